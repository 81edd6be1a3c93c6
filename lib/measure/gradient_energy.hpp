// Bands and blur as two numbers: where a picture has more gradient than its truth, and where it has less.
//
// An error of 0.1 spread over a picture is one thing to RMSE and many to the eye: as a slow drift it is not
// seen, as bands it is all that is seen (Mach). So gradients are compared, not values. Energies are averaged
// over a small window before they are, so that an edge in the wrong pixel is not a band.
#pragma once

#include "measure/image_metrics.hpp"

namespace pellucid {

/// Both are root mean squares over the picture, in linear colour per pixel.
struct GradientDifference {
    double excess = 0;  // bands, jags, noise: gradient that the truth does not have
    double lack = 0;    // blur: gradient of the truth that is missing
};

/// With E = g ∗ mean over channels of (∂x² + ∂y²), ∂ the differences between neighbours and g the Gaussian of
/// SSIM (σ = 1.5 pixels, 11×11, cut at the borders, weights sum to 1):
/// excess² = mean of max(0, E_test − E_truth), lack² = mean of max(0, E_truth − E_test).
/// Bands a·sin(2πx/p) on what is even have an excess of √2·a·|sin(π/p)|, whatever their phase.
/// The flanks of a blurred edge count as excess, a quarter or less of what its middle lacks.
/// Preconditions as for rmse.
[[nodiscard]] GradientDifference gradient_difference(const RgbImage& test, const RgbImage& truth);

}  // namespace pellucid
