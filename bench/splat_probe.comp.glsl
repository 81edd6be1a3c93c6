// The bare compute splat: one 16-byte point an invocation, float projection, one 64-bit minimum. Keys are all ones
// before. Nothing else of a renderer.
#version 450
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_shader_atomic_int64 : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require

layout(local_size_x = 64) in;

struct Point {
    float x;
    float y;
    float z;
    uint payload;
};
layout(buffer_reference, scalar) readonly buffer Points { Point at[]; };
layout(buffer_reference, scalar) buffer Keys { uint64_t at[]; };
layout(push_constant, scalar) uniform Push {
    Points points;
    Keys keys;
    uint count;
    uint size;
};

void main() {
    uint i = (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (i >= count) return;
    Point p = points.at[i];
    float half_size = 0.5 * float(size);
    float scale = 3.0 * half_size / p.z;
    int column = int(p.x * scale + half_size);
    int row = int(p.y * scale + half_size);
    if (column < 0 || row < 0 || column >= int(size) || row >= int(size)) return;
    atomicMin(keys.at[row * int(size) + column], (uint64_t(floatBitsToUint(p.z)) << 32) | uint64_t(p.payload));
}
