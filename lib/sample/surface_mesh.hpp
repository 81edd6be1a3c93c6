// A surface f = 0 as triangles: Marching Tetrahedra by the GNU Triangulated Surface Library (gts_isosurface_tetra), and
// by tangent planes in the leaves of an octree.
//
// Marching Tetrahedra: places on the edges of tetrahedra where f changes its sign, moved to f = 0 by a step of Newton's
// method; blocks of the grid in which f surely has no zero are not evaluated. Distance from the surface: of second order
// in the grid's spacing. Octree (interval subdivision): a leaf in which f may vanish holds the polygon in which it is cut
// by the tangent plane at the surface's place nearest to its middle; neighbouring polygons do not meet exactly, of two
// sheets in one leaf there is one, and at sharp edges, where a leaf has one plane for two, the area is right to first order only.
// Tangent planes are cut at the bounds: surfaces that touch these from inside lose area there (closed catalogue surfaces do not). The samplers `mesh` and `octree` throw uniform points on these triangles.
#pragma once

#include <cstddef>

#include "io/mesh_file.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct SurfaceTriangles {
    TriangleMesh mesh;       // world; normals are the field's gradient
    double error = 0;        // largest distance of a triangle's middle from the surface, |f|/|∇f|, world
    std::size_t dropped = 0;  // triangles at poles and gaps of the field, which are no surface; octree: leaves whose surface was lost
};

/// Most cells along the longest edge of the bounds.
inline constexpr int kMostMeshCells = 1024;

/// `cells` along the longest edge of the bounds in the world, as many of nearly the same size along the others. Cut at the
/// bounds exactly; clip planes are left to Object::keeps. Throws Error(input) where the object has no field.
[[nodiscard]] SurfaceTriangles tessellate(const Object& object, int cells);
/// Cells for an error of at most `error` (world), from that of coarse grids: at most kMostMeshCells. For an error in
/// pixels: times the side of a pixel where the surface is nearest (ViewThinning::least_pixel_area).
[[nodiscard]] int cells_for_error(const Object& object, double error);

/// Leaves of a side of at most 1/cells of the longest edge of the bounds. Throws Error(input) where the object has no
/// field, or more than 2^24 leaves.
[[nodiscard]] SurfaceTriangles octree_triangles(const Object& object, int cells);

}  // namespace pellucid
