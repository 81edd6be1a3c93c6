#include "field/formula_graph.hpp"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <limits>

namespace pellucid {
namespace {

/// Below it the slope of a root is taken as that of a line; it is a number in float, too.
constexpr double kLeastRoot = 1e-30;

using Node = FormulaGraph::Node;

constexpr Node kUnknown = std::numeric_limits<Node>::max();

/// Factors within this and its reciprocal may move: u·v then overflows hardly before (c·u)·v does.
constexpr double kMostMovedFactor = 0x1p64;

[[nodiscard]] bool moves(double factor) {
    return std::abs(factor) <= kMostMovedFactor && std::abs(factor) >= 1 / kMostMovedFactor;
}

[[nodiscard]] bool is_power_of_two(double v) {
    int exponent = 0;
    return std::isnormal(v) && std::abs(std::frexp(v, &exponent)) == 0.5 && std::abs(exponent) < 1000;
}

/// a + b where it needs no rounding.
[[nodiscard]] std::optional<double> exact_sum(double a, double b) {
    const double sum = a + b;
    const double b_seen = sum - a;
    const bool exact = (a - (sum - b_seen)) + (b - b_seen) == 0;  // Knuth's error of a sum; NaN on overflow
    return exact && std::isfinite(sum) ? std::optional(sum) : std::nullopt;
}

/// a·b where it needs no rounding, nor comes near underflow, where the remainder would be lost.
[[nodiscard]] std::optional<double> exact_product(double a, double b) {
    const double product = a * b;
    if (std::abs(a) == 1 || std::abs(b) == 1) return product;
    const bool exact = std::isfinite(product) && std::abs(product) > 1e-200 && std::fma(a, b, -product) == 0;
    return exact ? std::optional(product) : std::nullopt;
}

[[nodiscard]] bool has_one_operand(Op op) { return op >= Op::negate && op <= Op::step; }
[[nodiscard]] bool has_two_operands(Op op) { return op >= Op::add; }

/// Whether a step is defined wherever its operands are.
[[nodiscard]] bool is_total(const Step& s) {
    switch (s.op) {
        case Op::constant: return std::isfinite(s.value);
        case Op::power: return s.exponent > 0;
        case Op::sqrt:
        case Op::exp:  // overflows too soon to be multiplied by 0
        case Op::log:
        case Op::tan:
        case Op::divide: return false;
        default: return true;
    }
}

[[nodiscard]] bool is_never_negative(const Step& s) {
    return s.op == Op::square || s.op == Op::abs || s.op == Op::sqrt || s.op == Op::exp || s.op == Op::step ||
           (s.op == Op::power && s.exponent % 2 == 0);
}

[[nodiscard]] std::uint64_t hash(const Step& s) {
    const auto mix = [](std::uint64_t h) {  // the finaliser of SplitMix64
        h = (h ^ (h >> 30U)) * 0xbf58476d1ce4e5b9U;
        h = (h ^ (h >> 27U)) * 0x94d049bb133111ebU;
        return h ^ (h >> 31U);
    };
    const auto of_operands = static_cast<std::uint64_t>(s.a) << 32U | s.b;
    const auto of_op = static_cast<std::uint64_t>(s.op) << 32U | static_cast<std::uint32_t>(s.exponent);
    return mix(mix(mix(of_operands) + of_op) + std::bit_cast<std::uint64_t>(s.value));
}

/// Equal bits: a NaN is the same as itself here.
[[nodiscard]] bool same(const Step& s, const Step& t) {
    return s.op == t.op && s.a == t.a && s.b == t.b && s.exponent == t.exponent &&
           std::bit_cast<std::uint64_t>(s.value) == std::bit_cast<std::uint64_t>(t.value);
}

}  // namespace

// Nodes

/// Of that step, or where it would stand.
std::size_t FormulaGraph::slot_of(const Step& step) const {
    const std::size_t mask = table_.size() - 1;
    std::size_t slot = static_cast<std::size_t>(hash(step)) & mask;
    while (table_[slot] != kUnknown && !same(steps_[table_[slot]], step)) slot = (slot + 1) & mask;
    return slot;
}

Node FormulaGraph::node(const Step& step) {
    if (2 * (steps_.size() + 1) > table_.size()) {
        table_.assign(std::max<std::size_t>(64, 2 * table_.size()), kUnknown);
        for (Node i = 0; i < steps_.size(); ++i) table_[slot_of(steps_[i])] = i;
    }
    Node& number = table_[slot_of(step)];
    if (number == kUnknown) {
        const bool of_total = (step.op < Op::negate || total_[step.a]) &&
                              (!has_two_operands(step.op) || total_[step.b]);
        number = static_cast<Node>(steps_.size());
        steps_.push_back(step);
        total_.push_back(is_total(step) && of_total);
    }
    return number;
}

Node FormulaGraph::constant(double value) {
    if (std::isnan(value)) value = std::numeric_limits<double>::quiet_NaN();  // no sign to be printed
    return node({.value = value == 0 ? 0 : value});
}

Node FormulaGraph::variable(int axis) {
    assert(axis >= 0 && axis < 3);
    return node({.op = axis == 0 ? Op::x : axis == 1 ? Op::y : Op::z});
}

Node FormulaGraph::fold(Op op, double a, double b, int exponent) {
    fold_program_.steps = {{.value = a}, {.value = b}, {.op = op, .a = 0, .b = 1, .exponent = exponent}};
    run_program<Real>(fold_program_, {}, fold_values_, {});
    return constant(fold_values_[2].value);
}

FormulaGraph::Node FormulaGraph::zeros(Node f, bool& touches) { return zeros(f, touches, 0); }

FormulaGraph::Node FormulaGraph::zeros(Node f, bool& touches, int depth) {
    constexpr int kMostFactors = 64;  // of a product: those beyond stay as they are
    for (;;) {
        const Step s = steps_[f];
        if (s.op == Op::multiply && depth < kMostFactors) {
            if (constant_value(s.a).value_or(0) != 0) {
                f = s.b;
                continue;
            }
            if (constant_value(s.b).value_or(0) != 0) {
                f = s.a;
                continue;
            }
            const Node a = zeros(s.a, touches, depth + 1);
            const Node b = zeros(s.b, touches, depth + 1);
            return a == s.a && b == s.b ? f : multiply(a, b);
        }
        const bool even = s.op == Op::square || s.op == Op::abs || s.op == Op::sqrt ||
                          (s.op == Op::power && s.exponent > 0 && s.exponent % 2 == 0);
        const bool odd = s.op == Op::negate || (s.op == Op::power && s.exponent > 0 && s.exponent % 2 != 0);
        if (!even && !odd) return f;
        touches = touches || even;
        f = s.a;
    }
}

std::optional<double> FormulaGraph::constant_value(Node a) const {
    return steps_[a].op == Op::constant ? std::optional(steps_[a].value) : std::nullopt;
}

bool FormulaGraph::is(Node a, double value) const { return constant_value(a) == value; }

FormulaGraph::Scaled FormulaGraph::scaled(Node a) const {
    const Step& s = steps_[a];
    if (s.op == Op::negate) return {-1, s.a};
    if (s.op == Op::multiply)
        if (const auto factor = constant_value(s.a)) return {*factor, s.b};
    return {1, a};
}

FormulaGraph::Raised FormulaGraph::raised(Node a) const {
    const Step& s = steps_[a];
    if (s.op == Op::square) return {s.a, 2};
    if (s.op == Op::power && s.exponent > 0) return {s.a, s.exponent};
    return {a, 1};
}

std::optional<FormulaGraph::Shifted> FormulaGraph::shifted(Node a) const {
    const Step& s = steps_[a];
    if (s.op != Op::add && s.op != Op::subtract) return std::nullopt;
    const bool minus = s.op == Op::subtract;
    if (const auto c = constant_value(s.a)) return Shifted{*c, s.b, minus};
    if (const auto c = constant_value(s.b)) return Shifted{minus ? -*c : *c, s.a, false};
    return std::nullopt;
}

// Sums

Node FormulaGraph::add(Node a, Node b) { return sum(a, b, false); }
Node FormulaGraph::subtract(Node a, Node b) { return sum(a, b, true); }
Node FormulaGraph::negate(Node a) { return scale(-1, a); }

/// constant ± a
Node FormulaGraph::shift(double c, Node a, bool minus) {
    if (c == 0) return minus ? negate(a) : a;
    if (minus) return node({.op = Op::subtract, .a = constant(c), .b = a});
    return c > 0 ? node({.op = Op::add, .a = constant(c), .b = a})
                 : node({.op = Op::subtract, .a = a, .b = constant(-c)});
}

/// a ± b
Node FormulaGraph::sum(Node a, Node b, bool minus) {
    const auto ca = constant_value(a);
    const auto cb = constant_value(b);
    if (ca && cb) return fold(minus ? Op::subtract : Op::add, *ca, *cb);

    // One constant, in front; two become one.
    if (cb) {
        const double c = minus ? -*cb : *cb;
        if (const auto inner = shifted(a))
            if (const auto both = exact_sum(inner->constant, c)) return shift(*both, inner->of, inner->minus);
        return scaled(a).factor < 0 ? shift(c, negate(a), true) : shift(c, a, false);
    }
    if (ca) {
        if (const auto inner = shifted(b))
            if (const auto both = exact_sum(*ca, minus ? -inner->constant : inner->constant))
                return shift(*both, inner->of, inner->minus != minus);
        if (const Scaled s = scaled(b); s.factor < 0) return sum(a, negate(b), !minus);
        return shift(*ca, b, minus);
    }

    // The same thing twice; then all signs into the sum.
    const Scaled sa = scaled(a);
    const Scaled sb = scaled(b);
    if (sa.of == sb.of)
        if (const auto both = exact_sum(sa.factor, minus ? -sb.factor : sb.factor))
            return scale(*both, sa.of);
    if (sb.factor < 0) return sum(a, negate(b), !minus);
    if (!minus && sa.factor < 0) return sum(b, negate(a), true);
    if (minus && sa.factor == -1) return negate(sum(sa.of, b, false));
    if (sa.factor == sb.factor && sa.factor != 1 && is_power_of_two(sa.factor) && moves(sa.factor))
        return scale(sa.factor, sum(sa.of, sb.of, minus));
    if (minus) return node({.op = Op::subtract, .a = a, .b = b});
    return node({.op = Op::add, .a = std::min(a, b), .b = std::max(a, b)});
}

// Products

Node FormulaGraph::scale(double factor, Node a) {
    if (const auto c = constant_value(a)) return fold(Op::multiply, factor, *c);
    const Scaled s = scaled(a);
    if (s.factor != 1)
        if (const auto both = exact_product(factor, s.factor)) return scale(*both, s.of);
    if (factor == 0 && total_[a]) return constant(0);
    if (factor == 1) return a;
    if (factor == -1) {
        const Step& step = steps_[a];
        if (step.op == Op::subtract) return sum(step.b, step.a, true);
        return node({.op = Op::negate, .a = a});
    }
    return node({.op = Op::multiply, .a = constant(factor), .b = a});
}

Node FormulaGraph::multiply(Node a, Node b) {
    if (const auto c = constant_value(a)) return scale(*c, b);
    if (const auto c = constant_value(b)) return scale(*c, a);
    const Scaled sa = scaled(a);
    const Scaled sb = scaled(b);
    if ((sa.factor != 1 || sb.factor != 1) && moves(sa.factor) && moves(sb.factor))
        if (const auto both = exact_product(sa.factor, sb.factor)) return scale(*both, product(sa.of, sb.of));
    return product(a, b);
}

/// Of two that are no constants.
Node FormulaGraph::product(Node a, Node b) {
    const auto as_power = [&](Node u, Node v) -> std::optional<Node> {
        const Raised ru = raised(u);
        const Raised rv = raised(v);
        if (ru.of != rv.of || ru.exponent + rv.exponent > kMostPower) return std::nullopt;
        return integer_power(ru.of, ru.exponent + rv.exponent);
    };
    if (const auto whole = as_power(a, b)) return *whole;
    // (p·u)·u = p·u²
    for (int swapped = 0; swapped < 2; ++swapped, std::swap(a, b)) {
        const Step s = steps_[a];
        if (s.op != Op::multiply || constant_value(s.a)) continue;
        if (const auto part = as_power(s.b, b)) return multiply(s.a, *part);
        if (const auto part = as_power(s.a, b)) return multiply(*part, s.b);
    }
    return node({.op = Op::multiply, .a = std::min(a, b), .b = std::max(a, b)});
}

Node FormulaGraph::divide(Node a, Node b) {
    const auto ca = constant_value(a);
    const auto cb = constant_value(b);
    if (ca && cb) return fold(Op::divide, *ca, *cb);
    if (cb && is_power_of_two(*cb)) return scale(1 / *cb, a);
    if (const Scaled s = scaled(a); s.factor != 1 && moves(s.factor)) return scale(s.factor, divide(s.of, b));
    if (const Scaled s = scaled(b); s.factor != 1 && is_power_of_two(s.factor) && moves(s.factor))
        return scale(1 / s.factor, divide(a, s.of));
    return node({.op = Op::divide, .a = a, .b = b});
}

// Functions

Node FormulaGraph::function(Op op, Node a) {
    assert(has_one_operand(op) && op != Op::power && op != Op::negate);
    if (const auto c = constant_value(a)) return fold(op, *c);
    const Scaled s = scaled(a);
    switch (op) {
        case Op::square: return integer_power(a, 2);
        case Op::abs:
            if (is_never_negative(steps_[a])) return a;
            if (s.factor != 1) return scale(std::abs(s.factor), function(op, s.of));
            break;
        case Op::cos:
            if (s.factor == -1) return function(op, s.of);
            break;
        case Op::sin:
        case Op::tan:
            if (s.factor == -1) return negate(function(op, s.of));
            break;
        default: break;
    }
    return node({.op = op, .a = a});
}

Node FormulaGraph::min(Node a, Node b) {
    if (a == b) return a;
    const auto ca = constant_value(a);
    const auto cb = constant_value(b);
    return ca && cb ? fold(Op::min, *ca, *cb) : node({.op = Op::min, .a = a, .b = b});
}

Node FormulaGraph::max(Node a, Node b) {
    if (a == b) return a;
    const auto ca = constant_value(a);
    const auto cb = constant_value(b);
    return ca && cb ? fold(Op::max, *ca, *cb) : node({.op = Op::max, .a = a, .b = b});
}

// Powers

Node FormulaGraph::integer_power(Node base, int exponent) {
    if (exponent == 0) return total_[base] ? constant(1) : add(constant(1), scale(0, base));
    if (exponent == 1) return base;
    if (exponent == -1) return divide(constant(1), base);
    if (const auto c = constant_value(base)) return fold(Op::power, *c, 0, exponent);
    const bool even = exponent % 2 == 0;
    if (even && steps_[base].op == Op::abs) return integer_power(steps_[base].a, exponent);
    const Scaled s = scaled(base);
    if (s.factor == -1) {
        const Node positive = integer_power(s.of, exponent);
        return even ? positive : negate(positive);
    }
    if (exponent == 2 && s.factor != 1 && moves(s.factor))
        if (const auto factor = exact_product(s.factor, s.factor))
            return scale(*factor, integer_power(s.of, 2));
    if (const Raised r = raised(base); r.exponent > 1 && std::abs(r.exponent * exponent) <= kMostPower)
        return integer_power(r.of, r.exponent * exponent);
    if (exponent == 2) return node({.op = Op::square, .a = base});
    return node({.op = Op::power, .a = base, .exponent = exponent});
}

/// By the operations that a variable base would get.
Node FormulaGraph::constant_power(double base, double exponent) {
    if (exponent == std::trunc(exponent) && std::abs(exponent) <= kMostPower)
        return fold(Op::power, base, 0, static_cast<int>(exponent));
    FormulaGraph apart;
    const Node f = apart.power(apart.variable(0), apart.constant(exponent));
    const Program program = apart.program(std::array{f});
    std::array<Real, 1> result;
    run_program<Real>(program, {Real(base), Real(0), Real(0)}, fold_values_, result);
    return constant(result[0].value);
}

Node FormulaGraph::power(Node base, Node exponent) {
    const auto e = constant_value(exponent);
    if (!e) return function(Op::exp, multiply(exponent, function(Op::log, base)));
    if (const auto b = constant_value(base)) return constant_power(*b, *e);
    if (*e == std::trunc(*e)) {
        if (std::abs(*e) <= kMostPower) return integer_power(base, static_cast<int>(*e));
        // |u|^e = (u²)^(e/2), so that negative bases have it too.
        const bool even = std::fmod(*e, 2) == 0;
        const double half = even ? *e / 2 : (*e - 1) / 2;
        const Node of_size =
            function(Op::exp, scale(half, function(Op::log, function(Op::square, base))));
        return even ? of_size : multiply(base, of_size);
    }
    if (*e == 0.5) return function(Op::sqrt, base);
    if (*e == -0.5) return divide(constant(1), function(Op::sqrt, base));
    return function(Op::exp, scale(*e, function(Op::log, base)));
}

// Derivatives

/// outer·inner, 0 where inner is: also if outer is not defined everywhere.
Node FormulaGraph::chain(Node outer, Node inner) { return is(inner, 0) ? inner : multiply(outer, inner); }

Node FormulaGraph::derivative_of_step(Node f, const std::vector<Node>& d) {
    const Step s = steps_[f];
    const Node zero = constant(0);
    const Node da = has_one_operand(s.op) || has_two_operands(s.op) ? d[s.a] : zero;
    const Node db = has_two_operands(s.op) ? d[s.b] : zero;
    if (is(da, 0) && is(db, 0)) return zero;
    const auto where_first = [&](Node a_minus_b) {  // da there, else db
        return add(chain(function(Op::step, a_minus_b), subtract(da, db)), db);
    };
    switch (s.op) {
        case Op::negate: return negate(da);
        case Op::square: return scale(2, chain(s.a, da));
        case Op::abs: return chain(shift(-1, scale(2, function(Op::step, s.a)), false), da);
        case Op::sqrt:
            // u'/2√u, and 0 instead of 0/0 where u and u' vanish together: distances to boxes do so in whole volumes.
            return scale(0.5, divide(da, max(f, constant(kLeastRoot))));
        case Op::exp: {
            // (u^c)' = c·u^(c−1)·u', not c·u^c/u·u': 0 and no 0/0 at u = 0 where c > 1.
            const Scaled w = scaled(s.a);
            if (w.factor != 1 && steps_[w.of].op == Op::log) {
                const Node u = steps_[w.of].a;
                return scale(w.factor, chain(function(Op::exp, scale(w.factor - 1, w.of)), d[u]));
            }
            return chain(f, da);
        }
        case Op::log: return divide(da, s.a);
        case Op::sin: return chain(function(Op::cos, s.a), da);
        case Op::cos: return negate(chain(function(Op::sin, s.a), da));
        case Op::tan: return chain(add(constant(1), function(Op::square, f)), da);
        case Op::power: return scale(s.exponent, chain(integer_power(s.a, s.exponent - 1), da));
        case Op::add: return add(da, db);
        case Op::subtract: return subtract(da, db);
        case Op::multiply: return add(chain(s.b, da), chain(s.a, db));
        case Op::divide:
            if (is(db, 0)) return divide(da, s.b);
            return divide(subtract(da, chain(f, db)), s.b);
        case Op::min: return where_first(subtract(s.b, s.a));
        case Op::max: return where_first(subtract(s.a, s.b));
        default: return zero;  // of step; constants and variables are not asked
    }
}

Node FormulaGraph::derivative(Node f, int axis) {
    assert(axis >= 0 && axis < 3);
    const auto own = static_cast<Op>(static_cast<int>(Op::x) + axis);
    std::vector<Node>& d = derivatives_[static_cast<std::size_t>(axis)];
    d.resize(std::max<std::size_t>(d.size(), f + std::size_t{1}), kUnknown);

    std::vector<bool> wanted(f + std::size_t{1}, false);
    wanted[f] = true;
    for (std::size_t i = f + std::size_t{1}; i-- > 0;) {
        if (!wanted[i] || d[i] != kUnknown) continue;
        const Step& s = steps_[i];
        if (has_one_operand(s.op) || has_two_operands(s.op)) wanted[s.a] = true;
        if (has_two_operands(s.op)) wanted[s.b] = true;
    }
    for (Node i = 0; i <= f; ++i) {
        if (!wanted[i] || d[i] != kUnknown) continue;
        d[i] = steps_[i].op < Op::negate ? constant(steps_[i].op == own ? 1 : 0) : derivative_of_step(i, d);
    }
    return d[f];
}

// Programs

Program FormulaGraph::program(std::span<const Node> outputs) const {
    std::vector<Node> number(steps_.size(), kUnknown);  // 0: wanted
    for (const Node f : outputs) number[f] = 0;
    for (std::size_t i = steps_.size(); i-- > 0;) {
        if (number[i] == kUnknown) continue;
        const Step& s = steps_[i];
        if (has_one_operand(s.op) || has_two_operands(s.op)) number[s.a] = 0;
        if (has_two_operands(s.op)) number[s.b] = 0;
    }
    Program program;
    for (std::size_t i = 0; i < steps_.size(); ++i) {
        if (number[i] == kUnknown) continue;
        Step s = steps_[i];
        if (has_one_operand(s.op) || has_two_operands(s.op)) s.a = number[s.a];
        if (has_two_operands(s.op)) s.b = number[s.b];
        number[i] = static_cast<Node>(program.steps.size());
        program.steps.push_back(s);
    }
    for (const Node f : outputs) program.outputs.push_back(number[f]);
    return program;
}

}  // namespace pellucid
