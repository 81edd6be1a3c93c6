// What the three shaders of depth peeling share: where a fragment is. Double, in the order of the CPU's operations, so
// that depths have its bits (cpu/rasterizer.hpp, scene/camera.cpp).
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_shader_atomic_int64 : require
#include "kernel/peeling_twin.h"

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Parts { PeelPart at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Planes { PeelPlane at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Objects { PeelObject at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Painted { PaintedFragment at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Doubles { double at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Pixels { PeelPixel at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Place { uint64_t value; };

const uint64_t kNoPlace = 0xfffffffffffffffful;

Vec3d vec3d(double x, double y, double z) {
    Vec3d v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}
Vec3d minus3d(Vec3d a, Vec3d b) {
    precise double x = a.x - b.x;
    precise double y = a.y - b.y;
    precise double z = a.z - b.z;
    return vec3d(x, y, z);
}
double dot3d(Vec3d a, Vec3d b) {
    precise double r = a.x * b.x + a.y * b.y + a.z * b.z;
    return r;
}
Vec3d cross3d(Vec3d a, Vec3d b) {
    precise double x = a.y * b.z - b.y * a.z;
    precise double y = a.z * b.x - b.z * a.x;
    precise double z = a.x * b.y - b.x * a.y;
    return vec3d(x, y, z);
}

// Of a plane on the ray of a pixel's centre.
double plane_depth(double center_x, double center_y, PeelPlane p, int x, int y) {
    precise double u = (double(x) + 0.5lf) - center_x;
    precise double v = (double(y) + 0.5lf) - center_y;
    precise double above = p.c0 + p.cu * u + p.cv * v;
    precise double below = p.d0 + p.du * u + p.dv * v;
    precise double z = p.base + above / below;
    return z > p.lo ? (z < p.hi ? z : p.hi) : p.lo;  // also where a plane is seen edge-on: 0/0
}

struct Ray {
    Vec3d origin;
    Vec3d direction;
};
Ray pixel_ray(PeelRays s, bool perspective, int x, int y) {
    precise double u = ((double(x) + 0.5lf) - s.center_x) * s.pixel_size;
    precise double v = ((double(y) + 0.5lf) - s.center_y) * s.pixel_size;
    precise double ax = u * s.axis_x.x + v * s.axis_y.x;
    precise double ay = u * s.axis_x.y + v * s.axis_y.y;
    precise double az = u * s.axis_x.z + v * s.axis_y.z;
    Ray r;
    r.origin = s.eye;
    r.direction = s.axis_z;
    if (perspective) {
        precise double x1 = s.axis_z.x + ax;
        precise double y1 = s.axis_z.y + ay;
        precise double z1 = s.axis_z.z + az;
        r.direction = vec3d(x1, y1, z1);
    } else {
        precise double x1 = s.eye.x + ax;
        precise double y1 = s.eye.y + ay;
        precise double z1 = s.eye.z + az;
        r.origin = vec3d(x1, y1, z1);
    }
    return r;
}
Vec3d along(Ray ray, double z) {
    precise double x = ray.origin.x + z * ray.direction.x;
    precise double y = ray.origin.y + z * ray.direction.y;
    precise double w = ray.origin.z + z * ray.direction.z;
    return vec3d(x, y, w);
}
