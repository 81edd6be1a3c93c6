#include "measure/gradient_energy.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

namespace pellucid {
namespace {

RgbImage picture(int width, int height, const std::function<double(double x, double y)>& value) {
    RgbImage image{width, height, {}};
    for (auto& channel : image.channels)
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) channel.push_back(value(x, y));
    return image;
}

double edge(double at, double x) { return x < at ? 0.2 : 0.8; }

TEST(GradientEnergy, NothingBetweenEqualPictures) {
    const RgbImage p = picture(40, 30, [](double x, double y) { return std::sin(0.1 * x * y); });
    EXPECT_EQ(gradient_difference(p, p).excess, 0);
    EXPECT_EQ(gradient_difference(p, p).lack, 0);
}

TEST(GradientEnergy, BandsHaveTheEnergyOfTheirSlopeAtAnyPhase) {
    const RgbImage even = picture(240, 12, [](double, double) { return 0.5; });
    for (const double period : {2.0, 3.0, 8.0, 40.0})
        for (const double phase : {0.3, 1.1}) {
            const RgbImage bands = picture(
                240, 12, [&](double x, double) { return 0.5 + 0.02 * std::sin(2 * std::numbers::pi * x / period + phase); });
            const double raw = period == 2.0 ? 2 * 0.02 * std::abs(std::sin(phase))
                                             : std::numbers::sqrt2 * 0.02 * std::sin(std::numbers::pi / period);
            for (const double ppd : {1e-3, 67.02, 30.0}) {
                // What a Gaussian leaves of a wave; at 30 pixels a degree it is no wider than a pixel, and sampled.
                const double sigma = ppd / (2 * std::numbers::pi * 8);
                double left = 0, weights = 0;
                for (int k = -20; k <= 20; ++k) {
                    const double w = std::exp(-k * k / (2 * sigma * sigma));
                    left += w * std::cos(2 * std::numbers::pi * k / period);
                    weights += w;
                }
                const double expected = raw * std::abs(left / weights);
                const GradientDifference d = gradient_difference(bands, even, ppd);
                // Where the eye leaves little of a wave, what is seen is its end at the borders.
                const double borders = ppd > 1 ? 0.05 * raw : 0;
                EXPECT_NEAR(d.excess, expected, 0.02 * expected + borders) << period << " " << ppd;
                EXPECT_LE(d.lack, 1e-12);
                EXPECT_NEAR(gradient_difference(even, bands, ppd).lack, d.excess, 1e-12);
            }
        }
}

TEST(GradientEnergy, BlurIsLackAndJagsAreExcess) {
    const auto slanted = [](double x, double y) { return x - 0.2 * y; };
    const auto smooth = [&](double width) {
        return picture(64, 64, [=](double x, double y) {
            return 0.5 + 0.3 * std::clamp((slanted(x, y) - 25) / width, -1.0, 1.0);
        });
    };
    const RgbImage truth = smooth(1);
    const GradientDifference blurred = gradient_difference(smooth(6), truth, 1e-3);
    EXPECT_GT(blurred.lack, 3 * blurred.excess);
    const RgbImage jagged = picture(64, 64, [&](double x, double y) { return edge(25, slanted(x, y)); });
    const GradientDifference jags = gradient_difference(jagged, truth, 1e-3);
    EXPECT_GT(jags.excess, 3 * jags.lack);
}

TEST(GradientEnergy, AnEdgeInTheNextPixelIsNotABand) {
    const RgbImage truth = picture(64, 16, [](double x, double) { return edge(30, x); });
    const RgbImage off = picture(64, 16, [](double x, double) { return edge(31, x); });
    const RgbImage band = picture(64, 16, [](double x, double) { return x == 50 ? 0.2 : edge(30, x); });
    EXPECT_LT(gradient_difference(off, truth, 1e-3).excess, 0.5 * gradient_difference(band, truth, 1e-3).excess);
    // As the eye has it, it is less than the edge itself: half of its energy.
    const RgbImage even = picture(64, 16, [](double, double) { return 0.2; });
    EXPECT_LT(gradient_difference(off, truth).excess, 0.7 * gradient_difference(truth, even).excess);
}

TEST(GradientEnergy, ADriftOfTheSameSizeCountsLittle) {
    const RgbImage even = picture(200, 16, [](double, double) { return 0.5; });
    const RgbImage drift = picture(200, 16, [](double x, double) { return 0.4 + 0.2 * x / 199; });
    const RgbImage bands =
        picture(200, 16, [](double x, double) { return 0.5 + 0.1 * std::sin(2 * std::numbers::pi * x / 10); });
    EXPECT_LT(20 * gradient_difference(drift, even).excess, gradient_difference(bands, even).excess);
}

TEST(GradientEnergy, FollowsTheEyesContrastSensitivity) {
    // Periods 4 … 64 pixels at 67 pixels a degree: within a factor of 2, and largest where the eye is most sensitive.
    EXPECT_NEAR(contrast_sensitivity(8), 0.98, 0.01);
    const RgbImage even = picture(512, 12, [](double, double) { return 0.5; });
    double most = 0, at_most = 0;
    for (const double period : {4.0, 6.0, 8.0, 12.0, 16.0, 32.0, 64.0}) {
        const RgbImage bands =
            picture(512, 12, [&](double x, double) { return 0.5 + 0.1 * std::sin(2 * std::numbers::pi * x / period); });
        const double excess = gradient_difference(bands, even).excess;
        const double sensitivity = contrast_sensitivity(67.02 / period);
        if (excess > most) {
            most = excess;
            at_most = period;
        }
        EXPECT_GT(excess / sensitivity, 0.5 * 0.1 * 0.33) << period;
        EXPECT_LT(excess / sensitivity, 1.1 * 0.1 * 0.33) << period;
    }
    EXPECT_EQ(at_most, 8);
}

TEST(GradientEnergy, OnePixelHasNoGradient) {
    const RgbImage a = picture(1, 1, [](double, double) { return 0.1; });
    const RgbImage b = picture(1, 1, [](double, double) { return 0.9; });
    EXPECT_EQ(gradient_difference(a, b).excess, 0);
}

}  // namespace
}  // namespace pellucid
