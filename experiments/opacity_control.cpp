// Which opacity comes of a wished one when particles are counted in spheres, and when their number is known?
// configs/opacity_control.toml -> results/opacity_control/ -> analysis/opacity_control.py
#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/error.hpp"
#include "harness/experiment.hpp"
#include "measure/statistics.hpp"
#include "render/particles.hpp"
#include "sample/counting_spheres.hpp"
#include "sample/view_thinning.hpp"
#include "scene/scene_file.hpp"
#include "study/sphere_counts.hpp"
#include "study/uniformity.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::vector<double> wished;
    std::vector<std::string> surfaces;
    std::uint32_t seeds;
    double pixel, radius;
    std::size_t points, spheres;
    std::vector<double> curvature, edge, sheet;
    std::vector<std::string> drawn;
    std::uint32_t repeats;
};

Settings read_settings(const ConfigTable& t) {
    const auto size = [&](const char* key) { return static_cast<std::size_t>(t.integer(key, kRequired, {1, 1 << 30})); };
    return {t.numbers("wished", kRequired, strictly_within(0, 1)),
            t.texts("surfaces", kRequired),
            static_cast<std::uint32_t>(t.integer("seeds", kRequired, {2, 1 << 20})),
            t.number("pixel", kRequired, above(0)),
            t.number("radius", kRequired, above(0)),
            size("points"),
            size("spheres"),
            t.numbers("curvature", kRequired, above(0)),
            t.numbers("edge", kRequired, at_least(0)),
            t.numbers("sheet", kRequired, above(0)),
            t.texts("drawn", kRequired),
            static_cast<std::uint32_t>(t.integer("repeats", kRequired, {1, kMostRepeats}))};
}

/// Keys of a [[surface]] of width 2.
std::string body_of(const std::string& name) {
    if (name == "ellipsoid") return "implicit = \"ellipsoid\"\nparameters = { a = 1.0, b = 0.6, c = 0.35 }";
    if (name == "torus") return "implicit = \"torus\"\nparameters = { major = 0.75, minor = 0.25 }";
    if (name == "open_cylinder") return "implicit = \"cylinder\"\nparameters = { radius = 1.0, height = 0.5 }";
    if (name == "two_sheets") return "expression = \"z*(z - 0.03)\"\nbounds = [[-1, -1, -0.1], [1, 1, 0.1]]";
    return "implicit = \"" + name + "\"";
}

// ---- Wished, predicted and drawn

/// A surface that the image shows so often everywhere but at its rim, without light.
struct Drawn {
    std::string body;
    int sheets;
    double view_height, rim;  // rim: of the disc of pixels that are judged, from the middle of the image; 0: all of them
};

Drawn drawn_of(const std::string& name) {
    if (name == "flat patch") return {"rectangle = { u = [1, 0, 0], v = [0, 1, 0] }", 1, 1.5, 0};
    if (name == "sphere") return {"implicit = \"sphere\"", 2, 2.2, 0.93};
    if (name == "two_sheets") return {body_of(name), 2, 1.5, 0};
    throw input_error("drawn: no surface \"{}\", expected flat patch, sphere, two_sheets", name);
}

PreparedScene drawn_scene(const Drawn& d, double opacity) {
    constexpr int kSide = 64;
    const Config config = Config::parse(
        fmt::format("image.resolution = [{0}, {0}]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 5]\nview_height = {1}\n"
                    "[[surface]]\nshading = \"flat\"\nopacity = {2:.17g}\n{3}\n",
                    kSide, d.view_height, opacity, d.body),
        "drawn");
    Scene scene = scene_from_config(config);
    config.finish();
    return prepare(std::move(scene));
}

/// Hits of the judged pixels in an image of particles, and how many there could be: independent of each other, for particles are
/// a Poisson process.
struct Hits {
    double hits = 0, trials = 0;
    /// p that a pixel's opacity is this one.
    [[nodiscard]] double p_of(double opacity) const { return binomial_two_sided_p(hits, {trials, opacity}); }
};

Hits draw(const PreparedScene& scene, const Drawn& d, const ParticleSettings& settings) {
    RenderStats stats;
    const EnsembleSums sums = draw_particles(scene, settings, stats);
    const int width = scene.camera.width();
    Hits result;
    for (int y = 0; y < scene.camera.height(); ++y)
        for (int x = 0; x < width; ++x) {
            const double pixel = d.view_height / scene.camera.height();
            const double from_middle = pixel * std::hypot(x + 0.5 - 0.5 * width, y + 0.5 - 0.5 * scene.camera.height());
            if (d.rim > 0 && from_middle > d.rim) continue;
            result.hits += sums.pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)].covered;
            result.trials += static_cast<double>(sums.repeats);
        }
    return result;
}

