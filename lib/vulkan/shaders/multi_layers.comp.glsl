// Multi-volume casting: what lies between the volumes on a ray. Its crossings with isosurfaces and the layers
// that came from elsewhere, sorted; what shares a depth is mixed. As LayersOfRay of the CPU.
//
// An invocation is one ray; it writes its own RayLayers and their number, and the most there are to the
// status.
#version 460
#include "cast_plain.glsl"
#include "mix_shared.glsl"

layout(buffer_reference, scalar) readonly buffer PlainSetup { CastSetup it; };
layout(buffer_reference, scalar) readonly buffer Surfaces { PlainSurface at[]; };
layout(buffer_reference, scalar) readonly buffer Slabs { Slab at[]; };
layout(buffer_reference, scalar) buffer Layers { RayLayer at[]; };
layout(buffer_reference, scalar) buffer Counts { uint at[]; };
layout(push_constant, scalar) uniform Push {
    PlainSetup setup;
    uint first_packet;
    uint packet_count;
    uint part;
};

uint first_layer, layer_count;
// In order of depth, behind those of the same; counts on where there is no more room.
void add_layer(RayLayer layer) {
    Layers layers = Layers(setup.it.layers);
    uint place = layer_count++;
    if (place >= setup.it.layer_room) return;
    for (; place > 0u && layers.at[first_layer + place - 1u].t > layer.t; --place)
        layers.at[first_layer + place] = layers.at[first_layer + place - 1u];
    layers.at[first_layer + place] = layer;
}
bool take_crossing(PlainSurface s, double t, double opacity, Vec3d color) {
    add_layer(RayLayer(t, float(color.x), float(color.y), float(color.z), float(opacity)));
    return true;
}

#include "isosurface_cast.glsl"

void main() {
    uint number = invocation_number();
    if (number >= packet_count * kPacketRaysT) return;
    uint packet = first_packet + number / kPacketRaysT, in_packet = number % kPacketRaysT;
    ivec2 pixel = ivec2(packet % setup.it.packet_columns * kPacketSideT + in_packet % kPacketSideT,
                        packet / setup.it.packet_columns * kPacketSideT + in_packet / kPacketSideT);
    CastCamera camera = setup.it.camera;
    first_layer = number * setup.it.layer_room;
    layer_count = 0u;
    bool ended = true;
    if (pixel.x < camera.width && pixel.y < camera.height) {
        if (setup.it.given_first != 0) {
            uint n = camera.rays;
            uint row = (uint(pixel.y) - setup.it.given_row) * n + part / n;
            uint ray = row * uint(camera.width) * n + uint(pixel.x) * n + part % n;
            Words first = Words(setup.it.given_first);
            for (uint i = first.at[ray]; i < first.at[ray + 1u]; ++i) {
                Slab s = Slabs(setup.it.given).at[i];
                add_layer(RayLayer(double(s.z), s.r, s.g, s.b, s.a));
            }
        }
        for (uint i = 0u; i < setup.it.surface_count; ++i) {
            PlainSurface s = Surfaces(setup.it.surfaces).at[i];
            bool all = find_crossings(camera, Lights(setup.it.lights), s,
                                      plain_ray(camera, s.grid, pixel, part, false));
            ended = ended && all;
        }
    }
    Status status = Status(setup.it.status);
    if (!ended) status.unfinished = 1u;
    if (layer_count > setup.it.layer_room) {
        atomicMax(status.most_layers, layer_count);
        layer_count = 0u;
    }
    // One layer a depth.
    Layers layers = Layers(setup.it.layers);
    uint kept = 0u;
    for (uint i = 0u; i < layer_count;) {
        RayLayer layer = layers.at[first_layer + i];
        Shared all = no_shared();
        uint begin = i;
        for (; i < layer_count; ++i) {
            RayLayer next = layers.at[first_layer + i];
            if (next.t != layer.t) break;
            all = share(all, vec4(next.r, next.g, next.b, next.a));
        }
        if (i > begin + 1u) {
            vec4 mixed = shared_color(all, setup.it.mixing);
            layer = RayLayer(layer.t, mixed.r, mixed.g, mixed.b, mixed.a);
        }
        layers.at[first_layer + kept] = layer;
        ++kept;
    }
    Counts(setup.it.layer_counts).at[number] = kept;
}
