// Does a head, skin and brain fused from opaque particles, equal its ray-traced truth but for the noise?
// configs/fused_head.toml, scenes/fused_head.toml -> results/fused_head/ -> analysis/fused_head.py
#include <algorithm>
#include <bit>
#include <cmath>

#include "core/error.hpp"
#include "harness/experiment.hpp"
#include "measure/comparison.hpp"
#include "measure/particle_test.hpp"
#include "reference/truth.hpp"
#include "render/particles.hpp"
#include "study/coverage_tables.hpp"
#include "study/stage_seconds.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::vector<std::string> backends;
    std::filesystem::path scene;
    std::vector<std::int64_t> resolution;
    std::uint32_t repeats, twin_repeats;
    TruthSettings truth, box_truth;
    double error_share, twin_error, color_limit;
};

Settings read_settings(const ConfigTable& t) {
    const auto count = [&](const char* key, std::int64_t lo) {
        return t.integer(key, kRequired, {lo, 1 << 20});
    };
    const auto truth = [&](PixelFilter filter, const char* error, const char* samples) {
        return TruthSettings{
            filter, {}, t.number(error, kRequired, above(0)), static_cast<int>(count(samples, 64))};
    };
    const std::vector<std::string> backends = t.texts("backends", kRequired);
    for (const std::string& backend : backends)
        if (backend != "cpu" && backend != "vulkan")
            throw t.error("backends", fmt::format("holds \"{}\", expected \"cpu\", \"vulkan\"", backend));
    return {backends,
            t.file("scene"),
            t.integers("resolution", kRequired, {1, 1 << 15}, exactly(2)),
            static_cast<std::uint32_t>(count("repeats", 2)),
            static_cast<std::uint32_t>(count("twin_repeats", 2)),
            truth(PixelFilter::particle, "truth_error", "truth_samples"),
            truth(PixelFilter::box, "box_error", "box_samples"),
            t.number("largest_error_share", kRequired, above(0)),
            t.number("twin_error", kRequired, above(0)),
            t.number("color_limit", kRequired, above(0))};
}

/// The scene at the preset's size, before which --set image.resolution goes.
Scene read_scene(Experiment& ex, const Settings& s) {
    Scene scene = ex.scene(s.scene);
    const auto& given = ex.options().overrides;
    if (std::none_of(given.begin(), given.end(),
                     [](const auto& text) { return text.starts_with("image.resolution"); })) {
        scene.image.width = static_cast<int>(s.resolution[0]);
        scene.image.height = static_cast<int>(s.resolution[1]);
    }
    for (const Surface& surface : scene.surfaces)
        if (const auto* iso = std::get_if<IsosurfaceShape>(&surface.shape);
            iso != nullptr && !std::filesystem::exists(iso->volume))
            throw input_error(
                "{}: surface \"{}\": volume {} is not there, expected that of Debian's package mricron-data",
                scene.source, surface.name, iso->volume.string());
    return scene;
}

/// The drawing, its exact expectation, what a perfect camera would see, and a wrong twin of the drawing.
struct Pictures {
    Image drawn, one_set, truth, box;
    std::vector<RenderStats> stats;  // of the drawing, one a backend
    TruthStats truth_stats;
};

/// Pixels of which any plane's bits differ.
std::size_t pixels_that_differ(const Image& a, const Image& b) {
    std::vector<bool> differs(a.plane("A").size(), false);
    for (const std::string& name : a.names()) {
        const std::span<const float> one = a.plane(name);
        const std::span<const float> other = b.plane(name);
        for (std::size_t i = 0; i < one.size(); ++i)
            if (std::bit_cast<std::uint32_t>(one[i]) != std::bit_cast<std::uint32_t>(other[i]))
                differs[i] = true;
    }
    return static_cast<std::size_t>(std::count(differs.begin(), differs.end(), true));
}

