// zSlabs: pieces of one pixel's ray, each filled with one homogeneous medium (zSlab dissertation, chapters 2 to 4).
// Splitting (3.2) to (3.6), mixing (4.1) to (4.4) and compositing (1.4), (1.5), for numbers that are finite:
// depths and thicknesses up to 1e37 in size, opacities in [0, 1], colours >= 0. Lengths and opacities below the
// smallest normal float count as 0. No result is NaN, no opacity leaves [0, 1], no part has more of a colour than
// its slab. Front part over back part is the whole (tests/slab_kernel_test.cpp has the bounds).
#ifndef PELLUCID_KERNEL_SLAB_TWIN_H
#define PELLUCID_KERNEL_SLAB_TWIN_H
#include "kernel/math_twin.h"
TWIN_BEGIN

// From depth z − d to z. Depths are measured along the view axis. Colour is associated.
struct Slab {
    float z;  // of the back
    float d;  // thickness, >= 0
    float r;
    float g;
    float b;
    float a;  // opacity, [0, 1]
};

// As SlabInterpolation and SlabMixing of stage/slab_settings.hpp.
const uint kInterpolateModified = 0u;
const uint kInterpolateOriginal = 1u;
const uint kInterpolateTextbook = 2u;
const uint kMixAverage = 0u;
const uint kMixNormalised = 1u;
const uint kMixExtinction = 2u;

const float kSmallestNormal = 1.17549435e-38f;

// Both are there, so that a loop over slabs becomes SIMD all the same; masks of integers take twice as long one by one.
TWIN_FN float pick(bool c, float a, float b) { return c ? a : b; }
TWIN_FN Slab pick_slab(bool c, Slab a, Slab b) {
    Slab s;
    s.z = pick(c, a.z, b.z);
    s.d = pick(c, a.d, b.d);
    s.r = pick(c, a.r, b.r);
    s.g = pick(c, a.g, b.g);
    s.b = pick(c, a.b, b.b);
    s.a = pick(c, a.a, b.a);
    return s;
}

TWIN_FN float slab_front(Slab slab) {
    TWIN_PRECISE float front = slab.z - slab.d;
    return front;
}

// Thickness of a slab from `front` to `back` whose front, as slab_front rounds it, is not before `front`: the
// difference or the float below it, so that neighbours never overlap. Precondition: front <= back.
TWIN_FN float thickness_between(float front, float back) {
    TWIN_PRECISE float d = back - front;
    TWIN_PRECISE float seen = back - d;
    return uintBitsToFloat(floatBitsToUint(d) - uint(seen < front));
}

// F in front of B, (1.4) and (1.5): colour and opacity. Depths are F's.
TWIN_FN Slab slab_over(Slab front, Slab back) {
    TWIN_PRECISE float t = 1.0f - front.a;
    TWIN_PRECISE float r = front.r + t * back.r;
    TWIN_PRECISE float g = front.g + t * back.g;
    TWIN_PRECISE float b = front.b + t * back.b;
    TWIN_PRECISE float a = front.a + t * back.a;
    Slab s;
    s.z = front.z;
    s.d = front.d;
    s.r = r;
    s.g = g;
    s.b = b;
    s.a = a;
    return s;
}

// What the parts have of their slab's colour and opacity alike, so that no part is brighter than it is opaque
// where its slab is not.
struct SlabShares {
    float front;
    float back;
};

// part/whole in [0, 1], exactly 1 from part = whole on. whole > 0.
TWIN_FN float length_ratio(float part, float whole) {
    TWIN_PRECISE float ratio = part * twin_reciprocal(whole);
    return pick(part >= whole, 1.0f, min(ratio, 1.0f));
}

// Modified: (3.4), (3.5), and (3.6) without its differences: with t + u = d, α_b = α u/((1 − α)d + α u).
// Where nothing is left of that denominator, nothing is left behind.
TWIN_FN SlabShares modified_shares(float a, float front_length, float back_length, float d) {
    TWIN_PRECISE float left = (1.0f - a) * d + a * back_length;
    TWIN_PRECISE float ratio = back_length * twin_reciprocal(max(left, kSmallestNormal));
    bool whole = (a >= 1.0f && back_length >= kSmallestNormal) || back_length >= d;
    SlabShares s;
    s.front = length_ratio(front_length, d);
    s.back = pick(whole, 1.0f, pick(left < kSmallestNormal, 0.0f, min(ratio, 1.0f)));
    return s;
}

