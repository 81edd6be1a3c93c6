// Particle rendering judged against the ray-traced truth of its own pixel filter.
//
// Level of every judgement: 99.9 % over the whole family of scenes (Šidák). What it can see: the total
// over all pixels sees a common relative bias of the opacity of about 4/sqrt(pixels·repeats), 1 % here; KS
// sees a distortion of the p-values' distribution of about 2/sqrt(pixels), 6 % at 1000 pixels.
#include <cstring>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

struct Case {
    const char* name;
    std::string toml;
    std::uint32_t repeats = 200;
};

void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

const std::string kPerspective = "image.resolution = [24, 20]\ncamera.position = [0.3, 0.4, 4]\n";
const std::string kOrthographic =
    "image.resolution = [24, 20]\n[camera]\nprojection = \"orthographic\"\nposition = [0.3, 0.4, 4]\nview_height = 3\n";

std::string surface(const std::string& body) { return "[[surface]]\n" + body + "\n"; }

std::vector<Case> cases() {
    return {
        {"translucent_torus_perspective",
         kPerspective + surface("implicit = \"torus\"\nopacity = 0.4\nrotate_degrees = [60, 20, 0]")},
        {"oblique_torus_orthographic", kOrthographic + surface("implicit = \"torus\"\nopacity = 0.3\nopacity_law = "
                                                               "\"oblique\"\nrotate_degrees = [70, 20, 0]")},
        {"object_below_a_pixel",
         "image.resolution = [7, 7]\ncamera.position = [0, 0, 1000]\n" +
             surface("implicit = \"sphere\"\nscale = 20\nopacity = 0.7\ntranslate = [38, 39, 0]"),
         20000},
        {"camera_inside_a_sphere", "image.resolution = [24, 20]\ncamera.position = [0.3, 0.2, 0.1]\ncamera.fov_degrees = 100\n" +
                                       surface("implicit = \"sphere\"\nopacity = 0.5")},
        {"implicit_ground_plane_to_the_horizon",
         "image.resolution = [24, 20]\ncamera.position = [0.1, 0.3, 0.2]\ncamera.target = [3, 0.1, 1]\n" +
             surface("implicit = \"plane\"\nrotate_degrees = [90, 0, 0]\nscale = 300\nopacity = 0.5")},
        {"rectangle_ground_plane_to_the_horizon_oblique",
         "image.resolution = [24, 20]\ncamera.position = [0.1, 0.3, 0.2]\ncamera.target = [3, 0.1, 1]\n" +
             surface("rectangle = { u = [500, 0, 0], v = [0, 0, 500] }\nopacity = 0.01\nopacity_law = \"oblique\"")},
        {"partly_behind_the_camera",
         "image.resolution = [24, 20]\ncamera.position = [0, 0, 1]\ncamera.target = [0.5, 0, 0]\ncamera.fov_degrees = 70\n" +
             surface("implicit = \"cylinder\"\nparameters = { radius = 0.8, height = 8 }\nopacity = 0.3\nrotate_degrees = [10, 90, 0]")},
        {"sheets_that_cut_one_another",
         kPerspective + surface("name = \"a\"\nrectangle = { u = [0.9, 0, 0.5], v = [0, 1, 0] }\nopacity = 0.5\ncolor = [1, 0, 0]") +
             surface("name = \"b\"\nrectangle = { u = [0.9, 0, -0.5], v = [0, 0.8, 0.1] }\nopacity = 0.4\ncolor = [0, 1, 0]") +
             surface("name = \"c\"\nimplicit = \"sphere\"\nscale = 0.7\nopacity = 0.2\ncolor = [0, 0, 1]")},
        {"close_sheets", kOrthographic +
                             surface("name = \"a\"\nrectangle = { u = [1, 0, 0], v = [0, 1, 0] }\nopacity = 0.5\ncolor = [1, 0, 0]") +
                             surface("name = \"b\"\nrectangle = { center = [0, 0, 1e-5], u = [1, 0, 0], v = [0, 1, 0] }\nopacity = 0.5\ncolor = [0, 1, 0]")},
        {"scale_1e-6", "image.resolution = [24, 20]\ncamera.position = [0, 0, 4e-6]\n" +
                           surface("implicit = \"ellipsoid\"\nscale = 1e-6\nopacity = 0.3\nrotate_degrees = [10, 20, 30]")},
        {"scale_1e6", "image.resolution = [20, 24]\ncamera.position = [0, 0, 4e6]\n" +
                          surface("implicit = \"hyperboloid\"\nscale = 1e6\nopacity = 0.3\nrotate_degrees = [60, 20, 30]")},
        {"origin_1e6_away",
         "image.resolution = [24, 20]\ncamera.position = [1e6, 1e6, -999996]\ncamera.target = [1e6, 1e6, -1e6]\n" +
             surface("implicit = \"torus\"\ntranslate = [1e6, 1e6, -1e6]\nrotate_degrees = [40, 0, 0]\nopacity = 0.5")},
        {"opaque", kPerspective + surface("implicit = \"cone\"\nrotate_degrees = [80, 20, 0]\nscale = 0.5")},
        {"opacity_0.001", kPerspective + surface("implicit = \"sphere\"\nopacity = 0.001"), 5000},
        {"mirrored_sheared_saddle", kPerspective + surface("implicit = \"saddle\"\nopacity = 0.5\nmatrix = [-0.7,0.3,0,0, 0,0.6,0.2,0.1, 0.1,0,0.5,0, 0,0,0,1]")},
        {"clipped_bounded", kPerspective + surface("implicit = \"sphere\"\nopacity = 0.5\nbounds = [[-1, -1, -0.3], [1, 0.5, 1]]\n"
                                                   "clip = [{ normal = [1, 1, 0], offset = 0.2 }]")},
        {"plane_on_the_face_of_its_bounds",
         kPerspective + surface("implicit = \"plane\"\nbounds = [[-1, -1, 0], [1, 0.5, 1]]\nopacity = 0.5\nrotate_degrees = [30, 20, 10]")},
        {"lights_and_highlights",
         kPerspective + "[[light]]\ndirection = [1, 1, 1]\n[[light]]\ndirection = [-1, 0.5, 2]\nintensity = 0.5\n[[light]]\nheadlight = true\n" +
             surface("implicit = \"sphere\"\nopacity = 0.5\nshading = { ambient = 0.1, diffuse = 0.5, specular = 0.9, shininess = 20 }")},
    };
}

