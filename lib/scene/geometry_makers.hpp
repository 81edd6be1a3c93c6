// One maker a kind of shape; used by geometry.cpp only.
#pragma once

#include <memory>

#include "core/error.hpp"
#include "field/expression.hpp"
#include "io/volume_file.hpp"
#include "scene/geometry.hpp"

namespace pellucid {

[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_implicit(const Surface& surface, const ImplicitShape& shape);
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_mesh(const Surface& surface, const MeshShape& shape);
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_rectangle(const Surface& surface, const RectangleShape& shape);
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_points(const Surface& surface, const PointsShape& shape);
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_slice(const Surface& surface, const SliceShape& shape);
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_isosurface(const Surface& surface, const IsosurfaceShape& shape);
/// Part of make_isosurface.
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_catmull_rom(std::shared_ptr<const VoxelGrid> grid, double isovalue,
                                                                const Affine& to_world);

[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_expression(const Surface& surface, const ExpressionShape& shape);
/// f = 0 in a box of object space.
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_field(const Surface& surface, const Expression& field, const Box& bounds);

}  // namespace pellucid
