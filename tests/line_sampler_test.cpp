// Particles by random lines: uniform in area, independent, and with the density that PBSR (1) needs.
#include "sample/line_sampler.hpp"

#include <numeric>
#include <set>

#include "core/error.hpp"
#include "kernel/normal_twin.h"
#include "sample/pack_points.hpp"
#include "sample/particle_sampler.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

const std::string kAll =  // sees everything within ±3, across every axis
    "image.resolution = [64, 64]\n[camera]\nprojection = \"orthographic\"\nposition = [7, 5, 6]\nview_height = 12\n[[surface]]\nopacity_law = \"oblique\"\n";

/// World positions of `trials` trials that gave a point.
std::vector<Vec3> points(const PreparedScene& scene, std::uint64_t trials) {
    const LineSampler sampler(scene.objects[0], scene.camera, 0);
    std::vector<Vec3> found;
    for (std::uint64_t i = 0; i < trials; ++i)
        if (const auto p = sampler.trial({1}, 0, i)) found.push_back(scene.camera.to_world(p->view));
    return found;
}

/// χ² of equal cells. With n points in k cells a bias of 4·sqrt(k)^(1/2)/sqrt(n/k) of one cell is seen: 5 to
/// 10 % of one cell, or 2 % of all, here.
void expect_uniform(const std::vector<Vec3>& found, std::size_t cells,
                    const std::function<std::size_t(const Vec3&)>& cell) {
    ASSERT_GT(found.size(), 20 * cells);
    std::vector<std::int64_t> counts(cells, 0);
    for (const Vec3& p : found) ++counts.at(cell(p));
    EXPECT_GT(chi2_uniformity(counts)->p_value, 1e-4);
}

std::size_t bin(double u, std::size_t n) {
    return std::min(n - 1, static_cast<std::size_t>(std::max(0.0, u) * static_cast<double>(n)));
}
double turn(double y, double x) { return 0.5 + std::atan2(y, x) / (2 * M_PI); }

TEST(LineSampler, UniformOnTheSphere) {
    const auto found = points(prepare(scene_from(kAll + "implicit = \"sphere\"")), 400000);
    expect_uniform(found, 48,
                   [](const Vec3& p) { return 8 * bin(0.5 + 0.5 * p.z, 6) + bin(turn(p.y, p.x), 8); });
    for (const Vec3& p : found) ASSERT_NEAR(length(p), 1, 1e-9);
}

TEST(LineSampler, UniformOnTheTorus) {
    const auto found = points(prepare(scene_from(kAll + "implicit = \"torus\"")), 800000);
    expect_uniform(found, 48, [](const Vec3& p) {
        const double tube = turn(p.z, std::hypot(p.x, p.y) - 1) * 2 * M_PI - M_PI;  // around the tube
        return 6 * bin(0.5 + (tube + 0.4 * std::sin(tube)) / (2 * M_PI), 8) +
               bin(turn(p.y, p.x), 6);  // ∫ (R + r cos)
    });
}

TEST(LineSampler, UniformOnARectangleAndAMesh) {
    const auto flat =
        points(prepare(scene_from(kAll + "rectangle = { u = [2, 0, 1], v = [0, 1, 0] }")), 100000);
    EXPECT_EQ(flat.size(), 100000U);  // a flat piece never wastes a line
    expect_uniform(flat, 49, [](const Vec3& p) { return 7 * bin(0.5 + p.x / 4, 7) + bin(0.5 + p.y / 2, 7); });

    // One triangle a hundred times larger than the other, both within z = 0: uniform over their union.
    const fs::path folder = test_folder();
    put(folder / "m.obj", "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 0.02 0\nv 2 2.02 0\nv 0 2 0\nf 1 2 3\nf 6 1 3\n");
    const auto mesh = points(prepare(scene_from(kAll + "mesh = \"m.obj\"", folder)), 100000);
    expect_uniform(mesh, 64, [](const Vec3& p) { return 8 * bin(p.x / 2, 8) + bin(p.y / 2, 8); });
}