class ParticlesAgainstTruth : public testing::TestWithParam<Case> {};

TEST_P(ParticlesAgainstTruth, OpacityAndColourFollowTheLaw) {
    const Case& c = GetParam();
    const PreparedScene scene = prepare(scene_from(c.toml));
    RenderStats stats;
    const Image drawn = render_particles(scene, {.repeats = c.repeats, .sampler = {.seed = {7}}}, stats);
    TruthStats truth_stats;
    const double noise = 0.5 / std::sqrt(c.repeats);
    const Image truth = trace_truth(
        scene, {.filter = PixelFilter::particle, .seed = {3}, .max_error = noise / 20, .max_samples = 4096}, truth_stats);

    const double families = 4.0 * static_cast<double>(cases().size());
    const double level = sidak_level(0.001, families);
    const OpacityVerdict verdict = judge_opacity(drawn, truth, c.repeats);
    ASSERT_GT(verdict.pixels, 3U);
    EXPECT_GT(verdict.ks_p, level);
    EXPECT_LT(std::abs(verdict.total_z), normal_critical_value(level));
    EXPECT_LT(verdict.worst_z, normal_critical_value(sidak_level(level, static_cast<double>(verdict.pixels))));

    // Colour: squared distances from the truth in units of the theory's variance have mean 1. A colour of
    // n repeats is no normal number where few of them are hit, so only pixels with 20 hits and misses.
    MeanVariance squares;
    for (std::size_t i = 0; i < drawn.pixel_count(); ++i)
        for (const char* channel : {"R", "G", "B"}) {
            const std::string name(channel);
            const double alpha = static_cast<double>(truth.plane("A")[i]);
            const double variance = static_cast<double>(truth.plane("repeat_variance." + name)[i]) / c.repeats +
                                    static_cast<double>(truth.plane("variance." + name)[i]);
            if (std::min(alpha, 1 - alpha) * c.repeats < 20 || variance < 1e-7) continue;
            const double off = static_cast<double>(drawn.plane(name)[i] - truth.plane(name)[i]);
            squares.add(off * off / variance);
        }
    if (squares.count() > 100) {
        // Channels of a pixel share their noise: about a third of the numbers are independent.
        const double sigma = std::sqrt(squares.variance() * 3 / static_cast<double>(squares.count()));
        EXPECT_NEAR(squares.mean(), 1, normal_critical_value(level) * sigma);
    }

    // Depth: of something drawn, between near and far.
    const Camera& camera = scene.camera;
    for (std::size_t i = 0; i < drawn.pixel_count(); ++i) {
        const float z = drawn.plane("Z")[i];
        EXPECT_EQ(std::isinf(z), drawn.plane("A")[i] == 0) << i;
        if (std::isinf(z)) continue;
        EXPECT_GE(static_cast<double>(z), camera.near() * (1 - 1e-6));
        EXPECT_LE(static_cast<double>(z), camera.far() * (1 + 1e-6));
    }
}

