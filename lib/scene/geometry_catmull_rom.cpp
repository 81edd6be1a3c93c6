// Isosurfaces of Catmull-Rom volumes: a patch for every cell with a part of the surface.
#include "field/catmull_rom.hpp"
#include "scene/cell_geometry.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {

std::unique_ptr<SurfaceGeometry> make_catmull_rom(std::shared_ptr<const VoxelGrid> grid, double isovalue,
                                                  const Affine& to_world) {
    const Affine placed = compose(to_world, grid->index_to_world);
    const auto cells =
        std::make_shared<const CatmullRomCells>(std::make_shared<VolumeField>(grid, Interpolation::catmull_rom), isovalue);
    if (cells->lost() > 0) warn("isosurface: {} cells beside a NaN or infinite voxel are empty", cells->lost());
    return make_cell_geometry({.cells = cells,
                               .field = {cells, &cells->field()},
                               .bounds = cells->field().volume().hull(),
                               .cell_width = 1,
                               .max_crossings = 9,
                               .bytes = cells->bytes()},
                              placed);
}

}  // namespace pellucid