TEST(LineSampler, UniformOnAnIsosurface) {
    const fs::path folder = test_folder();
    // A linear ramp has a plane, cells of it cut at slanting angles.
    put_volume(folder / "v.nrrd", {6, 6, 6},
               sampled({6, 6, 6}, [](const Vec3& p) { return p.z + 0.3 * p.x - 0.2 * p.y; }), Vec3(0.5));
    const auto ramp = points(
        prepare(scene_from(kAll + "isosurface = { volume = \"v.nrrd\", isovalue = 2.3 }", folder)), 600000);
    expect_uniform(ramp, 49, [](const Vec3& p) { return 7 * bin(p.x / 2.5, 7) + bin(p.y / 2.5, 7); });

    // A curved one, against ∫ δ(f − c)|∇f| dV on a fine grid, octant by octant.
    const auto f = [](const Vec3& p) {
        return p.x * p.y + 0.7 * p.y * p.z + 0.4 * p.z - p.x;
    };  // trilinear itself
    put_volume(folder / "w.nrrd", {2, 2, 2}, sampled({2, 2, 2}, f));
    const auto curved = points(
        prepare(scene_from(kAll + "isosurface = { volume = \"w.nrrd\", isovalue = 0.2 }", folder)), 300000);
    constexpr int kGrid = 160;
    constexpr double kHalf = 0.02;
    std::vector<double> area(8, 0);
    const auto octant = [](const Vec3& p) { return bin(p.x, 2) + 2 * bin(p.y, 2) + 4 * bin(p.z, 2); };
    for (int k = 0; k < kGrid; ++k)
        for (int j = 0; j < kGrid; ++j)
            for (int i = 0; i < kGrid; ++i) {
                const Vec3 p = (Vec3(i, j, k) + 0.5) / static_cast<double>(kGrid);
                if (std::abs(f(p) - 0.2) < kHalf)
                    area[octant(p)] += length(Vec3(p.y - 1, p.x + 0.7 * p.z, 0.7 * p.y + 0.4)) / (2 * kHalf);
            }
    const double sum = std::accumulate(area.begin(), area.end(), 0.0);
    std::vector<std::int64_t> counts(8, 0);
    for (const Vec3& p : curved) {
        ++counts[octant(p)];
        ASSERT_NEAR(f(p), 0.2, 1e-6);
    }
    for (std::size_t i = 0; i < 8; ++i) {
        const double share = area[i] / sum;
        const auto n = static_cast<double>(curved.size());
        // 4 sigmas of the count and 0.2 % of the whole for the grid.
        EXPECT_NEAR(static_cast<double>(counts[i]) / n, share, 4 * std::sqrt(share * (1 - share) / n) + 0.002)
            << i;
    }
}

// Landing chance of every pixel, against the crossings of many rays of that pixel: Σ 1/|cosθ| (oblique)
// or their number (constant), over V.
TEST(LineSampler, DensityIsOneOverVForEverySurfaceLawAndProjection) {
    int tests = 0;
    for (const char* shape : {"sphere", "ellipsoid", "torus", "plane", "cylinder", "cone", "paraboloid",
                              "saddle", "hyperboloid", "hyperboloid_two_sheets"})
        for (const bool perspective : {false, true})
            for (const bool oblique : {false, true}) {
                const PreparedScene scene = prepare(scene_from(fmt::format(
                    "image.resolution = [10, 10]\n[camera]\nprojection = \"{}\"\nposition = [1.2, 1.5, 2.0]\n{}\n[[surface]]\nimplicit = \"{}\"\n"
                    "opacity_law = \"{}\"\nrotate_degrees = [20, 30, 40]\n",
                    perspective ? "perspective" : "orthographic",
                    perspective ? "fov_degrees = 50" : "view_height = 2.5", shape,
                    oblique ? "oblique" : "constant")));
                const Camera& camera = scene.camera;
                constexpr std::uint64_t kTrials = 200000;
                const LineSampler sampler(scene.objects[0], camera, 0);
                std::vector<double> counts(100, 0);
                for (std::uint64_t i = 0; i < kTrials; ++i)
                    if (const auto p = sampler.trial({2}, 0, i)) {
                        const Vec2 at = camera.project(p->view);
                        ++counts[static_cast<std::size_t>(at.x) + 10 * static_cast<std::size_t>(at.y)];
                    }
                std::mt19937_64 random(3);
                std::uniform_real_distribution<double> unit(0, 1);
                double statistic = 0;
                int bins = 0;
                for (int pixel = 0; pixel < 100; ++pixel) {
                    constexpr int kSide = 64;  // the weights 1/|cosθ| have heavy tails
                    MeanVariance crossings;
                    for (int sub = 0; sub < kSide * kSide; ++sub) {
                        const Ray ray = camera.ray(pixel % 10 + (sub % kSide + unit(random)) / kSide,
                                                   pixel / 10 + (sub / kSide + unit(random)) / kSide);
                        CrossingList hits;
                        const int found = scene.objects[0].geometry->crossings(
                            0, {ray.origin, ray.direction, camera.near(), camera.far()}, hits);
                        double weight = 0;
                        for (std::size_t k = 0; k < static_cast<std::size_t>(found); ++k)
                            weight += oblique ? length(hits[k].normal) * length(ray.direction) /
                                                    std::abs(dot(hits[k].normal, ray.direction))
                                              : 1;
                        crossings.add(weight);
                    }
                    const double expected =
                        static_cast<double>(kTrials) * crossings.mean() / sampler.virtual_pixels();
                    if (expected < 20) continue;
                    // The stratified estimate is better than its plain error; take half of that as its own.
                    const double own = 0.5 * expected * crossings.standard_error() / crossings.mean();
                    const double off = counts[static_cast<std::size_t>(pixel)] - expected;
                    statistic += off * off / (expected + own * own);
                    ++bins;
                }
                ASSERT_GT(bins, 10) << shape;
                const double p = chi2_survival(statistic, bins);
                ++tests;
                EXPECT_GT(p, sidak_level(0.001, 40))
                    << shape << (perspective ? " perspective" : " orthographic")
                    << (oblique ? " oblique" : " constant");
            }
    EXPECT_EQ(tests, 40);
}

