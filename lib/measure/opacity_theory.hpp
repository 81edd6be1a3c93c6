// The opacity that opaque particles draw on a flat patch. PBSR: Tanaka et al. 2012, "Particle-based
// transparent rendering of implicit surfaces", eq. (1) and section 3.
#pragma once

#include <optional>

namespace pellucid {

/// A flat piece of surface as one pixel sees it.
struct Patch {
    double ratio = 0;     // s/S: area seen by one pixel, across the ray, over area of the patch; > 0
    double cos_tilt = 1;  // |cosine| between geometric normal and the pixel's ray, (0, 1]
};

/// Opacity one pixel gets from `count` opaque particles uniform on the patch. PBSR (1), tilt: sec. 3.
///   count  >= 0; a mean may be fractional
/// Empty where ratio >= cos_tilt (a patch of less than one pixel is outside the theory), and for
/// arguments outside their range. expm1/log1p: the textbook form has no digits left below ratio 1e-8.
[[nodiscard]] std::optional<double> opacity_from_count(double count, const Patch& patch);

/// What the pixel lets through, 1 − opacity_from_count, to full relative precision near opacity 1.
[[nodiscard]] std::optional<double> transmittance_from_count(double count, const Patch& patch);

/// The (fractional) count that draws `opacity`, the inverse of (1): n = ln(1−α)/ln(1−s/(S cosθ)).
///   opacity  [0, 1); empty for 1, which no finite count reaches, and outside the theory
[[nodiscard]] std::optional<double> count_from_opacity(double opacity, const Patch& patch);

/// The limit S/s → ∞ of (1) at fixed count·ratio: 1 − exp(−n s/(S cosθ)). Exact for any patch where
/// the number of particles is itself Poisson with mean `count`. Empty for arguments out of range.
[[nodiscard]] std::optional<double> poisson_opacity(double count, const Patch& patch);

/// The ensemble's limit for a surface of `opacity` seen straight on: 1 − (1−α)^(1/|cosθ|).
/// Empty unless opacity is in [0, 1] and cos_tilt in (0, 1].
[[nodiscard]] std::optional<double> oblique_opacity(double opacity, double cos_tilt);

}  // namespace pellucid
