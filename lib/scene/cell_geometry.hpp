// Surfaces in cells (field/surface_cells.hpp): formulas, Catmull-Rom volumes, points. A cell is a patch.
#pragma once

#include <memory>

#include "field/surface_cells.hpp"
#include "scene/geometry.hpp"

namespace pellucid {

/// What such a surface is, in object space.
struct CellSurface {
    std::shared_ptr<const SurfaceCells> cells;
    std::shared_ptr<const ScalarField> field;  // its zeros
    Box bounds;                                // of the field
    double cell_width = 0;                     // as FieldSurface
    int max_crossings = SurfaceCells::kMostRoots;  // of a cell
    std::size_t bytes = 0;                     // of all
};

[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_cell_geometry(CellSurface surface, const Affine& to_world);

}  // namespace pellucid
