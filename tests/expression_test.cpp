// Formulas against C++ that says the same, in numbers that carry their own derivatives and rounding.
#include "field/expression.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <optional>
#include <random>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include "core/error.hpp"
#include "core/real.hpp"
#include "render/backend.hpp"
#include "vulkan/device.hpp"

namespace pellucid {
namespace {

// A number that carries its derivatives and how wrong rounding may have made it

/// What one operation adds to the error, in units of the roundoff (2^-53 or 2^-24) times its result.
struct InDouble {
    static constexpr long double kRoundoff = 0x1p-53L;
    static constexpr long double kConstant = 0, kDivide = 1, kSqrt = 1;
    static long double exp(long double) { return 2 * kElementaryUlp; }
    static long double log(long double v) { return 2 * kElementaryUlp * std::abs(v); }
    static constexpr long double kSine = 0;  // beside the relative error
};

/// What Vulkan promises of GLSL: environment for SPIR-V, "Precision and Operation of SPIR-V Instructions".
struct OnDevice {
    static constexpr long double kRoundoff = 0x1p-24L;
    static constexpr long double kConstant = 1, kDivide = 5, kSqrt = 10;
    static long double exp(long double a) { return 2 * (3 + 2 * std::abs(a)); }
    static long double log(long double v) { return std::max(6 * std::abs(v), 8.0L); }
    static constexpr long double kSine = 0x1p13L;  // 2^-11 between -pi and pi
};

constexpr int kPairs[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};  // the order of hessian()

template <class Rounding>
struct Jet {
    long double v = 0;
    std::array<long double, 3> d{};
    std::array<long double, 6> dd{};
    long double e = 0;  // error in units of the roundoff, to first order
    bool bad = false;   // undefined, huge, or an error too large for first order

    Jet() = default;
    explicit Jet(double value) : v(value), e(Rounding::kConstant * std::abs(v)) { judge(); }
    [[nodiscard]] static Jet variable(double value, std::size_t axis) {
        Jet j;
        j.v = value;
        j.d[axis] = 1;
        return j;
    }
    [[nodiscard]] long double error() const { return e * Rounding::kRoundoff; }
    void judge() {
        bad = bad || !std::isfinite(v) || !std::isfinite(e) || std::abs(v) > 1e60L;
    }

    /// f(a) with its derivatives; own: its own error.
    [[nodiscard]] static Jet of(const Jet& a, long double f, long double f1, long double f2,
                                long double own) {
        Jet j;
        j.v = f;
        for (std::size_t i = 0; i < 3; ++i) j.d[i] = f1 * a.d[i];
        for (std::size_t k = 0; k < 6; ++k) j.dd[k] = f1 * a.dd[k] + f2 * a.part(k, 0) * a.part(k, 1);
        j.e = std::abs(f1) * a.e + own;
        // The slope must not change much over the error.
        j.bad = a.bad || std::abs(f2) * a.error() > 1e-2L * std::abs(f1) + 1e-20L;
        j.judge();
        return j;
    }
    [[nodiscard]] long double part(std::size_t k, std::size_t side) const {
        return d[static_cast<std::size_t>(kPairs[k][side])];
    }

