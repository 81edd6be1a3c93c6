// Opaque particles of a scene, sampled for one view: repeat by repeat, 16 bytes each.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "kernel/projection_twin.h"
#include "scene/camera.hpp"

namespace pellucid {

using twin::Particle;

/// How stored particles relate to view space: coordinates are divided by 2^exponent, depth counts
/// from the near plane. So float32 keeps the order of two sheets that are close to each other and far
/// from the camera, and scenes of any size.
struct ParticleFrame {
    double near = 0;
    int exponent = 0;
    double shrink = 1;  // 2^-exponent

    explicit ParticleFrame(const Camera& camera);
    /// As stored: of a shard.
    ParticleFrame(double near_depth, int exponent_of_scale) : near(near_depth), exponent(exponent_of_scale) {}
    /// As stored; what lies before the near plane is put on it. `view_normal`: any length but 0.
    [[nodiscard]] Particle pack(const Vec3& view, const Vec3& view_normal) const;
    /// The same for a particle that carries its colour, 0 … 1 of its object's brightest: rounded up or down with the chance
    /// that keeps its mean, by a hash of its place.
    [[nodiscard]] Particle pack_painted(const Vec3& view, const Vec3& color) const;
    [[nodiscard]] Vec3 view_position(const Particle& particle) const;
    /// The integers by which every backend projects these particles.
    [[nodiscard]] twin::Projection projection(const Camera& camera) const;

private:
    /// The float32 side of it.
    void set_quick(twin::Projection& projection, const Camera& camera) const;
};

/// The image's tiles, row by row.
struct TileGrid {
    std::uint32_t columns, rows;

    TileGrid(int width, int height)
        : columns(static_cast<std::uint32_t>((width + twin::kTileSide - 1) >> twin::kTileShift)),
          rows(static_cast<std::uint32_t>((height + twin::kTileSide - 1) >> twin::kTileShift)) {}
    [[nodiscard]] std::size_t count() const { return std::size_t{columns} * rows; }
    [[nodiscard]] std::size_t tile(int column, int row) const {
        return static_cast<std::size_t>(row >> twin::kTileShift) * columns +
               static_cast<std::size_t>(column >> twin::kTileShift);
    }
    /// Column and row of pixel `local` (row · side + column) of a tile.
    [[nodiscard]] std::size_t column_of(std::size_t tile, std::size_t local) const {
        return (tile % columns << twin::kTileShift) + (local & (twin::kTileSide - 1));
    }
    [[nodiscard]] std::size_t row_of(std::size_t tile, std::size_t local) const {
        return (tile / columns << twin::kTileShift) + (local >> twin::kTileShift);
    }
};

/// Neighbours of one object in one tile: from `begin` to the next run's.
struct ParticleRun {
    std::uint32_t begin;
    std::uint32_t bin;  // tile · objects + object; a tile past the last holds what rounding put out of view
};

/// The particles of one repeat, sorted by tile, within a tile by object: a tile's pixels stay in a near cache
/// while they are drawn.
struct RepeatParticles {
    std::vector<Particle> particles;
    std::vector<ParticleRun> runs;  // none is empty

    /// The bin of particle `index`.
    [[nodiscard]] std::uint32_t bin_of(std::uint32_t index) const;
};

/// Sorts what comes object after object (`object_ends`: past the last of each); order within a run is kept.
/// Throws Error(run) where objects times tiles exceed 2^32.
[[nodiscard]] RepeatParticles sort_by_tile(std::span<const Particle> particles,
                                           std::span<const std::uint32_t> object_ends,
                                           const twin::Projection& projection);

struct ParticleSet {
    ParticleFrame frame;
    std::uint32_t objects = 0;
    std::vector<RepeatParticles> repeats;

    [[nodiscard]] std::uint64_t count() const;
    [[nodiscard]] std::uint64_t bytes() const;
};

}  // namespace pellucid