Pictures make_pictures(Experiment& ex, const PreparedScene& scene, const Settings& s) {
    Pictures p;
    const std::vector<Backend>& backends = ex.backends(s.backends);
    const auto draw = [&](const std::string& name, const Backend& backend, std::uint32_t repeats,
                          bool same_set, RenderStats& stats) {
        const auto stage = ex.stage(name);
        ParticleSettings settings{.repeats = repeats, .sampler = {}, .max_error = {}, .backend = backend};
        settings.sampler.seed = ex.seed();
        settings.sampler.same_set_in_all_repeats = same_set;
        return render_particles(scene, settings, stats);
    };
    const auto trace = [&](const std::string& name, TruthSettings settings, std::uint64_t stream,
                           TruthStats& stats) {
        const auto stage = ex.stage(name);
        settings.seed = derived_seed(ex.seed(), stream);
        return trace_truth(scene, settings, stats);
    };
    RenderStats twin_stats;
    TruthStats box_stats;
    for (const Backend& backend : backends) {
        Image drawn = draw("particles, " + backend.name(), backend, s.repeats, false, p.stats.emplace_back());
        if (p.stats.size() == 1) p.drawn = std::move(drawn);
        else
            ex.check(
                fmt::format("drawn by {} and by {}: pixels that differ", backends[0].name(), backend.name()),
                static_cast<double>(pixels_that_differ(p.drawn, drawn)), "==", 0);
    }
    p.one_set = draw("wrong twin", backends[0], s.twin_repeats, true, twin_stats);
    p.truth = trace("truth, particle filter", s.truth, 1, p.truth_stats);
    p.box = trace("truth, box filter", s.box_truth, 2, box_stats);
    return p;
}

using Numbers = std::vector<std::pair<const char*, double>>;

void reject_twin(Experiment& ex, const std::string& name, double p, double level) {
    ex.check("wrong twin, " + name + ": p", p, "<", level);
}

/// Opacity, pixel by pixel; how much the choice of pixels matters; wrong twins.
Numbers test_opacity(Experiment& ex, const PreparedScene& scene, const Settings& s, const Pictures& p,
                     double level) {
    CoverageTables tables(ex, scene);
    const auto test = [&](const std::string& name, const Image& picture, std::span<const float> opacity,
                          double repeats, double share) {
        // Pixels are chosen by the error of the tracing that is not tested against: see particle_test.hpp.
        const Image& other = opacity.data() == p.box.plane("A").data() ? p.truth : p.box;
        const CoverageRule rule{
            .repeats = repeats, .largest_error_share = share, .seed = derived_seed(ex.seed(), 3)};
        CoverageTest result = test_coverage(picture.plane("A"), opacity, other.plane("variance.A"), rule);
        tables.add(name, share, result);
        return result;
    };
    const double repeats = s.repeats;
    const std::span<const float> opacity = p.truth.plane("A");
    const CoverageTest coverage = test("particles", p.drawn, opacity, repeats, s.error_share);
    ex.check("pixels tested", static_cast<double>(coverage.pixels.size()), ">=", 250);  // 5 a bin
    ex.check("A, share outside 3 sigma: p", coverage.outside_test.p_value, ">=", level);
    ex.check("A, p-values uniform (KS): p", coverage.ks.value_or(TestResult{}).p_value, ">=", level);
    ex.check("A, p-values uniform (chi2): p", coverage.chi2.value_or(TestResult{}).p_value, ">=", level);
    for (const double factor : {0.5, 2.0, 4.0})
        (void)test(fmt::format("rule x {}", factor), p.drawn, opacity, repeats, factor * s.error_share);
    const auto rejected = [&](const std::string& name, const Image& picture, std::span<const float> wrong,
                              double count) {
        reject_twin(ex, name, test("twin: " + name, picture, wrong, count, s.error_share).smallest_p(),
                    level);
    };
    rejected("optical depth off", p.drawn, opacity_off_by(opacity, s.twin_error), repeats);
    rejected("box filter", p.drawn, p.box.plane("A"), repeats);
    rejected("one set", p.one_set, opacity, s.twin_repeats);
    const EmptyPixels empty = test_empty(p.drawn.plane("A"), opacity, p.drawn.width());
    ex.check("pixels drawn where nothing is", static_cast<double>(empty.drawn), "==", 0);
    const double shift = smallest_shift_seen(std::max<std::size_t>(1, coverage.pixels.size()), level);
    return {{"smallest_shift_sigma", shift},
            {"smallest_optical_depth_error", shift / coverage.sensitivity},
            {"empty_pixels", static_cast<double>(empty.pixels)},
            {"rim_pixels", static_cast<double>(empty.rim)},
            {"rim_drawn", static_cast<double>(empty.rim_drawn)}};
}

