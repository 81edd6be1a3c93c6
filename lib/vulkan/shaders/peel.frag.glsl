// A fragment takes its place among the nearest of its pixel that are still wanted. Places are (depth or rank, number of
// the part): a total order, so that no two are equal and the result is the same in whatever order fragments come.
// Slots of a pixel ascend: the least goes first, and what it displaces goes on to the next.
#version 460
#include "vulkan/shaders/peeling.glsl"

// Constants and not branches: software runs through all branches, with nobody in them.
layout(constant_id = 0) const uint kSlots = 4;
layout(constant_id = 1) const uint kAsks = 0;    // fragments may be cut away
layout(constant_id = 2) const uint kJudged = 0;  // the device covers more than the part
layout(constant_id = 3) const uint kRanked = 0;  // by rank, not by depth
layout(constant_id = 4) const uint kPerspective = 1;
layout(constant_id = 5) const uint kFirst = 0;  // of all passes: nothing was kept so far

layout(push_constant, scalar) uniform Push { PeelDrawPush push; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Rays { PeelRays rays; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Order { uint at[]; };

layout(location = 0) flat in uvec4 plane_0;
layout(location = 1) flat in uvec4 plane_1;
layout(location = 2) flat in uvec4 plane_2;
layout(location = 3) flat in uvec4 plane_3;
layout(location = 4) flat in uvec4 plane_4;

// A pixel's centre against an edge in 64 bits, as RasterEdge of cpu/rasterizer.hpp.
bool inside(int from_x, int from_y, int to_x, int to_y, int x, int y) {
    int64_t dx = int64_t(to_x) - int64_t(from_x);
    int64_t dy = int64_t(to_y) - int64_t(from_y);
    bool holds = dy < 0 || (dy == 0 && dx > 0);
    int64_t at = dx * (int64_t(256 * y + 128) - int64_t(from_y)) - dy * (int64_t(256 * x + 128) - int64_t(from_x));
    return holds ? at >= 0 : at > 0;
}

bool is_cut(PeelObject o, Vec3d world) {
    for (uint i = 0; i < o.clip_count; ++i) {
        Doubles clip = Doubles(o.clip);
        Vec3d normal = vec3d(clip.at[4 * i], clip.at[4 * i + 1], clip.at[4 * i + 2]);
        if (dot3d(normal, world) > clip.at[4 * i + 3]) return true;
    }
    if ((o.flags & kPeelBounds) == 0) return false;
    precise double x = o.to_object_x.x * world.x + o.to_object_y.x * world.y + o.to_object_z.x * world.z;
    precise double y = o.to_object_x.y * world.x + o.to_object_y.y * world.y + o.to_object_z.y * world.z;
    precise double z = o.to_object_x.z * world.x + o.to_object_y.z * world.y + o.to_object_z.z * world.z;
    precise double px = x + o.to_object_offset.x;
    precise double py = y + o.to_object_offset.y;
    precise double pz = z + o.to_object_offset.z;
    return px < o.lo.x || px > o.hi.x || py < o.lo.y || py > o.hi.y || pz < o.lo.z || pz > o.hi.z;
}

void main() {
    int x = int(gl_FragCoord.x);
    int row = int(gl_FragCoord.y);
    int y = push.first_row + row;
    uint part_number = plane_4.z;
    uint triangle = kAsks != 0u || kRanked != 0u ? Parts(push.parts).at[part_number].triangle : 0u;
    if (kJudged != 0u) {
        PeelPart p = Parts(push.parts).at[part_number];
        if (!(inside(p.x0, p.y0, p.x1, p.y1, x, y) && inside(p.x1, p.y1, p.x2, p.y2, x, y) &&
              inside(p.x2, p.y2, p.x0, p.y0, x, y)))
            return;
    }
    PeelPlane plane;
    plane.base = packDouble2x32(plane_0.xy);
    plane.c0 = packDouble2x32(plane_0.zw);
    plane.cu = packDouble2x32(plane_1.xy);
    plane.cv = packDouble2x32(plane_1.zw);
    plane.d0 = packDouble2x32(plane_2.xy);
    plane.du = packDouble2x32(plane_2.zw);
    plane.dv = packDouble2x32(plane_3.xy);
    plane.lo = packDouble2x32(plane_3.zw);
    plane.hi = packDouble2x32(plane_4.xy);
    double z = plane_depth(push.center_x, push.center_y, plane, x, y);
    if (!(z >= push.near_depth && z <= push.far_depth)) return;
    uint first = floatBitsToUint(float(z));
    if (kRanked != 0u) first = Order(push.order).at[triangle];
    uint64_t place = (uint64_t(first) << 32u) | uint64_t(part_number);

    uint64_t pixel = uint64_t(row) * uint64_t(push.width) + uint64_t(x);
    uint64_t slot = push.slots + 8ul * pixel;
    uint64_t step = 8ul * (uint64_t(push.width) * uint64_t(push.rows));
    // What is read here may be old, and then larger than what is there: it only falls.
    if (kSlots > 1u && place >= Place(slot + (kSlots - 1) * step).value) return;
    if (kFirst == 0u && place < Pixels(push.pixels + 24ul * pixel).at[0].from) return;

    if (kAsks != 0u) {
        PeelObject o = Objects(push.objects).at[plane_4.w];
        if ((o.flags & kPeelPainted) != 0) {
            uint at = uint(y - o.painted_y) * uint(o.painted_width) + uint(x - o.painted_x);
            if (Painted(o.painted).at[at].triangle != triangle) return;
        } else {
            if (is_cut(o, along(pixel_ray(Rays(push.rays).rays, kPerspective != 0u, x, y), z))) return;
        }
    }

    for (uint i = 0; i < kSlots; ++i) {
        uint64_t before = atomicMin(Place(slot).value, place);
        if (before == kNoPlace) return;
        place = max(before, place);
        slot += step;
    }
}
