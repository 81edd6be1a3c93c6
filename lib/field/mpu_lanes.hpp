// Lines along an axis through cells of an MPU surface, a line a SIMD lane.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "field/mpu.hpp"

namespace pellucid {

/// One line, unit cube. Where f is monotone between lo and hi.
struct MpuLaneLine {
    std::span<const std::uint32_t> leaves;  // all of one piece, at most kMpuLaneLeaves
    double at[2];                           // coordinates along the axes after `axis`, cyclic
    double lo, hi;
    double root;                            // out: NaN where there is none
    std::array<double, 3> gradient;         // out
};
inline constexpr std::size_t kMpuLaneLeaves = 96;

/// The same to the last bit for any instruction set and any neighbours.
void cross_mpu_lanes(const MpuLeaf* leaves, std::size_t axis, std::span<MpuLaneLine> lines);

}  // namespace pellucid
