// Brownian motion on surfaces: uniform in the world's area, at edges too; the twins of its step are seen to be wrong.
#include "sample/brownian_source.hpp"

#include <numeric>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "sample/make_sources.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

PreparedScene scene_of(const std::string& body, const std::string& camera = "position = [7, 5, 6]\nview_height = 12") {
    return prepare(scene_from("image.resolution = [16, 16]\n[camera]\nprojection = \"orthographic\"\n" + camera +
                              "\n[[surface]]\nopacity_law = \"oblique\"\n" + body));
}

/// The last positions of many walkers, each on its own: independent, so that χ² judges them.
std::vector<Vec3> places(const PreparedScene& scene, WalkSettings settings, std::uint32_t walkers, std::uint32_t steps) {
    settings.walkers = walkers;
    settings.thinning = steps;
    const BrownianSource source(scene.objects[0], scene.camera, 0, settings);
    // A quarter of them a repeat, so that threads share the work.
    std::vector<std::vector<Vec3>> parts(4);
    parallel_for(4, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
            parts[i] = source.positions({7}, static_cast<std::uint32_t>(i), walkers / 4);
    });
    std::vector<Vec3> all;
    for (const auto& part : parts) all.insert(all.end(), part.begin(), part.end());
    return all;
}

std::size_t bin(double u, std::size_t n) {
    return std::min(n - 1, static_cast<std::size_t>(std::max(0.0, u) * static_cast<double>(n)));
}
double turn(double y, double x) { return 0.5 + std::atan2(y, x) / (2 * M_PI); }

double uniformity_p(const std::vector<Vec3>& found, std::size_t cells, const std::function<std::size_t(const Vec3&)>& cell) {
    std::vector<std::int64_t> counts(cells, 0);
    for (const Vec3& p : found) ++counts.at(cell(p));
    return chi2_uniformity(counts)->p_value;
}

std::size_t sphere_cell(const Vec3& p) { return 8 * bin(0.5 + 0.5 * p.z, 6) + bin(turn(p.y, p.x), 8); }
std::size_t torus_cell(const Vec3& p) {  // radii 1 and 0.4
    const double tube = turn(p.z, std::hypot(p.x, p.y) - 1) * 2 * M_PI - M_PI;
    return 6 * bin(0.5 + (tube + 0.4 * std::sin(tube)) / (2 * M_PI), 8) + bin(turn(p.y, p.x), 6);
}

// Of 24000 points in 48 cells: a bias of 5 % in half of the cells gives χ² 60 more than its 47.
TEST(Brownian, StaysUniformOnSphereAndTorus) {
    const PreparedScene sphere = scene_of("implicit = \"sphere\"");
    const auto on_sphere = places(sphere, {.step = 0.02}, 24000, 40);
    EXPECT_GT(uniformity_p(on_sphere, 48, sphere_cell), 1e-4);
    for (const Vec3& p : on_sphere) ASSERT_NEAR(length(p), 1, 1e-11);
    EXPECT_GT(uniformity_p(places(scene_of("implicit = \"torus\""), {.step = 0.01}, 24000, 40), 48, torus_cell), 1e-4);
}

// An affine map that is no similarity: uniform in object space would be another law.
TEST(Brownian, IsUniformInTheAreaOfTheWorld) {
    // A sphere stretched along z to an ellipsoid of half-axis 3: by a formula, and by the map.
    const PreparedScene mapped = scene_of("implicit = \"sphere\"\nscale = [1, 1, 3]\n");
    const auto found = places(mapped, {.step = 0.006}, 24000, 120);
    // Bands of equal area of the spheroid: ∫ 2π √(1 − z²/9) √(1 + …) dz numerically.
    constexpr int kBands = 12;
    std::vector<double> border(1, -3.0);
    const auto slope = [](double t) { return 2 * M_PI * std::cos(t) * std::sqrt(9 * std::cos(t) * std::cos(t) + std::sin(t) * std::sin(t)); };
    double total = 0;
    constexpr int kSteps = 200000;
    for (int i = 0; i < kSteps; ++i) total += slope(M_PI * ((i + 0.5) / kSteps - 0.5)) * M_PI / kSteps;
    double sum = 0;
    for (int i = 0; i < kSteps; ++i) {
        const double t = M_PI * ((i + 0.5) / kSteps - 0.5);
        sum += slope(t) * M_PI / kSteps;
        if (sum > total * static_cast<double>(border.size()) / kBands && border.size() < kBands) border.push_back(3 * std::sin(t));
    }
    const auto band = [&](const Vec3& p) {
        return static_cast<std::size_t>(std::ranges::upper_bound(border, p.z) - border.begin()) - 1;
    };
    EXPECT_GT(uniformity_p(found, kBands, [&](const Vec3& p) { return std::min<std::size_t>(band(p), kBands - 1); }), 1e-4);
    const BrownianSource source(mapped.objects[0], mapped.camera, 0, {});
    EXPECT_NEAR(source.area(), total, 4 * source.area_error() + 1e-9);
    EXPECT_LT(source.area_error(), 1e-3 * source.area());
}

