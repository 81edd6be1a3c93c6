// Is opacity inside of a split slab to be spread linearly (modified) or as a medium's (original), and what does the
// eye see of it? zSlab dissertation, figures 3.1 to 3.3, 6.9, 6.10.
// configs/visibility_interpolation.toml, scenes/slabs -> results/visibility_interpolation/ -> analysis/…
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "harness/experiment.hpp"
#include "kernel/slab_twin.h"
#include "measure/flip.hpp"
#include "measure/gradient_energy.hpp"
#include "measure/statistics.hpp"
#include "reference/truth.hpp"
#include "scene/scene_file.hpp"
#include "study/method_image.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::filesystem::path crossing, clipped;
    std::vector<std::int64_t> resolution;
    std::int64_t layers;
    std::vector<double> profile_opacities;
    std::size_t profile_points;
    std::vector<double> opacities, thicknesses_px, steps;
    TruthSettings truth;
    double band_rmse;
    std::vector<double> band_periods_px;
};

Settings read_settings(const ConfigTable& t) {
    const auto numbers = [&](const char* key, const Range& range) { return t.numbers(key, kRequired, range); };
    return {t.file("crossing"),
            t.file("clipped"),
            t.integers("resolution", kRequired, {16, 1 << 14}, exactly(2)),
            t.integer("layers", kRequired, {2, 1 << 10}),
            numbers("profile_opacities", within(0, 1)),
            static_cast<std::size_t>(t.integer("profile_points", kRequired, {2, 1 << 20})),
            numbers("opacities", {.lo = 0, .hi = 1, .lo_open = true}),
            numbers("thicknesses_px", at_least(0)),
            numbers("steps", above(0)),
            {PixelFilter::box, {}, t.number("truth_error", kRequired, above(0)),
             static_cast<int>(t.integer("truth_samples", kRequired, {64, 1 << 20}))},
            t.number("band_rmse", kRequired, above(0)),
            numbers("band_periods_px", at_least(2))};
}

struct Interpolation {
    const char* name;  // as in settings
    twin::uint number;
};
constexpr Interpolation kInterpolations[] = {{"modified", twin::kInterpolateModified},
                                             {"original", twin::kInterpolateOriginal},
                                             {"original-textbook", twin::kInterpolateTextbook}};

/// zSlab (3.2) in double: what a homogeneous medium lets pass.
double medium_opacity(double alpha, double t) {
    return t <= 0 ? 0 : alpha >= 1 ? 1 : -std::expm1(t * std::log1p(-alpha));
}

twin::SlabParts parts_of(float alpha, float t, const Interpolation& model) {
    return twin::split_slab({1, 1, alpha, 0.5F * alpha, 0, alpha}, 0, t, model.number);
}

