// Intervals that contain every value that exact arithmetic could give: results are rounded outwards.
//
// An interval also knows whether its formula is surely defined and continuous all over the box it came from.
// Where it may not be (a division by an interval with zero, a root or logarithm that reaches below zero), the
// bounds still hold for the points where the formula has a value. Bounds are never NaN; ±infinity is a bound
// like any other.
#pragma once

#include <cmath>
#include <limits>

namespace pellucid {

struct Interval {
    double lo = 0;
    double hi = 0;           // lo > hi: empty, the formula has a value nowhere
    bool continuous = true;  // and defined, all over the box

    Interval() = default;
    explicit Interval(double value) : lo(value), hi(value) {}
    Interval(double low, double high, bool whole = true) : lo(low), hi(high), continuous(whole) {}

    [[nodiscard]] bool empty() const { return !(lo <= hi); }
    [[nodiscard]] bool has_zero() const { return lo <= 0 && hi >= 0; }
    [[nodiscard]] double width() const { return hi - lo; }
    /// Largest absolute value.
    [[nodiscard]] double reach() const { return -lo > hi ? -lo : hi; }

    [[nodiscard]] static Interval nothing() {
        return {std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity(), false};
    }
    [[nodiscard]] static Interval everything(bool whole) {
        return {-std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(), whole};
    }
};

/// A double below (above) every real number that rounds to x; at most two units away.
/// S. M. Rump, P. Zimmermann, S. Boldo, G. Melquiond, Computing predecessor and successor in rounding to
/// nearest, BIT Numerical Mathematics 49 (2009), algorithm 1.
[[nodiscard]] inline double round_down(double x) {
    constexpr double kUnit = 0x1p-53 * (1 + 0x1p-52);
    // Infinity as a lower bound is a sum or product that overflowed: above the largest double.
    if (x == std::numeric_limits<double>::infinity()) return std::numeric_limits<double>::max();
    return x - (kUnit * std::abs(x) + std::numeric_limits<double>::denorm_min());
}
[[nodiscard]] inline double round_up(double x) { return -round_down(-x); }

[[nodiscard]] inline Interval operator-(const Interval& a) { return {-a.hi, -a.lo, a.continuous}; }

[[nodiscard]] inline Interval operator+(const Interval& a, const Interval& b) {
    if (a.empty() || b.empty()) return Interval::nothing();
    // A sum that rounds to zero is zero. A lower bound is never +∞, so no NaN.
    const double lo = a.lo + b.lo;
    const double hi = a.hi + b.hi;
    return {lo == 0 ? 0.0 : round_down(lo), hi == 0 ? 0.0 : round_up(hi), a.continuous && b.continuous};
}

[[nodiscard]] inline Interval operator-(const Interval& a, const Interval& b) { return a + -b; }

[[nodiscard]] Interval operator*(const Interval& a, const Interval& b);

/// Where b has 0 inside: not continuous, and the whole line, or half of it where a has one sign and 0 is an
/// end of b; empty where b is 0.
[[nodiscard]] Interval operator/(const Interval& a, const Interval& b);

[[nodiscard]] inline Interval square(const Interval& a) {
    if (a.empty()) return Interval::nothing();
    const double far = a.reach();
    const double near = a.lo > 0 ? a.lo : a.hi < 0 ? -a.hi : 0.0;
    const double below = round_down(near * near);
    return {below > 0 ? below : 0.0, far == 0 ? 0.0 : round_up(far * far), a.continuous};
}

/// a^exponent, any integer.
[[nodiscard]] Interval power(const Interval& a, int exponent);

[[nodiscard]] inline Interval abs(const Interval& a) {
    if (a.empty()) return Interval::nothing();
    return {a.lo > 0 ? a.lo : a.hi < 0 ? -a.hi : 0.0, a.reach(), a.continuous};
}

/// Clipped to the domain, and then not continuous; empty where nothing of a is in it. log(0) is undefined.
[[nodiscard]] Interval sqrt(const Interval& a);
[[nodiscard]] Interval exp(const Interval& a);
[[nodiscard]] Interval log(const Interval& a);

/// Beyond ±1.6e6 nothing is known but the range of the function (and that tan has poles).
[[nodiscard]] Interval sin(const Interval& a);
[[nodiscard]] Interval cos(const Interval& a);
[[nodiscard]] Interval tan(const Interval& a);

[[nodiscard]] inline Interval min(const Interval& a, const Interval& b) {
    if (a.empty() || b.empty()) return Interval::nothing();
    return {a.lo < b.lo ? a.lo : b.lo, a.hi < b.hi ? a.hi : b.hi, a.continuous && b.continuous};
}

[[nodiscard]] inline Interval max(const Interval& a, const Interval& b) {
    if (a.empty() || b.empty()) return Interval::nothing();
    return {a.lo > b.lo ? a.lo : b.lo, a.hi > b.hi ? a.hi : b.hi, a.continuous && b.continuous};
}

/// 1 where a >= 0, else 0. Stands in derivatives only, and says nothing about continuity of f: passes it on.
[[nodiscard]] inline Interval step(const Interval& a) {
    if (a.empty()) return Interval::nothing();
    return {a.lo >= 0 ? 1.0 : 0.0, a.hi >= 0 ? 1.0 : 0.0, a.continuous};
}

/// What both contain; empty where they have nothing in common. Continuous where either is.
[[nodiscard]] inline Interval intersect(const Interval& a, const Interval& b) {
    const Interval both{a.lo > b.lo ? a.lo : b.lo, a.hi < b.hi ? a.hi : b.hi, a.continuous || b.continuous};
    return both.empty() ? Interval::nothing() : both;
}

/// What either contains, and what lies between. Continuous where both are.
[[nodiscard]] inline Interval hull(const Interval& a, const Interval& b) {
    const bool whole = a.continuous && b.continuous;
    if (a.empty()) return {b.lo, b.hi, whole};
    if (b.empty()) return {a.lo, a.hi, whole};
    return {a.lo < b.lo ? a.lo : b.lo, a.hi > b.hi ? a.hi : b.hi, whole};
}

}  // namespace pellucid
