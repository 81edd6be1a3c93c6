// What the shaders share that cast in double: the plain version of the CPU (cpu/volume_caster.cpp) line by
// line. Values that are no numbers go by flags. Nothing is written here.
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#include "kernel/plain_cast_twin.h"

layout(local_size_x_id = 0) in;
// What a frame does not need is not there: in software a branch that nobody takes is still run through.
layout(constant_id = 1) const uint kInterpolations = 7;  // bit k: some grid has interpolation k
layout(constant_id = 2) const bool kLit = true;
layout(constant_id = 3) const bool kGlossy = true;
layout(constant_id = 4) const uint kLights = 1;
layout(constant_id = 5) const bool kHoles = true;  // some samples are not a number

const uint kTrilinear = 0u;
const uint kCatmullRom = 1u;
const uint kNearest = 2u;
const double kFar = 1e300lf;  // for infinity, which a device need not have
const double kRoom = 1e-9lf;
const double kGuard = 1e-6lf;

layout(buffer_reference, scalar) readonly buffer Lights { CastLight at[]; };
layout(buffer_reference, scalar) readonly buffer Planes { CastPlane at[]; };
layout(buffer_reference, scalar) readonly buffer Words { uint at[]; };
layout(buffer_reference, scalar) readonly buffer Floats { float at[]; };
layout(buffer_reference, scalar) readonly buffer PlainPieces { PlainPiece at[]; };
layout(buffer_reference, scalar) buffer Status {
    uint unfinished;
    uint most_layers;
};

