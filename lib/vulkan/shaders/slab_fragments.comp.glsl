// The polygon stage's fragments of one object, as virtual slabs, into the pixels' arrays: SlabFrame::intermix_overlapping.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "slab_frame.glsl"
layout(local_size_x_id = 0) in;
struct Pass {
    uint64_t slabs;   // of pixel p: slab k at k·pixels + p
    uint64_t counts;
};
layout(buffer_reference, scalar) readonly buffer Passes { Pass at[]; };
layout(push_constant, scalar) uniform Push {
    Frame frame_;
    Passes passes;
    uint pass_count;
    uint pixels;      // of the image
    uint first, count;
};
void main() {
    uint number = (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (number >= count) return;
    frame = frame_;
    own = number;
    uint pixel = first + number;
    uint given = 0u;
    for (uint pass = 0u; pass < pass_count; ++pass) {
        uint here = FrameWords(passes.at[pass].counts).at[pixel];
        for (uint k = 0u; k < here; ++k) {
            Slab s = FrameSlabs(passes.at[pass].slabs).at[k * pixels + pixel];
            if (given == frame.given_room) {
                set_given(given - 1u, joined_slabs(given_at(given - 1u), s));
                continue;
            }
            set_given(given, s);
            ++given;
        }
    }
    if (given == 0u) return;
    intermix_given(pixel, given, given_at(0u).z);
}
