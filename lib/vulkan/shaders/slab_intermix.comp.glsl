// The kernel: what each ray of a band has left in `given`, merged with its pixel's array (zSlab, sections 4.2 and 5.3).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "slab_frame.glsl"
layout(local_size_x_id = 0) in;
layout(push_constant, scalar) uniform Push {
    Frame frame_;
    uint count;
};
void main() {
    uint number = (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (number >= count) return;
    frame = frame_;
    own = number;
    Arrival arrival = Arrivals(frame.arrivals).at[number];
    if (arrival.count > 0u) intermix_given(arrival.pixel, arrival.count, arrival.nearest);
}
