// STEP 2 of PBSR: projection with occlusion, shading of the winners, sums over the repeats.
//
// A workgroup is one item: some repeats of one tile. It reads particles, spans, runs; writes the keys and
// sums of its own slot, which no other workgroup touches, and `pixels` (who won which pixel) where colours are
// not asked for. Keys are all ones before and after. Within a repeat one invocation at most wins a pixel, so sums
// need no atomics; a winner may clear its key at once, since no other particle's key could have been equal.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_shader_atomic_int64 : require
#extension GL_KHR_shader_subgroup_basic : require
#include "kernel/particle_draw_twin.h"

layout(local_size_x_id = 0) in;
// What a scene does not need is not there: in software a branch that nobody takes is still run through.
layout(constant_id = 1) const bool kShaded = true;
layout(constant_id = 2) const bool kTextured = true;
layout(constant_id = 3) const int kLights = 1;
layout(constant_id = 4) const bool kByDivision = false;  // float32 cannot find the quotient of the projection
layout(constant_id = 5) const bool kOneSubgroup = false;  // the workgroup is no more

layout(buffer_reference, scalar) readonly buffer Setup { DrawSetup it; };
layout(buffer_reference, scalar) readonly buffer Particles { u64vec2 at[]; };  // two loads, not four
layout(buffer_reference, scalar) readonly buffer Runs { DrawRun at[]; };
layout(buffer_reference, scalar) readonly buffer Spans { DrawSpan at[]; };
layout(buffer_reference, scalar) readonly buffer Items { DrawItem at[]; };
layout(buffer_reference, scalar) readonly buffer Materials { Material at[]; };
layout(buffer_reference, scalar) readonly buffer Lights { ViewLight at[]; };
layout(buffer_reference, scalar) readonly buffer Texels { Vec3f at[]; };
layout(buffer_reference, scalar) buffer Pixels { uint at[]; };
layout(buffer_reference, scalar) coherent buffer Keys { uint64_t at[]; };
layout(buffer_reference, scalar) coherent buffer Sums { PackedSums at[]; };
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
    return Vec3f(mix_texels(p, a.x, b.x, c.x, d.x), mix_texels(p, a.y, b.y, c.y, d.y),
                 mix_texels(p, a.z, b.z, c.z, d.z));
}

struct Lighting {
    ShadingView view;
    ViewLight first;     // in registers: most scenes have no more
    ViewLight second;
};

LightSums add_view_light(LightSums sums, ViewLight light, Vec3f normal, Vec3f to_viewer, float shininess) {
    Vec3f l;
    l.x = light.headlight != 0 ? to_viewer.x : light.direction.x;
    l.y = light.headlight != 0 ? to_viewer.y : light.direction.y;
    l.z = light.headlight != 0 ? to_viewer.z : light.direction.z;
    return add_light(sums, normal, to_viewer, l, light.intensity, shininess);
}

ColorUnits shade_particle(Lighting lighting, Material m, Particle q) {
    ShadingView view = lighting.view;
    LightSums sums = LightSums(0.0, 0.0);
    if (m.flat_colored == 0) {
        Vec3f to_viewer = direction_to_viewer(view, q);
        Vec3f normal = turned_to(unpack_normal(q.normal), to_viewer);
        sums = add_view_light(sums, lighting.first, normal, to_viewer, m.shininess);
        if (kLights > 1) sums = add_view_light(sums, lighting.second, normal, to_viewer, m.shininess);
        for (int i = 2; i < kLights; ++i)
            sums = add_view_light(sums, Lights(setup.it.lights).at[i], normal, to_viewer, m.shininess);
    }
    Vec3f color = Vec3f(m.red, m.green, m.blue);
    if (kTextured && m.texture_width > 0) color = texture_color(m, q);
    if (m.painted != 0) color = paint_color(m, q);
    return color_units(m, sums, color.x, color.y, color.z, view.units);
}

Particle particle_at(uint i) {
    u64vec2 words = Particles(setup.it.particles).at[i];
    uvec2 a = unpackUint2x32(words.x);
    uvec2 b = unpackUint2x32(words.y);
    return Particle(uintBitsToFloat(a.x), uintBitsToFloat(a.y), uintBitsToFloat(b.x), b.y);
}

// Of the tile; all of its particles are in view.
uint tile_pixel(Projection projection, Particle q) {
    PixelDepth at;
    if (kByDivision) at = project_particle(projection, q);
    else at = project_in_view(projection, q);
    return uint(((at.row & (kTileSide - 1)) << kTileShift) | (at.column & (kTileSide - 1)));
}

// Everybody's writes are seen by all, and nobody goes on before.
void meet() {
    if (kOneSubgroup) {
        subgroupMemoryBarrierBuffer();
        subgroupBarrier();
    } else {
        memoryBarrierBuffer();
        barrier();
    }
}

void main() {
    uint number = gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y;
    if (number >= item_count) return;
    DrawItem item = Items(setup.it.items).at[first_item + number];
    Keys keys = Keys(setup.it.keys);
    Sums sums = Sums(setup.it.sums);
    Spans spans = Spans(setup.it.spans);
    Runs runs = Runs(setup.it.runs);
    Projection projection = setup.it.projection;
    Lighting lighting;
    lighting.view = setup.it.view;
    lighting.first = Lights(setup.it.lights).at[0];
    lighting.second = Lights(setup.it.lights).at[min(1, kLights - 1)];
    uint lane = gl_LocalInvocationID.x;
    uint lanes = gl_WorkGroupSize.x;
    uint base = item.slot * kSlotPixels;
    uint nowhere = base + uint(kTilePixels) + lane;
    for (uint s = item.first_span; s < item.end_span; ++s) {
        DrawSpan span = spans.at[s];
        // Nearest wins.
        for (uint i = lane; i < span.count; i += lanes) {
            Particle q = particle_at(span.first + i);
            atomicMin(keys.at[base + tile_pixel(projection, q)], particle_key(q, span.index + i));
        }
        meet();
        // Winners are shaded and added.
        for (uint r = span.first_run; r < span.end_run; ++r) {
            DrawRun run = runs.at[r];
            Material m;
            if (kShaded) m = Materials(setup.it.materials).at[run.object];
            for (uint i = run.first + lane; i < run.end; i += lanes) {
                Particle q = particle_at(i);
                uint pixel = tile_pixel(projection, q);
                bool won = keys.at[base + pixel] == particle_key(q, span.index + i - span.first);
                uint place = won ? base + pixel : nowhere;
                keys.at[place] = ~uint64_t(0);
                if (kShaded) {
                    ColorUnits color = shade_particle(lighting, m, q);
                    sums.at[place] = add_packed(sums.at[place], color, nearness_of(q));
                } else {
                    Pixels(setup.it.pixels).at[i] = won ? pixel : kNoTilePixel;
                }
            }
        }
        meet();
    }
}
