// The tests of the twin headers: one invocation runs one twin function on one input, so that the device's
// bits can be compared with those of C++.
//   operation 0  project_particle: Particle -> PixelDepth
//   operation 1  pack_normal: Vec3f -> uint
//   operation 2  unpack_normal: uint -> Vec3f
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#include "kernel/normal_twin.h"
#include "kernel/projection_twin.h"

layout(local_size_x = 64) in;
layout(constant_id = 0) const uint kOperation = 0;

layout(buffer_reference, scalar) readonly buffer View { Projection projection; };
layout(buffer_reference, scalar) buffer Particles { Particle at[]; };
layout(buffer_reference, scalar) buffer Pixels { PixelDepth at[]; };
layout(buffer_reference, scalar) buffer Normals { Vec3f at[]; };
layout(buffer_reference, scalar) buffer Words { uint at[]; };

layout(push_constant, scalar) uniform Push {
    uint64_t view;  // operation 0
    uint64_t inputs;
    uint64_t results;
    uint count;
} push;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= push.count) return;
    if (kOperation == 0) {
        Particle particle = Particles(push.inputs).at[i];
        Pixels(push.results).at[i] = project_particle(View(push.view).projection, particle);
    } else if (kOperation == 1) {
        Words(push.results).at[i] = pack_normal(Normals(push.inputs).at[i]);
    } else {
        Normals(push.results).at[i] = unpack_normal(Words(push.inputs).at[i]);
    }
}
