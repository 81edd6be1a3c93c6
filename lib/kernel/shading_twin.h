// Blinn-Phong without clamp: rgb = color·(ambient + diffuse·Σ I·max(0, n·l)) + specular·Σ I·max(0, n·h)^shininess,
// the normal turned to the viewer. Two sums over the lights are all that it needs.
#ifndef PELLUCID_KERNEL_SHADING_TWIN_H
#define PELLUCID_KERNEL_SHADING_TWIN_H
#include "kernel/normal_twin.h"
TWIN_BEGIN

struct LightSums {
    float diffuse;   // Σ I·max(0, n·l)
    float specular;  // Σ I·max(0, n·h)^shininess
};

TWIN_FN float dot3(Vec3f a, Vec3f b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// n turned to the side of v.
TWIN_FN Vec3f turned_to(Vec3f n, Vec3f v) {
    float s = dot3(n, v) < 0.0f ? -1.0f : 1.0f;
    return Vec3f(s * n.x, s * n.y, s * n.z);
}

// One light more; n, v (to the viewer) and l (to the light) have unit length.
TWIN_FN LightSums add_light(LightSums sums, Vec3f n, Vec3f v, Vec3f l, float intensity, float shininess) {
    Vec3f h = Vec3f(l.x + v.x, l.y + v.y, l.z + v.z);
    float size = sqrt(dot3(h, h));
    float n_h = size > 0.0f ? max(0.0f, dot3(n, h) / size) : 0.0f;
    float highlight = n_h > 0.0f ? pow(n_h, shininess) : (shininess > 0.0f ? 0.0f : 1.0f);
    LightSums r;
    r.diffuse = sums.diffuse + intensity * max(0.0f, dot3(n, l));
    r.specular = sums.specular + intensity * highlight;
    return r;
}

// One channel of the shaded colour.
TWIN_FN float shaded_channel(float color, LightSums sums, float ambient, float diffuse, float specular) {
    return color * (ambient + diffuse * sums.diffuse) + specular * sums.specular;
}

TWIN_END
#endif
