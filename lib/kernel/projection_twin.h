// Which pixel a particle covers and how deep it lies, to the last bit the same on every backend:
//   project_particle  the definition: integers and exact scalings only
//   project_quickly   float32 where it decides, else the definition: sorting and the fast CPU
//   project_in_view   float32 guesses, integers mend: Vulkan, for particles known to be in view
#ifndef PELLUCID_KERNEL_PROJECTION_TWIN_H
#define PELLUCID_KERNEL_PROJECTION_TWIN_H
#include "kernel/twin.h"
TWIN_BEGIN

// A particle as it is stored: view space (x right, y down), in units of 2^scene_exponent scene units.
struct Particle {
    float x;
    float y;
    float above_near;  // distance along the view axis beyond the near plane, >= 0
    uint normal;       // shading normal, octahedral 2 x 16 bits: normal_twin.h; or its colour: paint_twin.h
};

// Image column = floor((focal·x + center_x·w)/w), row alike, in fixed point. The divisor w is
// near + above_near for perspective and one constant for orthographic views.
struct Projection {
    int64_t near_fixed;   // near plane · 2^near_bits, below 2^62
    int64_t focal_fixed;  // pixels: see ParticleFrame::projection (sample/particle_set.cpp)
    int64_t center_x;     // half the width · 2^fraction_bits
    int64_t center_y;     // half the height · 2^fraction_bits
    int near_bits;
    int near_exponent;    // near plane in [2^e, 2^(e+1)), or below where that would be under
                          // -97 + lateral_shift
    int lateral_shift;    // perspective: extra bits that x and y keep below those of w;
                          // orthographic: their binary point
    int fraction_bits;
    int perspective;      // 0 or 1
    int width;
    int height;
    // The same in float32, for project_quickly and project_in_view.
    float quick_near;
    float quick_focal;
    float quick_center_x;
    float quick_center_y;
    float doubt;          // pixels: this close to a border of a pixel float32 does not decide; 1: never
};

// The image is cut into square tiles, 2^kTileShift pixels a side: what a core or workgroup draws at a time.
const int kTileShift = 6;
const int kTileSide = 1 << kTileShift;
const int kTilePixels = kTileSide * kTileSide;

// Pixel of a particle; column = -1 where it is out of view.
struct PixelDepth {
    int column;
    int row;
    uint depth;  // bits of above_near: for numbers >= 0 they are ordered like the numbers
};

// 2^e as a float, e in [-126, 127].
TWIN_FN float power_of_two(int e) { return uintBitsToFloat(uint(e + 127) << 23u); }

// Exponent of a positive normal float: value in [2^e, 2^(e+1)).
TWIN_FN int exponent_of(float value) { return int((floatBitsToUint(value) >> 23u) & 255u) - 127; }

// floor(a/b) for b > 0.
TWIN_FN int64_t floor_divide(int64_t a, int64_t b) {
    int64_t q = a / b;
    return (a % b < int64_t(0)) ? q - int64_t(1) : q;
}

// value · 2^shift rounded down, as an integer: exact but for the bits that fall below 1.
TWIN_FN int64_t to_fixed(float value, int shift) {
    int s = min(max(shift, -126), 126);
    return int64_t(floor(value * power_of_two(s)));
}

// A bijection of the 32-bit numbers that looks random (Fibonacci hashing: 2^32 over the golden ratio),
// and back: particles at equal depth are told apart by it, not by the order of their objects.
TWIN_FN uint scramble_index(uint index) { return index * 0x9e3779b1u; }
TWIN_FN uint restore_index(uint scrambled) { return scrambled * 0x0e8b2f51u; }

// Nearest first; at equal depth the lower of the scrambled indices.
TWIN_FN uint64_t particle_key(Particle q, uint index) {
    return (uint64_t(floatBitsToUint(q.above_near)) << 32) | uint64_t(scramble_index(index));
}

// The definition of a particle's pixel; column = row = -1 out of view.
// Where a particle lies, in fixed point: column and row are the quotients, rounded down.
struct FixedPlace {
    int64_t column;      // numerators
    int64_t row;
    int64_t denominator; // <= 0: behind the eye
};

