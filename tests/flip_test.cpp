#include <cmath>
#include <fstream>
#include <sstream>
#include <string>

#include <gtest/gtest.h>

#include "core/parallel.hpp"
#include "measure/flip.hpp"
#include "measure/magma.hpp"

namespace pellucid {
namespace {

RgbImage uniform_image(int width, int height, double r, double g, double b) {
    RgbImage image{width, height, {}};
    const double color[3] = {r, g, b};
    for (std::size_t c = 0; c < 3; ++c) image.channels[c].assign(image.pixel_count(), color[c]);
    return image;
}

struct Vector {
    RgbImage test, truth;
    double ppd = 0;
    std::vector<double> expected;
};

/// A file of tests/oracles/flip_oracle.py.
Vector read_vector(const std::string& name) {
    std::ifstream file(PELLUCID_SOURCE_DIR "/tests/data/flip_" + name + ".txt");
    std::string comment;
    std::getline(file, comment);
    Vector v;
    int width = 0;
    int height = 0;
    file >> width >> height >> v.ppd;
    v.test = uniform_image(width, height, 0, 0, 0);
    v.truth = v.test;
    v.expected.resize(v.test.pixel_count());
    for (std::size_t i = 0; i < v.expected.size(); ++i) {
        for (auto& channel : v.test.channels) file >> channel[i];
        for (auto& channel : v.truth.channels) file >> channel[i];
        file >> v.expected[i];
    }
    EXPECT_TRUE(file) << name << " is missing or cut short";
    EXPECT_FALSE(v.expected.empty());
    return v;
}

class FlipOracle : public testing::TestWithParam<const char*> {};

TEST_P(FlipOracle, AgreesWithBruteForceInTwoDimensions) {
    const Vector v = read_vector(GetParam());
    const FlipError error = flip(v.test, v.truth, v.ppd);
    double mean = 0;
    for (std::size_t i = 0; i < v.expected.size(); ++i) {
        EXPECT_NEAR(error.map[i], v.expected[i], 1e-5) << "pixel " << i;
        mean += v.expected[i];
    }
    EXPECT_NEAR(error.mean, mean / static_cast<double>(v.expected.size()), 1e-6);
}

INSTANTIATE_TEST_SUITE_P(Pairs, FlipOracle,
                         testing::Values("edge", "points", "colors", "noise_ppd20", "noise_ppd3", "edge_ppd150", "row",
                                         "green_blue"));

TEST(Flip, EqualImagesGiveZero) {
    const RgbImage image = read_vector("colors").truth;
    const FlipError error = flip(image, image);
    EXPECT_EQ(error.mean, 0);
    for (const double e : error.map) EXPECT_EQ(e, 0);
}

TEST(Flip, GreenAgainstBlueIsTheLargestError) {
    EXPECT_NEAR(flip(uniform_image(5, 5, 0, 1, 0), uniform_image(5, 5, 0, 0, 1)).mean, 1, 1e-12);
    EXPECT_LT(flip(uniform_image(5, 5, 0, 0, 0), uniform_image(5, 5, 1, 1, 1)).mean, 1);
}

TEST(Flip, IsSymmetric) {
    const Vector v = read_vector("noise_ppd20");
    EXPECT_EQ(flip(v.test, v.truth).map, flip(v.truth, v.test).map);
}

TEST(Flip, ClampsToTheScreensRange) {
    EXPECT_EQ(flip(uniform_image(4, 4, 7, 1, 1), uniform_image(4, 4, 1, 30, 1)).mean, 0);
    EXPECT_EQ(flip(uniform_image(4, 4, -7, 0, 0), uniform_image(4, 4, 0, 0, -0.5)).mean, 0);
}

TEST(Flip, SmallestImageAndExtremePpdStayInRange) {
    for (const double ppd : {kMinPixelsPerDegree, kDefaultPixelsPerDegree, kMaxPixelsPerDegree})
        for (const double value : {0.0, 0.5, 1.0}) {
            const double e = flip(uniform_image(1, 1, 1, 0.2, 0), uniform_image(1, 1, value, value, value), ppd).mean;
            EXPECT_GT(e, 0);
            EXPECT_LE(e, 1);
        }
    const Vector v = read_vector("noise_ppd20");
    for (const double ppd : {kMinPixelsPerDegree, kMaxPixelsPerDegree})
        for (const double e : flip(v.test, v.truth, ppd).map) {
            EXPECT_GE(e, 0);
            EXPECT_LE(e, 1);
        }
}

TEST(Flip, SameBitsForAnyThreadCount) {
    RgbImage a = uniform_image(97, 61, 0, 0, 0);
    RgbImage b = a;
    for (std::size_t i = 0; i < a.pixel_count(); ++i) {
        a.channels[i % 3][i] = 0.5 + 0.5 * std::sin(0.37 * static_cast<double>(i));
        b.channels[1][i] = 0.5 + 0.5 * std::cos(0.11 * static_cast<double>(i));
    }
    set_thread_count(1);
    const FlipError one = flip(a, b);
    set_thread_count(4);
    const FlipError four = flip(a, b);
    set_thread_count(0);
    EXPECT_EQ(one.map, four.map);
    EXPECT_EQ(one.mean, four.mean);
}

TEST(Magma, RunsFromBlackToPaleYellowAndClamps) {
    const Image image = magma_image({-1, 0, 1, 2}, 4, 1);
    EXPECT_EQ(image.plane("R")[0], image.plane("R")[1]);
    EXPECT_EQ(image.plane("G")[2], image.plane("G")[3]);
    EXPECT_EQ(image.plane("R")[0], 0);
    EXPECT_GT(image.plane("R")[3], 0.95F);
    EXPECT_LT(image.plane("B")[3], image.plane("R")[3]);
}

TEST(Magma, LinearValuesEncodeBackToTheBytesOfTheMap) {
    std::vector<double> values;
    for (int i = 0; i < 256; ++i) values.push_back(i / 255.0);
    const Image image = magma_image(values, 256, 1);
    const char* names[3] = {"R", "G", "B"};
    for (std::size_t i = 0; i < 256; ++i)
        for (std::size_t c = 0; c < 3; ++c) {
            const double v = image.plane(names[c])[i];
            const double srgb = v <= 0.0031308 ? 12.92 * v : 1.055 * std::pow(v, 1 / 2.4) - 0.055;
            EXPECT_EQ(std::lround(255 * srgb), kMagma[i][c]);
        }
}

}  // namespace
}  // namespace pellucid
