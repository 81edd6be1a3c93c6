// What the shaders share that cast trilinear volumes in float32: samples, the steps of a ray, and how it gets
// over what is empty. One invocation is one ray; rays come packet after packet. Nothing is written here.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_KHR_shader_subgroup_vote : require
layout(constant_id = 10) const uint kExtremes = 3;  // 1: some opacity is above 0.6; 2: some step's optical depth above 4.9
#define CAST_STEEP ((kExtremes & 1u) != 0u)
#define CAST_THICK ((kExtremes & 2u) != 0u)
#include "kernel/cast_rays_twin.h"

layout(local_size_x_id = 0) in;
// What a frame does not need is not there: in software a branch that nobody takes is still run through.
layout(constant_id = 1) const uint kKinds = 7;   // bit k: some volume's samples are of kind k
layout(constant_id = 2) const bool kLit = true;  // some volume is
layout(constant_id = 3) const bool kGlossy = true;
layout(constant_id = 4) const uint kLights = 1;
layout(constant_id = 5) const bool kHoles = true;  // some samples are not a number
layout(constant_id = 6) const bool kSkip = true;   // some volume has blocks
layout(constant_id = 7) const uint kMixing = 0;
layout(constant_id = 8) const uint kPieces = 0;   // a transfer function's, kept by the ray; 0: read where they are needed
layout(constant_id = 9) const uint kVolumes = 1;

layout(buffer_reference, scalar) readonly buffer Setup { CastSetup it; };
layout(buffer_reference, scalar) readonly buffer Volumes { CastVolume at[]; };
layout(buffer_reference, scalar) readonly buffer Lights { CastLight at[]; };
layout(buffer_reference, scalar) buffer PacketRays { PacketRay at[]; };
layout(buffer_reference, scalar) buffer VolumeRays { VolumeRay at[]; };
layout(buffer_reference, scalar) buffer AllRaySteps { RaySteps at[]; };
layout(buffer_reference, scalar) readonly buffer Words { uint at[]; };
layout(buffer_reference, scalar) readonly buffer LongWords { uint64_t at[]; };
layout(buffer_reference, scalar) readonly buffer Floats { float at[]; };
layout(buffer_reference, scalar) readonly buffer Pieces { TransferPiece at[]; };
layout(buffer_reference, scalar) buffer Status {
    uint unfinished;
    uint most_layers;
};

// ---- Samples

struct Place {
    CastCell cell;
    bool number;  // all of its corners are
};

bool is_number(float v) { return (floatBitsToUint(v) & ~kSignBit) <= kInfinityBits; }

void set_bytes(inout CastCell c, uint near_z, uint far_z) {
    int a = int(near_z & 255u), b = int((near_z >> 16) & 255u);
    int d = int(far_z & 255u), e = int((far_z >> 16) & 255u);
    c.low0 = float(a);
    c.low1 = float(b);
    c.low2 = float(d);
    c.low3 = float(e);
    c.more0 = float(int((near_z >> 8) & 255u) - a);
    c.more1 = float(int(near_z >> 24) - b);
    c.more2 = float(int((far_z >> 8) & 255u) - d);
    c.more3 = float(int(far_z >> 24) - e);
}
void set_words(inout CastCell c, uvec2 near_z, uvec2 far_z) {
    int a = int(near_z.x & 65535u), b = int(near_z.y & 65535u);
    int d = int(far_z.x & 65535u), e = int(far_z.y & 65535u);
    c.low0 = float(a);
    c.low1 = float(b);
    c.low2 = float(d);
    c.low3 = float(e);
    c.more0 = float(int(near_z.x >> 16) - a);
    c.more1 = float(int(near_z.y >> 16) - b);
    c.more2 = float(int(far_z.x >> 16) - d);
    c.more3 = float(int(far_z.y >> 16) - e);
}
bool set_floats(inout CastCell c, Floats samples, uint n, uint row, uint slice) {
    float a = samples.at[n], a1 = samples.at[n + 1];
    float b = samples.at[n + row], b1 = samples.at[n + row + 1];
    float d = samples.at[n + slice], d1 = samples.at[n + slice + 1];
    float e = samples.at[n + slice + row], e1 = samples.at[n + slice + row + 1];
    precise float more0 = a1 - a, more1 = b1 - b, more2 = d1 - d, more3 = e1 - e;
    c.low0 = a;
    c.low1 = b;
    c.low2 = d;
    c.low3 = e;
    c.more0 = more0;
    c.more1 = more1;
    c.more2 = more2;
    c.more3 = more3;
    return !kHoles || (is_number(a) && is_number(a1) && is_number(b) && is_number(b1) && is_number(d) &&
                       is_number(d1) && is_number(e) && is_number(e1));
}

