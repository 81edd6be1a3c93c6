// The method `slabs`, from scene to image.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "core/error.hpp"
#include "scene_testing.hpp"
#include "study/method_image.hpp"

namespace pellucid {
namespace {

using testing_scenes::scene_from;

const std::string kView = R"(
[image]
resolution = [24, 24]
[camera]
projection = "orthographic"
position = [0, 0, 5]
view_height = 2
)";

std::string card(const std::string& name, double z, double opacity, const std::string& more = "") {
    return fmt::format("[[surface]]\nname = \"{}\"\nrectangle = {{ center = [0, 0, {}], u = [3, 0, 0], v = [0, 3, 0] }}\n"
                       "opacity = {}\nshading = \"flat\"\n{}\n",
                       name, z, opacity, more);
}
/// A cube of one medium: `opacity` accrues over a length of 1.
std::string medium(const std::string& name, double lo, double hi, double opacity, const std::string& color) {
    return fmt::format("[[volume]]\nname = \"{0}\"\nexpression = \"1 + 0*x\"\nbounds = [[-3, -3, {1}], [3, 3, {2}]]\n"
                       "resolution = 9\ntransfer = [[0, {4}, {3}], [2, {4}, {3}]]\nopacity_step = 1\n",
                       name, lo, hi, opacity, color);
}

Image draw(const std::string& scene, const std::vector<std::string>& settings = {}) {
    RenderStats stats;
    return method_image(prepare(scene_from(kView + scene)), {"slabs", settings}, Seed{1}, stats);
}
double at_middle(const Image& image, const char* plane) { return static_cast<double>(image.plane(plane)[12 * 24 + 12]); }
bool same(const Image& a, const Image& b) {
    for (const char* plane : {"R", "G", "B", "A", "Z"})
        if (!std::ranges::equal(a.plane(plane), b.plane(plane))) return false;
    return true;
}

TEST(SlabsMethod, StacksOfPlanesCompositeFrontToBack) {
    std::string scene;
    double clear = 1, red = 0;
    for (int i = 0; i < 7; ++i) {
        const double opacity = 0.1 + 0.1 * i;
        scene += card(fmt::format("card {}", i), -1 + 0.3 * i, opacity, fmt::format("thickness = 0.01\ncolor = [{}, 0.5, 1]", 0.1 * i));
    }
    for (int i = 6; i >= 0; --i) {  // the last is nearest
        const double opacity = 0.1 + 0.1 * i;
        red += clear * opacity * 0.1 * i;
        clear *= 1 - opacity;
    }
    const std::vector<std::string> ways[] = {{}, {"slabs.intermix=order-free"}, {"slabs.interpolation=original"}};
    for (auto settings : ways) {
        settings.push_back("slabs.opaque_at=1");
        const Image image = draw(scene, settings);
        EXPECT_NEAR(at_middle(image, "A"), 1 - clear, 1e-6);
        EXPECT_NEAR(at_middle(image, "R"), red, 1e-6);
        EXPECT_NEAR(at_middle(image, "Z"), 5 - 0.8, 1e-6);
    }
}

TEST(SlabsMethod, ASurfaceInsideOfAMediumSplitsIt) {
    // Medium from z = −1 to 1, surface at 0: half of the medium in front, half behind.
    const double half = -std::expm1(std::log1p(-0.6));  // opacity of a length of 1
    const std::string scene = medium("fog", -1, 1, 0.6, "1, 0, 0") + card("card", 0, 0.5, "thickness = 0\ncolor = [0, 0, 1]");
    const double alpha = 1 - (1 - half) * 0.5 * (1 - half);
    const double blue = (1 - half) * 0.5;
    for (const char* intermix : {"image", "hybrid", "order-free"}) {
        const Image image = draw(scene, {fmt::format("slabs.intermix={}", intermix), "slabs.interpolation=original", "slabs.layers=64",
                                         "slabs.opaque_at=1"});
        EXPECT_NEAR(at_middle(image, "A"), alpha, 1e-5) << intermix;
        EXPECT_NEAR(at_middle(image, "B"), blue, 2e-4) << intermix;
        EXPECT_NEAR(at_middle(image, "Z"), 4, 1e-5) << intermix;
    }
}

TEST(SlabsMethod, OverlappingMediaMixByTheirExtinctions) {
    const std::string scene = medium("red", -1, 1, 0.3, "1, 0, 0") + medium("blue", -0.5, 1.5, 0.7, "0, 0, 1");
    const double r = -std::log1p(-0.3), b = -std::log1p(-0.7);
    // Front to back: blue alone (0.5), both (1.5), red alone (0.5).
    const double through_blue = std::exp(-0.5 * b), through_both = std::exp(-1.5 * (r + b)), through_red = std::exp(-0.5 * r);
    const double blue = (1 - through_blue) + through_blue * (1 - through_both) * b / (r + b);
    const double red = through_blue * ((1 - through_both) * r / (r + b) + through_both * (1 - through_red));
    for (const char* intermix : {"image", "hybrid", "order-free"}) {
        const Image image = draw(scene, {fmt::format("slabs.intermix={}", intermix), "slabs.interpolation=original",
                                         "slabs.mixing=extinction", "slabs.layers=64", "slabs.opaque_at=1"});
        EXPECT_NEAR(at_middle(image, "A"), 1 - through_blue * through_both * through_red, 1e-5) << intermix;
        EXPECT_NEAR(at_middle(image, "B"), blue, 2e-3) << intermix;
        EXPECT_NEAR(at_middle(image, "R"), red, 2e-3) << intermix;
    }
}

TEST(SlabsMethod, OrderFreeImagesDoNotDependOnTheOrderOfObjects) {
    const std::string a = card("a", 0.1, 0.6, "thickness = 0.5\ncolor = [1, 0.2, 0]");
    const std::string b = card("b", 0.2, 0.4, "thickness = 0.4\ncolor = [0, 0.9, 0.3]");
    const std::string c = card("c", 0.0, 0.7, "thickness = 0.6\ncolor = [0.2, 0, 1]");
    const std::string fog = medium("fog", -1, 1, 0.6, "1, 0, 0");
    const std::string mist = medium("mist", -0.5, 1.5, 0.3, "0, 1, 0");
    const std::vector<std::string> free{"slabs.intermix=order-free"};
    const Image first = draw(a + b + c + fog + mist, free);
    EXPECT_TRUE(same(first, draw(c + a + b + mist + fog, free)));
    EXPECT_TRUE(same(first, draw(b + c + a + mist + fog, free)));
    // One by one it does: the check can fail.
    EXPECT_FALSE(same(draw(a + b + c + fog + mist), draw(c + b + a + mist + fog)));
}

TEST(SlabsMethod, FewLayersKeepTheWholeOfOneObject) {
    const std::string scene =
        "[[volume]]\nname = \"cloud\"\nexpression = \"exp(-3*(x^2 + y^2 + z^2))*(1.2 + sin(9*z))\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\n"
        "resolution = 33\ntransfer = [[0.1, 1, 0.5, 0.2, 0], [1, 0.2, 0.5, 1, 0.4]]\nopacity_step = 0.1\n";
    const Image many = draw(scene, {"slabs.layers=256", "slabs.opaque_at=1"});
    for (const char* compression : {"tail", "slope", "transmittance"})
        for (const int layers : {2, 3, 8}) {
            const Image few =
                draw(scene, {fmt::format("slabs.layers={}", layers), fmt::format("slabs.compression={}", compression), "slabs.opaque_at=1"});
            for (const char* plane : {"R", "G", "B", "A"})
                for (std::size_t i = 0; i < few.pixel_count(); ++i)
                    ASSERT_NEAR(few.plane(plane)[i], many.plane(plane)[i], 2e-5) << compression << " " << layers << " " << plane;
        }
}

TEST(SlabsMethod, SkippingEmptySpaceChangesNothing) {
    const std::string scene =
        "[[volume]]\nname = \"shell\"\nexpression = \"abs(sqrt(x^2 + y^2 + z^2) - 0.7)\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\n"
        "resolution = 65\ntransfer = [[0, 1, 0.5, 0.2, 0.3], [0.05, 0.2, 0.5, 1, 0]]\n" +
        card("card", 0, 0.5);
    EXPECT_TRUE(same(draw(scene), draw(scene, {"slabs.skip=false"})));
}

TEST(SlabsMethod, NothingInAPixelIsNothing) {
    const Image image = draw("[[surface]]\nname = \"dot\"\nrectangle = { u = [0.2, 0, 0], v = [0, 0.2, 0] }\n");
    EXPECT_EQ(image.plane("A")[0], 0);
    EXPECT_EQ(image.plane("Z")[0], std::numeric_limits<float>::infinity());
    EXPECT_EQ(at_middle(image, "A"), 1);
}

TEST(SlabsMethod, FormatsRoundAsTheySay) {
    const std::string scene = card("a", 0.1, 0.6, "thickness = 0.1\ncolor = [1, 0.2, 0]") + medium("fog", -1, 1, 0.6, "1, 0, 0");
    const Image exact = draw(scene);
    const Image half = draw(scene, {"slabs.format=half"});
    const Image byte = draw(scene, {"slabs.format=byte"});
    for (const char* plane : {"R", "G", "B", "A"}) {
        EXPECT_NEAR(at_middle(half, plane), at_middle(exact, plane), 3e-3) << plane;
        EXPECT_NEAR(at_middle(byte, plane), at_middle(exact, plane), 3e-2) << plane;
    }
}

TEST(SlabsMethod, BadSettingsAreRefused) {
    const std::string scene = card("a", 0, 0.5);
    for (const char* bad : {"slabs.layers=0", "slabs.layers=1", "slabs.layers=1000000", "slabs.step=0", "slabs.step=-1", "slabs.opaque_at=0",
                            "slabs.opaque_at=1.5", "slabs.interpolation=linear", "slabs.intermix=pixel", "slabs.format=quarter",
                            "slabs.surfaces=-1", "slabs.layer=8"})
        EXPECT_THROW((void)draw(scene, {bad}), Error) << bad;
}

// ---- Extremes

Image draw_by(const char* method, const std::string& scene, const std::vector<std::string>& settings = {}) {
    RenderStats stats;
    return method_image(prepare(scene_from(kView + scene)), {method, settings}, Seed{1}, stats);
}
std::string ball(const std::string& transfer, const std::string& more = "", const std::string& name = "ball") {
    return fmt::format("[[volume]]\nname = \"{}\"\nexpression = \"1 - x^2 - y^2 - z^2\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\n"
                       "resolution = 17\ntransfer = {}\n{}\n",
                       name, transfer, more);
}
void expect_sane(const Image& image, const std::string& what) {
    for (const char* plane : {"R", "G", "B", "A"})
        for (const float v : image.plane(plane)) {
            ASSERT_GE(v, 0) << what << " " << plane;
            ASSERT_LE(v, 1.00001F) << what << " " << plane;
        }
    for (const float z : image.plane("Z")) ASSERT_FALSE(std::isnan(z)) << what;
}

TEST(SlabsMethod, ExtremeTransferFunctionsAreDrawnRight) {
    std::string fine = "[";
    for (int i = 0; i < 10'000; ++i) fine += fmt::format("[{}, 1, 0.5, 0.2, {}], ", i / 1e4, 0.1 * i / 1e4);
    fine += "]";
    struct Extreme {
        const char* what;
        std::string transfer, equal_to;  // a plain one that draws the same
    };
    const Extreme extremes[] = {
        {"ten thousand points of one line", fine, "[[0, 1, 0.5, 0.2, 0], [1, 1, 0.5, 0.2, 0.1]]"},
        {"three points at a value", "[[0.5, 1, 0, 0, 0], [0.5, 0, 1, 0, 1], [0.5, 0, 0, 1, 0.5]]",
         "[[0.5, 0, 0, 1, 0], [0.5, 0, 0, 1, 0.5]]"},
        {"opacity 1 at one value", "[[0.5, 1, 0, 0, 0], [0.5, 0, 1, 0, 1], [0.5, 0, 0, 1, 0]]", "[[0, 1, 1, 1, 0]]"},
        {"values beyond float32", "[[-1e300, 1, 0.5, 0.2, 0.25], [1e300, 1, 0.5, 0.2, 0.25]]", "[[0, 1, 0.5, 0.2, 0.25]]"},
        {"out of the range of values", "[[100, 1, 0.5, 0.2, 0.3], [200, 1, 1, 1, 1]]", "[[0, 1, 0.5, 0.2, 0.3]]"},
    };
    for (const char* method : {"slabs", "mdvr"})
        for (const Extreme& extreme : extremes) {
            const Image drawn = draw_by(method, ball(extreme.transfer)), plain = draw_by(method, ball(extreme.equal_to));
            expect_sane(drawn, extreme.what);
            for (const char* plane : {"R", "G", "B", "A"})
                for (std::size_t i = 0; i < plain.pixel_count(); ++i)
                    ASSERT_NEAR(drawn.plane(plane)[i], plain.plane(plane)[i], 3e-5) << method << ": " << extreme.what << " " << plane;
        }
    // From a jump on nothing shines through, whatever the step.
    const std::string solid = ball("[[0.5, 1, 0.5, 0.2, 0], [0.5, 1, 0.5, 0.2, 1]]");
    for (const char* step : {"step=0.001", "step=1", "step=1000"})
        for (const std::string method : {"slabs", "mdvr"}) {
            const Image image = draw_by(method.c_str(), solid, {method + "." + step});
            expect_sane(image, step);
            // Steps longer than the ball may miss it, as they say.
            if (std::string(step) == "step=1000") continue;
            EXPECT_EQ(at_middle(image, "A"), 1) << method << " " << step;
        }
    // As thin as can be: 16 voxels of 1e-30.
    const Image thin = draw(ball("[[0, 1, 1, 1, 1e-30]]"));
    EXPECT_NEAR(at_middle(thin, "A") / 16e-30, 1, 1e-5);
}

TEST(SlabsMethod, VolumesInOnePlaceAddTheirOpticalDepths) {
    const std::string transfer = "[[0, 1, 0.5, 0.2, 0], [1, 1, 0.5, 0.2, 0.1]]";
    const std::vector<std::string> exact{"slabs.opaque_at=1", "slabs.interpolation=original", "slabs.mixing=extinction"};
    const double one = at_middle(draw(ball(transfer), exact), "A");
    for (const char* intermix : {"image", "hybrid", "order-free"}) {
        auto settings = exact;
        settings.push_back(fmt::format("slabs.intermix={}", intermix));
        const Image both = draw(ball(transfer) + ball(transfer, "", "another"), settings);
        EXPECT_NEAR(at_middle(both, "A"), 1 - (1 - one) * (1 - one), 2e-5) << intermix;
        EXPECT_NEAR(at_middle(both, "G"), 0.5 * at_middle(both, "A"), 1e-5) << intermix;
    }
}

TEST(SlabsMethod, VoxelsThatAreNoNumbersAreEmptyAndCounted) {
    for (const char* interpolation : {"trilinear", "catmull-rom", "nearest"})
        for (const char* method : {"slabs", "mdvr"}) {
            const std::string scene = fmt::format(
                "[[volume]]\nexpression = \"sqrt(x)\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nresolution = 9\n"
                "transfer = [[0, 1, 1, 1, 0.2]]\ninterpolation = \"{}\"\n", interpolation);
            testing::internal::CaptureStderr();
            const Image image = draw_by(method, scene);
            const std::string warning = testing::internal::GetCapturedStderr();
            EXPECT_NE(warning.find("324 samples of \"sqrt(x)\" are not finite"), std::string::npos) << warning;  // 4 · 9 · 9
            expect_sane(image, interpolation);
            EXPECT_EQ(image.plane("A")[12 * 24 + 2], 0) << interpolation << " " << method;
            EXPECT_GT(image.plane("A")[12 * 24 + 20], 0.5F) << interpolation << " " << method;
        }
}

TEST(SlabsMethod, StepsThatTakeForEverAreRefused) {
    // A step of mdvr is that of the smallest voxel of all; where voxels are flat it is their thickness.
    const std::string pair = ball("[[0, 1, 1, 1, 0.1]]", "scale = 1e-6", "dot") + ball("[[0, 1, 1, 1, 0.1]]", "", "huge");
    EXPECT_THROW((void)draw_by("mdvr", pair), Error);
    EXPECT_NO_THROW((void)draw_by("slabs", pair));
    EXPECT_THROW((void)draw_by("slabs", ball("[[0, 1, 1, 1, 0.1]]", "scale = [1, 1e-6, 1]")), Error);
}

TEST(SlabsMethod, SamplesOfFormulasThatHaveNoRoomAreRefusedAtOnce) {
    std::string scene;  // half a terabyte
    for (int i = 0; i < 64; ++i)
        scene += fmt::format("[[volume]]\nname = \"{}\"\nexpression = \"x\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nresolution = 1290\n"
                             "transfer = [[0, 1, 1, 1, 0.1]]\n", i);
    EXPECT_THROW((void)draw(scene), Error);
}

TEST(SlabsMethod, DepthsThatFloatsDoNotTellApartAreWarnedOf) {
    const auto warning_from = [](const char* method, double distance) {
        testing::internal::CaptureStderr();
        RenderStats stats;
        (void)method_image(prepare(scene_from(fmt::format("[image]\nresolution = [4, 4]\n[camera]\nprojection = \"orthographic\"\n"
                                                          "position = [0, 0, {}]\n", distance) + card("a", 0, 0.5) + card("b", 0.1, 0.5))),
                           {method, {}}, Seed{1}, stats);
        return testing::internal::GetCapturedStderr();
    };
    for (const char* method : {"slabs", "mdvr", "depth-peeling", "z-test", "alpha-blend"}) {
        EXPECT_NE(warning_from(method, 1e8).find("float32"), std::string::npos) << method;
        EXPECT_EQ(warning_from(method, 100), "") << method;
    }
}

TEST(SlabsMethod, CamerasAnywhereAndNothingAtAll) {
    const std::string scene = ball("[[0, 1, 0.5, 0.2, 0], [1, 0.2, 0.5, 1, 0.5]]") + card("card", 0, 0.5);
    for (const char* camera :
         {"position = [0, 0, 0.2]\ntarget = [0, 0, -1]", "position = [0, 0, 0]\ntarget = [0, 0, -1]", "position = [0, 0, 5]\nnear = 5",
          "position = [0, 0, 5]\nfar = 5", "position = [0, 0, 5]\nfar = 1", "position = [0, 0, 5]\nnear = 100",
          "position = [0, 0, 5]\nnear = 1e-30\nfar = 1e30", "position = [0, 0, 5]\nfov_degrees = 179.99",
          "position = [0, 0, 5]\nfov_degrees = 1e-6", "position = [0, 0, 5]\ntarget = [0, 0, 9]"})
        for (const char* intermix : {"image", "hybrid", "order-free"}) {
            RenderStats stats;
            const std::string toml = fmt::format("[image]\nresolution = [13, 7]\n[camera]\n{}\n", camera);
            const PreparedScene prepared = prepare(scene_from(toml + scene));
            expect_sane(method_image(prepared, {"slabs", {fmt::format("slabs.intermix={}", intermix)}}, Seed{1}, stats), camera);
            expect_sane(method_image(prepared, {"mdvr", {}}, Seed{1}, stats), camera);
        }
    for (const char* method : {"slabs", "mdvr"})
        EXPECT_EQ(std::ranges::count(draw_by(method, "").plane("A"), 0.0F), 24 * 24) << method;
    // From inside half of the ball is seen.
    const std::string inside = "[image]\nresolution = [1, 1]\n[camera]\nposition = [0, 0, 0]\ntarget = [0, 0, -1]\n";
    const std::string medium = ball("[[0, 1, 1, 1, 0.1]]");
    RenderStats stats;
    const Image half = method_image(prepare(scene_from(inside + medium)), {"slabs", {"slabs.opaque_at=1"}}, Seed{1}, stats);
    EXPECT_NEAR(half.plane("A")[0], 1 - std::pow(0.9, 8), 1e-5);
}

TEST(SlabsMethod, ACroppedImageIsPartOfTheWhole) {
    const std::string scene = ball("[[0, 1, 0.5, 0.2, 0], [1, 0.2, 0.5, 1, 0.5]]") + card("card", 0.1, 0.5);
    for (const char* method : {"slabs", "mdvr"}) {
        const Image whole = draw_by(method, scene);
        RenderStats stats;
        const Image part = method_image(prepare(scene_from(kView + scene), PixelRect{5, 7, 18, 22}), {method, {}}, Seed{1}, stats);
        ASSERT_EQ(part.width(), 13);
        for (const char* plane : {"R", "G", "B", "A", "Z"})
            for (int y = 0; y < part.height(); ++y)
                for (int x = 0; x < part.width(); ++x)
                    ASSERT_EQ(part.plane(plane)[static_cast<std::size_t>(13 * y + x)],
                              whole.plane(plane)[static_cast<std::size_t>(24 * (y + 7) + x + 5)])
                        << method << " " << plane;
    }
}

TEST(SlabsMethod, BadObjectsAreRefused) {
    for (const char* bad : {"thickness = -1", "thickness = nan", "thickness = inf", "thickness = \"thin\"", "clip = [{ normal = [0, 0, 0] }]"})
        EXPECT_THROW((void)draw(card("a", 0, 0.5, bad)), Error) << bad;
    const std::string good = "[[0, 1, 1, 1, 0.1]]";
    for (const char* bad : {"clip = [{ normal = [0, 0, 0] }]", "scale = 0", "scale = [1, 0, 1]", "opacity_step = 0", "opacity_step = -1",
                            "opacity_step = inf", "matrix = [1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]"})
        EXPECT_THROW((void)draw(ball(good, bad)), Error) << bad;
    for (const char* bad : {"[]", "[[1, 1, 1, 1, 0], [0, 1, 1, 1, 0]]", "[[0, 1, 1, 1, 2]]", "[[0, 1, 1, 1, -0.1]]", "[[0, 1, 1, 1, nan]]",
                            "[[inf, 1, 1, 1, 0.1]]", "[[0, 2, 1, 1, 0.1]]", "[[0, 1, 1, 1]]"})
        EXPECT_THROW((void)draw(ball(bad)), Error) << bad;
    EXPECT_NO_THROW((void)draw(card("a", 0, 0.5, "thickness = 3e38") + card("b", 0.1, 0.5, "thickness = 0")));
}

}  // namespace
}  // namespace pellucid
