// A formula as a list of steps, and its evaluation over any algebra.
//
// One representation serves everything: a number gives the value, an interval the range over a box, a polynomial
// the restriction to a line, an interval with an error bound the rounding. `run_program` needs from its algebra T, found
// by argument-dependent lookup:
//     T(double), + − × ÷, unary −, square, abs, sqrt, exp, log, sin, cos, tan, min, max, power(T, int), step(T).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/vec.hpp"

namespace pellucid {

enum class Op : std::uint8_t {
    constant, x, y, z,                                        // no operand
    negate, square, abs, sqrt, exp, log, sin, cos, tan,       // a
    power,                                                    // a to the integer `exponent`, not 0, 1 or 2
    step,                                                     // 1 where a >= 0, else 0: in derivatives of kinks
    add, subtract, multiply, divide, min, max,                // a, b
};

/// Operands are the numbers of earlier steps.
struct Step {
    Op op = Op::constant;
    std::uint32_t a = 0;
    std::uint32_t b = 0;
    std::int32_t exponent = 0;
    double value = 0;  // of a constant

    [[nodiscard]] bool operator==(const Step&) const = default;
};

/// Steps in order; `outputs` are the numbers of those whose results are wanted.
struct Program {
    std::vector<Step> steps;
    std::vector<std::uint32_t> outputs;
};

/// Runs a program at one point (or box, line, …).
///   values   scratch: afterwards holds the result of every step
///   out      room for program.outputs.size()
template <class T>
void run_program(const Program& program, const std::array<T, 3>& at, std::vector<T>& values, std::span<T> out) {
    values.clear();
    values.reserve(program.steps.size());
    for (const Step& s : program.steps) {
        const auto a = [&]() -> const T& { return values[s.a]; };
        const auto b = [&]() -> const T& { return values[s.b]; };
        switch (s.op) {
            case Op::constant: values.push_back(T(s.value)); break;
            case Op::x: values.push_back(at[0]); break;
            case Op::y: values.push_back(at[1]); break;
            case Op::z: values.push_back(at[2]); break;
            case Op::negate: values.push_back(-a()); break;
            case Op::square: values.push_back(square(a())); break;
            case Op::abs: values.push_back(abs(a())); break;
            case Op::sqrt: values.push_back(sqrt(a())); break;
            case Op::exp: values.push_back(exp(a())); break;
            case Op::log: values.push_back(log(a())); break;
            case Op::sin: values.push_back(sin(a())); break;
            case Op::cos: values.push_back(cos(a())); break;
            case Op::tan: values.push_back(tan(a())); break;
            case Op::power: values.push_back(power(a(), s.exponent)); break;
            case Op::step: values.push_back(step(a())); break;
            case Op::add: values.push_back(a() + b()); break;
            case Op::subtract: values.push_back(a() - b()); break;
            case Op::multiply: values.push_back(a() * b()); break;
            case Op::divide: values.push_back(a() / b()); break;
            case Op::min: values.push_back(min(a(), b())); break;
            case Op::max: values.push_back(max(a(), b())); break;
        }
    }
    for (std::size_t i = 0; i < program.outputs.size(); ++i) out[i] = values[program.outputs[i]];
}

/// The results at one place, with a scratch a thread.
template <class T, std::size_t outputs>
[[nodiscard]] std::array<T, outputs> evaluate_at(const Program& program, const std::array<T, 3>& at) {
    thread_local std::vector<T> values;
    std::array<T, outputs> out;
    run_program<T>(program, at, values, out);
    return out;
}

}  // namespace pellucid
