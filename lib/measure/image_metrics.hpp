// How far two pictures are apart: RMSE, MAE, PSNR, SSIM. (FLIP has its own header.)
//
// All sums run in double, a row at a time, then over the rows: the same bits for any thread count.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string_view>
#include <vector>

#include "core/image.hpp"
#include "core/vec.hpp"

namespace pellucid {

/// A picture as it is judged: linear colours over a background, nothing transparent left.
struct RgbImage {
    int width = 0;
    int height = 0;
    std::array<std::vector<double>, 3> channels;  // R, G, B; rows from the top

    [[nodiscard]] std::size_t pixel_count() const {
        return static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    }
};

/// RGB + (1 − A)·background; A = 1 where there is no plane A. Not clamped.
///   name  the file, for messages
/// Throws Error(input) for an empty image, a missing channel R, G or B, and a value of R, G, B, A that
/// is NaN or infinite (first pixel and count named). Other planes are not looked at.
[[nodiscard]] RgbImage over_background(const Image& image, const Vec3& background, std::string_view name);

// Both images of a pair: the same size, at least one pixel (precondition).

/// Root of the mean square of all differences, three channels a pixel. Linear, unclamped.
[[nodiscard]] double rmse(const RgbImage& test, const RgbImage& truth);

/// Mean absolute difference, three channels a pixel. Linear, unclamped.
[[nodiscard]] double mae(const RgbImage& test, const RgbImage& truth);

/// 20·log10(1/rmse) dB: peak 1, values not clamped. Empty when the images are equal.
[[nodiscard]] std::optional<double> psnr(const RgbImage& test, const RgbImage& truth);

/// Mean structural similarity of the luminance (Rec. 709 of linear RGB, unclamped), dynamic range 1:
/// Wang, Bovik, Sheikh & Simoncelli 2004. Gaussian window σ = 1.5, 11×11, weights sum to 1, K = 0.01 and
/// 0.03, biased local moments; mean over the pixels whose whole window lies in the image.
/// Empty where there is none: an image narrower or lower than 11 pixels has no SSIM.
[[nodiscard]] std::optional<double> ssim(const RgbImage& test, const RgbImage& truth);

/// |test − truth| of each channel as a picture (planes R, G, B), for the eye.
[[nodiscard]] Image absolute_error_map(const RgbImage& test, const RgbImage& truth);

}  // namespace pellucid