Place place_at(CastVolume v, Vec3f index) {
    int i = min(int(index.x), v.last_cell_x);
    int j = min(int(index.y), v.last_cell_y);
    int k = min(int(index.z), v.last_cell_z);
    Place p;
    p.number = true;
    precise float x = index.x - float(i), y = index.y - float(j), z = index.z - float(k);
    p.cell.at = Vec3f(x, y, z);
    uint n = uint(i) + uint(j) * v.row + uint(k) * v.slice;
    if ((kKinds & 1u) != 0u && (kKinds == 1u || v.kind == kSamplesBytes)) {
        Words samples = Words(v.samples);
        set_bytes(p.cell, samples.at[n], samples.at[n + v.slice]);
    }
    if ((kKinds & 2u) != 0u && (kKinds == 2u || v.kind == kSamplesWords)) {
        LongWords samples = LongWords(v.samples);
        set_words(p.cell, unpackUint2x32(samples.at[n]), unpackUint2x32(samples.at[n + v.slice]));
    }
    if ((kKinds & 4u) != 0u && (kKinds == 4u || v.kind == kSamplesFloats))
        p.number = set_floats(p.cell, Floats(v.samples), n, v.row, v.slice);
    return p;
}

// ---- One volume along one ray

struct Walk {
    VolumeRay ray;
    uint volume;  // its number
    float u;      // how far the ray is looked at
    float begin;  // of the last step
    float value;  // at u …
    bool number;  // … where it is one
    uint piece;
};

Vec3f index_of(CastVolume v, VolumeRay ray, float u) {
    precise float x = ray.p.x + u * ray.d.x, y = ray.p.y + u * ray.d.y, z = ray.p.z + u * ray.d.z;
    return Vec3f(min(max(x, 0.0), v.last.x), min(max(y, 0.0), v.last.y), min(max(z, 0.0), v.last.z));
}

float clamp_u(VolumeRay ray, float u) { return min(max(u, ray.u_in), ray.u_out); }

// Transfer functions as bits, a piece three words of four. In software a load is eight of them, one a ray. What is kept is
// chosen, not indexed: so it stays in registers.
uvec4 kept_pieces[kVolumes * kPieces * 3u + 1u];  // an array has at least one
void keep_pieces(CastVolume v, uint volume) {
    for (uint k = 0u; k < kPieces; ++k) {
        Words words = Words(v.pieces + 48ul * min(k, v.piece_count - 1u));
        for (uint i = 0u; i < 3u; ++i)
            kept_pieces[(volume * kPieces + k) * 3u + i] =
                uvec4(words.at[4u * i], words.at[4u * i + 1u], words.at[4u * i + 2u], words.at[4u * i + 3u]);
    }
}
uint piece_of(CastVolume v, uint volume, float value) {
    uint piece = 0u;
    if (kPieces == 0u) {
        for (uint k = 1u; k < v.piece_count; ++k) piece += uint(value >= Pieces(v.pieces).at[k].begin);
        return piece;
    }
    for (uint k = 1u; k < kPieces; ++k)
        piece += uint(k < v.piece_count && value >= uintBitsToFloat(kept_pieces[(volume * kPieces + k) * 3u].x));
    return piece;
}

// Before step i, wherever the ray was before.
void prime(inout Walk w, CastVolume v, float i) {
    w.u = clamp_u(w.ray, i);
    Place p = place_at(v, index_of(v, w.ray, w.u));
    w.value = p.number ? cell_value(p.cell) : 0.0;
    w.number = p.number;
    w.piece = piece_of(v, w.volume, w.value);
}

// Between two values; `piece` is that of `from` and becomes that of `to`.
StepLook preintegrate(CastVolume v, uint volume, float from, float to, float steps, inout uint piece) {
    uint first_kept = volume * kPieces * 3u;
    PartLook sum = PartLook(no_look(), 1.0);
    float at = from;
    precise float change = to - from;
    for (bool first = true;; first = false) {
        TransferPiece t;
        if (kPieces == 0u) {
            t = Pieces(v.pieces).at[piece];
        } else {
            // No function gives it: glslang would look for `precise` in every member of every argument.
            uvec4 a = kept_pieces[first_kept], b = kept_pieces[first_kept + 1u], c = kept_pieces[first_kept + 2u];
            for (uint k = 1u; k < kPieces; ++k) {
                bool here = piece >= k;
                a = here ? kept_pieces[first_kept + 3u * k] : a;
                b = here ? kept_pieces[first_kept + 3u * k + 1u] : b;
                c = here ? kept_pieces[first_kept + 3u * k + 2u] : c;
            }
            t = TransferPiece(uintBitsToFloat(a.x), uintBitsToFloat(a.y), uintBitsToFloat(a.z), uintBitsToFloat(a.w),
                              uintBitsToFloat(b.x), uintBitsToFloat(b.y), uintBitsToFloat(b.z), uintBitsToFloat(b.w),
                              uintBitsToFloat(c.x), uintBitsToFloat(c.y), uintBitsToFloat(c.z), 0.0);
        }
        float end = min(max(to, t.begin), t.end);
        bool beyond = to >= t.end, before = to < t.begin;
        bool last = !(beyond || before);
        precise float part = (end - at) / change;
        float share = (first && last) || change == 0.0 ? 1.0 : part;
        sum = add_piece(sum, t, at, end, steps, share);
        if (last) break;
        piece = beyond ? piece + 1u : piece - 1u;
        at = end;
    }
    return sum.look;
}