    friend Jet operator-(const Jet& a) { return of(a, -a.v, -1, 0, 0); }
    friend Jet operator+(const Jet& a, const Jet& b) {
        Jet j;
        j.v = a.v + b.v;
        for (std::size_t i = 0; i < 3; ++i) j.d[i] = a.d[i] + b.d[i];
        for (std::size_t k = 0; k < 6; ++k) j.dd[k] = a.dd[k] + b.dd[k];
        j.e = a.e + b.e + std::abs(j.v);
        j.bad = a.bad || b.bad;
        j.judge();
        return j;
    }
    friend Jet operator-(const Jet& a, const Jet& b) { return a + -b; }
    friend Jet operator*(const Jet& a, const Jet& b) {
        Jet j;
        j.v = a.v * b.v;
        for (std::size_t i = 0; i < 3; ++i) j.d[i] = a.d[i] * b.v + a.v * b.d[i];
        for (std::size_t k = 0; k < 6; ++k)
            j.dd[k] =
                a.dd[k] * b.v + a.part(k, 0) * b.part(k, 1) + a.part(k, 1) * b.part(k, 0) + a.v * b.dd[k];
        j.e = std::abs(a.v) * b.e + std::abs(b.v) * a.e + a.e * b.e * Rounding::kRoundoff + std::abs(j.v);
        j.bad = a.bad || b.bad;
        j.judge();
        return j;
    }
    friend Jet operator/(const Jet& a, const Jet& b) {
        const long double r = 1 / b.v;
        return a * of(b, r, -r * r, 2 * r * r * r, Rounding::kDivide * std::abs(r));
    }
    friend Jet square(const Jet& a) { return a * a; }
    friend Jet abs(const Jet& a) { return of(a, std::abs(a.v), a.v < 0 ? -1 : 1, 0, 0); }
    friend Jet sqrt(const Jet& a) {
        const long double s = std::sqrt(a.v);
        return of(a, s, 0.5L / s, -0.25L / (s * a.v), Rounding::kSqrt * s);
    }
    friend Jet exp(const Jet& a) {
        const long double f = std::exp(a.v);
        return of(a, f, f, f, Rounding::exp(a.v) * f);
    }
    friend Jet log(const Jet& a) {
        const long double f = std::log(a.v);
        return of(a, f, 1 / a.v, -1 / (a.v * a.v), Rounding::log(f));
    }
    friend Jet sin(const Jet& a) {
        const long double s = std::sin(a.v);
        return of_sine(a, s, std::cos(a.v), -s);
    }
    friend Jet cos(const Jet& a) {
        const long double c = std::cos(a.v);
        return of_sine(a, c, -std::sin(a.v), -c);
    }
    friend Jet tan(const Jet& a) {
        const Jet quotient = sin(a) / cos(a);
        const long double t = std::tan(a.v);
        Jet j = of(a, t, 1 + t * t, 2 * t * (1 + t * t), 0);
        j.e = quotient.e;
        j.bad = j.bad || quotient.bad;
        return j;
    }
    // As documented: the first where equal.
    friend Jet min(const Jet& a, const Jet& b) { return chosen(a, b, a.v > b.v ? b : a); }
    friend Jet max(const Jet& a, const Jet& b) { return chosen(a, b, a.v < b.v ? b : a); }
    friend Jet step(const Jet& a) {
        Jet j;
        j.v = a.v >= 0 ? 1 : 0;
        j.bad = a.bad || std::abs(a.v) <= 4 * a.error();
        return j;
    }
    friend Jet power(const Jet& a, int exponent) {
        Jet j(1.0);
        j.bad = a.bad;  // also to the 0
        for (int i = 0; i < std::abs(exponent); ++i) j = j * a;
        return exponent < 0 ? Jet(1.0) / j : j;
    }
    friend Jet pow(const Jet& a, const Jet& b) { return exp(b * log(a)); }

private:
    /// The error within a large argument counts as if it were relative to 1.
    [[nodiscard]] static Jet of_sine(const Jet& a, long double f, long double f1, long double f2) {
        Jet j = of(a, f, f1, f2, Rounding::kSine + 2 * kElementaryUlp * std::abs(f));
        j.e += a.error() * a.e;  // where the slope is 0
        j.bad = a.bad || a.error() > 1e-3L;
        return j;
    }
    [[nodiscard]] static Jet chosen(const Jet& a, const Jet& b, Jet one) {
        one.e = std::max(a.e, b.e);
        one.bad = a.bad || b.bad;
        return one;
    }
};

using Number = Jet<InDouble>;

// Formulas and what they mean

struct Formula {
    const char* text;
    std::function<Number(Number, Number, Number)> meaning;
    double lo = -1.5, hi = 1.5;  // of x, y and z
};

[[nodiscard]] Number c(double value) { return Number(value); }

constexpr double kGolden = 1.618033988749895;
const std::map<std::string, double> kParameters{{"t", kGolden * kGolden}, {"g", kGolden}};
constexpr const char* kBarth =
    "4*(t*x^2-y^2)*(t*y^2-z^2)*(t*z^2-x^2)-(1+2*g)*(x^2+y^2+z^2-1)^2";

const std::vector<Formula>& formulas() {
    using N = const Number&;
    static const std::vector<Formula> all{
        {"x", [](N x, N, N) { return x; }},
        {"(x^2+y^2+z^2+1-0.16)^2-4*(x^2+y^2)",
         [](N x, N y, N z) {
             const Number s = x * x + y * y + z * z + c(0.84);
             return s * s - c(4) * (x * x + y * y);
         }},
        {kBarth,
         [](N x, N y, N z) {
             const Number t = c(kGolden * kGolden);
             const Number s = x * x + y * y + z * z - c(1);
             return c(4) * (t * x * x - y * y) * (t * y * y - z * z) * (t * z * z - x * x) -
                    (c(1) + c(2) * c(kGolden)) * s * s;
         }},
        {"(x^2+9/4*y^2+z^2-1)^3-x^2*z^3-9/80*y^2*z^3",
         [](N x, N y, N z) {
             return power(x * x + c(2.25) * y * y + z * z - c(1), 3) - x * x * z * z * z -
                    c(0.1125) * y * y * z * z * z;
         }},
        {"sin(x)*cos(y)+sin(y)*cos(z)+sin(z)*cos(x)",
         [](N x, N y, N z) { return sin(x) * cos(y) + sin(y) * cos(z) + sin(z) * cos(x); }},
        {"sin(-x)+cos(-y)-tan(-z/4)", [](N x, N y, N z) { return cos(y) - sin(x) + tan(z / c(4)); }},
        {"tan(x/4)/(2+cos(y*z))", [](N x, N y, N z) { return tan(x / c(4)) / (c(2) + cos(y * z)); }},
        {"sqrt(x^2+y^2)-abs(z)*abs(-2*x)^3",
         [](N x, N y, N z) { return sqrt(x * x + y * y) - abs(z) * power(abs(c(2) * x), 3); }},
        {"exp(-x^2)*log(y+3)-z*pi",
         [](N x, N y, N z) { return exp(-(x * x)) * log(y + c(3)) - z * c(3.141592653589793); }},
        {"min(x, y, z) + max(x*y, z, 0.3)",
         [](N x, N y, N z) { return min(min(x, y), z) + max(max(x * y, z), c(0.3)); }},
        {"x^7-3*x^5*y+z^4*x^-2",
         [](N x, N y, N z) { return power(x, 7) - c(3) * power(x, 5) * y + power(z, 4) / (x * x); }},
        {"((x+y)/(x-3))^2*(y+x)",
         [](N x, N y, N) { return (x + y) / (x - c(3)) * ((x + y) / (x - c(3))) * (x + y); }},
        {"(x-y)*(y-x)/(0.1*z+1)", [](N x, N y, N z) { return (x - y) * (y - x) / (c(0.1) * z + c(1)); }},
        {"3*(0.1*x)*(0.2*y)-x/3/z",
         [](N x, N y, N z) { return c(3) * c(0.1) * x * c(0.2) * y - x / c(3) / z; }},
        {"1+x+2-(3-y)-(-z-x*2)", [](N x, N y, N z) { return c(3) * x + y + z; }},
        {"x^y", [](N x, N y, N) { return pow(x, y); }, 0.2, 1.5},
        {"2^-x^2*y", [](N x, N y, N) { return exp(-(x * x) * log(c(2))) * y; }},
        {"x^-3+y^-1+z^-0.5", [](N x, N y, N z) { return power(x, -3) + c(1) / y + c(1) / sqrt(z); }, 0.2,
         1.5},
        {"x^1.7-y^0.5*z^-2.25", [](N x, N y, N z) { return pow(x, c(1.7)) - sqrt(y) * pow(z, c(-2.25)); },
         0.2, 1.5},
        {"log(x)^3/sqrt(y)+z^0", [](N x, N y, N) { return power(log(x), 3) / sqrt(y) + c(1); }, 0.2, 1.5},
        {"exp(2*log(x))*exp(log(y))", [](N x, N y, N) { return x * x * y; }, 0.2, 1.5},
        {"(-x)^1001+(-y)^1002+z^-1001",
         [](N x, N y, N z) { return -power(x, 1001) + power(y, 1002) + power(z, -1001); }, 0.98, 1.02},
    };
    return all;
}

[[nodiscard]] Expression parsed(const std::string& text) { return Expression(text, kParameters); }

[[nodiscard]] std::array<Number, 3> variables(const std::array<double, 3>& at) {
    return {Number::variable(at[0], 0), Number::variable(at[1], 1), Number::variable(at[2], 2)};
}

/// Results of a program in double, with bounds of their error from the same steps.
struct Bounded {
    std::vector<double> value;
    std::vector<double> error;
    bool bad = false;
};

[[nodiscard]] std::vector<double> in_double(const Program& program, const std::array<double, 3>& at) {
    std::vector<Real> values;
    std::vector<Real> out(program.outputs.size());
    run_program<Real>(program, {Real(at[0]), Real(at[1]), Real(at[2])}, values, out);
    std::vector<double> numbers;
    for (const Real r : out) numbers.push_back(r.value);
    return numbers;
}

template <class Rounding>
[[nodiscard]] Bounded bounded(const Program& program, const std::array<double, 3>& at) {
    using J = Jet<Rounding>;
    std::vector<J> values;
    std::vector<J> out(program.outputs.size());
    run_program<J>(program, {J::variable(at[0], 0), J::variable(at[1], 1), J::variable(at[2], 2)}, values, out);
    Bounded b{.value = in_double(program, at), .error = {}};
    for (const J& j : out) {
        b.error.push_back(static_cast<double>(j.error()));
        b.bad = b.bad || j.bad;
    }
    return b;
}

class Points {
public:
    explicit Points(unsigned seed) : random_(seed) {}
    [[nodiscard]] std::array<double, 3> next(double lo, double hi) {
        std::uniform_real_distribution<double> in(lo, hi);
        return {in(random_), in(random_), in(random_)};
    }

private:
    std::mt19937_64 random_;
};

TEST(Expression, ValuesAreThoseOfTheSameFormulaInCpp) {
    Points points(1);
    for (const Formula& f : formulas()) {
        const Expression e = parsed(f.text);
        int compared = 0;
        for (int i = 0; i < 1000; ++i) {
            const auto at = points.next(f.lo, f.hi);
            const auto [x, y, z] = variables(at);
            const Number expected = f.meaning(x, y, z);
            const Bounded own = bounded<InDouble>(e.value(), at);
            if (expected.bad || own.bad) continue;
            ++compared;
            const double got = e.at({at[0], at[1], at[2]});
            ASSERT_NEAR(got, static_cast<double>(expected.v),
                        static_cast<double>(expected.error()) + own.error[0])
                << f.text << " at " << at[0] << ' ' << at[1] << ' ' << at[2];
        }
        EXPECT_GT(compared, 900) << f.text;
    }
}

TEST(Expression, GradientsAndHessiansAreThoseOfDualNumbers) {
    Points points(2);
    for (const Formula& f : formulas()) {
        const Expression e = parsed(f.text);
        int compared = 0;
        for (int i = 0; i < 300; ++i) {
            const auto at = points.next(f.lo, f.hi);
            const auto [x, y, z] = variables(at);
            const Number expected = f.meaning(x, y, z);
            const Bounded own = bounded<InDouble>(e.hessian(), at);
            if (expected.bad || own.bad) continue;
            ++compared;
            long double size = 1;
            for (const long double d : expected.d) size = std::max(size, std::abs(d));
            for (const long double d : expected.dd) size = std::max(size, std::abs(d));
            std::array<long double, 10> all{expected.v, expected.d[0], expected.d[1], expected.d[2]};
            std::copy(expected.dd.begin(), expected.dd.end(), all.begin() + 4);
            for (std::size_t k = 0; k < 10; ++k) {
                const auto wanted = static_cast<double>(all[k]);
                const double allowed = own.error[k] + static_cast<double>(1e-15L * size);
                ASSERT_NEAR(own.value[k], wanted, allowed) << f.text << " output " << k;
                ASSERT_LT(own.error[k], static_cast<double>(1e-9L * size)) << f.text << " output " << k;
            }
            // The other programs say the same, to the bit where the steps are the same.
            const auto gradient = in_double(e.gradient(), at);
            const Vec3 g = e.gradient_at({at[0], at[1], at[2]});
            for (std::size_t k = 0; k < 4; ++k) ASSERT_EQ(gradient[k], own.value[k]) << f.text;
            for (int axis = 0; axis < 3; ++axis) {
                const auto slope = in_double(e.slope(axis), at);
                ASSERT_EQ(slope[0], own.value[0]) << f.text;
                ASSERT_EQ(slope[1], gradient[static_cast<std::size_t>(axis) + 1]) << f.text;
                ASSERT_EQ(g[axis], slope[1]) << f.text;
            }
        }
        EXPECT_GT(compared, 200) << f.text;
    }
}

TEST(Expression, PrecedenceAndSpelling) {
    const struct {
        const char* text;
        double value;  // at x = 2, y = 3, z = 5
    } table[] = {
        {"2+3*4", 14},        {"2-3-4", -5},         {"24/4/2", 3},          {"2^3^2", 512},
        {"-2^2", -4},         {"(-2)^2", 4},         {"2^-1", 0.5},          {"2^-2^2", 0.0625},
        {"-x^2", -4},         {"x^-2^2", 0.0625},    {"--x", 2},             {"x--y", 5},
        {"x*-y", -6},         {"x/-y*y", -2},        {"+x", 2},              {"2*x^3", 16},
        {"x/y*z", 10.0 / 3},  {"-x^-1", -0.5},       {"1e-3", 0.001},        {".5", 0.5},
        {"5.", 5},            {"1E2", 100},          {"1e+2*x", 200},        {"min(x,y)-max(x,y,z)", -3},
        {"2^x^y", 256},       {"0^0", 1},            {"(0*x)^0", 1},         {"x^0", 1},
        {"(-x)^3", -8},       {"(-2)^-3", -0.125},   {"sqrt (4)", 2},        {" \n x\t+\r\n y ", 5},
        {"-x+y", 1},          {"-x*y", -6},          {"-(x-y)-z", -4},       {"2^-x^2*y", 0.1875},
        {"(((x)))", 2},       {"max(min(x,y),z)", 5}, {"x^-+-2", 4},         {"0^0.5", 0},
        {"0^0.3", 0},         {"(-1)^1001", -1},     {"(-1)^1e300", 1},      {"x-y-z", -6},
        {"x-(y-z)", 4},       {"1-x-1", -2},         {"z/(y/x)", 10.0 / 3},  {"x^y*z", 40},
        {"abs(-x)", 2},       {"-abs(-y)*2", -6},    {"x^10", 1024},         {"x^-10*1024", 1},
    };
    for (const auto& row : table)
        EXPECT_NEAR(parsed(row.text).at({2, 3, 5}), row.value, 1e-14 * std::abs(row.value)) << row.text;
    EXPECT_EQ(parsed(" x + y\n").text(), " x + y\n");
}

[[nodiscard]] std::string message_of(const std::string& text,
                                     const std::map<std::string, double>& parameters = {}) {
    try {
        const Expression e(text, parameters);
    } catch (const Error& error) {
        EXPECT_EQ(error.kind(), Failure::input);
        return error.what();
    }
    return "accepted";
}

TEST(Expression, ErrorsNameColumnTextAndExpectation) {
    const std::string value = ", expected a number, a name, \"(\" or a sign";
    const std::string behind = " directly behind a value, expected an operator (a product needs *)";
    const struct {
        std::string text, message;
    } table[] = {
        {"", ": it is empty, expected a formula of x, y and z"},
        {" \n\t", ": it is empty, expected a formula of x, y and z"},
        {"x + y*foo",
         ", column 7: \"foo\" is no name here, expected x, y, z, pi or a function: sqrt abs exp log sin "
         "cos tan min max"},
        {"x +", ", column 4: the text ends" + value},
        {"x\n+ y\n* q",
         ", line 3, column 3: \"q\" is no name here, expected x, y, z, pi or a function: sqrt abs exp "
         "log sin cos tan min max"},
        {"(x", ", column 1: \"(\" is never closed, expected \")\""},
        {"1+sin(x", ", column 3: \"sin(\" is never closed, expected \")\""},
        {"x)", ", column 2: \")\" closes nothing, expected an operator or the end"},
        {"()", ", column 2: \")\"" + value},
        {"sin()", ", column 5: \")\"" + value},
        {"2x", ", column 2: \"x\"" + behind},
        {"x y", ", column 3: \"y\"" + behind},
        {"x(1)", ", column 2: \"(\"" + behind},
        {"(x)(y)", ", column 4: \"(\"" + behind},
        {"1.2.3", ", column 4: \".\"" + behind},
        {"0x10", ", column 2: \"x10\"" + behind},
        {"1e", ", column 2: \"e\"" + behind},
        {"x; y", ", column 2: \";\", expected an operator, \")\" or the end"},
        {"*x", ", column 1: \"*\"" + value},
        {"x**2", ", column 3: \"*\"" + value},
        {".", ", column 1: \".\" is no number"},
        {"1e999", ", column 1: the number 1e999 is not in the range of a double"},
        {"x+1e-999", ", column 3: the number 1e-999 is not in the range of a double"},
        {"x+1/0", ", column 4: \"/\" by 0, expected another divisor"},
        {"x/(y-y)", ", column 2: \"/\" by 0, expected another divisor"},
        {"0/0", ", column 2: \"/\" by 0, expected another divisor"},
        {"x*log(-1)", ", column 3: \"log\" of -1 is nan, expected a finite number"},
        {"log(0*x)", ", column 1: \"log\" of 0 is -inf, expected a finite number"},
        {"sqrt(-1)", ", column 1: \"sqrt\" of -1 is nan, expected a finite number"},
        {"1e200*1e200", ", column 6: \"*\" of 1e+200 and 1e+200 is inf, expected a finite number"},
        {"0^-1", ", column 2: \"^\" of 0 and -1 is inf, expected a finite number"},
        {"(-8)^(1/3)", ", column 5: \"^\" of -8 and 0.3333333333333333 is nan, expected a finite number"},
        {"(-2)^x", ", column 5: \"^\" of -2 to what varies, expected a positive base"},
        {"sin(x,y)", ", column 1: \"sin\" has 2 arguments, expected 1"},
        {"1+min(x)", ", column 3: \"min\" has 1 argument, expected 2 or more"},
        {"sin x", ", column 1: \"sin\" is a function, expected \"(\" behind it"},
        {"cos", ", column 1: \"cos\" is a function, expected \"(\" behind it"},
        {"(x,y)", ", column 3: \",\" stands between the arguments of a function, and here is none"},
        {"x,y", ", column 2: \",\" stands between the arguments of a function, and here is none"},
        {"max((x,y),z)", ", column 7: \",\" stands between the arguments of a function, and here is none"},
        {"max(x,)", ", column 7: \")\"" + value},
        {"x\xC3\x97y", ", column 2: \"\xC3\x97\", expected an operator, \")\" or the end"},
        {"\xE2\x88\x92x", ", column 1: \"\xE2\x88\x92\"" + value},
        {"1\xC3\x97x\xFF", ", column 2: \"\xC3\x97\", expected an operator, \")\" or the end"},
        {"x + \xFFy", ", column 5: the byte 0xff" + value},
        {"x + \xC3", ", column 5: the byte 0xc3" + value},
        {std::string("x\0y", 3), ", column 2: the byte 0x00, expected an operator, \")\" or the end"},
        {"x\x1b[31m", ", column 2: the byte 0x1b, expected an operator, \")\" or the end"},
    };
    for (const auto& row : table) EXPECT_EQ(message_of(row.text), "expression" + row.message) << row.text;

    const std::string long_name(5000, 'q');
    EXPECT_EQ(message_of(long_name).substr(0, 70),
              "expression, column 1: \"" + std::string(40, 'q') + "…\" is");
}

TEST(Expression, ParametersAreNamesThatHideNothing) {
    const Expression e("a_1*x + b2", {{"a_1", 3}, {"b2", -1}, {"x", 77}, {"sin", 5}, {"unused", kInfinity}});
    EXPECT_EQ(e.at({2, 0, 0}), 5);
    EXPECT_EQ(message_of("k", {{"k", kInfinity}}),
              "expression, column 1: the parameter \"k\" is inf, expected a finite number");
    EXPECT_EQ(
        message_of("j", {{"k", 1}, {"m", 2}}),
        "expression, column 1: \"j\" is no name here, expected x, y, z, pi, k, m or a function: sqrt abs exp "
        "log sin cos tan min max");
    EXPECT_EQ(message_of("sin*2", {{"sin", 1}}),
              "expression, column 1: \"sin\" is a function, expected \"(\" behind it");
}

[[nodiscard]] std::string repeated(const std::string& part, int count) {
    std::string all;
    for (int i = 0; i < count; ++i) all += part;
    return all;
}

TEST(Expression, DeepAndLongTextsNeitherOverflowNorTire) {
    const auto nested = [](const std::string& open, int count) {
        return repeated(open, count) + "x" + repeated(")", count);
    };
    const std::string too_deep = ": more than 1000 parentheses or functions inside of each other";
    EXPECT_EQ(parsed(nested("(", 1000)).value().steps.size(), 1U);
    EXPECT_EQ(message_of(nested("(", 1001)), "expression, column 1001" + too_deep);
    EXPECT_EQ(message_of(nested("(", 50000)), "expression, column 1001" + too_deep);
    EXPECT_EQ(message_of(repeated("(", 50000)), "expression, column 1001" + too_deep);
    EXPECT_EQ(message_of(nested("sin(", 50000)), "expression, column 4001" + too_deep);
    const Expression sines = parsed(nested("sin(", 1000));
    EXPECT_EQ(sines.value().steps.size(), 1001U);
    EXPECT_EQ(sines.hessian().outputs.size(), 10U);

    EXPECT_EQ(parsed(repeated("-", 100001) + "x").at({3, 0, 0}), -3);
    EXPECT_NE(message_of(repeated("2^", 5000) + "2").find("is inf, expected a finite number"),
              std::string::npos);
    EXPECT_EQ(parsed(repeated("1^", 50000) + "x").at({3, 0, 0}), 1);
    EXPECT_NE(message_of(repeated("x^", 50000) + "x")
                  .find("operations after simplification, expected at most 20000"),
              std::string::npos);

    // x·1 + x·2·y + …: ten thousand terms; a hundred thousand are refused.
    std::string terms = "0";
    for (int i = 1; i <= 6000; ++i) terms += fmt::format("+{}.5*y^{}", i, i % 900);
    EXPECT_LE(parsed(terms).value().steps.size(), Expression::kMostOperations);
    EXPECT_EQ(parsed(repeated("x+x*y+", 5000) + "0").at({2, 3, 0}), 40000);
    terms = "0";
    for (int i = 1; i <= 70000; ++i) terms += fmt::format("+x/{}", 2 * i + 1);
    EXPECT_EQ(message_of(terms),
              "expression: 210000 operations after simplification, expected at most 20000");
    EXPECT_EQ(message_of(repeated("x + y*", 1 << 20)), "expression: 6291456 bytes, expected at most 1048576");
    EXPECT_EQ(message_of(repeated(" ", 1 << 20)),
              "expression: it is empty, expected a formula of x, y and z");
}

[[nodiscard]] std::size_t steps(const std::string& text) { return parsed(text).value().steps.size(); }

TEST(Expression, EqualPartsAreOneStep) {
    EXPECT_EQ(steps("(x+y)^2+(x+y)"), 5U);  // x, y, their sum, its square, the sum
    EXPECT_EQ(steps("(x+y)*(y+x)"), 4U);
    EXPECT_EQ(steps("sin(x*y)+cos(y*x)"), 6U);
    EXPECT_EQ(steps("x^2*(x*x)+x^4"), 4U);  // 2·x⁴ and the 2

    const Expression e = parsed("exp(x*y)");
    // x, y, x·y, exp; times y, times x: value and derivatives share.
    EXPECT_EQ(e.gradient().steps.size(), 7U);  // and 0 = ∂z
    EXPECT_EQ(e.slope(2).steps.size(), 5U);

    const Expression barth = parsed(kBarth);
    const auto work = [](const Program& p) {
        return std::count_if(p.steps.begin(), p.steps.end(), [](const Step& s) { return s.op > Op::z; });
    };
    EXPECT_LE(work(barth.value()), 18);
    EXPECT_LE(work(barth.gradient()), 48);
    EXPECT_LE(work(barth.hessian()), 120);
}

TEST(Expression, ProgramsHaveOnlyWantedStepsInOrder) {
    for (const Formula& f : formulas()) {
        const Expression e = parsed(f.text);
        for (const Program* p :
             {&e.value(), &e.slope(0), &e.slope(1), &e.slope(2), &e.gradient(), &e.hessian()}) {
            std::vector<bool> used(p->steps.size(), false);
            for (const std::uint32_t output : p->outputs) used.at(output) = true;
            for (std::size_t i = 0; i < p->steps.size(); ++i) {
                const Step& s = p->steps[i];
                if (s.op > Op::z) {
                    ASSERT_LT(s.a, i);
                    used[s.a] = true;
                }
                if (s.op >= Op::add) {
                    ASSERT_LT(s.b, i);
                    used[s.b] = true;
                }
                if (s.op == Op::power) {
                    ASSERT_TRUE(s.exponent < 0 || s.exponent > 2);
                }
                for (std::size_t k = 0; k < i; ++k)
                    ASSERT_FALSE(p->steps[k] == s) << f.text << " twice: " << i;
            }
            for (std::size_t i = 0; i < used.size(); ++i) ASSERT_TRUE(used[i]) << f.text << " step " << i;
        }
    }
}

TEST(Expression, SimplifiesToTheSameStep) {
    const struct {
        const char *text, *simpler;
    } table[] = {
        {"x+0", "x"},           {"0+x", "x"},           {"x-0", "x"},          {"0-x", "-x"},
        {"x*1", "x"},           {"x/1", "x"},           {"x/-1", "-x"},        {"0*x*y", "0"},
        {"0*sin(x)", "0"},      {"--x", "x"},           {"x-x", "0"},          {"sin(x)-sin(x)", "0"},
        {"x*x", "x^2"},         {"x*x*x", "x^3"},       {"x^2*x^3", "x^5"},    {"(x^2)^3", "x^6"},
        {"x^0", "1"},           {"x^1", "x"},           {"x^0.5", "sqrt(x)"},  {"x^-0.5", "1/sqrt(x)"},
        {"x^-1", "1/x"},        {"x/4", "0.25*x"},      {"x/-0.5", "-2*x"},    {"2*(3*x)", "6*x"},
        {"2*x*3", "6*x"},       {"3*x+2*x", "5*x"},     {"x+x", "2*x"},        {"3*x-2*x", "x"},
        {"3*x-3*x", "0"},       {"x+-y", "x-y"},        {"-x+y", "y-x"},       {"-x-y", "-(x+y)"},
        {"x--y", "x+y"},        {"y+x", "x+y"},         {"y*x", "x*y"},        {"-(x-y)", "y-x"},
        {"x+1+2", "x+3"},       {"1+x-3", "x-2"},       {"1-(x+1)", "-x"},     {"(-x)^2", "x^2"},
        {"(-x)^3", "-x^3"},     {"abs(x)^2", "x^2"},    {"abs(-x)", "abs(x)"}, {"abs(abs(x))", "abs(x)"},
        {"abs(x^2)", "x^2"},    {"cos(-x)", "cos(x)"},  {"sin(-x)", "-sin(x)"}, {"(-x)*(-y)", "x*y"},
        {"(-x)*y", "-(x*y)"},   {"(2*x)^2", "4*x^2"},   {"2*x*(3*y)", "6*(x*y)"}, {"2*x+2*y", "2*(x+y)"},
        {"y*x*x", "y*x^2"},     {"x*y*x*y", "(x^2)*(y^2)"}, {"x/-y", "-(x/y)"}, {"2*x/(2*y)", "x/y"},
        {"x+-2*y", "x-2*y"},    {"min(x,x)", "x"},      {"2+3*4-1", "13"},     {"sqrt(4)*x", "2*x"},
        {"x^2^0.5^0", "x^2"},   {"x-1", "x+-1"},        {"3*(0.1*x)", "3*(0.1*x)"},
    };
    for (const auto& row : table) {
        // max(f, f) is f, and for what is defined everywhere f − f is 0.
        const std::string both = fmt::format("max({},{})", row.text, row.simpler);
        const Program together = parsed(both).value();
        EXPECT_EQ(together.steps.size(), steps(row.simpler)) << both;
        EXPECT_NE(together.steps.back().op, Op::max) << both;
    }
}

TEST(Expression, RoundingKeepsInexactConstantsApart) {
    EXPECT_EQ(steps("3*(0.1*x)"), 5U);
    EXPECT_EQ(steps("x+0.1+0.2"), 5U);
    EXPECT_EQ(steps("x/3"), 3U);
    EXPECT_EQ(parsed("x/3").at({1, 0, 0}), 1.0 / 3);
    // A tiny factor stays where it is: x·x would overflow.
    EXPECT_DOUBLE_EQ(parsed("(1e-300*x)*x").at({1e160, 0, 0}), 1e20);
}

TEST(Expression, TheDomainStaysAsWritten) {
    const struct {
        const char* text;
        double x;  // where it is undefined
    } table[] = {
        {"x/x", 0},
        {"0*log(x)", -1},
        {"log(x)*0", -1},
        {"x^-1*x", 0},
        {"sqrt(x)^2", -1},
        {"log(x)-log(x)", -1},
        {"log(x)^0", -1},
        {"exp(log(x))", -1},
        {"0/x", 0},
        {"x^0.5*x^0.5", -1},
        {"x-x/x*x", 0},
        {"x^1.5", -1},
        {"2*log(x)-log(x)*2", -1},
        {"0*(1/x)", 0},
        {"x^2.5/x^2.5", -1},
        {"(x^0.5)^2", -1},
        {"x^-2*x^2", 0},
    };
    for (const auto& row : table) EXPECT_TRUE(std::isnan(parsed(row.text).at({row.x, 0, 0}))) << row.text;
    EXPECT_EQ(parsed("sqrt(x^2)").at({-3, 0, 0}), 3);
    EXPECT_EQ(parsed("x^1002/x^1001").at({-1, 0, 0}), -1);
}

TEST(Expression, DerivativesAtEdgesAreNumbers) {
    EXPECT_EQ(parsed("x^1.5").gradient_at({0, 0, 0}), Vec3(0));
    EXPECT_EQ(parsed("x^3+y^2").gradient_at({0, 0, 0}), Vec3(0));
    EXPECT_EQ(parsed("sqrt(x)*y").gradient_at({4, 1, 7}), Vec3(0.25, 2, 0));
    EXPECT_EQ(parsed("log(x)").gradient_at({-1, 0, 0}).y, 0);  // does not depend on it
    // At a kink the side of a >= 0, and of the first operand.
    EXPECT_EQ(parsed("abs(x)").gradient_at({0, 0, 0}), Vec3(1, 0, 0));
    EXPECT_EQ(parsed("min(x,y)").gradient_at({0, 0, 0}), Vec3(1, 0, 0));
    EXPECT_EQ(parsed("max(x,y)").gradient_at({0, 0, 0}), Vec3(1, 0, 0));
    EXPECT_EQ(parsed("max(x,y)").gradient_at({0, 1, 0}), Vec3(0, 1, 0));
}

TEST(Expression, DegreesAndKinks) {
    constexpr int kNone = -1;
    const struct {
        const char* text;
        int all, x, y, z;
        bool kinks;
    } table[] = {
        {kBarth, 6, 4, 4, 4, false},
        {"1", 0, 0, 0, 0, false},
        {"x*y*z", 3, 1, 1, 1, false},
        {"(x^2+y^2+z^2+1)^2-4*(x^2+y^2)", 4, 4, 4, 4, false},
        {"sin(x)*y^2+z", kNone, kNone, 2, 1, false},
        {"x^3/y", kNone, 3, kNone, 0, false},
        {"x/4+y/3", 1, 1, 1, 0, false},
        {"abs(x)+y^5", kNone, kNone, 5, 0, true},
        {"min(x,y)*z", kNone, kNone, kNone, 1, true},
        {"max(2,3)*x", 1, 1, 0, 0, false},
        {"abs(x)^2", 2, 2, 0, 0, false},
        {"x^1000", 1000, 1000, 0, 0, false},
        {"x^600*y^600", kNone, 600, 600, 0, false},
        {"x^1001", kNone, kNone, 0, 0, false},
        {"x^-2*y", kNone, kNone, 1, 0, false},
        {"sqrt(y)*x^2", kNone, 2, kNone, 0, false},
        {"(x^1000)^1000", kNone, kNone, 0, 0, false},
        {"x-x+y", 1, 0, 1, 0, false},
    };
    for (const auto& row : table) {
        const Expression e = parsed(row.text);
        EXPECT_EQ(e.degree().value_or(kNone), row.all) << row.text;
        EXPECT_EQ(e.degree_along(0).value_or(kNone), row.x) << row.text;
        EXPECT_EQ(e.degree_along(1).value_or(kNone), row.y) << row.text;
        EXPECT_EQ(e.degree_along(2).value_or(kNone), row.z) << row.text;
        EXPECT_EQ(e.has_kinks(), row.kinks) << row.text;
    }
}

TEST(Expression, OneHessianForAllThreads) {
    const Expression e = parsed(kBarth);
    const Expression copy = e;
    std::vector<const Program*> seen(8);
    std::vector<std::thread> threads;
    for (const Program*& program : seen)
        threads.emplace_back([&program, &e, &copy, even = threads.size() % 2 == 0] {
            program = &(even ? e : copy).hessian();
        });
    for (std::thread& t : threads) t.join();
    for (const Program* program : seen) EXPECT_EQ(program, &e.hessian());
    EXPECT_EQ(e.hessian().outputs.size(), 10U);
}

// Random formulas

/// A random tree as text, and what it means.
class RandomFormula {
public:
    explicit RandomFormula(unsigned seed) : random_(seed) {}

