#include "stage/slab_merge.hpp"

#include <gtest/gtest.h>

#include <array>
#include <numeric>

#include "slab_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_slabs;

[[nodiscard]] SlabSettings settings_of(SlabInterpolation interpolation, SlabMixing mixing, float opaque_at = 1) {
    return {.interpolation = interpolation, .mixing = mixing, .opaque_at = opaque_at};
}

template <class Check>
void for_all_rules(const Check& check) {
    for (const SlabInterpolation interpolation : kInterpolations)
        for (const SlabMixing mixing : kMixings) check(settings_of(interpolation, mixing));
}

[[nodiscard]] Real transmittance_of(std::span<const Slab> slabs) {
    Real t = 1;
    for (const Slab& s : slabs) t *= 1 - Real{s.a};
    return t;
}

// ---- Two sorted arrays ------------------------------------------------------------------------

TEST(SlabMerge, OutputIsSortedDisjointAndNeverLongerThanInput) {
    RandomSlabs random(1);
    for_all_rules([&](const SlabSettings& settings) {
        for (int i = 0; i < 20'000; ++i) {
            const SlabArray a = random.array(9);
            const SlabArray b = random.array(9);
            ASSERT_TRUE(is_sorted_array(a) && is_sorted_array(b));
            const SlabArray out = merge_arrays(a, b, settings);
            ASSERT_TRUE(is_sorted_array(out)) << testing::PrintToString(a) << testing::PrintToString(b);
            ASSERT_LE(out.size(), a.size() + b.size());
            ASSERT_EQ(out, merge_arrays(b, a, settings));
        }
    });
}

TEST(SlabMerge, KeepsTheTransmittanceOfBoth) {
    RandomSlabs random(2);
    for (const SlabMixing mixing : kMixings)
        for (const SlabInterpolation interpolation : {SlabInterpolation::modified, SlabInterpolation::original})
            for (int i = 0; i < 20'000; ++i) {
                const SlabArray a = random.array(9);
                const SlabArray b = random.array(9);
                const SlabArray out = merge_arrays(a, b, settings_of(interpolation, mixing));
                const auto exact = static_cast<double>(transmittance_of(a) * transmittance_of(b));
                ASSERT_NEAR(1 - static_cast<double>(composite(out).a), exact, 2e-6);
            }
}

TEST(SlabMerge, NothingAndOneArray) {
    const SlabArray array{{1, 0.5F, 0.1F, 0, 0, 0.5F}, {2, 0.5F, 0.1F, 0, 0, 0.25F}};
    for_all_rules([&](const SlabSettings& settings) {
        EXPECT_EQ(merge_arrays(array, {}, settings), array);
        EXPECT_EQ(merge_arrays({}, array, settings), array);
        EXPECT_TRUE(merge_arrays({}, {}, settings).empty());
    });
    EXPECT_EQ(composite({}), Slab{});
}

// [0, 2] red 0.5 and [4, 6] red 0.5; [1, 5] green 0.8 in three pieces: 0.2 + 0.4/0.8… by (3.6) after each.
TEST(SlabMerge, OneSlabOverTwoByHand) {
    const SlabArray a{{2, 2, 0.5F, 0, 0, 0.5F}, {6, 2, 0.5F, 0, 0, 0.5F}};
    const SlabArray b{{5, 4, 0, 0.8F, 0, 0.8F}};
    const SlabArray out = merge_arrays(a, b, settings_of(SlabInterpolation::modified, SlabMixing::average));
    ASSERT_EQ(out.size(), 3U);
    // [0, 2]: red 0.25, then red 1/3 with green 0.2.
    EXPECT_FLOAT_EQ(out[0].g, 0.75F * (0.2F - 0.5F * 0.2F / 3));
    EXPECT_FLOAT_EQ(out[0].a, 0.25F + 0.75F * (0.2F + 0.8F / 3));
    // [2, 5]: green 0.75 is left, [2, 4] takes 0.5 of it; the rest 0.5 meets red 0.25.
    EXPECT_FLOAT_EQ(out[1].a, 0.5F + 0.5F * 0.625F);
    EXPECT_FLOAT_EQ(out[1].g, 0.5F + 0.5F * (0.5F - 0.5F * 0.5F * 0.25F));
    EXPECT_EQ(out[1].z, 5);
    EXPECT_EQ(out[1].d, 3);
    EXPECT_FLOAT_EQ(out[2].a, 1.0F / 3);
    EXPECT_EQ(out[2].d, 1);
}

TEST(SlabMerge, EndsWhereNothingPasses) {
    const SlabArray a{{1, 1, 0.5F, 0, 0, 0.5F}, {3, 1, 1, 0, 0, 1}, {5, 1, 1, 0, 0, 0.5F}};
    const SlabArray b{{7, 1, 0, 1, 0, 1}};
    EXPECT_EQ(merge_arrays(a, b, settings_of(SlabInterpolation::modified, SlabMixing::average)).size(), 2U);
    EXPECT_EQ(merge_arrays(a, b, settings_of(SlabInterpolation::modified, SlabMixing::average, 0.5F)).size(), 1U);
    EXPECT_EQ(merge_arrays(a, b, settings_of(SlabInterpolation::modified, SlabMixing::average, 2)).size(), 4U);
}

