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

}  // namespace
}  // namespace pellucid