INSTANTIATE_TEST_SUITE_P(Scenes, ParticlesAgainstTruth, testing::ValuesIn(cases()), [](const auto& instance) {
    std::string name = instance.param.name;
    std::replace_if(name.begin(), name.end(), [](char c) { return !std::isalnum(static_cast<unsigned char>(c)); }, '_');
    return name;
});

TEST(ParticlesIsosurface, PlateausOnCellFacesAreWhole) {
    // Values 0 and 1 and isovalues 1 and ½: every crossing lies exactly on a face or in the middle of a cell.
    const fs::path folder = test_folder();
    put_volume(folder / "v.nrrd", {5, 5, 5}, sampled({5, 5, 5}, [](const Vec3& p) { return p.x >= 2 ? 1.0 : 0.0; }));
    for (const char* isovalue : {"1", "0.5"})
        for (const char* camera :
             {"projection = \"orthographic\"\nposition = [-9, 3.3, 4.1]\ntarget = [2, 2, 2]\nview_height = 2",
              "position = [1.2, 2.2, 2.1]\ntarget = [2.3, 2, 2]\nfov_degrees = 60"}) {
            const PreparedScene scene =
                prepare(scene_from(fmt::format("image.resolution = [16, 16]\n[camera]\n{}\n[[surface]]\nisosurface = {{ volume "
                                               "= \"v.nrrd\", isovalue = {} }}\nopacity = 0.5",
                                               camera, isovalue),
                                   folder));
            RenderStats stats;
            const Image drawn = render_particles(scene, {.repeats = 200, .sampler = {.seed = {7}}}, stats);
            TruthStats truth_stats;
            const Image truth = trace_truth(scene, {.filter = PixelFilter::particle, .max_error = 0.001}, truth_stats);
            // The plane x = const fills the image: its opacity is known without any ray.
            double truth_sum = 0;
            double drawn_sum = 0;
            for (std::size_t i = 0; i < 256; ++i) {
                truth_sum += static_cast<double>(truth.plane("A")[i]) / 256;
                drawn_sum += static_cast<double>(drawn.plane("A")[i]) / 256;
            }
            EXPECT_NEAR(truth_sum, 0.5, 1e-6) << isovalue << camera;
            // 51 200 Bernoulli numbers: four sigmas are 0.9 %.
            EXPECT_NEAR(drawn_sum, 0.5, 4 * std::sqrt(0.25 / (256 * 200))) << isovalue << camera;
        }
}

TEST(ParticlesIsosurface, SmoothVolumeFollowsTheTruth) {
    const fs::path folder = test_folder();
    put_volume(folder / "v.nrrd", {6, 7, 8}, sampled({6, 7, 8}, [](const Vec3& p) {
                   return std::sin(1.3 * p.x) + std::cos(1.1 * p.y + 0.3 * p.x) + 0.4 * std::sin(p.z);
               }));
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [24, 24]\ncamera.position = [14, 6, 12]\ncamera.target = [2.5, 3, 3.5]\n[[surface]]\n"
        "isosurface = { volume = \"v.nrrd\", isovalue = 0.1 }\nopacity = 0.3\nscale = [1, 0.9, 1.1]",
        folder));
    RenderStats stats;
    const Image drawn = render_particles(scene, {.repeats = 200, .sampler = {.seed = {7}}}, stats);
    TruthStats truth_stats;
    const Image truth = trace_truth(scene, {.filter = PixelFilter::particle, .max_error = 0.002}, truth_stats);
    const OpacityVerdict verdict = judge_opacity(drawn, truth, 200);
    EXPECT_GT(verdict.ks_p, 0.0005);
    EXPECT_LT(std::abs(verdict.total_z), normal_critical_value(0.0005));
}

