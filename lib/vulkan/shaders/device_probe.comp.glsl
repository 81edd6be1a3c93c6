// The tests of the Vulkan layer: one invocation changes one number.
//   operation 0  values[i] = factor·values[i] + addend
//   operation 1  minima[i mod places] = min(…, scramble(i)), 64 bits, many invocations on the same words
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
#extension GL_EXT_shader_atomic_int64 : require

layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint kOperation = 0;

layout(buffer_reference, scalar) buffer Values { uint at[]; };
layout(buffer_reference, scalar) buffer Minima { uint64_t at[]; };

layout(push_constant, scalar) uniform Push {
    uint64_t buffer_address;
    uint count;   // invocations that do something
    uint factor;
    uint addend;
    uint places;  // operation 1
} push;

void main() {
    uint group = gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y;
    uint i = group * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (i >= push.count) return;
    if (kOperation == 0) {
        Values values = Values(push.buffer_address);
        values.at[i] = push.factor * values.at[i] + push.addend;
    } else {
        Minima minima = Minima(push.buffer_address);
        uint64_t key = (uint64_t(i * 0x9e3779b1u) << 32) | uint64_t(i);
        atomicMin(minima.at[i % push.places], key);
    }
}
