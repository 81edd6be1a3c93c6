// Triangles of a surface f = 0 that crosses itself or has cuspidal edges, where a grid's signs lose it: two sheets in one
// cell change no sign.
//
// Marching tetrahedra on tetrahedra that are bisected where the surface needs it: all in which f may vanish down to a few
// pixels, and further those over which the gradient turns (more than one sheet, or a singular place). An edge that has the
// same sign at both ends, with f falling towards zero from both, is cut where f is least: there the other side of a thin
// sheet begins. Edges are cut longest first (M.-C. Rivara, Algorithms for refining triangular grids suitable for adaptive and
// multigrid techniques, 1984), for all tetrahedra around an edge at once, in an order of edges that all agree on: no crack.
#pragma once

#include "field/scalar_field.hpp"
#include "io/mesh_file.hpp"
#include "scene/camera.hpp"

namespace pellucid {

struct SingularMeshSettings {
    double coarse_px = 6;  // longest edge anywhere
    double fine_px = 1.5;    // where the gradient turns
    std::size_t most_tetrahedra = std::size_t{1} << 21U;  // finer ones are not made; 60 bytes each
};

/// World; normals are the field's gradient, unit length or zero. The same for any number of threads.
[[nodiscard]] TriangleMesh singular_mesh(const FieldSurface& surface, const Camera& camera, const SingularMeshSettings& settings);

}  // namespace pellucid