// α(ratio)/α with α(ratio) = −expm1(ratio · log1p(−α)), (3.2) and (3.3): `ratio` itself as α goes to 0; 1 for
// α = 1 and any ratio > 0.
TWIN_FN float homogeneous_share(float a, float log_t, float ratio) {
    TWIN_PRECISE float share = -twin_expm1(ratio * log_t) * twin_reciprocal(max(a, kSmallestNormal));
    bool all = ratio >= 1.0f || (a >= 1.0f && ratio > 0.0f);
    return pick(all, 1.0f, pick(a < kSmallestNormal, ratio, min(share, 1.0f)));
}
TWIN_FN SlabShares original_shares(float a, float front_length, float back_length, float d) {
    float log_t = twin_log1p(-min(a, 0.99999994f));
    SlabShares s;
    s.front = homogeneous_share(a, log_t, length_ratio(front_length, d));
    s.back = homogeneous_share(a, log_t, length_ratio(back_length, d));
    return s;
}

// (3.2) and (3.3) as they stand, for both parts: digits are lost as α goes to 0, and 0/0 counts as 0.
TWIN_FN SlabShares textbook_shares(float a, float front_length, float back_length, float d) {
    TWIN_PRECISE float transmittance = 1.0f - a;
    TWIN_PRECISE float front_a = 1.0f - twin_power(transmittance, length_ratio(front_length, d));
    TWIN_PRECISE float back_a = 1.0f - twin_power(transmittance, length_ratio(back_length, d));
    TWIN_PRECISE float front = front_a * twin_reciprocal(max(a, kSmallestNormal));
    TWIN_PRECISE float back = back_a * twin_reciprocal(max(a, kSmallestNormal));
    SlabShares s;
    s.front = min(max(front, 0.0f), 1.0f);
    s.back = min(max(back, 0.0f), 1.0f);
    return s;
}

struct SlabParts {
    Slab front;
    Slab back;
};

TWIN_FN Slab slab_part(Slab slab, float share, float z, float d) {
    TWIN_PRECISE float r = slab.r * share;
    TWIN_PRECISE float g = slab.g * share;
    TWIN_PRECISE float b = slab.b * share;
    TWIN_PRECISE float a = slab.a * share;
    Slab part;
    part.z = z;
    part.d = d;
    part.r = r;
    part.g = g;
    part.b = b;
    part.a = a;
    return part;
}

// Slab from depth `front` to slab.z, cut at depth `cut`. A slab without thickness at the cut lies behind it.
// Precondition: front <= cut <= slab.z; `front` is slab_front(slab), but for what rounding did to thickness.
TWIN_FN SlabParts split_slab(Slab slab, float front, float cut, uint interpolation) {
    TWIN_PRECISE float d = slab.z - front;
    TWIN_PRECISE float front_length = cut - front;
    TWIN_PRECISE float back_length = slab.z - cut;
    d = max(d, kSmallestNormal);
    SlabShares shares;
    if (interpolation == kInterpolateModified) shares = modified_shares(slab.a, front_length, back_length, d);
    else if (interpolation == kInterpolateOriginal) shares = original_shares(slab.a, front_length, back_length, d);
    else shares = textbook_shares(slab.a, front_length, back_length, d);

    bool behind = front_length < kSmallestNormal;
    bool before = back_length < kSmallestNormal && !behind;
    shares.front = pick(behind, 0.0f, pick(before, 1.0f, shares.front));
    shares.back = pick(behind, 1.0f, pick(before, 0.0f, shares.back));
    SlabParts parts;
    parts.front = slab_part(slab, shares.front, cut, pick(before, slab.d, thickness_between(front, cut)));
    parts.back = slab_part(slab, shares.back, slab.z, pick(behind, slab.d, thickness_between(cut, slab.z)));
    return parts;
}

// Weights of the two colours of a mixture, and its opacity.
struct MixWeights {
    float first;
    float second;
    float a;
};

