// A ray's step through a volume: what is trilinear between eight samples, closed-form pre-integration of a
// transfer function that is linear in pieces, and light. K. Engel, M. Kraus, T. Ertl, High-quality
// pre-integrated volume rendering, Graphics Hardware 2001; cpu/preintegration.cpp has the derivation.
//
// In float32, the operations of cpu/fast_volume_caster.cpp in the same order, one lane: so the same bits
// wherever the division rounds as the standard says (Vulkan grants it 2.5 ULP). Numbers that are none are
// told apart by flags and by integers: a device need not keep them.
#ifndef PELLUCID_KERNEL_CAST_TWIN_H
#define PELLUCID_KERNEL_CAST_TWIN_H
#include "kernel/math_twin.h"
#include "kernel/shading_twin.h"
#include "kernel/slab_twin.h"

// A shader may leave out what its volumes never need: opacities above 0.6; steps of optical depth above 5.
#ifndef CAST_STEEP
#define CAST_STEEP true
#define CAST_THICK true
#endif
TWIN_BEGIN

// What the kernels that cast share with their hosts.
const uint kPacketSideT = 4u;  // pixels; rays of a packet count their steps from one place
const uint kPacketRaysT = 16u;
const uint kSamplesBytes = 0u;  // as PackedVolume::Kind
const uint kSamplesWords = 1u;
const uint kSamplesFloats = 2u;
const float kCastNever = 1e9f;      // u that no ray reaches
const float kCastFaceRoom = 2e-3f;  // voxels: what is near a face of blocks that are skipped is looked at
const float kCastBlocks = 1e6f;     // optical depth that stands for what blocks

// Of a transfer function, for values less the volume's offset: holds for begin <= value < end.
struct TransferPiece {
    float begin;
    float end;
    float base;
    float opacity;  // opacity + (value - base)·opacity_slope
    float opacity_slope;
    float r;
    float g;
    float b;
    float r_slope;
    float g_slope;
    float b_slope;
    float unused;
};

struct CastLight {
    Vec3f direction;  // to it, world, unit length
    float intensity;
    uint headlight;
};

// Rays of a packet in one volume: u steps after the packet's first they are at p + u·d, in samples.
struct VolumeRay {
    float u_in;  // u_in >= u_out: misses it
    float u_out;
    Vec3f p;
    Vec3f d;
};
struct PacketRay {
    float last;       // u where the ray has left all volumes
    Vec3f to_viewer;  // unit length
    float z;          // depth is z + u·dt
    float dt;
};

// ---- Between samples

// Samples at the low end along x, and what the high end adds, at (y, z), y + 1, z + 1, both; place in the
// cell.
struct CastCell {
    float low0;
    float low1;
    float low2;
    float low3;
    float more0;
    float more1;
    float more2;
    float more3;
    Vec3f at;
};

TWIN_FN float cast_between(float a, float b, float share) {
    TWIN_PRECISE float r = a + share * (b - a);
    return r;
}
TWIN_FN float cast_line(float low, float share, float more) {
    TWIN_PRECISE float r = low + share * more;
    return r;
}

// By differences: where all samples are equal, exactly their value.
TWIN_FN float cell_value(CastCell c) {
    float a = cast_line(c.low0, c.at.x, c.more0);
    float b = cast_line(c.low1, c.at.x, c.more1);
    float d = cast_line(c.low2, c.at.x, c.more2);
    float e = cast_line(c.low3, c.at.x, c.more3);
    return cast_between(cast_between(a, b, c.at.y), cast_between(d, e, c.at.y), c.at.z);
}
TWIN_FN Vec3f cell_gradient(CastCell c) {
    float a = cast_line(c.low0, c.at.x, c.more0);
    float b = cast_line(c.low1, c.at.x, c.more1);
    float d = cast_line(c.low2, c.at.x, c.more2);
    float e = cast_line(c.low3, c.at.x, c.more3);
    TWIN_PRECISE float near = b - a;
    TWIN_PRECISE float far = e - d;
    float low = cast_between(a, b, c.at.y);
    float high = cast_between(d, e, c.at.y);
    TWIN_PRECISE float along_z = high - low;
    Vec3f g;
    g.x =
        cast_between(cast_between(c.more0, c.more1, c.at.y), cast_between(c.more2, c.more3, c.at.y), c.at.z);
    g.y = cast_between(near, far, c.at.z);
    g.z = along_z;
    return g;
}

// ---- Pre-integration

