// One 64-bit minimum a fragment. Nothing else of a renderer.
#version 450
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_shader_atomic_int64 : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require

layout(buffer_reference, scalar) buffer Keys { uint64_t at[]; };
layout(push_constant, scalar) uniform Push {
    uint64_t corners;
    Keys keys;
    uint size;
};
layout(location = 0) in float depth;
layout(location = 1) flat in uint payload;

void main() {
    uint pixel = uint(gl_FragCoord.y) * size + uint(gl_FragCoord.x);
    atomicMin(keys.at[pixel], (uint64_t(floatBitsToUint(depth)) << 32) | uint64_t(payload));
}