TEST(ParticlesMesh, ClosedMeshFollowsTheTruth) {
    const fs::path folder = test_folder();
    put_sphere_mesh(folder / "ball.ply", 12);
    const PreparedScene scene = prepare(scene_from("image.resolution = [24, 24]\ncamera.position = [1, 2, 3]\n[[surface]]\nmesh = "
                                                   "\"ball.ply\"\nopacity = 0.3\nscale = [0.8, 0.4, -0.6]",
                                                   folder));
    RenderStats stats;
    const Image drawn = render_particles(scene, {.repeats = 200, .sampler = {.seed = {7}}}, stats);
    TruthStats truth_stats;
    const Image truth = trace_truth(scene, {.filter = PixelFilter::particle, .max_error = 0.002}, truth_stats);
    const OpacityVerdict verdict = judge_opacity(drawn, truth, 200);
    EXPECT_GT(verdict.ks_p, 0.0005);
    EXPECT_LT(std::abs(verdict.total_z), normal_critical_value(0.0005));
}

// ---- wrong twins: what the tests above must reject

TEST(ParticlesAgainstTruthItself, BiasOfTwoPercentIsRejected) {
    const Case c = cases()[0];
    const PreparedScene right = prepare(scene_from(c.toml));
    std::string wrong_toml = c.toml;
    wrong_toml.replace(wrong_toml.find("0.4\nrotate"), 3, "0.39");
    const PreparedScene wrong = prepare(scene_from(wrong_toml));
    RenderStats stats;
    const Image drawn = render_particles(wrong, {.repeats = 200, .sampler = {.seed = {7}}}, stats);
    TruthStats truth_stats;
    const Image truth = trace_truth(right, {.filter = PixelFilter::particle, .max_error = 0.002}, truth_stats);
    EXPECT_GT(std::abs(judge_opacity(drawn, truth, 200).total_z), normal_critical_value(0.001));
}

// Two sheets of one object, 0.1 pixel apart, α = 0.3 each: 1 − 0.7² = 0.51. Wholly in view, so that the
// sampler has no reason to cut the sheets apart.
const std::string kTwoSheets =
    "image.resolution = [24, 24]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = 2.4\n" +
    surface("implicit = \"ellipsoid\"\nparameters = { a = 1, b = 1, c = 0.005 }\nopacity = 0.3\nopacity_law = \"oblique\"");

/// Mean opacity of the `pixels` whole pixels within 0.7 of the centre, where both sheets are flat.
double inner_opacity(const PreparedScene& scene, const SamplerSettings& settings, std::uint32_t repeats, double& pixels) {
    RenderStats stats;
    const Image image = render_particles(scene, {.repeats = repeats, .sampler = settings}, stats);
    double sum = 0;
    pixels = 0;
    for (int y = 0; y < 24; ++y)
        for (int x = 0; x < 24; ++x) {
            if (std::hypot(x - 11.5, y - 11.5) > 6.5) continue;
            sum += static_cast<double>(image.plane("A")[static_cast<std::size_t>(24 * y + x)]);
            ++pixels;
        }
    return sum / pixels;
}

TEST(WrongTwin, AllCrossingsOfALineInOneRepeatAreRejected) {
    const PreparedScene scene = prepare(scene_from(kTwoSheets));
    const std::uint32_t repeats = 1000;
    double pixels = 0;
    const double right = inner_opacity(scene, {.seed = {5}}, repeats, pixels);
    const double sigma = std::sqrt(0.51 * 0.49 / (pixels * repeats));  // 0.14 %: that is what this sees
    EXPECT_NEAR(right, 0.51, 3.3 * sigma);
    const double wrong = inner_opacity(scene, {.seed = {5}, .keep_all_crossings = true}, repeats, pixels);
    EXPECT_GT(std::abs(wrong - 0.51) / sigma, 50);
    EXPECT_NEAR(wrong, 0.342, 0.01);  // as measured by others on such sheets
}

