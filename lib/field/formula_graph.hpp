// Formulas as a graph in which nothing stands twice: what is equal is one node.
//
// Every function that makes a node simplifies first. The domain never changes: x/x stays, 0·log(x) stays,
// 0·x is 0. The value may change in its last bits, and only so:
//   * constants fold by the operations of `run_program<Real>`: the same bits as without folding;
//   * factors move outwards, (c·u)·v = c·(u·v), (c·u)/v = c·(u/v), if 2⁻⁶⁴ <= |c| <= 2⁶⁴;
//   * two constants become one only where that is exact: 2·(3·u) = 6·u, (u + 1) + 2 = u + 3,
//     3·u + 2·u = 5·u, but 3·(0.1·u) stays;
//   * u·u = u², u²·u = u³, (u²)³ = u⁶, u/4 = 0.25·u, 2·u + 2·v = 2·(u + v).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/real.hpp"
#include "field/program.hpp"

namespace pellucid {

class FormulaGraph {
public:
    /// Operands have smaller numbers.
    using Node = std::uint32_t;

    /// Integer powers up to here are Op::power; beyond, exp and log.
    static constexpr int kMostPower = 1000;

    [[nodiscard]] Node constant(double value);  // −0 is 0, −NaN is NaN
    [[nodiscard]] Node variable(int axis);
    [[nodiscard]] Node negate(Node a);
    /// A function of one argument: square, abs, sqrt, exp, log, sin, cos, tan or step.
    [[nodiscard]] Node function(Op op, Node a);
    [[nodiscard]] Node add(Node a, Node b);
    [[nodiscard]] Node subtract(Node a, Node b);
    [[nodiscard]] Node multiply(Node a, Node b);
    [[nodiscard]] Node divide(Node a, Node b);
    [[nodiscard]] Node min(Node a, Node b);
    [[nodiscard]] Node max(Node a, Node b);
    /// Integers as exponents take every base, and u⁰ is 1 (also 0⁰, as std::pow has it); others as
    /// exp(exponent·log(base)), but ½ and −½ by the square root.
    [[nodiscard]] Node power(Node base, Node exponent);

    /// ∂f/∂axis. What does not depend on the axis has derivative 0, also where it is undefined. At a kink of
    /// abs the derivative of a >= 0, of min and max that of the first operand.
    [[nodiscard]] Node derivative(Node f, int axis);

    /// A simpler formula that is 0 where f is: without powers, roots, signs and constant factors around it and around the
    /// factors of a product. `touches`: whether f lost its change of sign to one of them (a square, abs, √).
    [[nodiscard]] Node zeros(Node f, bool& touches);

    /// The value of a constant, not finite where folding gave that; else empty.
    [[nodiscard]] std::optional<double> constant_value(Node a) const;

    /// The steps that `outputs` need, operands first.
    [[nodiscard]] Program program(std::span<const Node> outputs) const;

private:
    /// factor·of
    struct Scaled {
        double factor;
        Node of;
    };
    /// constant ± of
    struct Shifted {
        double constant;
        Node of;
        bool minus;
    };
    /// of^exponent, exponent > 0
    struct Raised {
        Node of;
        int exponent;
    };

    [[nodiscard]] Node node(const Step& step);
    [[nodiscard]] std::size_t slot_of(const Step& step) const;
    [[nodiscard]] Node fold(Op op, double a, double b = 0, int exponent = 0);
    [[nodiscard]] bool is(Node a, double value) const;
    [[nodiscard]] Scaled scaled(Node a) const;
    [[nodiscard]] Raised raised(Node a) const;
    [[nodiscard]] std::optional<Shifted> shifted(Node a) const;

    [[nodiscard]] Node scale(double factor, Node a);
    [[nodiscard]] Node shift(double constant, Node a, bool minus);
    [[nodiscard]] Node sum(Node a, Node b, bool minus);
    [[nodiscard]] Node product(Node a, Node b);
    [[nodiscard]] Node integer_power(Node base, int exponent);
    [[nodiscard]] Node constant_power(double base, double exponent);
    [[nodiscard]] Node zeros(Node f, bool& touches, int depth);
    [[nodiscard]] Node chain(Node outer, Node inner);
    [[nodiscard]] Node derivative_of_step(Node f, const std::vector<Node>& d);

    std::vector<Step> steps_;
    std::vector<bool> total_;  // defined everywhere
    std::vector<Node> table_;   // numbers of the steps by hash, open addressing, at most half full
    std::array<std::vector<Node>, 3> derivatives_;  // of each node, where known
    Program fold_program_;
    std::vector<Real> fold_values_;
};

}  // namespace pellucid
