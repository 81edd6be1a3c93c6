// STEP 3 of PBSR: the sums of all slots of a tile are added to those of the image, and are zero again. An
// invocation is one pixel of the padded image (tile after tile); it reads and clears its own sums in every
// slot of its tile, and writes its own pixel.
#version 450
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#include "kernel/particle_draw_twin.h"

layout(local_size_x_id = 0) in;

layout(buffer_reference, scalar) readonly buffer Setup { DrawSetup it; };
layout(buffer_reference, scalar) buffer Sums { PackedSums at[]; };
layout(buffer_reference, scalar) buffer Image { PixelSums at[]; };
layout(push_constant, scalar) uniform Push {
    Setup setup;
    uint pixel_count;    // of all tiles
};

void main() {
    uint group = gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y;
    uint number = group * gl_WorkGroupSize.x + gl_LocalInvocationID.x;
    if (number >= pixel_count) return;
    uint tile = number / uint(kTilePixels);
    uint local = number % uint(kTilePixels);
    int column = int(tile % setup.it.tile_columns) * kTileSide + int(local & uint(kTileSide - 1));
    int row = int(tile / setup.it.tile_columns) * kTileSide + int(local >> uint(kTileShift));
    if (column >= setup.it.projection.width || row >= setup.it.projection.height) return;
    Image image = Image(setup.it.image);
    Sums sums = Sums(setup.it.sums);
    uint place = uint(row * setup.it.projection.width + column);
    PixelSums sum = image.at[place];
    for (uint part = 0u; part < setup.it.slots_a_tile; ++part) {
        uint from = (tile * setup.it.slots_a_tile + part) * kSlotPixels + local;
        sum = add_unpacked(sum, sums.at[from]);
        sums.at[from] = PackedSums(uint64_t(0), uint64_t(0), uint64_t(0), uint64_t(0), uint64_t(0));
    }
    image.at[place] = sum;
}
