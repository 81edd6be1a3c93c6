// Are a sampler's particles uniform, independent, Poisson - and how many of them a second?
// configs/sampling_uniformity.toml -> results/sampling_uniformity/ -> analysis/sampling_uniformity.py
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "core/error.hpp"
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
               static_cast<int>(size("cells", 1, 16))};
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
    return {judge_uniformity(c.cells, world_points(scene, set), s.queries), seconds};
}

class Table {
public:
    explicit Table(Experiment& ex)
        : csv_(ex.csv("uniformity", {"surface", "sampler", "points", "chi2", "dof", "p", "density_deviation", "dispersion",
                                     "count_dispersion", "count_p", "neighbour", "neighbour_z", "sampling_s",
                                     "particles_per_s", "independent_per_s"})) {}
    void row(const std::string& surface, const std::string& sampler, const Measured& m) {
        const UniformityReport& r = m.report;
        const double rate = r.points / m.sampling_s;
        csv_.row(surface, sampler, r.points, r.chi2, r.dof, r.p_value, r.density_deviation, r.dispersion, r.count_dispersion,
                 r.count_p, r.neighbour, r.neighbour_z, m.sampling_s, rate, rate / std::max(r.dispersion, 1e-9));
    }

private:
    CsvWriter& csv_;
};

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    const TemporaryFolder folder;
    Table table(ex);
    auto progress = ex.progress("samplers", s.surfaces.size() * (s.samplers.size() + 1));
    // Three p-values a sampler and surface.
    const double level = sidak_level(0.001, 3.0 * static_cast<double>(s.surfaces.size() * s.samplers.size()));
    for (std::size_t i = 0; i < s.surfaces.size(); ++i) {
        const std::string& name = s.surfaces[i];
        const std::string body = uniformity_surface(name, folder.path());
        PreparedScene scene = prepare(uniformity_scene(body, folder.path()));
        AreaCells cells(scene, s.reference, s.cells, derived_seed(ex.seed(), 100 + i));
        Case c{name, std::move(scene), prepare(uniformity_scene(body, folder.path(), kFinePixels)), std::move(cells)};
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
    }
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv,
                          {.name = "sampling_uniformity",
                           .question = "Are a sampler's particles uniform, independent, Poisson, and how many a second?"},
                          run);
}