/// Opacity of the image with the number of particles that each way gives: the exact one against the wished opacity, counting
/// spheres against what they say was achieved; and against the wished one, which they miss where their great circles are wrong.
void draw_both(Experiment& ex, const Settings& s, Progress& progress) {
    CsvWriter& csv = ex.csv("drawn", {"surface", "way", "wished", "predicted", "drawn", "error", "p", "p_of_wished"});
    const double level = sidak_level(0.001, 2.0 * static_cast<double>(s.drawn.size() * s.wished.size()));
    for (const std::string& name : s.drawn) {
        const Drawn d = drawn_of(name);
        double twin = 1;
        for (const double wished : s.wished) {
            const PreparedScene scene = drawn_scene(d, wished);
            const Object& object = scene.objects[0];
            ParticleSettings settings{.repeats = s.repeats, .sampler = {.seed = derived_seed(ex.seed(), 300)}};
            const auto of_sheets = [&](double opacity) { return -std::expm1(d.sheets * std::log1p(-opacity)); };
            const auto judge = [&](const char* way, double predicted) {
                const Hits hits = draw(scene, d, settings);
                const double share = hits.hits / hits.trials;
                const double p = hits.p_of(of_sheets(predicted));
                const double p_of_wished = hits.p_of(of_sheets(wished));
                csv.row(name, way, wished, of_sheets(predicted), share, std::sqrt(share * (1 - share) / hits.trials), p, p_of_wished);
                ex.check(fmt::format("{} of {} drawn, {}: p", name, wished, way), p, ">=", level);
                return p_of_wished;
            };
            judge("exact", wished);
            settings.source.counting_spheres = true;
            settings.source.counting.radius = 2 * s.radius;
            settings.source.seed = derived_seed(ex.seed(), 301);
            const UniformPoints places(object, 0);
            const auto pixel = ViewThinning(object, scene.camera).least_pixel_area();
            if (!pixel) throw run_error("opacity_control: {} is not in view", name);
            const OpacityControl control =
                control_by_counting(places, wished, *pixel, settings.source.counting, length(object.geometry->bounds().size()),
                                    derived_seed(settings.source.seed, 0));
            twin = std::min(twin, judge("counting spheres", control.counted_opacity));
        }
        // With a second sheet in its spheres the count is far off: to take it for the exact one must fail.
        if (name == "two_sheets") ex.check("wrong twin: counting spheres beside a second sheet taken for exact: least p", twin, "<", level);
        progress.step();
    }
}

/// Wished against counted opacity, spheres at random places as in the paper.
void control(Experiment& ex, const Settings& s, Progress& progress) {
    CsvWriter& csv = ex.csv("control", {"surface", "wished", "counted", "counted_error", "area_ratio", "particles"});
    for (const std::string& name : s.surfaces) {
        const PreparedScene scene = prepare(uniformity_scene(body_of(name)));
        const UniformPoints points(scene.objects[0], 0);
        const double size = length(scene.objects[0].geometry->bounds().size());
        const CountingSpheres spheres{.radius = 2 * s.radius};
        for (const double wished : s.wished) {
            MeanVariance counted, ratio, particles;
            for (std::uint32_t k = 0; k < s.seeds; ++k) {
                const OpacityControl c =
                    control_by_counting(points, wished, 4 * s.pixel * s.pixel, spheres, size, derived_seed(ex.seed(), 100 + k));
                counted.add(c.counted_opacity);
                ratio.add(c.mean_area_ratio);
                particles.add(static_cast<double>(c.particles));
            }
            csv.row(name, wished, counted.mean(), counted.standard_error(), ratio.mean(), particles.mean());
        }
        progress.step();
    }
}

/// What a sphere counts beside what its great circle holds, where geometry says what that must be.
class Bias {
public:
    Bias(Experiment& ex, const Settings& s)
        : ex_(ex), s_(s), csv_(ex.csv("bias", {"case", "x", "ratio", "ratio_error", "exact", "series", "z", "opacity_of_half"})) {
        level_ = sidak_level(0.001, static_cast<double>(s.curvature.size() + s.edge.size() + s.sheet.size()));
    }

