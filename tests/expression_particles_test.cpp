// Particles of formulas: the sampler's law against closed forms and against certified roots of the rays of a pixel.
//
// Level: 99.9 % over each family (Šidák). The counts see a common bias of the density of about 4/sqrt(points): 1 to 2 %.
#include <numeric>

#include "field/field_cells.hpp"
#include "field_scenes.hpp"
#include "sample/line_sampler.hpp"
#include "sample/particle_sampler.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

std::string expression(const std::string& text, const Box& b) {
    return fmt::format("expression = \"{}\"\nbounds = [[{:.17g}, {:.17g}, {:.17g}], [{:.17g}, {:.17g}, {:.17g}]]\n", text, b.lo.x,
                       b.lo.y, b.lo.z, b.hi.x, b.hi.y, b.hi.z);
}

const std::string kAll =  // sees everything within ±3, across every axis
    "image.resolution = [64, 64]\n[camera]\nprojection = \"orthographic\"\nposition = [7, 5, 6]\nview_height = 12\n[[surface]]\n";

struct Area {
    const char* name;
    std::string toml;
    double area;
    double projected;  // ∫ |cosθ| dA along the camera's axis; 0: not known in closed form
};

std::vector<Area> areas() {
    const double a = 1, b = 0.5;  // spheroid with semi-axes a, a, b
    const double e = std::sqrt(1 - b * b / (a * a));
    const double spheroid = 2 * M_PI * a * a * (1 + (1 - e * e) / e * std::atanh(e));
    const Box ball = cube(1.1);
    // The axis of kAll's camera in the spheroid's frame: π sqrt(Σ (b c n_x)²) is an ellipsoid's shadow.
    const Vec3 n = normalize(Vec3(7, 5, 6));
    const double shadow = M_PI * std::sqrt(std::pow(a * b * n.x, 2) + std::pow(a * b * n.y, 2) + std::pow(a * a * n.z, 2));
    return {
        {"sphere", expression("x^2+y^2+z^2-1", ball), 4 * M_PI, 2 * M_PI},
        {"sphere in tight bounds", expression("x^2+y^2+z^2-1", cube(1)), 4 * M_PI, 2 * M_PI},
        {"sphere touched", expression("(x^2+y^2+z^2-1)^2", ball), 4 * M_PI, 2 * M_PI},
        {"sphere cubed", expression("(x^2+y^2+z^2-1)^3", ball), 4 * M_PI, 2 * M_PI},
        {"sphere by a root", expression("sqrt(x^2+y^2+z^2)-1", ball), 4 * M_PI, 2 * M_PI},
        {"sphere by max", expression("max(x^2+y^2+z^2-1,-x-5,-2)", ball), 4 * M_PI, 2 * M_PI},
        {"sphere scaled down", expression("x^2+y^2+z^2-1e-60", cube(1.1e-30)) + "scale = 1e30\n", 4 * M_PI, 2 * M_PI},
        {"sphere moved", expression("(x-1000)^2+(y+2000)^2+(z-500)^2-1", {{998.9, -2001.1, 498.9}, {1001.1, -1998.9, 501.1}}) +
                             "translate = [-1000, 2000, -500]\n", 4 * M_PI, 2 * M_PI},
        {"half a sphere", expression("x^2+y^2+z^2-1", {{-1.1, -1.1, 0}, {1.1, 1.1, 1.1}}), 2 * M_PI, M_PI},
        {"sphere clipped", expression("x^2+y^2+z^2-1", ball) + "clip = [{ normal = [1, 2, 3], offset = 0 }]\n", 2 * M_PI, M_PI},
        {"torus", expression(kTorusQuartic, {{-1.5, -1.5, -0.5}, {1.5, 1.5, 0.5}}), 4 * M_PI * M_PI * 0.4, 0},
        {"spheroid by scale", expression("x^2+y^2+z^2-1", ball) + "scale = [1, 1, 0.5]\n", spheroid, 2 * shadow},
        {"spheroid mirrored", expression("x^2+y^2+z^2-1", ball) + "scale = [1, -1, 0.5]\n", spheroid, 2 * shadow},
        {"spheroid by formula", expression("x^2+y^2+4*z^2-1", ball), spheroid, 2 * shadow},
        {"three planes", expression("x*y*z", cube(1)), 12, 4 * (n.x + n.y + n.z)},
        {"plane in a face", expression("z", {{-1, -1, 0}, {1, 1, 1}}), 4, 4 * n.z},
        {"plane in the middle", expression("x", cube(1)), 4, 4 * n.x},
        {"planes that meet", expression("x^2-y^2", cube(1)), 8 * std::sqrt(2.0), 4 * ((n.x + n.y) + std::abs(n.x - n.y))},
        {"box", expression("max(abs(x),abs(y),abs(z))-0.7", cube(1)), 24 * 0.49, 4 * 1.96 * (n.x + n.y + n.z) / 2},
        {"cylinder", expression("x^2+y^2-0.25", cube(1)), 2 * M_PI, 4 * std::sqrt(n.x * n.x + n.y * n.y)},
    };
}