// Half a sphere, its edge a circle; a cylinder between its bounds; a rectangle with corners, as a formula.
struct EdgeCase {
    const char* name;
    const char* body;
    double step;
    std::size_t cells;
    std::size_t (*cell)(const Vec3&);
};
void PrintTo(const EdgeCase& c, std::ostream* out) { *out << c.name; }

const EdgeCase kEdges[] = {
    {"half a sphere", "implicit = \"sphere\"\nclip = [{ normal = [0, 0, 1], offset = 0.0 }]", 0.025, 40,
     [](const Vec3& p) { return bin(-p.z, 40); }},
    {"cap of a sphere", "implicit = \"sphere\"\nclip = [{ normal = [0, 0, 1], offset = -0.5 }]", 0.01, 25,
     [](const Vec3& p) { return bin(-2 * p.z - 1, 25); }},
    {"cylinder", "implicit = \"cylinder\"", 0.04, 40, [](const Vec3& p) { return bin(0.5 + 0.5 * p.z, 40); }},
    {"square", "expression = \"z+0.1\"\nbounds = [[-1, -1, -1], [1, 1, 1]]", 0.03, 100,
     [](const Vec3& p) { return 10 * bin(0.5 + 0.5 * p.x, 10) + bin(0.5 + 0.5 * p.y, 10); }},
};

class BrownianEdge : public testing::TestWithParam<EdgeCase> {};

TEST_P(BrownianEdge, KeepsTheUniformLaw) {
    const PreparedScene scene = scene_of(GetParam().body);
    EXPECT_GT(uniformity_p(places(scene, {.step = GetParam().step}, 24000, 60), GetParam().cells, GetParam().cell), 1e-4);
}

TEST_P(BrownianEdge, ThatDrawsAgainUntilAStepEndsInsideIsSeenToBeWrong) {
    const PreparedScene scene = scene_of(GetParam().body);
    WalkSettings wrong{.step = GetParam().step};
    wrong.twin.edge = WalkStep::Edge::redraw;
    EXPECT_LT(uniformity_p(places(scene, wrong, 24000, 60), GetParam().cells, GetParam().cell), 1e-6);
}

INSTANTIATE_TEST_SUITE_P(Shapes, BrownianEdge, testing::ValuesIn(kEdges));

// A step that is not made at an edge leaves the law, but the particle comes twice.
TEST(Brownian, FoldingMakesNoParticleTwice) {
    const PreparedScene scene = scene_of(kEdges[3].body);
    for (const auto edge : {WalkStep::Edge::fold, WalkStep::Edge::stay}) {
        WalkSettings settings{.step = 0.05, .walkers = 64};
        settings.twin.edge = edge;
        const BrownianSource source(scene.objects[0], scene.camera, 0, settings);
        const auto at = source.positions({1}, 0, 64 * 200);
        std::size_t twice = 0;
        for (std::size_t i = 64; i < at.size(); ++i) twice += at[i] == at[i - 64] ? 1U : 0U;
        const bool fold = edge == WalkStep::Edge::fold;
        EXPECT_TRUE(fold ? twice == 0 : twice > 300) << twice;
    }
}

