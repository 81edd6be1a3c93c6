// Crossings with an isosurface as virtual slabs (zSlab, section 5.4): with depth `thickness` towards the
// viewer, less where the eye is nearer. Include a sink first.
layout(buffer_reference, scalar) readonly buffer Surfaces { PlainSurface at[]; };
layout(buffer_reference, scalar) readonly buffer PlainSetup { CastSetup it; };
layout(push_constant, scalar) uniform Push {
    PlainSetup setup;
    Sink sink;
    uint first_packet;
    uint packet_count;
};

bool take_crossing(PlainSurface s, double t, double opacity, Vec3d color) {
    Slab slab = slab_between(t, t, opacity, color);
    slab.d = float(s.thickness > t ? (t > 0.0lf ? t : 0.0lf) : s.thickness);
    return !(slab.a > 0.0) || sink_push(slab);
}

#include "isosurface_cast.glsl"

void main() {
    uint number = invocation_number();
    if (number >= packet_count * kPacketRaysT) return;
    uint packet = first_packet + number / kPacketRaysT, in_packet = number % kPacketRaysT;
    ivec2 pixel = ivec2(packet % setup.it.packet_columns * kPacketSideT + in_packet % kPacketSideT,
                        packet / setup.it.packet_columns * kPacketSideT + in_packet / kPacketSideT);
    CastCamera camera = setup.it.camera;
    if (pixel.x >= camera.width || pixel.y >= camera.height) return;
    PlainSurface s = Surfaces(setup.it.volumes).at[0];
    sink_start(uint(pixel.y * camera.width + pixel.x));
    bool ended =
        find_crossings(camera, Lights(setup.it.lights), s, plain_ray(camera, s.grid, pixel, 0u, false));
    if (!ended) Status(setup.it.status).unfinished = 1u;
    sink_finish();
}
