// Unit vectors in 32 bits: octahedral map, 16 bits a coordinate (Meyer et al. 2010, "On floating-point
// normal vectors"; Cigolle et al. 2014 call it oct32). Largest error 6.5e-5 rad, at the middle
// of the octahedron's faces: half a step along both axes, 2^-15.5, stretched by 3; tested.
#ifndef PELLUCID_KERNEL_NORMAL_TWIN_H
#define PELLUCID_KERNEL_NORMAL_TWIN_H
#include "kernel/math_twin.h"
TWIN_BEGIN

struct Vec3f {
    float x;
    float y;
    float z;
};

TWIN_FN float dot3(Vec3f a, Vec3f b) {
    TWIN_PRECISE float r = a.x * b.x + a.y * b.y + a.z * b.z;
    return r;
}

// 16 bits for a coordinate in [-1, 1]. Whole numbers by conversion, which rounds to zero, and mended: floor is
// a call on some processors.
TWIN_FN uint quantise_snorm(float v) {
    TWIN_PRECISE float scaled = min(max(v, -1.0f), 1.0f) * 32767.0f + 0.5f;
    int whole = int(scaled);
    return uint(whole - int(scaled < float(whole)) + 32768) & 65535u;
}
// Steps of 1/32767 times 32767: whole numbers, exact. A normal's length is of no account before the end.
TWIN_FN float restore_snorm(uint bits) { return float(int(bits) - 32768); }

// n need not have unit length; not zero. Without a branch: g++ vectorises.
TWIN_FN uint pack_normal(Vec3f n) {
    TWIN_PRECISE float size = abs(n.x) + abs(n.y) + abs(n.z);
    float over_size = twin_reciprocal(size);
    float u = n.x * over_size;
    float v = n.y * over_size;
    // The lower half is folded outwards: 1 - |v| with the sign of u, and the other way round.
    uint folded_u = floatBitsToUint(1.0f - abs(v)) ^ (floatBitsToUint(u) & kSignBit);
    uint folded_v = floatBitsToUint(1.0f - abs(u)) ^ (floatBitsToUint(v) & kSignBit);
    bool lower = n.z < 0.0f;
    u = uintBitsToFloat(bits_where(lower, folded_u, floatBitsToUint(u)));
    v = uintBitsToFloat(bits_where(lower, folded_v, floatBitsToUint(v)));
    return quantise_snorm(u) | (quantise_snorm(v) << 16u);
}

// Unit length.
TWIN_FN Vec3f unpack_normal(uint bits) {
    float u = restore_snorm(bits & 65535u);
    float v = restore_snorm(bits >> 16u);
    float z = 32767.0f - abs(u) - abs(v);
    float fold = max(-z, 0.0f);  // how far beyond the diamond |u| + |v| = 1 of the upper half
    Vec3f n;
    n.x = u - uintBitsToFloat(floatBitsToUint(fold) | (floatBitsToUint(u) & kSignBit));
    n.y = v - uintBitsToFloat(floatBitsToUint(fold) | (floatBitsToUint(v) & kSignBit));
    n.z = z;
    float r = quick_rsqrt(dot3(n, n));
    n.x = n.x * r;
    n.y = n.y * r;
    n.z = n.z * r;
    return n;
}

TWIN_END
#endif