// ⟨x·x'⟩ on the unit sphere, against the exact step of a formula with its own gradient: 1 − step² + …; and |x| = 1.
TEST(Brownian, WrongTwinsOfTheStepAreSeen) {
    const PreparedScene scene = scene_of("implicit = \"sphere\"");
    const auto cosine_z = [&](const WalkStep& twin) {
        constexpr double kStep = 0.1;
        WalkSettings settings{.step = kStep, .walkers = 500, .drift = false};
        settings.twin = twin;
        const BrownianSource source(scene.objects[0], scene.camera, 0, settings);
        const auto at = source.positions({3}, 0, 500 * 60);
        MeanVariance cosine;
        for (std::size_t i = 500; i < at.size(); ++i) cosine.add(dot(at[i], at[i - 500]) / (length(at[i]) * length(at[i - 500])));
        // ∫ e^(−t)/√(1 + 2σ²t) dt, σ a share of the width 2.
        double expected = 0;
        for (int i = 0; i < 400000; ++i)
            expected += std::exp(-1e-4 * (i + 0.5)) / std::sqrt(1 + 8 * kStep * kStep * 1e-4 * (i + 0.5)) * 1e-4;
        return (cosine.mean() - expected) / cosine.standard_error();
    };
    EXPECT_LT(std::abs(cosine_z({})), 4);
    EXPECT_GT(std::abs(cosine_z({.noise = 0.5})), 20);
    EXPECT_GT(std::abs(cosine_z({.projected = false})), 4);

    WalkSettings loose{.step = 0.01, .walkers = 100, .drift = false};
    loose.twin.corrected = false;
    const BrownianSource source(scene.objects[0], scene.camera, 0, loose);
    double off = 0;
    for (const Vec3& p : source.positions({3}, 0, 100 * 50)) off = std::max(off, std::abs(length(p) - 1));
    EXPECT_GT(off, 1e-3);
}

// Landing chance of every pixel against random lines of the same object: w/s, both laws and projections.
TEST(Brownian, DensityIsThatOfRandomLinesForEveryLawAndProjection) {
    int tests = 0;
    for (const char* shape : {"torus", "cylinder"})
        for (const bool perspective : {false, true})
            for (const bool oblique : {false, true}) {
                const PreparedScene scene = prepare(scene_from(fmt::format(
                    "image.resolution = [8, 8]\n[camera]\nprojection = \"{}\"\nposition = [1.6, 2.0, 2.4]\n{}\n[[surface]]\nimplicit = \"{}\"\n"
                    "opacity_law = \"{}\"\nrotate_degrees = [20, 30, 40]\nscale = [1, 0.7, 1]\nclip = [{{ normal = [1, 0, 0], offset = 0.6 }}]\n",
                    perspective ? "perspective" : "orthographic", perspective ? "fov_degrees = 40" : "view_height = 2.2", shape,
                    oblique ? "oblique" : "constant")));
                const BrownianSource walk(scene.objects[0], scene.camera, 0, {.step = 0.02, .walkers = 60000, .thinning = 3});
                const LineSampler lines(scene.objects[0], scene.camera, 0);
                std::vector<double> a(64, 0), b(64, 0);
                const auto count = [&](const std::vector<SourcePoint>& points, std::vector<double>& counts) {
                    for (const SourcePoint& p : points) {
                        const Vec2 at = scene.camera.project(p.view);
                        ++counts[static_cast<std::size_t>(at.x) + 8 * static_cast<std::size_t>(at.y)];
                    }
                };
                constexpr std::uint32_t kTrials = 60000;
                std::vector<SourcePoint> points;
                walk.trials_in_block(0, {4}, 0, 0, kTrials, points);
                count(points, a);
                points.clear();
                for (std::uint64_t i = 0; i < kTrials; ++i)
                    if (const auto p = lines.trial({5}, 0, i)) points.push_back(*p);
                count(points, b);
                // Expected in proportion to 1/V.
                const double scale = lines.virtual_pixels() / walk.virtual_pixels();
                double statistic = 0;
                int bins = 0;
                for (std::size_t i = 0; i < 64; ++i) {
                    if (b[i] * std::min(1.0, scale) < 20) continue;
                    const double off = a[i] - scale * b[i];
                    statistic += off * off / (scale * b[i] + scale * scale * b[i]);
                    ++bins;
                }
                ASSERT_GT(bins, 10);
                ++tests;
                EXPECT_GT(chi2_survival(statistic, bins), sidak_level(0.001, 8))
                    << shape << (perspective ? " perspective" : " orthographic") << (oblique ? " oblique" : " constant");
            }
    EXPECT_EQ(tests, 8);
}

