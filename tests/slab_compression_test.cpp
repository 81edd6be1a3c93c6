#include "stage/slab_compression.hpp"

#include <gtest/gtest.h>

#include <array>

#include "slab_testing.hpp"
#include "stage/slab_merge.hpp"

namespace pellucid {
namespace {

using namespace testing_slabs;

[[nodiscard]] SlabSettings collecting(std::size_t most, SlabCompression compression, float opaque_at = 1) {
    return {.layers = static_cast<int>(most) + 1, .compression = compression, .opaque_at = opaque_at};
}

[[nodiscard]] std::vector<Slab> collected(std::span<const Slab> slabs, const SlabSettings& settings) {
    SlabCollector collector(settings);
    collector.start();
    for (const Slab& slab : slabs)
        if (!collector.push(slab)) break;
    const auto kept = collector.finish();
    return {kept.begin(), kept.end()};
}

/// Transmittance at a depth, falling linearly within a slab.
[[nodiscard]] double transmittance_at(std::span<const Slab> slabs, double depth) {
    double t = 1;
    for (const Slab& s : slabs) {
        const double z = static_cast<double>(s.z);
        const double d = static_cast<double>(s.d);
        const double share = depth >= z ? 1 : d > 0 ? std::max(0.0, (depth - (z - d)) / d) : 0;
        t *= 1 - static_cast<double>(s.a) * share;
    }
    return t;
}
[[nodiscard]] double area_between(std::span<const Slab> a, std::span<const Slab> b, double from, double to) {
    constexpr int kSteps = 20'000;
    double sum = 0;
    for (int i = 0; i < kSteps; ++i) {
        const double depth = from + (to - from) * (i + 0.5) / kSteps;
        sum += std::abs(transmittance_at(a, depth) - transmittance_at(b, depth));
    }
    return sum * (to - from) / kSteps;
}

/// Two soft layers and a wall of fog behind them, 256 steps long, with noise on the opacity.
[[nodiscard]] std::vector<Slab> long_ray(float scale, unsigned seed = 1) {
    RandomSlabs random(seed);
    std::vector<Slab> slabs;
    for (int i = 0; i < 256; ++i) {
        const auto x = static_cast<float>(i) / 256;
        const float layers = std::exp(-400 * (x - 0.2F) * (x - 0.2F)) + std::exp(-900 * (x - 0.5F) * (x - 0.5F)) +
                             (x > 0.7F ? 0.3F : 0.0F);
        const float a = scale * layers * (0.8F + 0.4F * random.unit());
        const float back = 2 + static_cast<float>(i + 1) / 64;
        slabs.push_back({back, 1.0F / 64, a * x, a * (1 - x), 0.5F * a, a});
    }
    return slabs;
}

TEST(SlabCompression, FitsKeepsTheCompositeAndStaysSorted) {
    RandomSlabs random(1);
    for (const SlabCompression compression : kCompressions)
        for (int i = 0; i < 10'000; ++i) {
            const SlabArray array = random.array(30);
            const std::size_t most = 1 + random.below(12);
            for (const auto& fewer : {compress_slabs(array, most, compression),
                                      collected(array, collecting(most, compression))}) {
                ASSERT_LE(fewer.size(), most);
                ASSERT_TRUE(is_sorted_array(fewer)) << testing::PrintToString(fewer);
                const RealColor before = composite_real(array);
                const RealColor after = composite_real(fewer);
                ASSERT_NEAR(static_cast<double>(after.r), static_cast<double>(before.r), 2e-6);
                ASSERT_NEAR(static_cast<double>(after.b), static_cast<double>(before.b), 2e-6);
                ASSERT_NEAR(static_cast<double>(after.a), static_cast<double>(before.a), 2e-6);
            }
        }
}

TEST(SlabCompression, WhatFitsIsNotTouched) {
    RandomSlabs random(2);
    for (const SlabCompression compression : kCompressions)
        for (int i = 0; i < 3'000; ++i) {
            const SlabArray array = random.array(8);
            ASSERT_EQ(compress_slabs(array, 8, compression), array);
        }
    const SlabArray apart{{1, 0.1F, 0.1F, 0, 0, 0.3F}, {2, 0.1F, 0.2F, 0, 0, 0.5F}, {3, 0.1F, 0, 0, 0, 0.1F}};
    for (const SlabCompression compression : kCompressions)
        EXPECT_EQ(collected(apart, collecting(3, compression)), apart);
}

TEST(SlabCompression, TailTakesAllThatFollow) {
    const SlabArray array{{1, 1, 0.5F, 0, 0, 0.5F}, {2, 0.5F, 0, 0.5F, 0, 0.5F}, {4, 1, 0, 0, 0.5F, 0.5F}};
    const std::vector<Slab> two = compress_slabs(array, 2, SlabCompression::tail);
    EXPECT_EQ(two, (std::vector<Slab>{array[0], {4, 2.5F, 0, 0.5F, 0.25F, 0.75F}}));
    EXPECT_EQ(collected(array, collecting(2, SlabCompression::tail)), two);
}

// G of the four: 0.2/1, 0.16/1, 0.32/1, 0.16/1: the first two differ least.
TEST(SlabCompression, SlopeJoinsWhereOpacityRisesAlike) {
    const SlabArray array{{1, 1, 0.2F, 0, 0, 0.2F}, {2, 1, 0, 0.2F, 0, 0.2F}, {3, 1, 0, 0, 0.5F, 0.5F}, {4, 1, 0, 0, 0.5F, 0.5F}};
    const std::vector<Slab> three = compress_slabs(array, 3, SlabCompression::slope);
    ASSERT_EQ(three.size(), 3U);
    EXPECT_EQ(three[0].z, 2);
    EXPECT_EQ(three[0].d, 2);
    EXPECT_FLOAT_EQ(three[0].a, 0.36F);
    EXPECT_FLOAT_EQ(three[0].g, 0.16F);
    EXPECT_EQ(three[1], array[2]);
}

TEST(SlabCompression, SlopeMergesOnlyWhatTouchesWhileItCan) {
    const SlabArray array{{1, 0.5F, 0, 0, 0, 0.1F}, {5, 0.5F, 0, 0, 0, 0.1F}, {6, 1, 0, 0, 0, 0.9F}};
    const std::vector<Slab> two = compress_slabs(array, 2, SlabCompression::slope);
    EXPECT_EQ(two[0], array[0]);
    EXPECT_EQ(two[1].d, 1.5F);
}

TEST(SlabCompression, CostIsTheAreaBetweenTheCurves) {
    RandomSlabs random(3);
    for (int i = 0; i < 300; ++i) {
        const SlabArray array = random.array(2);
        if (array.size() < 2) continue;
        const std::array pair{array[0], array[1]};
        const std::array joined{compress_slabs(pair, 1, SlabCompression::tail)[0]};
        const double cost = merging_cost(pair[0], pair[1], 1);
        ASSERT_NEAR(cost, area_between(pair, joined, 0.5, 5.5), 2e-3) << pair[0] << pair[1];
        ASSERT_NEAR(merging_cost(pair[0], pair[1], 0.25), 0.25 * cost, 1e-12);
    }
}

// A half-transparent wall, a gap, thin fog of three steps: the fog's steps merge first, the gap stays.
TEST(SlabCompression, TransmittanceKeepsWhatMatters) {
    const SlabArray array{{1, 0.1F, 0, 0, 0, 0.5F}, {3, 0.5F, 0, 0, 0, 0.02F}, {3.5F, 0.5F, 0, 0, 0, 0.02F}, {4, 0.5F, 0, 0, 0, 0.021F}};
    const std::vector<Slab> two = compress_slabs(array, 2, SlabCompression::transmittance);
    EXPECT_EQ(two[0], array[0]);
    EXPECT_EQ(two[1].z, 4);
    EXPECT_EQ(two[1].d, 1.5F);
}

TEST(SlabCompression, TransmittanceTakesTheLeastCostEveryTime) {
    RandomSlabs random(4);
    for (int i = 0; i < 2'000; ++i) {
        SlabArray array = random.array(20);
        const std::vector<Slab> fast = compress_slabs(array, 5, SlabCompression::transmittance);
        std::vector<double> before(array.size() + 1, 1.0);
        for (std::size_t k = 0; k < array.size(); ++k) before[k + 1] = before[k] * (1 - static_cast<double>(array[k].a));
        while (array.size() > 5) {
            std::size_t best = 0;
            double least = 1e300;
            for (std::size_t k = 0; k + 1 < array.size(); ++k) {
                const double cost = merging_cost(array[k], array[k + 1], before[k]);
                if (cost >= least) continue;
                least = cost;
                best = k;
            }
            array[best] = compress_slabs(std::span(array).subspan(best, 2), 1, SlabCompression::tail)[0];
            array.erase(array.begin() + static_cast<std::ptrdiff_t>(best) + 1);
            before.erase(before.begin() + static_cast<std::ptrdiff_t>(best) + 1);
        }
        ASSERT_EQ(fast, array);
    }
}

TEST(SlabCompression, TransmittanceFollowsTheCurveBetterThanSlopeAndTail) {
    for (const float scale : {0.01F, 0.05F, 0.3F}) {
        const std::vector<Slab> ray = long_ray(scale);
        const auto error = [&](SlabCompression c) { return area_between(ray, compress_slabs(ray, 7, c), 2, 6); };
        EXPECT_LT(error(SlabCompression::transmittance), 0.7 * error(SlabCompression::slope)) << scale;
        EXPECT_LT(error(SlabCompression::transmittance), 0.2 * error(SlabCompression::tail)) << scale;
    }
}

TEST(SlabCollector, IsNearlyAsGoodAsSeeingTheWholeRay) {
    for (const unsigned seed : {1U, 2U, 3U})
        for (const float scale : {0.01F, 0.05F, 0.3F}) {
            const std::vector<Slab> ray = long_ray(scale, seed);
            const auto streamed = collected(ray, collecting(7, SlabCompression::transmittance));
            const auto whole = compress_slabs(ray, 7, SlabCompression::transmittance);
            EXPECT_LE(area_between(ray, streamed, 2, 6), 2 * area_between(ray, whole, 2, 6)) << scale;
        }
}

TEST(SlabCollector, WhatIsNegligibleJoinsAtOnceAndNothingElseDoes) {
    const SlabSettings settings = collecting(7, SlabCompression::transmittance);
    const float negligible = SlabCollector::negligible_cost(settings, 1);
    EXPECT_FLOAT_EQ(negligible, 4.0F / 343);
    EXPECT_FLOAT_EQ(SlabCollector::negligible_cost(collecting(1, SlabCompression::transmittance), 2), 2.0F / 64);
    EXPECT_EQ(SlabCollector::negligible_cost(collecting(7, SlabCompression::slope), 1), 0);
    const auto kept = [&](std::span<const Slab> slabs) {
        SlabCollector collector(settings, negligible);
        collector.start();
        for (const Slab& slab : slabs) (void)collector.push(slab);
        return collector.finish().size();
    };
    // A triangle of ½·|difference of what two steps take|.
    const auto pair = [](float second) { return std::array<Slab, 2>{{{1, 1, 0, 0, 0, 0.1F}, {2, 1, 0, 0, 0, second}}}; };
    EXPECT_EQ(kept(pair((0.1F + 1.9F * negligible) / 0.9F)), 1U);
    EXPECT_EQ(kept(pair((0.1F + 2.1F * negligible) / 0.9F)), 2U);
    // Along a whole ray it is no worse than what is least worth a slab.
    for (const float scale : {0.01F, 0.05F, 0.3F}) {
        const std::vector<Slab> ray = long_ray(scale);
        SlabCollector collector(settings, SlabCollector::negligible_cost(settings, 1.0 / 64));
        collector.start();
        for (const Slab& slab : ray) (void)collector.push(slab);
        const auto whole = compress_slabs(ray, 7, SlabCompression::transmittance);
        EXPECT_LE(area_between(ray, collector.finish(), 2, 6), 2 * area_between(ray, whole, 2, 6)) << scale;
    }
}

TEST(SlabCollector, EndsTheRayAtItsOpacity) {
    SlabCollector collector(collecting(7, SlabCompression::transmittance, 0.9F));
    collector.start();
    EXPECT_TRUE(collector.push({1, 1, 0, 0, 0, 0.5F}));
    EXPECT_TRUE(collector.push({2, 1, 0, 0, 0, 0.5F}));
    EXPECT_FALSE(collector.push({3, 1, 0, 0, 0, 0.75F}));
    EXPECT_EQ(collector.finish().size(), 3U);
    collector.start();
    EXPECT_TRUE(collector.finish().empty());
    EXPECT_TRUE(collector.push({1, 1, 0, 0, 0, 0.5F}));
    EXPECT_EQ(collector.finish().size(), 1U);
}

TEST(SlabCollector, TakesNothingBehindAnOpaqueSlab) {
    for (const SlabCompression compression : kCompressions) {
        SlabCollector collector(collecting(3, compression, 1));
        collector.start();
        EXPECT_FALSE(collector.push({1, 0, 0.5F, 0, 0, 1}));
        EXPECT_FALSE(collector.push({2, 1, 0.5F, 0, 0, 0.5F}));
        const auto kept = collector.finish();
        EXPECT_EQ(std::vector<Slab>(kept.begin(), kept.end()), (std::vector<Slab>{{1, 0, 0.5F, 0, 0, 1}}));
    }
}

TEST(SlabCollector, ThousandsOfSlabsThinAndThick) {
    for (const SlabCompression compression : kCompressions)
        for (const float thickness : {0.0F, 1e-30F, 1e-3F, 1e25F}) {
            std::vector<Slab> slabs;
            float z = 1;
            for (int i = 0; i < 5000; ++i) {
                z += thickness;
                slabs.push_back({z, thickness, 1e-5F, 0, 0, 1e-4F});
            }
            const auto kept = collected(slabs, collecting(7, compression));
            ASSERT_LE(kept.size(), 7U);
            EXPECT_TRUE(is_sorted_array(kept));
            EXPECT_NEAR(static_cast<double>(composite_real(kept).a), 1 - std::pow(1 - 1e-4, 5000), 1e-4);
        }
}

}  // namespace
}  // namespace pellucid