LightSums light_sums(Setup setup, CastShading shading, Vec3f normal, Vec3f viewer) {
    LightSums sums = LightSums(0.0, 0.0);
    Lights lights = Lights(setup.it.lights);
    for (uint i = 0u; i < kLights; ++i) {
        CastLight light = lights.at[i];
        Vec3f l = light.headlight != 0u ? viewer : light.direction;
        if (kGlossy)
            sums = add_light(sums, normal, viewer, l, light.intensity, shading.shininess);
        else
            sums.diffuse = add_diffuse(sums.diffuse, normal, l, light.intensity);
    }
    return sums;
}

// On to u = `target`.
StepLook step_to(Setup setup, inout Walk w, CastVolume v, float target, Vec3f viewer) {
    float u = clamp_u(w.ray, target);
    Place p = place_at(v, index_of(v, w.ray, u));
    float value = p.number ? cell_value(p.cell) : 0.0;
    precise float share = u - w.u;
    precise float steps = share * v.steps;
    StepLook look = no_look();
    uint piece = w.piece;
    bool inside = share > 0.0;
    if (inside && w.number && p.number)
        look = preintegrate(v, w.volume, w.value, value, steps, piece);
    else if (kHoles && p.number)
        piece = piece_of(v, w.volume, value);
    if (kLit && look.opacity > 0.0 && v.lit != 0u) {
        precise float middle = 0.5 * (w.u + u);
        Place m = place_at(v, index_of(v, w.ray, middle));
        Vec3f gradient = cell_gradient(m.cell);
        float steepest = cast_steepest(gradient);
        // Unlit where there is no gradient.
        if (m.number && steepest > 0.0) {
            Vec3f normal = cast_normal(v.shading, gradient, steepest, viewer);
            look.color = cast_lit_color(v.shading, light_sums(setup, v.shading, normal, viewer), look.color,
                                        look.opacity);
        }
    }
    w.piece = piece;
    w.begin = w.u;
    w.u = u;
    w.value = value;
    w.number = p.number;
    return look;
}

// ---- Empty space

float leave(float end, int block, int away, float p, float d) {
    // A hair before the face of the cube of empty blocks through which the ray leaves.
    precise float up = float((block + away) * 8) - kCastFaceRoom;
    precise float down = float((block - away + 1) * 8) + kCastFaceRoom;
    precise float meet = ((d > 0.0 ? up : down) - p) / d;
    return d == 0.0 ? end : min(end, meet);
}

// The first step from i on in which the ray may see something; kCastNever.
float next_step(Walk w, CastVolume v, float i) {
    VolumeRay ray = w.ray;
    float u = clamp_u(ray, i);
    if (!(ray.u_in < ray.u_out && u < ray.u_out)) return kCastNever;
    if (!kSkip || v.distance == 0) return floor(u);
    if (v.anything == 0u) return kCastNever;
    Vec3f at = index_of(v, ray, u);
    int x = min(int(at.x) >> 3, v.blocks_x - 1);
    int y = min(int(at.y) >> 3, v.blocks_y - 1);
    int z = min(int(at.z) >> 3, v.blocks_z - 1);
    uint block = uint(x + v.blocks_x * (y + v.blocks_y * z));
    int away = int((Words(v.distance).at[block >> 2] >> (8u * (block & 3u))) & 255u);
    if (away == 0) return floor(u);
    float end = leave(leave(leave(kCastNever, x, away, ray.p.x, ray.d.x), y, away, ray.p.y, ray.d.y), z, away,
                      ray.p.z, ray.d.z);
    return end >= ray.u_out ? kCastNever : floor(max(u, end));
}

// Number of this invocation.
uint invocation_number() {
    return (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x +
           gl_LocalInvocationID.x;
}
// The pixel of a ray of a packet.
ivec2 pixel_of_ray(Setup setup, uint packet, uint ray) {
    return ivec2(packet % setup.it.packet_columns * kPacketSideT + ray % kPacketSideT,
                 packet / setup.it.packet_columns * kPacketSideT + ray / kPacketSideT);
}
