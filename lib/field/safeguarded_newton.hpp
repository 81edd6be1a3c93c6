// The one change of sign in a bracket: Newton's steps, halving where they leave it or do not shrink.
#pragma once

#include <cmath>

namespace pellucid {

/// A step so small, of the bracket, leaves an error below rounding: Newton's errors are squared.
inline constexpr double kLastStep = 0x1p-30;

/// `f(t)` gives value and slope at t, as a pair; a value of zero counts as positive, a slope that is no number halves.
///   rising  whether f is negative at lo and positive at hi; else the other way round
template <class ValueAndSlope>
[[nodiscard]] double safeguarded_newton(double lo, double hi, double guess, bool rising, const ValueAndSlope& f) {
    const double small = kLastStep * (hi - lo);
    double t = guess;
    double last_step = hi - lo;
    for (int step = 0; step < 100; ++step) {
        if (!(t > lo && t < hi)) t = lo + 0.5 * (hi - lo);
        const auto [value, slope] = f(t);
        ((value >= 0) == rising ? hi : lo) = t;
        double next = t - value / slope;
        if (!(next >= lo && next <= hi) || std::abs(next - t) > 0.5 * last_step) next = lo + 0.5 * (hi - lo);
        last_step = std::abs(next - t);
        t = next;
        if (last_step <= small || hi - lo <= 0x1p-52 * std::abs(t)) break;
    }
    return t;
}

}  // namespace pellucid
