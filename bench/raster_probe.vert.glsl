// The bare rasteriser: corners as they are.
#version 450
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require

struct Corner {
    float x;
    float y;
    float z;
    uint payload;
};
layout(buffer_reference, scalar) readonly buffer Corners { Corner at[]; };
layout(push_constant, scalar) uniform Push {
    Corners corners;
    uint64_t keys;
    uint size;
};
layout(location = 0) out float depth;
layout(location = 1) flat out uint payload;

void main() {
    Corner c = corners.at[gl_VertexIndex];
    gl_Position = vec4(c.x, c.y, 0.5, 1.0);
    depth = c.z;
    payload = c.payload;
}