    struct Tree {
        std::string text;
        int rank;  // how tightly its outermost operator binds: 1 sum … 5 primary
        std::function<Number(const std::array<Number, 3>&)> meaning;
    };

    [[nodiscard]] Tree next(int depth) {
        using At = const std::array<Number, 3>&;
        const int kind = depth == 0 ? below(2) : 2 + below(9);
        if (kind == 0) {
            const auto axis = static_cast<std::size_t>(below(3));
            return {std::string(1, "xyz"[axis]), 5, [axis](At at) { return at[axis]; }};
        }
        if (kind == 1) {
            const char* numbers[] = {"0", "1", "2", ".5", "3", "0.1", "1e-1", "2.75", "4"};
            const char* number = numbers[below(9)];
            return {number, 5, [v = std::strtod(number, nullptr)](At) { return Number(v); }};
        }
        if (kind == 2) {
            const Tree a = next(depth - 1);
            return {"-" + wrapped(a, 3), 3, [a](At at) { return -a.meaning(at); }};
        }
        if (kind == 3) {
            const Tree a = next(depth - 1);
            const int n = below(9) - 4;
            return {fmt::format("{}^{}{}", wrapped(a, 5), blank(), n), 4,
                    [a, n](At at) { return power(a.meaning(at), n); }};
        }
        if (kind == 4) {
            using Unary = Number (*)(const Number&);
            const struct {
                const char* name;
                Unary of;
            } all[] = {{"sqrt", [](const Number& a) { return sqrt(a); }},
                       {"abs", [](const Number& a) { return abs(a); }},
                       {"exp", [](const Number& a) { return exp(a); }},
                       {"log", [](const Number& a) { return log(a); }},
                       {"sin", [](const Number& a) { return sin(a); }},
                       {"cos", [](const Number& a) { return cos(a); }},
                       {"tan", [](const Number& a) { return tan(a); }}};
            const auto& one = all[below(7)];
            const Tree a = next(depth - 1);
            return {fmt::format("{}{}({}{})", one.name, blank(), a.text, blank()), 5,
                    [a, of = one.of](At at) { return of(a.meaning(at)); }};
        }
        const Tree a = next(depth - 1);
        const Tree b = next(depth - 1);
        if (kind == 5) {
            const bool least = below(2) == 0;
            return {fmt::format("{}({},{}{})", least ? "min" : "max", a.text, blank(), b.text), 5,
                    [a, b, least](At at) {
                        return least ? min(a.meaning(at), b.meaning(at)) : max(a.meaning(at), b.meaning(at));
                    }};
        }
        const char op = "+-**/"[kind - 6];
        const int rank = op == '+' || op == '-' ? 1 : 2;
        // The right side of − and ÷ needs parentheses where it binds no tighter.
        return {fmt::format("{}{}{}{}{}", wrapped(a, rank), blank(), op, blank(), wrapped(b, rank + 1)), rank,
                [a, b, op](At at) {
                    const Number u = a.meaning(at);
                    const Number v = b.meaning(at);
                    return op == '+' ? u + v : op == '-' ? u - v : op == '*' ? u * v : u / v;
                }};
    }

private:
    [[nodiscard]] int below(int n) { return static_cast<int>(random_() % static_cast<unsigned>(n)); }
    [[nodiscard]] const char* blank() { return below(4) == 0 ? " " : ""; }
    [[nodiscard]] std::string wrapped(const Tree& t, int rank) {
        return t.rank < rank || below(8) == 0 ? "(" + t.text + ")" : t.text;
    }

