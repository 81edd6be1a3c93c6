// Volumes and slices in the ray-traced truth, against closed forms and a plain march in small steps.
#include <random>

#include "core/error.hpp"
#include "reference/volume_rays.hpp"
#include "scene/shading.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

Image trace(const std::string& toml, const TruthSettings& settings = {.max_error = 1e-5},
            const fs::path& folder = "/") {
    TruthStats stats;
    return trace_truth(prepare(scene_from(toml, folder)), settings, stats);
}
double at(const Image& image, const char* plane, int x = 1, int y = 1) {
    return static_cast<double>(image.plane(plane)[static_cast<std::size_t>(y * image.width() + x)]);
}
/// Orthographic from +z, 3 × 3 pixels: rays run from z = 4 down.
std::string head(double view = 0.3) {
    return fmt::format(
        "image.resolution = [3, 3]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, "
        "4]\nview_height = {}\n",
        view);
}
std::string volume(const std::string& expression, const std::string& transfer, const std::string& more = "",
                   double step = 0.5) {
    return fmt::format(
        "[[volume]]\nexpression = \"{}\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nresolution = 5\ntransfer = "
        "{}\nopacity_step = {}\n{}\n",
        expression, transfer, step, more);
}

TEST(VolumeTruth, HomogeneousMediumIsBeersLaw) {
    const std::string toml = head() + volume("1", "[[0, 0.2, 0.4, 1, 0.3], [2, 0.2, 0.4, 1, 0.3]]");
    for (const PixelFilter filter : {PixelFilter::box, PixelFilter::particle}) {
        const Image image = trace(toml, {.filter = filter});
        const double alpha = 1 - std::pow(0.7, 4);
        EXPECT_NEAR(at(image, "A"), alpha, 1e-6);
        EXPECT_NEAR(at(image, "R"), 0.2 * alpha, 1e-6);
        EXPECT_NEAR(at(image, "B"), alpha, 1e-6);
        EXPECT_NEAR(at(image, "Z"), 3, 0.5);  // the middle of the nearest layer, of a cell of ½
    }
}

TEST(VolumeTruth, OpacityRampToOneHasItsClosedForm) {
    // α = v = (1 + z)/2 from 0 to 1: ∫ −ln(1 − v) dz = 2·∫₀¹ −ln(1 − v) dv = 2.
    const std::string ramp = "[[0, 1, 1, 1, 0], [1, 1, 1, 1, 1]]";
    const double expected = 1 - std::exp(-2 / 4.0);
    EXPECT_NEAR(at(trace(head() + volume("0.5 + 0.5*z", ramp, "", 4)), "A"), expected, 2e-6);
    EXPECT_NEAR(at(trace(head() + volume("0.5 - 0.5*z", ramp, "", 4)), "A"), expected, 2e-6);
    EXPECT_NEAR(at(trace(head() + volume("0.5 - 0.5*z", ramp, "interpolation = \"catmull-rom\"", 4)), "A"),
                expected, 2e-6);
    EXPECT_NEAR(
        at(trace(head() + volume("0.5 - 0.5*z", ramp, "", 4), {.filter = PixelFilter::particle}), "A"),
        expected, 2e-6);
}

TEST(VolumeTruth, ColourRampInAConstantMediumHasItsClosedForm) {
    // c = s/2 after a way of s, σ = ln 2: ∫₀² (s/2) σ e^(−σ s) ds.
    const Image image = trace(head() + volume("z", "[[-1, 1, 0, 0, 0.5], [1, 0, 0, 0, 0.5]]", "", 1));
    const double sigma = std::log(2.0);
    EXPECT_NEAR(at(image, "R"), 0.5 * (1 / sigma - (2 + 1 / sigma) * std::exp(-2 * sigma)), 1e-6);
    EXPECT_NEAR(at(image, "A"), 0.75, 1e-6);
    EXPECT_NEAR(at(trace(head() + volume("z", "[[-1, 1, 0, 0, 0.5], [1, 0, 0, 0, 0.5]]", "", 1),
                         {.filter = PixelFilter::particle}),
                   "R"),
                at(image, "R"), 2e-4);  // layers of τ = 0.05 in which colour changes by 1/32: (τ·Δc)/12
}

