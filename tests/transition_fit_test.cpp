#include "measure/transition_fit.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace pellucid {
namespace {

std::vector<TransitionPoint> transition(double center, double width, double exponent, double noise = 0) {
    std::mt19937 random(7);
    std::normal_distribution<double> normal;
    std::vector<TransitionPoint> points;
    for (int x = 0; x < 100; ++x)
        points.push_back({x + 0.5, transition_share(x + 0.5, center, width, exponent) + noise * normal(random)});
    return points;
}

TEST(TransitionFit, FindsCenterWidthAndExponent) {
    for (const double exponent : {1.0, 2.0, 5.0})
        for (const double width : {4.0, 30.0}) {
            const FitResult fit = fit_transition(transition(47.3, width, exponent));
            ASSERT_TRUE(fit.converged);
            EXPECT_NEAR(fit.parameters[0].value, 47.3, 1e-4);
            EXPECT_NEAR(fit.parameters[1].value, width, 1e-3 * width);
            EXPECT_NEAR(fit.parameters[2].value, exponent, 2e-3 * exponent);
        }
}

TEST(TransitionFit, IntervalsHoldTheTruthUnderNoise) {
    const FitResult fit = fit_transition(transition(52, 20, 2, 0.01), 0.999);
    ASSERT_TRUE(fit.converged);
    const double truth[] = {52, 20, 2};
    for (std::size_t i = 0; i < 3; ++i) {
        EXPECT_LE(fit.parameters[i].low, truth[i]) << fit.parameters[i].name;
        EXPECT_GE(fit.parameters[i].high, truth[i]) << fit.parameters[i].name;
        EXPECT_GT(fit.parameters[i].standard_error, 0);
    }
}

TEST(TransitionFit, AStepHasNoShape) {
    std::vector<TransitionPoint> step;
    for (int x = 0; x < 40; ++x) step.push_back({x + 0.5, x < 20 ? 0.0 : 1.0});
    EXPECT_FALSE(fit_transition(step).converged);
    EXPECT_FALSE(fit_transition({}).converged);
}

TEST(TransitionFit, TheShareIsAntisymmetricAndEnds) {
    for (const double u : {0.0, 0.2, 0.9, 1.0, 3.0})
        EXPECT_NEAR(transition_share(10 + u, 10, 1, 2) + transition_share(10 - u, 10, 1, 2), 1, 1e-15);
    EXPECT_EQ(transition_share(11, 10, 1, 2), 1);
    EXPECT_EQ(transition_share(9, 10, 1, 2), 0);
}

}  // namespace
}  // namespace pellucid
