// Does a real head, skin and brain fused from opaque particles, equal its ray-traced truth but for the noise that theory allows?
// configs/fused_head.toml, scenes/fused_head.toml -> results/fused_head/ -> analysis/fused_head.py
#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "harness/experiment.hpp"
#include "measure/comparison.hpp"
#include "measure/particle_test.hpp"
#include "reference/truth.hpp"
#include "render/particles.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::filesystem::path scene;
    std::vector<std::int64_t> resolution;
    std::uint32_t repeats, twin_repeats;
    TruthSettings truth, box_truth;
    double error_share, twin_error, color_limit;
};

Settings read_settings(const ConfigTable& t) {
    const auto count = [&](const char* key, std::int64_t lo) { return t.integer(key, kRequired, {lo, 1 << 20}); };
    const auto truth = [&](PixelFilter filter, const char* error, const char* samples) {
        return TruthSettings{filter, {}, t.number(error, kRequired, above(0)), static_cast<int>(count(samples, 64))};
    };
    return {t.file("scene"), t.integers("resolution", kRequired, {1, 1 << 15}, exactly(2)),
            static_cast<std::uint32_t>(count("repeats", 2)), static_cast<std::uint32_t>(count("twin_repeats", 2)),
            truth(PixelFilter::particle, "truth_error", "truth_samples"), truth(PixelFilter::box, "box_error", "box_samples"),
            t.number("largest_error_share", kRequired, above(0)), t.number("twin_error", kRequired, above(0)),
            t.number("color_limit", kRequired, above(0))};
}

/// The scene at the preset's size, before which --set image.resolution goes.
Scene read_scene(Experiment& ex, const Settings& s) {
    Scene scene = ex.scene(s.scene);
    const auto& given = ex.options().overrides;
    if (std::none_of(given.begin(), given.end(), [](const auto& text) { return text.starts_with("image.resolution"); })) {
        scene.image.width = static_cast<int>(s.resolution[0]);
        scene.image.height = static_cast<int>(s.resolution[1]);
    }
    for (const Surface& surface : scene.surfaces)
        if (const auto* iso = std::get_if<IsosurfaceShape>(&surface.shape); iso != nullptr && !std::filesystem::exists(iso->volume))
            throw input_error("{}: surface \"{}\": volume {} is not there, expected that of Debian's package mricron-data",
                              scene.source, surface.name, iso->volume.string());
    return scene;
}

std::string names_of(const PreparedScene& scene, const SurfaceClass& surfaces) {
    std::string names;
    for (std::size_t i = 0; i < scene.objects.size(); ++i)
        if ((surfaces.objects >> i & 1U) != 0) names += (names.empty() ? "" : " + ") + scene.objects[i].surface.name;
    return names.empty() ? "smaller than a pixel" : names;
}

struct Tables {
    CsvWriter &tests, &p_values, &z_scores, &outside;
};

void write(const Tables& to, const std::string& name, double share, const CoverageTest& t, const PreparedScene& scene,
           std::span<const SurfaceClass> classes) {
    const TestResult ks = t.ks.value_or(TestResult{}), chi2 = t.chi2.value_or(TestResult{});
    to.tests.row(name, share, t.pixels.size(), t.left_out, t.worst_error_share, t.mean_noise_share, t.outside, t.outside_expected,
                 t.outside_test.statistic, t.outside_test.p_value, ks.statistic, ks.p_value, chi2.p_value);
    const auto bins = [&](CsvWriter& csv, const Histogram& h) {
        for (std::size_t i = 0; i < h.counts.size(); ++i) {
            const double lo = h.lo + static_cast<double>(i) * h.width;
            csv.row(name, lo, lo + h.width, h.counts[i], h.expected[i]);
        }
    };
    bins(to.p_values, p_value_histogram(t));
    bins(to.z_scores, z_histogram(t));
    for (const ClassOutcome& c : outside_by_class(t, classes))
        to.outside.row(name, names_of(scene, c.surfaces), c.surfaces.edge ? "edge" : "inner", c.pixels, c.outside, c.expected, std::sqrt(c.variance));
}

