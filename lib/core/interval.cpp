#include "core/interval.hpp"

#include <algorithm>

#include "core/real.hpp"

namespace pellucid {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Functions by Real: the same bits on every machine, so cells and particles are too.
constexpr double kFunctionError = (kElementaryUlp + 1) * 0x1p-52;
[[nodiscard]] double function_down(Real value) {
    const double v = value.value;
    if (v == kInfinity) return std::numeric_limits<double>::max();
    return v - (kFunctionError * std::abs(v) + 8 * std::numeric_limits<double>::denorm_min());
}
[[nodiscard]] double function_up(Real value) { return -function_down(-value); }

/// 0·∞ and ∞/∞ stand for limits whose bounds the other pairs of ends give: they count as 0.
[[nodiscard]] double or_zero(double value) { return std::isnan(value) ? 0.0 : value; }

/// Hull of four products (or quotients) of ends, rounded outwards.
[[nodiscard]] Interval hull_of_ends(double p, double q, double r, double s, bool continuous) {
    // NaN, or ∞ − ∞, which is harmless.
    if (std::isnan(p + q + r + s)) {
        p = or_zero(p);
        q = or_zero(q);
        r = or_zero(r);
        s = or_zero(s);
    }
    return {round_down(std::min(std::min(p, q), std::min(r, s))),
            round_up(std::max(std::max(p, q), std::max(r, s))), continuous};
}

/// Where signs of the operands leave no other, rounding outwards must not step over zero.
[[nodiscard]] Interval keep_sign(Interval c, const Interval& a, const Interval& b) {
    if ((a.lo >= 0 && b.lo >= 0) || (a.hi <= 0 && b.hi <= 0)) c.lo = std::max(c.lo, 0.0);
    if ((a.lo >= 0 && b.hi <= 0) || (a.hi <= 0 && b.lo >= 0)) c.hi = std::min(c.hi, 0.0);
    return c;
}

/// Bounds of m^n, m >= 0, n >= 1: the same multiplications as Real, rounded each way.
[[nodiscard]] Interval power_of_magnitude(const Interval& m, unsigned n) {
    Interval result(1.0);
    bool first = true;
    for (Interval factor = m; n != 0; n >>= 1U) {
        if ((n & 1U) != 0) {
            result = first ? factor : result * factor;
            first = false;
        }
        if (n > 1) factor = square(factor);
    }
    return result;
}

/// Whether a + k is in [lo, hi] / period for an integer k: never a false "no".
[[nodiscard]] bool meets(const Interval& x, double per_period, double a) {
    const double lo = x.lo * per_period - a;
    const double hi = x.hi * per_period - a;
    // per_period, the product and the difference are each within 2^-53 of a number below |.| + 1.
    constexpr double kSlack = 0x1p-50;
    return std::ceil(lo - kSlack * (std::abs(lo) + 1)) <= hi + kSlack * (std::abs(hi) + 1);
}

constexpr double kPerTurn = 0.15915494309189533577;   // 1/2π
constexpr double kPerHalfTurn = 0.31830988618379067154;  // 1/π
constexpr double kMostArgument = 1.6e6;  // up to there Real has its own sine

[[nodiscard]] bool too_far(const Interval& a) { return !(a.lo >= -kMostArgument && a.hi <= kMostArgument); }

/// A wave with the given values at the ends and its maxima and minima at these turns, plus integers.
[[nodiscard]] Interval wave(const Interval& a, double at_lo, double at_hi, double maximum, double minimum) {
    double lo = std::max(-1.0, function_down(Real(std::min(at_lo, at_hi))));
    double hi = std::min(1.0, function_up(Real(std::max(at_lo, at_hi))));
    if (a.lo < a.hi) {
        if (meets(a, kPerTurn, minimum)) lo = -1;
        if (meets(a, kPerTurn, maximum)) hi = 1;
    }
    return {lo, hi, a.continuous};
}

}  // namespace

Interval operator*(const Interval& a, const Interval& b) {
    if (a.empty() || b.empty()) return Interval::nothing();
    const bool continuous = a.continuous && b.continuous;
    return keep_sign(hull_of_ends(a.lo * b.lo, a.lo * b.hi, a.hi * b.lo, a.hi * b.hi, continuous), a, b);
}

