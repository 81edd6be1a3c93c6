// STEP 3 of PBSR: the sums of all slots of a tile become those of the image. An invocation is one pixel of the
// padded image (tile after tile); it reads its own sums in every slot of its tile, and writes its own pixel.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#include "kernel/particle_draw_twin.h"

layout(local_size_x_id = 0) in;

layout(buffer_reference, scalar) readonly buffer Setup { DrawSetup it; };
layout(buffer_reference, scalar) readonly buffer Sums { PixelSums at[]; };
layout(buffer_reference, scalar) writeonly buffer Image { PixelSums at[]; };
layout(push_constant, scalar) uniform Push {
    Setup setup;
    uint pixel_count;    // of all tiles
};

void main() {
    uint number = (gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y) * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (number >= pixel_count) return;
    uint tile = number / uint(kTilePixels);
    uint local = number % uint(kTilePixels);
    int column = int(tile % setup.it.tile_columns) * kTileSide + int(local & uint(kTileSide - 1));
    int row = int(tile / setup.it.tile_columns) * kTileSide + int(local >> uint(kTileShift));
    if (column >= setup.it.projection.width || row >= setup.it.projection.height) return;
    PixelSums sum = PixelSums(uint64_t(0), uint64_t(0), uint64_t(0), uint64_t(0), uint64_t(0), uint64_t(0), 0u, 0u);
    for (uint part = 0u; part < setup.it.slots_a_tile; ++part) {
        PixelSums s = Sums(setup.it.sums).at[(tile * setup.it.slots_a_tile + part) * uint(kTilePixels) + local];
        sum.red += s.red;
        sum.green += s.green;
        sum.blue += s.blue;
        sum.red_square += s.red_square;
        sum.green_square += s.green_square;
        sum.blue_square += s.blue_square;
        sum.covered += s.covered;
        sum.nearness = max(sum.nearness, s.nearness);
    }
    Image(setup.it.image).at[row * setup.it.projection.width + column] = sum;
}
