// All objects at once over shared intervals, an array each: merge_order_free of stage/slab_merge.cpp, composited.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "slab_frame.glsl"
#include "kernel/plain_cast_twin.h"
layout(local_size_x_id = 0) in;
struct QuadratureNode {
    double at;
    double weight;
};
layout(buffer_reference, scalar) readonly buffer FrameTable { uint64_t at[]; };
layout(buffer_reference, scalar) readonly buffer Quadrature { QuadratureNode at[]; };
layout(push_constant, scalar) uniform Push {
    FrameTable frames;
    Quadrature nodes;  // those of the rule with n nodes from n(n − 1)/2 on
    FrameFloats planes;
    uint frame_count;
    uint pixels;       // of the image
    uint first, count;
};

uint pixel;

// Rooms: in `given` the next slab of each array, slabs that have begun, and parts of an interval; in `costs` the layer of
// the next slab.
uint active_count, part_count;
uint active_room(uint i) { return frame_count + i; }
uint part_room(uint i) { return 3u * frame_count + i; }

Frame frame_of(uint i) { return Frame(frames.at[i]); }
bool has_next(uint i) { return cost_at(i) > 0.0; }
void load_next(uint i, uint layer) {
    Frame rooms = frame;
    frame = frame_of(i);
    bool there = layer <= most_slabs() && touched(pixel);
    Slab s = no_slab();
    if (there) s = stored_slab(pixel, layer);
    frame = rooms;
    there = there && !is_no_slab(s);
    set_given(i, s);
    set_cost(i, there ? float(layer) : 0.0);
}

// By depth, then by bits: one order for one set of slabs.
bool before(Slab a, Slab b) {
    float fa = slab_front(a), fb = slab_front(b);
    if (fa != fb) return fa < fb;
    if (a.z != b.z) return a.z < b.z;
    if (a.d != b.d) return a.d < b.d;
    if (a.a != b.a) return a.a < b.a;
    if (a.r != b.r) return a.r < b.r;
    if (a.g != b.g) return a.g < b.g;
    return a.b < b.b;
}

void take_slabs_at(float depth) {
    for (;;) {
        uint best = frame_count;
        Slab s;
        for (uint i = 0u; i < frame_count; ++i) {
            if (!has_next(i)) continue;
            Slab here = given_at(i);
            if (slab_front(here) <= depth && (best == frame_count || before(here, s))) {
                best = i;
                s = here;
            }
        }
        if (best == frame_count) return;
        if (s.z <= depth) {
            set_given(part_room(part_count), s);
            ++part_count;
        } else {
            set_given(active_room(active_count), s);
            ++active_count;
        }
        load_next(best, uint(cost_at(best)) + 1u);
    }
}

void cut_active(float front, float back) {
    uint kept = 0u;
    for (uint i = 0u; i < active_count; ++i) {
        Slab s = given_at(active_room(i));
        if (s.z <= back) {
            set_given(part_room(part_count), s);
            ++part_count;
            continue;
        }
        SlabParts cut = split_slab(s, front, back, kInterpolationOfSlabs);
        set_given(part_room(part_count), cut.front);
        ++part_count;
        set_given(active_room(kept), cut.back);
        ++kept;
    }
    active_count = kept;
}

// ∫ Π_{j≠i}(1 − tα_j) dt
double weight_in_all_orders(uint i) {
    uint n = (part_count + 1u) / 2u;
    double own_a = double(given_at(part_room(i)).a);
    double weight = 0.0lf;
    for (uint k = 0u; k < n; ++k) {
        QuadratureNode node = nodes.at[n * (n - 1u) / 2u + k];
        precise double product = node.weight;
        for (uint j = 0u; j < part_count; ++j) {
            precise double passes = 1.0lf - node.at * double(given_at(part_room(j)).a);
            product = product * passes;
        }
        precise double passes_own = 1.0lf - node.at * own_a;
        precise double share = product / passes_own;
        precise double sum = weight + share;
        weight = sum;
    }
    return weight;
}

Slab mix_parts() {
    if (part_count == 1u) return given_at(part_room(0u));
    if (part_count == 2u) return mix_slabs(given_at(part_room(0u)), given_at(part_room(1u)), kMixingOfSlabs);
    precise double a = 0.0lf;
    precise double opacities = 0.0lf;
    precise double depths = 0.0lf;
    double opaque = 0.0lf;
    for (uint i = 0u; i < part_count; ++i) {
        double own_a = double(given_at(part_room(i)).a);
        a = a + (1.0lf - a) * own_a;
        opacities = opacities + own_a;
        if (own_a >= 1.0lf) opaque += 1.0lf;
        else if (kMixingOfSlabs == kMixExtinction) depths = depths - log1p_d(-own_a);
    }
    precise double r = 0.0lf, g = 0.0lf, b = 0.0lf;
    for (uint i = 0u; i < part_count; ++i) {
        Slab s = given_at(part_room(i));
        double own_a = double(s.a);
        precise double weight = 1.0lf;
        if (kMixingOfSlabs == kMixAverage) {
            weight = weight_in_all_orders(i);
        } else if (kMixingOfSlabs == kMixNormalised) {
            if (opacities > 0.0lf) weight = a / opacities;
        } else if (opaque > 0.0lf) {
            weight = own_a >= 1.0lf ? 1.0lf / opaque : 0.0lf;
        } else if (depths > 0.0lf) {
            precise double ratio = 1.0lf;
            if (own_a > 0.0lf) ratio = -log1p_d(-own_a) / own_a;
            weight = a * ratio / depths;
        }
        r = r + weight * double(s.r);
        g = g + weight * double(s.g);
        b = b + weight * double(s.b);
    }
    return Slab(0.0, 0.0, float(r), float(g), float(b), float(a));
}

Slab total;
float passing;
bool emit_parts() {
    if (part_count == 0u) return true;
    Slab mixed = mix_parts();
    part_count = 0u;
    total = slab_over(total, mixed);
    precise float passes = passing * (1.0 - mixed.a);
    precise float least = 1.0 - frame.opaque_at;
    passing = passes;
    return passing > least;
}

void main() {
    uint number = (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (number >= count) return;
    pixel = first + number;
    own = number;
    frame = frame_of(0u);
    float nearest = uintBitsToFloat(0x7f800000u);
    float depth = kNeverJoins;
    for (uint i = 0u; i < frame_count; ++i) {
        nearest = min(nearest, FrameFloats(frame_of(i).nearest).at[pixel]);
        load_next(i, 1u);
        if (has_next(i)) depth = min(depth, slab_front(given_at(i)));
    }
    total = no_slab();
    passing = 1.0;
    active_count = 0u;
    part_count = 0u;
    bool going = depth < kNeverJoins;
    while (going) {
        take_slabs_at(depth);
        going = emit_parts();
        float next = kNeverJoins;
        for (uint i = 0u; i < frame_count; ++i)
            if (has_next(i)) next = min(next, slab_front(given_at(i)));
        for (uint i = 0u; i < active_count; ++i) next = min(next, given_at(active_room(i)).z);
        going = going && next < kNeverJoins;
        if (!going) break;
        cut_active(depth, next);
        going = emit_parts();
        depth = next;
    }
    planes.at[pixel] = total.r;
    planes.at[pixels + pixel] = total.g;
    planes.at[2u * pixels + pixel] = total.b;
    planes.at[3u * pixels + pixel] = total.a;
    planes.at[4u * pixels + pixel] = nearest;
}
