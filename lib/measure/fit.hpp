// Least-squares fits of drawn opacities to PBSR (1), and of errors to a power of the repeats.
// Ceres underneath, kept out of this header.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace pellucid {

/// One of the tilts that a point mixes.
struct RingPart {
    double weight = 0;  // > 0, all together 1
    double cos_tilt = 1;
};

/// One measured opacity.
struct OpacityPoint {
    double count = 0;           // n, particles on the patch
    double ratio = 0;           // s/S
    double cos_tilt = 1;        // (0, 1]
    double alpha_drawn = 0;
    double alpha_variance = 0;  // of alpha_drawn, from theory, never from the drawn image
    std::vector<RingPart> ring = {};  // not empty: α = Σ weight·α(cos_tilt), and cos_tilt is not used
};

struct FitParameter {
    std::string name;
    double value = 0;
    double standard_error = 0;
    double low = 0;  // interval at the asked level, by the normal law
    double high = 0;
};

struct FitResult {
    std::vector<FitParameter> parameters;
    std::vector<double> covariance;  // parameters × parameters, row by row
    double chi2 = 0;                 // Σ ((model − drawn)/σ)² at the minimum
    double dof = 0;                  // points used − parameters
    double p_value = 1;              // P(χ² >= chi2); 1 where dof = 0
    std::size_t used = 0;
    std::size_t skipped = 0;         // points without information, see below
    bool converged = false;          // only then do the numbers above mean anything
};

/// Which of the two parameters of
///     α = 1 − (1 − a·ratio/cos^p θ)^n
/// are free; a fixed one is 1, which is the theory. PBSR (1) and sec. 3.
///   a  effective area: pixels that one particle covers
///   p  exponent of the tilt
enum class OpacityModel { effective_area, tilt_exponent, both };

/// Weighted fit with the points' variances taken as known (they are not rescaled by χ²/dof).
///   level  of the intervals, (0, 1)
/// Skipped: points whose variance is not positive and finite, whose values are not finite, whose theory
/// (a = p = 1) does not exist (ratio >= cos_tilt) or rounds to 0 or 1. The drawn value decides nothing:
/// leaving out what happened to be drawn as 0 or 1 would bias the fit. Not converged where fewer points
/// than parameters are left, or where they cannot tell the parameters apart (p without any tilt).
[[nodiscard]] FitResult fit_opacity(std::span<const OpacityPoint> points, OpacityModel model, double level = 0.95);

/// χ² of the points under the theory with nothing fitted, dof = points used.
[[nodiscard]] FitResult test_opacity(std::span<const OpacityPoint> points);

/// A fixed number of particles, α = 1 − (1 − a·s/(S cosθ))^n, against a Poisson number of the same
/// mean, α = 1 − exp(−n a·s/(S cosθ)). Mean curves only: both sides use the points' variances, those of a fixed
/// number, though the covered share of a Poisson number varies more.
struct CountLawComparison {
    struct Side {
        double chi2_theory = 0;          // a = 1
        double log_likelihood_theory = 0;  // Gaussian, with its constant
        FitResult free_area;             // a fitted
        double log_likelihood_free = 0;
    };
    Side binomial;
    Side poisson;
    /// What delta_chi2_theory is on average under the fixed number, from theory alone: Σ ((α_P − α_B)/σ)².
    double expected_delta_chi2 = 0;
    double delta_chi2_theory = 0;     // poisson − binomial, > 0 speaks for a fixed number
    double delta_chi2_free = 0;
    double akaike_weight_binomial = 0.5;  // of the four hypotheses {law} × {a = 1, a free}: both of the law
    double log10_bayes_factor = 0;        // binomial over Poisson at a = 1; equal parameters, so BIC is exact here
    double log10_bayes_factor_free = 0;   // the same with a free, by BIC: Δχ²/(2 ln 10)
};

/// Empty where no point carries information or a fit did not converge.
[[nodiscard]] std::optional<CountLawComparison> compare_count_laws(std::span<const OpacityPoint> points,
                                                                   double level = 0.95);

/// An error measured at a number of repeats.
struct ErrorPoint {
    double repeats = 0;         // > 0
    double error = 0;           // > 0
    double relative_error = 0;  // standard error of `error` over `error`; 0 in all points = unknown
};

/// error = factor · repeats^slope: parameters "slope" (−½ for independent repeats) and "log_factor"
/// (natural logarithm), linear in log–log. Where no point has a relative_error the scatter about the line
/// gives the standard errors and Student's t the intervals, and p_value is 1. Skipped: values not > 0.
[[nodiscard]] FitResult fit_power_law(std::span<const ErrorPoint> points, double level = 0.95);

}  // namespace pellucid
