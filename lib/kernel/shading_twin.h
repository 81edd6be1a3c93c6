// Blinn-Phong without clamp, the normal turned to the viewer; two sums over the lights are all that it needs:
//   rgb = color·(ambient + diffuse·Σ I·max(0, n·l)) + specular·Σ I·max(0, n·h)^shininess
#ifndef PELLUCID_KERNEL_SHADING_TWIN_H
#define PELLUCID_KERNEL_SHADING_TWIN_H
#include "kernel/math_twin.h"
#include "kernel/normal_twin.h"
TWIN_BEGIN

struct LightSums {
    float diffuse;   // Σ I·max(0, n·l)
    float specular;  // Σ I·max(0, n·h)^shininess
};

// n turned to the side of v.
TWIN_FN Vec3f turned_to(Vec3f n, Vec3f v) {
    uint turn = floatBitsToUint(dot3(n, v)) & kSignBit;
    return Vec3f(uintBitsToFloat(floatBitsToUint(n.x) ^ turn), uintBitsToFloat(floatBitsToUint(n.y) ^ turn),
                 uintBitsToFloat(floatBitsToUint(n.z) ^ turn));
}

// One light more; n, v (to the viewer) and l (to the light) have unit length.
TWIN_FN LightSums add_light(LightSums sums, Vec3f n, Vec3f v, Vec3f l, float intensity, float shininess) {
    Vec3f h = Vec3f(l.x + v.x, l.y + v.y, l.z + v.z);
    float size2 = dot3(h, h);
    // A light from behind the point: no half-way direction.
    TWIN_PRECISE float n_h = min(max(dot3(n, h) * quick_rsqrt(max(size2, 1e-30f)), 0.0f), 1.0f);
    TWIN_PRECISE float diffuse = sums.diffuse + intensity * max(0.0f, dot3(n, l));
    TWIN_PRECISE float specular = sums.specular + intensity * quick_power(n_h, shininess);
    LightSums r;
    r.diffuse = diffuse;
    r.specular = specular;
    return r;
}

// The same where nothing glosses: add_light(...).diffuse to the last bit.
TWIN_FN float add_diffuse(float sum, Vec3f n, Vec3f l, float intensity) {
    TWIN_PRECISE float diffuse = sum + intensity * max(0.0f, dot3(n, l));
    return diffuse;
}

// One channel of the shaded colour.
TWIN_FN float shaded_channel(float color, LightSums sums, float ambient, float diffuse, float specular) {
    TWIN_PRECISE float r = color * (ambient + diffuse * sums.diffuse) + specular * sums.specular;
    return r;
}

TWIN_END
#endif