/// Figure 3.1, and how many digits each evaluation keeps.
void judge_profiles(Experiment& ex, const Settings& s) {
    CsvWriter& csv = ex.csv("profile", {"opacity", "t_over_d", "interpolation", "front_opacity", "medium_opacity"});
    for (const double alpha : s.profile_opacities)
        for (std::size_t i = 0; i < s.profile_points; ++i) {
            const double t = static_cast<double>(i) / static_cast<double>(s.profile_points - 1);
            for (const Interpolation& model : kInterpolations)
                csv.row(alpha, t, model.name,
                        static_cast<double>(parts_of(static_cast<float>(alpha), static_cast<float>(t), model).front.a),
                        medium_opacity(static_cast<double>(static_cast<float>(alpha)), static_cast<double>(static_cast<float>(t))));
        }

    CsvWriter& digits = ex.csv("digits", {"opacity", "t_over_d", "interpolation", "relative_error", "whole_error"});
    std::map<std::string, double> worst, worst_whole;
    for (int e = -24; e <= -1; ++e)
        for (const bool near_one : {false, true})
            for (const float t : {1e-6F, 1e-3F, 0.1F, 0.5F, 0.9F, 0.999F}) {
                const float small = std::ldexp(1.0F, e);
                const float alpha = near_one ? 1 - small : small;
                for (const Interpolation& model : kInterpolations) {
                    const twin::SlabParts parts = parts_of(alpha, t, model);
                    const double truth = medium_opacity(static_cast<double>(alpha), static_cast<double>(t));
                    const double off = std::abs(static_cast<double>(parts.front.a) / truth - 1);
                    const double whole =
                        std::abs(static_cast<double>(twin::slab_over(parts.front, parts.back).a) / static_cast<double>(alpha) - 1);
                    digits.row(static_cast<double>(alpha), static_cast<double>(t), model.name, off, whole);
                    worst[model.name] = std::max(worst[model.name], off);
                    worst_whole[model.name] = std::max(worst_whole[model.name], whole);
                }
            }
    constexpr double kUlp = 0x1p-23;
    ex.check("original in stable numerics: largest relative error beside a medium", worst["original"], "<=", 4 * kUlp);
    ex.check("modified: front over back beside the whole", worst_whole["modified"], "<=", 4 * kUlp);
    ex.check("original: front over back beside the whole", worst_whole["original"], "<=", 4 * kUlp);
    ex.check("the textbook's formula loses digits: largest relative error", worst["original-textbook"], ">=", 0.01);
    ex.check("modified moves opacity: front half of 0.9 beside a medium's 0.684",
             medium_opacity(0.9, 0.5) - static_cast<double>(parts_of(0.9F, 0.5F, kInterpolations[0]).front.a), ">=", 0.2);
}

Scene resized(Scene scene, const Settings& s) {
    scene.image.width = static_cast<int>(s.resolution[0]);
    scene.image.height = static_cast<int>(s.resolution[1]);
    return scene;
}

/// One picture beside its truth.
struct Judged {
    std::string scene, method;
    double opacity = 0, thickness_px = 0, step_voxels = 0;
    double rmse = 0, flip = 0;
    GradientDifference gradient;
};

class Pictures {
public:
    Pictures(Experiment& ex, const Settings& s)
        : ex_(&ex),
          settings_(&s),
          csv_(&ex.csv("pictures", {"scene", "method", "opacity", "thickness_px", "step_voxels", "rmse", "banding", "blur", "flip"})),
          rows_(&ex.csv("rows", {"scene", "method", "opacity", "thickness_px", "step_voxels", "x_px", "r", "g", "b"})) {}

    void begin(const PreparedScene& scene) {
        TruthStats stats;
        TruthSettings settings = settings_->truth;
        settings.seed = derived_seed(ex_->seed(), 1);
        const auto stage = ex_->stage("truth");
        image_ = trace_truth(scene, settings, stats);
        truth_ = over_background(image_, scene.settings.image.background, "truth");
    }
    [[nodiscard]] const RgbImage& truth() const { return truth_; }
    [[nodiscard]] const Image& truth_image() const { return image_; }

    void add(const PreparedScene& scene, const MethodChoice& choice, Judged judged, bool keep) {
        RenderStats stats;
        const Image image = method_image(scene, choice, ex_->seed(), stats);
        const RgbImage test = over_background(image, scene.settings.image.background, judged.method);
        judged.rmse = rmse(test, truth_);
        judged.gradient = gradient_difference(test, truth_);
        judged.flip = pellucid::flip(test, truth_).mean;
        csv_->row(judged.scene, judged.method, judged.opacity, judged.thickness_px, judged.step_voxels, judged.rmse,
                  judged.gradient.excess, judged.gradient.lack, judged.flip);
        if (keep) {
            ex_->png(fmt::format("pictures/{}_{}", judged.scene, judged.method), image, scene.settings.image.background);
            add_row(judged, test);
        }
        all_.push_back(judged);
    }
    /// The middle row of the truth or of a picture.
    void add_row(const Judged& judged, const RgbImage& image) {
        const auto width = static_cast<std::size_t>(image.width);
        const std::size_t first = width * static_cast<std::size_t>(image.height / 2);
        for (std::size_t x = 0; x < width; ++x)
            rows_->row(judged.scene, judged.method, judged.opacity, judged.thickness_px, judged.step_voxels,
                       static_cast<double>(x) + 0.5, image.channels[0][first + x], image.channels[1][first + x],
                       image.channels[2][first + x]);
    }
    [[nodiscard]] const std::vector<Judged>& all() const { return all_; }

private:
    Experiment* ex_;
    const Settings* settings_;
    CsvWriter* csv_;
    CsvWriter* rows_;
    Image image_;
    RgbImage truth_;
    std::vector<Judged> all_;
};