void run(Experiment& ex) {
    Settings s = ex.config(read_settings);
    const PreparedScene scene = prepare(read_scene(ex, s));
    const double repeats = s.repeats, twin_repeats = s.twin_repeats, share = s.error_share;
    s.truth.seed = derived_seed(ex.seed(), 1);
    s.box_truth.seed = derived_seed(ex.seed(), 2);

    // The drawing, its exact expectation, what a perfect camera would see, and a wrong twin of the drawing
    RenderStats stats, twin_stats;
    TruthStats truth_stats, box_stats;
    const auto draw = [&](std::uint32_t count, bool same_set, RenderStats& to) {
        const auto stage = ex.stage(same_set ? "wrong twin" : "particles");
        ParticleSettings settings{.repeats = count, .sampler = {}, .max_error = {}};
        settings.sampler.seed = ex.seed();
        settings.sampler.same_set_in_all_repeats = same_set;
        return render_particles(scene, settings, to);
    };
    const auto trace = [&](const std::string& name, const TruthSettings& settings, TruthStats& to) {
        const auto stage = ex.stage(name);
        return trace_truth(scene, settings, to);
    };
    const Image drawn = draw(s.repeats, false, stats);
    const Image twin = draw(s.twin_repeats, true, twin_stats);
    const Image truth = trace("truth, particle filter", s.truth, truth_stats);
    const Image box = trace("truth, box filter", s.box_truth, box_stats);

    // Opacity, pixel by pixel; how much the choice of pixels matters; wrong twins, which must be rejected
    const std::vector<SurfaceClass> classes = surface_classes(scene);
    const Tables tables{ex.csv("coverage", {"case", "largest_error_share", "pixels", "left_out", "worst_error_share", "mean_noise_share", "outside",
                                            "outside_expected", "outside_z", "outside_p", "ks_distance", "ks_p", "chi2_p"}),
                        ex.csv("p_values", {"case", "p_lo", "p_hi", "pixels", "expected"}),
                        ex.csv("z_scores", {"case", "z_lo", "z_hi", "pixels", "expected"}),
                        ex.csv("outside", {"case", "surfaces", "place", "pixels", "outside", "outside_expected", "outside_sd"})};
    const auto test = [&](const std::string& name, const Image& picture, std::span<const float> opacity, double count, double most) {
        const CoverageRule rule{.repeats = count, .largest_error_share = most, .seed = derived_seed(ex.seed(), 3)};
        CoverageTest result = test_coverage(picture.plane("A"), opacity, truth.plane("variance.A"), rule);
        write(tables, name, most, result, scene, classes);
        return result;
    };
    const double level = sidak_level(0.001, 4);  // four tests of one drawing, 99.9 % together
    const CoverageTest coverage = test("particles", drawn, truth.plane("A"), repeats, share);
    ex.check("pixels tested", static_cast<double>(coverage.pixels.size()), ">=", 250);  // 5 a bin
    ex.check("A, share outside 3 sigma: p", coverage.outside_test.p_value, ">=", level);
    ex.check("A, p-values uniform (KS): p", coverage.ks.value_or(TestResult{}).p_value, ">=", level);
    ex.check("A, p-values uniform (chi2): p", coverage.chi2.value_or(TestResult{}).p_value, ">=", level);
    for (const double factor : {0.5, 2.0, 4.0}) (void)test(fmt::format("rule x {}", factor), drawn, truth.plane("A"), repeats, factor * share);
    const auto rejected = [&](const std::string& name, double p) { ex.check("wrong twin, " + name + ": p", p, "<", level); };
    rejected("optical depth off", test("twin: optical depth off", drawn, opacity_off_by(truth.plane("A"), s.twin_error), repeats, share).smallest_p());
    rejected("box filter", test("twin: box filter", drawn, box.plane("A"), repeats, share).smallest_p());
    rejected("one set", test("twin: one set", twin, truth.plane("A"), twin_repeats, share).smallest_p());
    const EmptyPixels empty = test_empty(drawn.plane("A"), truth.plane("A"), drawn.width());
    ex.check("pixels drawn where nothing is", static_cast<double>(empty.drawn), "==", 0);

    // Colour against the layered noise floor; the model's own bias at edges
    const ColorTest color = test_colors(drawn, truth, repeats);
    ex.check("colour, RMSE over noise floor: p", color.p_value, ">=", level);
    if (normal_critical_value(level) * color.ratio_error < s.color_limit)  // else too few pixels to tell
        ex.check("colour, |RMSE over noise floor - 1|", std::abs(color.ratio - 1), "<=", s.color_limit);
    rejected("one set, colour", test_colors(twin, truth, twin_repeats).p_value);
    const EdgeBias bias = edge_bias(truth, box, repeats);
    const Comparison seen = compare_images({"particles", drawn}, {"truth", truth},
                                           {.metrics = parse_metrics("all"), .background = scene.settings.image.background, .wants_map = true});
    const double range = 0.05, shift = smallest_shift_seen(std::max<std::size_t>(1, coverage.pixels.size()), level);
    CsvWriter& numbers = ex.csv("numbers", {"name", "value"});
    for (const auto& [metric, value] : seen.values) numbers.row(metric_name(metric), value);
    for (const auto& [name, value] : std::initializer_list<std::pair<const char*, double>>{
             {"repeats", repeats}, {"level", level}, {"color_rmse", color.rmse}, {"color_floor", color.floor}, {"color_ratio", color.ratio},
             {"color_truth_error", color.truth_error}, {"color_ratio_error", color.ratio_error}, {"smallest_shift_sigma", shift},
             {"smallest_optical_depth_error", shift / coverage.sensitivity}, {"twin_error", s.twin_error}, {"bias_rmse", bias.rmse},
             {"bias_truth_error", bias.truth_error}, {"bias_share_above_noise", bias.share_above_noise}, {"bias_range", range},
             {"empty_pixels", static_cast<double>(empty.pixels)}, {"rim_pixels", static_cast<double>(empty.rim)},
             {"rim_drawn", static_cast<double>(empty.rim_drawn)}, {"truth_worst_error", truth_stats.worst_error}})
        numbers.row(name, value);

    // The paper's table and ours; pictures
    CsvWriter& table = ex.csv("table", {"source", "scene", "resolution_px", "repeats", "particles", "sampling_s", "draw_s", "frames_per_s"});
    table.row("Tanaka 2012", "breast, fig. 3 right", 1024, 500, 6.3e7, 3294, std::nullopt, 3.2);
    table.row("Tanaka 2012", "organs, fig. 4 left", 1024, 500, 9.5e7, 3708, std::nullopt, 2.5);
    table.row("Tanaka 2012", "dragon and wave, fig. 4 right", 1024, 500, 5.0e7, 1449, std::nullopt, 3.6);
    const double sampling_s = stats.stages[0].wall_s + stats.stages[1].wall_s, draw_s = stats.stages[2].wall_s;
    table.row("Pellucid", "skin and brain", drawn.width(), s.repeats, stats.particles, sampling_s, draw_s, 1 / draw_s);
    for (const auto& [name, image] : {std::pair{"particles", &drawn}, {"truth", &truth}, {"truth_box", &box}, {"edge_bias", &bias.map}})
        ex.image(name, *image);
    const Image bias_map = signed_grey(bias.map, range);
    for (const auto& [name, image] : {std::pair{"particles", &drawn}, {"truth", &truth}, {"flip", &*seen.map}, {"edge_bias", &bias_map}})
        ex.png(std::string("pictures/") + name, *image, scene.settings.image.background);
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv, {"fused_head", "Does a head drawn by opaque particles equal its ray-traced truth?"}, run);
}
