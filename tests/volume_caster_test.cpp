// Slabs of rays through volumes: closed forms, the integrated truth, and what must not change them.
#include <random>

#include "core/error.hpp"
#include "cpu/multi_volume_caster.hpp"
#include "cpu/preintegration.hpp"
#include "cpu/volume_caster.hpp"
#include "reference/volume_rays.hpp"
#include "render/method.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;
using twin::Slab;

/// Orthographic from +z: rays run from z = 4 down.
std::string head(int pixels = 3, double view = 0.3) {
    return fmt::format(
        "image.resolution = [{0}, {0}]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, "
        "4]\nview_height = {1}\n",
        pixels, view);
}
/// 5³ samples half a unit apart.
std::string volume(const std::string& expression, const std::string& transfer, const std::string& more = "",
                   double step = 0.5) {
    return fmt::format(
        "[[volume]]\nexpression = \"{}\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nresolution = 5\ntransfer = "
        "{}\nopacity_step = {}\n{}\n",
        expression, transfer, step, more);
}

struct Composite {
    Vec3 color{0.0};
    double clear = 1;

    void add(double alpha, const Vec3& associated) {
        color += clear * associated;
        clear *= 1 - alpha;
    }
};
Composite composite(const std::vector<Slab>& slabs) {
    Composite sum;
    for (const Slab& s : slabs)
        sum.add(static_cast<double>(s.a),
                {static_cast<double>(s.r), static_cast<double>(s.g), static_cast<double>(s.b)});
    return sum;
}
std::vector<Slab> cast(const PreparedScene& scene, const Ray& ray, double step, bool skip = true,
                       std::size_t which = 0) {
    const VolumeCaster caster(scene, scene.volumes[which],
                              {.step = step * voxel_pitch(scene.volumes[which].to_world()), .skip = skip});
    SlabList list;
    caster.cast(ray, list);
    return list.slabs;
}
/// The truth of all volumes.
Composite integrated(const PreparedScene& scene, const Ray& ray) {
    VolumeRay volumes(scene, {.tolerance = 1e-7});
    std::vector<VolumeLayer> layers;
    volumes.start(ray);
    volumes.advance(kInfinity, 1, 1e-12, layers);
    Composite sum;
    for (const VolumeLayer& layer : layers) {
        const double alpha = -std::expm1(-layer.optical_depth);
        sum.add(alpha, alpha * layer.color);
    }
    return sum;
}
double difference(const Composite& a, const Composite& b) {
    double worst = std::abs(a.clear - b.clear);
    for (int c = 0; c < 3; ++c) worst = std::max(worst, std::abs(a.color[c] - b.color[c]));
    return worst;
}
void expect_sorted(const std::vector<Slab>& slabs) {
    for (std::size_t i = 0; i < slabs.size(); ++i) {
        EXPECT_GT(slabs[i].d, 0) << i;
        EXPECT_GT(slabs[i].a, 0) << i;
        EXPECT_LE(slabs[i].a, 1) << i;
        if (i > 0) {
            EXPECT_GE(slabs[i].z - slabs[i].d, slabs[i - 1].z) << i;
        }
    }
}

// ---- Pre-integration --------------------------------------------------------------------------

/// By midpoints, front to back; where opacity is 1 nothing passes.
Look quadrature(const TransferFunction& f, double from, double to, double steps, int parts = 200000) {
    Look sum;
    for (int i = 0; i < parts && sum.opacity < 1; ++i) {
        const double value = from + (to - from) * (i + 0.5) / parts;
        const double alpha = -std::expm1(std::log1p(-f.opacity(value)) * steps / parts);
        sum.color += (1 - sum.opacity) * alpha * f.color(value);
        sum.opacity += (1 - sum.opacity) * alpha;
    }
    return sum;
}

TEST(Preintegration, EqualsQuadratureForAnyTransferFunction) {
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> unit(0, 1);
    for (int round = 0; round < 150; ++round) {
        std::vector<TransferPoint> points;
        double value = -3;
        for (int i = 0; i < 5; ++i) {
            if (unit(random) < 0.7) value += 2 * unit(random);
            const double opacity = std::min(1.0, 1.1 * unit(random));
            points.push_back(
                {value, unit(random), unit(random), unit(random), round % 2 == 0 ? opacity : 0.3 * opacity});
        }
        const TransferFunction f(points);
        const double from = -4 + 8 * unit(random), to = -4 + 8 * unit(random);
        const double steps = std::pow(10.0, 3 * unit(random) - 2);
        const Look look = preintegrate(f, from, to, steps);
        const Look expected = quadrature(f, from, to, steps);
        ASSERT_NEAR(look.opacity, expected.opacity, 3e-5) << round;
        for (int c = 0; c < 3; ++c)
            ASSERT_NEAR(look.color[c], expected.color[c], 5e-4 * expected.opacity + 3e-5) << round;
    }
}