TEST(VolumeTruth, OverlappingMediaAddTheirExtinctions) {
    // Red in z = −1 … 1 (τ = 0.5 a unit), green in z = −2 … 0.3, offset by its placement (τ = 0.8 a unit).
    const auto constant = [](const char* color, double depth, const std::string& more) {
        return volume("1", fmt::format("[[0, {}, {}]]", color, 1 - std::exp(-depth)), more, 1);
    };
    const std::string red = constant("1, 0, 0", 0.5, "");
    const std::string green = constant("0, 1, 0", 0.8, "scale = [1, 1, 1.15]\ntranslate = [0, 0, -0.85]\n");
    const double first = std::exp(-0.5 * 0.7);
    const double both = std::exp(-1.3 * 1.3);
    const double r = 1 - first + first * (1 - both) * (0.5 / 1.3);
    const double g = first * (1 - both) * (0.8 / 1.3) + first * both * (1 - std::exp(-0.8));
    for (const std::string& toml : {head() + red + green, head() + green + red})
        for (const PixelFilter filter : {PixelFilter::box, PixelFilter::particle}) {
            const Image image = trace(toml, {.filter = filter});
            EXPECT_NEAR(at(image, "R"), r, 2e-6);
            EXPECT_NEAR(at(image, "G"), g, 2e-6);
            EXPECT_NEAR(at(image, "A"), 1 - first * both * std::exp(-0.8), 2e-6);
        }
}

TEST(VolumeTruth, SurfacesLieInOrderBetweenTheParts) {
    const auto sheet = [](double z, const char* color, double opacity) {
        return fmt::format(
            "[[surface]]\nrectangle = {{ center = [0, 0, {}] }}\ncolor = [{}]\nopacity = {}\nshading = "
            "\"flat\"\n",
            z, color, opacity);
    };
    // Blue medium of 0.5 a unit; sheets in front, inside of a cell, on a face of cells, behind.
    const std::string medium = volume("1", "[[0, 0, 0, 1, 0.5]]", "", 1);
    const Image image = trace(head() + medium + sheet(1.5, "1, 0, 0", 0.3) + sheet(0.2, "0, 1, 0", 0.4) +
                              sheet(-0.5, "1, 0, 0", 0.2) + sheet(-2, "0, 1, 0", 1));
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
    EXPECT_NEAR(at(image, "R"), r, 1e-6);
    EXPECT_NEAR(at(image, "G"), g, 1e-6);
    EXPECT_NEAR(at(image, "B"), b, 1e-6);
    EXPECT_NEAR(at(image, "Z"), 2.5, 1e-6);
}

TEST(VolumeTruth, JumpsCutWhereTheyAre) {
    // Half-transparent a unit above 0.3, nothing below; a peak 1e-3 wide is not missed.
    EXPECT_NEAR(
        at(trace(head() +
                 volume("z", "[[-1, 1, 1, 1, 0], [0.3, 1, 1, 1, 0], [0.3, 1, 1, 1, 0.5], [1, 1, 1, 1, 0.5]]",
                        "", 1)),
           "A"),
        1 - std::pow(0.5, 0.7), 1e-6);
    EXPECT_NEAR(
        at(trace(
               head() +
               volume("z + 0.001*x",
                      "[[0.1, 1, 1, 1, 0], [0.1, 1, 1, 1, 0.5], [0.101, 1, 1, 1, 0.5], [0.101, 1, 1, 1, 0]]",
                      "", 1e-3)),
           "A"),
        0.5, 1e-5);
    // At the value itself what follows counts: a plateau that has exactly that value.
    EXPECT_NEAR(at(trace(head() + volume("1", "[[1, 1, 1, 1, 0], [1, 1, 1, 1, 0.5]]",
                                         "rotate_degrees = [0, 0, 17]", 1)),
                   "A"),
                0.75, 1e-6);
}