// −ln(1 − α) for α going linearly, and what of colour's change is added to its middle by that weight.
struct PieceDepth {
    float mean;
    float skew;
};

TWIN_FN float cast_series(float r2, float c0, float c1, float c2, float c3, float c4) {
    TWIN_PRECISE float sum = c3 + r2 * c4;
    sum = c2 + r2 * sum;
    sum = c1 + r2 * sum;
    sum = c0 + r2 * sum;
    return sum;
}

// For |r| > ½ the series is short of digits: the closed forms.
TWIN_FN PieceDepth steep_depth(float r, float middle) {
    const float kLn2 = 0.693147181f;
    TWIN_PRECISE float size = min(abs(r), 1.0f);
    TWIN_PRECISE float above = 1.0f + size;
    TWIN_PRECISE float up = kLn2 * quick_log2(above);
    TWIN_PRECISE float below = 1.0f - size;
    TWIN_PRECISE float rest = max(below, 1e-30f);
    TWIN_PRECISE float down = kLn2 * quick_log2(rest);
    TWIN_PRECISE float whole = above * up - rest * down;
    TWIN_PRECISE float safe = max(size, 0.5f);
    TWIN_PRECISE float mean = (middle - (0.5f * whole) / safe) + 1.0f;
    TWIN_PRECISE float inverse = 1.0f / safe;
    TWIN_PRECISE float odd = (0.5f * (1.0f - inverse * inverse)) * (up - down);
    TWIN_PRECISE float skew = -0.25f * (odd + inverse);
    uint against = (floatBitsToUint(r) ^ kSignBit) & kSignBit;
    PieceDepth out_depth;
    out_depth.mean = mean;
    out_depth.skew = uintBitsToFloat((floatBitsToUint(skew) & ~kSignBit) | against);
    return out_depth;
}

TWIN_FN PieceDepth depth_of_opacities(float a0, float a1) {
    TWIN_PRECISE float middle = 0.5f * (a0 + a1);
    TWIN_PRECISE float m = max(1.0f - middle, 1e-30f);
    TWIN_PRECISE float lost = (1.0f - m) - middle;  // 1 − middle = m + lost
    TWIN_PRECISE float inverse = 1.0f / m;
    TWIN_PRECISE float ratio = (0.5f * (a0 - a1)) * inverse;
    TWIN_PRECISE float r = min(max(ratio, -1.0f), 1.0f);
    TWIN_PRECISE float log_middle = -(lost * inverse + 0.693147181f * quick_log2(m));
    TWIN_PRECISE float r2 = r * r;
    PieceDepth depth;
    if (CAST_STEEP && abs(r) > 0.5f) {
        depth = steep_depth(r, log_middle);
    } else {
        // 1/6, 1/20, 1/42, 1/72, 1/110 and 1/3, 1/15, 1/35, 1/63, 1/99.
        TWIN_PRECISE float mean = log_middle + r2 * cast_series(r2, 0.166666672f, 0.0500000007f,
                                                                0.0238095243f, 0.013888889f, 0.0090909088f);
        TWIN_PRECISE float skew = (-0.5f * r) * cast_series(r2, 0.333333343f, 0.0666666701f, 0.0285714287f,
                                                            0.0158730168f, 0.0101010101f);
        depth.mean = mean;
        depth.skew = skew;
    }
    return depth;
}

// 1 − e^(−depth) to full relative precision, depth >= 0.
TWIN_FN float opacity_of_depth(float depth) {
    TWIN_PRECISE float t = max(depth * -1.44269504f, -126.0f);
    TWIN_PRECISE float pushed = t + 12582912.0f;
    int n = int(floatBitsToUint(pushed) - 0x4b400000u);
    TWIN_PRECISE float r = t - float(n);
    // 2^r − 1 by the polynomial of quick_exp2.
    TWIN_PRECISE float r2 = r * r;
    TWIN_PRECISE float high = 0.00961848907f + r * 0.00133999309f;
    TWIN_PRECISE float tail = (0.0555032864f + r * high) + (r2 * r) * 0.00015345811f;
    TWIN_PRECISE float p = r * ((0.693147182f + r * 0.240226462f) + r2 * tail);
    TWIN_PRECISE float power = uintBitsToFloat(uint(n + 127) << 23u);
    TWIN_PRECISE float opacity = (1.0f - power) - power * p;
    return opacity;
}