TEST(Preintegration, ClosedForms) {
    // α from 0 to 1 over one step: mean of −ln(1 − α) is 1.
    const TransferFunction ramp({{0, 1, 0.5, 0, 0}, {1, 1, 0.5, 0, 1}});
    for (const auto& [from, to] : {std::pair(0.0, 1.0), std::pair(1.0, 0.0)}) {
        EXPECT_NEAR(preintegrate(ramp, from, to, 1).opacity, 1 - std::exp(-1.0), 1e-14);
        EXPECT_NEAR(preintegrate(ramp, from, to, 1).color.y, 0.5 * (1 - std::exp(-1.0)), 1e-14);
    }
    // A jump: nothing below, red at once.
    const TransferFunction jump({{0, 0, 1, 0, 0}, {2, 0, 1, 0, 0}, {2, 1, 0, 0, 0.5}, {3, 1, 0, 0, 0.5}});
    EXPECT_NEAR(preintegrate(jump, 1, 3, 2).opacity, 0.5, 1e-15);
    EXPECT_EQ(preintegrate(jump, 1, 3, 2).color.y, 0);
    EXPECT_EQ(preintegrate(jump, 2, 2, 1).opacity, 0.5);  // at the value itself what follows counts
    EXPECT_EQ(preintegrate(jump, std::nextafter(2.0, 0.0), 0, 1).opacity, 0);
    // What blocks, blocks with the colour at its front.
    const TransferFunction wall({{0, 1, 0, 0, 1}, {1, 0, 1, 0, 1}, {1, 0, 0, 1, 0.2}, {2, 0, 0, 1, 0.2}});
    const Look from_behind = preintegrate(wall, 2, 0, 1);
    EXPECT_EQ(from_behind.opacity, 1);
    EXPECT_NEAR(from_behind.color.z, 1 - std::sqrt(0.8), 1e-14);
    EXPECT_NEAR(from_behind.color.y, std::sqrt(0.8), 1e-14);
    EXPECT_EQ(preintegrate(wall, 0, 2, 1).color, Vec3(1, 0, 0));
}

TEST(Preintegration, KeepsDigitsAtTheEndsOfItsRange) {
    const TransferFunction thin({{0, 1, 1, 1, 0}, {1, 1, 1, 1, 1e-12}});
    EXPECT_NEAR(preintegrate(thin, 0, 1, 1).opacity / 5e-13, 1, 1e-9);
    const TransferFunction half({{0, 1, 1, 1, 0.5}});
    EXPECT_EQ(preintegrate(half, 0, 1, 1e300).opacity, 1);
    EXPECT_NEAR(preintegrate(half, 0, 1, 1e-300).opacity / (1e-300 * std::log(2.0)), 1, 1e-12);
    const TransferFunction clear({{0, 1, 1, 1, 0}});
    EXPECT_EQ(preintegrate(clear, 0, 1, kInfinity).opacity, 0);
    for (const double bad : {std::nan(""), kInfinity, -kInfinity}) {
        EXPECT_EQ(preintegrate(half, bad, 1, 1).opacity, 0);
        EXPECT_EQ(preintegrate(half, 1, bad, 1).opacity, 0);
    }
    // Values as large as floats go.
    const TransferFunction wide({{-3e38, 0, 0, 0, 0}, {3e38, 1, 1, 1, 0.8}});
    EXPECT_NEAR(preintegrate(wide, 0, 0, 1).opacity, 0.4, 1e-12);
}

// ---- Closed forms along a ray -----------------------------------------------------------------

TEST(VolumeCaster, HomogeneousMediumIsBeersLawForAnyStep) {
    const PreparedScene scene = prepare(scene_from(head() + volume("1", "[[0, 0.2, 0.4, 1, 0.3]]")));
    for (const double step : {0.01, 0.3, 1.0, 2.7, 100.0}) {
        const auto slabs = cast(scene, scene.camera.ray(1.5, 1.5), step);
        const Composite sum = composite(slabs);
        const double alpha = 1 - std::pow(0.7, 4);
        EXPECT_NEAR(1 - sum.clear, alpha, 2e-6) << step;
        EXPECT_NEAR(sum.color.y, 0.4 * alpha, 2e-6) << step;
        expect_sorted(slabs);
        // Hull from depth 3 to 5, slabs without gaps, of one step but for the ends.
        EXPECT_FLOAT_EQ(slabs.front().z - slabs.front().d, 3);
        EXPECT_FLOAT_EQ(slabs.back().z, 5);
        for (std::size_t i = 1; i < slabs.size(); ++i) {
            EXPECT_EQ(slabs[i].z - slabs[i].d, slabs[i - 1].z);
        }
        for (std::size_t i = 1; i + 1 < slabs.size(); ++i) {
            EXPECT_NEAR(slabs[i].d, 0.5 * step, 1e-6);
        }
    }
}

TEST(VolumeCaster, LinearRampAndJumpAreExactForAnyStep) {
    // α = (1 + z)/2: ∫ −ln(1 − α) dz over −1 … 1 is 2.
    const PreparedScene ramp =
        prepare(scene_from(head() + volume("0.5 + 0.5*z", "[[0, 1, 1, 1, 0], [1, 1, 1, 1, 1]]", "", 4)));
    // Half-transparent a unit above z = 0.3.
    const PreparedScene jump = prepare(scene_from(
        head() +
        volume("z", "[[-1, 1, 1, 1, 0], [0.3, 1, 1, 1, 0], [0.3, 1, 1, 1, 0.5], [1, 1, 1, 1, 0.5]]", "", 1)));
    for (const double step : {0.05, 1.0, 3.1, 50.0}) {
        EXPECT_NEAR(1 - composite(cast(ramp, ramp.camera.ray(1.5, 1.5), step)).clear, 1 - std::exp(-0.5),
                    3e-6)
            << step;
        EXPECT_NEAR(1 - composite(cast(jump, jump.camera.ray(1.5, 1.5), step)).clear, 1 - std::pow(0.5, 0.7),
                    3e-6)
            << step;
    }
}