TEST(Brownian, DependsOnSeedRepeatAndIndexAlone) {
    const PreparedScene scene = scene_of("implicit = \"torus\"");
    const BrownianSource source(scene.objects[0], scene.camera, 0, {.walkers = 50});
    const auto all = source.positions({1}, 3, 700);
    const auto less = source.positions({1}, 3, 333);
    EXPECT_TRUE(std::equal(less.begin(), less.end(), all.begin()));
    EXPECT_NE(all, source.positions({1}, 4, 700));
    EXPECT_NE(all, source.positions({2}, 3, 700));
    std::vector<SourcePoint> whole, part;
    source.trials_in_block(0, {1}, 3, 0, 700, whole);
    source.trials_in_block(0, {1}, 3, 0, 320, part);
    source.trials_in_block(0, {1}, 3, 320, 380, part);
    ASSERT_EQ(whole.size(), part.size());
    for (std::size_t i = 0; i < whole.size(); ++i) EXPECT_EQ(whole[i].view, part[i].view);

    const Sources sources = make_sources(scene, SamplerKind::brownian);
    const int threads = thread_count();
    set_thread_count(1);
    const ParticleSet one = sample_particles(scene, sources, {.seed = {9}, .exact_count = {}}, 0, 4);
    set_thread_count(threads);
    const ParticleSet many = sample_particles(scene, sources, {.seed = {9}, .exact_count = {}}, 0, 4);
    ASSERT_EQ(one.count(), many.count());
    for (std::size_t r = 0; r < 4; ++r)
        EXPECT_EQ(0, std::memcmp(one.repeats[r].particles.data(), many.repeats[r].particles.data(),
                                 one.repeats[r].particles.size() * sizeof(Particle)));
}

TEST(Brownian, NeverLoopsForEverWhereTheFieldHasNoWayBack) {
    // A pole beside the surface, a kink, and a domain that ends: steps are lost and counted, walkers are put elsewhere.
    for (const char* text : {"1/x-2*y+z", "max(abs(x),abs(y),abs(z))-0.7", "sqrt(x)-y"}) {
        const PreparedScene scene = scene_of(fmt::format("expression = \"{}\"\nbounds = [[-1, -1, -1], [1, 1, 1]]", text));
        const BrownianSource source(scene.objects[0], scene.camera, 0, {.step = 0.2, .walkers = 50});
        const auto at = source.positions({1}, 0, 50 * 100);
        EXPECT_EQ(at.size(), 5000U);
        for (const Vec3& p : at) ASSERT_TRUE(std::abs(p.x) < 1.001 && std::abs(p.y) < 1.001 && std::abs(p.z) < 1.001) << text;
    }
}

