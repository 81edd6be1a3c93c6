// Formulas that are polynomials along every line, and their roots there by Descartes' rule of signs.
//
// Coefficients stand in Bernstein form on the interval, each with a bound of its rounding error; bisection until the
// signs leave no root or one (G. E. Collins, A. G. Akritas, Polynomial real root isolation using Descartes' rule of
// signs, SYMSAC 1976; in Bernstein form: J. M. Lane, R. F. Riesenfeld, Bounds on a polynomial, BIT 21, 1981). Where an
// error bound leaves a sign open, the same is done with integers, and multiple roots are told by the square-free part.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/vec.hpp"
#include "field/program.hpp"
#include "field/root_isolation.hpp"

namespace pellucid {

inline constexpr int kMostLineDegree = 12;

class LinePolynomial {
public:
    /// Empty where the steps are not those of a polynomial of degree <= kMostLineDegree: + − × and whole powers, and
    /// division by constants. The program has one output. Keeps a copy.
    [[nodiscard]] static std::optional<LinePolynomial> from(const Program& value);

    /// Degree by counting, an upper bound.
    [[nodiscard]] int degree() const { return degree_; }

    /// As RootIsolator::isolate.
    void isolate(const Vec3& origin, const Vec3& direction, double lo, double hi, std::vector<Root>& roots,
                 IsolationStats& stats) const;

    /// The program with what is known of each step before any line is given.
    struct Plan {
        Program program;
        std::vector<int> degree;            // of each step
        std::vector<std::size_t> place;     // of its first coefficient
        std::size_t size = 0;               // coefficients of all steps
        double roundings = 0;               // most roundings on the way to a coefficient of the result
        bool dyadic = true;                 // no division but by powers of two
    };

private:
    LinePolynomial() = default;
    Plan plan_;
    int degree_ = 0;
};

}  // namespace pellucid
