// Gradients of an MPU field at several places from one list of leaves, a place a SIMD lane.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "field/mpu.hpp"

namespace pellucid {

/// A place of the unit cube each; a whole number of the widest vectors.
inline constexpr std::size_t kMpuPlaces = 8;
using MpuPlaces = std::array<std::array<double, kMpuPlaces>, 3>;  // x, y, z

/// mpu_gradient (field/mpu_lines.hpp) to the last bit, but for the sign of zeros, on every instruction set. Leaves of the
/// list: all of one piece.
[[nodiscard]] MpuPlaces mpu_gradients(const MpuLeaf* leaves, std::span<const std::uint32_t> list, const MpuPlaces& places);

}  // namespace pellucid