/// Two surfaces: opacity by thickness.
void judge_crossing(Experiment& ex, const Settings& s, Pictures& pictures) {
    Scene file = resized(ex.scene(s.crossing), s);
    const double pixel = file.camera.view_height / static_cast<double>(s.resolution[1]);
    const double most = *std::ranges::max_element(s.opacities);
    for (const double opacity : s.opacities) {
        for (Surface& surface : file.surfaces) surface.opacity = opacity;
        pictures.begin(prepare(file));
        if (opacity == most) {
            pictures.add_row({"crossing", "truth", opacity, 0, 0, 0, 0, {}}, pictures.truth());
            ex.png("pictures/crossing_truth", pictures.truth_image(), file.image.background);
        }
        // What both are without virtual thickness: one surface wins each pixel.
        const char* const binary = opacity < 1 ? "depth-peeling" : "z-test";
        pictures.add(prepare(file), {binary, {}}, {"crossing", binary, opacity, 0, 0, 0, 0, {}}, opacity == most);
        for (const double thickness : s.thicknesses_px) {
            for (Surface& surface : file.surfaces) surface.thickness = thickness * pixel;
            const PreparedScene scene = prepare(file);
            for (const Interpolation& model : kInterpolations)
                pictures.add(scene,
                             {"slabs", {fmt::format("slabs.layers={}", s.layers), fmt::format("slabs.interpolation=\"{}\"", model.name)}},
                             {"crossing", model.name, opacity, thickness, 0, 0, 0, {}},
                             opacity == most && thickness == s.thicknesses_px.back());
        }
    }
}

/// A volume and surfaces: opacity over a voxel by step.
void judge_clipped(Experiment& ex, const Settings& s, Pictures& pictures) {
    Scene file = resized(ex.scene(s.clipped), s);
    const double most = *std::ranges::max_element(s.opacities);
    for (const double opacity : s.opacities) {
        for (TransferPoint& point : file.volumes[0].transfer)
            if (point[4] > 0) point[4] = opacity;
        const PreparedScene scene = prepare(file);
        pictures.begin(scene);
        if (opacity == most) {
            pictures.add_row({"clipped", "truth", opacity, 0, 0, 0, 0, {}}, pictures.truth());
            ex.png("pictures/clipped_truth", pictures.truth_image(), file.image.background);
        }
        for (const double step : s.steps) {
            const bool keep = opacity == most && (step == 1 || s.steps.size() == 1);
            for (const Interpolation& model : kInterpolations)
                pictures.add(scene,
                             {"slabs", {fmt::format("slabs.layers={}", s.layers), fmt::format("slabs.interpolation=\"{}\"", model.name),
                                        fmt::format("slabs.step={}", step)}},
                             {"clipped", model.name, opacity, 0, step, 0, 0, {}}, keep);
            pictures.add(scene, {"mdvr", {fmt::format("mdvr.step={}", step)}}, {"clipped", "mdvr", opacity, 0, step, 0, 0, {}}, keep);
        }
    }
}