// Where colour changes evenly along a part, what is seen of it stands by this share of the part behind its
// middle: for opacity that changes, skew/mean; for what attenuates on the way, 1/τ − 1/(e^τ − 1) − ½ to 0.02,
// and to 2e-3 up to a depth of 2.
TWIN_FN float cast_color_shift(PieceDepth piece, float depth) {
    TWIN_PRECISE float mean = max(piece.mean, 1e-30f);
    TWIN_PRECISE float shift;
    if (CAST_THICK && depth > 5.0f) {
        TWIN_PRECISE float front = 1.0f / depth - 0.5f;
        shift = piece.skew / mean + front;
    } else {
        TWIN_PRECISE float thin = 12.0f + 0.2f * (depth * depth);
        shift = (piece.skew * thin - depth * mean) / (mean * thin);
    }
    return min(max(shift, -0.5f), 0.5f);
}

// A step: optical depth, opacity, associated colour.
struct StepLook {
    float depth;
    float opacity;
    Vec3f color;
};
TWIN_FN StepLook no_look() {
    StepLook look;
    look.depth = 0.0f;
    look.opacity = 0.0f;
    look.color.x = 0.0f;
    look.color.y = 0.0f;
    look.color.z = 0.0f;
    return look;
}

// `look`, which lets `clear` pass, and behind it the values from `from` to `to` within a piece: `share` of
// `steps` opacity steps.
struct PartLook {
    StepLook look;
    float clear;
};
TWIN_FN PartLook add_piece(PartLook sum, TransferPiece t, float from, float to, float steps, float share) {
    TWIN_PRECISE float x0 = from - t.base;
    TWIN_PRECISE float x1 = to - t.base;
    TWIN_PRECISE float raw0 = t.opacity + t.opacity_slope * x0;
    TWIN_PRECISE float raw1 = t.opacity + t.opacity_slope * x1;
    TWIN_PRECISE float a0 = min(max(raw0, 0.0f), 1.0f);
    TWIN_PRECISE float a1 = min(max(raw1, 0.0f), 1.0f);
    TWIN_PRECISE float both = a0 + a1;
    if (both > 0.0f && share > 0.0f) {
        PieceDepth piece = depth_of_opacities(a0, a1);
        TWIN_PRECISE float depth = (piece.mean * steps) * share;
        TWIN_PRECISE float middle = 0.5f * (x0 + x1);
        middle = middle + cast_color_shift(piece, depth) * (x1 - x0);
        bool blocks = CAST_STEEP && min(a0, a1) >= 1.0f;
        depth = pick(blocks, kCastBlocks, min(depth, kCastBlocks));
        middle = pick(blocks, x0, middle);
        float alpha = opacity_of_depth(depth);
        TWIN_PRECISE float weight = sum.clear * alpha;
        TWIN_PRECISE float r = sum.look.color.x + weight * (t.r + middle * t.r_slope);
        TWIN_PRECISE float g = sum.look.color.y + weight * (t.g + middle * t.g_slope);
        TWIN_PRECISE float b = sum.look.color.z + weight * (t.b + middle * t.b_slope);
        TWIN_PRECISE float all_depth = sum.look.depth + depth;
        TWIN_PRECISE float opacity = sum.look.opacity + weight;
        TWIN_PRECISE float clear = sum.clear * (1.0f - alpha);
        sum.look.color.x = r;
        sum.look.color.y = g;
        sum.look.color.z = b;
        sum.look.depth = all_depth;
        sum.look.opacity = opacity;
        sum.clear = clear;
    }
    return sum;
}

// ---- Light

// What all rays of a volume have in common; rows of a matrix that carries −∇f into the world, of any length.
struct CastShading {
    Vec3f row0;
    Vec3f row1;
    Vec3f row2;
    float ambient;
    float diffuse;
    float specular;
    float shininess;
};

TWIN_FN float cast_steepest(Vec3f gradient) {
    return max(max(abs(gradient.x), abs(gradient.y)), abs(gradient.z));
}

// Unit normal on the viewer's side; `steepest` > 0 is that of the gradient.
TWIN_FN Vec3f cast_normal(CastShading s, Vec3f gradient, float steepest, Vec3f viewer) {
    TWIN_PRECISE float inverse = 1.0f / steepest;
    TWIN_PRECISE float x = gradient.x * inverse;
    TWIN_PRECISE float y = gradient.y * inverse;
    TWIN_PRECISE float z = gradient.z * inverse;
    Vec3f g;
    g.x = x;
    g.y = y;
    g.z = z;
    Vec3f carried;
    carried.x = dot3(s.row0, g);
    carried.y = dot3(s.row1, g);
    carried.z = dot3(s.row2, g);
    float over_size = quick_rsqrt(max(dot3(carried, carried), 1e-30f));
    TWIN_PRECISE float nx = carried.x * over_size;
    TWIN_PRECISE float ny = carried.y * over_size;
    TWIN_PRECISE float nz = carried.z * over_size;
    Vec3f n;
    n.x = nx;
    n.y = ny;
    n.z = nz;
    return turned_to(n, viewer);
}

