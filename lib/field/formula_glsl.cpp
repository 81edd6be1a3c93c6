#include "field/formula_glsl.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <vector>

#include <fmt/format.h>

namespace pellucid {
namespace {

/// Nearest float, in digits that give it back; beyond the largest, that.
[[nodiscard]] std::string literal(double value) {
    constexpr double kMost = std::numeric_limits<float>::max();
    const auto nearest = static_cast<float>(std::clamp(value, -kMost, kMost));
    std::string digits = fmt::format("{:.9g}", std::abs(nearest));
    if (digits.find_first_of(".e") == std::string::npos) digits += ".0";
    return nearest < 0 ? "(-" + digits + ")" : digits;
}

class Writer {
public:
    explicit Writer(const Program& program) : program_(program), names_(program.steps.size()) {
        for (std::size_t i = 0; i < program.steps.size(); ++i) names_[i] = written(i);
    }

    [[nodiscard]] const std::string& name(std::size_t step) const { return names_[step]; }
    [[nodiscard]] const std::string& body() const { return body_; }

private:
    /// The statement of a step; returns how others call its result.
    [[nodiscard]] std::string written(std::size_t i) {
        const Step& s = program_.steps[i];
        const auto a = [&]() -> const std::string& { return names_[s.a]; };
        const auto b = [&]() -> const std::string& { return names_[s.b]; };
        const auto let = [&](const std::string& value) { return variable(fmt::format("t{}", i), value); };
        switch (s.op) {
            case Op::constant: return literal(s.value);
            case Op::x: return "p.x";
            case Op::y: return "p.y";
            case Op::z: return "p.z";
            case Op::negate: return let("-" + a());
            case Op::square: return let(a() + " * " + a());
            case Op::abs: return let("abs(" + a() + ")");
            case Op::sqrt: return let("sqrt(" + a() + ")");
            case Op::exp: return let("exp(" + a() + ")");
            case Op::log: return let("log(" + a() + ")");
            case Op::sin: return let("sin(" + a() + ")");
            case Op::cos: return let("cos(" + a() + ")");
            case Op::tan: return let("tan(" + a() + ")");
            case Op::power: return let(power(i, a(), s.exponent));
            case Op::step: return let("step(0.0, " + a() + ")");
            case Op::add: return let(a() + " + " + b());
            case Op::subtract: return let(a() + " - " + b());
            case Op::multiply: return let(a() + " * " + b());
            case Op::divide: return let(a() + " / " + b());
            case Op::min: return let("min(" + a() + ", " + b() + ")");
            case Op::max: return let("max(" + a() + ", " + b() + ")");
        }
        return {};
    }

    /// As `power` of core/real.hpp: pow() of GLSL knows no negative base.
    [[nodiscard]] std::string power(std::size_t i, const std::string& base, int exponent) {
        std::string result;
        std::string square = base;
        unsigned bit = 1;  // square is base^bit
        for (auto n = static_cast<unsigned>(std::abs(exponent)); n != 0; n >>= 1U, bit <<= 1U) {
            if ((n & 1U) != 0)
                result = result.empty() ? square
                                        : variable(fmt::format("t{}_to_{}", i, bit), result + " * " + square);
            if (n > 1) square = variable(fmt::format("t{}_square_{}", i, 2 * bit), square + " * " + square);
        }
        return exponent < 0 ? "1.0 / " + result : result;
    }

    [[nodiscard]] std::string variable(std::string name, const std::string& value) {
        body_ += fmt::format("    float {} = {};\n", name, value);
        return name;
    }

    const Program& program_;
    std::vector<std::string> names_;
    std::string body_;
};

}  // namespace

std::string glsl_function(const Program& program, std::string_view name) {
    assert(program.outputs.size() == 1 || program.outputs.size() == 4);
    const Writer writer(program);
    std::string result = writer.name(program.outputs[0]);
    for (std::size_t i = 1; i < program.outputs.size(); ++i) result += ", " + writer.name(program.outputs[i]);
    const bool one = program.outputs.size() == 1;
    return fmt::format("{} {}(vec3 p) {{\n{}    return {};\n}}\n", one ? "float" : "vec4", name,
                       writer.body(), one ? result : "vec4(" + result + ")");
}

}  // namespace pellucid
