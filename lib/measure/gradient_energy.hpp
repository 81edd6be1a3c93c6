// Bands and blur as two numbers: where a picture has more gradient than its truth, and where it has less.
//
// An error of 0.1 spread over a picture is one thing to RMSE and many to the eye: as a slow drift it is not
// seen, as bands it is all that is seen (Mach). So gradients are compared, not values: those of the picture as the
// eye has it, blurred so that a gradient is largest at 8 cycles per degree, where the eye's contrast sensitivity is
// (J. Mannos, D. Sakrison, The effects of a visual fidelity criterion on the encoding of images, IEEE Trans.
// Information Theory 20, 1974; experiment visibility_interpolation sets both side by side). Energies are averaged over
// a small window before they are compared, so that an edge in the neighbouring pixel counts half, not twice.
#pragma once

#include "measure/flip.hpp"
#include "measure/image_metrics.hpp"

namespace pellucid {

/// Both are root mean squares over the picture, in linear colour per pixel.
struct GradientDifference {
    double excess = 0;  // bands, jags, noise: gradient that the truth does not have
    double lack = 0;    // blur: gradient of the truth that is missing
};

/// With E = g ∗ mean over channels of (∂x² + ∂y²)(h ∗ c), where ∂ are the differences between neighbours, h a Gaussian
/// of σ = pixels_per_degree/(2π·8) pixels (the picture goes on as its border is) and g that of SSIM (σ = 1.5 pixels,
/// 11×11, cut at the borders, weights sum to 1):
/// excess² = mean of max(0, E_test − E_truth), lack² = mean of max(0, E_truth − E_test).
/// Bands a·sin(2πx/p) on what is even have an excess of √2·a·|sin(π/p)|·H(p), H what h leaves of them, whatever their
/// phase. The flanks of a blurred edge count as excess, a quarter or less of what its middle lacks.
///   pixels_per_degree  of visual angle; near 0: the pixels as they are
/// Preconditions as for rmse.
[[nodiscard]] GradientDifference gradient_difference(const RgbImage& test, const RgbImage& truth,
                                                     double pixels_per_degree = kDefaultPixelsPerDegree);

/// Contrast sensitivity of the eye by Mannos and Sakrison, 1 at its largest: 2.6·(0.0192 + 0.114 f)·exp(−(0.114 f)^1.1).
[[nodiscard]] double contrast_sensitivity(double cycles_per_degree);

}  // namespace pellucid