    /// Spheres of radius r around `centers`; `exact`: the area inside over πr².
    void row(const std::string& name, double x, const UniformPoints& surface, const std::vector<Vec3>& centers, double r,
             double exact, double series) {
        const MeanVariance counts = counts_in_spheres(surface, s_.points, centers, r, derived_seed(ex_.seed(), 200 + ++rows_));
        const double unit = surface.area() / static_cast<double>(s_.points) / (std::numbers::pi * r * r);
        const double ratio = unit * counts.mean();
        const double error = ratio * std::hypot(1 / std::sqrt(independent_points(surface, s_.points, centers, r)),
                                                surface.area_error() / surface.area());
        const double z = (ratio - exact) / error;
        // Density is what it should be over the ratio: (1) for S >> s.
        csv_.row(name, x, ratio, error, exact, series, z, 1 - std::pow(0.5, 1 / ratio));
        ex_.check(fmt::format("{} {}: area inside beside geometry: p", name, x), normal_two_sided_p(z), ">=", level_);
    }

private:
    Experiment& ex_;
    const Settings& s_;
    CsvWriter& csv_;
    double level_ = 0;
    std::uint64_t rows_ = 0;
};

void curvature(Bias& bias, const Settings& s) {
    // κ1 − κ2 = 1 on a cylinder of radius 1, far from its ends.
    const PreparedScene scene = prepare(uniformity_scene("implicit = \"cylinder\"\nparameters = { radius = 1.0, height = 8.0 }"));
    const UniformPoints surface(scene.objects[0], 0);
    std::vector<Vec3> centers;
    for (std::size_t i = 0; i < s.spheres; ++i) {
        const double angle = 2 * std::numbers::pi * (static_cast<double>(i) * 0.61803398875);
        centers.emplace_back(std::cos(angle), std::sin(angle), 4 * ((static_cast<double>(i) + 0.5) / static_cast<double>(s.spheres) - 0.5));
    }
    for (const double x : s.curvature) {
        const double r = std::sqrt(x);
        bias.row("curvature", x, surface, centers, r, cylinder_in_sphere(r) / (std::numbers::pi * r * r), 1 + x / 32);
    }
}

void edges(Bias& bias, const Settings& s) {
    const PreparedScene scene = prepare(uniformity_scene("rectangle = { u = [1, 0, 0], v = [0, 1, 0] }"));
    const UniformPoints surface(scene.objects[0], 0);
    const double r = 0.1;
    for (const double d : s.edge) {
        std::vector<Vec3> centers;
        for (std::size_t i = 0; i < s.spheres; ++i)
            centers.emplace_back(1 - d * r, 1.6 * ((static_cast<double>(i) + 0.5) / static_cast<double>(s.spheres) - 0.5), 0);
        // A circle less the segment beyond the edge.
        const double cut = d >= 1 ? 0 : (std::acos(d) - d * std::sqrt(1 - d * d)) / std::numbers::pi;
        bias.row("edge", d, surface, centers, r, 1 - cut, 1);
    }
}

void sheets(Bias& bias, const Settings& s) {
    const double r = 0.1;
    for (const double d : s.sheet) {
        const PreparedScene scene =
            prepare(uniformity_scene(fmt::format("expression = \"z*(z - {:.17g})\"\nbounds = [[-1, -1, -0.3], [1, 1, 0.3]]", d * r)));
        const UniformPoints surface(scene.objects[0], 0);
        std::vector<Vec3> centers;
        for (std::size_t i = 0; i < s.spheres; ++i) {
            const double k = static_cast<double>(i) + 0.5;
            centers.emplace_back(1.6 * (k / static_cast<double>(s.spheres) - 0.5), 1.6 * (std::fmod(k * 0.61803398875, 1) - 0.5), 0);
        }
        bias.row("second sheet", d, surface, centers, r, 1 + std::max(0.0, 1 - d * d), 1);
    }
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    auto progress = ex.progress("surfaces", s.surfaces.size() + s.drawn.size() + 3);
    control(ex, s, *progress);
    draw_both(ex, s, *progress);
    Bias bias(ex, s);
    curvature(bias, s);
    progress->step();
    edges(bias, s);
    progress->step();
    sheets(bias, s);
    progress->step();
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv,
                          {.name = "opacity_control",
                           .question = "Which opacity comes of a wished one by counting spheres, and by an exact count?"},
                          run);
}
