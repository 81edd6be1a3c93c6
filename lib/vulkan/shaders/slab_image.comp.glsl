// Layer 0 of a z-thickness buffer as planes R, G, B, A, Z.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "slab_frame.glsl"
layout(local_size_x_id = 0) in;
layout(push_constant, scalar) uniform Push {
    Frame frame_;
    FrameFloats planes;
    uint pixels;
};
void main() {
    uint pixel = (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (pixel >= pixels) return;
    frame = frame_;
    Slab s = no_slab();
    if (touched(pixel)) s = stored_slab(pixel, 0u);
    planes.at[pixel] = s.r;
    planes.at[pixels + pixel] = s.g;
    planes.at[2u * pixels + pixel] = s.b;
    planes.at[3u * pixels + pixel] = s.a;
    planes.at[4u * pixels + pixel] = FrameFloats(frame.nearest).at[pixel];
}
