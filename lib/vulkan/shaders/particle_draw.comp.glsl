// STEP 2 of PBSR: projection with occlusion, shading of the winners, sums over the repeats.
//
// A workgroup is one item: some repeats of one tile. It reads particles, spans, runs; writes `pixels` (who won
// which pixel) and the keys and sums of its own slot, which no other workgroup touches. Keys are all ones before
// and after. Within a repeat one invocation at most wins a pixel, so sums need no atomics.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_shader_atomic_int64 : require
#include "kernel/particle_draw_twin.h"

layout(local_size_x_id = 0) in;
layout(constant_id = 1) const bool kShaded = true;

layout(buffer_reference, scalar) readonly buffer Setup { DrawSetup it; };
layout(buffer_reference, scalar) readonly buffer Particles { Particle at[]; };
layout(buffer_reference, scalar) readonly buffer Runs { DrawRun at[]; };
layout(buffer_reference, scalar) readonly buffer Spans { DrawSpan at[]; };
layout(buffer_reference, scalar) readonly buffer Items { DrawItem at[]; };
layout(buffer_reference, scalar) readonly buffer Materials { Material at[]; };
layout(buffer_reference, scalar) readonly buffer Lights { ViewLight at[]; };
layout(buffer_reference, scalar) readonly buffer Texels { Vec3f at[]; };
layout(buffer_reference, scalar) buffer Pixels { uint at[]; };
layout(buffer_reference, scalar) coherent buffer Keys { uint64_t at[]; };
layout(buffer_reference, scalar) buffer Sums { PixelSums at[]; };
layout(push_constant, scalar) uniform Push {
    Setup setup;
    uint item_count;
    uint first_item;
};

Vec3f texture_color(Material m, Particle q) {
    Texels texels = Texels(setup.it.texels);
    TexelPlace p = texel_place(m, q);
    int top = m.first_texel + p.top * m.texture_width;
    int bottom = m.first_texel + p.bottom * m.texture_width;
    Vec3f a = texels.at[top + p.left];
    Vec3f b = texels.at[top + p.right];
    Vec3f c = texels.at[bottom + p.left];
    Vec3f d = texels.at[bottom + p.right];
    return Vec3f(mix_texels(p, a.x, b.x, c.x, d.x), mix_texels(p, a.y, b.y, c.y, d.y), mix_texels(p, a.z, b.z, c.z, d.z));
}

ColorUnits shade_particle(Material m, Particle q) {
    ShadingView view = setup.it.view;
    Lights lights = Lights(setup.it.lights);
    Vec3f to_viewer = direction_to_viewer(view, q);
    Vec3f normal = turned_to(unpack_normal(q.normal), to_viewer);
    LightSums sums = LightSums(0.0, 0.0);
    for (int i = 0; i < view.light_count; ++i) {
        ViewLight light = lights.at[i];
        Vec3f to_light = light.direction;
        if (light.headlight != 0) to_light = to_viewer;
        sums = add_light(sums, normal, to_viewer, to_light, light.intensity, m.shininess);
    }
    Vec3f color = Vec3f(m.red, m.green, m.blue);
    if (m.texture_width > 0) color = texture_color(m, q);
    return color_units(m, sums, color.x, color.y, color.z, view.units);
}

uint object_of(DrawSpan span, uint particle) {
    Runs runs = Runs(setup.it.runs);
    uint lo = span.first_run;
    uint hi = span.end_run;
    while (hi - lo > 1u) {
        uint middle = (lo + hi) >> 1u;
        if (runs.at[middle].first <= particle) {
            lo = middle;
        } else {
            hi = middle;
        }
    }
    return runs.at[lo].object;
}

void add(uint place, Particle q, ColorUnits c) {
    Sums sums = Sums(setup.it.sums);
    PixelSums s = sums.at[place];
    s.red += uint64_t(c.red);
    s.green += uint64_t(c.green);
    s.blue += uint64_t(c.blue);
    s.red_square += uint64_t(c.red) * uint64_t(c.red);
    s.green_square += uint64_t(c.green) * uint64_t(c.green);
    s.blue_square += uint64_t(c.blue) * uint64_t(c.blue);
    s.covered += 1u;
    s.nearness = max(s.nearness, ~floatBitsToUint(q.above_near));
    sums.at[place] = s;
}

void main() {
    uint number = gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y;
    if (number >= item_count) return;
    DrawItem item = Items(setup.it.items).at[first_item + number];
    Particles particles = Particles(setup.it.particles);
    Pixels pixels = Pixels(setup.it.pixels);
    Keys keys = Keys(setup.it.keys);
    Projection projection = setup.it.projection;
    uint base = item.slot * uint(kTilePixels);
    uint lane = gl_LocalInvocationID.x;
    uint lanes = gl_WorkGroupSize.x;
    for (uint s = item.first_span; s < item.end_span; ++s) {
        DrawSpan span = Spans(setup.it.spans).at[s];
        // Nearest wins.
        for (uint i = lane; i < span.count; i += lanes) {
            Particle q = particles.at[span.first + i];
            PixelDepth at = project_quickly(projection, q);
            uint pixel = uint(((at.row & (kTileSide - 1)) << kTileShift) | (at.column & (kTileSide - 1)));
            pixels.at[span.first + i] = pixel;
            atomicMin(keys.at[base + pixel], particle_key(q, span.index + i));
        }
        memoryBarrierBuffer();
        barrier();
        // Winners are shaded and added.
        for (uint i = lane; i < span.count; i += lanes) {
            Particle q = particles.at[span.first + i];
            uint pixel = pixels.at[span.first + i];
            bool won = keys.at[base + pixel] == particle_key(q, span.index + i);
            if (!won) pixels.at[span.first + i] = kNoTilePixel;
            if (won && kShaded) {
                Material m = Materials(setup.it.materials).at[object_of(span, span.first + i)];
                add(base + pixel, q, shade_particle(m, q));
            }
        }
        memoryBarrierBuffer();
        barrier();
        // All ones again.
        for (uint i = lane; i < span.count; i += lanes) {
            uint pixel = pixels.at[span.first + i];
            if (pixel != kNoTilePixel) keys.at[base + pixel] = ~uint64_t(0);
        }
        memoryBarrierBuffer();
        barrier();
    }
}
