// Unit vectors in 32 bits: octahedral map, 16 bits a coordinate (Meyer et al. 2010, "On floating-point
// normal vectors"; Cigolle et al. 2014 call it oct32). Largest error 6.5e-5 rad, at the middle
// of the octahedron's faces: half a step along both axes, 2^-15.5, stretched by 3; tested.
#ifndef PELLUCID_KERNEL_NORMAL_TWIN_H
#define PELLUCID_KERNEL_NORMAL_TWIN_H
#include "kernel/twin.h"
TWIN_BEGIN

struct Vec3f {
    float x;
    float y;
    float z;
};

TWIN_FN float sign_or_one(float v) { return v < 0.0f ? -1.0f : 1.0f; }

// 16 bits for a coordinate in [-1, 1].
TWIN_FN uint quantise_snorm(float v) {
    return uint(int(floor(min(max(v, -1.0f), 1.0f) * 32767.0f + 0.5f)) + 32768) & 65535u;
}
TWIN_FN float restore_snorm(uint bits) { return float(int(bits) - 32768) / 32767.0f; }

// n need not have unit length; not zero.
TWIN_FN uint pack_normal(Vec3f n) {
    float size = abs(n.x) + abs(n.y) + abs(n.z);
    float u = n.x / size;
    float v = n.y / size;
    if (n.z < 0.0f) {
        float folded_u = (1.0f - abs(v)) * sign_or_one(u);
        float folded_v = (1.0f - abs(u)) * sign_or_one(v);
        u = folded_u;
        v = folded_v;
    }
    return quantise_snorm(u) | (quantise_snorm(v) << 16u);
}

// Unit length.
TWIN_FN Vec3f unpack_normal(uint bits) {
    float u = restore_snorm(bits & 65535u);
    float v = restore_snorm(bits >> 16u);
    float z = 1.0f - abs(u) - abs(v);
    float x = z < 0.0f ? (1.0f - abs(v)) * sign_or_one(u) : u;
    float y = z < 0.0f ? (1.0f - abs(u)) * sign_or_one(v) : v;
    float size = sqrt(x * x + y * y + z * z);
    return Vec3f(x / size, y / size, z / size);
}

TWIN_END
#endif
