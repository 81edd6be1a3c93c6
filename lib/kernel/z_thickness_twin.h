// Slabs as the words of a z-thickness buffer (stage/z_thickness_buffer.hpp has the formats).
#ifndef PELLUCID_KERNEL_Z_THICKNESS_TWIN_H
#define PELLUCID_KERNEL_Z_THICKNESS_TWIN_H
#include "kernel/slab_twin.h"
TWIN_BEGIN

// As SlabFormat.
const uint kFormatFloat = 0u;
const uint kFormatHalf = 1u;
const uint kFormatByte = 2u;

struct SlabWords {
    uint w0;
    uint w1;
    uint w2;
    uint w3;
    uint w4;
    uint w5;
};

// Half floats without a sign: nearest, ties to even; subnormal halves included; above the largest, 65504: the largest.
TWIN_FN uint half_of(float v) {
    if (!(v > 0.0f)) return 0u;
    if (v < 6.103515625e-05f) {
        TWIN_PRECISE float scaled = v * 16777216.0f;
        TWIN_PRECISE float whole = floor(scaled);
        TWIN_PRECISE float rest = scaled - whole;
        uint low = uint(whole);
        return low + uint(rest > 0.5f || (rest == 0.5f && (low & 1u) == 1u));
    }
    uint b = floatBitsToUint(v);
    uint rounded = (b + 0xfffu + ((b >> 13u) & 1u)) >> 13u;
    return min(rounded - (112u << 10u), 0x7bffu);
}
TWIN_FN float from_half(uint h) {
    TWIN_PRECISE float small = float(h) * 5.9604644775390625e-08f;
    return h < 0x400u ? small : uintBitsToFloat((h << 13u) + (112u << 23u));
}

// Depth and thickness of the half format: 16 and 5 bits of mantissa.
const uint kDepthShift = 7u;
const uint kThicknessShift = 18u;
TWIN_FN uint depth_bits(float z) {
    if (!(z > 0.0f)) return 0u;
    uint b = floatBitsToUint(z);
    return min((b + 63u + ((b >> kDepthShift) & 1u)) >> kDepthShift, 0x7f7fffffu >> kDepthShift);
}

// 255 v to the nearest, halves up.
TWIN_FN uint byte_of(float v) {
    TWIN_PRECISE float scaled = 255.0f * min(max(v, 0.0f), 1.0f);
    TWIN_PRECISE float whole = floor(scaled);
    TWIN_PRECISE float rest = scaled - whole;
    return uint(whole) + uint(rest >= 0.5f);
}
// v/255 to the nearest.
TWIN_FN float from_byte(uint v) {
    TWIN_PRECISE float q = float(v) * 0.00392156862745098f;
    TWIN_PRECISE float left = float(v) - q * 255.0f;  // exact but for the product's rounding
    TWIN_PRECISE float mended = q + left * 0.00392156862745098f;
    return mended;
}

// half: 24 bits z, 13 d, 15 each r, g, b, 14 a, from the lowest bit of the first word on.
TWIN_FN SlabWords pack_slab(Slab s, uint format) {
    SlabWords w;
    w.w0 = floatBitsToUint(s.z);
    w.w1 = floatBitsToUint(s.d);
    w.w2 = 0u;
    w.w3 = 0u;
    w.w4 = 0u;
    w.w5 = 0u;
    if (format == kFormatHalf) {
        uint d = floatBitsToUint(s.d) >> kThicknessShift;
        uint r = half_of(s.r);
        uint g = half_of(s.g);
        uint b = half_of(s.b);
        uint a = half_of(s.a);
        w.w0 = depth_bits(s.z) | (d << 24u);                  // 8 bits of d
        w.w1 = (d >> 8u) | (r << 5u) | (g << 20u);            // 5 of d, r, 12 of g
        w.w2 = (g >> 12u) | (b << 3u) | (a << 18u);           // 3 of g, b, a
    } else if (format == kFormatByte) {
        w.w2 = byte_of(s.r) | (byte_of(s.g) << 8u) | (byte_of(s.b) << 16u) | (byte_of(s.a) << 24u);
    } else {
        w.w2 = floatBitsToUint(s.r);
        w.w3 = floatBitsToUint(s.g);
        w.w4 = floatBitsToUint(s.b);
        w.w5 = floatBitsToUint(s.a);
    }
    return w;
}
TWIN_FN Slab unpack_slab(SlabWords w, uint format) {
    Slab s;
    s.z = uintBitsToFloat(w.w0);
    s.d = uintBitsToFloat(w.w1);
    s.r = uintBitsToFloat(w.w2);
    s.g = uintBitsToFloat(w.w3);
    s.b = uintBitsToFloat(w.w4);
    s.a = uintBitsToFloat(w.w5);
    if (format == kFormatHalf) {
        s.z = uintBitsToFloat((w.w0 & 0xffffffu) << kDepthShift);
        s.d = uintBitsToFloat(((w.w0 >> 24u) | ((w.w1 & 31u) << 8u)) << kThicknessShift);
        s.r = from_half((w.w1 >> 5u) & 0x7fffu);
        s.g = from_half((w.w1 >> 20u) | ((w.w2 & 7u) << 12u));
        s.b = from_half((w.w2 >> 3u) & 0x7fffu);
        s.a = from_half(w.w2 >> 18u);
    } else if (format == kFormatByte) {
        s.r = from_byte(w.w2 & 255u);
        s.g = from_byte((w.w2 >> 8u) & 255u);
        s.b = from_byte((w.w2 >> 16u) & 255u);
        s.a = from_byte(w.w2 >> 24u);
    }
    return s;
}

// Ends a pixel's slabs that are fewer than its layers.
TWIN_FN bool is_no_slab(Slab s) { return s.r == 0.0f && s.g == 0.0f && s.b == 0.0f && s.a == 0.0f; }

// A slab as it will be read, not overlapping what ends at `end`.
TWIN_FN SlabWords pack_behind(Slab slab, float end, uint format) {
    SlabWords words = pack_slab(slab, format);
    if (format != kFormatHalf) return words;
    float z = unpack_slab(words, format).z;
    float front = min(max(slab_front(slab), end), z);
    slab.d = thickness_between(front, z);
    return pack_slab(slab, format);
}

TWIN_END
#endif