TEST(VolumeCaster, ClipPlanesCutExactly) {
    const PreparedScene scene = prepare(scene_from(
        head() +
        volume("1", "[[0, 1, 1, 1, 0.5]]",
               "clip = [{ normal = [0, 0, 2], offset = 0.57 }, { normal = [0, 0, -1], offset = 0.613 }]",
               1)));
    for (const double step : {0.1, 1.0, 9.0}) {
        const auto slabs = cast(scene, scene.camera.ray(1.5, 1.5), step);
        EXPECT_NEAR(1 - composite(slabs).clear, 1 - std::pow(0.5, 0.285 + 0.613), 2e-6);
        EXPECT_FLOAT_EQ(slabs.front().z - slabs.front().d, 4 - 0.285F);
        EXPECT_FLOAT_EQ(slabs.back().z, 4.613F);
    }
}

TEST(VolumeCaster, LabelsAreCutWhereTheirCellsEnd) {
    const fs::path folder = test_folder();
    put_volume(folder / "l.nrrd", {2, 2, 3}, sampled({2, 2, 3}, [](const Vec3& p) { return p.z; }));
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [1, 1]\n[camera]\nprojection = \"orthographic\"\nposition = [0.5, 0.5, "
        "9]\ntarget = [0.5, 0.5, 0]\nview_height = 0.1\n"
        "[[volume]]\nfile = \"l.nrrd\"\ninterpolation = \"nearest\"\nopacity_step = 1\n"
        "transfer = [[0, 0, 0, 0, 0], [0.5, 0, 0, 0, 0], [0.5, 1, 0, 0, 0.4], [1.5, 1, 0, 0, 0.4], [1.5, 0, "
        "1, 0, 0.7]]\n",
        folder));
    for (const double step : {0.1, 1.0, 7.0}) {  // labels 2, 1, 0 over ½, 1, ½; none between is invented
        const Composite sum = composite(cast(scene, scene.camera.ray(0.5, 0.5), step));
        EXPECT_NEAR(sum.color.y, 1 - std::sqrt(0.3), 2e-6) << step;
        EXPECT_NEAR(sum.color.x, std::sqrt(0.3) * 0.4, 2e-6) << step;
    }
}

TEST(VolumeCaster, ExtremeOpacitySteps) {
    for (const auto& [step, alpha] : {std::pair(1e-30, 1.0), std::pair(1e30, 0.0), std::pair(1e-300, 1.0)}) {
        const PreparedScene scene =
            prepare(scene_from(head() + volume("z", "[[-2, 0, 0, 0, 0.1], [2, 1, 1, 1, 0.9]]",
                                               "shading = { ambient = 1 }", step)));
        const auto slabs = cast(scene, scene.camera.ray(1.5, 1.5), 1);
        const Composite sum = composite(slabs);
        EXPECT_NEAR(1 - sum.clear, alpha, 1e-20);
        for (const Slab& s : slabs) {
            EXPECT_TRUE(std::isfinite(s.r) && std::isfinite(s.a));
        }
    }
}

TEST(VolumeCaster, OpacityOneEndsTheRay) {
    const PreparedScene scene = prepare(scene_from(
        head() + volume("z",
                        "[[-1, 0, 0, 1, 1], [0.25, 0, 1, 0, 1], [0.25, 1, 0, 0, 0.5], [1, 1, 0, 0, 0.5]]", "",
                        1)));
    const auto slabs = cast(scene, scene.camera.ray(1.5, 1.5), 0.7);
    EXPECT_EQ(slabs.back().a, 1);
    EXPECT_NEAR(composite(slabs).color.y, std::pow(0.5, 0.75), 2e-6);
    EXPECT_EQ(composite(slabs).clear, 0);
    expect_sorted(slabs);
}

TEST(VolumeCaster, OneSampleAlongAnAxisAndRaysBesideDrawNothing) {
    const fs::path folder = test_folder();
    put_volume(folder / "flat.nrrd", {4, 4, 1}, std::vector<float>(16, 1.0F));
    const PreparedScene flat = prepare(
        scene_from(head() + "[[volume]]\nfile = \"flat.nrrd\"\ntransfer = [[0, 1, 1, 1, 0.5]]\n", folder));
    EXPECT_TRUE(cast(flat, flat.camera.ray(1.5, 1.5), 1).empty());
    const PreparedScene beside =
        prepare(scene_from(head() + volume("1", "[[0, 1, 1, 1, 0.5]]", "translate = [3, 0, 0]")));
    EXPECT_TRUE(cast(beside, beside.camera.ray(1.5, 1.5), 1).empty());
}

// ---- Against the truth ------------------------------------------------------------------------

