// LDR-FLIP: Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström & Fairchild 2020, "FLIP: A difference
// evaluator for alternating images", Proc. ACM Comput. Graph. Interact. Tech. 3(2).
#pragma once

#include <vector>

#include "core/image.hpp"
#include "measure/image_metrics.hpp"

namespace pellucid {

/// Pixels per degree of visual angle: 0.7 m before a 0.7 m wide screen of 3840 pixels, as the paper's default.
inline constexpr double kDefaultPixelsPerDegree = 67.02;

/// What flip() takes: below, the filters are narrower than a pixel; above, wider than any screen shows.
inline constexpr double kMinPixelsPerDegree = 1;
inline constexpr double kMaxPixelsPerDegree = 2000;

struct FlipError {
    double mean = 0;
    std::vector<double> map;  // one a pixel, [0, 1], rows from the top
};

/// The difference seen when flipping between the two pictures, per pixel and its mean. Symmetric.
/// Linear values are clamped to [0, 1] first. Borders are continued by their last pixel.
/// Preconditions: same size, at least one pixel; pixels_per_degree within the two limits above.
[[nodiscard]] FlipError flip(const RgbImage& test, const RgbImage& truth,
                             double pixels_per_degree = kDefaultPixelsPerDegree);

/// Values 0…1 (clamped) in the colours of "magma", as FLIP shows its maps: planes R, G, B, linear, such
/// that write_png stores exactly the bytes of the colour map.
/// Precondition: values.size() == width·height.
[[nodiscard]] Image magma_image(const std::vector<double>& values, int width, int height);

}  // namespace pellucid