// (4.1) from the larger opacity on: exact where one is 0 or 1, the same for either order.
TWIN_FN float mixed_opacity(float a1, float a2) {
    TWIN_PRECISE float larger = max(a1, a2);
    TWIN_PRECISE float a = larger + (1.0f - larger) * min(a1, a2);
    return a;
}

// (4.4)
TWIN_FN MixWeights average_weights(float a1, float a2) {
    TWIN_PRECISE float first = 1.0f - 0.5f * a2;
    TWIN_PRECISE float second = 1.0f - 0.5f * a1;
    MixWeights w;
    w.first = first;
    w.second = second;
    w.a = mixed_opacity(a1, a2);
    return w;
}

// (4.3): α_mix/Σα, which goes to 1 where there is nothing.
TWIN_FN MixWeights normalised_weights(float a1, float a2) {
    MixWeights w;
    w.a = mixed_opacity(a1, a2);
    TWIN_PRECISE float sum = a1 + a2;
    TWIN_PRECISE float ratio = w.a * twin_reciprocal(max(sum, kSmallestNormal));
    w.first = pick(sum <= w.a, 1.0f, min(ratio, 1.0f));
    w.second = w.first;
    return w;
}

// Extinction σ of an opacity in one unit of length and σ/α, which goes to 1 as α goes to 0.
struct Extinction {
    float sigma;
    float ratio;
};
TWIN_FN Extinction extinction_of(float a) {
    Extinction e;
    TWIN_PRECISE float sigma = -twin_log1p(-min(a, 0.99999994f));
    TWIN_PRECISE float ratio = sigma * twin_reciprocal(max(a, kSmallestNormal));
    e.sigma = sigma;
    e.ratio = pick(a < kSmallestNormal, 1.0f, ratio);
    return e;
}

// Two media in one place: Σσ_i c_i/Σσ_i, c = C/α. An opacity of 1 is a limit of σ: it hides every other one, and
// two of them have the mean of their colours.
TWIN_FN MixWeights extinction_weights(float a1, float a2) {
    Extinction e1 = extinction_of(a1);
    Extinction e2 = extinction_of(a2);
    MixWeights w;
    w.a = mixed_opacity(a1, a2);
    TWIN_PRECISE float sum = e1.sigma + e2.sigma;
    TWIN_PRECISE float scale = w.a * twin_reciprocal(max(sum, kSmallestNormal));
    TWIN_PRECISE float first = scale * e1.ratio;
    TWIN_PRECISE float second = scale * e2.ratio;
    bool nothing = sum < kSmallestNormal;
    bool opaque1 = a1 >= 1.0f;
    bool opaque2 = a2 >= 1.0f;
    first = pick(nothing || a2 <= 0.0f, 1.0f, first);
    second = pick(nothing || a1 <= 0.0f, 1.0f, second);
    first = pick(opaque2, pick(opaque1, 0.5f, 0.0f), pick(opaque1, 1.0f, first));
    second = pick(opaque1, pick(opaque2, 0.5f, 0.0f), pick(opaque2, 1.0f, second));
    w.first = first;
    w.second = second;
    return w;
}

// Two slabs of the same interval, given the depths of the first; the same bits for either order.
TWIN_FN Slab mix_slabs(Slab first, Slab second, uint mixing) {
    MixWeights w;
    if (mixing == kMixAverage) w = average_weights(first.a, second.a);
    else if (mixing == kMixNormalised) w = normalised_weights(first.a, second.a);
    else w = extinction_weights(first.a, second.a);
    TWIN_PRECISE float r = first.r * w.first + second.r * w.second;
    TWIN_PRECISE float g = first.g * w.first + second.g * w.second;
    TWIN_PRECISE float b = first.b * w.first + second.b * w.second;
    Slab s;
    s.z = first.z;
    s.d = first.d;
    s.r = r;
    s.g = g;
    s.b = b;
    s.a = w.a;
    return s;
}

TWIN_END
#ifdef __cplusplus
#include <cstddef>
static_assert(sizeof(pellucid::twin::Slab) == 24 && offsetof(pellucid::twin::Slab, r) == 8);
#endif
#endif