TEST(ExpressionParticles, LandWithTheChanceThatTheirAreaSays) {
    const auto all = areas();
    const double critical = normal_critical_value(sidak_level(0.001, 2.0 * static_cast<double>(all.size())));
    for (const Area& a : all)
        for (const bool oblique : {true, false}) {
            const double measure = oblique ? a.area : a.projected;
            if (measure == 0) continue;
            const PreparedScene scene = prepare(scene_from(kAll + a.toml + "opacity = 0.3\nopacity_law = \"" + (oblique ? "oblique" : "constant") + "\"\n"));
            const LineSampler sampler(scene.objects[0], scene.camera, 0);
            const double share = measure / (scene.camera.pixel_area(Vec3(0, 0, 1)) * sampler.virtual_pixels());
            ASSERT_LE(share, 1) << a.name;
            constexpr std::uint64_t kTrials = 40000;
            std::uint64_t landed = 0;
            for (std::uint64_t i = 0; i < kTrials; ++i) landed += sampler.trial({1}, 0, i) ? 1U : 0U;
            EXPECT_NEAR(static_cast<double>(landed) / kTrials, share, critical * std::sqrt(share * (1 - share) / kTrials))
                << a.name << (oblique ? " oblique" : " constant") << ", V " << sampler.virtual_pixels();
            // Fast mode draws as many, from shared lines: 16 repeats a group depend on one another.
            const std::vector<LineSampler> samplers(1, sampler);
            constexpr std::uint32_t kRepeats = 48;
            const ParticleSet exact = sample_particles(scene, samplers, {.seed = {1}}, 0, kRepeats);
            const ParticleSet fast = sample_particles(scene, samplers, {.seed = {2}, .lines = LineMode::fast}, 0, kRepeats);
            const double expected = kRepeats * measure / scene.camera.pixel_area(Vec3(0, 0, 1)) * -std::log1p(-0.3);
            EXPECT_NEAR(static_cast<double>(exact.count()), expected, critical * std::sqrt(expected)) << a.name;
            EXPECT_NEAR(static_cast<double>(fast.count()), expected, critical * std::sqrt(4 * expected)) << a.name;
        }
}

TEST(ExpressionParticles, UniformOnTheSphere) {
    for (const char* text : {"x^2+y^2+z^2-1", "(x^2+y^2+z^2-1)^2", "sqrt(x^2+y^2+z^2)-1", "(x^2+y^2+z^2)^5-1"}) {
        const PreparedScene scene = prepare(scene_from(kAll + expression(text, cube(1.1)) + "opacity_law = \"oblique\"\n"));
        const LineSampler sampler(scene.objects[0], scene.camera, 0);
        std::vector<std::int64_t> counts(192, 0);
        const auto bin = [](double u, std::size_t n) {
            return std::min(n - 1, static_cast<std::size_t>(std::max(0.0, u) * static_cast<double>(n)));
        };
        for (std::uint64_t i = 0; i < 120000; ++i)
            if (const auto p = sampler.trial({1}, 0, i)) {
                const Vec3 x = scene.camera.to_world(p->view);
                ASSERT_NEAR(length(x), 1, 1e-9) << text;
                ++counts[16 * bin(0.5 + 0.5 * x.z, 12) + bin(0.5 + std::atan2(x.y, x.x) / (2 * M_PI), 16)];
            }
        EXPECT_GT(std::accumulate(counts.begin(), counts.end(), std::int64_t{0}), 10000) << text;
        EXPECT_GT(chi2_uniformity(counts)->p_value, 0.001 / 4) << text;
    }
}

// ---- against rays

struct Seen {
    const char* name;
    std::string text;
    Box bounds;
    std::string place;
    double size;  // of the image at the origin
};

