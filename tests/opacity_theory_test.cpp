#include <cmath>
#include <limits>

#include <boost/multiprecision/cpp_dec_float.hpp>
#include <gtest/gtest.h>

#include "measure/opacity_theory.hpp"

namespace pellucid {
namespace {

using Wide = boost::multiprecision::cpp_dec_float_50;

/// PBSR (1) as printed, 50 digits.
Wide wide_transmittance(double count, const Patch& patch) {
    return pow(1 - Wide(patch.ratio) / Wide(patch.cos_tilt), Wide(count));
}

void expect_relative(double value, const Wide& expected, double tolerance) {
    const Wide off = abs(Wide(value) - expected);
    EXPECT_LE(static_cast<double>(off), tolerance * static_cast<double>(abs(expected)))
        << value << " for " << expected.str(20);
}

TEST(Opacity, KeepsDigitsFromTinyRatioToOpaque) {
    for (const double ratio : {1e-12, 1e-9, 1e-4, 0.013, 0.3, 0.49})
        for (const double cos_tilt : {1.0, 0.7, 0.5})
            for (const double depth : {1e-10, 1e-3, 0.1, 1.0, 5.0, 30.0}) {
                const Patch patch{ratio, cos_tilt};
                const double count = depth / ratio;
                const Wide through = wide_transmittance(count, patch);
                // (1 − p)^n carries the rounding of p = ratio/cos_tilt and of log1p, times the depth.
                expect_relative(*opacity_from_count(count, patch), 1 - through, 2e-15);
                expect_relative(*transmittance_from_count(count, patch), through, 4e-16 * (4 + 4 * depth / cos_tilt));
            }
}

TEST(Opacity, CountIsTheInverse) {
    for (const double ratio : {1e-12, 1e-6, 0.1, 0.45})
        for (const double cos_tilt : {1.0, 0.5})
            for (const double opacity : {1e-14, 1e-6, 0.1, 0.5, 0.999, 1 - 1e-15}) {
                const Patch patch{ratio, cos_tilt};
                const Wide expected = log(1 - Wide(opacity)) / log(1 - Wide(ratio) / Wide(cos_tilt));
                expect_relative(*count_from_opacity(opacity, patch), expected, 2e-15);
            }
}

TEST(Opacity, OneParticleDrawsTheShareOfItsPixel) {
    EXPECT_DOUBLE_EQ(*opacity_from_count(1, {0.25, 1}), 0.25);
    EXPECT_DOUBLE_EQ(*opacity_from_count(1, {0.25, 0.5}), 0.5);
    EXPECT_EQ(*opacity_from_count(0, {0.25, 1}), 0.0);
    EXPECT_EQ(*count_from_opacity(0, {0.25, 1}), 0.0);
}

TEST(Opacity, IsEmptyOutsideTheTheory) {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    EXPECT_FALSE(opacity_from_count(3, {0.5, 0.5}));
    EXPECT_FALSE(opacity_from_count(3, {0.5, 0.3}));
    EXPECT_FALSE(opacity_from_count(3, {1.0, 1.0}));
    EXPECT_FALSE(opacity_from_count(3, {0.0, 1.0}));
    EXPECT_FALSE(opacity_from_count(3, {0.1, 0.0}));
    EXPECT_FALSE(opacity_from_count(3, {0.1, 1.1}));
    EXPECT_FALSE(opacity_from_count(-1, {0.1, 1.0}));
    EXPECT_FALSE(opacity_from_count(nan, {0.1, 1.0}));
    EXPECT_FALSE(opacity_from_count(3, {nan, 1.0}));
    EXPECT_FALSE(opacity_from_count(3, {0.1, nan}));
    EXPECT_FALSE(count_from_opacity(1.0, {0.1, 1.0}));
    EXPECT_FALSE(count_from_opacity(-0.1, {0.1, 1.0}));
    EXPECT_FALSE(count_from_opacity(0.5, {0.5, 0.5}));
    EXPECT_FALSE(oblique_opacity(0.5, 0.0));
    EXPECT_FALSE(poisson_opacity(-1, {0.1, 1.0}));
    EXPECT_TRUE(opacity_from_count(3, {std::nextafter(0.5, 0), 0.5}));
}

TEST(Opacity, TendsToThePoissonLimitFromAbove) {
    const double depth = 0.7;
    double previous = 1;
    for (const double ratio : {0.2, 1e-2, 1e-4, 1e-6}) {
        const double off = *opacity_from_count(depth / ratio, {ratio, 1}) - *poisson_opacity(depth / ratio, {ratio, 1});
        EXPECT_GT(off, 0);
        EXPECT_LT(off, previous);
        // α − α_P ≈ e^(−d)·d·ratio/2
        if (ratio < 0.1) {
            EXPECT_NEAR(off / (0.5 * depth * std::exp(-depth) * ratio), 1, ratio + 1e-7);
        }
        previous = off;
    }
}

TEST(Opacity, TiltInTheManyParticleLimitIsTheObliqueLaw) {
    const double ratio = 1e-9;
    const double count = *count_from_opacity(0.3, {ratio, 1});
    for (const double cos_tilt : {1.0, 0.6, 0.1})
        EXPECT_NEAR(*opacity_from_count(count, {ratio, cos_tilt}), *oblique_opacity(0.3, cos_tilt), 1e-7);
    EXPECT_EQ(*oblique_opacity(1, 0.5), 1.0);
    EXPECT_EQ(*oblique_opacity(0, 0.5), 0.0);
    EXPECT_NEAR(*oblique_opacity(0.5, 0.5), 0.75, 1e-15);
}

}  // namespace
}  // namespace pellucid