/// Two volumes with borders, placements, holes, clip planes; `which` of them alone.
PreparedScene rough_scene(const fs::path& folder, const std::string& interpolation,
                          const std::string& shading, bool holes, const std::string& transfer_points) {
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    std::vector<float> values = sampled({26, 25, 27}, [&](const Vec3& p) {
        return p.x > 17
                   ? 0.05
                   : 0.5 + 0.4 * std::sin(0.9 * p.x) * std::cos(0.7 * p.y + 0.3 * p.z) + 0.1 * unit(random);
    });
    if (holes) {
        values[static_cast<std::size_t>(7 + 26 * (9 + 25 * 12))] = std::numeric_limits<float>::quiet_NaN();
        for (int k = 0; k < 27; ++k)
            for (int j = 0; j < 25; ++j)
                for (int i = 0; i < 10; ++i)
                    if (j > 14)
                        values[static_cast<std::size_t>(i + 26 * (j + 25 * k))] =
                            std::numeric_limits<float>::quiet_NaN();
    }
    put_volume(folder / "noise.nrrd", {26, 25, 27}, values, {0.09, 0.1, 0.08});
    return prepare(scene_from(
        "image.resolution = [16, 16]\n[camera]\nposition = [3, 2.5, 4]\ntarget = [0.2, 0.1, "
        "0.2]\nfov_degrees = 30\n"
        "[[volume]]\nfile = \"noise.nrrd\"\nmatrix = [0.9,0.2,0,-0.8, -0.3,1,0.1,-0.9, 0,0.2,-1,0.9, "
        "0,0,0,1]\n"
        "clip = [{ normal = [1, 0.2, 0], offset = 0.9 }]\nopacity_step = 0.2\ntransfer = " +
            transfer_points + fmt::format("\ninterpolation = \"{}\"\nshading = {}\n", interpolation, shading),
        folder));
}
constexpr const char* kSmooth =
    "[[0.1, 1, 0, 0, 0], [0.4, 0, 1, 0, 0.2], [0.6, 0, 0, 1, 0.05], [0.9, 1, 1, 1, 0.6]]";
constexpr const char* kJumps =
    "[[0.1, 1, 0, 0, 0], [0.4, 0, 1, 0, 0.2], [0.4, 0, 1, 0, 0], [0.7, 0, 0, 1, 0], [0.7, 1, 1, 0, 0.8], "
    "[0.72, 1, 1, 0, 1], [0.72, 0, 0, 0, 0]]";

TEST(VolumeCaster, ConvergesToTheTruthAsTheSquareOfTheStep) {
    for (const char* shading : {"\"flat\"", "{ ambient = 0.3, diffuse = 0.7 }"}) {
        const PreparedScene scene = rough_scene(test_folder(), "trilinear", shading, false, kSmooth);
        std::array<double, 4> mean{};
        const std::array<double, 4> step{0.5, 0.25, 0.125, 0.0625};
        int rays = 0;
        for (int y = 1; y < 16; y += 2)
            for (int x = 1; x < 16; x += 2, ++rays) {
                const Ray ray = scene.camera.ray(x + 0.31, y + 0.77);
                const Composite truth = integrated(scene, ray);
                for (std::size_t i = 0; i < 4; ++i)
                    mean[i] += difference(composite(cast(scene, ray, step[i])), truth);
            }
        for (double& m : mean) m /= rays;
        // Flat: order 2. Lit: order 1, for normals jump from cell to cell and the middle of a step sees one
        // of them.
        const bool flat = std::string(shading) == "\"flat\"";
        EXPECT_LT(mean[0], flat ? 0.01 : 0.02);
        EXPECT_LT(mean[2], mean[0] / (flat ? 12 : 3));
        EXPECT_LT(mean[3], mean[1] / (flat ? 12 : 3));
        EXPECT_GT(mean[0], 1e-5);
    }
}

class CasterVariants : public testing::TestWithParam<std::tuple<const char*, const char*, const char*>> {};

TEST_P(CasterVariants, FineStepsAreTheTruth) {
    const auto& [interpolation, shading, transfer] = GetParam();
    const PreparedScene scene = rough_scene(test_folder(), interpolation, shading, true, transfer);
    double seen = 0;
    for (int y = 0; y < 16; y += 3)
        for (int x = 0; x < 16; x += 3) {
            const Ray ray = scene.camera.ray(x + 0.5, y + 0.5);
            const Composite truth = integrated(scene, ray);
            EXPECT_LT(difference(composite(cast(scene, ray, 1 / 64.0)), truth), 4e-3) << x << " " << y;
            seen += 1 - truth.clear;
        }
    EXPECT_GT(seen, 3);
}

TEST_P(CasterVariants, SkippingChangesNoBit) {
    const auto& [interpolation, shading, transfer] = GetParam();
    const PreparedScene scene = rough_scene(test_folder(), interpolation, shading, true, transfer);
    const VolumeCaster probe(scene, scene.volumes[0], {.step = 1});
    std::size_t slabs = 0;
    for (const double step : {0.3, 1.0, 5.0, 30.0})
        for (int y = 0; y < 16; ++y)
            for (int x = 0; x < 16; ++x) {
                const Ray ray = scene.camera.ray(x + 0.5, y + 0.5);
                const auto with = cast(scene, ray, step, true);
                const auto without = cast(scene, ray, step, false);
                ASSERT_EQ(with.size(), without.size()) << step << " " << x << " " << y;
                ASSERT_EQ(0, std::memcmp(with.data(), without.data(), with.size() * sizeof(Slab)));
                slabs += with.size();
                expect_sorted(with);
            }
    EXPECT_GT(slabs, 1000);
}

