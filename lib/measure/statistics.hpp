// Hypothesis tests, exact where counts are small, and running moments.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

namespace pellucid {

/// Level of each of `tests` tests such that all of them together have `family_level`, for independent
/// tests (Šidák 1967): 1 − (1 − level)^(1/tests).
///   family_level  (0, 1);  tests  >= 1
[[nodiscard]] double sidak_level(double family_level, double tests);

/// The |z| that a standard normal exceeds with probability `level` (both tails together), (0, 1).
[[nodiscard]] double normal_critical_value(double level);
/// The same for Student's t with `dof` > 0 degrees of freedom.
[[nodiscard]] double student_critical_value(double level, double dof);

/// The |z| above which one of `tests` two-sided tests is significant at the level of the whole family.
[[nodiscard]] double sidak_critical_value(double family_level, double tests);

/// Φ and its inverse. The quantile is finite for every p: p is clamped to the smallest normal double
/// and the largest below 1, which gives −37.5 and +8.2.
[[nodiscard]] double normal_cdf(double z);
[[nodiscard]] double normal_quantile(double p);

/// z of a law known by both of its tails, lower + upper = 1: full precision in either, within ±37.6.
[[nodiscard]] double z_from_tails(double lower, double upper);

/// P(|Z| >= |z|) of a standard normal.
[[nodiscard]] double normal_two_sided_p(double z);

struct BinomialLaw {
    double trials = 0;       // whole number >= 0
    double probability = 0;  // [0, 1]
};

[[nodiscard]] double binomial_pmf(double successes, const BinomialLaw& law);
/// P(X <= successes); 0 below 0, 1 from `trials` on.
[[nodiscard]] double binomial_cdf(double successes, const BinomialLaw& law);
/// P(X > successes), not by subtraction.
[[nodiscard]] double binomial_survival(double successes, const BinomialLaw& law);

/// Exact two-sided p-value: the probability of all outcomes that are not likelier than the one seen.
/// Conservative, as any test of a discrete law is.
[[nodiscard]] double binomial_two_sided_p(double successes, const BinomialLaw& law);

/// The outcome turned into a standard normal: Φ⁻¹ of the point at `uniform` in (0, 1) inside the step
/// of the CDF. Exactly N(0, 1) under the law, for any number of trials; finite for any outcome.
[[nodiscard]] double binomial_randomized_z(double successes, const BinomialLaw& law, double uniform);

/// Probability that a binomial count lies more than `sigmas` of its own standard deviations from its
/// mean: what a perfect renderer shows outside the three-sigma band. Exact, so 0 for a sure outcome.
[[nodiscard]] double binomial_share_outside(const BinomialLaw& law, double sigmas = 3);

struct TestResult {
    double statistic = 0;
    double p_value = 1;
};

/// Kolmogorov–Smirnov test that values in [0, 1] are uniform; Kolmogorov's law with the correction of
/// Vrbik (2018): p within 1e-3 from 20 values on (7e-3 at 5). Empty without values or with one that is NaN.
[[nodiscard]] std::optional<TestResult> ks_uniformity(std::span<const double> values);

/// Pearson's χ² test that counts come from equally likely bins; dof = bins − 1. Wants five or more
/// expected in each bin. Empty for fewer than two bins or no counts.
[[nodiscard]] std::optional<TestResult> chi2_uniformity(std::span<const std::int64_t> counts);

/// P(χ² >= statistic) for `dof` >= 1 degrees of freedom.
[[nodiscard]] double chi2_survival(double statistic, double dof);

/// The same with unequal bins: `shares` > 0 sum to 1, one a bin. Empty where sizes differ.
[[nodiscard]] std::optional<TestResult> chi2_test(std::span<const std::int64_t> counts, std::span<const double> shares);

/// Mean and variance of numbers as they come (Welford), and of two such sets together (Chan et al.).
class MeanVariance {
public:
    void add(double x);
    void merge(const MeanVariance& other);

    [[nodiscard]] std::int64_t count() const { return count_; }
    [[nodiscard]] double mean() const { return mean_; }  // 0 when empty
    /// Unbiased; 0 for fewer than two numbers.
    [[nodiscard]] double variance() const { return count_ > 1 ? squares_ / static_cast<double>(count_ - 1) : 0.0; }
    /// Of the mean; 0 for fewer than two numbers.
    [[nodiscard]] double standard_error() const;

private:
    std::int64_t count_ = 0;
    double mean_ = 0;
    double squares_ = 0;  // Σ (x − mean)²
};

/// The value below which the share `q` in [0, 1] of the values lies, linear between order statistics
/// (NumPy's default). Empty for no values.
[[nodiscard]] std::optional<double> quantile(std::span<const double> values, double q);
[[nodiscard]] std::optional<double> median(std::span<const double> values);

/// Spearman's rank correlation, ties by their mean rank, [-1, 1]; empty for fewer than two pairs and where one side is
/// all the same. Precondition: equal lengths, no NaN.
[[nodiscard]] std::optional<double> rank_correlation(std::span<const double> a, std::span<const double> b);

}  // namespace pellucid
