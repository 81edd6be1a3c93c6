// A particle picture judged against its exact expectation: opacity pixel by pixel by the exact binomial,
// colour against the layered noise floor, the model's own bias at edges.
//
// All variances come from the truth (PixelFilter::particle), never from the drawn picture.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/image.hpp"
#include "core/random.hpp"
#include "measure/statistics.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct CoverageRule {
    double repeats = 500;  // L_R
    /// Pixels are tested where the truth's standard error is at most this share of the binomial's
    /// sqrt(p(1−p)/L_R). At 0.1 the error adds 1 % to a pixel's variance, as far as
    /// a variance from four sets of sub-rays can be known.
    double largest_error_share = 0.1;
    double sigmas = 3;
    Seed seed;  // of the randomised p-values
};

/// One tested pixel. `p_value` is uniform on (0, 1) and `z` standard normal under the theory, exactly.
struct PixelOutcome {
    std::size_t pixel = 0;
    double p_value = 0;
    double z = 0;
    bool outside = false;      // farther than `sigmas` from its mean
    double share_outside = 0;  // the chance of that
};

struct CoverageTest {
    std::vector<PixelOutcome> pixels;
    std::int64_t left_out = 0;      // 0 < A < 1, but the truth is not sharp enough there
    double worst_error_share = 0;   // truth's standard error over the binomial's, largest that was tested
    double mean_noise_share = 0;    // mean of that ratio's square: what the truth adds to the variance of z
    /// Mean over pixels of dz/dε where all optical depths are off by the factor 1 + ε.
    double sensitivity = 0;
    std::int64_t outside = 0;
    double outside_expected = 0;
    double outside_variance = 0;
    /// z of `outside`; p of the binomial law with the mean chance: its variance is a little larger than
    /// that of pixels with different chances, so p is conservative.
    TestResult outside_test;
    std::optional<TestResult> ks;    // of the p-values; empty without pixels
    std::optional<TestResult> chi2;  // the same in kPValueBins equal bins

    /// The smallest of the three p-values; 1 without pixels.
    [[nodiscard]] double smallest_p() const;
    [[nodiscard]] double outside_z() const { return outside_test.statistic; }
};

inline constexpr int kPValueBins = 50;

/// The number of covered repeats, drawn·L_R rounded, against Binomial(L_R, truth) in every pixel.
///   drawn, truth     one a pixel: opacity
///   chosen_variance  squared standard error of an *independent* tracing of the same scene, by which pixels
///                    are chosen. Not the truth's own: grazing rays make its law skew (the optical depth of
///                    the oblique law has an infinite variance at rims), so tracings that missed them are too
///                    low and look sharp, and choosing those makes a right drawing look too opaque.
[[nodiscard]] CoverageTest test_coverage(std::span<const float> drawn, std::span<const float> truth,
                                         std::span<const float> chosen_variance, const CoverageRule& rule);

/// Equal bins and what the theory expects in each.
struct Histogram {
    double lo = 0;
    double width = 0;
    std::vector<std::int64_t> counts;
    std::vector<double> expected;
};
/// Of the p-values, in kPValueBins bins.
[[nodiscard]] Histogram p_value_histogram(const CoverageTest& test);
/// Of z, −5 to 5 in steps of 0.2; the outer bins hold all beyond.
[[nodiscard]] Histogram z_histogram(const CoverageTest& test);

/// The shift of every z that the KS test sees in half of all cases: D(level)/φ(0), φ(0) the steepest
/// slope of the normal law.
[[nodiscard]] double smallest_shift_seen(std::size_t pixels, double level);

/// The truth's opacity where all particle densities are off by 1 + `error`: 1 − (1−A)^(1+error), exact
/// for PixelFilter::particle, whose A is 1 − exp(−mean optical depth). The wrong twin of an exact count.
[[nodiscard]] std::vector<float> opacity_off_by(std::span<const float> truth, double error);

/// Pixels where nothing may be drawn: the truth is 0 there and in all eight neighbours. Beside the
/// silhouette a sliver of surface may have slipped between all sub-rays of the truth: counted apart.
struct EmptyPixels {
    std::int64_t pixels = 0;
    std::int64_t drawn = 0;      // of them: not exactly 0
    std::int64_t rim = 0;        // truth 0, but not in all neighbours
    std::int64_t rim_drawn = 0;
};
[[nodiscard]] EmptyPixels test_empty(std::span<const float> drawn, std::span<const float> truth, int width);

/// RMSE over R, G, B of a particle picture, against what theory says it must be.
struct ColorTest {
    double rmse = 0;
    double floor = 0;        // sqrt(mean repeat_variance / L_R)
    double truth_error = 0;  // RMS standard error of the truth, which adds to it
    /// rmse / sqrt(floor² + truth_error²): independent errors without bias add in squares. 1 in theory.
    double ratio = 0;
    /// Standard error of `ratio`: channels taken as fully correlated, the fourth moment as that of covered
    /// or not (rare highlights have a larger one).
    double ratio_error = 0;
    double p_value = 1;      // two-sided, of (ratio − 1)/ratio_error
};
[[nodiscard]] ColorTest test_colors(const Image& drawn, const Image& truth, double repeats);

/// What particles converge to against the mean over the pixel's area.
struct EdgeBias {
    Image map;                // R, G, B, A: particle − box, signed
    double rmse = 0;          // R, G, B; the truths' own error is taken off (in squares, not below 0)
    double truth_error = 0;   // RMS standard error of the difference
    /// Of the covered pixels: colour off by more than one standard deviation of the particle picture
    /// and by more than three standard errors of the truths.
    double share_above_noise = 0;
};
[[nodiscard]] EdgeBias edge_bias(const Image& particle_truth, const Image& box_truth, double repeats);

/// The luminance (Rec. 709) of a signed map such that write_png stores the bytes 128 + 127·value/range:
/// 128 is none, 1 and 255 are ∓range and beyond.
[[nodiscard]] Image signed_grey(const Image& map, double range);

/// What a pixel shows, from the rays through its four corners.
struct SurfaceClass {
    std::uint32_t objects = 0;  // bit i: object i is crossed by one of them
    bool edge = false;          // not all of them cross every object equally often
};
/// One a pixel. Precondition: at most 32 objects.
[[nodiscard]] std::vector<SurfaceClass> surface_classes(const PreparedScene& scene);

/// Pixels outside the band among those of one class.
struct ClassOutcome {
    SurfaceClass surfaces;
    std::int64_t pixels = 0;
    std::int64_t outside = 0;
    double expected = 0;
    double variance = 0;
};
/// In order of (objects, edge); `classes` has one entry for each pixel of the picture.
[[nodiscard]] std::vector<ClassOutcome> outside_by_class(const CoverageTest& test, std::span<const SurfaceClass> classes);

}  // namespace pellucid