INSTANTIATE_TEST_SUITE_P(All, CasterVariants,
                         testing::Combine(testing::Values("trilinear", "catmull-rom", "nearest"),
                                          testing::Values("\"flat\"", "{ ambient = 0.3, diffuse = 0.7 }"),
                                          testing::Values(kSmooth, kJumps)));

TEST(EmptySpace, DistancesAreThoseToTheNearestBlockOfAnotherKind) {
    const std::array<int, 3> cells{70, 61, 43};  // 9 × 8 × 6 blocks
    std::mt19937_64 random(3);
    for (const double share : {0.02, 0.3}) {
        std::vector<EmptySpace::Kind> kinds(9 * 8 * 6);
        for (auto& k : kinds) {
            const double u = std::uniform_real_distribution<double>(0, 1)(random);
            k = u < share       ? EmptySpace::Kind::visit
                : u < 2 * share ? EmptySpace::Kind::not_a_number
                                : EmptySpace::Kind::clear;
        }
        const auto at = [&](int i, int j, int k) {
            return kinds[static_cast<std::size_t>(i + 9 * (j + 8 * k))];
        };
        const EmptySpace space(cells, [&](const std::array<int, 3>& first, const std::array<int, 3>& end) {
            for (std::size_t a = 0; a < 3; ++a) EXPECT_EQ(end[a], std::min(first[a] + 8, cells[a]));
            return at(first[0] / 8, first[1] / 8, first[2] / 8);
        });
        for (int i = 0; i < 9 * 8 * 6; ++i) {
            const int x = i % 9, y = i / 9 % 8, z = i / 72;
            int nearest = at(x, y, z) == EmptySpace::Kind::visit ? 0 : 255;
            for (int other = 0; other < 9 * 8 * 6 && nearest > 0; ++other)
                if (kinds[static_cast<std::size_t>(other)] != at(x, y, z))
                    nearest =
                        std::min(nearest, std::max({std::abs(other % 9 - x), std::abs(other / 9 % 8 - y),
                                                    std::abs(other / 72 - z)}));
            ASSERT_EQ(space.distance()[static_cast<std::size_t>(i)], nearest) << i;
        }
    }
}

TEST(VolumeCaster, TurningCameraAndVolumeTogetherChangesNothing) {
    const std::string medium =
        volume("x*y + z", kSmooth, "shading = { ambient = 0.1, specular = 0.4 }\nMOVE", 0.4);
    const auto scene_of = [&](const std::string& camera, const std::string& move) {
        std::string text = "image.resolution = [6, 6]\n[camera]\n" + camera + medium;
        return prepare(scene_from(text.replace(text.find("MOVE"), 4, move)));
    };
    const PreparedScene still = scene_of("position = [3, 1, 2]\nup = [0, 1, 0]\n", "");
    // A quarter turn about z, (x, y, z) to (−y, x, z), then moved.
    const PreparedScene turned =
        scene_of("position = [-1.5, 3.25, 3]\ntarget = [-0.5, 0.25, 1]\nup = [-1, 0, 0]\n",
                 "rotate_degrees = [0, 0, 90]\ntranslate = [-0.5, 0.25, 1]");
    for (int i = 0; i < 36; ++i) {
        const auto a = cast(still, still.camera.ray(i % 6 + 0.5, i / 6 + 0.5), 0.6);
        const auto b = cast(turned, turned.camera.ray(i % 6 + 0.5, i / 6 + 0.5), 0.6);
        EXPECT_LT(difference(composite(a), composite(b)), 2e-5) << i;
    }
}

// ---- Isosurfaces ------------------------------------------------------------------------------

std::string sphere_surface(const std::string& interpolation, const std::string& more) {
    return fmt::format(
        "[[surface]]\nisosurface = {{ volume = \"r.nrrd\", isovalue = 9, interpolation = \"{}\" }}\n{}\n",
        interpolation, more);
}
fs::path put_radii(const fs::path& folder) {  // distance from the middle of 31³ samples
    put_volume(folder / "r.nrrd", {31, 31, 31},
               sampled({31, 31, 31}, [](const Vec3& p) { return length(p - Vec3(15.0)); }));
    return folder;
}
constexpr const char* kSphereView =
    "image.resolution = [9, 9]\n[camera]\nposition = [15, 15, 90]\ntarget = [15, 15, 15]\nfov_degrees = 13\n";

