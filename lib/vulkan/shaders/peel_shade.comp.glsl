// One invocation is one pixel after a pass (in software, several of them: workgroups are dear there): it takes the pixel's
// slots in their order, shades each once, and either stores the slabs (targets) or adds them to the pixel's colour. No two
// invocations share anything but the flags.
// Shading is that of cpu/depth_peeling.cpp: geometry in double, light by kernel/shading_twin.h.
#version 460
#include "vulkan/shaders/peeling.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint kOutput = 0;
layout(constant_id = 2) const uint kPixelsEach = 1;
layout(constant_id = 3) const uint kPerspective = 1;
// Whether any object of the scene needs it: software runs through all branches, with nobody in them.
layout(constant_id = 4) const uint kThickness = 1;
layout(constant_id = 5) const uint kPainted = 1;
layout(constant_id = 6) const uint kSmooth = 1;
layout(constant_id = 7) const uint kLit = 1;

const uint kTargets = 0;  // slabs into targets
const uint kMixed = 1;    // into a colour; fragments at one depth are mixed by (4.4)
const uint kBlended = 2;  // into a colour, one over the other

layout(push_constant, scalar) uniform Push { PeelShadePush push; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Setup { PeelSetup setup; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Indices { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Lights { PeelLight at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) writeonly buffer Slabs { Slab at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) writeonly buffer Numbers { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Colors { PeelColor at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Flags { PeelFlags flags; };

// 1 - e^-t for t >= 0 to the last bits of a double: t = n·ln 2 + r, and 1 - 2^-n·e^-r = (1 - 2^-n) - 2^-n·(e^-r - 1).
double one_minus_exp(double t) {
    if (t > 45.0lf) return 1.0lf;
    int n = int(t * 1.4426950408889634lf + 0.5lf);
    precise double r = (double(n) * 0.6931471803691238lf - t) + double(n) * 1.9082149292705877e-10lf;  // -r, |r| <= 0.35
    precise double e = 1.0lf / 6227020800.0lf;
    e = e * r + 1.0lf / 479001600.0lf;
    e = e * r + 1.0lf / 39916800.0lf;
    e = e * r + 1.0lf / 3628800.0lf;
    e = e * r + 1.0lf / 362880.0lf;
    e = e * r + 1.0lf / 40320.0lf;
    e = e * r + 1.0lf / 5040.0lf;
    e = e * r + 1.0lf / 720.0lf;
    e = e * r + 1.0lf / 120.0lf;
    e = e * r + 1.0lf / 24.0lf;
    e = e * r + 1.0lf / 6.0lf;
    e = e * r + 0.5lf;
    precise double grown = r + r * r * e;  // e^r - 1
    double scale = packDouble2x32(uvec2(0u, uint(1023 - n) << 20u));
    precise double result = (1.0lf - scale) - scale * grown;
    return result;
}

double size3d(Vec3d v) { return sqrt(dot3d(v, v)); }

Vec3d vertex(uint64_t list, uint i) {
    Doubles d = Doubles(list);
    return vec3d(d.at[3 * i], d.at[3 * i + 1], d.at[3 * i + 2]);
}

Vec3f shaded(PeelSetup s, PeelObject o, Vec3d ray, double ray_size, Vec3d normal) {
    Vec3f color = Vec3f(float(o.color.x), float(o.color.y), float(o.color.z));
    precise double over = 1.0lf / sqrt(dot3d(normal, normal));
    Vec3f v = Vec3f(float(-ray.x / ray_size), float(-ray.y / ray_size), float(-ray.z / ray_size));
    Vec3f n = turned_to(Vec3f(float(normal.x * over), float(normal.y * over), float(normal.z * over)), v);
    LightSums sums;
    sums.diffuse = 0.0;
    sums.specular = 0.0;
    for (uint i = 0; i < s.light_count; ++i) {
        PeelLight light = Lights(s.lights).at[i];
        Vec3f l = light.direction;
        if (light.headlight != 0) l = v;
        if (o.specular == 0.0) sums.diffuse = add_diffuse(sums.diffuse, n, l, light.intensity);
        else sums = add_light(sums, n, v, l, light.intensity, o.shininess);
    }
    return Vec3f(shaded_channel(color.x, sums, o.ambient, o.diffuse, o.specular),
                 shaded_channel(color.y, sums, o.ambient, o.diffuse, o.specular),
                 shaded_channel(color.z, sums, o.ambient, o.diffuse, o.specular));
}

double thickness_by_pixel(PeelSetup s, Vec3d world, Vec3d geometric) {
    Vec3d from = minus3d(world, push.rays.eye);
    Vec3d view = vec3d(dot3d(push.rays.axis_x, from), dot3d(push.rays.axis_y, from), dot3d(push.rays.axis_z, from));
    Vec3d normal = vec3d(dot3d(push.rays.axis_x, geometric), dot3d(push.rays.axis_y, geometric),
                         dot3d(push.rays.axis_z, geometric));
    Vec3d ray = kPerspective != 0u ? view : vec3d(0.0lf, 0.0lf, 1.0lf);
    precise double side = push.rays.pixel_size * (kPerspective != 0u ? view.z : 1.0lf);
    precise double stretch = size3d(normal) * size3d(ray) / abs(dot3d(normal, ray));
    precise double d = 0.5lf * side * (stretch < 8.0lf ? stretch : 8.0lf);  // kMostStretch
    return d;
}

Slab shade_fragment(PeelSetup s, PeelPart part, uint part_number, int x, int y) {
    PeelObject o = Objects(s.objects).at[part.object & ~kPeelJudged];
    if (kPainted != 0u && (o.flags & kPeelPainted) != 0) {
        uint at = uint(y - o.painted_y) * uint(o.painted_width) + uint(x - o.painted_x);
        return Painted(o.painted).at[at].slab;
    }
    double z = plane_depth(push.rays.center_x, push.rays.center_y, Planes(s.planes).at[part_number], x, y);
    Ray ray = pixel_ray(push.rays, kPerspective != 0u, x, y);
    Vec3d world = along(ray, z);
    uint t = part.triangle - o.first_triangle;
    Indices indices = Indices(o.triangles);
    uint i = indices.at[3 * t];
    uint j = indices.at[3 * t + 1];
    uint k = indices.at[3 * t + 2];
    Vec3d a = vertex(o.positions, i);
    Vec3d ab = minus3d(vertex(o.positions, j), a);
    Vec3d ac = minus3d(vertex(o.positions, k), a);
    Vec3d facet = cross3d(ab, ac);

    // Of the vertices, interpolated on the facet; the facet's where they cancel.
    Vec3d smooth_normal = facet;
    if (kSmooth != 0u && (o.flags & kPeelSmooth) != 0) {
        Vec3d from = minus3d(world, a);
        double area2 = dot3d(facet, facet);
        precise double v1 = dot3d(cross3d(from, ac), facet) / area2;
        precise double v2 = dot3d(cross3d(ab, from), facet) / area2;
        precise double v0 = 1.0lf - v1 - v2;
        Vec3d n0 = vertex(o.normals, i);
        Vec3d n1 = vertex(o.normals, j);
        Vec3d n2 = vertex(o.normals, k);
        precise double nx = v0 * n0.x + v1 * n1.x + v2 * n2.x;
        precise double ny = v0 * n0.y + v1 * n1.y + v2 * n2.y;
        precise double nz = v0 * n0.z + v1 * n1.z + v2 * n2.z;
        Vec3d normal = vec3d(nx, ny, nz);
        if (dot3d(normal, normal) > 0.0lf) smooth_normal = normal;
    }
    Vec3d geometric = facet;
    if ((o.flags & kPeelOfField) != 0) geometric = smooth_normal;

    double ray_size = size3d(ray.direction);
    double alpha = o.opacity;
    if ((o.flags & kPeelOblique) != 0 && alpha != 1.0lf) {
        precise double cosine = abs(dot3d(geometric, ray.direction)) / (size3d(geometric) * ray_size);
        alpha = one_minus_exp(o.optical_depth / (cosine > 1e-12lf ? min(cosine, 1.0lf) : 1e-12lf));
    }
    Vec3d color = o.color;
    if (kLit != 0u && (o.flags & kPeelFlat) == 0) {
        Vec3f lit = shaded(s, o, ray.direction, ray_size, smooth_normal);
        color = vec3d(double(lit.x), double(lit.y), double(lit.z));
    }
    double thickness = 0.0lf;
    if (kThickness != 0u) {
        thickness = o.thickness >= 0.0lf ? o.thickness : thickness_by_pixel(s, world, geometric);
        if (thickness > z) thickness = z > 0.0lf ? z : 0.0lf;  // what lies before the eye's plane
    }
    Slab slab;
    slab.z = float(z);
    slab.d = float(thickness);
    slab.r = float(alpha * color.x);
    slab.g = float(alpha * color.y);
    slab.b = float(alpha * color.z);
    slab.a = float(alpha);
    return slab;
}

// Fragments at one depth: what each keeps of its colour is the integral of the product of 1 - u·α over the others, u in
// [0, 1]; (4.4) of two. By Gauss and Legendre with 8 nodes u, exact for 16 fragments; of 40 opaque ones a weight is off by
// 1 in 250. At every node the product of all so far, and the sum of each one's colour times the product of the others.
const uint kNodes = 8;
const float kNode[kNodes] = float[](0.019855072, 0.101666761, 0.237233795, 0.408282679, 0.591717321, 0.762766205,
                                             0.898333239, 0.980144928);
const float kWeight[kNodes] = float[](0.050614268, 0.111190517, 0.156853323, 0.181341892, 0.181341892, 0.156853323,
                                               0.111190517, 0.050614268);

struct Group {
    Slab first;
    uint count;
    double passes;  // product of 1 - opacity
    float product[kNodes];
    float r[kNodes];
    float g[kNodes];
    float b[kNodes];
};

Group joined(Group group, Slab slab) {
    if (group.count == 0) {
        group.first = slab;
        group.passes = 1.0lf;
    }
    ++group.count;
    group.passes *= 1.0lf - double(slab.a);
    if (kOutput != kMixed) return group;
    for (uint i = 0; i < kNodes; ++i) {
        float passes = 1.0 - kNode[i] * slab.a;
        bool first = group.count == 1;
        group.r[i] = first ? slab.r : group.r[i] * passes + slab.r * group.product[i];
        group.g[i] = first ? slab.g : group.g[i] * passes + slab.g * group.product[i];
        group.b[i] = first ? slab.b : group.b[i] * passes + slab.b * group.product[i];
        group.product[i] = first ? passes : group.product[i] * passes;
    }
    return group;
}

PeelColor add_group(PeelColor sum, Group group) {
    float r = group.first.r;
    float g = group.first.g;
    float b = group.first.b;
    if (kOutput == kMixed && group.count > 1) {
        r = 0.0;
        g = 0.0;
        b = 0.0;
        for (uint i = 0; i < kNodes; ++i) {
            r += kWeight[i] * group.r[i];
            g += kWeight[i] * group.g[i];
            b += kWeight[i] * group.b[i];
        }
    }
    if (sum.count == 0) {
        sum.clear = 1.0lf;
        sum.z = group.first.z;
    }
    sum.z = min(sum.z, group.first.z);
    sum.r += sum.clear * double(r);
    sum.g += sum.clear * double(g);
    sum.b += sum.clear * double(b);
    sum.clear *= group.passes;
    sum.count += group.count;
    return sum;
}

void take_pixel(PeelSetup s, uint pixels, uint pixel) {
    uint64_t slot = s.slots + 8ul * pixel;
    uint64_t place = Place(slot).value;
    if (place == kNoPlace) {
        if (kOutput == kTargets) Numbers(s.counts).at[pixel] = 0;
        return;
    }
    int row = int(pixel / uint(s.width));
    int x = int(pixel) - row * s.width;
    int y = s.first_row + row;
    PeelPixel state = Pixels(s.pixels).at[pixel];
    if (state.count == 0) {
        state.clear = 1.0lf;
        state.most = 0xffffffffu;
    }
    PeelPixel before_group = state;
    PeelColor sum;
    if (kOutput != kTargets) sum = Colors(s.colors).at[pixel];
    Group group;
    group.count = 0;
    uint taken = 0;
    bool wanted = true;
    for (uint i = 0; i < s.slot_count; ++i) {
        if (i > 0) {
            slot += 8ul * pixels;
            place = Place(slot).value;
            if (place == kNoPlace) break;
        }
        Place(slot).value = kNoPlace;
        uint first = uint(place >> 32u);
        wanted = wanted && state.count < s.most_layers && first <= state.most;
        if (!wanted) continue;
        uint part_number = uint(place & 0xfffffffful);
        PeelPart part = Parts(s.parts).at[part_number];
        Slab slab = shade_fragment(s, part, part_number, x, y);
        if (kOutput == kTargets) {
            uint64_t target = uint64_t(taken) * uint64_t(pixels) + uint64_t(pixel);
            Slabs(s.slabs + 24ul * target).at[0] = slab;
            Numbers(s.numbers + 4ul * target).at[0] = part.triangle;
        } else {
            if (group.count > 0 && (kOutput == kBlended || group.first.z != slab.z)) {
                sum = add_group(sum, group);
                group.count = 0;
                before_group = state;
            }
            group = joined(group, slab);
        }
        ++taken;
        state.from = place + 1ul;
        state.count += 1u;
        precise double clear = state.clear * (1.0lf - double(slab.a));
        state.clear = clear;
        if (clear <= s.most_clear) state.most = first;
    }
    bool more = wanted && taken == s.slot_count && state.count < s.most_layers;
    if (kOutput == kMixed && more) {
        // More may come at the depth of the last ones: these come again in the next pass.
        state = before_group;
        if (group.count == s.slot_count) Flags(s.flags).flags.stuck = 1u;
    } else if (kOutput != kTargets && group.count > 0) {
        sum = add_group(sum, group);
    }
    if (!more) state.from = kNoPlace;  // finished
    if (more) Flags(s.flags).flags.more = 1u;
    Pixels(s.pixels).at[pixel] = state;
    if (kOutput == kTargets) {
        Numbers(s.counts).at[pixel] = taken;
        if (taken == 0) return;
        Flags flags = Flags(s.flags);
        atomicAdd(flags.flags.found, taken);
        if (state.count == taken) atomicAdd(flags.flags.pixels, 1u);
        atomicMax(flags.flags.layers, state.count);
    } else {
        Colors(s.colors).at[pixel] = sum;
    }
}

void main() {
    PeelSetup s = Setup(push.setup).setup;
    uint pixels = uint(s.width) * uint(s.rows);
    uint group = gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y;
    for (uint i = 0; i < kPixelsEach; ++i) {
        uint pixel = (group * kPixelsEach + i) * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
        if (pixel < pixels) take_pixel(s, pixels, pixel);
    }
}
