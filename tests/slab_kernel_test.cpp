#include <gtest/gtest.h>

#include <array>

#include "kernel/intermix_twin.h"
#include "slab_testing.hpp"
#include "stage/slab_merge.hpp"

namespace pellucid {
namespace {

using namespace testing_slabs;
using twin::uint;

constexpr uint kModified = twin::kInterpolateModified;
constexpr uint kOriginal = twin::kInterpolateOriginal;
constexpr uint kTextbook = twin::kInterpolateTextbook;

[[nodiscard]] twin::SlabParts cut(const Slab& slab, float at, uint interpolation) {
    return twin::split_slab(slab, twin::slab_front(slab), at, interpolation);
}

// ---- Splitting --------------------------------------------------------------------------------

TEST(SlabSplit, HalvesAreTheDissertations) {
    const Slab slab{2, 2, 0.45F, 0.9F, 0, 0.9F};
    const auto linear = cut(slab, 1, kModified);  // (3.4) to (3.6): 0.45, (0.9 − 0.45)/(1 − 0.45)
    EXPECT_FLOAT_EQ(linear.front.a, 0.45F);
    EXPECT_FLOAT_EQ(linear.front.r, 0.225F);
    EXPECT_FLOAT_EQ(linear.back.a, 9.0F / 11);
    EXPECT_FLOAT_EQ(linear.back.g, 9.0F / 11);
    for (const uint how : {kOriginal, kTextbook}) {
        const auto homogeneous = cut(slab, 1, how);  // 1 − √0.1 twice
        EXPECT_NEAR(homogeneous.front.a, 0.683772234, 2e-7);
        EXPECT_NEAR(homogeneous.back.a, 0.683772234, 2e-7);
        EXPECT_NEAR(homogeneous.front.r, 0.341886117, 2e-7);
    }
    EXPECT_EQ(linear.front.z, 1);
    EXPECT_EQ(linear.front.d, 1);
    EXPECT_EQ(linear.back.z, 2);
    EXPECT_EQ(linear.back.d, 1);
}

/// Largest errors over all opacities, thicknesses and places, in ULP of the whole.
struct Worst {
    Real a = 0;
    Real color = 0;
};
[[nodiscard]] Worst worst_recomposition(uint interpolation) {
    RandomSlabs random(1);
    Worst worst;
    for (int i = 0; i < 2'000'000; ++i) {
        Slab slab = random.slab();
        if (i % 7 == 0) slab.d = random.one_of(kThicknesses);
        const float front = twin::slab_front(slab);
        const float at = std::clamp(front + random.unit() * (slab.z - front), front, slab.z);
        const auto parts = cut(slab, at, interpolation);
        const RealColor whole = composite_real(std::array{parts.front, parts.back});
        worst.a = std::max(worst.a, ulps_off(whole.a, slab.a));
        worst.color = std::max(worst.color, ulps_off(whole.r, slab.r));
        for (const float part : {parts.front.a, parts.back.a})
            if (!(part >= 0 && part <= slab.a)) ADD_FAILURE() << slab << " at " << at << ": part " << part;
        for (const float part : {parts.front.r, parts.back.r})
            if (!(part >= 0 && part <= slab.r)) ADD_FAILURE() << slab << " at " << at << ": colour of part " << part;
    }
    return worst;
}

TEST(SlabSplit, PartsCompositeToTheWhole) {
    for (const uint interpolation : {kModified, kOriginal}) {
        const Worst worst = worst_recomposition(interpolation);
        EXPECT_LE(worst.a, 4) << interpolation;
        EXPECT_LE(worst.color, 5) << interpolation;
    }
}

TEST(SlabSplit, TextbookLosesDigitsThatTheStableFormsKeep) {
    const Slab faint{1, 1, 1e-7F, 1e-7F, 1e-7F, 1e-7F};
    const Real exact = -std::expm1(Real{0.25F} * std::log1p(-Real{1e-7F}));
    EXPECT_LE(ulps_off(cut(faint, 0.25F, kOriginal).front.a, exact), 4);
    EXPECT_GE(std::abs(cut(faint, 0.25F, kTextbook).front.a - exact), 0.1L * exact);
}

TEST(SlabSplit, AgreesWithExactNumbers) {
    RandomSlabs random(2);
    Real worst_modified = 0;
    Real worst_original = 0;
    for (int i = 0; i < 300'000; ++i) {
        const float a = random.opacity();
        if (a < 1e-20F || a == 1) continue;  // no part below the smallest normal number
        const Slab slab{1, 1, a, a, a, a};
        const float at = std::ldexp(random.unit(), -static_cast<int>(random.below(3)) * 8);
        const Real t = at;
        const Real u = 1 - t;
        const Real front_length = t;
        const auto linear = cut(slab, at, kModified);
        const Real back = (1.0F - at);  // as both see it
        worst_modified = std::max(worst_modified, ulps_off(linear.front.a, a * front_length));
        worst_modified = std::max(worst_modified, ulps_off(linear.back.a, a * back / (1 - Real{a} + a * back)));
        const auto homogeneous = cut(slab, at, kOriginal);
        worst_original = std::max(worst_original, ulps_off(homogeneous.front.a, -std::expm1(t * std::log1p(-Real{a}))));
        worst_original = std::max(worst_original, ulps_off(homogeneous.back.a, -std::expm1(back * std::log1p(-Real{a}))));
        EXPECT_NEAR(static_cast<double>(u), static_cast<double>(back), 1e-7);
    }
    EXPECT_LE(worst_modified, 5);
    EXPECT_LE(worst_original, 6);
}

TEST(SlabSplit, OpacityRisesWithTheCut) {
    RandomSlabs random(3);
    for (const uint interpolation : {kModified, kOriginal, kTextbook})
        for (const float a : kOpacities) {
            const Slab slab{3, 2, 0.5F * a, 0, a, a};
            float last = 0;
            float last_color = 0;
            float last_back = a;
            for (int i = 0; i <= 20'000; ++i) {
                const float at = 1 + 2 * static_cast<float>(i) / 20'000;
                const auto parts = cut(slab, at, interpolation);
                // twin_power and twin_expm1 are good to 1.2 ULP, so neighbours may change places by one.
                const float give = interpolation == kModified ? 0 : 2e-7F;
                EXPECT_GE(parts.front.a, last - give);
                EXPECT_GE(parts.front.r, last_color - give);
                if (a < 1) {
                    EXPECT_LE(parts.back.a, last_back + (interpolation == kTextbook ? 0.7F : 3e-7F));
                }
                last = parts.front.a;
                last_color = parts.front.r;
                last_back = parts.back.a;
            }
            EXPECT_EQ(last, a);
        }
}

TEST(SlabSplit, BordersGiveAllAndNothing) {
    for (const uint interpolation : {kModified, kOriginal, kTextbook})
        for (const float a : kOpacities)
            for (const float d : kThicknesses) {
                const Slab slab{5, d, 0.25F * a, 0.5F * a, a, a};
                const float front = twin::slab_front(slab);
                const auto behind = cut(slab, front, interpolation);
                EXPECT_EQ(behind.front.a, 0);
                EXPECT_EQ(behind.back, slab);
                if (front == slab.z) continue;  // a surface lies behind the cut
                const auto before = cut(slab, slab.z, interpolation);
                EXPECT_EQ(before.front, slab);
                EXPECT_EQ(before.back.a, 0);
                EXPECT_EQ(before.back.r, 0);
            }
}

TEST(SlabSplit, OpaqueSlabsStayOpaqueBehind) {
    const Slab slab{2, 2, 0.5F, 1, 0, 1};
    for (const float at : {0.1F, 1.0F, 1.9999999F}) {
        EXPECT_EQ(cut(slab, at, kModified).front.a, at / 2);
        EXPECT_EQ(cut(slab, at, kModified).back.a, 1);
        EXPECT_EQ(cut(slab, at, kOriginal).front.a, 1);  // the jump of (3.2)
        EXPECT_EQ(cut(slab, at, kOriginal).back.a, 1);
        EXPECT_EQ(cut(slab, at, kTextbook).front.a, 1);
        EXPECT_EQ(cut(slab, at, kTextbook).back.a, 1);
    }
}

TEST(SlabSplit, EmissionWithoutOpacityIsSpreadEvenly) {
    const Slab glow{1, 1, 0.5F, 0.25F, 1, 0};
    for (const uint interpolation : {kModified, kOriginal}) {
        const auto parts = cut(glow, 0.25F, interpolation);
        EXPECT_EQ(parts.front.r, 0.125F);
        EXPECT_EQ(parts.back.r, 0.375F);
        EXPECT_EQ(parts.front.a, 0);
        EXPECT_EQ(parts.back.a, 0);
    }
}

TEST(SlabSplit, PartsDoNotOverlapInFloat) {
    RandomSlabs random(4);
    for (int i = 0; i < 500'000; ++i) {
        const float front = std::ldexp(random.unit(), static_cast<int>(random.below(24)) - 12);
        const float at = front + std::ldexp(random.unit(), static_cast<int>(random.below(24)) - 12);
        const float back = at + std::ldexp(random.unit(), static_cast<int>(random.below(24)) - 12);
        const Slab behind{back, twin::thickness_between(at, back), 0, 0, 0, 0};
        EXPECT_GE(twin::slab_front(behind), at);
        EXPECT_LE(ulps_off(behind.d, Real{back} - Real{at}), 1.5L);
    }
}

// ---- Mixing -----------------------------------------------------------------------------------

TEST(SlabMixing, TwoHalfOpaqueSlabs) {
    const Slab red{1, 1, 0.5F, 0, 0, 0.5F};
    const Slab green{1, 1, 0, 0.25F, 0, 0.25F};
    const Slab average = twin::mix_slabs(red, green, twin::kMixAverage);
    EXPECT_EQ(average.a, 0.625F);
    EXPECT_EQ(average.r, 0.5F - 0.5F * 0.5F * 0.25F);
    EXPECT_EQ(average.g, 0.25F - 0.5F * 0.25F * 0.5F);
    const Slab normalised = twin::mix_slabs(red, green, twin::kMixNormalised);
    EXPECT_FLOAT_EQ(normalised.r, 0.625F * 0.5F / 0.75F);
    EXPECT_FLOAT_EQ(normalised.g, 0.625F * 0.25F / 0.75F);
    const Slab physics = twin::mix_slabs(red, green, twin::kMixExtinction);
    const double s1 = -std::log(0.5);
    const double s2 = -std::log(0.75);
    EXPECT_FLOAT_EQ(physics.r, static_cast<float>(0.625 * s1 / (s1 + s2)));
    EXPECT_FLOAT_EQ(physics.g, static_cast<float>(0.625 * s2 / (s1 + s2)));
}

TEST(SlabMixing, KeepsOpacityAndOrderDoesNotMatter) {
    RandomSlabs random(5);
    for (const uint mixing : {twin::kMixAverage, twin::kMixNormalised, twin::kMixExtinction})
        for (int i = 0; i < 300'000; ++i) {
            const Slab a = random.slab();
            const Slab b = random.slab();
            Slab ab = twin::mix_slabs(a, b, mixing);
            const Slab ba = twin::mix_slabs(b, a, mixing);
            ab.z = ba.z;
            ab.d = ba.d;
            EXPECT_EQ(ab, ba);
            const Real exact = Real{a.a} + b.a - Real{a.a} * b.a;
            EXPECT_LE(ulps_off(ab.a, exact), 1.5L) << a << b;
            EXPECT_LE(ab.a, 1);
            // The blue of both is as large as their opacity: a white medium stays white.
            EXPECT_LE(ulps_off(ab.b, exact), 6) << a << b << mixing;
        }
}

TEST(SlabMixing, NothingChangesNothing) {
    for (const uint mixing : {twin::kMixAverage, twin::kMixNormalised, twin::kMixExtinction})
        for (const float a : kOpacities) {
            const Slab slab{1, 1, 0.3F * a, 0.7F * a, a, a};
            EXPECT_EQ(twin::mix_slabs(slab, {1, 1, 0, 0, 0, 0}, mixing), slab) << a;
        }
}

TEST(SlabMixing, OpaqueMediaAreTheLimit) {
    const Slab red{1, 1, 1, 0, 0, 1};
    const Slab green{1, 1, 0, 1, 0, 1};
    const Slab mist{1, 1, 0, 0, 0.5F, 0.5F};
    EXPECT_EQ(twin::mix_slabs(red, mist, twin::kMixExtinction), red);
    EXPECT_EQ(twin::mix_slabs(red, green, twin::kMixExtinction), (Slab{1, 1, 0.5F, 0.5F, 0, 1}));
    EXPECT_EQ(twin::mix_slabs(red, green, twin::kMixAverage), (Slab{1, 1, 0.5F, 0.5F, 0, 1}));
}

// ---- The intermixing kernel -------------------------------------------------------------------

[[nodiscard]] twin::Intermixed mixed(const Slab& prior, const Slab& posterior, uint interpolation = kModified,
                                     uint mixing = twin::kMixAverage) {
    return twin::intermix(prior, posterior, interpolation, mixing);
}

TEST(IntermixKernel, NoOverlapLeavesBothAsTheyAre) {
    const Slab near{1, 1, 0.1F, 0, 0, 0.5F};
    for (const float front : {1.0F, 1.5F}) {
        const Slab far{front + 1, 1, 0, 0.1F, 0, 0.25F};
        const auto r = mixed(near, far);
        EXPECT_EQ(r.integrated, near);
        EXPECT_EQ(r.remaining, far);
        EXPECT_EQ(r.remains, 1U);
    }
}

// Prior [0, 2] of 0.5 red, posterior [1, 3] of 0.5 green. Front 0.25; rest of prior 0.25/0.75 = 1/3; first half of
// posterior 0.25; mixture 1/2 of red 1/3 − 1/24 and green 1/4 − 1/24; behind 0.25 of it: 1/4 + 3/4·7/24 and 3/4·5/24.
TEST(IntermixKernel, PartialOverlap) {
    const auto r = mixed({2, 2, 0.5F, 0, 0, 0.5F}, {3, 2, 0, 0.5F, 0, 0.5F});
    EXPECT_FLOAT_EQ(r.integrated.r, 0.25F + 0.75F * 7 / 24);
    EXPECT_FLOAT_EQ(r.integrated.g, 0.75F * 5 / 24);
    EXPECT_FLOAT_EQ(r.integrated.a, 0.25F + 0.75F * 0.5F);
    EXPECT_EQ(r.integrated.z, 2);
    EXPECT_EQ(r.integrated.d, 2);
    EXPECT_FLOAT_EQ(r.remaining.a, 1.0F / 3);
    EXPECT_EQ(r.remaining.z, 3);
    EXPECT_EQ(r.remaining.d, 1);
}

// Posterior [0, 4] of 0.8, prior [1, 2] of 0.5: parts 0.2, 0.25 and 0.4/0.6.
TEST(IntermixKernel, PriorInsidePosterior) {
    const auto r = mixed({2, 1, 0.5F, 0, 0, 0.5F}, {4, 4, 0, 0.8F, 0, 0.8F});
    EXPECT_FLOAT_EQ(r.integrated.r, 0.8F * (0.5F - 0.0625F));
    EXPECT_FLOAT_EQ(r.integrated.g, 0.2F + 0.8F * (0.25F - 0.0625F));
    EXPECT_FLOAT_EQ(r.integrated.a, 0.2F + 0.8F * 0.625F);
    EXPECT_EQ(r.integrated.d, 2);
    EXPECT_FLOAT_EQ(r.remaining.a, 2.0F / 3);
    EXPECT_EQ(r.remaining.d, 2);
}

TEST(IntermixKernel, EqualBacksEndBoth) {
    const Slab thick{4, 4, 0, 0.5F, 0, 0.5F};
    const Slab thin{4, 1, 0.25F, 0, 0, 0.25F};
    const auto r = mixed(thick, thin);
    EXPECT_EQ(r.remains, 0U);
    EXPECT_EQ(r.integrated.z, 4);
    EXPECT_EQ(r.integrated.d, 4);
    EXPECT_FLOAT_EQ(r.integrated.a, 0.625F);
    EXPECT_EQ(r.integrated, mixed(thin, thick).integrated);
}

TEST(IntermixKernel, SurfacesWithoutThickness) {
    const Slab medium{4, 4, 0, 0.5F, 0, 0.5F};
    const Slab inside{2, 0, 0.5F, 0, 0, 0.5F};
    const auto divided = mixed(inside, medium);
    EXPECT_FLOAT_EQ(divided.integrated.a, 0.25F + 0.75F * 0.5F);
    EXPECT_FLOAT_EQ(divided.integrated.r, 0.375F);
    EXPECT_EQ(divided.integrated.d, 2);
    EXPECT_FLOAT_EQ(divided.remaining.a, 1.0F / 3);

    const Slab at_front{0, 0, 0.5F, 0, 0, 0.5F};
    EXPECT_EQ(mixed(at_front, medium).integrated, at_front);
    EXPECT_EQ(mixed(at_front, medium).remaining, medium);

    const Slab at_back{4, 0, 0.5F, 0, 0, 0.5F};
    EXPECT_FLOAT_EQ(mixed(at_back, medium).integrated.r, 0.25F);
    EXPECT_EQ(mixed(at_back, medium).integrated, mixed(medium, at_back).integrated);
    EXPECT_EQ(mixed(at_back, medium).remains, 0U);

    const Slab other{4, 0, 0, 0.5F, 0, 0.5F};
    EXPECT_EQ(mixed(at_back, other).integrated, (Slab{4, 0, 0.375F, 0.375F, 0, 0.75F}));
    EXPECT_EQ(mixed(at_back, other).remains, 0U);
}

TEST(IntermixKernel, KeepsTheOpacityOfBothAndStaysInRange) {
    RandomSlabs random(6);
    for (const SlabInterpolation interpolation : kInterpolations)
        for (const SlabMixing mixing : kMixings)
            for (int i = 0; i < 100'000; ++i) {
                Slab prior = random.slab();
                Slab posterior = random.slab();
                if (i % 9 == 0) posterior.d = random.one_of(kThicknesses);
                if (posterior.z < prior.z) std::swap(prior, posterior);
                const auto r = mixed(prior, posterior, uint(interpolation), uint(mixing));
                const std::array out{r.integrated, r.remains != 0 ? r.remaining : Slab{}};
                for (const Slab& s : out) {
                    ASSERT_TRUE(s.a >= 0 && s.a <= 1 && s.d >= 0) << prior << posterior << s;
                    ASSERT_TRUE(s.r >= 0 && s.r <= 1 && s.b <= s.a * (1 + 2e-6F)) << prior << posterior << s;
                }
                EXPECT_EQ(r.integrated.z, prior.z);
                if (r.remains != 0) {
                    EXPECT_EQ(r.remaining.z, posterior.z);
                    EXPECT_GE(twin::slab_front(r.remaining), prior.z);
                }
                if (interpolation == SlabInterpolation::original_textbook) continue;
                const Real exact = Real{prior.a} + posterior.a - Real{prior.a} * posterior.a;
                EXPECT_LE(ulps_off(composite_real(out).a, exact), 8) << prior << posterior;
            }
}

// ---- Two media in one place -------------------------------------------------------------------

/// Colour and opacity of homogeneous media that overlap, step by step: an integrator that knows nothing of slabs.
[[nodiscard]] RealColor march(std::span<const Slab> media) {
    constexpr int kSteps = 200'000;
    const Real end = 6;
    const Real h = end / kSteps;
    RealColor sum;
    for (int i = 0; i < kSteps; ++i) {
        const Real x = (i + Real{0.5}) * h;
        Real sigma = 0;
        Real r = 0;
        Real g = 0;
        for (const Slab& m : media) {
            if (x < Real{m.z} - Real{m.d} || x >= m.z) continue;
            const Real s = -std::log1p(-Real{m.a}) / m.d;
            sigma += s;
            r += s * m.r / m.a;
            g += s * m.g / m.a;
        }
        const Real t = 1 - sum.a;
        const Real lost = -std::expm1(-sigma * h);
        if (sigma == 0) continue;
        sum.r += t * lost * r / sigma;
        sum.g += t * lost * g / sigma;
        sum.a += t * lost;
    }
    return sum;
}

TEST(IntermixKernel, ExtinctionWithTheOriginalInterpolationIsPhysics) {
    SlabSettings settings;
    settings.interpolation = SlabInterpolation::original;
    settings.mixing = SlabMixing::extinction;
    settings.opaque_at = 1;
    const std::array<std::array<Slab, 2>, 4> cases{{
        {{{3, 2, 0.9F, 0, 0, 0.9F}, {4, 2, 0, 0.5F, 0, 0.5F}}},
        {{{3, 1, 0.3F, 0.1F, 0, 0.3F}, {5, 4, 0.1F, 0.99F, 0, 0.99F}}},
        {{{3, 2, 0.2F, 0, 0, 0.5F}, {3, 2, 0, 0.7F, 0, 0.75F}}},
        {{{3, 3, 0.999F, 0, 0, 0.999F}, {3, 1, 0, 0.01F, 0, 0.01F}}},
    }};
    for (const auto& media : cases) {
        const RealColor marched = march(media);
        const Slab merged = composite(merge_arrays(std::span(&media[0], 1), std::span(&media[1], 1), settings));
        EXPECT_NEAR(merged.r, static_cast<double>(marched.r), 2e-5);
        EXPECT_NEAR(merged.g, static_cast<double>(marched.g), 2e-5);
        EXPECT_NEAR(merged.a, static_cast<double>(marched.a), 2e-6);
    }
}

}  // namespace
}  // namespace pellucid