/// Colour against the layered noise floor.
Numbers test_color(Experiment& ex, const Settings& s, const Pictures& p, double level) {
    const ColorTest color = test_colors(p.drawn, p.truth, s.repeats);
    ex.check("colour, RMSE over noise floor: p", color.p_value, ">=", level);
    if (normal_critical_value(level) * color.ratio_error < s.color_limit)  // else too few pixels to tell
        ex.check("colour, |RMSE over noise floor - 1|", std::abs(color.ratio - 1), "<=", s.color_limit);
    reject_twin(ex, "one set, colour", test_colors(p.one_set, p.truth, s.twin_repeats).p_value, level);
    return {{"color_rmse", color.rmse},
            {"color_floor", color.floor},
            {"color_ratio", color.ratio},
            {"color_truth_error", color.truth_error},
            {"color_ratio_error", color.ratio_error}};
}

/// The paper's table (Tanaka et al. 2012, sec. 5) and ours, a row a backend.
void write_table(Experiment& ex, const Settings& s, const Pictures& p) {
    CsvWriter& table = ex.csv("table", {"source", "scene", "backend", "device", "resolution_px", "repeats",
                                        "particles", "sampling_s", "draw_s", "device_s", "frames_per_s"});
    const auto paper = [&](const char* scene, double particles, double sampling_s, double frames_per_s) {
        table.row("Tanaka 2012", scene, "opengl", "GTX 580", 1024, 500, particles, sampling_s, std::nullopt,
                  std::nullopt, frames_per_s);
    };
    paper("breast, fig. 3 right", 6.3e7, 3294, 3.2);
    paper("organs, fig. 4 left", 9.5e7, 3708, 2.5);
    paper("dragon and wave, fig. 4 right", 5.0e7, 1449, 3.6);
    for (std::size_t i = 0; i < p.stats.size(); ++i) {
        const Backend& backend = ex.backends()[i];
        const std::vector<Stage>& stages = p.stats[i].stages;
        const double sampling_s = stage_seconds(p.stats[i], "cut into pieces") + stage_seconds(p.stats[i], "sample particles");
        const double draw_s = stage_seconds(p.stats[i], "project and average");
        std::optional<double> device_s;
        for (const Stage& stage : stages)
            if (stage.device_s) device_s = device_s.value_or(0) + *stage.device_s;
        table.row("Pellucid", "skin and brain", backend.name(), backend.device_name(), p.drawn.width(),
                  s.repeats, p.stats[i].particles, sampling_s, draw_s, device_s, 1 / draw_s);
    }
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    const PreparedScene scene = prepare(read_scene(ex, s));
    const Pictures p = make_pictures(ex, scene, s);
    const double level = sidak_level(0.001, 4);  // four tests of one drawing, 99.9 % together
    const double map_range = 0.05;               // of the edge bias's picture

    const EdgeBias bias = edge_bias(p.truth, p.box, s.repeats);
    Numbers numbers{{"repeats", s.repeats}, {"level", level}, {"twin_error", s.twin_error},
                    {"bias_rmse", bias.rmse}, {"bias_truth_error", bias.truth_error},
                    {"bias_share_above_noise", bias.share_above_noise}, {"bias_range", map_range},
                    {"truth_worst_error", p.truth_stats.worst_error}};
    for (const Numbers& more : {test_opacity(ex, scene, s, p, level), test_color(ex, s, p, level)})
        numbers.insert(numbers.end(), more.begin(), more.end());
    const Vec3 background = scene.settings.image.background;
    const Comparison seen =
        compare_images({"particles", p.drawn}, {"truth", p.truth},
                       {.metrics = parse_metrics("all"), .background = background, .wants_map = true});
    CsvWriter& csv = ex.csv("numbers", {"name", "value"});
    for (const auto& [metric, value] : seen.values) csv.row(metric_name(metric), value);
    for (const auto& [name, value] : numbers) csv.row(name, value);
    write_table(ex, s, p);

    const std::pair<const char*, const Image*> images[] = {
        {"particles", &p.drawn}, {"truth", &p.truth}, {"truth_box", &p.box}, {"edge_bias", &bias.map}};
    for (const auto& [name, image] : images) ex.image(name, *image);
    const Image bias_map = signed_grey(bias.map, map_range);
    const std::pair<const char*, const Image*> pictures[] = {
        {"particles", &p.drawn}, {"truth", &p.truth}, {"flip", &*seen.map}, {"edge_bias", &bias_map}};
    for (const auto& [name, image] : pictures) ex.png(std::string("pictures/") + name, *image, background);
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv,
                          {.name = "fused_head",
                           .question = "Does a head drawn by opaque particles equal its ray-traced truth?",
                           .reads_scene = true},
                          run);
}