TWIN_FN FixedPlace fixed_place(Projection p, Particle q) {
    int64_t w = int64_t(1) << 30;
    int lateral = p.lateral_shift;
    if (p.perspective != 0) {
        // A binary point for this particle alone: near and far ones keep the same relative precision.
        int reach = q.above_near > 0.0f ? exponent_of(q.above_near) : -126;
        int shift = 29 - max(p.near_exponent, reach);
        // near_bits = 60 - near_exponent, so the near plane always has more bits than w: at least 31.
        w = (p.near_fixed >> min(p.near_bits - shift, 63)) + to_fixed(q.above_near, shift);
        lateral += shift;
    }
    FixedPlace r;
    r.denominator = w << p.fraction_bits;
    r.column = to_fixed(q.x, lateral) * p.focal_fixed + w * p.center_x;
    r.row = to_fixed(q.y, lateral) * p.focal_fixed + w * p.center_y;
    return r;
}

TWIN_FN PixelDepth project_particle(Projection p, Particle q) {
    FixedPlace at = fixed_place(p, q);
    PixelDepth r;
    r.column = -1;
    r.row = -1;
    r.depth = floatBitsToUint(q.above_near);
    if (at.denominator > int64_t(0)) {
        int64_t column = floor_divide(at.column, at.denominator);
        int64_t row = floor_divide(at.row, at.denominator);
        if (column >= int64_t(0) && column < int64_t(p.width) && row >= int64_t(0) &&
            row < int64_t(p.height)) {
            r.column = int(column);
            r.row = int(row);
        }
    }
    return r;
}

// Where float32 lands on one axis: 0 surely inside [0, size), 1 surely outside, 2 undecided. `doubt` covers
// the roundings here (of a division up to 2.5 ULP) and those of the fixed point.
TWIN_FN int quick_verdict(float position, float size, float doubt) {
    float share = position - floor(position);
    int inside = position >= 0.0f && position < size && share > doubt && share < 1.0f - doubt ? 0 : 2;
    return position < -doubt || position > size + doubt ? 1 : inside;
}

// The same pixel as project_particle, by float32 wherever that decides.
TWIN_FN PixelDepth project_quickly(Projection p, Particle q) {
    float w = p.perspective != 0 ? p.quick_near + q.above_near : 1.0f;
    float x = q.x * p.quick_focal / w + p.quick_center_x;
    float y = q.y * p.quick_focal / w + p.quick_center_y;
    int on_x = quick_verdict(x, float(p.width), p.doubt);
    int on_y = quick_verdict(y, float(p.height), p.doubt);
    PixelDepth r;
    r.column = -1;
    r.row = -1;
    r.depth = floatBitsToUint(q.above_near);
    if (!(w > 1e-30f) || (on_x != 1 && on_y != 1 && on_x + on_y > 0)) {
        r = project_particle(p, q);
    } else if (on_x + on_y == 0) {
        r.column = int(x);
        r.row = int(y);
    }
    return r;
}

// floor(a/b) for b > 0, where `guess` is that quotient or a neighbour of it.
TWIN_FN int mended_quotient(int64_t a, int64_t b, int guess) {
    int64_t rest = a - b * int64_t(guess);
    return guess + (rest < int64_t(0) ? -1 : (rest >= b ? 1 : 0));
}

// The same pixel as project_particle for particles that are in view, without a division of integers and
// without a branch: float32 finds the quotient but for 1, products mend it. Precondition: p.doubt < 1.
TWIN_FN PixelDepth project_in_view(Projection p, Particle q) {
    float w_float = p.perspective != 0 ? p.quick_near + q.above_near : 1.0f;
    float x = q.x * p.quick_focal / w_float + p.quick_center_x;
    float y = q.y * p.quick_focal / w_float + p.quick_center_y;
    FixedPlace at = fixed_place(p, q);
    PixelDepth r;
    r.column = mended_quotient(at.column, at.denominator, int(floor(x)));
    r.row = mended_quotient(at.row, at.denominator, int(floor(y)));
    r.depth = floatBitsToUint(q.above_near);
    return r;
}

TWIN_END
#endif
