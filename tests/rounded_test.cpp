// What `run_program<Real>` gives against a hundred digits: never farther from them than Rounded says.
#include "field/rounded.hpp"

#include <cmath>
#include <random>

#include <boost/multiprecision/cpp_bin_float.hpp>
#include <gtest/gtest.h>

#include "core/real.hpp"
#include "field/expression.hpp"

namespace pellucid {
namespace {

using Digits = boost::multiprecision::number<boost::multiprecision::cpp_bin_float<100>,
                                             boost::multiprecision::et_off>;

struct Exact {
    Digits v;

    Exact() = default;
    explicit Exact(double value) : v(value) {}
    explicit Exact(const Digits& value) : v(value) {}
};
Exact operator-(const Exact& a) { return Exact(Digits(-a.v)); }
Exact operator+(const Exact& a, const Exact& b) { return Exact(Digits(a.v + b.v)); }
Exact operator-(const Exact& a, const Exact& b) { return Exact(Digits(a.v - b.v)); }
Exact operator*(const Exact& a, const Exact& b) { return Exact(Digits(a.v * b.v)); }
Exact operator/(const Exact& a, const Exact& b) { return Exact(Digits(a.v / b.v)); }
Exact square(const Exact& a) { return a * a; }
Exact abs(const Exact& a) { return Exact(Digits(boost::multiprecision::abs(a.v))); }
Exact sqrt(const Exact& a) { return Exact(a.v < 0 ? Digits(NAN) : Digits(boost::multiprecision::sqrt(a.v))); }
Exact exp(const Exact& a) { return Exact(Digits(boost::multiprecision::exp(a.v))); }
Exact log(const Exact& a) { return Exact(a.v > 0 ? Digits(boost::multiprecision::log(a.v)) : Digits(NAN)); }
Exact sin(const Exact& a) { return Exact(Digits(boost::multiprecision::sin(a.v))); }
Exact cos(const Exact& a) { return Exact(Digits(boost::multiprecision::cos(a.v))); }
Exact tan(const Exact& a) { return Exact(Digits(boost::multiprecision::tan(a.v))); }
Exact min(const Exact& a, const Exact& b) { return a.v > b.v ? b : a; }
Exact max(const Exact& a, const Exact& b) { return a.v < b.v ? b : a; }
Exact step(const Exact& a) { return Exact(a.v >= 0 ? 1.0 : 0.0); }
Exact power(const Exact& a, int exponent) { return Exact(Digits(boost::multiprecision::pow(a.v, exponent))); }

template <class T>
T value_at(const Expression& f, const std::array<T, 3>& at) {
    std::vector<T> values;
    std::array<T, 1> out;
    run_program<T>(f.value(), at, values, out);
    return out[0];
}

const char* const kFormulas[] = {
    "x + y + z",
    "x*y - z^2",
    "(x - y)^2 - (x^2 - 2*x*y + y^2) + z",
    "x^2 + y^2 + z^2 - 1",
    "x^7*y^5 - 3*z^3 + 0.1",
    "x^-3 + y^-2*z",
    "x/y - z/(x^2 + 0.01)",
    "1/(x + y + z)",
    "sqrt(x^2 + y^2) - z",
    "sqrt(x^2 + y^2 + z^2) - sqrt(abs(x*y))",
    "sqrt(x) - y*z",
    "exp(x*y) - exp(z)",
    "exp(-20*x^2) + exp(3*y) - 2*z",
    "log(x^2 + y^2 + 1e-3) - z",
    "log(x) + log(1 + y*z)",
    "sin(x)*cos(y) + sin(y)*cos(z) + sin(z)*cos(x)",
    "sin(40*x*y) - cos(300*z)",
    "tan(x) - y + tan(y*z)",
    "min(x, y, z) - max(x*y, 0.3)",
    "abs(x) + abs(y - z) - max(x^3, -y)",
    "2^x - 3^-y + x^0.5*z",
    "max(sqrt(x^2 + y^2 + z^2) - 1, -(x*y + z))/(1 + exp(x - y))",
};

struct Place {
    std::array<double, 3> lo, hi;
};

Place random_box(std::mt19937_64& random, bool far) {
    std::uniform_real_distribution<double> unit(0, 1);
    Place box;
    const double size = std::pow(10.0, -6 * unit(random));
    for (std::size_t k = 0; k < 3; ++k) {
        const double at = (far ? 1e4 : 2) * (2 * unit(random) - 1);
        box.lo[k] = at;
        box.hi[k] = at + size;
    }
    return box;
}

std::array<double, 3> random_point(std::mt19937_64& random, const Place& box) {
    std::uniform_real_distribution<double> unit(0, 1);
    std::array<double, 3> x;
    for (std::size_t k = 0; k < 3; ++k) {
        // Corners, too: there bounds are tight.
        const double u = std::clamp(1.4 * unit(random) - 0.2, 0.0, 1.0);
        x[k] = std::min(box.hi[k], box.lo[k] + u * (box.hi[k] - box.lo[k]));
    }
    return x;
}

Rounded over(const Expression& f, const Place& box) {
    return value_at<Rounded>(f, {Rounded({box.lo[0], box.hi[0]}, 0), Rounded({box.lo[1], box.hi[1]}, 0),
                                 Rounded({box.lo[2], box.hi[2]}, 0)});
}

TEST(Rounded, ErrorAndRangeHoldEverywhere) {
    std::mt19937_64 random(1);
    for (const char* text : kFormulas) {
        const Expression f(text);
        int bounded = 0;
        for (int i = 0; i < 240; ++i) {
            const Place box = random_box(random, i % 6 == 5);
            const Rounded r = over(f, box);
            bounded += r.error < 1 ? 1 : 0;
            for (int k = 0; k < 6; ++k) {
                const auto x = random_point(random, box);
                const Digits exact = value_at<Exact>(f, {Exact(x[0]), Exact(x[1]), Exact(x[2])}).v;
                if (!boost::multiprecision::isfinite(exact)) {
                    ASSERT_FALSE(r.range.continuous && r.range.reach() < INFINITY) << text;
                    continue;
                }
                ASSERT_LE(Digits(r.range.lo), exact) << text;
                ASSERT_GE(Digits(r.range.hi), exact) << text;
                if (std::isinf(r.error)) continue;
                const double drawn = value_at<Real>(f, {Real(x[0]), Real(x[1]), Real(x[2])}).value;
                ASSERT_TRUE(std::isfinite(drawn)) << text << " at " << x[0] << ' ' << x[1] << ' ' << x[2];
                const Digits off = boost::multiprecision::abs(Digits(drawn) - exact);
                ASSERT_LE(off, Digits(r.error)) << text << " at " << x[0] << ' ' << x[1] << ' ' << x[2];
            }
        }
        EXPECT_GT(bounded, 60) << text;
    }
}

TEST(Rounded, SaysLittleWhereLittleIsLost) {
    // Sums and products of positive numbers in small boxes: a few units each.
    std::mt19937_64 random(2);
    for (const char* text : {"x + y*z + 1", "(x + 1)^9*y", "sqrt(x + y) + exp(z)", "x/(y + z) + 1/x", "log(x + 2) + 1",
                             "x^2 + y^2 + z^2 + 3*x*y", "max(x, y) + min(y, z)*abs(x)"}) {
        const Expression f(text);
        for (int i = 0; i < 200; ++i) {
            Place box = random_box(random, false);
            for (std::size_t k = 0; k < 3; ++k) {
                box.lo[k] = 1 + std::abs(box.lo[k]);
                box.hi[k] = box.lo[k] + 1e-3;
            }
            const Rounded r = over(f, box);
            EXPECT_LE(r.error, 1000 * 0x1p-53 * r.range.reach()) << text;
        }
    }
}

TEST(Rounded, HalfOfItIsTooLittleForAProduct) {
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> unit(1, 1.001);
    const Expression f("x*y");
    double worst = 0;
    for (int i = 0; i < 20000; ++i) {
        const double x = unit(random);
        const double y = unit(random);
        const Rounded r = over(f, {{x, y, 0}, {x, y, 0}});
        const Digits off = boost::multiprecision::abs(Digits(x) * Digits(y) - Digits(x * y));
        worst = std::max(worst, static_cast<double>(off) / r.error);
    }
    EXPECT_GT(worst, 0.9);
    EXPECT_LE(worst, 1);
}

TEST(Rounded, NothingIsSaidWhereADivisorReachesZeroOrARootLeavesItsDomain) {
    const Place across{{-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5}};
    for (const char* text : {"1/x", "y/(x - z)", "x^-2", "log(x)", "sqrt(x)", "log(x^2)", "tan(4*x)", "exp(1/y)", "min(1/x, y)"})
        EXPECT_EQ(over(Expression(text), across).error, INFINITY) << text;
    // A divisor that is 0 within its error alone.
    EXPECT_EQ(over(Expression("1/(x + y - z)"), {{0.1, 1e16, 1e16}, {0.4, 1e16, 1e16}}).error, INFINITY);
}

TEST(Rounded, OverflowAndUnderflowAreErrorsLikeAnyOther) {
    for (const char* text : {"x^400", "x^-400", "exp(900*x) - exp(900*y)", "exp(-740*x)", "exp(-700*x)*exp(-700*y)", "x*1e-320*y",
                             "(x*1e-160)^2/1e-320"}) {
        const Expression f(text);
        std::mt19937_64 random(4);
        for (int i = 0; i < 50; ++i) {
            Place box = random_box(random, false);
            const Rounded r = over(f, box);
            if (std::isinf(r.error)) continue;
            const auto x = random_point(random, box);
            const Digits exact = value_at<Exact>(f, {Exact(x[0]), Exact(x[1]), Exact(x[2])}).v;
            const double drawn = value_at<Real>(f, {Real(x[0]), Real(x[1]), Real(x[2])}).value;
            ASSERT_LE(boost::multiprecision::abs(Digits(drawn) - exact), Digits(r.error)) << text;
        }
    }
}

}  // namespace
}  // namespace pellucid