// Many walkers at once against the plain walk: the same steps but for rounding, edges included.
TEST(Brownian, ManyWalkersAtOnceTakeTheStepsOfOne) {
    for (const char* body : {"implicit = \"torus\"", "implicit = \"cylinder\"\nrotate_degrees = [10, 20, 30]\nscale = 2.0",
                             "implicit = \"saddle\"", "implicit = \"sphere\"\nclip = [{ normal = [0, 0, 1], offset = 0.3 }]"}) {
        const PreparedScene scene = scene_of(body);
        for (const bool drift : {false, true}) {
            const WalkStep step{.length = 0.05, .drift = drift};
            const BrownianWalk walk(scene.objects[0], step);
            ASSERT_TRUE(walk.has_herds());
            const UniformPoints places(scene.objects[0], 0);
            constexpr std::size_t kCount = 1003;
            std::array<std::vector<double>, 7> soa;
            for (auto& values : soa) values.resize(1008, 1);
            std::vector<BrownianWalk::Walker> plain(kCount);
            std::uint64_t trial = 0;
            for (std::size_t i = 0; i < kCount; ++i) {
                for (;;)
                    if (const auto p = places.point({1}, 0, trial++); p && walk.put(*p, plain[i])) break;
                for (int k = 0; k < 3; ++k) {
                    soa[static_cast<std::size_t>(k)][i] = plain[i].at[k];
                    soa[static_cast<std::size_t>(3 + k)][i] = plain[i].gradient[k];
                }
            }
            std::vector<std::uint32_t> left;
            const DrawKey key{.object = 3, .repeat = 7, .index = (std::uint64_t{1} << 55U) | 17U};
            walk_herd(walk.quick(), {5}, key, {{soa[0].data(), soa[1].data(), soa[2].data()}, {soa[3].data(), soa[4].data(), soa[5].data()}, soa[6].data()},
                      kCount, left);
            EXPECT_LT(left.size(), kCount / 4) << body;
            std::size_t moved = 0;
            for (std::size_t i = 0; i < kCount; ++i) {
                const BrownianWalk::Walker was = plain[i];
                const WalkOutcome outcome =
                    walk.advance(plain[i], {5}, {key.object, key.repeat, key.index + (std::uint64_t{i} << 32U), 0});
                const bool is_left = std::ranges::find(left, static_cast<std::uint32_t>(i)) != left.end();
                EXPECT_TRUE(is_left || outcome == WalkOutcome::moved);
                const Vec3 expected = is_left ? was.at : plain[i].at;
                for (int k = 0; k < 3; ++k) ASSERT_NEAR(soa[static_cast<std::size_t>(k)][i], expected[k], 1e-11) << body;
                moved += is_left ? 0 : 1;
            }
            EXPECT_GT(moved, kCount / 2);
        }
    }
}

TEST(Brownian, RefusesWhatHasNoField) {
    const PreparedScene scene = scene_of("rectangle = { u = [2, 0, 1], v = [0, 1, 0] }\nname = \"card\"");
    for (const auto kind : {SamplerKind::brownian, SamplerKind::octree}) {
        try {
            (void)make_sources(scene, kind);
            ADD_FAILURE();
        } catch (const Error& error) {
            EXPECT_NE(std::string(error.what()).find("card"), std::string::npos) << error.what();
            EXPECT_NE(std::string(error.what()).find("particles.sampler"), std::string::npos) << error.what();
        }
    }
}

// ---- clumps

/// The planar random walk itself: how many more of its own walker a particle finds in its pixel, pixels of side 1.
double clumping_of_walks(double step, int positions) {
    std::mt19937_64 random(5);
    std::normal_distribution<double> normal(0, step);
    std::uniform_real_distribution<double> uniform(0, 1);
    constexpr int kWalks = 40000;
    double pairs = 0;
    for (int walk = 0; walk < kWalks; ++walk) {
        std::vector<std::pair<double, double>> at(1, {uniform(random), uniform(random)});
        while (at.size() < static_cast<std::size_t>(positions))
            at.emplace_back(at.back().first + normal(random), at.back().second + normal(random));
        for (std::size_t i = 0; i < at.size(); ++i)
            for (std::size_t k = i + 1; k < at.size(); ++k)
                pairs += std::floor(at[i].first) == std::floor(at[k].first) && std::floor(at[i].second) == std::floor(at[k].second);
    }
    return 2 * pairs / (double{kWalks} * positions);
}

TEST(Brownian, ClumpingIsThatOfPlanarWalks) {
    for (const double step : {2.0, 5.0})
        for (const int positions : {2, 5, 30}) {
            const double found = clumping_of_walks(step, positions);
            EXPECT_NEAR(clumping(1 / (2 * M_PI * step * step), 1e-12, positions) / found, 1, 0.15) << step << ' ' << positions;
        }
    EXPECT_EQ(clumping(0.5, 1e-12, 1), 0);
    EXPECT_NEAR(clumping(2.5, 1e-12, 4), 2.0 / 4 * (3 + 2 + 2.5 / 3), 0.01);  // a walker that hardly moves
}

