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

// Neighbours of one object: up to the next run of the span.
struct DrawRun {
    uint first;          // particle of the buffer
    uint object;
};

// The work of one workgroup: some spans of one tile. Its keys and sums are those of its slot.
struct DrawItem {
    uint slot;
    uint first_span;
    uint end_span;
};

// Sums of one pixel over repeats, as EnsembleSums::Pixel has them.
struct PixelSums {
    uint64_t red;
    uint64_t green;
    uint64_t blue;
    uint64_t red_square;
    uint64_t green_square;
    uint64_t blue_square;
    uint covered;
    uint nearness;       // ~depth, the largest: so that nothing is all zeros
};

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
    uint64_t keys;       // uint64_t, kTilePixels a slot
    uint64_t sums;       // PixelSums, kTilePixels a slot
    uint64_t image;      // PixelSums, row by row
    uint64_t materials;  // Material
    uint64_t lights;     // ViewLight
    uint64_t texels;     // Vec3f
};

const uint kNoTilePixel = 0xffffffffu;

// Nearest first; at equal depth the lower of the scrambled indices.
TWIN_FN uint64_t particle_key(Particle q, uint index) {
    return (uint64_t(floatBitsToUint(q.above_near)) << 32) | uint64_t(scramble_index(index));
}

TWIN_END
#endif
