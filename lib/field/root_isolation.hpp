// Every root of a field along a line, certified.
//
// Polynomials (degree <= 12 along the line): Bernstein coefficients in floating point with an error bound, bisection by
// Descartes' rule of signs; where a bound leaves a sign open, exact rational coefficients decide. Everything else:
// interval subdivision, with the slope's interval to tell monotone pieces, then safeguarded Newton.
#pragma once

#include <vector>

#include "core/vec.hpp"
#include "field/expression.hpp"
#include "field/isolation_stats.hpp"

namespace pellucid {

struct Root {
    double t;
    bool touching;  // f has a zero there and the same sign on both sides
};

/// Roots closer to each other than this share of the interval may be told as one, or as none if their number is even.
inline constexpr double kLeastShare = 1e-9;

class RootIsolator {
public:
    /// Keeps a copy of the expression (cheap).
    explicit RootIsolator(Expression f);

    /// Appends every root t in [lo, hi] of f(origin + t·direction), ascending. A value of zero counts as positive.
    /// Finite arguments, lo <= hi. Safe from several threads.
    void isolate(const Vec3& origin, const Vec3& direction, double lo, double hi, std::vector<Root>& roots,
                 IsolationStats& stats) const;

    /// Most roots that one line can have by degree; 0 = no such bound.
    [[nodiscard]] int most_roots() const;
    /// The next two for tests and for comparison: each way by itself. Precondition of the first: polynomial(), .
    [[nodiscard]] bool polynomial() const;
    void isolate_polynomial(const Vec3& origin, const Vec3& direction, double lo, double hi, std::vector<Root>& roots,
                            IsolationStats& stats) const;
    void isolate_by_intervals(const Vec3& origin, const Vec3& direction, double lo, double hi,
                              std::vector<Root>& roots, IsolationStats& stats) const;

private:
    Expression f_;
};

}  // namespace pellucid