TEST(IsosurfaceCaster, FindsBothSidesOfASphere) {
    for (const char* interpolation : {"trilinear", "catmull-rom"}) {
        const PreparedScene scene = prepare(scene_from(
            kSphereView +
                sphere_surface(
                    interpolation,
                    "opacity = 0.4\nopacity_law = \"oblique\"\nshading = \"flat\"\ncolor = [1, 0.5, 0]"),
            put_radii(test_folder())));
        const IsosurfaceCaster caster(scene, scene.objects[0], {.step = 1});
        for (int i = 0; i < 81; ++i) {
            const Ray ray = scene.camera.ray(i % 9 + 0.5, i / 9 + 0.5);
            const Vec3 to_center = Vec3(15.0) - ray.origin;
            const double along = dot(to_center, ray.direction) / dot(ray.direction, ray.direction);
            const double off = length(to_center - along * ray.direction);
            if (std::abs(off - 9) < 0.5) continue;  // grazing
            const bool steep = off < 6;
            std::vector<IsosurfaceCaster::Crossing> found;
            caster.crossings(ray, found);
            if (off > 9) {
                EXPECT_TRUE(found.empty());
                continue;
            }
            ASSERT_EQ(found.size(), 2U) << interpolation << " " << i;
            const double half = std::sqrt(81 - off * off) / length(ray.direction);
            const double cosine = std::sqrt(81 - off * off) / 9;
            EXPECT_NEAR(found[0].t, along - half, 0.05 / cosine);
            EXPECT_NEAR(found[1].t, along + half, 0.05 / cosine);
            EXPECT_NEAR(found[0].opacity, 1 - std::pow(0.6, 1 / cosine), steep ? 0.02 : 0.06);
            EXPECT_NEAR(dot(normalize(found[0].normal),
                            normalize(ray.origin + found[0].t * ray.direction - Vec3(15.0))),
                        1, 5e-3);
            EXPECT_EQ(found[0].color, Vec3(1, 0.5, 0));
        }
    }
}

TEST(IsosurfaceCaster, CrossingsLieOnTheSurfaceAndSkippingChangesNoBit) {
    const PreparedScene scene = prepare(
        scene_from(kSphereView + sphere_surface("trilinear", "opacity = 0.4\nrotate_degrees = [0, 0, 0]"),
                   put_radii(test_folder())));
    const IsosurfaceCaster with(scene, scene.objects[0], {.step = 0.8}),
        without(scene, scene.objects[0], {.step = 0.8, .skip = false});
    for (int i = 0; i < 81; ++i) {
        const Ray ray = scene.camera.ray(i % 9 + 0.5, i / 9 + 0.5);
        std::vector<IsosurfaceCaster::Crossing> a, b;
        with.crossings(ray, a);
        without.crossings(ray, b);
        ASSERT_EQ(a.size(), b.size());
        for (std::size_t k = 0; k < a.size(); ++k) {
            EXPECT_EQ(a[k].t, b[k].t);
            EXPECT_EQ(a[k].color, b[k].color);
            // Ten bisections of a step of 0.8 and a line: a quarter of (0.8/1024)² times a curvature below 1.
            const auto surface = scene.objects[0].geometry->field_surface();
            EXPECT_NEAR(surface->field->value(ray.origin + a[k].t * ray.direction), 0, 1e-6);
        }
    }
}

TEST(IsosurfaceCaster, VirtualSlabsReachTowardsTheViewerAndNotBehindTheEye) {
    const PreparedScene scene = prepare(
        scene_from(kSphereView + sphere_surface("trilinear", "opacity = 0.4"), put_radii(test_folder())));
    const IsosurfaceCaster caster(scene, scene.objects[0], {.step = 1});
    const Ray ray = scene.camera.ray(4.5, 4.5);
    std::vector<IsosurfaceCaster::Crossing> found;
    caster.crossings(ray, found);
    ASSERT_EQ(found.size(), 2U);
    for (const double thickness : {0.0, 1.0, 30.0, 1e30}) {
        SlabList list;
        caster.cast(ray, thickness, list);
        ASSERT_EQ(list.slabs.size(), 2U);
        EXPECT_FLOAT_EQ(list.slabs[0].z, static_cast<float>(found[0].t));
        EXPECT_NEAR(static_cast<double>(list.slabs[0].d), std::min(thickness, found[0].t), 1e-5);
        EXPECT_NEAR(static_cast<double>(list.slabs[1].d), std::min(thickness, found[1].t), 1e-5);
        EXPECT_FLOAT_EQ(list.slabs[0].a, 0.4F);
    }
}

// ---- All volumes together ---------------------------------------------------------------------

Image draw(const PreparedScene& scene, const MultiVolumeSettings& settings = {}) {
    MultiVolumeStats stats;
    return cast_volumes(scene, settings, stats, [](double) {});
}
double at(const Image& image, const char* plane, std::size_t i) {
    return static_cast<double>(image.plane(plane)[i]);
}

TEST(MultiVolume, OneVolumeIsTheCompositeOfItsSlabs) {
    const PreparedScene scene =
        rough_scene(test_folder(), "trilinear", "{ ambient = 0.3, diffuse = 0.7 }", true, kJumps);
    const Image image = draw(scene, {.step = 0.8, .opaque_at = 1});
    for (std::size_t i = 0; i < 256; ++i) {
        const auto slabs =
            cast(scene,
                 scene.camera.ray(static_cast<double>(i % 16) + 0.5, static_cast<double>(i / 16) + 0.5), 0.8);
        const Composite sum = composite(slabs);
        EXPECT_NEAR(at(image, "A", i), 1 - sum.clear, 1e-6);
        EXPECT_NEAR(at(image, "R", i), sum.color.x, 1e-6);
        if (slabs.empty()) {
            EXPECT_EQ(image.plane("Z")[i], std::numeric_limits<float>::infinity());
        } else {
            EXPECT_FLOAT_EQ(image.plane("Z")[i], slabs.front().z - slabs.front().d);
        }
    }
}

