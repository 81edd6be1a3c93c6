// Colours at one depth, in the mean over all orders.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <vector>

#include "core/order_weights.hpp"

namespace pellucid {
namespace {

std::vector<double> weights_of(const std::vector<double>& opacities) {
    std::vector<double> weights;
    weigh_all_orders(opacities, weights);
    return weights;
}

TEST(OrderWeights, AreTheMeanOverAllPermutations) {
    const std::vector<double> opacities{0.3, 1, 0.05, 0.9, 0.62, 0};
    std::vector<std::size_t> order(opacities.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::vector<double> mean(opacities.size());
    double count = 0;
    do {
        double clear = 1;
        for (const std::size_t i : order) {
            mean[i] += clear;
            clear *= 1 - opacities[i];
        }
        ++count;
    } while (std::ranges::next_permutation(order).found);
    const std::vector<double> weights = weights_of(opacities);
    for (std::size_t i = 0; i < mean.size(); ++i) EXPECT_NEAR(weights[i], mean[i] / count, 1e-14) << i;
}

TEST(OrderWeights, ShareWhatIsHiddenWhateverTheNumber) {
    std::mt19937 random(3);
    for (const std::size_t n : {1U, 2U, 3U, 31U, 32U, 33U, 64U, 1000U})
        for (const double most : {1e-6, 0.01, 0.9, 1.0}) {
            std::vector<double> opacities(n);
            for (double& a : opacities) a = most * std::uniform_real_distribution<double>(0.5, 1)(random);
            const std::vector<double> weights = weights_of(opacities);
            double hidden = 0, log_clear = 0;
            for (std::size_t i = 0; i < n; ++i) {
                EXPECT_GT(weights[i], 0);
                EXPECT_LE(weights[i], 1 + 1e-14);
                hidden += weights[i] * opacities[i];
                log_clear += std::log1p(-opacities[i]);
            }
            EXPECT_NEAR(hidden, -std::expm1(log_clear), 1e-12) << n << " of " << most;
        }
}

TEST(OrderWeights, OpaqueOnesAreSeenAlikeHoweverManyThereAre) {
    for (const std::size_t n : {2U, 44U, 64U, 1000U})
        for (const double weight : weights_of(std::vector<double>(n, 1.0)))
            ASSERT_NEAR(weight * static_cast<double>(n), 1, 1e-12) << n;
}

}  // namespace
}  // namespace pellucid
