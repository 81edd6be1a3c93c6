// The work of a particle set by tiles: what a core or a workgroup draws while one tile's pixels stay near.
// for_each_span walks one repeat, tile by tile; TileSpans sorts the spans of all repeats by tile.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sample/particle_set.hpp"

namespace pellucid {

/// What one repeat has in one tile: consecutive runs, so consecutive particles.
struct TileSpan {
    std::uint32_t repeat;  // of the set, from 0
    std::uint32_t first_run;
    std::uint32_t end_run;
};

/// Spans sorted by tile, within a tile by repeat; no span is empty. Particles out of view are left out.
struct TileSpans {
    std::vector<TileSpan> spans;
    std::vector<std::uint32_t> tile_begin;  // first span of each tile, and their number

    TileSpans(const ParticleSet& set, std::size_t tiles);
    [[nodiscard]] std::span<const TileSpan> of(std::size_t tile) const {
        return std::span(spans).subspan(tile_begin[tile], tile_begin[tile + 1] - tile_begin[tile]);
    }
};

/// First particle of run `run` of the repeat; for run = their number, the number of particles.
[[nodiscard]] inline std::uint32_t run_begin(const RepeatParticles& repeat, std::uint32_t run) {
    return run < repeat.runs.size() ? repeat.runs[run].begin
                                    : static_cast<std::uint32_t>(repeat.particles.size());
}

/// take(tile, first run, end run) for every tile in view that the repeat has something in, in ascending
/// order. `objects`: of the set; `tiles`: of the image.
template <class Take>
void for_each_span(const RepeatParticles& repeat, std::uint32_t objects, std::size_t tiles,
                   const Take& take) {
    const auto runs = static_cast<std::uint32_t>(repeat.runs.size());
    for (std::uint32_t first = 0; first < runs;) {
        const std::uint32_t tile = repeat.runs[first].bin / objects;
        const std::uint64_t next_bin = (std::uint64_t{tile} + 1) * objects;
        std::uint32_t end = first + 1;
        while (end < runs && repeat.runs[end].bin < next_bin) ++end;
        if (tile < tiles) take(tile, first, end);
        first = end;
    }
}

}  // namespace pellucid