TEST(MultiVolume, SkippingChangesNoBit) {
    const PreparedScene one = rough_scene(test_folder(), "trilinear", "\"flat\"", true, kJumps);
    Scene scene = one.settings;
    scene.volumes.push_back(scene.volumes[0]);
    scene.volumes[1].to_world.offset += Vec3(0.3, 0.1, 0.2);
    const PreparedScene two = prepare(scene);
    for (const SlabMixing mixing : {SlabMixing::average, SlabMixing::normalised, SlabMixing::extinction})
        expect_same_planes(draw(two, {.mixing = mixing, .skip = true}),
                           draw(two, {.mixing = mixing, .skip = false}));
}

TEST(MultiVolume, EqualVolumesAddTheirOpacity) {
    const std::string medium = volume("z", "[[-1, 1, 0.2, 0, 0.05], [1, 1, 0.2, 0, 0.7]]", "", 0.7);
    const PreparedScene one = prepare(scene_from(head() + medium)),
                        two = prepare(scene_from(head() + medium + medium));
    const double clear = 1 - at(draw(one, {.opaque_at = 1}), "A", 4);
    for (const SlabMixing mixing : {SlabMixing::average, SlabMixing::normalised, SlabMixing::extinction}) {
        const Image image = draw(two, {.mixing = mixing, .opaque_at = 1});
        EXPECT_NEAR(1 - at(image, "A", 4), clear * clear, 1e-6);
        EXPECT_NEAR(at(image, "R", 4), 1 - clear * clear, 1e-6);  // one colour stays itself
        EXPECT_NEAR(at(image, "G", 4), 0.2 * (1 - clear * clear), 1e-6);
    }
}

TEST(MultiVolume, OverlappingMediaWithExtinctionAreTheTruth) {
    const std::string a = volume("x + 2*z", kSmooth, "rotate_degrees = [10, 20, 30]", 0.4);
    const std::string b = volume("y - z", kSmooth, "translate = [0.3, 0.1, 0.4]", 0.3);
    const PreparedScene scene = prepare(scene_from(head(4, 3) + a + b));
    const Image image = draw(scene, {.step = 1 / 32.0, .mixing = SlabMixing::extinction, .opaque_at = 1});
    for (std::size_t i = 0; i < 16; ++i) {
        const Composite truth = integrated(
            scene, scene.camera.ray(static_cast<double>(i % 4) + 0.5, static_cast<double>(i / 4) + 0.5));
        EXPECT_NEAR(at(image, "A", i), 1 - truth.clear, 1e-3);
        EXPECT_NEAR(at(image, "R", i), truth.color.x, 1e-3);
        EXPECT_NEAR(at(image, "B", i), truth.color.z, 1e-3);
    }
}

TEST(MultiVolume, MixingRulesOfTwoAreThePublishedOnes) {
    const std::array<Slab, 2> two{Slab{2, 1, 0.3F, 0, 0.1F, 0.4F}, Slab{2, 1, 0, 0.6F, 0, 0.75F}};
    const Slab average = mix_shared(two, SlabMixing::average);
    EXPECT_FLOAT_EQ(average.a, 0.85F);
    EXPECT_FLOAT_EQ(average.r, 0.3F - 0.5F * 0.3F * 0.75F);
    EXPECT_FLOAT_EQ(average.g, 0.6F - 0.5F * 0.6F * 0.4F);
    const Slab normalised = mix_shared(two, SlabMixing::normalised);
    EXPECT_FLOAT_EQ(normalised.r, 0.85F * 0.3F / 1.15F);
    const Slab extinction = mix_shared(two, SlabMixing::extinction);
    const double s1 = -std::log(0.6), s2 = -std::log(0.25);
    EXPECT_NEAR(extinction.r, 0.85 * (s1 * 0.75) / (s1 + s2), 1e-6);
    EXPECT_NEAR(extinction.g, 0.85 * (s2 * 0.8) / (s1 + s2), 1e-6);
    const std::array<Slab, 2> walls{Slab{2, 1, 1, 0, 0, 1}, Slab{2, 1, 0, 1, 0, 1}};
    for (const SlabMixing mixing : {SlabMixing::average, SlabMixing::normalised, SlabMixing::extinction}) {
        EXPECT_FLOAT_EQ(mix_shared(walls, mixing).r, 0.5F);
        EXPECT_FLOAT_EQ(mix_shared(walls, mixing).a, 1);
    }
}

