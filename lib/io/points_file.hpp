// Scattered points with normals from .ply and .xyz.
#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <string_view>
#include <vector>

#include "core/vec.hpp"

namespace pellucid {

struct OrientedPoint {
    Vec3 position{0.0};
    std::array<float, 3> normal{};  // unit, outwards
};

/// What a file had that no surface can use; such points are left out.
struct DroppedPoints {
    std::size_t no_position = 0;  // NaN or infinite
    std::size_t no_normal = 0;    // NaN, infinite or zero
};

/// .ply: text or binary, vertices with x y z nx ny nz of any type, other elements passed over. .xyz: text, six numbers a
/// line, `#` comments. Points and normals that are not numbers are dropped, counted and warned of.
/// Throws Error(input), one line that names the file: not there, cut short, a header that claims more than the file holds,
/// no normals.
[[nodiscard]] std::vector<OrientedPoint> read_points(const std::filesystem::path& file);

/// The same of the bytes of a file (`extension`: ".ply" or ".xyz"), without warnings.
[[nodiscard]] std::vector<OrientedPoint> parse_points(const std::filesystem::path& file, std::string_view extension,
                                                      std::string_view bytes, DroppedPoints& dropped);

}  // namespace pellucid
