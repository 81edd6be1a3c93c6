// Which surfaces of a scene become triangles, and which triangles: what rasterising methods draw.
//
//   mesh               its own triangles
//   rectangle, slice   two triangles; image and transfer function are asked at every fragment
//   implicit, expression, isosurface, points
//                      Marching Tetrahedra (sample/surface_mesh.hpp), fine enough that a facet's middle is nowhere
//                      farther from the surface than `error_px` pixels where the surface is nearest to the eye
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "io/mesh_file.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct TessellationSettings {
    double error_px = 0.25;  // > 0
};

/// One object as triangles.
struct ObjectMesh {
    std::uint32_t object = 0;                  // its number in PreparedScene::objects
    std::shared_ptr<const TriangleMesh> mesh;  // world
    std::vector<Vec3> view;                    // its positions in view space
    /// Normals of the mesh are gradients of the field that the surface is a zero of: they, interpolated, are the
    /// geometric normal, not those of facets.
    bool of_field = false;
    /// Largest distance of a facet's middle from the surface, |f|/|∇f|, in pixels where the surface is nearest: the
    /// facet's middle is where a chord is farthest from its arc. 0 where the triangles are the surface.
    double error_px = 0;

    [[nodiscard]] std::size_t bytes() const;
};

/// All triangles of a scene have one number: those of the first object, of the second, …
class SceneMeshes {
public:
    /// Where the cells that `error_px` asks for are more than kMostMeshCells, the error that is left is warned of.
    SceneMeshes(const PreparedScene& scene, const TessellationSettings& settings);

    [[nodiscard]] const std::vector<ObjectMesh>& objects() const { return objects_; }
    [[nodiscard]] std::size_t triangle_count() const { return first_.back(); }
    /// Number of an object's first triangle.
    [[nodiscard]] std::uint32_t first_triangle(std::size_t object) const { return first_[object]; }
    [[nodiscard]] std::size_t object_of(std::uint32_t triangle) const;
    /// Largest ObjectMesh::error_px.
    [[nodiscard]] double error_px() const;
    [[nodiscard]] std::size_t bytes() const;

private:
    std::vector<ObjectMesh> objects_;
    std::vector<std::uint32_t> first_;  // and the number of all
};

/// What SceneMeshes will hold: triangles are counted where they are known, and else scaled up from a coarse grid.
struct MeshPlan {
    std::size_t objects = 0, tessellated = 0;
    double triangles = 0;
    std::int64_t bytes = 0;
};
[[nodiscard]] MeshPlan plan_meshes(const PreparedScene& scene, const TessellationSettings& settings);

}  // namespace pellucid
