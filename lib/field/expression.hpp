// Formulas of x, y, z: parsed once, then value, gradient and Hessian as programs.
//
//   formula  = term  { ("+" | "-") term }              x y z pi, numbers, names of parameters
//   term     = sign  { ("*" | "/") sign }
//   sign     = ("-" | "+") sign | power                −x^2 is −(x^2)
//   power    = primary [ "^" sign ]                    right associative; 2^-x is legal
//   primary  = number | name | function "(" formula { "," formula } ")" | "(" formula ")"
//   function = sqrt abs exp log sin cos tan (one argument), min max (two or more)
#pragma once

#include <array>
#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "field/program.hpp"

namespace pellucid {

class Expression {
public:
    /// Throws Error(input), one line with the column: what cannot be read, unknown names, constants that are
    /// not finite, more than kMostDepth parentheses or functions inside of each other, more than
    /// kMostOperations steps of value() after simplification (field/formula_graph.hpp says which), more than
    /// 1 MiB of text.
    ///   parameters  names with values beside pi; they hide nothing: x, y, z, pi and functions keep theirs
    explicit Expression(std::string_view text, const std::map<std::string, double>& parameters = {});

    static constexpr int kMostDepth = 1000;
    static constexpr std::size_t kMostOperations = 20000;

    /// f; f and ∂f/∂axis; f, ∂f/∂x, ∂f/∂y, ∂f/∂z; and then also xx, yy, zz, xy, xz, yz.
    /// Subexpressions are shared, also between the outputs. The constants of value() are finite. At a kink,
    /// derivatives of abs are those of its argument, of min and max those of the first operand.
    [[nodiscard]] const Program& value() const;
    [[nodiscard]] const Program& slope(int axis) const;
    [[nodiscard]] const Program& gradient() const;
    [[nodiscard]] const Program& hessian() const;  // built when first asked for; safe from several threads

    [[nodiscard]] double at(const Vec3& x) const;
    [[nodiscard]] Vec3 gradient_at(const Vec3& x) const;

    /// Degree as a polynomial in x, y and z together; empty where it is none (or above 1000). A bound from
    /// above: x·(x+1) − x² has 2 here.
    [[nodiscard]] std::optional<int> degree() const;
    /// Degree in one variable alone (axis 0, 1, 2), the others held fixed, however they enter.
    [[nodiscard]] std::optional<int> degree_along(int axis) const;
    /// Whether abs, min or max stands in it: second derivatives then say nothing about kinks.
    [[nodiscard]] bool has_kinks() const;
    /// A simpler formula that is 0 in the same places: of (x² − 1)³ and of 2·|x² − 1| it is x² − 1.
    [[nodiscard]] Expression zeros() const;
    /// Whether it changes its sign where this one, a square or the like, does not.
    [[nodiscard]] bool touches() const;
    /// As read.
    [[nodiscard]] const std::string& text() const;

    /// GLSL source of `float NAME(vec3 p)` and, with_gradient, `vec4 NAME_gradient(vec3 p)` (∂x, ∂y, ∂z,
    /// value), in float, each without need of anything else. Constants beyond the largest float become that.
    [[nodiscard]] std::string glsl(std::string_view name, bool with_gradient) const;

private:
    struct State;
    explicit Expression(std::shared_ptr<const State> state) : state_(std::move(state)) {}
    std::shared_ptr<const State> state_;
};

}  // namespace pellucid
