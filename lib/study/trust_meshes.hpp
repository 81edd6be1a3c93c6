// Closed meshes made by formula, and scenes of one surface: what rays are shot at to find out about the
// truth.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "io/mesh_file.hpp"
#include "io/temporary_folder.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct NamedMesh {
    std::string name;
    TriangleMesh mesh;  // closed; size about 1, centred near 0
};

/// An icosahedron subdivided `levels` times, vertices on the unit sphere: 20·4^levels triangles.
[[nodiscard]] TriangleMesh icosphere(int levels);
/// A torus of radii 1 and 0.4, around × across quadrilaterals cut in two.
[[nodiscard]] TriangleMesh torus_grid(int around, int across);
/// [-1, 1]³ of twelve triangles: many of its diagonals and edges lie on one another in projection.
[[nodiscard]] TriangleMesh cube_mesh();
/// A needle: a prism of length 2 with `sides` sides of width `width`, closed by two fans: slivers of aspect
/// 2/width.
[[nodiscard]] TriangleMesh sliver_prism(int sides, double width);
/// `count` closed plates [-1, 1]² of thickness `gap`, as far apart, around z = 0: layers that a step may jump
/// over.
[[nodiscard]] TriangleMesh thin_plates(int count, double gap);

/// Every edge belongs to an even number of triangles, so that every ray has an even number of hits, on
/// surfaces with one side too. Vertices at one place count as one.
[[nodiscard]] bool is_closed(const TriangleMesh& mesh);

/// Triangles as ASCII OFF, coordinates as float32 holds them.
void write_off(const std::filesystem::path& file, const TriangleMesh& mesh);

/// Where a surface of size about 1 is put: x ↦ scale·(x + offset).
struct Placement {
    double scale = 1;
    Vec3 offset{0.0};  // in sizes of the surface

    [[nodiscard]] Affine affine() const { return {Mat3(scale), scale * offset}; }
};

/// A scene of these surfaces whose orthographic camera stands 4 radii before them: only its near and far
/// planes matter, and they let pass whatever lies in the surfaces' box.
[[nodiscard]] PreparedScene scene_for_lines(std::vector<Surface> surfaces);
/// The same of one mesh, through a file.
[[nodiscard]] PreparedScene mesh_for_lines(const std::filesystem::path& file, const Placement& placement);

}  // namespace pellucid
