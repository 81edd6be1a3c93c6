// Are a sampler's particles uniform, independent, Poisson - and how many of them a second?
// configs/sampling_uniformity.toml -> results/sampling_uniformity/ -> analysis/sampling_uniformity.py
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "core/stopwatch.hpp"
#include "harness/experiment.hpp"
#include "io/temporary_folder.hpp"
#include "study/sampler_choice.hpp"
#include "study/uniformity.hpp"
#include "study/uniformity_surfaces.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::vector<std::string> surfaces, samplers, biased;
    std::uint32_t repeats;
    double particles;
    std::size_t reference, queries;
    int cells;
    std::vector<double> steps;
    std::vector<std::int64_t> walkers, thinning;
    std::vector<std::string> thinned;
    std::vector<double> thinned_steps;
};

Settings read_settings(const ConfigTable& t) {
    const auto size = [&](const char* key, std::int64_t lo, std::int64_t hi) {
        return static_cast<std::size_t>(t.integer(key, kRequired, {lo, hi}));
    };
    Settings s{t.texts("surfaces", kRequired),
               t.texts("samplers", kRequired),
               t.texts("biased", kRequired),
               static_cast<std::uint32_t>(size("repeats", 2, 1 << 20)),
               t.number("particles", kRequired, at_least(10)),
               size("reference", 1000, 1 << 30),
               size("queries", 1, 1 << 20),
               static_cast<int>(size("cells", 1, 16)),
               t.numbers("steps", kRequired, {.lo = 0, .hi = 1, .lo_open = true}),
               t.integers("walkers", kRequired, {1, kMostWalkers}),
               t.integers("thinning", kRequired, {1, 1 << 20}),
               t.texts("thinned", kRequired),
               t.numbers("thinned_steps", kRequired, {.lo = 0, .hi = 1, .lo_open = true})};
    for (const std::string& name : s.samplers) (void)sampler_choice(name);
    return s;
}

/// A surface with what all samplers are judged against.
struct Case {
    std::string name;
    PreparedScene scene;
    /// The same with pixels so small that hardly any holds two particles: "stratified" draws no hidden ones.
    PreparedScene fine;
    AreaCells cells;
    NeighbourBaseline neighbours;
};
constexpr int kFinePixels = 4096;  // a side

/// Opacity at which a source gives so many particles a repeat, all of the surface being in view.
void set_particles(PreparedScene& scene, double area, double particles) {
    Object& object = scene.objects[0];
    const double pixels = area / scene.camera.pixel_area(scene.camera.to_view(object.geometry->bounds().center()));
    object.surface.opacity = -std::expm1(-particles / pixels);
}

struct Measured {
    UniformityReport report;
    double sampling_s = 0;
};

Measured measure(const Case& c, const Settings& s, const ParticleSettings& particles) {
    const bool stratified = particles.kind == SamplerKind::stratified;
    const PreparedScene& scene = stratified ? c.fine : c.scene;
    const Sources sources = make_sources(scene, particles.kind);
    SamplerSettings sampler = particles.sampler;
    if (stratified) sampler.stratify = StratifySettings{.group = s.repeats};
    Stopwatch watch;
    const ParticleSet set = sample_particles(scene, sources, sampler, 0, s.repeats);
    const double seconds = watch.lap();
    return {judge_uniformity(c.cells, world_points(scene, set), s.queries, c.neighbours), seconds};
}

class Table {
public:
    explicit Table(Experiment& ex)
        : csv_(ex.csv("uniformity", {"surface", "sampler", "points", "chi2", "dof", "p", "density_deviation", "dispersion",
                                     "count_dispersion", "count_p", "neighbour", "neighbour_expected", "neighbour_z", "sampling_s",
                                     "particles_per_s", "independent_per_s"})) {}
    void row(const std::string& surface, const std::string& sampler, const Measured& m) {
        const UniformityReport& r = m.report;
        const double rate = r.points / m.sampling_s;
        csv_.row(surface, sampler, r.points, r.chi2, r.dof, r.p_value, r.density_deviation, r.dispersion, r.count_dispersion,
                 r.count_p, r.neighbour, r.neighbour_expected, r.neighbour_z, m.sampling_s, rate, rate / std::max(r.dispersion, 1e-9));
    }

private:
    CsvWriter& csv_;
};