    std::mt19937 random_;
};

TEST(Expression, RandomFormulasMeanWhatTheirTreesMean) {
    RandomFormula random(3);
    Points points(4);
    int compared = 0;
    int refused = 0;
    for (int i = 0; i < 6000; ++i) {
        const RandomFormula::Tree tree = random.next(1 + i % 5);
        std::optional<Expression> e;
        try {
            e.emplace(tree.text);
        } catch (const Error& error) {
            // Only a constant that is none.
            const auto [x, y, z] = variables(points.next(-2, 2));
            ASSERT_TRUE(tree.meaning({x, y, z}).bad) << tree.text << "\n" << error.what();
            ++refused;
            continue;
        }
        for (int k = 0; k < 4; ++k) {
            const auto at = points.next(-2, 2);
            const auto [x, y, z] = variables(at);
            const Number expected = tree.meaning({x, y, z});
            const Bounded own = bounded<InDouble>(e->gradient(), at);
            if (expected.bad || own.bad) continue;
            ++compared;
            const double by = 2 * static_cast<double>(expected.error()) + 1e-15;
            ASSERT_NEAR(own.value[0], static_cast<double>(expected.v), by + 2 * own.error[0]) << tree.text;
            // What constants lost before they were folded reaches slopes unseen by these bounds.
            if (expected.error() > 1e-13L * (1 + std::abs(expected.v))) continue;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const auto slope = static_cast<double>(expected.d[axis]);
                ASSERT_NEAR(own.value[1 + axis], slope,
                            1e-10 * (1 + std::abs(slope)) + 2 * own.error[1 + axis])
                    << tree.text << " along " << axis;
            }
        }
    }
    EXPECT_GT(compared, 5000);
    EXPECT_LT(refused, 2500);
}

TEST(Expression, RandomBytesAreReadOrRefused) {
    std::mt19937 random(5);
    const std::string pieces[] = {"x",    "y", "(",  ")", "+", "-",   "*",   "/",    "^",    ",",  "sin(",
                                  "min(", "1", ".5", "e", " ", "2e3", "log", "\xC3", "\x97", "pi", "\n"};
    int read = 0;
    for (int i = 0; i < 40000; ++i) {
        std::string text;
        for (std::size_t k = random() % 12; k-- > 0;)
            text += i % 3 == 0 ? std::string(1, static_cast<char>(random() % 256))
                               : pieces[random() % std::size(pieces)];
        const std::string message = message_of(text);
        if (message == "accepted") {
            ++read;
        } else {
            ASSERT_EQ(message.substr(0, 10), "expression") << message;
            ASSERT_EQ(
                std::count_if(message.begin(), message.end(), [](char ch) { return ch >= 0 && ch < ' '; }), 0)
                << message;
        }
    }
    EXPECT_GT(read, 100);
}

// GLSL

class ExpressionInGlsl : public testing::Test {
protected:
    void SetUp() override {
        if (std::system("glslc --version > /dev/null 2>&1") != 0) GTEST_SKIP() << "skipped: no glslc";
        stem_ = testing::TempDir() + fmt::format("pellucid_expression_{}", getpid());
    }
    void TearDown() override {
        std::filesystem::remove(stem_ + ".comp");
        std::filesystem::remove(stem_ + ".spv");
    }