// rgb = color·(ambient + diffuse·Σ) + opacity·specular·Σ, of associated colours.
TWIN_FN Vec3f cast_lit_color(CastShading s, LightSums sums, Vec3f color, float opacity) {
    TWIN_PRECISE float all = s.ambient + s.diffuse * sums.diffuse;
    TWIN_PRECISE float highlight = opacity * (s.specular * sums.specular);
    TWIN_PRECISE float r = highlight + color.x * all;
    TWIN_PRECISE float g = highlight + color.y * all;
    TWIN_PRECISE float b = highlight + color.z * all;
    Vec3f lit;
    lit.x = r;
    lit.y = g;
    lit.z = b;
    return lit;
}

// ---- Mixing volumes: zSlab (4.1) to (4.4), and by extinction; what one volume's step adds to those before
// it

struct CastMixture {
    StepLook sum;
    Vec3f weighted;
    float total;
    uint count;
};

TWIN_FN Vec3f cast_scaled(Vec3f v, float s) {
    TWIN_PRECISE float x = v.x * s;
    TWIN_PRECISE float y = v.y * s;
    TWIN_PRECISE float z = v.z * s;
    Vec3f r;
    r.x = x;
    r.y = y;
    r.z = z;
    return r;
}
// Straight colour times optical depth.
TWIN_FN Vec3f cast_by_depth(StepLook look) {
    TWIN_PRECISE float inverse = 1.0f / max(look.opacity, 1e-30f);
    return cast_scaled(cast_scaled(look.color, inverse), look.depth);
}
TWIN_FN float cast_average(float a, float b, float a_opacity, float b_opacity) {
    TWIN_PRECISE float both = a * b_opacity + b * a_opacity;
    TWIN_PRECISE float r = (a + b) - 0.5f * both;
    return r;
}
TWIN_FN Vec3f cast_sum(Vec3f a, Vec3f b) {
    TWIN_PRECISE float x = a.x + b.x;
    TWIN_PRECISE float y = a.y + b.y;
    TWIN_PRECISE float z = a.z + b.z;
    Vec3f r;
    r.x = x;
    r.y = y;
    r.z = z;
    return r;
}

TWIN_FN CastMixture add_to_mixture(CastMixture m, StepLook look, uint mixing) {
    m.count = m.count + 1u;
    if (m.count == 1u) {
        m.sum = look;
        return m;
    }
    if (m.count == 2u) {
        if (mixing == kMixExtinction) m.weighted = cast_by_depth(m.sum);
        m.total = m.sum.opacity;
    }
    if (mixing == kMixAverage) {
        m.sum.color.x = cast_average(m.sum.color.x, look.color.x, m.sum.opacity, look.opacity);
        m.sum.color.y = cast_average(m.sum.color.y, look.color.y, m.sum.opacity, look.opacity);
        m.sum.color.z = cast_average(m.sum.color.z, look.color.z, m.sum.opacity, look.opacity);
    } else if (mixing == kMixNormalised) {
        m.sum.color = cast_sum(m.sum.color, look.color);
        TWIN_PRECISE float total = m.total + look.opacity;
        m.total = total;
    } else {
        m.weighted = cast_sum(m.weighted, cast_by_depth(look));
    }
    TWIN_PRECISE float depth = m.sum.depth + look.depth;
    TWIN_PRECISE float opacity = (m.sum.opacity + look.opacity) - m.sum.opacity * look.opacity;
    m.sum.depth = depth;
    m.sum.opacity = opacity;
    return m;
}
TWIN_FN StepLook mixture_result(CastMixture m, uint mixing) {
    StepLook mixed = m.sum;
    if (m.count > 1u && mixing == kMixNormalised) {
        TWIN_PRECISE float ratio = m.sum.opacity / max(m.total, 1e-30f);
        mixed.color = cast_scaled(m.sum.color, ratio);
    }
    if (m.count > 1u && mixing == kMixExtinction) {
        TWIN_PRECISE float ratio = m.sum.opacity / max(m.sum.depth, 1e-30f);
        mixed.color = cast_scaled(m.weighted, ratio);
    }
    return mixed;
}

TWIN_END
#endif
