// The rays of some packets through one volume, as slabs with opacity > 0 from front to back; float32,
// trilinear. An invocation is one ray: it reads its PacketRay and VolumeRay, and hands its slabs to the sink,
// which alone writes, by pixel. Include a sink first: see slab_list.glsl.
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
    PacketRay ray = PacketRays(setup.it.packet_rays).at[number];
    Walk w;
    w.ray = VolumeRays(setup.it.volume_rays).at[number];
    float least_clear = setup.it.least_clear;
    float clear = 1.0;
    bool look_ahead = true, primed = false;
    sink_start(uint(pixel.y * setup.it.camera.width + pixel.x));
    bool ended = false;  // and not cut
    uint rounds = setup.it.camera.most_rounds;
    for (float i = 0.0; rounds > 0u; i += 1.0) {
        --rounds;
        if (!(clear > least_clear && i < ray.last)) ended = true;
        if (!ended && look_ahead) {
            float next = next_step(w, v, i);
            ended = next >= kCastNever;
            primed = primed && next <= i;
            i = max(i, next);
        }
        if (ended) break;
        if (!primed) prime(w, v, i);
        primed = true;
        StepLook look = step_to(setup, w, v, i + 1.0, ray.to_viewer);
        look_ahead = !(look.opacity > 0.0);
        if (look_ahead) continue;
        precise float back = ray.z + w.u * ray.dt;
        precise float front = ray.z + w.begin * ray.dt;
        precise float d = back - front;
        precise float passes = clear * (1.0 - look.opacity);
        clear = passes;
        if (!sink_push(Slab(back, d, look.color.x, look.color.y, look.color.z, look.opacity))) {
            ended = true;
            break;
        }
    }
    if (!ended) Status(setup.it.status).unfinished = 1u;
    sink_finish();
}
