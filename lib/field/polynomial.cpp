#include "field/polynomial.hpp"

#include <cassert>
#include <cmath>

namespace pellucid {
namespace {

[[nodiscard]] bool positive(double value) { return value >= 0; }

[[nodiscard]] Bernstein derivative(const Bernstein& p) {
    Bernstein d;
    d.count = p.count - 1;
    for (int i = 0; i < d.count; ++i) {
        const auto k = static_cast<std::size_t>(i);
        d.b[k] = (p.b[k + 1] - p.b[k]) * (p.count - 1);
    }
    return d;
}

/// The one sign change of p in [lo, hi]: Newton from the secant's guess, halving where it leaves the
/// bracket or does not shrink its step. Ends when a step is below the spacing of doubles in [½, 1].
[[nodiscard]] double refine(const Bernstein& p, double lo, double hi, double p_lo, double p_hi) {
    const bool rising = !positive(p_lo);
    const Bernstein slope = derivative(p);
    double t = lo - p_lo * ((hi - lo) / (p_hi - p_lo));
    double last_step = hi - lo;
    for (int step = 0; step < 200; ++step) {
        if (!(t > lo && t < hi)) t = lo + 0.5 * (hi - lo);
        const double value = p(t);
        (positive(value) == rising ? hi : lo) = t;
        double next = t - value / slope(t);
        if (!(next >= lo && next <= hi) || std::abs(next - t) > 0.5 * last_step) next = lo + 0.5 * (hi - lo);
        last_step = std::abs(next - t);
        t = next;
        if (last_step <= 0x1p-53) break;
    }
    return t;
}

}  // namespace

double Bernstein::operator()(double t) const {
    // Horner's scheme for Bernstein form: Σ b_i C(d,i) t^i s^(d−i).
    const int d = count - 1;
    const double s = 1 - t;
    double sum = b[0] * s;
    double power = 1;
    double choose = 1;
    if (d == 0) return b[0];
    for (int i = 1; i < d; ++i) {
        power *= t;
        choose *= static_cast<double>(d - i + 1) / i;
        sum = (sum + power * choose * b[static_cast<std::size_t>(i)]) * s;
    }
    return sum + power * t * b[static_cast<std::size_t>(d)];
}

Bernstein bernstein_from_powers(std::span<const double> c) {
    assert(!c.empty() && c.size() <= kMaxDegree + 1);
    // b_i = Σ_{k<=i} C(i,k)/C(d,k) c_k
    const int d = static_cast<int>(c.size()) - 1;
    Bernstein p;
    p.count = d + 1;
    for (int i = 0; i <= d; ++i) {
        double ratio = 1;  // C(i,k)/C(d,k)
        double sum = 0;
        for (int k = 0; k <= i; ++k) {
            sum += ratio * c[static_cast<std::size_t>(k)];
            ratio *= static_cast<double>(i - k) / (d - k == 0 ? 1 : d - k);
        }
        p.b[static_cast<std::size_t>(i)] = sum;
    }
    return p;
}

int sign_changes(const Bernstein& p, std::span<double> roots) {
    const auto last = static_cast<std::size_t>(p.count - 1);
    int changes = 0;
    for (std::size_t i = 0; i < last; ++i) changes += positive(p.b[i]) != positive(p.b[i + 1]) ? 1 : 0;
    if (changes == 0) return 0;
    if (changes == 1) {
        roots[0] = refine(p, 0, 1, p.b[0], p.b[last]);
        return 1;
    }

    // Between neighbouring roots of the derivative the polynomial is monotone.
    std::array<double, kMaxDegree + 1> cuts{};
    const int turning = sign_changes(derivative(p), std::span(cuts).subspan(1));
    cuts[static_cast<std::size_t>(turning) + 1] = 1;
    int found = 0;
    double p_lo = p.b[0];
    for (std::size_t i = 0; i <= static_cast<std::size_t>(turning); ++i) {
        const double p_hi = i == static_cast<std::size_t>(turning) ? p.b[last] : p(cuts[i + 1]);
        if (positive(p_lo) != positive(p_hi))
            roots[static_cast<std::size_t>(found++)] = refine(p, cuts[i], cuts[i + 1], p_lo, p_hi);
        p_lo = p_hi;
    }
    return found;
}

}  // namespace pellucid
