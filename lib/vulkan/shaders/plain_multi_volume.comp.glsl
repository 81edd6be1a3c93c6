// Conventional multi-volume ray-casting in double, for volumes that are not all trilinear: as cast_volumes of
// the CPU, ray by ray. See multi_volume.comp.glsl.
#version 460
#include "cast_plain.glsl"
#include "plain_volume.glsl"
#include "mix_shared.glsl"
#include "multi_total.glsl"

layout(constant_id = 6) const uint kVolumes = 1;

layout(buffer_reference, scalar) readonly buffer PlainSetup { CastSetup it; };
layout(buffer_reference, scalar) readonly buffer Layers { RayLayer at[]; };
layout(push_constant, scalar) uniform Push {
    PlainSetup setup;
    uint first_packet;
    uint packet_count;
    uint part;
};

Gathered gather(Gathered s, double front, vec4 rgba) {
    precise dvec4 c = dvec4(rgba);
    if (!(c.a > 0.0lf)) return s;
    precise dvec4 sum =
        dvec4(s.r + s.clear * c.r, s.g + s.clear * c.g, s.b + s.clear * c.b, s.clear * (1.0lf - c.a));
    return Gathered(sum.w, sum.x, sum.y, sum.z, min(s.z, front));
}

void main() {
    uint number = invocation_number();
    if (number >= packet_count * kPacketRaysT) return;
    uint packet = first_packet + number / kPacketRaysT, in_packet = number % kPacketRaysT;
    ivec2 pixel = ivec2(packet % setup.it.packet_columns * kPacketSideT + in_packet % kPacketSideT,
                        packet / setup.it.packet_columns * kPacketSideT + in_packet / kPacketSideT);
    CastCamera camera = setup.it.camera;
    if (pixel.x >= camera.width || pixel.y >= camera.height) return;
    PlainVolumes volumes = PlainVolumes(setup.it.volumes);
    Lights lights = Lights(setup.it.lights);
    Layers layers = Layers(setup.it.layers);
    PlainWalk walks[kVolumes];
    for (uint v = 0u; v < kVolumes; ++v)
        walks[v] = plain_start(volumes.at[v], plain_ray(camera, volumes.at[v].grid, pixel, part, true));
    uint layer = 0u, layer_count = 0u, first_layer = number * setup.it.layer_room;
    if (setup.it.layers != 0) layer_count = min(Words(setup.it.layer_counts).at[number], setup.it.layer_room);
    Gathered sum = Gathered(1.0lf, 0.0lf, 0.0lf, 0.0lf, kNoDepth);
    double least_clear = double(setup.it.least_clear);
    double dt = walks[0].r.dt;
    bool ended = false;  // and not cut
    for (uint rounds = camera.most_rounds; rounds > 0u; --rounds) {
        if (!(sum.clear > least_clear)) {
            ended = true;
            break;
        }
        // The next of all steps.
        bool any = false;
        int64_t k = int64_t(0);
        for (uint v = 0u; v < kVolumes; ++v) {
            if (!plain_done(walks[v])) plain_skip(walks[v], volumes.at[v]);
            if (plain_done(walks[v])) continue;
            k = any ? min(k, walks[v].k) : walks[v].k;
            any = true;
        }
        precise double next = double(k + int64_t(1)) * dt, begin = double(k) * dt;
        double end = any ? next : kNoDepth;
        RayLayer surface;
        surface.t = kNoDepth;
        if (layer < layer_count) surface = layers.at[first_layer + layer];
        bool at_surface = layer < layer_count && surface.t < end;
        if (!at_surface && !any) {
            ended = true;
            break;
        }
        // All volumes that are in step k: to its end, or to the surface in it.
        double t = at_surface ? surface.t : end;
        if (any && (!at_surface || t > begin)) {
            Shared all = no_shared();
            double front = kNoDepth;
            for (uint v = 0u; v < kVolumes; ++v) {
                if (plain_done(walks[v]) || walks[v].k != k) continue;
                double from = walks[v].t, to = min(t, walks[v].r.span.hi);
                if (to > from) {
                    Slab slab = plain_advance(camera, lights, walks[v], volumes.at[v], to);
                    if (slab.a > 0.0) {
                        all = share(all, vec4(slab.r, slab.g, slab.b, slab.a));
                        front = min(front, from);
                    }
                }
                if (!at_surface) walks[v].k = walks[v].k + int64_t(1);
            }
            if (all.count > 0u) sum = gather(sum, front, shared_color(all, setup.it.mixing));
        }
        if (at_surface) {
            sum = gather(sum, surface.t, vec4(surface.r, surface.g, surface.b, surface.a));
            ++layer;
        }
    }
    if (!ended) Status(setup.it.status).unfinished = 1u;
    add_to_pixel(camera, Totals(setup.it.totals), Planes5(setup.it.planes), pixel, part, sum);
}