// ---- Brownian motion

/// A walk's settings and how they are called.
struct Walk {
    std::string name;
    WalkSettings settings;
};

/// About the first of every list, one setting changed at a time; then the wrong twins.
std::vector<Walk> walks_of(const Settings& s) {
    WalkSettings base;
    base.step = s.steps[0];
    base.walkers = static_cast<std::uint32_t>(s.walkers[0]);
    base.thinning = static_cast<std::uint32_t>(s.thinning[0]);
    std::vector<Walk> walks;
    const auto add = [&](const std::string& name, const auto& change) {
        walks.push_back({name, base});
        change(walks.back().settings);
    };
    add("brownian", [](WalkSettings&) {});
    for (std::size_t i = 1; i < s.steps.size(); ++i) add("step", [&](WalkSettings& w) { w.step = s.steps[i]; });
    for (const double step : s.steps)
        add("no drift", [&](WalkSettings& w) {
            w.step = step;
            w.drift = false;
        });
    for (std::size_t i = 1; i < s.walkers.size(); ++i)
        add("walkers", [&](WalkSettings& w) { w.walkers = static_cast<std::uint32_t>(s.walkers[i]); });
    for (std::size_t i = 1; i < s.thinning.size(); ++i)
        add("thinning", [&](WalkSettings& w) { w.thinning = static_cast<std::uint32_t>(s.thinning[i]); });
    add("single start", [](WalkSettings& w) { w.start = WalkSettings::Start::single; });
    const double large = *std::ranges::max_element(s.steps);
    add("twin: not projected", [&](WalkSettings& w) {
        w.step = large;
        w.twin.projected = false;
    });
    add("twin: neither correction nor drift", [](WalkSettings& w) {
        w.drift = false;
        w.twin.corrected = false;
    });
    add("twin: half the variance", [](WalkSettings& w) { w.twin.noise = 0.5; });
    return walks;
}

/// What successive positions of walkers say, sphere of radius 1 only: the mean cosine between them, and what a step that is
/// right gives exactly. P dw has the length ρ with ρ²/step² = χ² of two degrees of freedom, dx^(S) = −step² x for any f of that
/// sphere, and Newton's method goes along the radius: cos = a/√(a² + ρ²), a = 1 − step² (1 without the drift).
struct StepTest {
    double cosine = 0, expected = 0, z = 0;
    double radius_z = 0;  // mean distance from the centre beside 1, in units of 1e-6
};

double expected_cosine(double step, bool drift) {
    // ∫ a (a² + 2 step² t)^(−1/2) e^(−t) dt over t > 0, Simpson's rule.
    const double a = drift ? 1 - step * step : 1;
    constexpr int kPanels = 20000;
    constexpr double kEnd = 40;
    double sum = 0;
    for (int i = 0; i <= kPanels; ++i) {
        const double t = kEnd * i / kPanels;
        const double weight = i == 0 || i == kPanels ? 1 : i % 2 == 1 ? 4 : 2;
        sum += weight * std::exp(-t) * a / std::sqrt(a * a + 2 * step * step * t);
    }
    return sum * kEnd / kPanels / 3;
}

StepTest test_steps(const PointSets& sets, const WalkSettings& walk, double step) {
    MeanVariance cosine, radius;
    for (const auto& points : sets)
        for (std::size_t i = *walk.walkers; i < points.size(); ++i) {
            const Vec3& a = points[i - *walk.walkers];
            const Vec3& b = points[i];
            if (a == b) continue;  // a step that was not made
            cosine.add(dot(a, b) / (length(a) * length(b)));
            radius.add(length(b));
        }
    StepTest test;
    if (cosine.count() < 2) return test;
    test.cosine = cosine.mean();
    test.expected = expected_cosine(step, walk.drift);
    test.z = (test.cosine - test.expected) / cosine.standard_error();
    test.radius_z = (radius.mean() - 1) / 1e-6;
    return test;
}

class WalkTable {
public:
    explicit WalkTable(Experiment& ex)
        : csv_(ex.csv("walks", {"surface", "walk", "step", "walkers", "thinning", "drift", "points", "chi2", "dof",
                                "density_deviation", "density_noise", "dispersion", "neighbour", "mean_cosine", "expected_cosine", "cosine_z",
                                "radius_off", "at_borders", "lost", "sampling_s", "steps_per_s", "independent_per_s"})) {}