    /// All formulas, asked by number: four numbers of the gradient's function and one of the value's.
    [[nodiscard]] static std::string shader() {
        std::string functions;
        std::string cases;
        for (std::size_t i = 0; i < formulas().size(); ++i) {
            functions += parsed(formulas()[i].text).glsl(fmt::format("f{}", i), true);
            cases += fmt::format("case {0}: value = f{0}(p); gradient = f{0}_gradient(p); break;\n", i);
        }
        return R"(#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
layout(local_size_x = 64) in;
layout(buffer_reference, scalar) buffer Points { vec3 at[]; };
layout(buffer_reference, scalar) buffer Results { float at[]; };
layout(push_constant, scalar) uniform Push { uint64_t points, results; uint formula, count; } push;
)" + functions + R"(
void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= push.count) return;
    vec3 p = Points(push.points).at[i];
    float value = 0.0;
    vec4 gradient = vec4(0.0);
    switch (push.formula) {
)" + cases + R"(
    }
    Results r = Results(push.results);
    r.at[5 * i] = gradient.w;
    r.at[5 * i + 1] = gradient.x;
    r.at[5 * i + 2] = gradient.y;
    r.at[5 * i + 3] = gradient.z;
    r.at[5 * i + 4] = value;
}
)";
    }

    [[nodiscard]] std::vector<std::uint32_t> compiled(const std::string& source) const {
        std::ofstream(stem_ + ".comp") << source;
        const std::string command =
            fmt::format("glslc --target-env=vulkan1.3 -O -Werror '{0}.comp' -o '{0}.spv'", stem_);
        EXPECT_EQ(std::system(command.c_str()), 0) << source;
        std::ifstream file(stem_ + ".spv", std::ios::binary);
        const std::string bytes(std::istreambuf_iterator<char>(file), {});
        std::vector<std::uint32_t> words(bytes.size() / 4);
        std::memcpy(words.data(), bytes.data(), words.size() * 4);
        return words;
    }

    std::string stem_;
};

