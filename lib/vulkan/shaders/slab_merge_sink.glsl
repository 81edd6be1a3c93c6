// A sink that merges the slabs of a ray with the pixel's array one by one, before any compression: hybrid intermixing.
#include "slab_frame.glsl"
#define Sink Frame
bool any_slab;
uint sink_pixel, seen_slabs;
void start_meeting(Frame f, uint pixel, uint number) {
    frame = f;
    own = number;
    sink_pixel = pixel;
    any_slab = false;
    seen_slabs = 0u;
}
bool meet_slab(Slab s) {
    if (!any_slab) {
        start_merging(sink_pixel);
        see(sink_pixel, slab_front(s));
    }
    any_slab = true;
    ++seen_slabs;
    return merge_slab(s);
}
void finish_meeting() {
    if (!any_slab) return;
    finish_merging();
    atomicAdd(frame.seen, seen_slabs);
}
#define sink_start(pixel) start_meeting(sink, pixel, invocation_number())
#define sink_push(slab) meet_slab(slab)
#define sink_finish() finish_meeting()
