// Every root of a field along a line: their number certified, their places to 1e-11 of the interval where they are
// ill-conditioned, else to the last bits.
//
// Polynomials (degree <= 12 along the line): Bernstein coefficients in floating point with an error bound,
// bisection by Descartes' rule of signs; where a bound leaves a sign open, exact integer coefficients decide
// (line_polynomial.hpp). Everything else: interval subdivision, with the slope's interval to tell monotone
// pieces, then safeguarded Newton (R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to Interval
// Analysis, 2009, chapter 8).
//
// f along the line is the exact function of the doubles given: f(origin + t·direction) with real t.
// At the ends a value of zero counts as positive, so a root at an end of [lo, hi] is a crossing exactly if
// f < 0 inside beside it. Splitting [lo, hi] at any double then neither loses nor doubles a crossing: one that
// falls on the split belongs to the part where f < 0. (A split at a root that f < 0 only touches makes two
// crossings of it, one a part; a split at a root that f > 0 only touches makes none.)
// f = 0 all along, or lo = hi: no roots.
#pragma once

#include <memory>
#include <vector>

#include "core/vec.hpp"
#include "field/expression.hpp"
#include "field/isolation_stats.hpp"

namespace pellucid {

struct Root {
    double t;
    bool touching;  // f has a zero there and the same sign on both sides
};

/// Where intervals are subdivided, roots closer to each other than this share of the interval may be told as
/// one, or as none if their number is even, and are then counted as undecided. Polynomials tell all apart.
inline constexpr double kLeastShare = 1e-9;
/// Most pieces of one line where intervals are subdivided. What is left then is a cluster, and undecided.
inline constexpr int kMostPieces = 2000;
/// … and most steps of the formula on all of them, but for kFewestPieces.
inline constexpr int kMostSteps = 40000;
inline constexpr int kFewestPieces = 200;

class RootIsolator {
public:
    /// Keeps a copy of the expression (cheap).
    explicit RootIsolator(Expression f);

    /// Appends every root t in [lo, hi] of f(origin + t·direction), ascending. A value of zero counts as
    /// positive. Finite arguments, lo <= hi. Safe from several threads.
    void isolate(const Vec3& origin, const Vec3& direction, double lo, double hi, std::vector<Root>& roots,
                 IsolationStats& stats) const;

    /// Most roots that one line can have by degree; 0 = no such bound.
    [[nodiscard]] int most_roots() const;
    /// Whether f is a polynomial of degree 12 at most on every line.
    [[nodiscard]] bool polynomial() const;
    /// Each way by itself, for tests and comparison. Precondition of the first: polynomial().
    void isolate_polynomial(const Vec3& origin, const Vec3& direction, double lo, double hi,
                            std::vector<Root>& roots, IsolationStats& stats) const;
    void isolate_by_intervals(const Vec3& origin, const Vec3& direction, double lo, double hi,
                              std::vector<Root>& roots, IsolationStats& stats) const;

private:
    struct State;
    std::shared_ptr<const State> state_;
};

}  // namespace pellucid
