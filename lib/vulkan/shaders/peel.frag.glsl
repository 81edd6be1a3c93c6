// A fragment takes its place among the nearest of its pixel that are still wanted. Places are (depth or rank, number of
// the part): a total order, so that no two are equal and the result is the same in whatever order fragments come.
// Slots of a pixel ascend: the least goes first, and what it displaces goes on to the next.
#version 460
#include "vulkan/shaders/peeling.glsl"

layout(constant_id = 0) const uint kSlots = 4;

layout(location = 0) flat in uint part_number;
layout(location = 1) flat in uint judged;

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
    PeelSetup s = Setup(push.setup).setup;
    int x = int(gl_FragCoord.x);
    int y = int(gl_FragCoord.y);
    if (x >= s.width || y >= s.height) return;
    PeelPart part = Parts(s.parts).at[part_number];
    if (judged != 0u && !(inside(part.x0, part.y0, part.x1, part.y1, x, y) && inside(part.x1, part.y1, part.x2, part.y2, x, y) &&
                          inside(part.x2, part.y2, part.x0, part.y0, x, y)))
        return;
    double z = plane_depth(s, Planes(s.planes).at[part_number], x, y);
    if (!(z >= s.near_depth && z <= s.far_depth)) return;
    uint first = s.order != 0ul ? Order(s.order).at[part.triangle] : floatBitsToUint(float(z));
    uint64_t place = (uint64_t(first) << 32u) | uint64_t(part_number);

    uint pixel = uint(y) * uint(s.width) + uint(x);
    if (place >= slot_of(s, kSlots - 1, pixel).value) return;
    Pixels state = Pixels(s.pixels);
    if (place < state.at[pixel].from || first > state.at[pixel].most) return;

    PeelObject o = Objects(s.objects).at[part.object];
    if ((o.flags & kPeelPainted) != 0) {
        uint at = uint(y - o.painted_y) * uint(o.painted_width) + uint(x - o.painted_x);
        if (Painted(o.painted).at[at].triangle != part.triangle) return;
    } else if (o.clip_count > 0 || (o.flags & kPeelBounds) != 0) {
        if (is_cut(o, along(pixel_ray(s, x, y), z))) return;
    }

    for (uint i = 0; i < kSlots; ++i) {
        uint64_t before = atomicMin(slot_of(s, i, pixel).value, place);
        if (before == kNoPlace) return;
        place = max(before, place);
    }
}