/// Bands of one RMSE and any period on an even picture, and a shift of the whole: what does each number say?
void judge_bands(Experiment& ex, const Settings& s) {
    constexpr int kHeight = 32;
    const auto width = static_cast<int>(4 * *std::ranges::max_element(s.band_periods_px));
    const auto picture = [&](const std::function<double(double)>& value) {
        RgbImage image{width, kHeight, {}};
        for (auto& channel : image.channels)
            for (int i = 0; i < width * kHeight; ++i) channel.push_back(0.4 + value(i % width));
        return image;
    };
    const RgbImage truth = picture([](double) { return 0.0; });
    // No period: a shift of the whole.
    CsvWriter& csv = ex.csv("bands", {"period_px", "cycles_per_degree", "rmse", "banding", "flip", "sensitivity"});
    const auto add = [&](std::optional<double> period, const RgbImage& test) {
        const double banding = gradient_difference(test, truth).excess;
        const double frequency = period ? kDefaultPixelsPerDegree / *period : 0;
        csv.row(period, frequency, rmse(test, truth), banding, flip(test, truth).mean, contrast_sensitivity(frequency));
        return banding;
    };
    const double shift = add({}, picture([&](double) { return s.band_rmse; }));
    std::vector<double> bandings, sensitivities;
    for (const double period : s.band_periods_px) {
        const auto wave = [&](double x) { return std::sin(2 * std::numbers::pi * (x + 0.25) / period); };
        const double scale = s.band_rmse / rmse(picture(wave), truth);
        bandings.push_back(add(period, picture([&](double x) { return scale * wave(x); })));
        sensitivities.push_back(contrast_sensitivity(kDefaultPixelsPerDegree / period));
    }
    ex.check("a shift of the whole picture is no band", shift, "<=", 1e-9);
    ex.check("bands of one RMSE: rank correlation of banding with the eye's contrast sensitivity",
             rank_correlation(bandings, sensitivities).value_or(std::nan("")), ">=", 0.9);
}

/// Rank correlation of banding with FLIP over all pictures of one scene.
std::optional<double> seen_by_flip(const std::vector<Judged>& all, const std::string& scene, double (*number)(const Judged&)) {
    std::vector<double> a, b;
    for (const Judged& j : all)
        if (j.scene == scene) {
            a.push_back(number(j));
            b.push_back(j.flip);
        }
    return rank_correlation(a, b);
}

double mean_of(const std::vector<Judged>& all, const std::string& scene, const std::string& method, double opacity,
               double (*number)(const Judged&)) {
    double sum = 0;
    int count = 0;
    for (const Judged& j : all)
        if (j.scene == scene && j.method == method && j.opacity == opacity) {
            sum += number(j);
            ++count;
        }
    return count > 0 ? sum / count : std::nan("");
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    judge_profiles(ex, s);
    judge_bands(ex, s);
    Pictures pictures(ex, s);
    judge_crossing(ex, s, pictures);
    judge_clipped(ex, s, pictures);

    const auto banding = [](const Judged& j) { return j.gradient.excess; };
    const auto error = [](const Judged& j) { return j.rmse; };
    CsvWriter& csv = ex.csv("eye", {"scene", "rank_correlation_banding_flip", "rank_correlation_rmse_flip"});
    for (const char* scene : {"crossing", "clipped"})
        csv.row(scene, seen_by_flip(pictures.all(), scene, banding), seen_by_flip(pictures.all(), scene, error));
    const double most = *std::ranges::max_element(s.opacities);
    for (const Judged& modified : pictures.all()) {
        if (modified.scene != "crossing" || modified.method != "modified" || modified.opacity != most) continue;
        if (!(modified.thickness_px > 0 && modified.thickness_px <= 2)) continue;
        for (const Judged& original : pictures.all())
            if (original.scene == "crossing" && original.method == "original" && original.opacity == most &&
                original.thickness_px == modified.thickness_px)
                ex.check(fmt::format("crossing: banding of modified over that of original, {} pixels thick", modified.thickness_px),
                         modified.gradient.excess / original.gradient.excess, "<=", 1);
    }
    for (const char* scene : {"clipped"})
        ex.check(fmt::format("{}: banding of modified over that of original, opacity {}", scene, most),
                 mean_of(pictures.all(), scene, "modified", most, banding) / mean_of(pictures.all(), scene, "original", most, banding),
                 "<=", 1);
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv,
                          {.name = "visibility_interpolation",
                           .question = "Linear or as a medium's: how is opacity to be spread in a slab that is split?",
                           .reads_scene = true},
                          run);
}
