// Arrays of zSlabs on a device, an invocation a pixel: the z-thickness buffer, merging in one scan, insertion and
// compression, each with the operations of the CPU in their order (stage/slab_merge.cpp, stage/slab_compression.cpp,
// stage/z_thickness_buffer.cpp).
//
// An invocation works in rooms of its own, `stride` invocations side by side: `nodes` of the collector, their `costs`,
// `merged` arrays (2(N - 1) slabs) and `given` ones, of slabs that may overlap.
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#include "kernel/intermix_twin.h"
#include "kernel/z_thickness_twin.h"

// As SlabSettings and SlabFormat; what is not chosen is not there.
layout(constant_id = 12) const uint kInterpolationOfSlabs = 0;
layout(constant_id = 13) const uint kMixingOfSlabs = 0;
layout(constant_id = 14) const uint kCompression = 2;
layout(constant_id = 15) const uint kFormat = 0;

const uint kTail = 0u;  // as SlabCompression
const uint kSlope = 1u;
const uint kTransmittance = 2u;
const float kNothingPasses = 1e-30;
const float kTouching = 0.015625;
const float kSteepest = 1e30;
const float kNeverJoins = 3.4e38;  // for infinity, which a device need not have
const uint kCostShift = 8u;
const float kToleranceStep = 4.0;