// Closed forms of the sampler against the root finder that rays use: the same surface.
TEST(LineSampler, PointsLieWhereRaysMeetTheSurface) {
    for (const char* shape : {"sphere", "ellipsoid", "torus", "plane", "cylinder", "cone", "paraboloid",
                              "saddle", "hyperboloid", "hyperboloid_two_sheets"})
        for (const char* place :
             {"", "rotate_degrees = [20, 30, 40]\nscale = [1.5, 0.3, 0.8]\ntranslate = [0.5, -0.2, 0.1]\n"}) {
            const PreparedScene scene = prepare(scene_from(kAll + "implicit = \"" + shape + "\"\n" + place));
            const SurfaceGeometry& geometry = *scene.objects[0].geometry;
            const LineSampler sampler(scene.objects[0], scene.camera, 0);
            int met = 0;
            int asked = 0;
            double worst = 0;
            for (std::uint64_t i = 0; i < 20000; ++i) {
                const auto p = sampler.trial({1}, 0, i);
                if (!p) continue;
                ++asked;
                const Vec3 normal = normalize(scene.camera.world_vector(p->view_normal));
                CrossingList hits;
                const int found =
                    geometry.crossings(0, {scene.camera.to_world(p->view), normal, -0.1, 0.1}, hits);
                for (int k = 0; k < found; ++k) {
                    const Crossing& hit = hits[static_cast<std::size_t>(k)];
                    if (std::abs(hit.t) > 1e-9) continue;
                    ++met;
                    worst = std::max(worst, std::abs(hit.t));
                    EXPECT_GT(std::abs(dot(normalize(hit.normal), normal)), 1 - 1e-9);
                    break;
                }
            }
            EXPECT_GT(asked, 1000) << shape;
            EXPECT_EQ(met, asked) << shape << place;
            EXPECT_LT(worst, 2e-13) << shape << place;
        }
}

/// Hides what a geometry knows of itself: bodies and crossings are all that is left.
class Anonymous final : public SurfaceGeometry {
public:
    explicit Anonymous(std::shared_ptr<const SurfaceGeometry> known) : known_(std::move(known)) {}
    [[nodiscard]] std::size_t patch_count() const override { return known_->patch_count(); }
    [[nodiscard]] Body body(std::size_t patch) const override { return known_->body(patch); }
    [[nodiscard]] int max_crossings() const override { return known_->max_crossings(); }
    int crossings(std::size_t patch, const Line& line, CrossingList& out) const override {
        return known_->crossings(patch, line, out);
    }
    [[nodiscard]] Box bounds() const override { return known_->bounds(); }
    [[nodiscard]] std::size_t bytes() const override { return known_->bytes(); }

private:
    std::shared_ptr<const SurfaceGeometry> known_;
};

