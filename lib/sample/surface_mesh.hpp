// A surface f = 0 as triangles: Marching Cubes, and tangent planes in the leaves of an octree.
//
// Marching Cubes: a vertex on every edge of a grid along which f changes its sign (sample/marching_blocks.hpp), put where f
// vanishes on the edge to rounding; blocks of the grid in which f surely has no zero are not evaluated. Every edge of a
// triangle inside the bounds belongs to two triangles: closed but at the bounds, at poles and at the border of what f has
// values on. Distance from the surface: of second order in the grid's spacing; sheets nearer to each other than that may be
// joined or missed. Octree (interval subdivision): a leaf in which f may vanish holds the polygon in which it is cut
// by the tangent plane at the surface's place nearest to its middle; neighbouring polygons do not meet exactly, of two
// sheets in one leaf there is one, and at sharp edges, where a leaf has one plane for two, the area is right to first
// order only. Tangent planes are cut at the bounds: surfaces that touch these from inside lose area there (closed
// catalogue surfaces do not). The samplers `mesh` and `octree` throw uniform points on these triangles.
//
// All are the same for any number of threads.
#pragma once

#include <cstddef>

#include "io/mesh_file.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct SurfaceTriangles {
    TriangleMesh mesh;       // world; normals are the field's gradient, or zero where it vanishes
    double error = 0;        // estimate of the largest distance from the surface, world: |f|/|∇f| in the triangles' middles and,
                             // of Marching Cubes, what normals say of their edges' middles. No bound: what a cell hides is not seen
    std::size_t dropped = 0;  // triangles at poles and gaps of the field, which are no surface; octree: leaves whose surface was lost
    int cells = 0;            // of the grid's longest edge; 0: no grid
};

/// Most cells along the longest edge of the bounds.
inline constexpr int kMostMeshCells = 1024;

/// `cells` along the longest edge of the bounds in the world, as many of nearly the same size along the others. Cut at the
/// bounds exactly; clip planes are left to Object::keeps. Degenerate triangles stay, so that neighbours meet. Throws
/// Error(input) where the object has no field.
[[nodiscard]] SurfaceTriangles tessellate(const FieldSurface& surface, int cells);
[[nodiscard]] SurfaceTriangles tessellate(const Object& object, int cells);

/// The field and bounds to make triangles of: a closed surface's bounds are a little wider than its own. Throws Error(input)
/// where the object has no field.
[[nodiscard]] FieldSurface surface_for_triangles(const Object& object);

/// Triangles for whoever draws them: with an `error` as above of at most that much (world, > 0), by grids of at most
/// kMostMeshCells; `error` of what is returned tells whether that was enough (at nodes, creases and apices it falls with the
/// spacing only). For an error in pixels: times the side of a pixel where the surface is nearest
/// (ViewThinning::least_pixel_area).
[[nodiscard]] SurfaceTriangles tessellate_within(const FieldSurface& surface, double error);
/// Of any surface: meshes as they are (without normals where the file has none), rectangles and slices as two triangles.
[[nodiscard]] SurfaceTriangles tessellate_within(const Object& object, double error);
/// SurfaceTriangles::cells of it.
[[nodiscard]] int cells_for_error(const Object& object, double error);

/// Leaves of a side of at most 1/cells of the longest edge of the bounds. Throws Error(input) where the object has no
/// field, or more than 2^24 leaves.
[[nodiscard]] SurfaceTriangles octree_triangles(const Object& object, int cells);

}  // namespace pellucid
