#include "sample/tile_mask.hpp"

#include <algorithm>
#include <cmath>

#include "core/box_corners.hpp"

namespace pellucid {

bool TileMask::any() const {
    return std::ranges::any_of(active, [](std::uint8_t each) { return each != 0; });
}

void TileMask::drop_others(std::vector<Particle>& particles, std::vector<std::uint32_t>& object_ends,
                           const twin::Projection& projection) const {
    std::uint32_t kept = 0;
    std::uint32_t begin = 0;
    for (std::uint32_t& end : object_ends) {
        for (std::uint32_t i = begin; i < end; ++i) {
            const twin::PixelDepth at = twin::project_quickly(projection, particles[i]);
            if (at.column >= 0 && active[grid.tile(at.column, at.row)] != 0) particles[kept++] = particles[i];
        }
        begin = end;
        end = kept;
    }
    particles.resize(kept);
}

bool TileMask::touches(const Box& box, const Camera& camera) const {
    Vec2 lo(kInfinity), hi(-kInfinity);
    for (const Vec3& corner : corners_of(box)) {
        const Vec3 view = camera.to_view(corner);
        if (camera.perspective() && !(view.z > camera.near() * 1e-3)) return true;
        const Vec2 pixel = camera.project(view);
        lo = glm::min(lo, pixel);
        hi = glm::max(hi, pixel);
    }
    // A pixel to spare: rounding.
    const auto tile_of = [](double pixel, std::uint32_t tiles) {
        return static_cast<std::uint32_t>(std::clamp(std::floor(pixel / twin::kTileSide), 0.0, tiles - 1.0));
    };
    for (std::uint32_t row = tile_of(lo.y - 1, grid.rows); row <= tile_of(hi.y + 1, grid.rows); ++row)
        for (std::uint32_t column = tile_of(lo.x - 1, grid.columns); column <= tile_of(hi.x + 1, grid.columns); ++column)
            if (active[std::size_t{row} * grid.columns + column] != 0) return true;
    return false;
}

}  // namespace pellucid
