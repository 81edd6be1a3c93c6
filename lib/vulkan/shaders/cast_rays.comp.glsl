// The rays of some packets of pixels: where each meets the volumes, in double, told in float32 from the step
// on from which its packet counts. An invocation is one ray; it reads the setup, and writes its PacketRay,
// RaySteps and a VolumeRay for each volume. A workgroup holds whole packets.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#include "kernel/cast_rays_twin.h"

layout(local_size_x_id = 0) in;

layout(buffer_reference, scalar) readonly buffer Setup { CastSetup it; };
layout(buffer_reference, scalar) readonly buffer Volumes { CastVolume at[]; };
layout(buffer_reference, scalar) readonly buffer Planes { CastPlane at[]; };
layout(buffer_reference, scalar) writeonly buffer PacketRays { PacketRay at[]; };
layout(buffer_reference, scalar) writeonly buffer VolumeRays { VolumeRay at[]; };
layout(buffer_reference, scalar) writeonly buffer AllRaySteps { RaySteps at[]; };
layout(buffer_reference, scalar) readonly buffer Layers { RayLayer at[]; };
layout(buffer_reference, scalar) readonly buffer Words { uint at[]; };
layout(push_constant, scalar) uniform Push {
    Setup setup;
    uint first_packet;
    uint packet_count;
    uint part;  // of the pixel
};

const int64_t kNoStep = int64_t(0x7fffffffffffffffL);
shared int64_t first_of[gl_WorkGroupSize.x];

struct Entered {
    Vec3d from;
    Vec3d along;
    SpanD span;
};
Entered enter(CastCamera camera, CastVolume v, RayD ray) {
    Entered e;
    e.from = place_point(v.place, ray.origin);
    e.along = place_vector(v.place, ray.direction);
    e.span = span_in_box(SpanD(camera.near, camera.far), e.from, e.along, v.place.last);
    Planes planes = Planes(v.planes);
    for (uint i = 0u; i < v.plane_count; ++i) e.span = span_clipped(e.span, ray, planes.at[i]);
    return e;
}

void main() {
    uint group = gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y;
    uint number = group * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    uint packet = first_packet + number / kPacketRaysT;
    uint in_packet = number % kPacketRaysT;
    CastCamera camera = setup.it.camera;
    int x = int(packet % setup.it.packet_columns * kPacketSideT + in_packet % kPacketSideT);
    int y = int(packet / setup.it.packet_columns * kPacketSideT + in_packet / kPacketSideT);
    bool here = number < packet_count * kPacketRaysT && x < camera.width && y < camera.height;
    RayD ray = camera_ray(camera, ray_position(x, part % camera.rays, camera.rays),
                          ray_position(y, part / camera.rays, camera.rays));
    precise double dt = camera.step / length3d(ray.direction);
    Volumes volumes = Volumes(setup.it.volumes);

    // The packet's first step.
    int64_t first = kNoStep;
    if (here)
        for (uint i = 0u; i < setup.it.volume_count; ++i) {
            Entered e = enter(camera, volumes.at[i], ray);
            if (e.span.lo < e.span.hi) first = min(first, grid_sample_before(e.span.lo, dt));
        }
    uint layer_count = 0u;
    Layers layers = Layers(setup.it.layers);
    uint first_layer = number * setup.it.layer_room;
    if (here && setup.it.layers != 0) {
        layer_count = min(Words(setup.it.layer_counts).at[number], setup.it.layer_room);
        precise double front = layers.at[first_layer].t / dt;
        if (layer_count > 0u) first = min(first, int64_t(floor(front)));
    }
    first_of[gl_LocalInvocationID.x] = first;
    barrier();
    uint base = gl_LocalInvocationID.x / kPacketRaysT * kPacketRaysT;
    for (uint i = 0u; i < kPacketRaysT; ++i) first = min(first, first_of[base + i]);
    if (number >= packet_count * kPacketRaysT) return;

    PacketRay packet_ray;
    packet_ray.last = 0.0;
    packet_ray.to_viewer = unit_to_viewer(ray.direction);
    precise double z = double(first) * dt;
    packet_ray.z = float(z);
    packet_ray.dt = float(dt);
    if (layer_count > 0u) {
        precise double back = layers.at[first_layer + layer_count - 1u].t / dt - double(first);
        precise float behind = float(back) + 1.0;
        packet_ray.last = behind;
    }
    VolumeRays volume_rays = VolumeRays(setup.it.volume_rays);
    for (uint i = 0u; i < setup.it.volume_count; ++i) {
        Entered e = enter(camera, volumes.at[i], ray);
        VolumeRay in_volume = VolumeRay(0.0, 0.0, Vec3f(0.0, 0.0, 0.0), Vec3f(0.0, 0.0, 0.0));
        if (here && e.span.lo < e.span.hi) {
            in_volume = packed_ray(e.from, e.along, e.span, dt, first);
            packet_ray.last = max(packet_ray.last, in_volume.u_out);
        }
        volume_rays.at[i * packet_count * kPacketRaysT + number] = in_volume;
    }
    PacketRays(setup.it.packet_rays).at[number] = packet_ray;
    AllRaySteps(setup.it.ray_steps).at[number] = RaySteps(first, dt);
}
