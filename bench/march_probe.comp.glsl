// The bare march: one ray an invocation, in packets of 4 × 4 pixels; samples of a cube, one voxel apart and trilinear.
// Nothing else of a renderer. Samples lie in memory as float32, eight loads each; or packed, uint8 and the four of a cell at
// its lower z as one word.
#version 450
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require

layout(local_size_x = 16) in;
layout(constant_id = 0) const bool kPacked = false;

struct MarchRay {
    vec3 p, d;
    uint steps;
};
layout(buffer_reference, scalar) readonly buffer Words { uint at[]; };
layout(buffer_reference, scalar) readonly buffer Floats { float at[]; };
layout(buffer_reference, scalar) readonly buffer Rays { MarchRay at[]; };
layout(buffer_reference, scalar) buffer Sums { float at[]; };
layout(push_constant, scalar) uniform Push {
    Words words;
    Rays rays;
    Sums sums;
    uint count;
    uint samples;
};

void main() {
    uint number = (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (number >= count) return;
    MarchRay ray = rays.at[number];
    float last = float(samples - 1u), sum = 0.0;
    int last_cell = int(samples) - 2;
    for (uint i = 0u; i < ray.steps; ++i) {
        vec3 at = clamp(ray.p + float(i) * ray.d, vec3(0.0), vec3(last));
        ivec3 cell = min(ivec3(at), ivec3(last_cell));
        vec3 f = at - vec3(cell);
        uint n = uint(cell.x) + samples * (uint(cell.y) + samples * uint(cell.z));
        vec4 low, high;
        if (kPacked) {
            uint near = words.at[n], far = words.at[n + samples * samples];
            low = vec4(float(near & 255u), float((near >> 16) & 255u), float(far & 255u), float((far >> 16) & 255u));
            high = vec4(float((near >> 8) & 255u), float(near >> 24), float((far >> 8) & 255u), float(far >> 24));
        } else {
            Floats values = Floats(words);
            uint m = n + samples * samples;
            low = vec4(values.at[n], values.at[n + samples], values.at[m], values.at[m + samples]);
            high = vec4(values.at[n + 1u], values.at[n + samples + 1u], values.at[m + 1u], values.at[m + samples + 1u]);
        }
        vec4 along_x = mix(low, high, f.x);
        vec2 along_y = mix(along_x.xz, along_x.yw, f.y);
        sum += mix(along_y.x, along_y.y, f.z);
    }
    sums.at[number] = sum;
}
