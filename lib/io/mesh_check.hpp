// A mesh file is walked through once before assimp gets it: assimp allocates what a header claims,
// makes up missing faces, mends indices that are out of range, or passes them on.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string_view>

namespace pellucid {

/// What a sound file announces; assimp's answer must agree.
struct MeshCounts {
    std::uint64_t vertices = 0;
    std::uint64_t faces = 0;  // of three corners and more
    bool shared = true;       // false: the format, or assimp's reader of it, repeats vertices at each corner
};

/// Walks the bytes of a .ply, .off, .stl or .obj file (`extension`, lower case) to their end.
/// Throws Error(input), one line that names the file and what is wrong: rows missing, counts that
/// the file cannot hold, an index out of range, no face, or not the format it is said to be.
[[nodiscard]] MeshCounts check_mesh(const std::filesystem::path& file, std::string_view extension,
                                    std::string_view bytes);

}  // namespace pellucid