struct CollectorNode {
    Slab slab;
    float before;  // transmittance in front of it
    float error;   // what merging within it has cost
};
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer FrameWords { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer FrameFloats { float at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer FrameSlabs { Slab at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer CollectorNodes { CollectorNode at[]; };
// What a ray has left in `given`.
struct Arrival {
    uint pixel;
    uint count;
    float nearest;
};
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Arrivals { Arrival at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 8) buffer Frame {
    uint64_t words, flags, nearest;              // of the z-thickness buffer; float a pixel
    uint64_t nodes, costs, merged, given, arrivals;  // rooms
    uint stride;                                 // invocations
    uint layers;
    float opaque_at;
    float negligible;                            // what merging may cost along a ray from the start
    uint given_room;                             // slabs of `given`
    uint seen;                                   // slabs that came, all pixels
};

Frame frame;
uint own;  // which rooms

uint most_slabs() { return frame.layers - 1u; }
float divide(float a, float b) { return float(double(a) / double(b)); }  // to the nearest, on every device

Slab merged_at(uint i) { return FrameSlabs(frame.merged).at[i * frame.stride + own]; }
void set_merged(uint i, Slab s) { FrameSlabs(frame.merged).at[i * frame.stride + own] = s; }
Slab given_at(uint i) { return FrameSlabs(frame.given).at[i * frame.stride + own]; }
void set_given(uint i, Slab s) { FrameSlabs(frame.given).at[i * frame.stride + own] = s; }
CollectorNode node_at(uint i) { return CollectorNodes(frame.nodes).at[i * frame.stride + own]; }
void set_node(uint i, CollectorNode n) { CollectorNodes(frame.nodes).at[i * frame.stride + own] = n; }
float cost_at(uint i) { return FrameFloats(frame.costs).at[i * frame.stride + own]; }
void set_cost(uint i, float c) { FrameFloats(frame.costs).at[i * frame.stride + own] = c; }

Slab no_slab() { return Slab(0.0, 0.0, 0.0, 0.0, 0.0, 0.0); }

// ---- The z-thickness buffer

uint words_of_slab() { return kFormat == kFormatFloat ? 6u : 3u; }
uint64_t word_number(uint pixel, uint layer) {
    return (uint64_t(pixel) * frame.layers + layer) * words_of_slab();
}
bool touched(uint pixel) { return (FrameWords(frame.flags).at[pixel / 32u] >> (pixel % 32u) & 1u) != 0u; }
Slab stored_slab(uint pixel, uint layer) {
    FrameWords from = FrameWords(frame.words + 4ul * word_number(pixel, layer));
    SlabWords w = SlabWords(from.at[0], from.at[1], from.at[2], 0u, 0u, 0u);
    if (kFormat == kFormatFloat) {
        w.w3 = from.at[3];
        w.w4 = from.at[4];
        w.w5 = from.at[5];
    }
    return unpack_slab(w, kFormat);
}
void store_words(uint pixel, uint layer, SlabWords w) {
    FrameWords to = FrameWords(frame.words + 4ul * word_number(pixel, layer));
    to.at[0] = w.w0;
    to.at[1] = w.w1;
    to.at[2] = w.w2;
    if (kFormat != kFormatFloat) return;
    to.at[3] = w.w3;
    to.at[4] = w.w4;
    to.at[5] = w.w5;
}

// What is written comes from two places.
const uint kFromMerged = 0u;
const uint kFromNodes = 1u;
const uint kFromGiven = 2u;
Slab slab_from(uint place, uint i) {
    if (place == kFromNodes) return node_at(i).slab;
    if (place == kFromGiven) return given_at(i);
    return merged_at(i);
}

void write_pixel(uint pixel, uint place, uint count) {
    Slab sum = no_slab();
    Slab slab = sum;
    float begin = 0.0;
    float end = -kNeverJoins;
    uint kept = 0u;
    for (uint i = 0u; i < count; ++i) {
        slab = slab_from(place, i);
        if (i == 0u) begin = slab_front(slab);
        sum = slab_over(sum, slab);
        SlabWords words = pack_behind(slab, end, kFormat);
        Slab seen = unpack_slab(words, kFormat);
        if (is_no_slab(seen)) continue;
        ++kept;
        store_words(pixel, kept, words);
        end = seen.z;
    }
    if (count > 0u) {
        sum.z = slab.z;
        sum.d = count == 1u ? slab.d : thickness_between(begin, sum.z);
    }
    store_words(pixel, 0u, pack_slab(sum, kFormat));
    if (kept < most_slabs()) store_words(pixel, kept + 1u, pack_slab(no_slab(), kFormat));
    atomicOr(FrameWords(frame.flags).at[pixel / 32u], 1u << (pixel % 32u));
}

// ---- Compression as slabs come: SlabCollector

struct Collector {
    Slab open;
    float front, clear;  // of the open slab: where it begins, what passes it
    float before, error;
    uint slabs;  // in it
    uint count;  // nodes in use
    float passing;
    float tolerance;
} collector;

uint collector_room() { return kCompression == kTransmittance ? max(2u * most_slabs(), 8u) : most_slabs(); }

float area_to_chord(float a, float gap, float b, float drop_a, float drop_b) {
    precise float length = a + gap + b;
    if (!(length > 0.0)) return 0.0;
    precise float drops = drop_a + drop_b;
    precise float slope = divide(drops, length);
    precise float e1 = slope * a - drop_a;
    precise float e2 = slope * (a + gap) - drop_a;
    precise float sides = abs(e1) * a + abs(e2) * b;
    precise float sum = abs(e1) + abs(e2);
    if (!(sum > 0.0)) return 0.0;
    precise float product = e1 * e2;
    precise float squares = e1 * e1 + e2 * e2;
    float middle = product >= 0.0 ? sum : divide(squares, sum);
    precise float twice = sides + middle * gap;
    precise float area = twice * 0.5;
    return area;
}
float cost_between(float a, float drop_a, float gap, float b, float drop_b) {
    precise float touching = kTouching * b;
    if (gap <= touching) {
        precise float cost = 0.5 * abs(b * drop_a - a * drop_b);
        return cost;
    }
    return area_to_chord(a, max(gap, 0.0), b, drop_a, drop_b);
}
float gap_before(Slab slab, float end) {
    precise float gap = slab_front(slab) - end;
    return gap;
}
float node_drop(CollectorNode n) {
    precise float drop = n.before * n.slab.a;
    return drop;
}
float cost_of_nodes(CollectorNode a, CollectorNode b) {
    return cost_between(a.slab.d, node_drop(a), gap_before(b.slab, a.slab.z), b.slab.d, node_drop(b));
}
float slope_of(float d, float drop) { return d > 0.0 ? min(divide(drop, d), kSteepest) : kSteepest; }
float change_of_slope(float a, float drop_a, float gap, float b, float drop_b) {
    precise float touching = kTouching * b;
    if (gap > touching) return kNeverJoins;
    precise float change = slope_of(b, drop_b) - slope_of(a, drop_a);
    return abs(change);
}

Slab joined_slabs(Slab a, Slab b) {
    Slab s = slab_over(a, b);
    s.d = thickness_between(slab_front(a), b.z);
    s.z = b.z;
    return s;
}

void collector_open(Slab s, float before, float error) {
    collector.open = s;
    collector.front = slab_front(s);
    precise float clear = 1.0 - s.a;
    collector.clear = clear;
    collector.before = before;
    collector.error = error;
    collector.slabs = 1u;
}
void collector_join(Slab s) {
    precise float r = collector.open.r + collector.clear * s.r;
    precise float g = collector.open.g + collector.clear * s.g;
    precise float b = collector.open.b + collector.clear * s.b;
    precise float a = collector.open.a + collector.clear * s.a;
    precise float clear = collector.clear * (1.0 - s.a);
    collector.open = Slab(s.z, collector.open.d, r, g, b, a);
    collector.clear = clear;
    ++collector.slabs;
}

void collector_sweep() {
    float least = kNeverJoins;
    uint sum = 0u;
    uint count = collector.count;
    CollectorNode here = node_at(0u);
    for (uint i = 0u; i + 1u < count; ++i) {
        CollectorNode next = node_at(i + 1u);
        precise float cost = here.error + next.error + cost_of_nodes(here, next);
        set_cost(i, cost);
        least = min(least, cost);
        sum += floatBitsToUint(cost) >> kCostShift;
        here = next;
    }
    precise float mean = kToleranceStep * uintBitsToFloat((sum / (count - 1u)) << kCostShift);
    collector.tolerance = max(max(collector.tolerance, least), mean);
    uint kept = 0u;
    for (uint i = 0u; i < count; ++kept) {
        CollectorNode n = node_at(i);
        bool pair = i + 1u < count && cost_at(i) <= collector.tolerance;
        if (pair) {
            n.slab = joined_slabs(n.slab, node_at(i + 1u).slab);
            n.error = cost_at(i);
        }
        set_node(kept, n);
        i += pair ? 2u : 1u;
    }
    collector.count = kept;
}
void collector_close() {
    if (collector.count == collector_room()) collector_sweep();
    CollectorNode n = CollectorNode(collector.open, collector.before, collector.error);
    if (collector.slabs != 1u) {
        n.slab.d = thickness_between(collector.front, n.slab.z);
        n.slab.a = min(n.slab.a, 1.0);
    }
    set_node(collector.count, n);
    ++collector.count;
}
void merge_nodes(uint i) {
    CollectorNode n = node_at(i);
    n.slab = joined_slabs(n.slab, node_at(i + 1u).slab);
    set_node(i, n);
    for (uint k = i + 1u; k + 1u < collector.count; ++k) set_node(k, node_at(k + 1u));
    --collector.count;
}
void collector_open_another(Slab s, float before, float drop) {
    collector_close();
    if (kCompression == kSlope && collector.count == most_slabs()) {
        uint best = collector.count - 1u;  // the last with the new one
        float least = kNeverJoins;
        for (uint i = 0u; i < collector.count; ++i) {
            CollectorNode a = node_at(i);
            bool last = i + 1u == collector.count;
            Slab next = s;
            float next_drop = drop;
            if (!last) {
                CollectorNode n = node_at(i + 1u);
                next = n.slab;
                next_drop = node_drop(n);
            }
            float change = change_of_slope(a.slab.d, node_drop(a), gap_before(next, a.slab.z), next.d, next_drop);
            if (change < least) {
                least = change;
                best = i;
            }
        }
        if (least < kNeverJoins) collector.tolerance = max(collector.tolerance, least);
        if (best + 1u == collector.count) {
            --collector.count;
            CollectorNode last = node_at(collector.count);
            collector_open(last.slab, last.before, 0.0);
            collector_join(s);
            return;
        }
        merge_nodes(best);
    }
    collector_open(s, before, 0.0);
}
bool collector_joins(Slab s, float drop) {
    precise float length = collector.open.z - collector.front;
    precise float open_drop = collector.before * collector.open.a;
    float gap = gap_before(s, collector.open.z);
    if (kCompression == kTransmittance) {
        precise float error = collector.error + cost_between(length, open_drop, gap, s.d, drop);
        if (!(error <= collector.tolerance)) return false;
        collector_join(s);
        collector.error = error;
        return true;
    }
    bool joins = collector.count + 1u == most_slabs();
    if (kCompression == kSlope)
        joins = change_of_slope(length, open_drop, gap, s.d, drop) < collector.tolerance;
    if (joins) collector_join(s);
    return joins;
}

void collector_start(float negligible) {
    collector.count = 0u;
    collector.slabs = 0u;
    collector.passing = 1.0;
    collector.tolerance = negligible;
}
// What of a slab neither opens the first nor joins the last one: collector_settle() comes before the next.
struct Unsettled {
    bool any;
    float before, drop;
};
// False: nothing behind is seen.
bool collector_take(Slab s, out Unsettled left) {
    float before = collector.passing;
    left = Unsettled(false, before, 0.0);
    if (before <= kNothingPasses) return false;
    precise float drop = before * s.a;
    precise float passing = before * (1.0 - s.a);
    collector.passing = passing;
    left.drop = drop;
    if (collector.slabs == 0u) collector_open(s, before, 0.0);
    else left.any = !collector_joins(s, drop);
    precise float least = 1.0 - frame.opaque_at;
    return passing > max(least, kNothingPasses);
}
bool collector_push(Slab s) {
    Unsettled left;
    bool more = collector_take(s, left);
    if (left.any) collector_open_another(s, left.before, left.drop);
    return more;
}
// Nodes 0 … collector.count − 1 are the array.
void collector_finish() {
    if (collector.slabs > 0u) collector_close();
    collector.slabs = 0u;
    if (collector.count <= most_slabs()) return;
    for (uint i = 0u; i + 1u < collector.count; ++i) set_cost(i, cost_of_nodes(node_at(i), node_at(i + 1u)));
    while (collector.count > most_slabs()) {
        uint best = 0u;
        float least = cost_at(0u);
        for (uint i = 1u; i + 1u < collector.count; ++i)
            if (cost_at(i) < least) {
                least = cost_at(i);
                best = i;
            }
        merge_nodes(best);
        for (uint i = best; i < collector.count; ++i) set_cost(i, cost_at(i + 1u));
        if (best > 0u) set_cost(best - 1u, cost_of_nodes(node_at(best - 1u), node_at(best)));
        if (best + 1u < collector.count) set_cost(best, cost_of_nodes(node_at(best), node_at(best + 1u)));
    }
}

// ---- Merging, as merge_arrays, of which array B comes slab by slab

struct Merging {
    uint pixel;
    uint next;     // layer of A's slab
    bool a_left;   // whether there is any
    Slab a;        // what is left of it
    float passing; // of what came out
    bool ended;    // too little passes
    uint count;    // slabs that came out, as long as they fit into `merged`
    bool collects; // they did not: they go to the collector
} merging;

void take_stored() {
    ++merging.next;
    merging.a_left = merging.next <= most_slabs();
    if (!merging.a_left) return;
    merging.a = stored_slab(merging.pixel, merging.next);
    merging.a_left = !is_no_slab(merging.a);
}
void start_merging(uint pixel) {
    merging.pixel = pixel;
    merging.next = 0u;
    merging.a_left = false;
    merging.passing = 1.0;
    merging.ended = false;
    merging.count = 0u;
    merging.collects = false;
    if (touched(pixel)) take_stored();
}
// Out of the scan. More slabs than layers are compressed.
void emit_merged(Slab s) {
    if (merging.ended) return;
    if (!merging.collects && merging.count == most_slabs()) {
        merging.collects = true;
        collector_start(0.0);
        for (uint i = 0u; i < merging.count; ++i)
            if (!collector_push(merged_at(i))) break;
    }
    if (merging.collects) {
        if (!collector_push(s)) merging.ended = true;
    } else {
        set_merged(merging.count, s);
    }
    ++merging.count;
    precise float passing = merging.passing * (1.0 - s.a);
    precise float least = 1.0 - frame.opaque_at;
    merging.passing = passing;
    if (!(passing > least)) merging.ended = true;
}
bool merge_slab(Slab b) {
    for (bool left = true; left && !merging.ended;) {
        if (!merging.a_left) {
            emit_merged(b);
            break;
        }
        MergeStep step = merge_step(merging.a, b, kInterpolationOfSlabs, kMixingOfSlabs);
        emit_merged(step.out_slab);
        merging.a = step.a;
        b = step.b;
        left = step.b_used == 0u;
        if (step.a_used != 0u) take_stored();
    }
    return !merging.ended;
}
void finish_merging() {
    while (merging.a_left && !merging.ended) {
        emit_merged(merging.a);
        take_stored();
    }
    if (merging.collects) {
        collector_finish();
        write_pixel(merging.pixel, kFromNodes, collector.count);
    } else {
        write_pixel(merging.pixel, kFromMerged, merging.count);
    }
}

// Of an invocation whose rooms others read later. (Field by field: glslc 2022.4 crashes on the whole structure.)
void leave_arrival(uint pixel, uint count, float nearest) {
    Arrivals arrivals = Arrivals(frame.arrivals);
    arrivals.at[own].pixel = pixel;
    arrivals.at[own].count = count;
    arrivals.at[own].nearest = nearest;
}

void see(uint pixel, float nearest) {
    FrameFloats all = FrameFloats(frame.nearest);
    all.at[pixel] = min(all.at[pixel], nearest);
}

// SlabFrame::intermix of an array in `place`, which is not `merged`.
void intermix_array(uint pixel, uint place, uint count, float nearest) {
    if (count == 0u) return;
    see(pixel, nearest);
    if (!touched(pixel) && count <= most_slabs()) {
        write_pixel(pixel, place, count);
        return;
    }
    start_merging(pixel);
    for (uint i = 0u; i < count; ++i)
        if (!merge_slab(slab_from(place, i))) break;
    finish_merging();
}

// ---- Slabs that may overlap, by back depth: SlabFrame::intermix_overlapping

// insert_slab, in a part of `given` that begins at `first`.
uint insert_given(uint count, Slab carried) {
    float front = slab_front(carried);
    uint at = 0u;
    while (at < count && given_at(at).z < front) ++at;
    for (; at < count; ++at) {
        Slab there = given_at(at);
        bool carried_first = carried.z <= there.z;
        Intermixed r = intermix(pick_slab(carried_first, carried, there), pick_slab(carried_first, there, carried),
                                kInterpolationOfSlabs, kMixingOfSlabs);
        set_given(at, r.integrated);
        if (r.remains == 0u) return count;
        carried = r.remaining;
        if (carried_first) {
            for (uint k = count; k > at + 1u; --k) set_given(k, given_at(k - 1u));
            set_given(at + 1u, carried);
            return count + 1u;
        }
    }
    set_given(count, carried);
    return count + 1u;
}
// `given` holds `count` slabs.
void intermix_given(uint pixel, uint count, float nearest) {
    if (count == 0u) return;
    bool overlap = false;
    for (uint i = 1u; i < count; ++i) overlap = overlap || slab_front(given_at(i)) < given_at(i - 1u).z;
    if (overlap) {
        // In place: what is read next is not yet part of the array, which is never longer than what was read.
        uint length = 1u;
        for (uint i = 1u; i < count; ++i) length = insert_given(length, given_at(i));
        count = length;
    }
    if (count <= most_slabs()) {
        intermix_array(pixel, kFromGiven, count, nearest);
        return;
    }
    collector_start(0.0);
    for (uint i = 0u; i < count; ++i)
        if (!collector_push(given_at(i))) break;
    collector_finish();
    // The collector may be needed once more.
    count = collector.count;
    for (uint i = 0u; i < count; ++i) set_given(i, node_at(i).slab);
    intermix_array(pixel, kFromGiven, count, nearest);
}
