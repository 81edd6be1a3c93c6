// Lines of the world through the cells of a surface.
#pragma once

#include "field/surface_cells.hpp"
#include "scene/geometry.hpp"

namespace pellucid {

/// Where the cells of a surface stand in the world.
struct PlacedCells {
    const SurfaceCells* cells;
    Affine to_world;
    Affine to_object;
    Vec3 center{0.0};  // of the surface, about; object space

    [[nodiscard]] Body body(const Box& box) const;
    /// SurfaceGeometry::crossings of one cell.
    int crossings(std::size_t cell, const Line& line, CrossingList& out) const;
};

}  // namespace pellucid
