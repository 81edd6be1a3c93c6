#include "field/expression.hpp"

#include <algorithm>
#include <cassert>
#include <mutex>

#include "core/error.hpp"
#include "core/real.hpp"
#include "field/formula_glsl.hpp"
#include "field/formula_graph.hpp"
#include "field/formula_parser.hpp"

namespace pellucid {
namespace {

using Node = FormulaGraph::Node;

constexpr int kNotPolynomial = -1;
constexpr int kMostDegree = 1000;

/// Degree of the only output in those variables, the others held fixed.
[[nodiscard]] std::optional<int> degree_of(const Program& program, const std::array<bool, 3>& varies) {
    std::vector<int> degrees;
    degrees.reserve(program.steps.size());
    for (const Step& s : program.steps) {
        const auto a = [&] { return degrees[s.a]; };
        const auto b = [&] { return degrees[s.b]; };
        const auto fixed = [](int all) { return all == 0 ? 0 : kNotPolynomial; };
        const auto both = [&](int degree) {
            return std::min(a(), b()) == kNotPolynomial ? kNotPolynomial : degree;
        };
        int degree = kNotPolynomial;
        switch (s.op) {
            case Op::constant: degree = 0; break;
            case Op::x: degree = varies[0] ? 1 : 0; break;
            case Op::y: degree = varies[1] ? 1 : 0; break;
            case Op::z: degree = varies[2] ? 1 : 0; break;
            case Op::negate: degree = a(); break;
            case Op::square: degree = a() == kNotPolynomial ? kNotPolynomial : 2 * a(); break;
            case Op::power:
                degree = s.exponent < 0 || a() == kNotPolynomial ? fixed(a()) : s.exponent * a();
                break;
            case Op::add:
            case Op::subtract: degree = both(std::max(a(), b())); break;
            case Op::multiply: degree = both(a() + b()); break;
            case Op::divide: degree = b() == 0 ? a() : kNotPolynomial; break;
            case Op::min:
            case Op::max: degree = fixed(a() == 0 ? b() : a()); break;
            default: degree = fixed(a()); break;  // functions of one argument
        }
        degrees.push_back(degree > kMostDegree ? kNotPolynomial : degree);
    }
    const int degree = degrees[program.outputs[0]];
    return degree == kNotPolynomial ? std::nullopt : std::optional(degree);
}

[[nodiscard]] std::array<Real, 3> reals(const Vec3& x) { return {Real(x.x), Real(x.y), Real(x.z)}; }

}  // namespace

struct Expression::State {
    std::string text;
    Program value;
    std::array<Program, 3> slope;
    Program gradient;
    std::optional<int> degree;
    std::array<std::optional<int>, 3> degree_along;
    bool has_kinks = false;

    std::shared_ptr<const State> zeros;  // null: of itself
    bool touches = false;

    void complete(std::string_view read_text);

    // For the Hessian
    Node f = 0;
    std::array<Node, 3> first{};
    mutable std::once_flag hessian_once;
    mutable FormulaGraph graph;
    mutable Program hessian;
};

Expression::Expression(std::string_view text, const std::map<std::string, double>& parameters) {
    FormulaGraph graph;
    const Node f = parse_formula(text, parameters, kMostDepth, graph);
    const auto state = std::make_shared<State>();
    const Node zeros = graph.zeros(f, state->touches);
    if (zeros != f) {
        const auto simpler = std::make_shared<State>();
        simpler->graph = graph;
        simpler->f = zeros;
        simpler->complete(text);
        state->zeros = simpler;
    }
    state->graph = std::move(graph);
    state->f = f;
    state->complete(text);
    state_ = state;
}

/// All but the Hessian, from graph and f.
void Expression::State::complete(std::string_view read_text) {
    value = graph.program(std::array{f});
    if (value.steps.size() > kMostOperations)
        throw input_error("expression: {} operations after simplification, expected at most {}", value.steps.size(),
                          kMostOperations);
    text = read_text;
    for (int axis = 0; axis < 3; ++axis) {
        const auto i = static_cast<std::size_t>(axis);
        first[i] = graph.derivative(f, axis);
        slope[i] = graph.program(std::array{f, first[i]});
        degree_along[i] = degree_of(value, {axis == 0, axis == 1, axis == 2});
    }
    gradient = graph.program(std::array{f, first[0], first[1], first[2]});
    degree = degree_of(value, {true, true, true});
    has_kinks = std::any_of(value.steps.begin(), value.steps.end(), [](const Step& step) {
        return step.op == Op::abs || step.op == Op::min || step.op == Op::max;
    });
}

Expression Expression::zeros() const { return state_->zeros ? Expression(state_->zeros) : *this; }
bool Expression::touches() const { return state_->touches; }

const Program& Expression::value() const { return state_->value; }

const Program& Expression::slope(int axis) const {
    assert(axis >= 0 && axis < 3);
    return state_->slope[static_cast<std::size_t>(axis)];
}

const Program& Expression::gradient() const { return state_->gradient; }

const Program& Expression::hessian() const {
    const State& s = *state_;
    std::call_once(s.hessian_once, [&s] {
        const auto& [fx, fy, fz] = s.first;
        FormulaGraph& g = s.graph;
        s.hessian = g.program(std::array{s.f, fx, fy, fz, g.derivative(fx, 0), g.derivative(fy, 1),
                                         g.derivative(fz, 2), g.derivative(fx, 1), g.derivative(fx, 2),
                                         g.derivative(fy, 2)});
        s.graph = FormulaGraph();  // nobody needs it any more
    });
    return s.hessian;
}

double Expression::at(const Vec3& x) const { return evaluate_at<Real, 1>(state_->value, reals(x))[0].value; }

Vec3 Expression::gradient_at(const Vec3& x) const {
    const auto fg = evaluate_at<Real, 4>(state_->gradient, reals(x));
    return {fg[1].value, fg[2].value, fg[3].value};
}

std::optional<int> Expression::degree() const { return state_->degree; }

std::optional<int> Expression::degree_along(int axis) const {
    assert(axis >= 0 && axis < 3);
    return state_->degree_along[static_cast<std::size_t>(axis)];
}

bool Expression::has_kinks() const { return state_->has_kinks; }
const std::string& Expression::text() const { return state_->text; }

std::string Expression::glsl(std::string_view name, bool with_gradient) const {
    std::string source = glsl_function(state_->value, name);
    if (!with_gradient) return source;
    Program gradient = state_->gradient;
    std::rotate(gradient.outputs.begin(), gradient.outputs.begin() + 1, gradient.outputs.end());
    return source + "\n" + glsl_function(gradient, std::string(name) + "_gradient");
}

}  // namespace pellucid
