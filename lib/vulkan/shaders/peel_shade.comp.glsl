// One invocation is one pixel after a pass (in software, several of them: workgroups are dear there): it takes the pixel's
// slots in their order, shades each once, and either stores the slabs (targets) or adds them to the pixel's colour. No two
// invocations share anything but the flags.
// Shading is that of cpu/depth_peeling.cpp: geometry in double, light by kernel/shading_twin.h.
#version 460
#include "vulkan/shaders/peeling.glsl"

layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint kSlots = 4;
layout(constant_id = 2) const uint kOutput = 0;
layout(constant_id = 3) const uint kPixelsEach = 1;

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
    Vec3d normal = vec3d(dot3d(push.rays.axis_x, geometric), dot3d(push.rays.axis_y, geometric), dot3d(push.rays.axis_z, geometric));
    Vec3d ray = s.perspective != 0 ? view : vec3d(0.0lf, 0.0lf, 1.0lf);
    precise double side = push.rays.pixel_size * (s.perspective != 0 ? view.z : 1.0lf);
    precise double stretch = size3d(normal) * size3d(ray) / abs(dot3d(normal, ray));
    precise double d = 0.5lf * side * (stretch < 8.0lf ? stretch : 8.0lf);  // kMostStretch
    return d;
}

Slab shade_fragment(PeelSetup s, PeelPart part, uint part_number, int x, int y) {
    PeelObject o = Objects(s.objects).at[part.object & ~kPeelAsks];
    if ((o.flags & kPeelPainted) != 0) {
        uint at = uint(y - o.painted_y) * uint(o.painted_width) + uint(x - o.painted_x);
        return Painted(o.painted).at[at].slab;
    }
    double z = plane_depth(push.rays.center_x, push.rays.center_y, Planes(s.planes).at[part_number], x, y);
    Ray ray = pixel_ray(push.rays, s.perspective, x, y);
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
    if ((o.flags & kPeelSmooth) != 0) {
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
    if ((o.flags & kPeelFlat) == 0) {
        Vec3f lit = shaded(s, o, ray.direction, ray_size, smooth_normal);
        color = vec3d(double(lit.x), double(lit.y), double(lit.z));
    }
    double thickness = 0.0lf;
    if (s.with_thickness != 0) thickness = o.thickness >= 0.0lf ? o.thickness : thickness_by_pixel(s, world, geometric);
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
// [0, 1]; (4.4) of two. By Gauss and Legendre with 8 nodes, exact for 16 fragments; more have as many pieces.
const double kNode[4] = double[](0.1834346424956498lf, 0.5255324099163290lf, 0.7966664774136267lf, 0.9602898564975363lf);
const double kWeight[4] = double[](0.3626837833783620lf, 0.3137066458778873lf, 0.2223810344533745lf, 0.1012285362903763lf);

PeelColor add_group(PeelColor sum, Slab only, Slab together[kSlots], uint count) {
    double r = double(only.r);
    double g = double(only.g);
    double b = double(only.b);
    double passes = 1.0lf - double(only.a);
    if (count > 1) {
        r = 0.0lf;
        g = 0.0lf;
        b = 0.0lf;
        passes = 1.0lf;
        uint pieces = (count + 15) / 16;
        for (uint node = 0; node < 8 * pieces; ++node) {
            double aside = kNode[node % 4] * (node % 8 < 4 ? 1.0lf : -1.0lf);
            double u = (double(node / 8) + 0.5lf + 0.5lf * aside) / double(pieces);
            double all = 0.5lf * kWeight[node % 4] / double(pieces);
            for (uint k = 0; k < count; ++k) all *= 1.0lf - u * double(together[k].a);
            for (uint k = 0; k < count; ++k) {
                double others = all / (1.0lf - u * double(together[k].a));
                r += others * double(together[k].r);
                g += others * double(together[k].g);
                b += others * double(together[k].b);
            }
        }
        for (uint k = 0; k < count; ++k) passes *= 1.0lf - double(together[k].a);
    }
    if (sum.count == 0) {
        sum.clear = 1.0lf;
        sum.z = only.z;
    }
    sum.z = min(sum.z, only.z);
    sum.r += sum.clear * r;
    sum.g += sum.clear * g;
    sum.b += sum.clear * b;
    sum.clear *= passes;
    sum.count += count;
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
    Slab only;
    Slab together[kSlots];  // fragments at one depth, where there is more than one
    uint gathered = 0;
    uint taken = 0;
    bool wanted = true;
    for (uint i = 0; i < kSlots; ++i) {
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
            if (gathered > 0 && (kOutput == kBlended || only.z != slab.z)) {
                sum = add_group(sum, only, together, gathered);
                gathered = 0;
                before_group = state;
            }
            if (kOutput == kMixed && gathered > 0) {
                if (gathered == 1) together[0] = only;
                together[gathered] = slab;
            }
            if (gathered == 0) only = slab;
            ++gathered;
        }
        ++taken;
        state.from = place + 1ul;
        state.count += 1u;
        precise double clear = state.clear * (1.0lf - double(slab.a));
        state.clear = clear;
        if (clear <= s.most_clear) state.most = first;
    }
    bool more = wanted && taken == kSlots && state.count < s.most_layers;
    if (kOutput == kMixed && more) {
        // More may come at the depth of the last ones: these come again in the next pass.
        state = before_group;
        if (gathered == kSlots) Flags(s.flags).flags.stuck = 1u;
    } else if (kOutput != kTargets && gathered > 0) {
        sum = add_group(sum, only, together, gathered);
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
