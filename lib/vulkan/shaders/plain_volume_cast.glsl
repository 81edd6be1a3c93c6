// The rays of some packets of pixels through one volume, in double: as volume_cast.glsl, for other
// interpolations and for rays of a million steps. Include a sink first.
layout(buffer_reference, scalar) readonly buffer PlainSetup { CastSetup it; };
layout(push_constant, scalar) uniform Push {
    PlainSetup setup;
    Sink sink;
    uint first_packet;
    uint packet_count;
};

void main() {
    uint number = invocation_number();
    if (number >= packet_count * kPacketRaysT) return;
    uint packet = first_packet + number / kPacketRaysT, in_packet = number % kPacketRaysT;
    ivec2 pixel = ivec2(packet % setup.it.packet_columns * kPacketSideT + in_packet % kPacketSideT,
                        packet / setup.it.packet_columns * kPacketSideT + in_packet / kPacketSideT);
    CastCamera camera = setup.it.camera;
    if (pixel.x >= camera.width || pixel.y >= camera.height) return;
    PlainVolume v = PlainVolumes(setup.it.volumes).at[0];
    Lights lights = Lights(setup.it.lights);
    PlainWalk w = plain_start(v, plain_ray(camera, v.grid, pixel, 0u, true));
    bool ended = false;  // and not cut
    sink_start(uint(pixel.y * camera.width + pixel.x));
    for (uint rounds = camera.most_rounds; rounds > 0u; --rounds) {
        if (!plain_done(w)) plain_skip(w, v);
        if (plain_done(w)) {
            ended = true;
            break;
        }
        Slab slab = plain_step(camera, lights, w, v);
        if (slab.a > 0.0 && !sink_push(slab)) {
            ended = true;
            break;
        }
    }
    if (!ended) Status(setup.it.status).unfinished = 1u;
    sink_finish();
}
