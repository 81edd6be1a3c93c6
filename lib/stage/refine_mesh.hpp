// Triangles of a surface f = 0 made finer where they are off by too many pixels.
//
// An edge is off by the distance |f|/|∇f| of its middle from the surface, in pixels at that depth; so is a triangle. An edge
// that is off by too much, and all edges of such a triangle, are cut in two at their middle moved to f = 0: whether an edge is
// cut depends on nothing but the mesh, so both of its triangles agree and no crack opens. Second order: each round quarters the
// error where the surface is smooth. At nodes and creases the gradient vanishes: what does not find the surface is left.
#pragma once

#include <cstddef>

#include "io/mesh_file.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct RefinedMesh {
    TriangleMesh mesh;      // world; normals are the field's gradient, unit length or zero
    double error_px = 0;    // largest of an edge or a triangle that is in front of the eye
    std::size_t off = 0;    // triangles that are off by more than was asked
};

/// Precondition: the object has a field_surface(), and `mesh` is of it.
[[nodiscard]] RefinedMesh refine_mesh(const Object& object, const Camera& camera, TriangleMesh mesh, double error_px);

}  // namespace pellucid