TEST_F(ExpressionInGlsl, CompilesAndNeedsNothingElse) {
    for (const char* constant : {"1e300", "-1e300", "1e-300", "-7", "1e10", "0.1", "123456789"}) {
        const std::string source = parsed(constant).glsl("f", true);
        EXPECT_EQ(source.find("inf"), std::string::npos) << source;
        EXPECT_FALSE(compiled("#version 460\n" + source + "void main() {}\n").empty()) << constant;
    }
    EXPECT_EQ(parsed("x^2-0.5").glsl("f", false),
              "float f(vec3 p) {\n    float t1 = p.x * p.x;\n    float t3 = t1 - 0.5;\n    return t3;\n}\n");
    EXPECT_FALSE(compiled(shader()).empty());
}

TEST_F(ExpressionInGlsl, DeviceAgreesWithinWhatVulkanPromises) {
    if (!Backend::has_vulkan()) GTEST_SKIP() << "skipped: no Vulkan device";
    using namespace vulkan;
    const Device device(DeviceOptions{.validate = true});
    struct Push {
        std::uint64_t points, results;
        std::uint32_t formula, count;
    };
    constexpr std::uint32_t kCount = 4096;
    const Kernel kernel(device, compiled(shader()), {.push_bytes = sizeof(Push)});
    const Buffer points_buffer(device, kCount * 3 * sizeof(float));
    const Buffer results_buffer(device, kCount * 5 * sizeof(float));
    Points points(6);
    for (std::uint32_t f = 0; f < formulas().size(); ++f) {
        const Formula& formula = formulas()[f];
        if (formula.hi < 1.1) continue;  // x^1001 keeps no digit of a float
        std::vector<float> at;
        for (std::uint32_t i = 0; i < kCount; ++i)
            for (const double v : points.next(formula.lo, formula.hi)) at.push_back(static_cast<float>(v));
        upload(device, points_buffer, std::as_bytes(std::span(at)));
        Commands commands(device);
        commands.dispatch(kernel, Push{points_buffer.address(), results_buffer.address(), f, kCount},
                          {kCount / 64, 1, 1});
        commands.submit_and_wait();
        std::vector<float> results(kCount * 5);
        download(device, results_buffer, std::as_writable_bytes(std::span(results)));

        const Expression e = parsed(formula.text);
        int compared = 0;
        for (std::size_t i = 0; i < kCount; ++i) {
            const Bounded own = bounded<OnDevice>(e.gradient(), {at[3 * i], at[3 * i + 1], at[3 * i + 2]});
            if (own.bad) continue;
            ++compared;
            for (std::size_t k = 0; k < 5; ++k) {
                const std::size_t output = k == 4 ? 0 : k;
                ASSERT_NEAR(results[5 * i + k], own.value[output], own.error[output] + 1e-37)
                    << formula.text << " output " << k;
            }
        }
        EXPECT_GT(compared, 3000) << formula.text;
    }
    EXPECT_EQ(device.validation_messages(), std::vector<std::string>{});
}

}  // namespace
}  // namespace pellucid
