// The tests of the twin headers: one invocation runs one twin function on one input, so that the device's
// bits can be compared with those of C++.
//   operation 0  project_particle: Particle -> PixelDepth
//   operation 1  pack_normal: Vec3f -> uint
//   operation 2  unpack_normal: uint -> Vec3f
//   operation 3  project_quickly, 4 project_in_view: as 0
//   operation 17… merge_step: two slabs -> MergeStep; 3·interpolation + mixing
//   operation 5… functions of one number: uint (a float's bits) -> uint (the result's bits)
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#include "kernel/intermix_twin.h"
#include "kernel/math_twin.h"
#include "kernel/normal_twin.h"
#include "kernel/projection_twin.h"

layout(local_size_x = 64) in;
layout(constant_id = 0) const uint kOperation = 0;

layout(buffer_reference, scalar) readonly buffer View { Projection projection; };
layout(buffer_reference, scalar) buffer Particles { Particle at[]; };
layout(buffer_reference, scalar) buffer Pixels { PixelDepth at[]; };
layout(buffer_reference, scalar) buffer Normals { Vec3f at[]; };
layout(buffer_reference, scalar) buffer Words { uint at[]; };

struct SlabPair {
    Slab a;
    Slab b;
};
layout(buffer_reference, scalar) readonly buffer SlabPairs { SlabPair at[]; };
layout(buffer_reference, scalar) buffer MergeSteps { MergeStep at[]; };

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
    } else if (kOperation == 2) {
        Normals(push.results).at[i] = unpack_normal(Words(push.inputs).at[i]);
    } else if (kOperation == 3 || kOperation == 4) {
        Particle particle = Particles(push.inputs).at[i];
        Projection projection = View(push.view).projection;
        if (kOperation == 3) Pixels(push.results).at[i] = project_quickly(projection, particle);
        else Pixels(push.results).at[i] = project_in_view(projection, particle);
    } else if (kOperation >= 17) {
        SlabPair pair = SlabPairs(push.inputs).at[i];
        MergeSteps(push.results).at[i] = merge_step(pair.a, pair.b, (kOperation - 17) / 3, (kOperation - 17) % 3);
    } else {
        float x = uintBitsToFloat(Words(push.inputs).at[i]);
        float r = 0.0;
        if (kOperation == 5) r = twin_reciprocal(x);
        if (kOperation == 6) r = twin_sqrt(x);
        if (kOperation == 7) r = twin_rsqrt(x);
        if (kOperation == 8) r = twin_log1p(x);
        if (kOperation == 9) r = twin_expm1(x);
        if (kOperation == 10) r = twin_log2(x);
        if (kOperation == 11) r = twin_exp2(x);
        if (kOperation == 12) r = twin_power(x, 37.3);
        if (kOperation == 13) r = quick_rsqrt(x);
        if (kOperation == 14) r = quick_log2(x);
        if (kOperation == 15) r = quick_exp2(x);
        if (kOperation == 16) r = quick_power(x, 37.3);
        Words(push.results).at[i] = floatBitsToUint(r);
    }
}
