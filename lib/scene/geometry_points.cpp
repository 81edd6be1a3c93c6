// Surfaces through points with normals: MPU implicits, the cells of whose octree are the patches.
#include "field/mpu_cells.hpp"
#include "io/points_file.hpp"
#include "scene/cell_geometry.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

struct PointSurface {
    MpuField field;
    MpuCells cells{field};
    explicit PointSurface(std::vector<OrientedPoint> points) : field(std::move(points)) {}
};

[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_points(std::vector<OrientedPoint> points, const Affine& to_world) {
    const auto both = std::make_shared<const PointSurface>(std::move(points));
    return make_cell_geometry({.cells = {both, &both->cells},
                               .field = {both, &both->field},
                               .bounds = both->field.bounds(),
                               .cell_width = both->cells.typical_width(),
                               .bytes = both->field.bytes() + both->cells.bytes()},
                              to_world);
}

}  // namespace

std::unique_ptr<SurfaceGeometry> make_points(const Surface& surface, const PointsShape& shape) {
    try {
        return make_points(read_points(shape.file), surface.to_world);
    } catch (const Error& error) {
        // What the fit says does not name the file.
        const std::string file = shape.file.string();
        if (std::string_view(error.what()).find(file) != std::string_view::npos) throw;
        throw Error(error.kind(), fmt::format("{}: {}", file, error.what()));
    }
}

}  // namespace pellucid
