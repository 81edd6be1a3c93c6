// Triangle meshes from .ply, .obj, .off and .stl (assimp).
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "core/vec.hpp"

namespace pellucid {

struct TriangleMesh {
    std::vector<Vec3> positions;
    std::vector<std::array<std::uint32_t, 3>> triangles;  // counter-clockwise seen from outside
    std::vector<Vec3> normals;  // one a vertex, unit length, if the file has them; else empty
};

/// Reads a mesh; polygons are cut into triangles, lines and points are left out. Normals are taken
/// from the file, never computed; those of STL are of facets and not taken. Positions and normals
/// pass through float32 (assimp). Vertices keep the order and sharing of .ply and .off; in .obj and
/// .stl, which name or repeat them per corner, equal ones are joined in order of first use.
/// Throws Error(input), one line that names the file, where it is not there, cut short, damaged,
/// lies about its size, has no triangle, an index out of range, or a NaN or infinite coordinate.
/// Degenerate triangles (no area) are dropped with a counted warning.
[[nodiscard]] TriangleMesh read_mesh(const std::filesystem::path& file);

}  // namespace pellucid
