// The rays of some packets through one volume, as slabs with opacity > 0 from front to back; float32,
// trilinear. An invocation is one ray: it reads its PacketRay and VolumeRay, and hands its slabs to the sink,
// which alone writes, by pixel. Include a sink first: see slab_list.glsl.
#ifndef sink_take
#define sink_take(slab) sink_push(slab)
#define sink_is_settled() true
#define sink_settle()
#endif
layout(push_constant, scalar) uniform Push {
    Setup setup;
    Sink sink;
    uint first_packet;
    uint packet_count;
};

void main() {
    uint number = invocation_number();
    if (number >= packet_count * kPacketRaysT) return;
    ivec2 pixel = pixel_of_ray(setup, first_packet + number / kPacketRaysT, number % kPacketRaysT);
    if (pixel.x >= setup.it.camera.width || pixel.y >= setup.it.camera.height) return;
    CastVolume v = Volumes(setup.it.volumes).at[0];
    keep_pieces(v, 0u);
    PacketRay ray = PacketRays(setup.it.packet_rays).at[number];
    Walk w;
    w.volume = 0u;
    w.ray = VolumeRays(setup.it.volume_rays).at[number];
    float least_clear = setup.it.least_clear;
    float clear = 1.0;
    sink_start(uint(pixel.y * setup.it.camera.width + pixel.x));
    bool ended = false;  // and not cut
    uint rounds = setup.it.camera.most_rounds;
    float i = 0.0;
    while (rounds > 0u) {
        --rounds;
        sink_settle();
        // To the next step that may show something, …
        float next = next_step(w, v, i);
        ended = !(clear > least_clear && i < ray.last) || next >= kCastNever;
        if (ended) break;
        i = max(i, next);
        prime(w, v, i);
        // … and on as long as any ray sees anything: what is empty costs the others nothing.
        for (bool visible = true; visible && rounds > 0u; --rounds) {
            i += 1.0;
            StepLook look = step_to(setup, w, v, i, ray.to_viewer);
            bool seen = look.opacity > 0.0;
            if (seen) {
                precise float back = ray.z + w.u * ray.dt;
                precise float front = ray.z + w.begin * ray.dt;
                precise float d = back - front;
                precise float passes = clear * (1.0 - look.opacity);
                clear = passes;
                ended = !sink_take(Slab(back, d, look.color.x, look.color.y, look.color.z, look.opacity));
            }
            visible = subgroupAny(seen) && sink_is_settled() && !ended && clear > least_clear && i < ray.last;
        }
        if (ended) break;
    }
    if (!ended) Status(setup.it.status).unfinished = 1u;
    sink_settle();
    sink_finish();
}