TEST(VolumeTruth, OpacityOneBlocksExactly) {
    // Clear red medium down to z = 0.25, then solid green that turns blue below.
    const Image image =
        trace(head() +
              volume("z", "[[-1, 0, 0, 1, 1], [0.25, 0, 1, 0, 1], [0.25, 1, 0, 0, 0.5], [1, 1, 0, 0, 0.5]]",
                     "", 1) +
              "[[surface]]\nrectangle = { center = [0, 0, -0.5] }\nshading = \"flat\"\n");
    const double clear = std::pow(0.5, 0.75);
    EXPECT_NEAR(at(image, "R"), 1 - clear, 1e-6);
    EXPECT_NEAR(at(image, "G"), clear, 1e-6);
    EXPECT_NEAR(at(image, "B"), 0, 1e-6);
    EXPECT_EQ(at(image, "A"), 1);
}

TEST(VolumeTruth, LabelsReachHalfWayToTheirNeighbours) {
    const fs::path folder = test_folder();
    // Labels 0 1 2 along z at 0, 1, 2: label 1 fills 0.5 … 1.5, label 2 1.5 … 2.
    put_volume(folder / "l.nrrd", {2, 2, 3}, sampled({2, 2, 3}, [](const Vec3& p) { return p.z; }));
    const std::string toml =
        "image.resolution = [1, 1]\n[camera]\nprojection = \"orthographic\"\nposition = [0.5, 0.5, "
        "9]\ntarget = [0.5, 0.5, 0]\nview_height = 0.1\n"
        "[[volume]]\nfile = \"l.nrrd\"\ninterpolation = \"nearest\"\nopacity_step = 1\n"
        "transfer = [[0, 0, 0, 0, 0], [0.5, 0, 0, 0, 0], [0.5, 1, 0, 0, 0.4], [1.5, 1, 0, 0, 0.4], [1.5, 0, "
        "1, 0, 0.7]]\n";
    const Image image = trace(toml, {.max_error = 1e-5}, folder);
    EXPECT_NEAR(at(image, "G", 0, 0), 1 - std::sqrt(0.3), 1e-6);
    EXPECT_NEAR(at(image, "R", 0, 0), std::sqrt(0.3) * 0.4, 1e-6);
}

/// The same integral by small steps and VolumeField alone: value, clip planes, shading, all volumes.
struct Marched {
    Vec3 color{0.0};
    double clear = 1;
};
Marched march(const PreparedScene& scene, const Ray& ray, int steps) {
    const double near = scene.camera.near(), far = scene.camera.far();
    Marched sum;
    const double way = (far - near) / steps * length(ray.direction);
    for (int i = 0; i < steps; ++i) {
        const Vec3 world = ray.origin + (near + (far - near) * (i + 0.5) / steps) * ray.direction;
        double extinction = 0;
        Vec3 emission(0.0);
        for (const VolumeObject& volume : scene.volumes) {
            const Vec3 index = volume.to_index().point(world);
            const double value = volume.field().value(index);
            bool kept = std::isfinite(value);
            for (const ClipPlane& plane : volume.settings().clip)
                kept = kept && dot(plane.normal, world) <= plane.offset;
            if (!kept) continue;
            const double sigma = -std::log(1 - volume.transfer().opacity(value)) / volume.opacity_step();
            Vec3 color = volume.transfer().color(value);
            const Vec3 gradient = volume.field().jet(index).gradient;
            if (!volume.settings().shading.flat && gradient != Vec3(0.0)) {
                // One headlight: n·l = |cos| between gradient and ray, in the world.
                const Vec3 normal = glm::transpose(glm::inverse(volume.to_world().linear)) * gradient;
                const double cosine =
                    std::abs(dot(normal, ray.direction)) / (length(normal) * length(ray.direction));
                color =
                    color * (volume.settings().shading.ambient + volume.settings().shading.diffuse * cosine);
            }
            extinction += sigma;
            emission += sigma * color;
        }
        if (extinction == 0) continue;
        const double alpha = 1 - std::exp(-extinction * way);
        sum.color += sum.clear * alpha * (emission / extinction);
        sum.clear *= 1 - alpha;
    }
    return sum;
}