TEST(WrongTwin, OneSetInAllRepeatsIsRejected) {
    const PreparedScene scene = prepare(scene_from(kTwoSheets));
    TruthStats truth_stats;
    const Image truth = trace_truth(scene, {.filter = PixelFilter::particle, .max_error = 1e-4}, truth_stats);
    RenderStats stats;
    const Image right = render_particles(scene, {.repeats = 100, .sampler = {.seed = {5}}}, stats);
    const Image wrong =
        render_particles(scene, {.repeats = 100, .sampler = {.seed = {5}, .same_set_in_all_repeats = true}}, stats);
    EXPECT_GT(judge_opacity(right, truth, 100).ks_p, 0.001);
    EXPECT_LT(judge_opacity(wrong, truth, 100).ks_p, 1e-9);
}

// ---- determinism

Image draw(const std::string& toml, const ParticleSettings& settings) {
    RenderStats stats;
    return render_particles(prepare(scene_from(toml)), settings, stats);
}

TEST(Particles, ThreadsAndBatchesDoNotMatterAndSeedsDo) {
    // About 4000 particles a repeat, 16 bytes each: 1 MiB holds 16 repeats.
    const std::string toml = "image.resolution = [40, 30]\ncamera.position = [0.3, 0.4, 4]\n" +
                             surface("implicit = \"torus\"\nopacity = 0.2") +
                             surface("rectangle = { u = [1, 0, 0], v = [0, 1, 1] }");
    const ParticleSettings plain{.repeats = 40, .sampler = {.seed = {11}}};
    const Image two = draw(toml, plain);
    set_thread_count(1);
    const Image one = draw(toml, plain);
    set_thread_count(7);
    const Image seven = draw(toml, plain);
    set_thread_count(0);
    expect_same_planes(two, one);
    expect_same_planes(two, seven);
    expect_same_planes(two, draw(toml, {.repeats = 40, .sampler = {.seed = {11}}, .memory_mib = 1}));
    const Image other = draw(toml, {.repeats = 40, .sampler = {.seed = {12}}});
    EXPECT_NE(0, std::memcmp(two.plane("A").data(), other.plane("A").data(), two.plane("A").size_bytes()));
}

TEST(Particles, VariancePlaneIsThatOfTheMean) {
    const std::string toml = "image.resolution = [24, 24]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = 1\n" +
                             surface("rectangle = {}\nopacity = 0.3\ncolor = [0.5, 1, 0]\nshading = \"flat\"");
    const Image image = draw(toml, {.repeats = 50, .sampler = {.seed = {1}}});
    MeanVariance alpha, red;
    for (std::size_t i = 0; i < image.pixel_count(); ++i) {
        alpha.add(static_cast<double>(image.plane("variance.A")[i]));
        red.add(static_cast<double>(image.plane("variance.R")[i]));
    }
    EXPECT_NEAR(alpha.mean(), 0.21 / 50, 5 * alpha.standard_error());
    EXPECT_NEAR(red.mean(), 0.25 * 0.21 / 50, 5 * red.standard_error());
}

TEST(Particles, DepthIsThatOfTheNearestSheetAsInTheTruth) {
    const std::string toml = "image.resolution = [12, 12]\ncamera.position = [0.5, 0.2, 4]\ncamera.target = [0.5, 0.2, 0]\n" +
                             surface("rectangle = { center = [0, 0, 0.5], u = [9, 0, 0], v = [0, 9, 0] }\nopacity = 0.3") +
                             surface("rectangle = { center = [0, 0, 0.25], u = [9, 0, 0], v = [0, 9, 0] }\nopacity = 0.9");
    const Image drawn = draw(toml, {.repeats = 100, .sampler = {.seed = {1}}});  // unhit: 0.7^100 a pixel
    TruthStats stats;
    const Image truth = trace_truth(prepare(scene_from(toml)), {}, stats);
    for (std::size_t i = 0; i < drawn.pixel_count(); ++i) {
        EXPECT_NEAR(static_cast<double>(drawn.plane("Z")[i]), 3.5, 1e-6);
        EXPECT_NEAR(static_cast<double>(truth.plane("Z")[i]), 3.5, 1e-6);
    }
}

