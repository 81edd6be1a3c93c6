// Real roots of polynomials of low degree in an interval, by Descartes' rule and derivative recursion.
//
// Polynomials stand in Bernstein form on [0, 1]: Σ b_i C(d,i) t^i (1−t)^(d−i). There the number of
// sign changes of b bounds the number of roots (Descartes), a bound of 0 or 1 is exact, and the
// coefficients of a field along a line are convex combinations of its values, so nothing cancels.
#pragma once

#include <array>
#include <span>

namespace pellucid {

inline constexpr int kMaxDegree = 4;

/// A polynomial of degree count − 1 on [0, 1].
struct Bernstein {
    std::array<double, kMaxDegree + 1> b{};
    int count = 0;  // coefficients, 1 … kMaxDegree + 1

    [[nodiscard]] double operator()(double t) const;
};

/// From powers: c[0] + c[1] t + …, at most kMaxDegree + 1 coefficients.
[[nodiscard]] Bernstein bernstein_from_powers(std::span<const double> c);

/// Every t in [0, 1] where the sign changes (zero counts as positive), ascending; `roots` holds at
/// least count − 1. A root that only touches zero is no crossing and is not returned. Returns how many.
int sign_changes(const Bernstein& p, std::span<double> roots);

}  // namespace pellucid