Interval operator/(const Interval& a, const Interval& b) {
    if (a.empty() || b.empty() || (b.lo == 0 && b.hi == 0)) return Interval::nothing();
    if (b.has_zero()) {
        if (b.lo < 0 && b.hi > 0) return Interval::everything(false);
        if (a.lo < 0 && a.hi > 0) return Interval::everything(false);
        // The least quotient in magnitude: nearest end of a over farthest end of b.
        const double near = a.lo >= 0 ? a.lo : -a.hi;
        const double least = std::max(0.0, round_down(or_zero(near / b.reach())));
        const bool positive = (a.lo >= 0) == (b.lo == 0);
        return positive ? Interval(least, kInfinity, false) : Interval(-kInfinity, -least, false);
    }
    const bool continuous = a.continuous && b.continuous;
    return keep_sign(hull_of_ends(a.lo / b.lo, a.lo / b.hi, a.hi / b.lo, a.hi / b.hi, continuous), a, b);
}

Interval power(const Interval& a, int exponent) {
    if (a.empty()) return Interval::nothing();
    if (exponent == 0) return {1.0, 1.0, a.continuous};
    if (exponent < 0) {
        const unsigned n = 0U - static_cast<unsigned>(exponent);
        const Interval whole = n % 2 == 0 ? abs(a) : a;
        // Bounds of the magnitude first: 1/power(a, n) keeps the sign of both halves.
        if (whole.lo >= 0) return Interval(1.0) / power_of_magnitude(whole, n);
        if (whole.hi <= 0) return -(Interval(1.0) / power_of_magnitude(-whole, n));
        return Interval::everything(false);
    }
    const auto n = static_cast<unsigned>(exponent);
    if (n % 2 == 0) return power_of_magnitude(abs(a), n);
    if (a.lo >= 0) return power_of_magnitude(a, n);
    if (a.hi <= 0) return -power_of_magnitude(-a, n);
    const double below = power_of_magnitude(Interval(-a.lo), n).hi;
    const double above = power_of_magnitude(Interval(a.hi), n).hi;
    return {-below, above, a.continuous};
}

Interval sqrt(const Interval& a) {
    if (a.empty() || a.hi < 0) return Interval::nothing();
    const bool inside = a.lo >= 0;
    const double lo = inside ? std::sqrt(a.lo) : 0.0;
    const double hi = std::sqrt(a.hi);
    return {lo == 0 ? 0.0 : round_down(lo), hi == 0 ? 0.0 : round_up(hi), a.continuous && inside};
}

Interval exp(const Interval& a) {
    if (a.empty()) return Interval::nothing();
    return {std::max(0.0, function_down(exp(Real(a.lo)))), function_up(exp(Real(a.hi))), a.continuous};
}

Interval log(const Interval& a) {
    if (a.empty() || a.hi <= 0) return Interval::nothing();
    const bool inside = a.lo > 0;
    const double lo = inside ? function_down(log(Real(a.lo))) : -kInfinity;
    return {lo, function_up(log(Real(a.hi))), a.continuous && inside};
}

Interval sin(const Interval& a) {
    if (a.empty()) return Interval::nothing();
    if (too_far(a)) return {-1, 1, a.continuous};
    return wave(a, sin(Real(a.lo)).value, sin(Real(a.hi)).value, 0.25, -0.25);
}

Interval cos(const Interval& a) {
    if (a.empty()) return Interval::nothing();
    if (too_far(a)) return {-1, 1, a.continuous};
    return wave(a, cos(Real(a.lo)).value, cos(Real(a.hi)).value, 0, 0.5);
}

Interval tan(const Interval& a) {
    if (a.empty()) return Interval::nothing();
    // No double is a pole, so a single one has a value.
    if (too_far(a) || (a.lo < a.hi && meets(a, kPerHalfTurn, 0.5))) return Interval::everything(false);
    return {function_down(tan(Real(a.lo))), function_up(tan(Real(a.hi))), a.continuous};
}

}  // namespace pellucid
