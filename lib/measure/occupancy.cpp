#include "measure/occupancy.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "measure/statistics.hpp"

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wsign-conversion"
#include <boost/math/special_functions/beta.hpp>
#include <boost/math/special_functions/gamma.hpp>
#pragma GCC diagnostic pop

namespace pellucid {
namespace {

/// Below this many expected hits a pixel the excess is summed as a series: it converges by a factor of
/// four a term, while the closed form would lose 1/hits of its digits. Above, that loss is one digit.
constexpr double kSeriesHits = 0.25;

/// Expected totals and σ from which the normal law is used; see covered_z_score.
constexpr double kNormalTotal = 1000;
constexpr double kNormalSigma = 20;

/// Additions of one exact law: 0.1 to 0.2 s.
constexpr double kLawBudget = 1.2e8;

/// Probabilities below this are dropped at the ends of a law: 1e-40 is z = 13.3, beyond any test.
constexpr double kNoProbability = 1e-40;

/// Values at the ends of their range come back as 0 or infinity, not as exceptions.
using Quiet = boost::math::policies::policy<
    boost::math::policies::overflow_error<boost::math::policies::ignore_error>,
    boost::math::policies::underflow_error<boost::math::policies::ignore_error>,
    boost::math::policies::evaluation_error<boost::math::policies::ignore_error>,
    boost::math::policies::promote_double<false>>;

/// (1 − p)^n with 0^0 = 1.
double power_of_miss(double p, double n) { return n > 0 ? std::exp(n * std::log1p(-p)) : 1.0; }
double one_minus_power_of_miss(double p, double n) { return n > 0 ? -std::expm1(n * std::log1p(-p)) : 0.0; }

/// E(p, w) = [1 − (1−p)^n] − [(1−r)^n − (1−w)^n]/w: what pixel k adds to the variance because its rival
/// l was hit too; p = p_k, r = p_l, w = p_l/(1−p_k), the chance of l given not k.
///
/// Both brackets are n·p for few hits, so they are expanded in binomials: the term of order i is
///   (−1)^i C(n,i)·[w^(i−1) − r^(i−1)(1−p) − p^i],
/// zero for i = 1. With r = w(1−p) the bracket is w^(i−1)·[1 − (1−p)^i] − p^i, free of cancellation.
double shared_excess(double n, double p, double r, double w) {
    if (n <= 1) return 0;
    if (n * std::max(p, w) < kSeriesHits) {
        double sum = 0;
        double choose_w = n;  // C(n,i) w^(i−1)
        double choose_p = n * p;  // C(n,i) p^i
        for (int i = 2; i <= 40 && i <= n; ++i) {
            const double next = (n - i + 1) / i;
            choose_w *= next * w;
            choose_p *= next * p;
            const double term = choose_w * one_minus_power_of_miss(p, i) - choose_p;
            sum += i % 2 == 0 ? term : -term;
            if (choose_w * p + choose_p < 1e-18 * std::abs(sum)) break;
        }
        return sum;
    }
    // (1−r)^n − (1−w)^n = (1−r)^n [1 − (1−x)^n] with (1−w)/(1−r) = 1 − x, x = p·w/(1−r).
    const double x = std::min(1.0, p * w / (1 - r));
    return one_minus_power_of_miss(p, n) - power_of_miss(r, n) * one_minus_power_of_miss(x, n) / w;
}

/// The variance of the number of covered pixels.
///
/// Var = Σ_k q_k u_k + Σ_{k≠l} (q_kl − q_k q_l), q = (1−p)^n, u = 1 − q, q_kl = (1−p_k−p_l)^n. The pair
/// term is −q_k [(1−p_l)^n − (1−w_kl)^n] with w_kl = p_l/(1−p_k). The weights w_kl over l ≠ k sum to
/// 1 − rest_k, rest_k = (1 − Σp)/(1−p_k): the chance to miss all pixels, given not k. Dealing u_k out by
/// them gives
///   Var = Σ_k q_k [ rest_k u_k + Σ_{l≠k} w_kl E_kl ],   E_kl = u_k − [(1−p_l)^n − (1−w_kl)^n]/w_kl,
/// in which the leading n·p of each pixel has cancelled on paper, not in the machine.
double covered_variance(double n, std::span<const PixelClass> classes, double rest) {
    double variance = 0;
    for (const PixelClass& k : classes) {
        if (k.pixels <= 0 || k.landing <= 0 || k.landing >= 1) continue;  // sure outcomes do not vary
        const double miss = 1 - k.landing;
        double bracket = rest / miss * one_minus_power_of_miss(k.landing, n);
        for (const PixelClass& l : classes) {
            const double rivals = &l == &k ? k.pixels - 1 : l.pixels;
            if (rivals <= 0 || l.landing <= 0 || l.landing >= 1) continue;
            const double w = std::min(1.0, l.landing / miss);
            bracket += rivals * w * shared_excess(n, k.landing, l.landing, w);
        }
        variance += k.pixels * power_of_miss(k.landing, n) * bracket;
    }
    return std::max(variance, 0.0);
}

double pixel_count(std::span<const PixelClass> classes) {
    double pixels = 0;
    for (const PixelClass& c : classes) pixels += c.pixels;
    return pixels;
}

/// Shares without their variance: pixels are covered by themselves, whatever the others do.
CoveredShare mean_share(std::span<const PixelClass> classes, auto covered_chance, auto uncovered_chance) {
    CoveredShare share{.mean = 0, .uncovered = 0, .variance = 0, .pixels = pixel_count(classes)};
    assert(share.pixels >= 1);
    for (const PixelClass& c : classes) {
        share.mean += c.pixels * covered_chance(c.landing);
        share.uncovered += c.pixels * uncovered_chance(c.landing);
    }
    share.mean /= share.pixels;
    share.uncovered /= share.pixels;
    return share;
}

/// Cuts the ends that hold nothing.
void trim(CountLaw& law) {
    auto& p = law.probability;
    std::size_t first = 0;
    while (first + 1 < p.size() && p[first] < kNoProbability) ++first;
    std::size_t last = p.size();
    while (last > first + 1 && p[last - 1] < kNoProbability) --last;
    p.resize(last);
    p.erase(p.begin(), p.begin() + static_cast<std::ptrdiff_t>(first));
    law.first += static_cast<std::int64_t>(first);
}

CountLaw convolution(const CountLaw& a, const CountLaw& b) {
    CountLaw sum{a.first + b.first, std::vector<double>(a.probability.size() + b.probability.size() - 1, 0.0)};
    for (std::size_t i = 0; i < a.probability.size(); ++i)
        for (std::size_t j = 0; j < b.probability.size(); ++j)
            sum.probability[i + j] += a.probability[i] * b.probability[j];
    trim(sum);
    return sum;
}

double z_of_law(double x, const CountLaw& law, double uniform) {
    double lower = 0;
    double upper = 0;
    for (std::size_t i = 0; i < law.probability.size(); ++i) {
        const double at = static_cast<double>(law.first) + static_cast<double>(i);
        const double p = law.probability[i];
        lower += at < x ? p : at == x ? uniform * p : 0;
        upper += at > x ? p : at == x ? (1 - uniform) * p : 0;
    }
    return z_from_tails(lower, upper);
}

/// Mean and variance of a total; its CDF is that of the binomial with the same two, N = μ/π and
/// π = 1 − σ²/μ, N not whole: the incomplete beta function does not ask. π → 0 is Poisson.
struct MatchedLaw {
    double mean = 0;
    double variance = 0;