TEST(LineSampler, AnyOtherGeometryIsServedByUniformLines) {
    for (const auto& [shape, area] : std::vector<std::pair<std::string, double>>{
             {"sphere", 4 * M_PI}, {"torus", 4 * M_PI * M_PI * 0.4}}) {
        PreparedScene scene = prepare(scene_from(kAll + "implicit = \"" + shape + "\"\nopacity = 0.05\n"));
        const double pixel_area = scene.camera.pixel_area(Vec3(0, 0, 1));
        for (const bool known : {true, false}) {
            if (!known)
                scene.objects[0].geometry = std::make_unique<Anonymous>(std::move(scene.objects[0].geometry));
            const LineSampler sampler(scene.objects[0], scene.camera, 0);
            constexpr std::uint64_t kTrials = 300000;
            const auto found = points(scene, kTrials);
            // Lands on the surface with probability area/(s V).
            const double share = area / (pixel_area * sampler.virtual_pixels());
            EXPECT_NEAR(static_cast<double>(found.size()) / kTrials, share,
                        4 * std::sqrt(share * (1 - share) / kTrials))
                << shape << known;
            expect_uniform(found, 8, [](const Vec3& p) {
                return static_cast<std::size_t>((p.x > 0) + 2 * (p.y > 0) + 4 * (p.z > 0));
            });
            // Fast mode draws as many, from shared lines.
            const std::vector<LineSampler> samplers(1, sampler);
            const ParticleSet exact = sample_particles(scene, samplers, {.seed = {1}}, 0, 160);
            const ParticleSet fast =
                sample_particles(scene, samplers, {.seed = {2}, .lines = LineMode::fast}, 0, 160);
            const auto n = static_cast<double>(exact.count());
            EXPECT_GT(n, 1000);
            EXPECT_NEAR(static_cast<double>(fast.count()), n, 4 * std::sqrt((1 + 4) * n)) << shape << known;
        }
    }
}

TEST(PackPoints, EqualsPackingOneByOne) {
    std::mt19937_64 random(1);
    std::normal_distribution<double> normal;
    for (const char* camera :
         {"camera.position = [0, 0, 4]\n", "camera.position = [0, 0, 4e9]\ncamera.far = 8e9\n"}) {
        const PreparedScene scene = prepare(scene_from(std::string("image.resolution = [64, 64]\n") + camera +
                                                       "[[surface]]\nimplicit = \"sphere\"\n"));
        const ParticleFrame frame(scene.camera);
        std::vector<LineSampler::Point> points;
        for (int i = 0; i < 1000; ++i) {
            const double scale = std::exp(20 * normal(random));
            const auto some = [&] { return i % 7 == 0 ? 0.0 : normal(random); };
            points.push_back({{normal(random), normal(random), 4 + normal(random)},
                              {scale * some(), scale * some(), scale * normal(random)}});
        }
        std::vector<Particle> packed(points.size());
        pack_points(frame, points, false, packed);
        for (std::size_t i = 0; i < points.size(); ++i) {
            const Particle one = frame.pack(points[i].view, points[i].view_normal);
            ASSERT_EQ(0, std::memcmp(&one, &packed[i], sizeof one)) << i;
            // And both are the point: shrunk to float, its normal to 6.5e-5.
            ASSERT_LT(length(frame.view_position(one) - Vec3(points[i].view.x, points[i].view.y,
                                                             std::max(points[i].view.z, frame.near))),
                      2e-7 * std::ldexp(1.0, frame.exponent));
            const twin::Vec3f n = twin::unpack_normal(one.normal);
            ASSERT_LT(length(Vec3(n.x, n.y, n.z) - normalize(points[i].view_normal)), 7e-5);
        }
    }
}

TEST(LineSampler, TrialIsAFunctionOfItsKeyAlone) {
    const PreparedScene scene = prepare(scene_from(kAll + "implicit = \"torus\""));
    const LineSampler sampler(scene.objects[0], scene.camera, 0);
    std::set<double> seen;
    for (std::uint64_t i = 0; i < 2000; ++i)
        for (std::uint32_t repeat = 0; repeat < 3; ++repeat) {
            const auto a = sampler.trial({1}, repeat, i);
            const auto b = sampler.trial({1}, repeat, i);
            ASSERT_EQ(a.has_value(), b.has_value());
            if (!a) continue;
            EXPECT_EQ(a->view, b->view);
            EXPECT_TRUE(seen.insert(a->view.x).second) << "two trials gave one point";
        }
    EXPECT_GT(seen.size(), 100U);
}

// ---- how many trials a repeat gets

std::string flat(double opacity, double pixels) {
    // A rectangle of `pixels` pixels inside a 16×16 image of pixels of size 1; every trial is a particle.
    return fmt::format(
        "image.resolution = [16, 16]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = 16\n"
        "[[surface]]\nopacity_law = \"oblique\"\nrectangle = {{ center = [0.5, 0.5, 0], u = [{}, 0, 0], v = [0, 0.5, 0] }}\nopacity = {}\n",
        0.5 * pixels, opacity);
}

