// How far the value that `run_program<Real>` gives may be from the real function: running error analysis over a box.
#pragma once

#include "core/interval.hpp"

namespace pellucid {

/// The exact value lies in `range`, what double arithmetic gives lies within `error` of it. The error is infinite where
/// nothing can be said (a divisor near 0).
struct Rounded {
    Interval range;
    double error = 0;

    Rounded() = default;
    explicit Rounded(double value) : range(value) {}
    Rounded(const Interval& values, double off) : range(values), error(off) {}
};

[[nodiscard]] Rounded operator-(const Rounded& a);
[[nodiscard]] Rounded operator+(const Rounded& a, const Rounded& b);
[[nodiscard]] Rounded operator-(const Rounded& a, const Rounded& b);
[[nodiscard]] Rounded operator*(const Rounded& a, const Rounded& b);
[[nodiscard]] Rounded operator/(const Rounded& a, const Rounded& b);
[[nodiscard]] Rounded square(const Rounded& a);
[[nodiscard]] Rounded power(const Rounded& a, int exponent);
[[nodiscard]] Rounded abs(const Rounded& a);
[[nodiscard]] Rounded sqrt(const Rounded& a);
[[nodiscard]] Rounded exp(const Rounded& a);
[[nodiscard]] Rounded log(const Rounded& a);
[[nodiscard]] Rounded sin(const Rounded& a);
[[nodiscard]] Rounded cos(const Rounded& a);
[[nodiscard]] Rounded tan(const Rounded& a);
[[nodiscard]] Rounded min(const Rounded& a, const Rounded& b);
[[nodiscard]] Rounded max(const Rounded& a, const Rounded& b);
[[nodiscard]] Rounded step(const Rounded& a);

}  // namespace pellucid
