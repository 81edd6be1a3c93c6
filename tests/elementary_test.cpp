// Real: functions of formulas that are the same on every machine, and their SIMD form.
#include <cmath>
#include <limits>
#include <random>

#include <boost/multiprecision/cpp_bin_float.hpp>
#include <gtest/gtest.h>

#include "core/real.hpp"
#include "field/point_evaluator.hpp"
#include "simd_targets.hpp"

namespace pellucid {
namespace {

using Exact = boost::multiprecision::cpp_bin_float_50;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

struct Function {
    const char* name;
    Op op;
    Real (*real)(Real);
    Exact (*exact)(const Exact&);
    double lo, hi;
};

const Function kFunctions[] = {
    {"exp", Op::exp, exp, [](const Exact& x) -> Exact { return boost::multiprecision::exp(x); }, -745, 709.7},
    {"exp near 0", Op::exp, exp, [](const Exact& x) -> Exact { return boost::multiprecision::exp(x); }, -1, 1},
    {"log", Op::log, log, [](const Exact& x) -> Exact { return boost::multiprecision::log(x); }, 1e-3, 4},
    {"log far", Op::log, log, [](const Exact& x) -> Exact { return boost::multiprecision::log(x); }, 4, 1e300},
    {"sin", Op::sin, sin, [](const Exact& x) -> Exact { return boost::multiprecision::sin(x); }, -20, 20},
    {"sin far", Op::sin, sin, [](const Exact& x) -> Exact { return boost::multiprecision::sin(x); }, -1.6e6, 1.6e6},
    {"cos", Op::cos, cos, [](const Exact& x) -> Exact { return boost::multiprecision::cos(x); }, -20, 20},
    {"cos far", Op::cos, cos, [](const Exact& x) -> Exact { return boost::multiprecision::cos(x); }, -2e7, 2e7},
    {"tan", Op::tan, tan, [](const Exact& x) -> Exact { return boost::multiprecision::tan(x); }, -20, 20},
};

TEST(Elementary, WithinStatedUnitsOfTheExactValue) {
    std::mt19937_64 generator(1);
    for (const Function& f : kFunctions) {
        std::uniform_real_distribution<double> uniform(f.lo, f.hi);
        double worst = 0;
        for (int i = 0; i < 20000; ++i) {
            const double x = uniform(generator);
            const Exact right = f.exact(Exact(x));
            const double unit = std::ldexp(1.0, std::max(-1074, std::ilogb(static_cast<double>(right)) - 52));
            const Exact off = boost::multiprecision::abs(Exact(f.real(Real(x)).value) - right) / unit;
            worst = std::max(worst, static_cast<double>(off));
        }
        EXPECT_LE(worst, kElementaryUlp) << f.name;
        EXPECT_GT(worst, 0.1) << f.name;
    }
}

TEST(Elementary, KeepsDigitsBesideMultiplesOfARightAngle) {
    for (int k = 1; k < 1000000; k += 37) {
        const double x = k * 1.5707963267948966;
        const double right = k % 2 == 0 ? std::sin(x) : std::cos(x);
        const double mine = k % 2 == 0 ? sin(Real(x)).value : cos(Real(x)).value;
        ASSERT_LE(std::abs(mine - right), 3e-16 * std::abs(right)) << k;
    }
}

TEST(Elementary, KnowsTheEndsOfItsDomain) {
    EXPECT_EQ(exp(Real(-kInfinity)).value, 0);
    EXPECT_EQ(exp(Real(kInfinity)).value, kInfinity);
    EXPECT_EQ(exp(Real(710)).value, kInfinity);
    EXPECT_EQ(exp(Real(-746)).value, 0);
    EXPECT_EQ(exp(Real(0)).value, 1);
    EXPECT_EQ(log(Real(0)).value, -kInfinity);
    EXPECT_EQ(log(Real(1)).value, 0);
    EXPECT_EQ(log(Real(kInfinity)).value, kInfinity);
    EXPECT_NEAR(log(Real(5e-324)).value, std::log(5e-324), 1e-12);
    EXPECT_TRUE(std::isnan(log(Real(-1)).value));
    for (Real (*const f)(Real) : {exp, log, sin, cos, tan}) EXPECT_TRUE(std::isnan(f(Real(kNaN)).value));
    for (Real (*const f)(Real) : {sin, cos, tan}) EXPECT_TRUE(std::isnan(f(Real(kInfinity)).value));
    EXPECT_TRUE(std::signbit(sin(Real(-0.0)).value));
    EXPECT_EQ(power(Real(-2), 3).value, -8);
    EXPECT_EQ(power(Real(2), -2).value, 0.25);
}

/// f = op(x) and a few steps that read registers again after others have been handed out.
Program all_operations() {
    Program p;
    const auto add = [&](Step s) {
        p.steps.push_back(s);
        return static_cast<std::uint32_t>(p.steps.size() - 1);
    };
    const auto x = add({.op = Op::x});
    const auto y = add({.op = Op::y});
    const auto z = add({.op = Op::z});
    const auto c = add({.op = Op::constant, .value = 1.25});
    std::vector<std::uint32_t> made{x, y, z};
    for (const Op op : {Op::negate, Op::square, Op::abs, Op::sqrt, Op::exp, Op::log, Op::sin, Op::cos, Op::tan, Op::step})
        for (const std::uint32_t a : {x, y, c}) made.push_back(add({.op = op, .a = a}));
    for (const int n : {3, 7, -1, -4}) made.push_back(add({.op = Op::power, .a = x, .exponent = n}));
    for (const Op op : {Op::add, Op::subtract, Op::multiply, Op::divide, Op::min, Op::max})
        for (const auto& [a, b] : std::initializer_list<std::pair<std::uint32_t, std::uint32_t>>{
                 {x, y}, {x, c}, {c, x}, {z, z}, {c, c}, {made[7], made[20]}})
            made.push_back(add({.op = op, .a = a, .b = b}));
    // A chain that frees registers, and outputs that are an input, a constant and one result twice.
    std::uint32_t sum = made[0];
    for (std::size_t i = 1; i < made.size(); i += 2) sum = add({.op = Op::add, .a = sum, .b = made[i]});
    p.outputs = made;
    p.outputs.insert(p.outputs.end(), {sum, sum, c, y});
    return p;
}

TEST(PointEvaluator, EqualsOnePointAtATimeOnEveryInstructionSet) {
    const Program p = all_operations();
    const PointEvaluator evaluator(p);
    std::mt19937_64 generator(2);
    std::uniform_real_distribution<double> uniform(-3, 3);
    for (const std::int64_t target : simd_targets()) {
        const ChosenTarget chosen(target);
        for (const std::size_t count : {1U, 7U, 8U, 127U, 128U, 129U, 1000U}) {
            std::array<std::vector<double>, 3> at;
            for (auto& axis : at) {
                axis.resize(count + PointEvaluator::kRoom);
                for (double& v : axis) v = uniform(generator);
            }
            at[0][0] = 3e7;  // beyond the reduction of its own
            at[1][count / 2] = kNaN;
            std::vector<std::vector<double>> out(p.outputs.size(),
                                                 std::vector<double>(count + PointEvaluator::kRoom));
            std::vector<double*> to;
            for (auto& each : out) to.push_back(each.data());
            evaluator(count, at[0].data(), at[1].data(), at[2].data(), to.data());
            std::vector<Real> values;
            std::vector<Real> right(p.outputs.size());
            for (std::size_t i = 0; i < count; ++i) {
                run_program<Real>(p, {Real(at[0][i]), Real(at[1][i]), Real(at[2][i])}, values, right);
                for (std::size_t k = 0; k < right.size(); ++k) {
                    if (std::isnan(right[k].value))
                        ASSERT_TRUE(std::isnan(out[k][i])) << k;
                    else
                        ASSERT_EQ(std::bit_cast<std::uint64_t>(right[k].value), std::bit_cast<std::uint64_t>(out[k][i]))
                            << "output " << k << " of point " << i;
                }
            }
        }
    }
}

}  // namespace
}  // namespace pellucid