    [[nodiscard]] double cdf(double k) const { return tail(k, false); }
    [[nodiscard]] double survival(double k) const { return tail(k, true); }

private:
    [[nodiscard]] double tail(double k, bool upper) const {
        if (k < 0 || mean <= 0) return (k < 0) == upper ? 1.0 : 0.0;
        const double probability = 1 - variance / mean;
        if (probability < 1e-9)
            return upper ? boost::math::gamma_p(k + 1, mean, Quiet()) : boost::math::gamma_q(k + 1, mean, Quiet());
        const double trials = mean / probability;
        if (k >= trials || probability >= 1) return (k >= mean) == upper ? 0.0 : 1.0;
        return upper ? boost::math::ibeta(k + 1, trials - k, probability, Quiet())
                     : boost::math::ibetac(k + 1, trials - k, probability, Quiet());
    }
};

struct Total {
    double covered = 0;  // expected
    double uncovered = 0;
    double variance = 0;
    double pixels = 0;
};

Total expected_total(const CoveredShare& share, double repeats) {
    const double pixels = share.pixels * repeats;
    return {pixels * share.mean, pixels * share.uncovered, pixels * share.pixels * share.variance, pixels};
}

bool normal_law_is_good(const Total& total) {
    return std::min(total.covered, total.uncovered) >= kNormalTotal && total.variance >= kNormalSigma * kNormalSigma;
}

double normal_z(double covered, const Total& total) { return (covered - total.covered) / std::sqrt(total.variance); }

/// Beyond this a z-score says nothing more; it keeps all paths within one finite range.
double bounded(double z) { return std::clamp(z, -37.6, 37.6); }

double matched_z(double covered, const Total& total, double uniform) {
    if (covered < 0 || covered > total.pixels) return covered < 0 ? normal_quantile(0) : -normal_quantile(0);
    const bool count_covered = total.covered <= total.uncovered;
    const double x = count_covered ? covered : total.pixels - covered;
    const MatchedLaw law{count_covered ? total.covered : total.uncovered, total.variance};
    // P(X < x) + u·P(X = x) as a mean of neighbouring CDF values: no difference is taken.
    const double u = count_covered ? uniform : 1 - uniform;
    const double lower = (1 - u) * law.cdf(x - 1) + u * law.cdf(x);
    const double upper = (1 - u) * law.survival(x - 1) + u * law.survival(x);
    return count_covered ? z_from_tails(lower, upper) : z_from_tails(upper, lower);
}

}  // namespace

std::vector<PixelClass> pixel_classes(std::span<const double> landing) {
    std::vector<double> sorted(landing.begin(), landing.end());
    std::sort(sorted.begin(), sorted.end());
    std::vector<PixelClass> exact;
    for (const double p : sorted) {
        if (exact.empty() || exact.back().landing != p) exact.push_back({p, 0});
        exact.back().pixels += 1;
    }
    if (exact.size() <= kMaxPixelClasses) return exact;

    // Zero is a class of its own; the others share the range of log p.
    std::vector<PixelClass> grouped;
    std::size_t first = 0;
    if (exact.front().landing <= 0) grouped.push_back(exact[first++]);
    const double low = std::log(exact[first].landing);
    const auto bins = static_cast<double>(kMaxPixelClasses - grouped.size());
    const double width = (std::log(exact.back().landing) - low) / bins;
    double bin = -1;
    for (; first < exact.size(); ++first) {
        const PixelClass& c = exact[first];
        const double here = std::min(std::floor((std::log(c.landing) - low) / width), bins - 1);
        if (here > bin) grouped.push_back({0, 0});
        bin = std::max(bin, here);
        PixelClass& into = grouped.back();
        into.landing += c.pixels / (into.pixels + c.pixels) * (c.landing - into.landing);
        into.pixels += c.pixels;
    }
    return grouped;
}

CoveredShare covered_share(const PatchPixels& patch) {
    assert(patch.particles >= 0 && patch.pixels >= 1 && patch.span >= patch.pixels);
    const PixelClass all{1 / patch.span, patch.pixels};
    CoveredShare share = mean_share({&all, 1}, [&](double p) { return one_minus_power_of_miss(p, patch.particles); },
                                    [&](double p) { return power_of_miss(p, patch.particles); });
    const double rest = (patch.span - patch.pixels) / patch.span;
    share.variance = covered_variance(patch.particles, {&all, 1}, rest) / (patch.pixels * patch.pixels);
    return share;
}

CoveredShare covered_share(double particles, std::span<const PixelClass> classes) {
    CoveredShare share = mean_share(classes, [&](double p) { return one_minus_power_of_miss(p, particles); },
                                    [&](double p) { return power_of_miss(p, particles); });
    double inside = 0;
    for (const PixelClass& c : classes) inside += c.pixels * c.landing;
    // What rounding leaves of a full sum must not pass for a chance to miss.
    const double rounding = 1e-15 * static_cast<double>(classes.size());
    const double rest = 1 - inside > rounding ? 1 - inside : 0.0;
    share.variance = covered_variance(particles, classes, rest) / (share.pixels * share.pixels);
    return share;
}

CoveredShare covered_share_poisson(double mean_particles, std::span<const PixelClass> classes) {
    CoveredShare share = mean_share(classes, [&](double p) { return -std::expm1(-mean_particles * p); },
                                    [&](double p) { return std::exp(-mean_particles * p); });
    for (const PixelClass& c : classes)
        share.variance += c.pixels * -std::expm1(-mean_particles * c.landing) * std::exp(-mean_particles * c.landing);
    share.variance /= share.pixels * share.pixels;
    return share;
}

std::optional<CountLaw> covered_law(const PatchPixels& patch) {
    assert(patch.particles >= 0 && patch.pixels >= 1 && patch.span >= patch.pixels);
    const double cells = patch.pixels;
    const double inside = std::min(1.0, cells / patch.span);

    // The number h of particles that land inside is binomial: the bulk of that law, ±14 σ and a margin
    // for the skewed tail of small means (1e-40 of a Poisson law of mean 1 is at 35).
    const double mean = patch.particles * inside;
    const double reach = 14 * std::sqrt(mean * (1 - inside)) + (inside < 1 ? 60 : 0);
    const double most = std::min(patch.particles, std::ceil(mean + reach));
    const double least = std::max(0.0, std::floor(mean - reach));
    const double width = std::min({cells, most, 28 * std::sqrt(std::min(cells, most)) + 60});
    // With M(ln M + 93) balls inside the chance of an empty cell is below 1e-40, and the law stands still.
    const double steps = std::min(most, cells * (std::log(cells) + 93));
    if (steps * (width + 1) > kLawBudget) return std::nullopt;

    // h balls into M equal cells, one at a time: j covered cells stay or become j + 1.
    CountLaw balls{0, {1.0}};
    std::vector<double> mixed(static_cast<std::size_t>(std::min(cells, most)) + 1, 0.0);
    for (double h = 0;; h += 1) {
        const bool all_covered = static_cast<double>(balls.first) >= cells;
        if (all_covered) {
            mixed.back() += binomial_survival(h - 1, {patch.particles, inside});
            break;
        }
        if (h >= least) {
            const double weight = binomial_pmf(h, {patch.particles, inside});
            for (std::size_t i = 0; i < balls.probability.size(); ++i)
                mixed[static_cast<std::size_t>(balls.first) + i] += weight * balls.probability[i];
        }
        if (h >= most) break;
        auto& p = balls.probability;
        p.push_back(0);
        for (std::size_t i = p.size(); i-- > 0;) {
            const double covered = static_cast<double>(balls.first) + static_cast<double>(i);
            const double before = i > 0 ? p[i - 1] * ((cells - covered + 1) / cells) : 0.0;
            p[i] = p[i] * (covered / cells) + before;
        }
        trim(balls);
    }
    CountLaw law{0, std::move(mixed)};
    trim(law);
    return law;
}

std::optional<CountLaw> law_of_sum(const CountLaw& law, std::int64_t repeats) {
    assert(repeats >= 1);
    // Square and multiply; the ends are trimmed on the way, so widths grow with the root of the repeats.
    std::optional<CountLaw> sum;
    CountLaw power = law;
    double work = 0;
    for (std::int64_t left = repeats;; left /= 2) {
        const auto width = static_cast<double>(power.probability.size());
        work += width * (width + (sum ? static_cast<double>(sum->probability.size()) : 0.0));
        if (work > kLawBudget) return std::nullopt;
        if (left % 2 == 1) sum = sum ? convolution(*sum, power) : power;
        if (left <= 1) return sum;
        power = convolution(power, power);
    }
}

double covered_z_score(double covered_total, double repeats, const PatchPixels& patch, double uniform) {
    const Total total = expected_total(covered_share(patch), repeats);
    if (normal_law_is_good(total)) return bounded(normal_z(covered_total, total));
    if (const auto one = covered_law(patch))
        if (const auto all = law_of_sum(*one, static_cast<std::int64_t>(repeats)))
            return z_of_law(covered_total, *all, uniform);
    return matched_z(covered_total, total, uniform);
}

double covered_z_score(double covered_total, double repeats, double particles, std::span<const PixelClass> classes,
                       double uniform) {
    const Total total = expected_total(covered_share(particles, classes), repeats);
    if (normal_law_is_good(total)) return bounded(normal_z(covered_total, total));
    return matched_z(covered_total, total, uniform);
}

double covered_z_score_poisson(double covered_total, double repeats, double mean_particles,
                               std::span<const PixelClass> classes, double uniform) {
    const CoveredShare share = covered_share_poisson(mean_particles, classes);
    const Total total = expected_total(share, repeats);
    if (normal_law_is_good(total)) return bounded(normal_z(covered_total, total));
    if (classes.size() == 1)
        return binomial_randomized_z(covered_total, {total.pixels, share.mean}, uniform);
    return matched_z(covered_total, total, uniform);
}

}  // namespace pellucid
