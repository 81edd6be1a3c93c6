// The eight corners of a box, x fastest.
#pragma once

#include <array>

#include "core/vec.hpp"

namespace pellucid {

[[nodiscard]] inline Vec3 corner_of(const Box& box, std::size_t i) {
    return {(i & 1U) != 0 ? box.hi.x : box.lo.x, (i & 2U) != 0 ? box.hi.y : box.lo.y, (i & 4U) != 0 ? box.hi.z : box.lo.z};
}
[[nodiscard]] inline std::array<Vec3, 8> corners_of(const Box& box) {
    std::array<Vec3, 8> corners;
    for (std::size_t i = 0; i < 8; ++i) corners[i] = corner_of(box, i);
    return corners;
}
/// Those of a box that a map carries elsewhere.
[[nodiscard]] inline std::array<Vec3, 8> corners_of(const Affine& map, const Box& box) {
    std::array<Vec3, 8> corners = corners_of(box);
    for (Vec3& each : corners) each = map.point(each);
    return corners;
}
/// Bounds of what a map makes of a box.
[[nodiscard]] inline Box bounds_of(const Affine& map, const Box& box) {
    Box bounds;
    for (const Vec3& each : corners_of(map, box)) bounds.include(each);
    return bounds;
}

}  // namespace pellucid