    void row(const std::string& surface, const Walk& w, const UniformityReport& r, const std::optional<StepTest>& t,
             const BrownianSource::Stats& stats, double seconds) {
        const auto of = [&](double StepTest::* value) { return t ? std::optional(*t.*value) : std::nullopt; };
        const auto steps = static_cast<double>(stats.steps);
        csv_.row(surface, w.name, *w.settings.step, *w.settings.walkers, w.settings.thinning, w.settings.drift ? 1 : 0, r.points,
                 r.chi2, r.dof, r.density_deviation, r.density_noise, r.dispersion, r.neighbour, of(&StepTest::cosine), of(&StepTest::expected),
                 of(&StepTest::z), of(&StepTest::radius_z), static_cast<double>(stats.at_borders) / steps,
                 static_cast<double>(stats.lost) / steps, seconds, steps / seconds, r.points / seconds / std::max(r.dispersion, 1e-9));
    }

private:
    CsvWriter& csv_;
};

/// All walks on one surface; on the unit sphere theory judges them.
void measure_walks(Experiment& ex, const Case& c, const Settings& s, const std::vector<Walk>& walks, WalkTable& table, double level,
                   const std::function<void()>& step_done) {
    const auto count = static_cast<std::uint32_t>(s.particles);
    for (const Walk& w : walks) {
        const BrownianSource source(c.scene.objects[0], c.scene.camera, 0, w.settings);
        // The wider a walk's stride, the fewer of its positions are needed.
        const std::uint32_t repeats = std::max(2U, s.repeats / (w.settings.thinning > 10 ? 10 : 1));
        PointSets sets(repeats);
        Stopwatch watch;
        parallel_for(repeats, 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i)
                sets[i] = source.positions(derived_seed(ex.seed(), 400), static_cast<std::uint32_t>(i), count);
        });
        const double seconds = watch.lap();
        const UniformityReport report = judge_uniformity(c.cells, sets, s.queries, c.neighbours);
        std::optional<StepTest> steps;
        if (c.name == "sphere" && w.settings.thinning == 1 && *w.settings.walkers < count)
            steps = test_steps(sets, w.settings, source.step_length());
        table.row(c.name, w, report, steps, source.stats(), seconds);
        step_done();
        if (!steps) continue;
        const double p = normal_two_sided_p(steps->z);
        if (!w.name.starts_with("twin")) {
            ex.check(fmt::format("sphere, {}, step {}: length of steps: p", w.name, *w.settings.step), p, ">=", level);
            ex.check(fmt::format("sphere, {}, step {}: off the surface, 1e-6", w.name, *w.settings.step), std::abs(steps->radius_z), "<=", 1);
        } else if (w.settings.twin.corrected) {
            ex.check("sphere, wrong " + w.name + ": p", p, "<", level);
        } else {
            ex.check("sphere, wrong " + w.name + ": off the surface, 1e-6", std::abs(steps->radius_z), ">", 1);
        }
    }
}