// ---- Insertion --------------------------------------------------------------------------------

TEST(SlabInsertion, AnyStreamBecomesASortedArray) {
    RandomSlabs random(3);
    for_all_rules([&](const SlabSettings& settings) {
        for (int i = 0; i < 5'000; ++i) {
            SlabArray array;
            Real t = 1;
            for (std::size_t k = 0; k < 10; ++k) {
                const Slab slab = random.slab();
                insert_slab(array, slab, settings);
                t *= 1 - Real{slab.a};
                ASSERT_TRUE(is_sorted_array(array)) << testing::PrintToString(array);
                ASSERT_LE(array.size(), k + 1);
            }
            if (settings.interpolation == SlabInterpolation::original_textbook) continue;
            ASSERT_NEAR(1 - static_cast<double>(composite(array).a), static_cast<double>(t), 4e-6);
        }
    });
}

TEST(SlabInsertion, IsMergingWithAnArrayOfOne) {
    RandomSlabs random(4);
    for_all_rules([&](const SlabSettings& settings) {
        SlabSettings never = settings;
        never.opaque_at = 2;
        for (int i = 0; i < 5'000; ++i) {
            const SlabArray array = random.array(9);
            const Slab slab = random.slab();
            SlabArray inserted = array;
            insert_slab(inserted, slab, never);
            ASSERT_EQ(inserted, merge_arrays(array, std::span(&slab, 1), never));
        }
    });
}

TEST(SlabInsertion, OfASortedArrayChangesNothing) {
    RandomSlabs random(5);
    for (int i = 0; i < 5'000; ++i) {
        SlabArray array = random.array(9);
        std::erase_if(array, [](const Slab& s) { return s.d == 0; });  // surfaces at an end belong to the slab there
        SlabArray inserted;
        for (const Slab& slab : array) insert_slab(inserted, slab, {});
        ASSERT_EQ(inserted, array);
    }
}

// ---- Order-free -------------------------------------------------------------------------------

TEST(OrderFreeMerge, EveryOrderGivesTheSameBits) {
    RandomSlabs random(6);
    std::mt19937 shuffles(1);
    for_all_rules([&](const SlabSettings& settings) {
        for (int i = 0; i < 1'000; ++i) {
            std::vector<SlabArray> arrays;
            for (int k = 0; k < 5; ++k) arrays.push_back(random.array(5));
            if (i % 2 == 0) arrays[1] = arrays[0];
            std::vector<std::span<const Slab>> order(arrays.begin(), arrays.end());
            const SlabArray first = merge_order_free(order, settings);
            ASSERT_TRUE(is_sorted_array(first));
            for (int k = 0; k < 8; ++k) {
                std::shuffle(order.begin(), order.end(), shuffles);
                ASSERT_EQ(merge_order_free(order, settings), first);
            }
            // Slabs among the arrays, too.
            SlabArray all;
            for (const SlabArray& array : arrays) all.insert(all.end(), array.begin(), array.end());
            std::shuffle(all.begin(), all.end(), shuffles);
            const std::array one{std::span<const Slab>(all)};
            ASSERT_EQ(merge_order_free(one, settings), first);
            ASSERT_LE(first.size(), order_free_plan(all.size()).most_slabs);
        }
    });
}

TEST(OrderFreeMerge, OneByOneDependsOnTheOrderAndThisDoesNot) {
    const SlabArray a{{2, 2, 0.9F, 0, 0, 0.9F}};
    const SlabArray b{{3, 2, 0, 0.9F, 0, 0.9F}};
    const SlabArray c{{2.5F, 2, 0, 0, 0.9F, 0.9F}};
    const SlabSettings settings = settings_of(SlabInterpolation::modified, SlabMixing::average);
    const auto one_by_one = [&](const SlabArray& x, const SlabArray& y, const SlabArray& z) {
        return composite(merge_arrays(merge_arrays(x, y, settings), z, settings));
    };
    EXPECT_GT(std::abs(one_by_one(a, b, c).g - one_by_one(c, b, a).g), 1e-3);
}

TEST(OrderFreeMerge, KeepsTheTransmittanceOfAll) {
    RandomSlabs random(7);
    for (const SlabMixing mixing : kMixings)
        for (const SlabInterpolation interpolation : {SlabInterpolation::modified, SlabInterpolation::original})
            for (int i = 0; i < 2'000; ++i) {
                std::vector<Slab> slabs;
                for (int k = 0; k < 12; ++k) slabs.push_back(random.slab());
                const std::array one{std::span<const Slab>(slabs)};
                const SlabArray out = merge_order_free(one, settings_of(interpolation, mixing));
                ASSERT_NEAR(1 - static_cast<double>(composite(out).a), static_cast<double>(transmittance_of(slabs)), 1e-5);
            }
}