class VolumeMarch : public testing::TestWithParam<std::tuple<const char*, const char*>> {};

TEST_P(VolumeMarch, RaysEqualSmallSteps) {
    const auto& [interpolation, shading] = GetParam();
    const fs::path folder = test_folder();
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    put_volume(folder / "noise.nrrd", {6, 5, 7},
               sampled({6, 5, 7}, [&](const Vec3& p) { return p.x > 3 && p.y < 2 ? 0.05 : unit(random); }),
               {0.4, 0.5, 0.3});
    std::vector<float> holes = sampled({5, 5, 5}, [&](const Vec3&) { return unit(random); });
    holes[62] = std::numeric_limits<float>::quiet_NaN();
    put_volume(folder / "holes.nrrd", {5, 5, 5}, holes, Vec3(0.3));
    const std::string transfer =
        "transfer = [[0.1, 1, 0, 0, 0], [0.4, 0, 1, 0, 0.2], [0.6, 0, 0, 1, 0.05], [0.6, 1, 1, 0, 0.3], "
        "[0.9, 1, 1, 1, 0.6]]\n";
    const std::string toml =
        "image.resolution = [4, 4]\n[camera]\nposition = [3, 2.5, 4]\ntarget = [0.2, 0, 0.2]\nfov_degrees = "
        "25\n"
        "[[volume]]\nfile = \"noise.nrrd\"\nmatrix = [0.9,0.2,0,-0.8, -0.3,1,0.1,-0.9, 0,0.2,-1,0.9, "
        "0,0,0,1]\n"
        "clip = [{ normal = [1, 0.2, 0], offset = 0.5 }]\n" +
        transfer + fmt::format("interpolation = \"{}\"\nshading = {}\n", interpolation, shading) +
        "[[volume]]\nfile = \"holes.nrrd\"\nrotate_degrees = [20, 30, 40]\nopacity_step = 0.2\n" + transfer;
    const PreparedScene scene = prepare(scene_from(toml, folder));
    VolumeRay volumes(scene, {.tolerance = 1e-6});
    std::vector<VolumeLayer> layers;
    double worst = 0, seen = 0;
    for (int i = 0; i < 30; ++i) {
        const Ray ray = scene.camera.ray(4 * unit(random), 4 * unit(random));
        layers.clear();
        volumes.start(ray);
        // In two parts, as a surface would cut it.
        volumes.advance(0.3 * scene.camera.near() + 0.7 * scene.camera.far(), 1, 1e-12, layers);
        double clear = 1;
        for (const VolumeLayer& layer : layers) clear *= std::exp(-layer.optical_depth);
        volumes.advance(kInfinity, clear, 1e-12, layers);
        Marched sum;
        for (const VolumeLayer& layer : layers) {
            sum.color += sum.clear * (1 - std::exp(-layer.optical_depth)) * layer.color;
            sum.clear *= std::exp(-layer.optical_depth);
        }
        const Marched expected = march(scene, ray, 10000);
        worst = std::max(worst, std::abs(sum.clear - expected.clear));
        for (int c = 0; c < 3; ++c) worst = std::max(worst, std::abs(sum.color[c] - expected.color[c]));
        seen += 1 - expected.clear;
    }
    EXPECT_GT(seen, 5);
    // Steps of 4e-4 that straddle jumps of up to 3 a unit: up to some 5e-4 for each of a few.
    EXPECT_LT(worst, 1.5e-3);
}