/// What dx^(S) is for: walks so thin that little but their bias is left. Every particle of a repeat is another walker's, after
/// kThinned steps from a uniform place. (A sphere says nothing: by its symmetry any walk is uniform there.)
void measure_thinned(Experiment& ex, const Case& c, const Settings& s, WalkTable& table, double level,
                     const std::function<void()>& step_done) {
    constexpr std::uint32_t kThinned = 20;
    /// RMS deviation of density at step 0.1 of the width: dx^(S) stays below, and it is not reached without.
    constexpr double kJudgedStep = 0.1;
    constexpr double kMost = 0.05;
    const auto count = static_cast<std::uint32_t>(s.particles);
    for (const double step : s.thinned_steps)
        for (const bool drift : {true, false}) {
            Walk w{drift ? "thinned" : "thinned, no drift", {}};
            w.settings.step = step;
            w.settings.walkers = count;
            w.settings.thinning = kThinned;
            w.settings.drift = drift;
            const BrownianSource source(c.scene.objects[0], c.scene.camera, 0, w.settings);
            PointSets sets(s.repeats);
            Stopwatch watch;
            parallel_for(sets.size(), 1, [&](std::size_t begin, std::size_t end) {
                for (std::size_t i = begin; i < end; ++i)
                    sets[i] = source.positions(derived_seed(ex.seed(), 500), static_cast<std::uint32_t>(i), count);
            });
            const double seconds = watch.lap();
            const UniformityReport report = judge_uniformity(c.cells, sets, s.queries, c.neighbours);
            table.row(c.name, w, report, {}, source.stats(), seconds);
            step_done();
            const std::string what = fmt::format("{}, step {}, every {}th position, ", c.name, step, kThinned);
            if (step == kJudgedStep && drift) ex.check(what + "deviation of density", report.density_deviation, "<=", kMost);
            if (step == kJudgedStep && !drift) {
                ex.check("wrong twin: " + what + "without dx^(S): deviation of density", report.density_deviation, ">", kMost);
                ex.check("wrong twin: " + what + "without dx^(S): chi2: p", report.p_value, "<", level);
            }
        }
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    const TemporaryFolder folder;
    Table table(ex);
    WalkTable walk_table(ex);
    const std::vector<Walk> walks = walks_of(s);
    const auto thinned_here = [&](const std::string& name) { return std::ranges::find(s.thinned, name) != s.thinned.end(); };
    const auto thinned = static_cast<std::size_t>(std::ranges::count_if(s.surfaces, thinned_here));
    auto progress = ex.progress("samplers", s.surfaces.size() * (s.samplers.size() + 1 + walks.size()) + thinned * s.thinned_steps.size() * 2);
    // Three p-values a sampler and surface, one a walk.
    const double level =
        sidak_level(0.001, 3.0 * static_cast<double>(s.surfaces.size() * s.samplers.size()) + static_cast<double>(walks.size()));
    for (std::size_t i = 0; i < s.surfaces.size(); ++i) {
        const std::string& name = s.surfaces[i];
        const std::string body = uniformity_surface(name, folder.path());
        PreparedScene scene = prepare(uniformity_scene(body, folder.path()));
        AreaCells cells(scene, s.reference, s.cells, derived_seed(ex.seed(), 100 + i));
        Case c{name, std::move(scene), prepare(uniformity_scene(body, folder.path(), kFinePixels)), std::move(cells), {}};
        c.neighbours = neighbour_baseline(c.cells, s.particles, s.queries);
        set_particles(c.scene, c.cells.area(), s.particles);
        set_particles(c.fine, c.cells.area(), s.particles);
        for (const std::string& sampler : s.samplers) {
            ParticleSettings particles;
            sampler_choice(sampler).apply(particles);
            particles.sampler.seed = derived_seed(ex.seed(), 200 + i);
            const Measured m = measure(c, s, particles);
            table.row(name, sampler, m);
            progress->step();
            if (std::ranges::find(s.biased, sampler) != s.biased.end()) continue;
            const std::string what = name + ", " + sampler + ": ";
            ex.check(what + "uniform, chi2: p", m.report.p_value, ">=", level);
            if (sampler == "stratified") continue;  // less than Poisson, as it should be
            ex.check(what + "Poisson numbers: p", m.report.count_p, ">=", level);
            ex.check(what + "neighbours of a Poisson process: p", normal_two_sided_p(m.report.neighbour_z), ">=", level);
        }
        ParticleSettings twin;
        twin.sampler.seed = derived_seed(ex.seed(), 300 + i);
        twin.sampler.keep_all_crossings = true;
        if (c.scene.objects[0].geometry->implicit()) {
            const Measured m = measure(c, s, twin);
            table.row(name, "twin: all hits of a line in one repeat", m);
            ex.check(name + ", wrong twin, all hits of a line in one repeat: p", std::min(m.report.count_p, m.report.p_value), "<", level);
        }
        progress->step();
        measure_walks(ex, c, s, walks, walk_table, level, [&] { progress->step(); });
        if (thinned_here(name)) measure_thinned(ex, c, s, walk_table, level, [&] { progress->step(); });
    }
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv,
                          {.name = "sampling_uniformity",
                           .question = "Are a sampler's particles uniform, independent, Poisson, and how many a second?"},
                          run);
}
