// One maker a kind of shape; used by geometry.cpp only.
#pragma once

#include <memory>

#include "core/error.hpp"
#include "scene/geometry.hpp"

namespace pellucid {

[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_implicit(const Surface& surface, const ImplicitShape& shape);
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_mesh(const Surface& surface, const MeshShape& shape);
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_rectangle(const Surface& surface, const RectangleShape& shape);
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_isosurface(const Surface& surface, const IsosurfaceShape& shape);

}  // namespace pellucid
