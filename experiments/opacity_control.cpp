// Which opacity comes of a wished one when particles are counted in spheres, and when their number is known?
// configs/opacity_control.toml -> results/opacity_control/ -> analysis/opacity_control.py
#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/error.hpp"
#include "harness/experiment.hpp"
#include "measure/statistics.hpp"
#include "sample/counting_spheres.hpp"
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
            t.numbers("sheet", kRequired, above(0))};
}

/// Keys of a [[surface]] of width 2.
std::string body_of(const std::string& name) {
    if (name == "ellipsoid") return "implicit = \"ellipsoid\"\nparameters = { a = 1.0, b = 0.6, c = 0.35 }";
    if (name == "torus") return "implicit = \"torus\"\nparameters = { major = 0.75, minor = 0.25 }";
    if (name == "open_cylinder") return "implicit = \"cylinder\"\nparameters = { radius = 1.0, height = 0.5 }";
    if (name == "two_sheets") return "expression = \"z*(z - 0.03)\"\nbounds = [[-1, -1, -0.1], [1, 1, 0.1]]";
    return "implicit = \"" + name + "\"";
}

/// Wished against achieved opacity, spheres at random places as in the paper.
void control(Experiment& ex, const Settings& s, Progress& progress) {
    CsvWriter& csv = ex.csv("control", {"surface", "wished", "exact", "counted", "counted_error", "area_ratio", "particles"});
    double worst = 0;
    for (const std::string& name : s.surfaces) {
        const PreparedScene scene = prepare(uniformity_scene(body_of(name)));
        const UniformPoints points(scene.objects[0], 0);
        const double size = length(scene.objects[0].geometry->bounds().size());
        const CountingSpheres spheres{.radius = 2 * s.radius};
        for (const double wished : s.wished) {
            MeanVariance counted, ratio, exact, particles;
            for (std::uint32_t k = 0; k < s.seeds; ++k) {
                const OpacityControl c =
                    control_by_counting(points, wished, 4 * s.pixel * s.pixel, spheres, size, derived_seed(ex.seed(), 100 + k));
                counted.add(c.counted_opacity);
                ratio.add(c.mean_area_ratio);
                exact.add(c.exact_opacity);
                particles.add(static_cast<double>(c.particles));
            }
            csv.row(name, wished, exact.mean(), counted.mean(), counted.standard_error(), ratio.mean(), particles.mean());
            worst = std::max(worst, std::abs(exact.mean() - wished));
        }
        progress.step();
    }
    ex.check("exact way: largest |achieved - wished| opacity", worst, "<=", 1e-9);
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
    auto progress = ex.progress("surfaces", s.surfaces.size() + 3);
    control(ex, s, *progress);
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
