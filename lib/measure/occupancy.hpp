// How many pixels opaque particles cover: the occupancy law behind the drawn opacity, and the test of
// a drawn count against it. Classical occupancy: Johnson & Kotz 1977, "Urn models".
//
// One repeat throws n particles independently; a pixel is covered when at least one lands in it.
// Exactly n particles make pixels compete (binomial counts, negatively correlated pixels); a Poisson
// number of them leaves pixels independent. Both are here: a renderer must say which it draws.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace pellucid {

/// M whole pixels inside a flat patch that spans ν pixels: a particle lands in each with chance 1/ν.
struct PatchPixels {
    double particles = 0;  // n, whole number >= 0
    double pixels = 1;     // M, whole number >= 1
    double span = 1;       // ν = S cosθ/s, need not be whole, >= M
};

/// Pixels that a particle lands in with the same chance.
struct PixelClass {
    double landing = 0;  // p of one pixel, [0, 1]; Σ p over all pixels <= 1 up to rounding
    double pixels = 0;   // how many, whole number >= 0
};

/// Most classes that pixel_classes makes: the variance costs their square, and at 512 logarithmic
/// classes over a factor of 10 in p the grouping moves the variance by a few 1e-6 of itself.
inline constexpr std::size_t kMaxPixelClasses = 512;

/// Landing chances grouped: exactly while at most kMaxPixelClasses values are distinct, else in
/// classes of equal width in log p, each with the mean of its pixels, so that Σ p is kept.
[[nodiscard]] std::vector<PixelClass> pixel_classes(std::span<const double> landing);

/// The covered share of all pixels in one repeat. `uncovered` = 1 − mean, kept because the
/// subtraction would lose it near opacity 1.
struct CoveredShare {
    double mean = 0;
    double uncovered = 1;
    double variance = 0;
    double pixels = 0;  // M
};

/// Mean 1 − q₁ and variance [M q₁ + M(M−1) q₂ − M² q₁²]/M², q_k = (1 − k/ν)^n. Relative precision
/// about 1e-13, at any M, ν, n, where the printed form has none for large M or small n/ν.
[[nodiscard]] CoveredShare covered_share(const PatchPixels& patch);

/// The same for pixels with different landing chances, exactly `particles` (whole number) thrown.
/// Relative precision of the variance about 1e-11; classes at most a few thousand (cost: square).
[[nodiscard]] CoveredShare covered_share(double particles, std::span<const PixelClass> classes);

/// The same with a Poisson number of particles of mean `mean_particles` >= 0: pixels are independent.
[[nodiscard]] CoveredShare covered_share_poisson(double mean_particles, std::span<const PixelClass> classes);

/// A law on whole numbers: P(first + i) = probability[i]. Ends below 1e-40 are cut off.
struct CountLaw {
    std::int64_t first = 0;
    std::vector<double> probability;
};

/// The exact law of the number of covered pixels in one repeat, by dynamic programming over particles
/// inside (sums of positive terms, no cancellation). Empty where that takes more than about 1e8
/// additions: roughly min(n, hits inside)·(width of the law).
[[nodiscard]] std::optional<CountLaw> covered_law(const PatchPixels& patch);

/// The law of the sum of `repeats` >= 1 independent counts. Empty past about 1e8 multiplications.
[[nodiscard]] std::optional<CountLaw> law_of_sum(const CountLaw& law, std::int64_t repeats);

/// A drawn total as a standard normal under the theory.
///
/// * (x − μ)/σ where the normal law is good: expected covered and uncovered totals both >= 1000 and
///   σ >= 20. The total is a sum of independent indicators (Vatutin & Mikhailov 1982: the generating
///   function of occupancy has only real roots), so Berry–Esseen bounds the error of the CDF by
///   0.56/σ; the lattice step alone is 0.2/σ.
/// * else the exact law, and Φ⁻¹ of the point at `uniform` inside the step of its CDF: N(0, 1) exactly.
/// * else, where neither fits (rare events in very many pixels), the binomial law that matches mean and
///   variance of the rarer of covered and uncovered, randomised in the same way. For negatively
///   related indicators even the Poisson law is within 1 − σ²/μ of the truth in total variation
///   (Barbour, Holst & Janson 1992, th. 2.C.2): matching σ² as well removes that leading term.
///
///   covered_total  covered pixels summed over all repeats, whole number
///   repeats        whole number >= 1
///   uniform        a random number in (0, 1), independent of the drawing
/// Finite for any total, also one that the theory excludes (then about −37.5 or 37.5).
[[nodiscard]] double covered_z_score(double covered_total, double repeats, const PatchPixels& patch, double uniform);

/// The same for pixels of different chances; without the exact law. The indicators are negatively
/// associated, so the bound of the last case holds.
[[nodiscard]] double covered_z_score(double covered_total, double repeats, double particles,
                                     std::span<const PixelClass> classes, double uniform);

/// The same with a Poisson number of particles. Exact for a single class (a binomial law); several
/// classes: normal where it is good, else the matched binomial.
[[nodiscard]] double covered_z_score_poisson(double covered_total, double repeats, double mean_particles,
                                             std::span<const PixelClass> classes, double uniform);

}  // namespace pellucid