uint invocation_number() {
    return (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x +
           gl_LocalInvocationID.x;
}

bool uses(PlainGrid g, uint interpolation) {
    uint bit = 1u << interpolation;
    return kInterpolations == bit || ((kInterpolations & bit) != 0u && g.interpolation == interpolation);
}

bool is_number(float v) { return !kHoles || (floatBitsToUint(v) & ~kSignBit) <= kInfinityBits; }

// ---- Samples

struct Sampled {
    double value;
    bool number;
};

Vec3d clamped_index(PlainGrid g, Vec3d from, Vec3d along, double t) {
    Vec3d p = along3d(from, t, along);
    return Vec3d(clamp(p.x, 0.0lf, g.place.last.x), clamp(p.y, 0.0lf, g.place.last.y),
                 clamp(p.z, 0.0lf, g.place.last.z));
}

// First sample of a cell, and the place in it.
struct CellPlace {
    uint first;  // of the samples that count
    uint row;
    uint slice;
    dvec3 at;
};
CellPlace cell_place(PlainGrid g, Vec3d p) {
    int i = clamp(int(floor(p.x)), 0, max(0, g.size_x - 2));
    int j = clamp(int(floor(p.y)), 0, max(0, g.size_y - 2));
    int k = clamp(int(floor(p.z)), 0, max(0, g.size_z - 2));
    uint more = uses(g, kCatmullRom) ? 2u : 0u;
    CellPlace c;
    c.row = uint(g.size_x) + more;
    c.slice = c.row * (uint(g.size_y) + more);
    c.first = uint(i) + uint(j) * c.row + uint(k) * c.slice;
    precise dvec3 at = dvec3(p.x - double(i), p.y - double(j), p.z - double(k));
    c.at = at;
    return c;
}

struct Corners {
    double v[8];  // x fastest
    bool number;
};
Corners corners_at(PlainGrid g, CellPlace c) {
    Floats samples = Floats(g.samples);
    Corners out_corners;
    out_corners.number = true;
    for (uint i = 0u; i < 8u; ++i) {
        float v = samples.at[c.first + (i & 1u) + (i >> 1 & 1u) * c.row + (i >> 2) * c.slice];
        out_corners.number = out_corners.number && is_number(v);
        out_corners.v[i] = double(v);
    }
    return out_corners;
}

// As CatmullRomWeights.
dvec4 spline_value(double t) {
    precise dvec4 w = dvec4(t * (-0.5lf + t * (1.0lf - 0.5lf * t)), 1.0lf + t * t * (-2.5lf + 1.5lf * t),
                            t * (0.5lf + t * (2.0lf - 1.5lf * t)), t * t * (-0.5lf + 0.5lf * t));
    return w;
}
dvec4 spline_slope(double t) {
    precise dvec4 w = dvec4(-0.5lf + t * (2.0lf - 1.5lf * t), t * (-5.0lf + 4.5lf * t),
                            0.5lf + t * (4.0lf - 4.5lf * t), t * (-1.0lf + 1.5lf * t));
    return w;
}
double weighted(dvec4 weights, dvec4 v) {
    precise double r = weights.x * v.x + weights.y * v.y + weights.z * v.z + weights.w * v.w;
    return r;
}
// Four samples of a row, less a number.
dvec4 samples_of_row(Floats samples, uint n, double less, inout bool number) {
    float a = samples.at[n], b = samples.at[n + 1u], c = samples.at[n + 2u], d = samples.at[n + 3u];
    number = number && is_number(a) && is_number(b) && is_number(c) && is_number(d);
    precise dvec4 row = dvec4(double(a) - less, double(b) - less, double(c) - less, double(d) - less);
    return row;
}
Sampled spline_at(PlainGrid g, CellPlace c, double less) {
    Floats samples = Floats(g.samples);
    dvec4 y = spline_value(c.at.y), z = spline_value(c.at.z);
    bool number = true;
    precise dvec4 sum = dvec4(0.0lf);
    for (uint k = 0u; k < 4u; ++k) {
        precise dvec4 slice = dvec4(0.0lf);
        for (uint j = 0u; j < 4u; ++j)
            slice += y[j] * samples_of_row(samples, c.first + j * c.row + k * c.slice, less, number);
        sum += z[k] * slice;
    }
    return Sampled(weighted(spline_value(c.at.x), sum), number);
}
struct Gradient {
    Vec3d value;
    bool number;
};
Gradient spline_gradient(PlainGrid g, CellPlace c, double less) {
    Floats samples = Floats(g.samples);
    dvec4 y = spline_value(c.at.y), y_slope = spline_slope(c.at.y);
    dvec4 z = spline_value(c.at.z), z_slope = spline_slope(c.at.z);
    bool number = true;
    precise dvec4 sum = dvec4(0.0lf), sum_y = dvec4(0.0lf), sum_z = dvec4(0.0lf);
    for (uint k = 0u; k < 4u; ++k) {
        precise dvec4 slice = dvec4(0.0lf), slice_y = dvec4(0.0lf);
        for (uint j = 0u; j < 4u; ++j) {
            dvec4 row = samples_of_row(samples, c.first + j * c.row + k * c.slice, less, number);
            slice += y[j] * row;
            slice_y += y_slope[j] * row;
        }
        sum += z[k] * slice;
        sum_y += z[k] * slice_y;
        sum_z += z_slope[k] * slice;
    }
    dvec4 x = spline_value(c.at.x);
    return Gradient(Vec3d(weighted(spline_slope(c.at.x), sum), weighted(x, sum_y), weighted(x, sum_z)),
                    number);
}

// ---- Empty space

// As EmptySpace::empty_until; `p` in cells.
double empty_until(PlainGrid g, Vec3d from, Vec3d along, double t) {
    if (g.blocks_x == 0) return t;
    if (g.anything == 0u) return kFar;
    precise dvec3 p = dvec3(from.x + t * along.x, from.y + t * along.y, from.z + t * along.z);
    ivec3 blocks = ivec3(g.blocks_x, g.blocks_y, g.blocks_z);
    ivec3 block = ivec3(clamp(floor(p / 8.0lf), dvec3(0.0lf), dvec3(blocks - 1)));
    uint n = uint(block.x + blocks.x * (block.y + blocks.y * block.z));
    int away = int((Words(g.distance).at[n >> 2] >> (8u * (n & 3u))) & 255u);
    if (away == 0) return t;
    dvec3 f = dvec3(from.x, from.y, from.z), d = dvec3(along.x, along.y, along.z);
    double end = kFar;
    for (int axis = 0; axis < 3; ++axis) {
        int face = d[axis] > 0.0lf ? block[axis] + away : block[axis] - away + 1;
        precise double meet = (double(8 * face) - f[axis]) / d[axis];
        if (d[axis] != 0.0lf) end = min(end, meet);
    }
    return max(t, end);
}
int64_t sample_after_skip(int64_t k, double end, double dt) {
    precise double at = end / dt - kGuard;
    return max(k, int64_t(floor(at)));
}

// ---- A ray on the grid of its steps

struct PlainRay {
    RayD ray;
    double dt;
    double ray_length;
    Vec3d from;
    Vec3d along;
    SpanD span;
};
PlainRay plain_ray(CastCamera camera, PlainGrid g, ivec2 pixel, uint part, bool clipped) {
    PlainRay r;
    r.ray = camera_ray(camera, ray_position(pixel.x, part % camera.rays, camera.rays),
                       ray_position(pixel.y, part / camera.rays, camera.rays));
    r.ray_length = length3d(r.ray.direction);
    precise double dt = camera.step / r.ray_length;
    r.dt = dt;
    r.from = place_point(g.place, r.ray.origin);
    r.along = place_vector(g.place, r.ray.direction);
    r.span = span_in_box(SpanD(camera.near, camera.far), r.from, r.along, g.place.last);
    Planes planes = Planes(g.planes);
    if (clipped)
        for (uint i = 0u; i < g.plane_count; ++i) r.span = span_clipped(r.span, r.ray, planes.at[i]);
    return r;
}

// ---- Light

Vec3d normalised(Vec3d v) {
    precise double over_size = 1.0lf / sqrt(dot3d(v, v));
    return scaled3d(over_size, v);
}
Vec3f narrowed(Vec3d v) { return Vec3f(float(v.x), float(v.y), float(v.z)); }

Vec3d carried_normal(PlainGrid g, Vec3d n) {
    return Vec3d(mapped_d(g.cofactor0.x, g.cofactor1.x, g.cofactor2.x, n),
                 mapped_d(g.cofactor0.y, g.cofactor1.y, g.cofactor2.y, n),
                 mapped_d(g.cofactor0.z, g.cofactor1.z, g.cofactor2.z, n));
}

// Blinn-Phong, as scene/shading.cpp: float32 from unit vectors on.
Vec3d shaded(CastCamera camera, Lights lights, PlainGrid g, Vec3d color, Vec3d world, Vec3d normal) {
    Vec3d to_eye = camera.perspective != 0u ? along3d(world, -1.0lf, camera.eye) : camera.forward;
    Vec3d forward = normalised(to_eye);
    Vec3f viewer = narrowed(Vec3d(-forward.x, -forward.y, -forward.z));
    Vec3f n = turned_to(narrowed(normalised(normal)), viewer);
    LightSums sums = LightSums(0.0, 0.0);
    for (uint i = 0u; i < kLights; ++i) {
        CastLight light = lights.at[i];
        Vec3f l = light.headlight != 0u ? viewer : light.direction;
        if (kGlossy)
            sums = add_light(sums, n, viewer, l, light.intensity, g.shininess);
        else
            sums.diffuse = add_diffuse(sums.diffuse, n, l, light.intensity);
    }
    return Vec3d(double(shaded_channel(float(color.x), sums, g.ambient, g.diffuse, g.specular)),
                 double(shaded_channel(float(color.y), sums, g.ambient, g.diffuse, g.specular)),
                 double(shaded_channel(float(color.z), sums, g.ambient, g.diffuse, g.specular)));
}

Slab slab_between(double begin, double end, double opacity, Vec3d color) {
    float z = float(end);
    precise float d = z - float(begin);
    return Slab(z, d, float(color.x), float(color.y), float(color.z), float(opacity));
}
