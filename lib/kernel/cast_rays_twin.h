// Rays of pixels and where they meet a volume, in double: what cpu/volume_caster.cpp (VolumeCaster::enter)
// and make_packet of cpu/fast_volume_caster.cpp do, with the same operations in the same order.
//
// All rays are sampled on a fixed grid: at depths t = k·dt, k whole. The rays of a packet of 4 × 4 pixels
// count their steps from one of them, so that what float32 has to say of a ray is small.
#ifndef PELLUCID_KERNEL_CAST_RAYS_TWIN_H
#define PELLUCID_KERNEL_CAST_RAYS_TWIN_H
#include "kernel/cast_twin.h"
#include "kernel/vec3d_twin.h"
TWIN_BEGIN

// As Camera, and a step's world length along a ray.
struct CastCamera {
    Vec3d eye;
    Vec3d right;
    Vec3d down;
    Vec3d forward;
    double center_x;
    double center_y;
    double pixel_size;
    double near;
    double far;
    double step;
    int width;
    int height;
    uint perspective;
    uint rays;         // n: n × n rays a pixel
    uint most_rounds;  // of a ray's loop: no limit, but one that a compiler does not know
    uint unused;
};

// Keeps normal·x <= offset, world.
struct CastPlane {
    Vec3d normal;
    double offset;
};

// Columns of the map from the world to samples.
struct CastPlace {
    Vec3d column0;
    Vec3d column1;
    Vec3d column2;
    Vec3d offset;
    Vec3d last;  // sample along each axis
};

struct RayD {
    Vec3d origin;
    Vec3d direction;  // 1 along the view axis
};

TWIN_FN Vec3d vec3d(double x, double y, double z) {
    Vec3d v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}
TWIN_FN double dot3d(Vec3d a, Vec3d b) {
    TWIN_PRECISE double r = a.x * b.x + a.y * b.y + a.z * b.z;
    return r;
}
// a + s·b
TWIN_FN Vec3d along3d(Vec3d a, double s, Vec3d b) {
    TWIN_PRECISE double x = a.x + s * b.x;
    TWIN_PRECISE double y = a.y + s * b.y;
    TWIN_PRECISE double z = a.z + s * b.z;
    return vec3d(x, y, z);
}
TWIN_FN Vec3d scaled3d(double s, Vec3d v) {
    TWIN_PRECISE double x = s * v.x;
    TWIN_PRECISE double y = s * v.y;
    TWIN_PRECISE double z = s * v.z;
    return vec3d(x, y, z);
}
TWIN_FN double length3d(Vec3d v) { return sqrt(dot3d(v, v)); }

TWIN_FN double mapped_d(double c0, double c1, double c2, Vec3d v) {
    TWIN_PRECISE double r = c0 * v.x + c1 * v.y + c2 * v.z;
    return r;
}
TWIN_FN Vec3d place_vector(CastPlace m, Vec3d v) {
    return vec3d(mapped_d(m.column0.x, m.column1.x, m.column2.x, v),
                 mapped_d(m.column0.y, m.column1.y, m.column2.y, v),
                 mapped_d(m.column0.z, m.column1.z, m.column2.z, v));
}
TWIN_FN Vec3d place_point(CastPlace m, Vec3d v) {
    Vec3d r = place_vector(m, v);
    TWIN_PRECISE double x = r.x + m.offset.x;
    TWIN_PRECISE double y = r.y + m.offset.y;
    TWIN_PRECISE double z = r.z + m.offset.z;
    return vec3d(x, y, z);
}

// Through image position (x, y), in pixels; (i + ½)/n of a pixel for ray i of n.
TWIN_FN double ray_position(int pixel, uint i, uint n) {
    TWIN_PRECISE double r = double(pixel) + (double(i) + double(0.5f)) / double(n);
    return r;
}
TWIN_FN RayD camera_ray(CastCamera c, double x, double y) {
    TWIN_PRECISE double u = (x - c.center_x) * c.pixel_size;
    TWIN_PRECISE double v = (y - c.center_y) * c.pixel_size;
    Vec3d aside = along3d(scaled3d(u, c.right), v, c.down);
    RayD ray;
    ray.origin = c.eye;
    ray.direction = c.forward;
    if (c.perspective != 0u)
        ray.direction = along3d(c.forward, double(1), aside);
    else
        ray.origin = along3d(c.eye, double(1), aside);
    return ray;
}

// The part of a line in which value + slope·t >= 0 for all that is asked.
struct SpanD {
    double lo;
    double hi;
};
TWIN_FN SpanD span_kept(SpanD s, double value, double slope) {
    double zero = double(0);
    TWIN_PRECISE double meet = -value / slope;
    if (slope > zero) s.lo = max(s.lo, meet);
    if (slope < zero) s.hi = min(s.hi, meet);
    if (slope == zero && value < zero) s.hi = s.lo;
    return s;
}
TWIN_FN SpanD span_in_box(SpanD s, Vec3d from, Vec3d along, Vec3d last) {
    s = span_kept(s, from.x, along.x);
    TWIN_PRECISE double x = last.x - from.x;
    s = span_kept(s, x, -along.x);
    s = span_kept(s, from.y, along.y);
    TWIN_PRECISE double y = last.y - from.y;
    s = span_kept(s, y, -along.y);
    s = span_kept(s, from.z, along.z);
    TWIN_PRECISE double z = last.z - from.z;
    return span_kept(s, z, -along.z);
}
TWIN_FN SpanD span_clipped(SpanD s, RayD ray, CastPlane plane) {
    TWIN_PRECISE double value = plane.offset - dot3d(plane.normal, ray.origin);
    return span_kept(s, value, -dot3d(plane.normal, ray.direction));
}