TEST(Particles, MaxErrorIsReachedOrAllRepeatsAreSpent) {
    const std::string toml = kPerspective + surface("implicit = \"torus\"\nopacity = 0.4");
    RenderStats stats;
    const PreparedScene scene = prepare(scene_from(toml));
    (void)render_particles(scene, {.repeats = 4096, .sampler = {.seed = {1}}, .max_error = 0.05}, stats);
    EXPECT_GE(stats.repeats, 100U);  // 0.25/0.05²
    EXPECT_LT(stats.repeats, 400U);
    (void)render_particles(scene, {.repeats = 64, .sampler = {.seed = {1}}, .max_error = 0.001}, stats);
    EXPECT_EQ(stats.repeats, 64U);
}

TEST(Particles, MaxErrorIsNotFooledByPixelsThatWereNeverHit) {
    // One pixel at α = 0.02: sixteen empty repeats say nothing about an error of 0.005.
    const PreparedScene scene = prepare(scene_from("image.resolution = [1, 1]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = 1\n" +
                                                   surface("rectangle = {}\nopacity = 0.02")));
    int early = 0;
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
        RenderStats stats;
        (void)render_particles(scene, {.repeats = 4096, .sampler = {.seed = {seed}}, .max_error = 0.005}, stats);
        early += stats.repeats < 100 ? 1 : 0;  // the true standard error is 0.014 there
    }
    EXPECT_EQ(early, 0);
}

TEST(Particles, EmptySceneAndSceneOutOfViewAreEmptyImages) {
    for (const std::string& toml :
         {std::string("image.resolution = [4, 3]\ncamera.position = [0, 0, 4]\n"),
          "image.resolution = [4, 3]\ncamera.position = [0, 0, 4]\n" + surface("implicit = \"sphere\"\ntranslate = [0, 0, 9]"),
          "image.resolution = [4, 3]\ncamera.position = [0, 0, 4]\n" + surface("implicit = \"sphere\"\ntranslate = [90, 0, 0]"),
          "image.resolution = [4, 3]\ncamera.position = [0, 0, 4]\n" + surface("implicit = \"sphere\"\nopacity = 0"),
          "image.resolution = [4, 3]\ncamera.position = [0, 0, 4]\n" +
              surface("implicit = \"sphere\"\nbounds = [[2, 2, 2], [3, 3, 3]]")}) {
        const Image image = draw(toml, {.repeats = 3});
        TruthStats stats;
        const Image truth = trace_truth(prepare(scene_from(toml)), {}, stats);
        for (std::size_t i = 0; i < 12; ++i) {
            EXPECT_EQ(image.plane("A")[i], 0);
            EXPECT_EQ(truth.plane("A")[i], 0);
            EXPECT_TRUE(std::isinf(image.plane("Z")[i]));
            EXPECT_TRUE(std::isinf(truth.plane("Z")[i])) << toml;
        }
    }
}

TEST(Particles, BrightLightsDoNotOverflowTheVariance) {
    const std::string toml = "image.resolution = [2, 2]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = 1\n[[light]]\nheadlight = true\nintensity = 100\n" +
                             surface("rectangle = {}\nopacity = 0.5\ncolor = [1, 1, 1]\nshading = { ambient = 0, diffuse = 1 }");
    const Image image = draw(toml, {.repeats = 500});
    for (std::size_t i = 0; i < 4; ++i) {
        EXPECT_NEAR(static_cast<double>(image.plane("R")[i]), 50, 6);
        EXPECT_NEAR(static_cast<double>(image.plane("variance.R")[i]), 0.25 * 1e4 / 500, 0.05 * 0.25 * 1e4 / 500);
    }
}

TEST(PreparedSceneWarnings, NameWhatTheLeastNearPlaneCutsOff) {
    const auto warnings = [](double size) {
        testing::internal::CaptureStderr();
        (void)prepare(scene_from(fmt::format("image.resolution = [4, 4]\ncamera.position = [0, 0, 4]\n[[surface]]\nname = "
                                             "\"ring\"\nimplicit = \"torus\"\n[[surface]]\nimplicit = \"sphere\"\nscale = {}\n"
                                             "translate = [0, 0, {}]\n", size, -3 * size)));
        return testing::internal::GetCapturedStderr();
    };
    EXPECT_EQ(warnings(1e7), "");
    EXPECT_NE(warnings(1e10).find("\"ring\": cut off"), std::string::npos);
}

}  // namespace
}  // namespace pellucid
