// Intervals that contain every value that exact arithmetic could give: results are rounded outwards.
//
// An interval also knows whether its formula is surely defined and continuous all over the box it came from. Where it
// may not be (a division by an interval with zero, a root or logarithm that reaches below zero), the bounds still
// hold for the points where the formula has a value.
#pragma once

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
};

[[nodiscard]] Interval operator-(const Interval& a);
[[nodiscard]] Interval operator+(const Interval& a, const Interval& b);
[[nodiscard]] Interval operator-(const Interval& a, const Interval& b);
[[nodiscard]] Interval operator*(const Interval& a, const Interval& b);
[[nodiscard]] Interval operator/(const Interval& a, const Interval& b);
[[nodiscard]] Interval square(const Interval& a);
[[nodiscard]] Interval power(const Interval& a, int exponent);
[[nodiscard]] Interval abs(const Interval& a);
[[nodiscard]] Interval sqrt(const Interval& a);
[[nodiscard]] Interval exp(const Interval& a);
[[nodiscard]] Interval log(const Interval& a);
[[nodiscard]] Interval sin(const Interval& a);
[[nodiscard]] Interval cos(const Interval& a);
[[nodiscard]] Interval tan(const Interval& a);
[[nodiscard]] Interval min(const Interval& a, const Interval& b);
[[nodiscard]] Interval max(const Interval& a, const Interval& b);
/// 1 where a >= 0, else 0. Stands in derivatives only, and says nothing about continuity of f: passes it on.
[[nodiscard]] Interval step(const Interval& a);
/// What both contain; empty where they have nothing in common. Continuous where either is.
[[nodiscard]] Interval intersect(const Interval& a, const Interval& b);
[[nodiscard]] Interval hull(const Interval& a, const Interval& b);

}  // namespace pellucid
