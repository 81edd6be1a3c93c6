// Which tiles of an image are still drawn: of adaptive runs, in which tiles stop one by one.
#pragma once

#include <cstdint>
#include <vector>

#include "sample/particle_set.hpp"
#include "sample/particle_source.hpp"
#include "scene/camera.hpp"

namespace pellucid {

struct TileMask {
    TileGrid grid;
    std::vector<std::uint8_t> active;  // one a tile

    TileMask(int width, int height) : grid(width, height), active(grid.count(), 1) {}
    [[nodiscard]] bool any() const;
    /// Particles in active tiles stay, in their order; `object_ends` follow.
    void drop_others(std::vector<Particle>& particles, std::vector<std::uint32_t>& object_ends,
                     const twin::Projection& projection) const;
    /// False where nothing of a box (world) can fall into an active tile.
    [[nodiscard]] bool touches(const Box& box, const Camera& camera) const;
};

}  // namespace pellucid
