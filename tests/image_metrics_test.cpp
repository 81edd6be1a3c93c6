#include <cmath>
#include <fstream>
#include <limits>
#include <string>

#include <gtest/gtest.h>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "measure/image_metrics.hpp"

namespace pellucid {
namespace {

Image grey(int width, int height, float value) {
    Image image(width, height);
    for (const char* name : {"R", "G", "B"}) image.add(name, value);
    return image;
}

RgbImage judged(const Image& image) { return over_background(image, Vec3{0.0}, "x.exr"); }

std::string message_of(const Image& image) {
    try {
        (void)over_background(image, Vec3{0.0}, "x.exr");
    } catch (const Error& error) {
        EXPECT_EQ(error.kind(), Failure::input);
        return error.what();
    }
    return "";
}

TEST(OverBackground, AddsWhatShowsThrough) {
    Image image = grey(1, 1, 0.25F);
    image.add("A", 0.75F);
    const RgbImage rgb = over_background(image, {1, 0, -2}, "x.exr");
    EXPECT_DOUBLE_EQ(rgb.channels[0][0], 0.5);
    EXPECT_DOUBLE_EQ(rgb.channels[1][0], 0.25);
    EXPECT_DOUBLE_EQ(rgb.channels[2][0], -0.25);
}

TEST(OverBackground, NoAlphaIsOpaque) {
    EXPECT_EQ(over_background(grey(2, 1, 0.25F), {1, 1, 1}, "x.exr").channels[0][1], 0.25);
}

TEST(OverBackground, RefusesWhatCannotBeJudged) {
    EXPECT_NE(message_of(Image(0, 0)).find("x.exr"), std::string::npos);
    Image no_green(1, 1);
    no_green.add("R");
    no_green.add("B");
    EXPECT_NE(message_of(no_green).find("\"G\""), std::string::npos);
    for (const char* channel : {"R", "B", "A"}) {
        Image bad = grey(3, 2, 0);
        bad.add("A", 1.0F);
        bad.plane(channel)[4] = std::numeric_limits<float>::quiet_NaN();
        const std::string message = message_of(bad);
        EXPECT_NE(message.find("NaN at pixel (1, 1) (1 in all)"), std::string::npos) << message;
        bad.plane(channel)[4] = std::numeric_limits<float>::infinity();
        EXPECT_NE(message_of(bad).find("infinite"), std::string::npos);
    }
}

TEST(OverBackground, OtherPlanesMayBeInfinite) {
    Image image = grey(1, 1, 0);
    image.add("Z", std::numeric_limits<float>::infinity());
    EXPECT_EQ(message_of(image), "");
}

TEST(Metrics, KnownDifference) {
    Image a = grey(2, 1, 0);
    const Image b = grey(2, 1, 0);
    a.plane("G")[1] = -3.0F;  // one of six values, unclamped
    EXPECT_DOUBLE_EQ(rmse(judged(a), judged(b)), std::sqrt(9.0 / 6));
    EXPECT_DOUBLE_EQ(mae(judged(a), judged(b)), 0.5);
    EXPECT_DOUBLE_EQ(*psnr(judged(a), judged(b)), -10 * std::log10(1.5));
}

TEST(Metrics, PsnrOfATenthIsTwentyDecibelAndOfEqualImagesNone) {
    EXPECT_NEAR(*psnr(judged(grey(4, 4, 0.1F)), judged(grey(4, 4, 0))), 20, 1e-6);
    EXPECT_FALSE(psnr(judged(grey(4, 4, 0.1F)), judged(grey(4, 4, 0.1F))));
}

TEST(Metrics, LargestFloatsStayFinite) {
    const float big = std::numeric_limits<float>::max();
    EXPECT_DOUBLE_EQ(rmse(judged(grey(3, 3, big)), judged(grey(3, 3, -big))), 2.0 * static_cast<double>(big));
}

TEST(Metrics, SameBitsForAnyThreadCount) {
    RgbImage a = judged(grey(101, 77, 0));
    RgbImage b = a;
    for (std::size_t i = 0; i < a.pixel_count(); ++i) a.channels[i % 3][i] = std::sin(static_cast<double>(i));
    set_thread_count(1);
    const double one[3] = {rmse(a, b), mae(a, b), *ssim(a, b)};
    set_thread_count(4);
    const double four[3] = {rmse(a, b), mae(a, b), *ssim(a, b)};
    set_thread_count(0);
    for (int i = 0; i < 3; ++i) EXPECT_EQ(one[i], four[i]);
}

TEST(Ssim, AgreesWithScikitImage) {
    std::ifstream file(PELLUCID_SOURCE_DIR "/tests/data/ssim.txt");  // tests/oracles/ssim_oracle.py
    std::string comment;
    std::getline(file, comment);
    int width = 0;
    int height = 0;
    int cases = 0;
    file >> width >> height >> cases;
    ASSERT_GT(cases, 0);
    for (int i = 0; i < cases; ++i) {
        double expected = 0;
        file >> expected;
        RgbImage test = judged(grey(width, height, 0));
        RgbImage truth = test;
        for (std::size_t p = 0; p < test.pixel_count(); ++p) {
            for (auto& channel : test.channels) file >> channel[p];
            for (auto& channel : truth.channels) file >> channel[p];
        }
        ASSERT_TRUE(file);
        EXPECT_NEAR(*ssim(test, truth), expected, 1e-12) << "case " << i;
    }
}

TEST(Ssim, OneForEqualImages) { EXPECT_NEAR(*ssim(judged(grey(11, 11, 0.3F)), judged(grey(11, 11, 0.3F))), 1, 1e-15); }

TEST(Ssim, NoneBelowElevenPixels) {
    EXPECT_FALSE(ssim(judged(grey(10, 40, 0.3F)), judged(grey(10, 40, 0.3F))));
    EXPECT_FALSE(ssim(judged(grey(40, 10, 0.3F)), judged(grey(40, 10, 0.3F))));
}

TEST(ErrorMap, IsTheAbsoluteDifferenceOfEachChannel) {
    Image a = grey(1, 1, 0.5F);
    a.plane("B")[0] = 1.0F;
    const Image map = absolute_error_map(judged(a), judged(grey(1, 1, 0.75F)));
    EXPECT_EQ(map.plane("R")[0], 0.25F);
    EXPECT_EQ(map.plane("B")[0], 0.25F);
}

}  // namespace
}  // namespace pellucid