/// Mean of A over the image less that of the truth, and the standard error of it.
std::pair<double, double> bias_of_opacity(const PreparedScene& scene, const WalkSettings& walk, std::uint32_t repeats) {
    TruthStats truth_stats;
    const Image truth = trace_truth(scene, {.filter = PixelFilter::particle, .max_error = 3e-3}, truth_stats);
    double expected = 0;
    for (const float a : truth.plane("A")) expected += static_cast<double>(a);
    MeanVariance found;
    for (std::uint64_t seed = 0; seed < 8; ++seed) {
        ParticleSettings settings{.repeats = repeats, .kind = SamplerKind::brownian, .sampler = {.seed = {seed}}};
        settings.source.walk = walk;
        RenderStats stats;
        const Image image = render_particles(scene, settings, stats);
        double sum = 0;
        for (const float a : image.plane("A")) sum += static_cast<double>(a);
        found.add((sum - expected) / expected);
    }
    return {found.mean(), found.standard_error()};
}

// ---- fields that end at the surface's edge

/// Mean A of the whole image and of its outermost pixels, a seed each.
struct WholeAndEdge {
    MeanVariance whole, edge;
};

WholeAndEdge opacities(const PreparedScene& scene, SamplerKind kind, bool continued, std::uint32_t repeats) {
    WholeAndEdge found;
    const auto width = static_cast<std::size_t>(scene.camera.width());
    const auto height = static_cast<std::size_t>(scene.camera.height());
    for (std::uint64_t seed = 0; seed < 8; ++seed) {
        ParticleSettings settings{.repeats = repeats, .kind = kind, .sampler = {.seed = {seed}}};
        settings.source.walk = {.step = 0.25, .walkers = 256};  // several steps a walker, a fourth of them across an edge
        settings.source.walk.twin.continued = continued;
        RenderStats stats;
        const Image image = render_particles(scene, settings, stats);
        MeanVariance whole, edge;
        for (std::size_t i = 0; i < image.pixel_count(); ++i) {
            const std::size_t x = i % width, y = i / width;
            const auto a = static_cast<double>(image.plane("A")[i]);
            whole.add(a);
            if (x == 0 || y == 0 || x + 1 == width || y + 1 == height) edge.add(a);
        }
        found.whole.add(whole.mean());
        found.edge.add(edge.mean());
    }
    return found;
}

/// Of 8 seeds, once in 10^4.
const double kStudent7 = student_critical_value(1e-4, 7);
double student(const MeanVariance& found, double expected) { return std::abs(found.mean() - expected) / found.standard_error(); }

/// An isosurface as a function of x and y over the whole of its volume, n³ samples, which fills the image.
PreparedScene open_isosurface(int n, const char* interpolation) {
    const auto height = [&](const Vec3& p) {
        const double x = p.x - 0.5 * (n - 1), y = p.y - 0.5 * (n - 1);
        return n == 2 ? p.z - 0.3 : p.z - 1.7 + 0.15 * x * x - 0.1 * y * y;
    };
    const fs::path file = test_folder() / "open.nrrd";
    put_volume(file, {n, n, n}, sampled({n, n, n}, height));
    const double middle = 0.5 * (n - 1);
    return prepare(scene_from(fmt::format(
        "image.resolution = [48, 48]\n[camera]\nprojection = \"orthographic\"\nposition = [{0}, {0}, 20]\ntarget = [{0}, {0}, 0]\n"
        "view_height = {1}\n[[surface]]\nopacity = 0.5\n"
        "isosurface = {{ volume = \"{2}\", isovalue = 0, interpolation = \"{3}\" }}\n",
        middle, n - 1, file.string(), interpolation)));
}

// All pixels are wholly covered: A = 0.5 to the edge. The wrong twin has a walker stay where a step would cross the hull.
TEST(Brownian, IsosurfacesThatEndAtTheirVolumeHaveTheirOpacityToTheEdge) {
    for (const auto& [n, interpolation] : {std::pair(2, "trilinear"), std::pair(5, "catmull-rom")}) {
        SCOPED_TRACE(n);
        const PreparedScene scene = open_isosurface(n, interpolation);
        const WholeAndEdge right = opacities(scene, SamplerKind::brownian, true, 40);
        EXPECT_LT(student(right.whole, 0.5), kStudent7) << right.whole.mean();
        EXPECT_LT(student(right.edge, 0.5), kStudent7) << right.edge.mean();
        EXPECT_LT(right.edge.standard_error(), 0.003);
        const WholeAndEdge wrong = opacities(scene, SamplerKind::brownian, false, 40);
        EXPECT_GT(student(wrong.whole, 0.5), kStudent7) << wrong.whole.mean();
        EXPECT_GT(student(wrong.edge, 0.5), kStudent7) << wrong.edge.mean();
    }
}

