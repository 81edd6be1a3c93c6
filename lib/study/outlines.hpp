// Outlines, where a method with one sample a pixel is jagged whatever it does about crossings: left out where crossings
// are judged.
#pragma once

#include <cstdint>
#include <vector>

#include "core/image.hpp"
#include "measure/image_metrics.hpp"

namespace pellucid {

/// 1 for pixels within `reach` of an outline: where depth (plane Z) along a row or column turns by more than `jump`
/// from one pixel to the next (a second difference), or ends. Surfaces that cross have no jump in depth.
[[nodiscard]] std::vector<std::uint8_t> near_outlines(const Image& image, double jump, int reach);

/// `test` with the truth's colours where the mask says so.
[[nodiscard]] RgbImage without(const std::vector<std::uint8_t>& mask, RgbImage test, const RgbImage& truth);

}  // namespace pellucid
