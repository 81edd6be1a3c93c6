// Conventional multi-volume ray-casting in float32: one ray samples all volumes at the same places and mixes
// each step (zSlab (4.1) to (4.4)); surfaces lie between the parts of a step. As cast_volumes_fast of the
// CPU.
//
// An invocation is one ray; it reads its PacketRay, VolumeRays, RaySteps and layers, and writes its pixel's
// total.
#version 460
#include "cast_volume.glsl"
#include "multi_total.glsl"

layout(constant_id = 11) const bool kLayers = false;

layout(buffer_reference, scalar) readonly buffer Layers { RayLayer at[]; };
layout(push_constant, scalar) uniform Push {
    Setup setup;
    uint first_packet;
    uint packet_count;
    uint part;
};

// The next surface of the ray.
struct NextLayer {
    RayLayer layer;
    float u;
    uint next;
    uint count;
};
NextLayer next_layer(NextLayer n, uint number, RaySteps steps) {
    n.u = kCastNever;
    if (n.next < n.count) {
        n.layer = Layers(setup.it.layers).at[number * setup.it.layer_room + n.next];
        precise double u = n.layer.t / steps.dt - double(steps.first);
        n.u = float(u);
        n.next += 1u;
    }
    return n;
}

// What is gathered: associated colour, transmittance, and u where something was seen first.
struct Sums {
    Vec3f color;
    float clear;
    float first;
};
Sums add_to_sums(Sums s, Vec3f associated, float opacity, float begin) {
    precise float r = s.color.x + s.clear * associated.x;
    precise float g = s.color.y + s.clear * associated.y;
    precise float b = s.color.z + s.clear * associated.z;
    precise float clear = s.clear * (1.0 - opacity);
    return Sums(Vec3f(r, g, b), clear, opacity > 0.0 ? min(s.first, begin) : s.first);
}

void main() {
    uint number = invocation_number();
    if (number >= packet_count * kPacketRaysT) return;
    ivec2 pixel = pixel_of_ray(setup, first_packet + number / kPacketRaysT, number % kPacketRaysT);
    if (pixel.x >= setup.it.camera.width || pixel.y >= setup.it.camera.height) return;
    PacketRay ray = PacketRays(setup.it.packet_rays).at[number];
    RaySteps steps = AllRaySteps(setup.it.ray_steps).at[number];
    CastVolume volumes[kVolumes];
    Walk walks[kVolumes];
    for (uint v = 0u; v < kVolumes; ++v) {
        volumes[v] = Volumes(setup.it.volumes).at[v];
        keep_pieces(volumes[v], v);
        walks[v].volume = v;
        walks[v].ray = VolumeRays(setup.it.volume_rays).at[v * packet_count * kPacketRaysT + number];
    }
    NextLayer layer;
    layer.u = kCastNever;
    if (kLayers) {
        layer.next = 0u;
        layer.count = min(Words(setup.it.layer_counts).at[number], setup.it.layer_room);
        layer = next_layer(layer, number, steps);
    }
    Sums sums = Sums(Vec3f(0.0, 0.0, 0.0), 1.0, kCastNever);
    float least_clear = setup.it.least_clear;
    bool ended = false;  // and not cut
    uint rounds = setup.it.camera.most_rounds;
    float i = 0.0;
    while (rounds > 0u) {
        --rounds;
        // To the next step in which a volume may show something, or with a surface, …
        float next[kVolumes];
        float soonest = kLayers ? max(floor(layer.u), i) : kCastNever;
        for (uint v = 0u; v < kVolumes; ++v) {
            next[v] = next_step(walks[v], volumes[v], i);
            soonest = min(soonest, max(next[v], i));
        }
        ended = !(sums.clear > least_clear && i < ray.last) || soonest >= kCastNever;
        if (ended) break;
        i = soonest;
        bool taking_part[kVolumes];
        float another = kCastNever;
        for (uint v = 0u; v < kVolumes; ++v) {
            taking_part[v] = next[v] <= i;
            if (taking_part[v]) prime(walks[v], volumes[v], i);
            else another = min(another, next[v]);
        }
        // … and on as long as any ray sees anything and no other volume comes: what is empty costs the others nothing.
        for (bool visible = true; visible && rounds > 0u; --rounds) {
            bool seen = false;
            precise float whole = i + 1.0;
            for (;;) {
                float target = kLayers ? min(whole, layer.u) : whole;
                CastMixture mixture = CastMixture(no_look(), Vec3f(0.0, 0.0, 0.0), 0.0, 0u);
                float begin = kCastNever;
                for (uint v = 0u; v < kVolumes; ++v) {
                    if (!taking_part[v]) continue;
                    StepLook look = step_to(setup, walks[v], volumes[v], target, ray.to_viewer);
                    if (!(look.opacity > 0.0)) continue;
                    seen = true;
                    if (kVolumes == 1u) mixture = CastMixture(look, Vec3f(0.0, 0.0, 0.0), 0.0, 1u);
                    else mixture = add_to_mixture(mixture, look, kMixing);
                    begin = min(begin, walks[v].begin);
                }
                if (mixture.count > 0u) {
                    StepLook sum = mixture.sum;
                    if (kVolumes > 1u) sum = mixture_result(mixture, kMixing);
                    sums = add_to_sums(sums, sum.color, sum.opacity, begin);
                }
                if (!kLayers || !(layer.u < whole) || !(sums.clear > least_clear)) break;
                sums =
                    add_to_sums(sums, Vec3f(layer.layer.r, layer.layer.g, layer.layer.b), layer.layer.a, layer.u);
                if (!(sums.clear > least_clear)) break;
                layer = next_layer(layer, number, steps);
            }
            i = whole;
            visible = subgroupAny(seen) && i < another && sums.clear > least_clear && i < ray.last;
        }
    }
    if (!ended) Status(setup.it.status).unfinished = 1u;
    precise double z = (double(steps.first) + double(sums.first)) * steps.dt;
    Gathered sum = Gathered(double(sums.clear), double(sums.color.x), double(sums.color.y),
                            double(sums.color.z), sums.clear < 1.0 ? z : kNoDepth);
    add_to_pixel(setup.it.camera, Totals(setup.it.totals), Planes5(setup.it.planes), pixel, part, sum);
}