std::vector<Seen> seen() {
    return {
        {"sphere", "x^2+y^2+z^2-1", cube(1.1), "", 2.5},
        {"sphere touched", "(x^2+y^2+z^2-1)^2", cube(1.1), "", 2.5},
        {"torus sheared", kTorusQuartic, {{-1.5, -1.5, -0.5}, {1.5, 1.5, 0.5}},
         "matrix = [-0.7,0.3,0,0, 0,0.6,0.2,0.1, 0.1,0,0.5,0, 0,0,0,1]\n", 2},
        {"Barth", kBarthSextic, cube(1.7), "", 3},
        {"gyroid", kGyroid, cube(3.5), "scale = [0.3, 0.4, 0.25]\nrotate_degrees = [20, 30, 40]\n", 2.5},
        {"Clebsch", kClebschCubic, cube(1.3), "rotate_degrees = [20, 30, 40]\n", 2.5},
        {"three planes", "x*y*z", cube(1), "rotate_degrees = [20, 30, 40]\n", 2.5},
        {"union", "min(x^2+y^2+z^2-0.49,(x-0.6)^2+y^2+z^2-0.25,abs(z)+abs(x)-0.4)", cube(1.2), "", 2.5},
        {"domain edge", "sqrt(x)-y", cube(1), "", 2.5},
        {"clipped", "x^2+y^2+z^2-1", cube(1.1), "clip = [{ normal = [1, 2, 3], offset = 0.3 }]\n", 2.5},
    };
}

struct Watch {
    const char* name;
    std::string toml;
};

/// Σ over the crossings of a ray of 1 (constant law) or 1/|cosθ| (oblique), by certified roots.
double ray_weight(const Object& object, const RootIsolator& isolator, const Expression& f, const Ray& ray, double near, double far,
                  bool oblique) {
    const Affine& to_world = object.surface.to_world;
    const Vec3 origin = object.to_object.point(ray.origin);
    const Vec3 direction = object.to_object.vector(ray.direction);
    double lo = near, hi = far;
    for (int axis = 0; axis < 3; ++axis) {
        if (direction[axis] == 0) continue;
        const double a = ((*object.surface.bounds).lo[axis] - origin[axis]) / direction[axis];
        const double b = ((*object.surface.bounds).hi[axis] - origin[axis]) / direction[axis];
        lo = std::max(lo, std::min(a, b));
        hi = std::min(hi, std::max(a, b));
    }
    if (!(lo < hi)) return 0;
    std::vector<Root> roots;
    IsolationStats stats;
    isolator.isolate(origin, direction, lo, hi, roots, stats);
    double weight = 0;
    for (const Root& root : roots) {
        const Vec3 x = origin + root.t * direction;
        if (!object.keeps(to_world.point(x))) continue;
        Vec3 g = f.gradient_at(x);
        if (!(length(g) > 1e-5)) g = f.gradient_at(x + 1e-5 * direction);  // a double root
        const Vec3 n = to_world.normal(g);
        weight += oblique ? length(n) * length(ray.direction) / std::abs(dot(n, ray.direction)) : 1;
    }
    return weight;
}

TEST(ExpressionParticles, DensityIsThatOfTheRootsOfRays) {
    int tests = 0;
    const double families = 6.0 * static_cast<double>(seen().size());
    for (const Seen& s : seen()) {
        const std::string surface = "[[surface]]\n" + expression(s.text, s.bounds) + s.place;
        const std::vector<Watch> watches{
            {"orthographic", fmt::format("projection = \"orthographic\"\nposition = [1.2, 1.5, 2.0]\nview_height = {}\n", s.size)},
            {"perspective", "position = [1.2, 1.5, 2.0]\nfov_degrees = 50\n"},
            {"from inside", "position = [0.12, 0.07, 0.2]\ntarget = [1, 0.4, 0.1]\nfov_degrees = 90\n"}};
        for (const Watch& watch : watches)
            for (const bool oblique : {false, true}) {
                const PreparedScene scene = prepare(scene_from("image.resolution = [8, 8]\n[camera]\n" + watch.toml + surface +
                                                               "opacity_law = \"" + (oblique ? "oblique" : "constant") + "\"\n"));
                const Camera& camera = scene.camera;
                const Expression f(s.text);
                const RootIsolator isolator(f);
                const LineSampler sampler(scene.objects[0], camera, 0);
                constexpr std::uint64_t kTrials = 60000;
                std::vector<double> counts(64, 0);
                for (std::uint64_t i = 0; i < kTrials; ++i)
                    if (const auto p = sampler.trial({2}, 0, i)) {
                        const Vec2 at = camera.project(p->view);
                        ++counts[std::min<std::size_t>(7, static_cast<std::size_t>(at.x)) +
                                 8 * std::min<std::size_t>(7, static_cast<std::size_t>(at.y))];
                    }
                std::mt19937_64 random(3);
                std::uniform_real_distribution<double> unit(0, 1);
                double statistic = 0;
                int bins = 0;
                for (int pixel = 0; pixel < 64; ++pixel) {
                    constexpr int kSide = 24;
                    MeanVariance crossings;
                    for (int sub = 0; sub < kSide * kSide; ++sub)
                        crossings.add(ray_weight(scene.objects[0], isolator, f,
                                                 camera.ray(pixel % 8 + (sub % kSide + unit(random)) / kSide,
                                                            pixel / 8 + (sub / kSide + unit(random)) / kSide),
                                                 camera.near(), camera.far(), oblique));
                    if (crossings.mean() == 0) continue;
                    const double expected = static_cast<double>(kTrials) * crossings.mean() / sampler.virtual_pixels();
                    if (expected < 20) continue;
                    // The stratified estimate is better than its plain error; take half of that as its own.
                    const double own = 0.5 * expected * crossings.standard_error() / crossings.mean();
                    const double off = counts[static_cast<std::size_t>(pixel)] - expected;
                    statistic += off * off / (expected + own * own);
                    ++bins;
                }
                ASSERT_GT(bins, 8) << s.name << ' ' << watch.name;
                EXPECT_GT(chi2_survival(statistic, bins), sidak_level(0.001, families))
                    << s.name << ' ' << watch.name << (oblique ? " oblique" : " constant") << ": " << statistic << " of " << bins;
                ++tests;
            }
    }
    EXPECT_EQ(tests, static_cast<int>(families));
}