TEST(TrialLaw, PoissonCountsArePoisson) {
    for (const double mean : {0.05, 1.0, 7.5, 200.0}) {
        const double pixels = std::max(1.0, mean / 5);
        const PreparedScene scene =
            prepare(scene_from(flat(-std::expm1(-mean / std::min(pixels, 15.0)), std::min(pixels, 15.0))));
        const auto samplers = make_samplers(scene);
        const double expected = mean_trials(samplers[0], TrialLaw::poisson);
        constexpr std::uint32_t kRepeats = 20000;
        const ParticleSet set = sample_particles(scene, samplers, {.seed = {4}}, 0, kRepeats);
        MeanVariance counts;
        for (const auto& r : set.repeats) counts.add(static_cast<double>(r.particles.size()));
        EXPECT_NEAR(counts.mean(), expected, 4 * std::sqrt(expected / kRepeats));
        // Variance of a sample variance of Poisson numbers: (μ + 2 μ²)/n.
        EXPECT_NEAR(counts.variance(), expected,
                    4 * std::sqrt((expected + 2 * expected * expected) / kRepeats));
    }
}

TEST(TrialLaw, PoissonOfTenMillionHasItsMeanAndVariance) {
    // The same generator and distribution as the sampler's, without ten million particles behind each number.
    MeanVariance counts;
    constexpr int kDraws = 20000;
    for (std::uint32_t i = 0; i < kDraws; ++i) {
        RandomStream random({5},
                            {.object = static_cast<std::uint32_t>(Purpose::particle_count), .repeat = i});
        counts.add(static_cast<double>(std::poisson_distribution<std::uint64_t>(1e7)(random)));
    }
    EXPECT_NEAR(counts.mean(), 1e7, 4 * std::sqrt(1e7 / kDraws));
    EXPECT_NEAR(counts.variance() / 1e7, 1, 4 * std::sqrt(2.0 / kDraws));
}

TEST(TrialLaw, BinomialTransmittanceIsExactForFewPixels) {
    for (const double pixels : {2.5, 7.3}) {
        const PreparedScene scene = prepare(scene_from(flat(0.45, pixels)));
        RenderStats stats;
        const std::uint32_t repeats = 100000;
        const Image image = render_particles(
            scene, {.repeats = repeats, .sampler = {.seed = {6}, .trials = TrialLaw::binomial}}, stats);
        // The pixel at the centre of the rectangle is whole: [0, 1]² is column 8, row 7.
        const double alpha = static_cast<double>(image.plane("A")[8 + 16 * 7]);
        EXPECT_NEAR(alpha, 0.45, 4 * std::sqrt(0.45 * 0.55 / repeats)) << pixels;
    }
}

TEST(TrialLaw, BinomialBelowOnePixelIsRefusedAndPoissonIsNot) {
    const PreparedScene scene = prepare(scene_from(flat(0.45, 0.7)));
    const auto samplers = make_samplers(scene);
    EXPECT_THROW((void)mean_trials(samplers[0], TrialLaw::binomial), Error);
    EXPECT_NEAR(mean_trials(samplers[0], TrialLaw::poisson), -0.7 * std::log(0.55), 1e-9);
}

TEST(ParticleSampler, ExactCountAndSplitsInCalls) {
    const PreparedScene scene = prepare(scene_from(kAll + "implicit = \"torus\"\nopacity = 0.3"));
    const auto samplers = make_samplers(scene);
    const ParticleSet exact = sample_particles(scene, samplers, {.seed = {1}, .exact_count = 37}, 0, 5);
    for (const auto& r : exact.repeats) EXPECT_EQ(r.particles.size(), 37U);
    const ParticleSet all = sample_particles(scene, samplers, {.seed = {1}}, 0, 6);
    const ParticleSet tail = sample_particles(scene, samplers, {.seed = {1}}, 4, 2);
    for (std::size_t i = 0; i < 2; ++i) {
        ASSERT_EQ(all.repeats[4 + i].particles.size(), tail.repeats[i].particles.size());
        EXPECT_EQ(0, std::memcmp(all.repeats[4 + i].particles.data(), tail.repeats[i].particles.data(),
                                 16 * tail.repeats[i].particles.size()));
    }
    const PreparedScene nothing = prepare(scene_from(kAll + "implicit = \"torus\"\ntranslate = [50, 0, 0]"));
    EXPECT_THROW((void)sample_particles(nothing, make_samplers(nothing), {.exact_count = 1}, 0, 1), Error);
}

}  // namespace
}  // namespace pellucid