INSTANTIATE_TEST_SUITE_P(All, VolumeMarch,
                         testing::Combine(testing::Values("trilinear", "catmull-rom", "nearest"),
                                          testing::Values("\"flat\"", "{ ambient = 0.3, diffuse = 0.7 }")));

TEST(VolumeTruth, CoarseToleranceKeepsItsBound) {
    const std::string toml =
        "image.resolution = [5, 5]\ncamera.position = [1, 2, 4]\n" +
        volume("sin(9*x)*cos(7*y) + z",
               "[[-1, 1, 0, 0, 0], [0.2, 0, 1, 0, 0.7], [0.2, 1, 1, 1, 0.1], [1, 0, 0, 1, 0.9]]",
               "shading = { specular = 0.5 }", 0.3);
    const PreparedScene scene = prepare(scene_from(toml));
    for (const double tolerance : {1e-3, 1e-4, 1e-5}) {
        VolumeRay coarse(scene, {.tolerance = tolerance}), fine(scene, {.tolerance = 1e-8});
        for (int i = 0; i < 25; ++i) {
            Marched sum[2];
            for (int k = 0; k < 2; ++k) {
                VolumeRay& volumes = k == 0 ? coarse : fine;
                std::vector<VolumeLayer> layers;
                volumes.start(scene.camera.ray(i % 5 + 0.37, i / 5 + 0.61));
                volumes.advance(kInfinity, 1, 1e-12, layers);
                for (const VolumeLayer& layer : layers) {
                    sum[k].color += sum[k].clear * (1 - std::exp(-layer.optical_depth)) * layer.color;
                    sum[k].clear *= std::exp(-layer.optical_depth);
                }
            }
            EXPECT_NEAR(sum[0].clear, sum[1].clear, tolerance) << i;
            for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[0].color[c], sum[1].color[c], 1.5 * tolerance) << i;
        }
    }
}

TEST(VolumeTruth, IsosurfacesOfTheLeastNumbersAreThereAsWell) {
    // float32 has 1e-39 with fewer digits only; flushed to zero such samples have no surface.
    const fs::path folder = test_folder();
    const auto picture = [&](double unit, const char* interpolation) {
        const std::string file = fmt::format("v{}.nrrd", unit < 1e-30 ? "small" : "large");
        put_volume(folder / file, {17, 17, 17},
                   sampled({17, 17, 17}, [&](const Vec3& p) { return unit * (1 + length(p - Vec3(8.0)) / 2); }));
        return trace(fmt::format("image.resolution = [16, 16]\n[camera]\nposition = [8, 8, 60]\ntarget = [8, 8, 8]\n"
                                 "fov_degrees = 18\n[[surface]]\nisosurface = {{ volume = \"{}\", isovalue = {}, "
                                 "interpolation = \"{}\" }}\nopacity = 0.5\nshading = \"flat\"\n",
                                 file, 3.5 * unit, interpolation),
                     {.samples = 16}, folder);
    };
    for (const char* interpolation : {"trilinear", "catmull-rom"}) {
        const Image large = picture(1, interpolation), small = picture(1e-39, interpolation);
        double sum = 0, off = 0;
        for (std::size_t i = 0; i < large.pixel_count(); ++i) {
            const auto a = static_cast<double>(large.plane("A")[i]);
            // Six digits are left: a ray at the rim may pass, one of 16.
            EXPECT_NEAR(static_cast<double>(small.plane("A")[i]), a, 0.06) << interpolation << i;
            off += std::abs(static_cast<double>(small.plane("A")[i]) - a);
            sum += a;
        }
        EXPECT_GT(sum, 20);
        EXPECT_LT(off, 0.1);
    }
}