// Independent walkers in 100 cells of equal area, corners among them.
TEST(Brownian, WalksOnAnOpenIsosurfaceStayUniformAndLoseNoStep) {
    const PreparedScene scene = open_isosurface(2, "trilinear");
    const auto cell = [](const Vec3& p) { return 10 * bin(p.x, 10) + bin(p.y, 10); };
    EXPECT_GT(uniformity_p(places(scene, {.step = 0.1}, 24000, 30), 100, cell), 1e-4);
    for (const bool continued : {true, false}) {
        WalkSettings settings{.walkers = 100};
        settings.twin.continued = continued;
        const BrownianSource source(scene.objects[0], scene.camera, 0, settings);
        (void)source.positions({1}, 0, 100 * 100);
        const auto stats = source.stats();
        EXPECT_TRUE(continued ? stats.lost == 0 && stats.at_borders > 1000 : stats.lost > 1000) << stats.lost;
    }
}

// Points of an open sheet: the surface ends at the cube around them. Random lines know nothing of walks.
TEST(Brownian, PointsThatEndAtTheirCubeHaveTheOpacityOfRandomLines) {
    std::string text;
    for (int j = 0; j < 60; ++j)
        for (int i = 0; i < 60; ++i) {
            const double x = (i + 0.5) / 30 - 1, y = (j + 0.5) / 30 - 1;
            const Vec3 n = normalize(Vec3(-0.4 * x, 0.2 * y, 1));
            text += fmt::format("{} {} {} {} {} {}\n", x, y, 0.2 * x * x - 0.1 * y * y, n.x, n.y, n.z);
        }
    const fs::path file = put(test_folder() / "sheet.xyz", text);
    const PreparedScene scene = prepare(scene_from(fmt::format(
        "image.resolution = [48, 48]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 9]\nview_height = 2\n[[surface]]\n"
        "opacity = 0.5\npoints = \"{}\"\n", file.string())));
    const WholeAndEdge lines = opacities(scene, SamplerKind::lines, true, 100);
    const WholeAndEdge walk = opacities(scene, SamplerKind::brownian, true, 100);
    EXPECT_LT(student(walk.whole, lines.whole.mean()), kStudent7) << walk.whole.mean() << ' ' << lines.whole.mean();
    EXPECT_LT(student(walk.edge, lines.edge.mean()), kStudent7) << walk.edge.mean() << ' ' << lines.edge.mean();
}

TEST(Brownian, DrawsTheOpacityAtItsDefaults) {
    for (const char* surface : {"implicit = \"sphere\"", "implicit = \"torus\"\nrotate_degrees = [60, 20, 0]"}) {
        const PreparedScene scene = prepare(scene_from(
            std::string("image.resolution = [48, 48]\ncamera.position = [0, 0, 4]\n[[surface]]\nopacity = 0.5\n") + surface));
        const auto [bias, error] = bias_of_opacity(scene, {}, 60);
        EXPECT_NEAR(bias, 0, 4.5 * error + 0.003) << surface;
        EXPECT_LT(error, 0.002);
    }
}

TEST(Brownian, FewWalkersWithSmallStepsClumpAndSaySo) {
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [48, 48]\ncamera.position = [0, 0, 4]\n[[surface]]\nopacity = 0.5\nimplicit = \"sphere\"\n"));
    const WalkSettings few{.step = 0.01, .walkers = 256};
    const auto [bias, error] = bias_of_opacity(scene, few, 20);
    EXPECT_LT(bias, -0.05);
    const BrownianSource source(scene.objects[0], scene.camera, 0, few);
    EXPECT_NE(source.complaint().find("more particles.walk.walkers (now 256)"), std::string::npos) << source.complaint();
    EXPECT_EQ(BrownianSource(scene.objects[0], scene.camera, 0, {}).complaint(), "");
    const BrownianSource lone(scene.objects[0], scene.camera, 0,
                              {.step = 0.001, .walkers = 1000, .start = WalkSettings::Start::single});
    EXPECT_NE(lone.complaint().find("reach an area of"), std::string::npos) << lone.complaint();
}

}  // namespace
}  // namespace pellucid
