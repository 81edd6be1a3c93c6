// The colour of an opaque particle, in integer units, from view space: STEP 2 of PBSR shades the winner of a
// pixel, STEP 3 adds. Only + − × and comparisons: every backend gives the same bits.
#ifndef PELLUCID_KERNEL_PARTICLE_TWIN_H
#define PELLUCID_KERNEL_PARTICLE_TWIN_H
#include "kernel/paint_twin.h"
#include "kernel/projection_twin.h"
#include "kernel/shading_twin.h"
TWIN_BEGIN

// How one object's particles are shaded.
struct Material {
    float red;
    float green;
    float blue;
    float ambient;
    float diffuse;
    float specular;
    float shininess;
    int flat_colored;    // 1: the colour as it is
    int painted;         // 1: particles carry their colour, shaded, as a share of red, green, blue; flat_colored is 1
    // An image in place of the colour: its first texel and size; width 0: none. A point's place on it is
    // (a, b) = ((q − center)·along_u, (q − center)·along_v), each in [-1, 1], in the particles' units.
    int first_texel;
    int texture_width;
    int texture_height;
    Vec3f center;
    Vec3f along_u;
    Vec3f along_v;
};

// A light in view space: unit direction towards it.
struct ViewLight {
    Vec3f direction;
    float intensity;
    int headlight;       // 1: shines along the pixel's ray, `direction` is not used
};

// What shading needs of the view.
struct ShadingView {
    float near;          // in the particles' units; perspective only
    int perspective;     // 0 or 1
    int light_count;
    float units;         // color units of 1.0
};

// Colours in units: below 2^20, so that 2^24 repeats of their squares fit into 64 bits.
struct ColorUnits {
    uint red;
    uint green;
    uint blue;
};
const uint kMostColorUnits = 0xfffffu;

// Direction from the particle to the viewer, unit length.
TWIN_FN Vec3f direction_to_viewer(ShadingView view, Particle q) {
    float z = view.near + q.above_near;
    // Scaled exactly, so that no square leaves the range of float32.
    float largest = max(max(abs(q.x), abs(q.y)), z);
    float s = power_of_two(-max(exponent_of(largest), -126));
    Vec3f v;
    v.x = q.x * s;
    v.y = q.y * s;
    v.z = z * s;
    float r = quick_rsqrt(dot3(v, v));
    bool eye = view.perspective != 0;  // else all rays are parallel
    v.x = eye ? -v.x * r : 0.0f;
    v.y = eye ? -v.y * r : 0.0f;
    v.z = eye ? -v.z * r : -1.0f;
    return v;
}

// A colour of one channel in units, rounded to the next, within 0 … kMostColorUnits.
TWIN_FN uint channel_units(float value, float units) {
    TWIN_PRECISE float scaled = max(value, 0.0f) * units + 0.5f;
    return min(uint(min(scaled, 2097152.0f)), kMostColorUnits);
}

// The shaded colour; red, green, blue: the surface's own, or its image's.
TWIN_FN ColorUnits color_units(Material m, LightSums sums, float red, float green, float blue, float units) {
    bool lit = m.flat_colored == 0;
    ColorUnits c;
    c.red = channel_units(lit ? shaded_channel(red, sums, m.ambient, m.diffuse, m.specular) : red, units);
    c.green =
        channel_units(lit ? shaded_channel(green, sums, m.ambient, m.diffuse, m.specular) : green, units);
    c.blue = channel_units(lit ? shaded_channel(blue, sums, m.ambient, m.diffuse, m.specular) : blue, units);
    return c;
}

// Colour of a painted particle.
TWIN_FN Vec3f paint_color(Material m, Particle q) {
    Vec3f color = unpack_paint(q.normal);
    color.x = color.x * m.red;
    color.y = color.y * m.green;
    color.z = color.z * m.blue;
    return color;
}

// Bilinear between texel centres, clamped at the border; columns run along u, the top row is at +v.
struct TexelPlace {
    int left;            // columns
    int right;
    int top;             // rows
    int bottom;
    float share_x;       // weight of the right column
    float share_y;       // weight of the bottom row
};

TWIN_FN TexelPlace texel_place(Material m, Particle q) {
    Vec3f from;
    from.x = q.x - m.center.x;
    from.y = q.y - m.center.y;
    from.z = q.above_near - m.center.z;
    TWIN_PRECISE float x = (0.5f + 0.5f * dot3(from, m.along_u)) * float(m.texture_width) - 0.5f;
    TWIN_PRECISE float y = (0.5f - 0.5f * dot3(from, m.along_v)) * float(m.texture_height) - 0.5f;
    x = min(max(x, 0.0f), float(m.texture_width - 1));
    y = min(max(y, 0.0f), float(m.texture_height - 1));
    TexelPlace p;
    p.left = int(x);
    p.top = int(y);
    p.right = min(p.left + 1, m.texture_width - 1);
    p.bottom = min(p.top + 1, m.texture_height - 1);
    p.share_x = x - float(p.left);
    p.share_y = y - float(p.top);
    return p;
}

// One channel from its four texels.
TWIN_FN float mix_texels(TexelPlace p, float top_left, float top_right, float bottom_left,
                         float bottom_right) {
    TWIN_PRECISE float top = top_left + p.share_x * (top_right - top_left);
    TWIN_PRECISE float bottom = bottom_left + p.share_x * (bottom_right - bottom_left);
    TWIN_PRECISE float r = top + p.share_y * (bottom - top);
    return r;
}

TWIN_END
#endif
