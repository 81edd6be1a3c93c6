#include "measure/statistics.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <vector>

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wsign-conversion"
#include <boost/math/distributions/students_t.hpp>
#include <boost/math/special_functions/beta.hpp>
#include <boost/math/special_functions/erf.hpp>
#include <boost/math/special_functions/gamma.hpp>
#pragma GCC diagnostic pop

namespace pellucid {
namespace {

/// Values at the ends of their range come back as 0 or infinity, not as exceptions.
using Quiet = boost::math::policies::policy<
    boost::math::policies::overflow_error<boost::math::policies::ignore_error>,
    boost::math::policies::underflow_error<boost::math::policies::ignore_error>,
    boost::math::policies::evaluation_error<boost::math::policies::ignore_error>,
    boost::math::policies::promote_double<false>>;

[[maybe_unused]] bool is_law(const BinomialLaw& law) {
    return law.trials >= 0 && law.probability >= 0 && law.probability <= 1;
}

/// P(sup |F_n − F| sqrt(n) > x) as n → ∞ (Kolmogorov 1933). Two series, each used where it converges
/// in a few terms; they are the two sides of Jacobi's theta identity.
double kolmogorov_survival(double x) {
    if (x <= 0) return 1;
    if (x < 1) {
        const double pi = std::numbers::pi;
        double cdf = 0;
        for (int k = 1; k <= 9; k += 2) cdf += std::exp(-k * k * pi * pi / (8 * x * x));
        return 1 - cdf * std::sqrt(2 * pi) / x;
    }
    double survival = 0;
    for (int k = 1; k <= 9; ++k) survival += (k % 2 == 1 ? 2 : -2) * std::exp(-2.0 * k * k * x * x);
    return survival;
}

std::optional<TestResult> chi2_of(std::span<const std::int64_t> counts, auto share_of_bin) {
    const auto total = static_cast<double>(std::accumulate(counts.begin(), counts.end(), std::int64_t{0}));
    if (counts.size() < 2 || total <= 0) return std::nullopt;
    double statistic = 0;
    for (std::size_t i = 0; i < counts.size(); ++i) {
        const double expected = total * share_of_bin(i);
        const double off = static_cast<double>(counts[i]) - expected;
        statistic += off * off / expected;
    }
    return TestResult{statistic, chi2_survival(statistic, static_cast<double>(counts.size() - 1))};
}

}  // namespace

double sidak_level(double family_level, double tests) {
    assert(family_level > 0 && family_level < 1 && tests >= 1);
    return -std::expm1(std::log1p(-family_level) / tests);
}

double student_critical_value(double level, double dof) {
    return boost::math::quantile(boost::math::complement(boost::math::students_t(dof), 0.5 * level));
}

double normal_critical_value(double level) { return -normal_quantile(0.5 * level); }

double sidak_critical_value(double family_level, double tests) {
    return normal_critical_value(sidak_level(family_level, tests));
}

double normal_cdf(double z) { return 0.5 * std::erfc(-z / std::numbers::sqrt2); }

double normal_quantile(double p) {
    constexpr double kBelowOne = 1 - std::numeric_limits<double>::epsilon() / 2;
    const double clamped = std::clamp(p, std::numeric_limits<double>::min(), kBelowOne);
    return -std::numbers::sqrt2 * boost::math::erfc_inv(2 * clamped, Quiet());
}

double z_from_tails(double lower, double upper) {
    return lower <= upper ? normal_quantile(lower) : -normal_quantile(upper);
}

double normal_two_sided_p(double z) { return std::erfc(std::abs(z) / std::numbers::sqrt2); }

double binomial_pmf(double successes, const BinomialLaw& law) {
    assert(is_law(law));
    const double n = law.trials;
    const double k = successes;
    if (k < 0 || k > n) return 0;
    if (law.probability <= 0) return k == 0 ? 1 : 0;
    if (law.probability >= 1) return k == n ? 1 : 0;
    // C(n,k) p^k q^(n−k) as the derivative of the incomplete beta function, over n + 1.
    return boost::math::ibeta_derivative(k + 1, n - k + 1, law.probability, Quiet()) / (n + 1);
}

double binomial_cdf(double successes, const BinomialLaw& law) {
    assert(is_law(law));
    const double k = std::floor(successes);
    if (k < 0) return 0;
    if (k >= law.trials) return 1;
    return boost::math::ibetac(k + 1, law.trials - k, law.probability, Quiet());
}

double binomial_survival(double successes, const BinomialLaw& law) {
    assert(is_law(law));
    const double k = std::floor(successes);
    if (k < 0) return 1;
    if (k >= law.trials) return 0;
    return boost::math::ibeta(k + 1, law.trials - k, law.probability, Quiet());
}

double binomial_two_sided_p(double successes, const BinomialLaw& law) {
    const double mean = law.trials * law.probability;
    // Outcomes as likely as the seen one, up to rounding, belong to it.
    const double seen = binomial_pmf(successes, law) * (1 + 1e-7);
    if (successes == mean) return 1;

    // On the other side of the mode the mass function is monotonic: bisect for the first outcome, going
    // outwards, that is not likelier than the seen one.
    const bool seen_low = successes < mean;
    double inner = seen_low ? std::ceil(mean) : std::floor(mean);
    double outer = seen_low ? law.trials + 1 : -1;
    if (binomial_pmf(inner, law) <= seen) {
        outer = inner;
    } else {
        while (std::abs(outer - inner) > 1) {
            const double middle = std::floor(0.5 * (outer + inner));
            (binomial_pmf(middle, law) <= seen ? outer : inner) = middle;
        }
    }
    const double p = seen_low ? binomial_cdf(successes, law) + binomial_survival(outer - 1, law)
                              : binomial_survival(successes - 1, law) + binomial_cdf(outer, law);
    return std::min(p, 1.0);
}

double binomial_randomized_z(double successes, const BinomialLaw& law, double uniform) {
    const double step = binomial_pmf(successes, law);
    return z_from_tails(binomial_cdf(successes - 1, law) + uniform * step,
                        binomial_survival(successes, law) + (1 - uniform) * step);
}

double binomial_share_outside(const BinomialLaw& law, double sigmas) {
    const double mean = law.trials * law.probability;
    const double band = sigmas * std::sqrt(mean * (1 - law.probability));
    return binomial_cdf(std::ceil(mean - band) - 1, law) + binomial_survival(std::floor(mean + band), law);
}

std::optional<TestResult> ks_uniformity(std::span<const double> values) {
    if (values.empty() || std::any_of(values.begin(), values.end(), [](double x) { return std::isnan(x); }))
        return std::nullopt;
    std::vector<double> sorted(values.begin(), values.end());
    std::sort(sorted.begin(), sorted.end());
    const auto n = static_cast<double>(sorted.size());
    double distance = 0;
    for (std::size_t i = 0; i < sorted.size(); ++i) {
        const double uniform = std::clamp(sorted[i], 0.0, 1.0);
        const auto rank = static_cast<double>(i);
        distance = std::max({distance, uniform - rank / n, (rank + 1) / n - uniform});
    }
    const double d = distance * std::sqrt(n);
    const double x = d + 1 / (6 * std::sqrt(n)) + (d - 1) / (4 * n);  // Vrbik 2018
    return TestResult{distance, std::clamp(kolmogorov_survival(x), 0.0, 1.0)};
}

double chi2_survival(double statistic, double dof) {
    assert(dof >= 1);
    return statistic <= 0 ? 1.0 : boost::math::gamma_q(0.5 * dof, 0.5 * statistic, Quiet());
}

std::optional<TestResult> chi2_uniformity(std::span<const std::int64_t> counts) {
    const double share = 1.0 / static_cast<double>(std::max<std::size_t>(counts.size(), 1));
    return chi2_of(counts, [share](std::size_t) { return share; });
}

std::optional<TestResult> chi2_test(std::span<const std::int64_t> counts, std::span<const double> shares) {
    if (counts.size() != shares.size()) return std::nullopt;
    return chi2_of(counts, [&](std::size_t i) { return shares[i]; });
}

void MeanVariance::add(double x) {
    ++count_;
    const double off = x - mean_;
    mean_ += off / static_cast<double>(count_);
    squares_ += off * (x - mean_);
}

void MeanVariance::merge(const MeanVariance& other) {
    if (other.count_ == 0) return;
    const auto n = static_cast<double>(count_);
    const auto m = static_cast<double>(other.count_);
    const double off = other.mean_ - mean_;
    count_ += other.count_;
    mean_ += off * (m / (n + m));
    squares_ += other.squares_ + off * off * (n * (m / (n + m)));
}

double MeanVariance::standard_error() const {
    return count_ > 1 ? std::sqrt(variance() / static_cast<double>(count_)) : 0.0;
}

std::optional<double> quantile(std::span<const double> values, double q) {
    assert(q >= 0 && q <= 1);
    if (values.empty()) return std::nullopt;
    std::vector<double> sorted(values.begin(), values.end());
    std::sort(sorted.begin(), sorted.end());
    const double place = q * static_cast<double>(sorted.size() - 1);
    const auto below = static_cast<std::size_t>(place);
    const std::size_t above = std::min(below + 1, sorted.size() - 1);
    const double part = place - static_cast<double>(below);
    return sorted[below] + part * (sorted[above] - sorted[below]);
}

std::optional<double> median(std::span<const double> values) { return quantile(values, 0.5); }

std::optional<double> rank_correlation(std::span<const double> a, std::span<const double> b) {
    assert(a.size() == b.size());
    const auto ranks = [](std::span<const double> values) {
        std::vector<std::size_t> order(values.size());
        std::iota(order.begin(), order.end(), std::size_t{0});
        std::ranges::sort(order, {}, [&](std::size_t i) { return values[i]; });
        std::vector<double> rank(values.size());
        for (std::size_t i = 0; i < order.size();) {
            std::size_t end = i + 1;
            while (end < order.size() && values[order[end]] == values[order[i]]) ++end;
            for (std::size_t k = i; k < end; ++k) rank[order[k]] = 0.5 * static_cast<double>(i + end - 1);
            i = end;
        }
        return rank;
    };
    const std::vector<double> x = ranks(a);
    const std::vector<double> y = ranks(b);
    const double middle = 0.5 * (static_cast<double>(x.size()) - 1);  // mean of all ranks
    double xx = 0, yy = 0, xy = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
        xx += (x[i] - middle) * (x[i] - middle);
        yy += (y[i] - middle) * (y[i] - middle);
        xy += (x[i] - middle) * (y[i] - middle);
    }
    if (!(xx > 0 && yy > 0)) return std::nullopt;
    return xy / std::sqrt(xx * yy);
}

}  // namespace pellucid