TEST(VolumeTruth, WorkForOneRayHasABound) {
    // Steps of 1e-30: what is thin in exact numbers is thick in the last digit.
    const std::string toml = "image.resolution = [5, 5]\ncamera.position = [1, 2, 4]\n" +
                             volume("sin(9*x)*cos(7*y) + z", "[[-1, 1, 0, 0, 0], [0.2, 0, 1, 0, 0.7], [0.2, 1, 1, 1, 0.1], [1, 0, 0, 1, 0.9]]",
                                    "", 1e-30);
    const PreparedScene scene = prepare(scene_from(toml));
    for (const bool pooled : {false, true}) {
        VolumeRay volumes(scene, {.tolerance = 1e-4, .pooled = pooled});
        for (int i = 0; i < 25; ++i) {
            std::vector<VolumeLayer> layers;
            volumes.start(scene.camera.ray(i % 5 + 0.37, i / 5 + 0.61), 1.0 / 64);
            volumes.advance(kInfinity, 1, 1e-9, layers);
            double depth = 0;
            for (const VolumeLayer& layer : layers) depth += layer.optical_depth;
            EXPECT_LE(layers.size(), VolumeRay::kMostHalvings + 100U) << i;
            EXPECT_TRUE(depth == 0 || depth > 20) << i;
        }
    }
}

TEST(VolumeTruth, OneSampleAlongAnAxisDrawsNothing) {
    const fs::path folder = test_folder();
    put_volume(folder / "flat.nrrd", {4, 4, 1}, std::vector<float>(16, 1.0F));
    const Image image =
        trace(head(3) + "[[volume]]\nfile = \"flat.nrrd\"\ntransfer = [[0, 1, 1, 1, 0.5]]\n", {}, folder);
    for (const float a : image.plane("A")) EXPECT_EQ(a, 0);
}

TEST(VolumeTruth, SlicesShowTheVolumeWhereTheyStand) {
    const fs::path folder = test_folder();
    put_volume(folder / "x.nrrd", {5, 5, 5}, sampled({5, 5, 5}, [](const Vec3& p) { return p.x; }));
    // The hull ends at 4; the slice goes on. Pixels of ¼ at x = 0.125, 0.375 …
    const std::string toml =
        "image.resolution = [24, 1]\n[camera]\nprojection = \"orthographic\"\nposition = [3, 2, 20]\ntarget "
        "= [3, 2, 0]\nview_height = 0.25\n"
        "[[surface]]\nname = \"s\"\nopacity = 0.5\nshading = \"flat\"\n"
        "slice = { volume = \"x.nrrd\", center = [3, 2, 4], u = [3, 0, 0], v = [0, 2, 0], transfer = [[0, 0, "
        "0, 1, 0], [4, 1, 0, 1, 0.8]] }\n";
    const Image image = trace(toml, {.max_error = 1e-4}, folder);
    for (int i = 0; i < 16; ++i) {
        const double x = 0.125 + 0.25 * i;
        EXPECT_NEAR(at(image, "A", i, 0), 0.5 * 0.2 * x, 1e-3) << i;
        EXPECT_NEAR(at(image, "R", i, 0), 0.5 * 0.2 * x * x / 4, 2e-3) << i;
    }
    for (int i = 16; i < 24; ++i) EXPECT_EQ(at(image, "A", i, 0), 0) << i;
    // Placement moves volume and slice together.
    const Image moved = trace(toml + "translate = [1, 0, 0]\n", {.max_error = 1e-4}, folder);
    EXPECT_NEAR(at(moved, "A", 7, 0), at(image, "A", 3, 0), 1e-3);
}

