// The plainest sink: all slabs of a pixel in a row, for tests. `count` goes on where there is no more room.
//
// A sink is included before a shader that casts, and gives it: the buffer reference Sink, which the shader
// has in its push constants as `sink`; sink_start(pixel), sink_push(slab), false where nothing behind is
// seen, and sink_finish(), each once or more an invocation. Room of an invocation's own goes by
// invocation_number(), below the caster's band_rays().
// One may part sink_push(): sink_take(slab) does what takes little, sink_settle() the rest, if sink_is_settled() says that
// there is any; so that in software, where a vector's rays go through all that one of them needs, they wait for one another.
layout(buffer_reference, scalar) buffer SlabLists { Slab at[]; };
layout(buffer_reference, scalar) buffer SlabCounts { uint at[]; };
layout(buffer_reference, scalar) readonly buffer Sink {
    uint64_t slabs;   // Slab: `room` a pixel
    uint64_t counts;  // uint a pixel
    uint room;
    float opaque_at;  // as SlabList
};
struct ListState {
    uint pixel;
    uint count;
    float clear;
} list;

void open_list(uint pixel) {
    list.pixel = pixel;
    list.count = 0u;
    list.clear = 1.0;
}
bool append(Sink sink, Slab slab) {
    if (list.count < sink.room) SlabLists(sink.slabs).at[list.pixel * sink.room + list.count] = slab;
    ++list.count;
    precise float clear = list.clear * (1.0 - slab.a);
    list.clear = clear;
    precise float least = 1.0 - sink.opaque_at;
    return list.clear > least;
}
#define sink_start(pixel) open_list(pixel)
#define sink_push(slab) append(sink, slab)
#define sink_finish() SlabCounts(sink.counts).at[list.pixel] = list.count