// ---- end to end

TEST(ExpressionParticles, ImagesFollowTheTruthAndWrongOpacityDoesNot) {
    struct Case {
        const char* name;
        std::string toml;
    };
    const std::string head = "image.resolution = [24, 20]\n[camera]\nposition = [0.9, 1.4, 3.5]\nfov_degrees = 45\n[[surface]]\n";
    const std::vector<Case> cases{
        {"Barth", head + expression(kBarthSextic, cube(1.7)) + "opacity = 0.3\n"},
        {"oblique torus", head + expression(kTorusQuartic, {{-1.5, -1.5, -0.5}, {1.5, 1.5, 0.5}}) + "opacity = 0.2\nopacity_law = \"oblique\"\n"},
        {"planes", head + expression("x*y*z", cube(1)) + "opacity = 0.4\n"},
        {"gyroid clipped", head + expression(kGyroid, cube(3.5)) + "scale = 0.4\nopacity = 0.3\nclip = [{ normal = [1, 1, 0], offset = 0.2 }]\n"},
        {"sphere touched", head + expression("(x^2+y^2+z^2-1)^2", cube(1.1)) + "opacity = 0.5\n"},
    };
    const double level = sidak_level(0.001, 4.0 * static_cast<double>(cases.size()));
    for (const Case& c : cases)
        for (const LineMode mode : {LineMode::exact, LineMode::fast}) {
            const PreparedScene scene = prepare(scene_from(c.toml));
            RenderStats stats;
            constexpr std::uint32_t kRepeats = 160;
            const Image drawn = render_particles(scene, {.repeats = kRepeats, .sampler = {.seed = {7}, .lines = mode}}, stats);
            TruthStats truth_stats;
            const Image truth = trace_truth(
                scene, {.filter = PixelFilter::particle, .seed = {3}, .max_error = 0.003, .max_samples = 1024}, truth_stats);
            const OpacityVerdict verdict = judge_opacity(drawn, truth, kRepeats);
            ASSERT_GT(verdict.pixels, 60U) << c.name;
            if (mode == LineMode::exact) {  // fast mode's repeats depend on one another
                EXPECT_GT(verdict.ks_p, level) << c.name;
                EXPECT_LT(verdict.worst_z, normal_critical_value(sidak_level(level, static_cast<double>(verdict.pixels)))) << c.name;
            }
            EXPECT_LT(std::abs(verdict.total_z), (mode == LineMode::exact ? 1 : 2) * normal_critical_value(level)) << c.name;
            if (mode == LineMode::exact && &c == &cases[0]) {
                std::string wrong = c.toml;
                wrong.replace(wrong.find("opacity = 0.3"), 13, "opacity = 0.29");
                const Image off = render_particles(prepare(scene_from(wrong)), {.repeats = kRepeats, .sampler = {.seed = {7}}}, stats);
                EXPECT_GT(std::abs(judge_opacity(off, truth, kRepeats).total_z), normal_critical_value(level));
            }
        }
}

}  // namespace
}  // namespace pellucid
