// A sink that compresses the slabs of a ray as they come, and leaves the array in `given`: image-level intermixing.
#include "slab_frame.glsl"
#define Sink Frame
float first_front;
uint sink_pixel, seen_slabs;
Slab unsettled_slab;
Unsettled unsettled;
void start_collecting(Frame f, uint pixel, uint number) {
    frame = f;
    own = number;
    sink_pixel = pixel;
    seen_slabs = 0u;
    unsettled.any = false;
    collector_start(frame.negligible);
}
void see_slab(Slab s) {
    if (seen_slabs == 0u) first_front = slab_front(s);
    ++seen_slabs;
}
bool collect_slab(Slab s) {
    see_slab(s);
    return collector_push(s);
}
bool take_slab(Slab s) {
    see_slab(s);
    unsettled_slab = s;
    return collector_take(s, unsettled);
}
void settle_slab() {
    if (unsettled.any) collector_open_another(unsettled_slab, unsettled.before, unsettled.drop);
    unsettled.any = false;
}
void finish_collecting() {
    if (seen_slabs == 0u) return;
    collector_finish();
    for (uint i = 0u; i < collector.count; ++i) set_given(i, node_at(i).slab);
    leave_arrival(sink_pixel, collector.count, first_front);
    atomicAdd(frame.seen, seen_slabs);
}
#define sink_start(pixel) start_collecting(sink, pixel, invocation_number())
#define sink_push(slab) collect_slab(slab)
#define sink_take(slab) take_slab(slab)
#define sink_is_settled() !unsettled.any
#define sink_settle() settle_slab()
#define sink_finish() finish_collecting()