// The grid's number of the sample at or before t: the quotient is off by rounding alone.
TWIN_FN int64_t grid_sample_before(double t, double dt) {
    TWIN_PRECISE double quotient = t / dt;
    int64_t k = int64_t(floor(quotient));
    TWIN_PRECISE double here = double(k) * dt;
    if (here > t) k = k - int64_t(1);
    TWIN_PRECISE double next = double(k + int64_t(1)) * dt;
    if (next <= t) k = k + int64_t(1);
    return k;
}

// What float32 is told of a ray: VolumeRay, from step `first` on.
TWIN_FN VolumeRay packed_ray(Vec3d from, Vec3d along, SpanD span, double dt, int64_t first_step) {
    TWIN_PRECISE double first = double(first_step);
    TWIN_PRECISE double u_in = span.lo / dt - first;
    TWIN_PRECISE double u_out = span.hi / dt - first;
    TWIN_PRECISE double begin = first * dt;
    Vec3d p = along3d(from, begin, along);
    Vec3d d = scaled3d(dt, along);
    VolumeRay ray;
    ray.u_in = float(u_in);
    ray.u_out = float(u_out);
    ray.p.x = float(p.x);
    ray.p.y = float(p.y);
    ray.p.z = float(p.z);
    ray.d.x = float(d.x);
    ray.d.y = float(d.y);
    ray.d.z = float(d.z);
    return ray;
}
TWIN_FN Vec3f unit_to_viewer(Vec3d direction) {
    TWIN_PRECISE double over_size = double(1) / length3d(direction);
    TWIN_PRECISE double x = -(direction.x * over_size);
    TWIN_PRECISE double y = -(direction.y * over_size);
    TWIN_PRECISE double z = -(direction.z * over_size);
    Vec3f v;
    v.x = float(x);
    v.y = float(y);
    v.z = float(z);
    return v;
}

// What one volume adds to how the kernels cast it: addresses are those of arrays.
struct CastVolume {
    CastPlace place;
    CastShading shading;
    Vec3f last;  // sample along each axis
    int last_cell_x;
    int last_cell_y;
    int last_cell_z;
    uint row;  // samples
    uint slice;
    int blocks_x;
    int blocks_y;
    int blocks_z;
    uint anything;  // 0: nothing is to be seen anywhere
    uint kind;
    uint piece_count;
    float steps;  // opacity steps in a step
    uint plane_count;
    uint lit;
    uint64_t samples;   // cells' corners: uint, uint64_t, or samples: float, by kind
    uint64_t pieces;    // TransferPiece
    uint64_t distance;  // bytes; 0: everything is visited
    uint64_t planes;    // CastPlane
};

// Multi-volume casting: a surface at one depth of a ray, associated colour.
struct RayLayer {
    double t;
    float r;
    float g;
    float b;
    float a;
};
// … and what the rays of a pixel have gathered: sums over them, and the nearest depth.
struct PixelTotal {
    double r;
    double g;
    double b;
    double clear;
    double z;
};
const double kNoDepth = double(1e30f) * double(1e30f);  // where nothing is seen

// All of a frame's casting, in one buffer.
struct CastSetup {
    CastCamera camera;
    uint volume_count;
    uint light_count;
    uint packet_columns;   // of the image
    float least_clear;     // a ray ends where what passes is not more
    uint64_t volumes;      // CastVolume, or PlainVolume, PlainSurface
    uint64_t lights;       // CastLight
    uint64_t packet_rays;  // PacketRay, packet after packet
    uint64_t volume_rays;  // VolumeRay, volume after volume
    uint64_t ray_steps;    // RaySteps
    uint64_t status;       // uint: kCastCut, and …
    // Multi-volume casting.
    uint64_t layers;        // RayLayer: `layer_room` a ray, from front to back; 0: there are none
    uint64_t layer_counts;  // uint a ray
    uint64_t surfaces;      // PlainSurface: isosurfaces
    uint64_t given;         // Slab: layers that came from elsewhere, sorted …
    uint64_t given_first;  // … and uint a ray and one more: where its own begin; row by row of `rays` times
                           // as many
    uint64_t totals;       // PixelTotal, row by row of the image
    uint64_t planes;       // float: five planes
    uint surface_count;
    uint layer_room;
    uint given_row;  // of pixels, the first one
    uint mixing;
};

// status[0]: not 0 where a ray's loops were cut before its end. status[1]: the most layers a ray has.
const uint kStatusWords = 2u;

// From where a packet counts, and a ray's step along the view axis.
struct RaySteps {
    int64_t first;
    double dt;
};

TWIN_END
#endif
