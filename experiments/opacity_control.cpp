// Which opacity does sampling achieve that stops by counting spheres (Tanaka et al. 2012, section 4), and which the exact way?
// configs/opacity_control.toml -> results/opacity_control/ -> analysis/opacity_control.py
#include <cmath>
#include <numbers>

#include "harness/experiment.hpp"
#include "measure/statistics.hpp"
#include "sample/counting_spheres.hpp"
#include "scene/prepared_scene.hpp"
#include "scene/scene_file.hpp"

namespace {

using namespace pellucid;
using std::numbers::pi;

struct Settings {
    std::vector<double> opacities, curvatures, edges, gaps;
    std::int64_t spheres, runs;
    double family_level;
};

Settings read_settings(const ConfigTable& config) {
    Settings s{
        .opacities = config.numbers("opacities", kRequired, strictly_within(0, 1)),
        .curvatures = config.numbers("curvatures", kRequired, within(0, 2)),
        .edges = config.numbers("edges", kRequired, within(0, 2)),
        .gaps = config.numbers("gaps", kRequired, {.lo = 0, .hi = 2, .lo_open = true}),
        .spheres = config.integer("spheres", kRequired, {.lo = 1, .hi = 100000}),
        .runs = config.integer("runs", kRequired, {.lo = 1, .hi = 1000}),
        .family_level = config.number("family_level", kRequired, strictly_within(0, 1)),
    };
    (void)config.integer("seed", 1, {.lo = 0});
    return s;
}

/// A surface, where on it the spheres are, and which area a/πr² one of them holds.
struct Case {
    std::string name;
    double value;  // (κ1 − κ2)²r², distance to the edge over r, distance of the sheets over r
    std::string body;
    double radius;
    double area_ratio;
    Vec3 (*center)(double turn, double value, double radius);
};

/// Share of a disc on this side of a line at `distance` radii from its middle.
double share_inside(double distance) {
    if (distance >= 1) return 1;
    return 1 - (std::acos(distance) - distance * std::sqrt(1 - distance * distance)) / pi;
}
/// a/πr² on a cylinder of radius 1: points at most r away, ∫ 2√(r² − 4 sin²(φ/2)) dφ over πr².
double cylinder_ratio(double r) {
    constexpr int kPanels = 200000;
    const double most = r < 2 ? 2 * std::asin(r / 2) : pi;
    double sum = 0;
    for (int i = 0; i < kPanels; ++i) {
        const double chord = 2 * std::sin(most * (i + 0.5) / kPanels / 2);
        sum += 4 * std::sqrt(std::max(0.0, r * r - chord * chord)) * most / kPanels;
    }
    return sum / (pi * r * r);
}

/// Sum over the others of the share that a sphere has in common with each, one for itself: at most 1 − d/2r a pair.
double mean_overlap(const CountingSpheres& spheres) {
    double sum = 0;
    for (const Vec3& a : spheres.centers)
        for (const Vec3& b : spheres.centers) sum += std::max(0.0, 1 - length(a - b) / (2 * spheres.radius));
    return sum / static_cast<double>(spheres.centers.size());
}

std::vector<Case> cases_of(const Settings& s) {
    std::vector<Case> cases;
    for (const double x : s.curvatures) {  // κ1 = 1, κ2 = 0
        const double r = std::sqrt(x);
        if (x > 0)
            cases.push_back({"curvature", x, "implicit = \"cylinder\"\nparameters = { height = 8.0 }", r, cylinder_ratio(r),
                             [](double turn, double, double) { return Vec3(std::cos(2 * pi * turn), std::sin(2 * pi * turn), 2 * turn - 1); }});
    }
    for (const double d : s.edges)
        cases.push_back({"edge", d, "rectangle = { u = [1, 0, 0], v = [0, 1, 0] }", 0.2, share_inside(d),
                         [](double turn, double distance, double r) { return Vec3(1 - distance * r, turn - 0.5, 0); }});
    for (const double gap : s.gaps)
        cases.push_back({"second sheet", gap, fmt::format("expression = \"z^2-{:.17g}\"\nbounds = [[-1, -1, -1], [1, 1, 1]]", 0.01 * gap * gap),
                         0.2, 1 + std::max(0.0, 1 - gap * gap),
                         [](double turn, double value, double r) { return Vec3(0.5 * std::cos(2 * pi * turn), 0.5 * std::sin(2 * pi * turn), 0.5 * value * r); }});
    return cases;
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(
        argc, argv, {"opacity_control", "Which opacity do counting spheres achieve, and which the exact way?"}, [](Experiment& ex) {
            constexpr double kPixelArea = 1e-4;  // a thousandth of a great circle, but for the smallest
            const Settings s = ex.config(read_settings);
            CsvWriter& csv = ex.csv("opacity_control", {"case", "value", "run", "radius", "alpha_wished", "alpha_exact", "alpha_counted",
                                                        "alpha_counted_theory", "area_ratio", "area_ratio_theory", "particles", "z_score"});
            const std::vector<Case> cases = cases_of(s);
            auto progress = ex.progress("surfaces", cases.size());
            const double tests = static_cast<double>(cases.size() * s.opacities.size()) * static_cast<double>(s.runs);
            double worst = 0;
            double worst_bias = 0;
            std::uint64_t row = 0;
            for (const Case& c : cases) {
                const Config scene_text = Config::parse("image.resolution = [16, 16]\n[camera]\nposition = [0, 0, 9]\n[[surface]]\n" + c.body, c.name, ".");
                const Scene scene = scene_from_config(scene_text);
                const PreparedScene prepared = prepare(scene);
                const UniformPoints places(prepared.objects[0], 0);
                CountingSpheres spheres{.spheres = static_cast<std::uint32_t>(s.spheres), .radius = c.radius};
                for (std::int64_t i = 0; i < s.spheres; ++i)
                    spheres.centers.push_back(c.center((static_cast<double>(i) + 0.5) / static_cast<double>(s.spheres), c.value, c.radius));
                const double overlap = mean_overlap(spheres);
                for (const double alpha : s.opacities)
                    for (std::int64_t run = 0; run < s.runs; ++run) {
                        const OpacityControl o = control_by_counting(places, alpha, kPixelArea, spheres, 1, derived_seed(ex.seed(), row++));
                        // (1) on the great circle asks for n; the density is n/a.
                        const double n = std::log1p(-alpha) / std::log1p(-kPixelArea / (pi * c.radius * c.radius));
                        const double theory = -std::expm1(-n / (c.area_ratio * pi * c.radius * c.radius) * kPixelArea);
                        // Counted particles are Poisson; where spheres overlap one counts in several.
                        const double relative = std::hypot(std::sqrt(overlap / (n * static_cast<double>(s.spheres))), places.area_error() / places.area());
                        const double z = (c.area_ratio / o.mean_area_ratio - 1) / relative;
                        worst = std::max(worst, std::abs(z));
                        worst_bias = std::max(worst_bias, std::abs(o.counted_opacity - alpha));
                        csv.row(c.name, c.value, run, c.radius, alpha, o.exact_opacity, o.counted_opacity, theory, o.mean_area_ratio,
                                c.area_ratio, o.particles, z);
                    }
                progress->step();
            }
            ex.check("worst z of counted particles against the area in the spheres", worst, "<=", sidak_critical_value(s.family_level, tests));
            ex.check("largest bias of counting spheres, opacity (they are biased)", worst_bias, ">=", 0.05);
        });
}