TEST(OrderFreeMerge, TwoSlabsAreTheKernelsTwo) {
    RandomSlabs random(8);
    for (const SlabMixing mixing : kMixings)
        for (int i = 0; i < 20'000; ++i) {
            const std::array slabs{random.slab(), random.slab()};
            const SlabSettings settings = settings_of(SlabInterpolation::modified, mixing, 2);
            const std::array one{std::span<const Slab>(slabs)};
            const Slab free = composite(merge_order_free(one, settings));
            const Slab kernel = composite(merge_arrays(std::span(&slabs[0], 1), std::span(&slabs[1], 1), settings));
            const bool surface_at_back = (slabs[0].d == 0) != (slabs[1].d == 0) && slabs[0].z == slabs[1].z;
            if (surface_at_back) continue;
            ASSERT_NEAR(free.r, kernel.r, 2e-6) << slabs[0] << slabs[1];
            ASSERT_NEAR(free.a, kernel.a, 2e-6);
        }
}

/// The mean over all orders of compositing.
[[nodiscard]] RealColor mean_over_orders(const std::vector<Slab>& slabs) {
    std::vector<std::size_t> order(slabs.size());
    std::iota(order.begin(), order.end(), 0U);
    RealColor sum;
    Real count = 0;
    do {
        std::vector<Slab> ordered;
        for (const std::size_t i : order) ordered.push_back(slabs[i]);
        const RealColor one = composite_real(ordered);
        sum = {sum.r + one.r, sum.g + one.g, sum.b + one.b, sum.a + one.a};
        ++count;
    } while (std::next_permutation(order.begin(), order.end()));
    return {sum.r / count, sum.g / count, sum.b / count, sum.a / count};
}

TEST(OrderFreeMerge, AverageIsTheMeanOverAllOrdersOfCompositing) {
    RandomSlabs random(9);
    for (std::size_t count = 1; count <= 7; ++count)
        for (int i = 0; i < 20; ++i) {
            std::vector<Slab> slabs;
            for (std::size_t k = 0; k < count; ++k) {
                Slab s = random.slab();
                s.z = 2;
                s.d = i % 2 == 0 ? 1.0F : 0.0F;
                slabs.push_back(s);
            }
            const std::array one{std::span<const Slab>(slabs)};
            const SlabArray out = merge_order_free(one, settings_of(SlabInterpolation::modified, SlabMixing::average));
            ASSERT_EQ(out.size(), 1U);
            const RealColor mean = mean_over_orders(slabs);
            EXPECT_LE(ulps_off(out[0].r, mean.r), 3);
            EXPECT_LE(ulps_off(out[0].b, mean.b), 3);
            EXPECT_LE(ulps_off(out[0].a, mean.a), 3);
        }
}

TEST(OrderFreeMerge, ManySlabsOfOneMediumAreOneMedium) {
    for (const SlabMixing mixing : kMixings)
        for (const std::size_t count : {3U, 33U, 200U}) {
            const std::vector<Slab> slabs(count, Slab{1, 1, 0.01F, 0.005F, 0, 0.02F});
            const std::array one{std::span<const Slab>(slabs)};
            const SlabArray out = merge_order_free(one, settings_of(SlabInterpolation::original, mixing));
            const Real a = -std::expm1(static_cast<Real>(count) * std::log1p(-Real{0.02F}));
            ASSERT_EQ(out.size(), 1U);
            EXPECT_LE(ulps_off(out[0].a, a), 2);
            EXPECT_LE(ulps_off(out[0].r, a / 2), 4);
        }
}

TEST(OrderFreeMerge, SurfacesLieBetweenTheIntervalsTheyDivide) {
    const std::array slabs{Slab{2, 0, 1, 0, 0, 0.5F}, Slab{4, 4, 0, 0.5F, 0, 0.5F}, Slab{2, 0, 0, 0, 1, 0.5F}};
    const std::array one{std::span<const Slab>(slabs)};
    const SlabArray out = merge_order_free(one, settings_of(SlabInterpolation::modified, SlabMixing::average));
    ASSERT_EQ(out.size(), 3U);
    EXPECT_EQ(out[0].a, 0.25F);
    EXPECT_EQ(out[1], (Slab{2, 0, 0.75F, 0, 0.75F, 0.75F}));
    EXPECT_FLOAT_EQ(out[2].a, 1.0F / 3);
}

TEST(OrderFreeMerge, OpaqueMediaHideTheRest) {
    const std::array slabs{Slab{1, 1, 1, 0, 0, 1}, Slab{1, 1, 0, 0.5F, 0, 0.5F}, Slab{1, 1, 0, 0, 1, 1}};
    const std::array one{std::span<const Slab>(slabs)};
    const SlabArray out = merge_order_free(one, settings_of(SlabInterpolation::original, SlabMixing::extinction));
    EXPECT_EQ(out, (SlabArray{{1, 1, 0.5F, 0, 0.5F, 1}}));
}

TEST(OrderFreeMerge, NothingIsNothing) { EXPECT_TRUE(merge_order_free({}, {}).empty()); }

}  // namespace
}  // namespace pellucid
