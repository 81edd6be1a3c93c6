#include "stage/tile_spans.hpp"

namespace pellucid {

TileSpans::TileSpans(const ParticleSet& set, std::size_t tiles) : tile_begin(tiles + 1, 0) {
    for (const RepeatParticles& repeat : set.repeats)
        for_each_span(repeat, set.objects, tiles,
                      [&](std::uint32_t tile, auto, auto) { ++tile_begin[tile + 1]; });
    for (std::size_t tile = 0; tile < tiles; ++tile) tile_begin[tile + 1] += tile_begin[tile];
    spans.resize(tile_begin[tiles]);
    std::vector<std::uint32_t> next(tile_begin.begin(), tile_begin.end() - 1);
    for (std::uint32_t r = 0; r < set.repeats.size(); ++r)
        for_each_span(set.repeats[r], set.objects, tiles,
                      [&](std::uint32_t tile, std::uint32_t first, std::uint32_t end) {
                          spans[next[tile]++] = {r, first, end};
                      });
}

}  // namespace pellucid