TEST(Transfer, IsLinearBetweenPointsAndJumpsAtRepeatedValues) {
    const TransferFunction f({{0, 0, 0, 0, 0.1}, {1, 1, 0.5, 0, 0.3}, {1, 0, 0, 1, 0.6}, {3, 0, 1, 1, 1}});
    EXPECT_DOUBLE_EQ(f.opacity(-5), 0.1);
    EXPECT_DOUBLE_EQ(f.opacity(0.5), 0.2);
    EXPECT_DOUBLE_EQ(f.color(0.5).x, 0.5);
    EXPECT_DOUBLE_EQ(f.opacity(1), 0.6);
    EXPECT_NEAR(f.opacity(std::nextafter(1.0, 0.0)), 0.3, 1e-12);
    EXPECT_DOUBLE_EQ(f.opacity(2), 0.8);
    EXPECT_EQ(f.opacity(3), 1);
    EXPECT_EQ(f.opacity(99), 1);
    EXPECT_EQ(f.opacity(std::nan("")), 0);
    EXPECT_EQ(f.opacity(kInfinity), 0);
    EXPECT_EQ(f.most_opacity(2, 1), 0);
    EXPECT_DOUBLE_EQ(f.most_opacity(0.2, 1), 0.6);
    EXPECT_DOUBLE_EQ(f.most_opacity(1, 1), 0.6);
    EXPECT_EQ(f.brightest(), Vec3(1, 1, 1));
}

TEST(Transfer, LargestOpacityOfAnIntervalIsSureAndMet) {
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> unit(0, 1);
    for (int round = 0; round < 200; ++round) {
        std::vector<TransferPoint> points;
        double value = 0;
        for (int i = 0; i < 6; ++i) {
            if (unit(random) < 0.7) value += unit(random);
            points.push_back({value, unit(random), unit(random), unit(random), unit(random)});
        }
        const TransferFunction f(points);
        const double lo = -0.5 + 4 * unit(random);
        const double hi = lo + unit(random);
        double most = 0;
        for (int i = 0; i <= 2000; ++i) most = std::max(most, f.opacity(lo + (hi - lo) * i / 2000));
        EXPECT_GE(f.most_opacity(lo, hi) + 1e-12, most);
        // Both sides of a jump count; where there is none inside, the bound is met.
        bool jump = false;
        for (std::size_t i = 0; i + 1 < points.size(); ++i)
            jump = jump || (points[i][0] == points[i + 1][0] && points[i][0] >= lo && points[i][0] <= hi);
        if (!jump) {
            EXPECT_LE(f.most_opacity(lo, hi), most + 0.02);
        }
    }
}

TEST(VolumeObject, RangesHoldEveryValue) {
    std::mt19937_64 random(11);
    std::uniform_real_distribution<double> unit(0, 1);
    const fs::path folder = test_folder();
    put_volume(folder / "v.nrrd", {9, 7, 5}, sampled({9, 7, 5}, [&](const Vec3&) { return unit(random); }));
    for (const char* interpolation : {"trilinear", "catmull-rom", "nearest"}) {
        const PreparedScene scene = prepare(scene_from(
            head() +
                fmt::format(
                    "[[volume]]\nfile = \"v.nrrd\"\ntransfer = [[0, 1, 1, 1, 0.5]]\ninterpolation = \"{}\"\n",
                    interpolation),
            folder));
        const VolumeObject& v = scene.volumes[0];
        for (int i = 0; i < 20000; ++i) {
            const Vec3 p(8 * unit(random), 6 * unit(random), 4 * unit(random));
            std::array<int, 3> cell{}, end{};
            for (int a = 0; a < 3; ++a) {
                cell[static_cast<std::size_t>(a)] = static_cast<int>(std::floor(p[a] + v.cell_shift()));
                end[static_cast<std::size_t>(a)] = cell[static_cast<std::size_t>(a)] + 1;
            }
            const ValueRange range = v.range(cell, end);
            const double value = v.value(p);
            ASSERT_NEAR(value, v.field().value(p), 1e-6);
            ASSERT_LE(range.lo, value) << interpolation;
            ASSERT_GE(range.hi, value) << interpolation;
        }
    }
}

}  // namespace
}  // namespace pellucid
