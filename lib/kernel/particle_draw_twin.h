// What the shaders that draw particles read and write: the same structs on both sides, scalar layout.
#ifndef PELLUCID_KERNEL_PARTICLE_DRAW_TWIN_H
#define PELLUCID_KERNEL_PARTICLE_DRAW_TWIN_H
#include "kernel/particle_twin.h"
TWIN_BEGIN

// What one repeat has in one tile. The tile's repeats are drawn one after the other.
struct DrawSpan {
    uint first;          // particle of the buffer
    uint count;
    uint index;          // of the first one within its repeat: decides at equal depth
    uint first_run;
    uint end_run;
};

// Neighbours of one object.
struct DrawRun {
    uint first;          // particles of the buffer
    uint end;
    uint object;
};

// The work of one workgroup: some spans of one tile. Its keys and sums are those of its slot.
struct DrawItem {
    uint slot;
    uint first_span;
    uint end_span;
};

// Sums of one pixel over at most kPackedRepeats repeats, as few words as they fit into: on a device in
// software every access is a loop over the lanes. Colours below 2^20 units sum to 29 bits.
const uint kPackedRepeats = 512u;
struct PackedSums {
    uint64_t red_green;    // red << 29 | green; the highest 6 bits: covered >> 4
    uint64_t blue_depth;   // blue << 34 | (covered & 15) << 30 | nearness, below 2^30
    uint64_t red_square;
    uint64_t green_square;
    uint64_t blue_square;
};

// Depths lie in [0, 1]: 30 bits of float32. 0: nothing; else the larger the nearer.
TWIN_FN uint nearness_of(Particle q) { return 0x3fffffffu - min(floatBitsToUint(q.above_near), 0x3ffffffeu); }
TWIN_FN uint depth_of_nearness(uint nearness) {
    return nearness == 0u ? 0xffffffffu : 0x3fffffffu - nearness;
}

TWIN_FN uint packed_covered(PackedSums s) {
    return (uint(s.red_green >> 58) << 4u) | (uint(s.blue_depth >> 30) & 15u);
}
TWIN_FN uint packed_nearness(PackedSums s) { return uint(s.blue_depth) & 0x3fffffffu; }

// One winner more.
TWIN_FN PackedSums add_packed(PackedSums s, ColorUnits c, uint nearness) {
    uint covered = packed_covered(s) + 1u;
    uint64_t low = uint64_t(1) << 58;
    uint64_t colors = (s.red_green & (low - uint64_t(1))) + ((uint64_t(c.red) << 29) | uint64_t(c.green));
    uint64_t blue = (s.blue_depth >> 34) + uint64_t(c.blue);
    PackedSums r;
    r.red_green = (uint64_t(covered >> 4u) << 58) | colors;
    r.blue_depth =
        (blue << 34) | (uint64_t(covered & 15u) << 30) | uint64_t(max(packed_nearness(s), nearness));
    r.red_square = s.red_square + uint64_t(c.red) * uint64_t(c.red);
    r.green_square = s.green_square + uint64_t(c.green) * uint64_t(c.green);
    r.blue_square = s.blue_square + uint64_t(c.blue) * uint64_t(c.blue);
    return r;
}

// Sums of one pixel over all repeats: EnsembleSums::Pixel, with nearness for depth.
struct PixelSums {
    uint64_t red;
    uint64_t green;
    uint64_t blue;
    uint64_t red_square;
    uint64_t green_square;
    uint64_t blue_square;
    uint covered;
    uint nearness;
};

// Adds what many winners came to.
TWIN_FN PixelSums add_unpacked(PixelSums sum, PackedSums s) {
    uint64_t low = (uint64_t(1) << 29) - uint64_t(1);
    sum.red += (s.red_green >> 29) & low;
    sum.green += s.red_green & low;
    sum.blue += s.blue_depth >> 34;
    sum.red_square += s.red_square;
    sum.green_square += s.green_square;
    sum.blue_square += s.blue_square;
    sum.covered += packed_covered(s);
    sum.nearness = max(sum.nearness, packed_nearness(s));
    return sum;
}

// Everything else, in one buffer; the last ones are addresses of arrays.
struct DrawSetup {
    Projection projection;
    ShadingView view;
    uint tile_columns;
    uint slots_a_tile;
    uint64_t particles;  // Particle
    uint64_t runs;       // DrawRun
    uint64_t spans;      // DrawSpan
    uint64_t items;      // DrawItem
    uint64_t pixels;     // uint a particle: its pixel of the tile where it won, else kNoTilePixel
    uint64_t keys;       // uint64_t, kSlotPixels a slot
    uint64_t sums;       // PackedSums, kSlotPixels a slot
    uint64_t image;      // PixelSums, row by row
    uint64_t materials;  // Material
    uint64_t lights;     // ViewLight
    uint64_t texels;     // Vec3f
};

const uint kNoTilePixel = 0xffffffffu;
// The pixels of a tile, and behind them one for every invocation to write to that has won nothing: a write
// that all do is cheaper than a branch that some take.
const uint kMostGroup = 256u;
const uint kSlotPixels = uint(kTilePixels) + kMostGroup;

TWIN_END
#endif