TEST(MultiVolume, SurfacesLieInOrderBetweenThePartsOfAStep) {
    const fs::path folder = put_radii(test_folder());
    // A blue medium all over, a red sphere of radius 9 in it; the ray through the middle.
    const PreparedScene scene = prepare(scene_from(
        kSphereView + sphere_surface("trilinear", "opacity = 0.3\nshading = \"flat\"\ncolor = [1, 0, 0]") +
            "[[volume]]\nfile = \"r.nrrd\"\nopacity_step = 10\ntransfer = [[0, 0, 0, 1, 0.5]]\n",
        folder));
    for (const double step : {0.37, 1.0, 40.0}) {
        const Image image = draw(scene, {.step = step, .opaque_at = 1});
        const double outside = std::pow(0.5, 0.6), inside = std::pow(0.5, 1.8);
        EXPECT_NEAR(at(image, "R", 40), 0.3 * outside + 0.7 * outside * inside * 0.3, 1e-4);
        EXPECT_NEAR(at(image, "B", 40),
                    1 - outside + 0.7 * outside * (1 - inside) + 0.49 * outside * inside * (1 - outside),
                    1e-4);
        EXPECT_NEAR(at(image, "Z", 40), 60, 1e-3);
    }
}

TEST(MultiVolume, MoreRaysAreTheMeanOfTheirPixels) {
    const std::string medium = volume("x + y*z", kSmooth, "", 0.4);
    const Image fine = draw(prepare(scene_from(head(6, 2.1) + medium)));
    const Image coarse = draw(prepare(scene_from(head(2, 2.1) + medium)), {.rays = 3});
    for (std::size_t i = 0; i < 4; ++i) {
        double sum = 0;
        for (std::size_t k = 0; k < 9; ++k)
            sum += at(fine, "A", 3 * (i % 2) + k % 3 + 6 * (3 * (i / 2) + k / 3));
        EXPECT_NEAR(at(coarse, "A", i), sum / 9, 1e-6);
    }
}

Image render(const std::string& toml, const std::string& settings = "") {
    const PreparedScene scene = prepare(scene_from(toml));
    const Config config = Config::parse("[mdvr]\n" + settings, "test.toml", "/");
    RenderStats stats;
    const RenderInput input{scene, config.root().table("mdvr"), {}, {}};
    const Method& method = method_by_name("mdvr");
    EXPECT_FALSE(method.plan(input).empty());
    return method.render(input, stats);
}

TEST(Mdvr, SheetsLieBetweenThePartsOfAMediumAtEveryRay) {
    const auto sheet = [](double z, const char* color, double opacity) {
        return fmt::format(
            "[[surface]]\nrectangle = {{ center = [0, 0, {}] }}\ncolor = [{}]\nopacity = {}\nshading = "
            "\"flat\"\n",
            z, color, opacity);
    };
    // Blue medium of 0.5 a unit; sheets in front, inside of a cell, on a face of cells, behind.
    const std::string medium = volume("1", "[[0, 0, 0, 1, 0.5]]", "", 1);
    double clear = 1, r = 0, g = 0, b = 0;
    const auto pass = [&](double& sum, double alpha) {
        sum += clear * alpha;
        clear *= 1 - alpha;
    };
    pass(r, 0.3);
    pass(b, 1 - std::pow(0.5, 0.8));
    pass(g, 0.4);
    pass(b, 1 - std::pow(0.5, 0.7));
    pass(r, 0.2);
    pass(b, 1 - std::pow(0.5, 0.5));
    pass(g, 1);
    const std::string toml = head(5) + medium + sheet(1.5, "1, 0, 0", 0.3) + sheet(0.2, "0, 1, 0", 0.4) +
                             sheet(-0.5, "1, 0, 0", 0.2) + sheet(-2, "0, 1, 0", 1);
    for (const char* settings :
         {"opaque_at = 1", "opaque_at = 1\nrays = 3\nstep = 0.37", "opaque_at = 1\nskip = false\nstep = 9"}) {
        const Image image = render(toml, settings);
        for (std::size_t i = 0; i < 25; ++i) {
            EXPECT_NEAR(at(image, "R", i), r, 2e-6);
            EXPECT_NEAR(at(image, "G", i), g, 2e-6);
            EXPECT_NEAR(at(image, "B", i), b, 2e-6);
            EXPECT_NEAR(at(image, "A", i), 1, 1e-6);
            EXPECT_NEAR(at(image, "Z", i), 2.5, 1e-6);
        }
    }
}

TEST(Mdvr, DrawsSurfacesWithoutVolumes) {
    const Image image =
        render(head(8, 3) +
               "[[surface]]\nimplicit = \"sphere\"\nopacity = 0.5\nshading = \"flat\"\ncolor = [1, 1, 1]\n");
    EXPECT_NEAR(at(image, "A", 8 * 4 + 4), 0.75, 1e-6);
    EXPECT_NEAR(at(image, "Z", 8 * 4 + 4), 4 - std::sqrt(1 - 2 * 0.1875 * 0.1875), 0.1);
    EXPECT_EQ(at(image, "A", 0), 0);
    EXPECT_EQ(at(image, "Z", 0), kInfinity);
}

TEST(Mdvr, RefusesContours) {
    const Method& method = method_by_name("mdvr");
    const auto why = method.refusal(
        scene_from(head() + "[[surface]]\nname = \"ring\"\nimplicit = \"torus\"\ncontours = [{ field = "
                            "\"y\", spacing = 0.2, width_px = 2, color = [0, 0, 0] }]\n"));
    ASSERT_TRUE(why.has_value());
    EXPECT_NE(why->find("ring"), std::string::npos);
    EXPECT_FALSE(method.refusal(scene_from(head() + volume("1", "[[0, 1, 1, 1, 0.5]]"))).has_value());
}

}  // namespace
}  // namespace pellucid
