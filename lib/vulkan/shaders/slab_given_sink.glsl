// A sink that leaves slabs which may overlap, virtual ones of surfaces, in `given`. Those that do not fit join the last.
#include "slab_frame.glsl"
#define Sink Frame
uint sink_pixel, given_count, seen_slabs;
float given_nearest;
void start_giving(Frame f, uint pixel, uint number) {
    frame = f;
    own = number;
    sink_pixel = pixel;
    given_count = 0u;
    seen_slabs = 0u;
}
bool give_slab(Slab s) {
    if (given_count == 0u) given_nearest = s.z;
    ++seen_slabs;
    if (given_count == frame.given_room) {
        set_given(given_count - 1u, joined_slabs(given_at(given_count - 1u), s));
    } else {
        set_given(given_count, s);
        ++given_count;
    }
    return s.a < 1.0;
}
void finish_giving() {
    if (given_count == 0u) return;
    leave_arrival(sink_pixel, given_count, given_nearest);
    atomicAdd(frame.seen, seen_slabs);
}
#define sink_start(pixel) start_giving(sink, pixel, invocation_number())
#define sink_push(slab) give_slab(slab)
#define sink_finish() finish_giving()
