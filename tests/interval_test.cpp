#include "core/interval.hpp"
#include "core/real.hpp"

#include <array>
#include <cmath>
#include <functional>
#include <random>
#include <vector>

#include <boost/multiprecision/cpp_bin_float.hpp>
#include <boost/multiprecision/cpp_int.hpp>
#include <gtest/gtest.h>

namespace pellucid {
namespace {

/// A function's value may be kElementaryUlp off on either side, and its units half as large below a power of two.
constexpr double kFunctionUnits = 4 * (kElementaryUlp + 1) + 2;

using Precise = boost::multiprecision::cpp_bin_float_50;
using Exact = boost::multiprecision::cpp_rational;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kTiniest = std::numeric_limits<double>::denorm_min();
constexpr double kLargest = std::numeric_limits<double>::max();

/// Bounds for a number of any exact type: that of a double is itself.
template <class Number>
[[nodiscard]] bool contains(const Interval& interval, const Number& value) {
    return (interval.lo == -kInfinity || Number(interval.lo) <= value) &&
           (interval.hi == kInfinity || value <= Number(interval.hi));
}

/// Doubles of every magnitude and sign, with the special ones among them.
class Doubles {
public:
    explicit Doubles(unsigned seed) : engine_(seed) {}
    [[nodiscard]] double any() {
        static constexpr std::array kSpecial{0.0,      1.0,       -1.0,   kTiniest,      -kTiniest, 0x1p-1022,
                                             kLargest, -kLargest, 0.5,    1 + 0x1p-52,   3.0,       -0x1p-1022};
        if (pick(8) == 0) return kSpecial[pick(kSpecial.size())];
        return std::ldexp(mantissa(), static_cast<int>(pick(2098)) - 1074);
    }
    /// Of ordinary size.
    [[nodiscard]] double usual() { return std::ldexp(mantissa(), static_cast<int>(pick(12)) - 6); }
    [[nodiscard]] double between(double lo, double hi) {
        const double t = lo + (hi - lo) * std::uniform_real_distribution<double>(0, 1)(engine_);
        return std::min(hi, std::max(lo, std::isfinite(t) ? t : 0.5 * lo + 0.5 * hi));
    }
    [[nodiscard]] std::size_t pick(std::size_t count) {
        return std::uniform_int_distribution<std::size_t>(0, count - 1)(engine_);
    }

private:
    [[nodiscard]] double mantissa() { return std::uniform_real_distribution<double>(-1, 1)(engine_); }
    std::mt19937_64 engine_;
};

[[nodiscard]] Interval interval_of(double a, double b) { return {std::min(a, b), std::max(a, b)}; }

TEST(Interval, SumsDifferencesProductsAndQuotientsContainTheExactOnes) {
    Doubles draw(1);
    for (int trial = 0; trial < 20000; ++trial) {
        const bool wild = trial % 2 == 0;
        const auto number = [&] { return wild ? draw.any() : draw.usual(); };
        const Interval a = interval_of(number(), number());
        const Interval b = trial % 5 == 0 ? Interval(number()) : interval_of(number(), number());
        const double p = draw.between(a.lo, a.hi);
        const double q = draw.between(b.lo, b.hi);
        const Exact x(p), y(q);
        ASSERT_TRUE(contains(a + b, Exact(x + y))) << p << " + " << q;
        ASSERT_TRUE(contains(a - b, Exact(x - y))) << p << " - " << q;
        ASSERT_TRUE(contains(a * b, Exact(x * y))) << p << " * " << q;
        ASSERT_TRUE(contains(square(a), Exact(x * x))) << p;
        if (q != 0) {
            ASSERT_TRUE(contains(a / b, Exact(x / y))) << p << " / " << q;
        }
        ASSERT_TRUE(contains(abs(a), Exact(boost::multiprecision::abs(x))));
        ASSERT_TRUE(contains(min(a, b), Exact(std::min(x, y))));
        ASSERT_TRUE(contains(max(a, b), Exact(std::max(x, y))));
        ASSERT_TRUE(contains(hull(a, b), x) && contains(hull(a, b), y));
    }
}

TEST(Interval, PowersContainTheExactOnes) {
    Doubles draw(2);
    for (int trial = 0; trial < 4000; ++trial) {
        const Interval a = interval_of(draw.usual(), draw.usual());
        const double p = draw.between(a.lo, a.hi);
        for (const int n : {-7, -4, -3, -2, -1, 0, 1, 2, 3, 4, 5, 11, 12}) {
            if (p == 0 && n < 0) continue;
            Exact exact = 1;
            for (int i = 0; i < std::abs(n); ++i) exact *= Exact(p);
            if (n < 0) exact = 1 / exact;
            ASSERT_TRUE(contains(power(a, n), exact)) << p << " ^ " << n;
        }
    }
}

struct Function {
    const char* name;
    std::function<Interval(const Interval&)> interval;
    std::function<Precise(const Precise&)> precise;
    double least, most;  // arguments
};

[[nodiscard]] std::vector<Function> functions() {
    namespace mp = boost::multiprecision;
    return {{"sqrt", [](const Interval& a) { return sqrt(a); }, [](const Precise& x) { return Precise(mp::sqrt(x)); },
             0, kLargest},
            {"exp", [](const Interval& a) { return exp(a); }, [](const Precise& x) { return Precise(mp::exp(x)); },
             -740, 709},
            {"log", [](const Interval& a) { return log(a); }, [](const Precise& x) { return Precise(mp::log(x)); },
             kTiniest, kLargest},
            {"sin", [](const Interval& a) { return sin(a); }, [](const Precise& x) { return Precise(mp::sin(x)); },
             -1e9, 1e9},
            {"cos", [](const Interval& a) { return cos(a); }, [](const Precise& x) { return Precise(mp::cos(x)); },
             -1e9, 1e9},
            {"tan", [](const Interval& a) { return tan(a); }, [](const Precise& x) { return Precise(mp::tan(x)); },
             -1e9, 1e9}};
}

TEST(Interval, FunctionsContainTheTruthAtEveryMagnitude) {
    Doubles draw(3);
    for (const Function& f : functions()) {
        for (int trial = 0; trial < 3000; ++trial) {
            const auto argument = [&] {
                for (;;) {
                    const double x = trial % 2 == 0 ? draw.any() : draw.usual();
                    if (x >= f.least && x <= f.most) return x;
                }
            };
            const double first = argument();
            const Interval a = trial % 3 == 0 ? Interval(first)
                               : trial % 3 == 1 ? interval_of(first, argument())
                                                : interval_of(first, std::min(f.most, first + std::abs(draw.usual())));
            const double p = draw.between(a.lo, a.hi);
            if (!(p >= f.least)) continue;
            ASSERT_TRUE(contains(f.interval(a), f.precise(Precise(p))))
                << f.name << "(" << p << ") in [" << a.lo << ", " << a.hi << "]";
        }
    }
}

TEST(Interval, WavesReachTheirExtremaAndOnlyThere) {
    const double pi = std::acos(-1.0);
    for (int k = -6; k <= 6; ++k) {
        const double top = (2 * k + 0.5) * pi;
        const double bottom = (2 * k - 0.5) * pi;
        EXPECT_EQ(sin(Interval(top - 0.1, top + 0.1)).hi, 1);
        EXPECT_GT(sin(Interval(top - 0.1, top + 0.1)).lo, 0.99);
        EXPECT_EQ(sin(Interval(bottom - 0.1, bottom + 0.1)).lo, -1);
        EXPECT_LT(sin(Interval(top + 0.1, top + 0.2)).hi, 0.996);
        EXPECT_EQ(cos(Interval(2 * k * pi - 0.1, 2 * k * pi + 0.1)).hi, 1);
        EXPECT_EQ(cos(Interval((2 * k + 1) * pi - 0.1, (2 * k + 1) * pi + 0.1)).lo, -1);
        EXPECT_GT(cos(Interval(2 * k * pi - 0.1, 2 * k * pi + 0.1)).lo, 0.99);
    }
    EXPECT_EQ(sin(Interval(0, 7)).lo, -1);
    EXPECT_EQ(sin(Interval(0, 7)).hi, 1);
    EXPECT_EQ(sin(Interval(1e16)).lo, -1);
    EXPECT_EQ(cos(Interval(-kInfinity, kInfinity)).hi, 1);
    EXPECT_TRUE(sin(Interval(-kInfinity, 3)).continuous);
}

/// Units in the last place between the bounds.
[[nodiscard]] int units_wide(const Interval& a) {
    int units = 0;
    for (double x = a.lo; x < a.hi && units < 100; x = std::nextafter(x, kInfinity)) ++units;
    return units;
}

TEST(Interval, SinglePointsStayFewUnitsWide) {
    Doubles draw(4);
    for (int trial = 0; trial < 5000; ++trial) {
        const double p = draw.usual();
        const double q = trial % 2 == 0 ? draw.any() : draw.usual();
        const double small = std::ldexp(q, -600);
        if (p == 0 || q == 0) continue;
        for (const double y : {q, small}) {
            EXPECT_LE(units_wide(Interval(p) + Interval(y)), 4) << p << " " << y;
            EXPECT_LE(units_wide(Interval(p) - Interval(y)), 4);
            EXPECT_LE(units_wide(Interval(p) * Interval(y)), 4);
            EXPECT_LE(units_wide(Interval(p) / Interval(y)), 4);
        }
        EXPECT_LE(units_wide(square(Interval(q))), 4);
        EXPECT_LE(units_wide(sqrt(Interval(std::abs(q)))), 4);
        EXPECT_LE(units_wide(log(Interval(std::abs(q)))), kFunctionUnits);
        for (const auto& wave : {exp(Interval(p)), sin(Interval(p)), cos(Interval(p)), tan(Interval(p))})
            EXPECT_LE(units_wide(wave), kFunctionUnits) << p;
    }
}

TEST(Interval, ZeroStaysExact) {
    const Interval zero(0.0), one(1.0), x(0.3, 0.7);
    for (const Interval& a : {zero + zero, one - one, square(zero), sqrt(zero), power(zero, 3), abs(zero)}) {
        EXPECT_EQ(a.lo, 0);
        EXPECT_EQ(a.hi, 0);
    }
    EXPECT_EQ((x * Interval(0, 1)).lo, 0);
    EXPECT_EQ((x * Interval(-1, 0)).hi, 0);
    EXPECT_EQ((Interval(0, 1) / x).lo, 0);
    EXPECT_EQ(square(Interval(-1, 2)).lo, 0);
    EXPECT_EQ(power(Interval(-1, 2), 4).lo, 0);
    EXPECT_GE((Interval(kTiniest) * Interval(kTiniest)).lo, 0);
    EXPECT_GT((Interval(kTiniest) * Interval(kTiniest)).hi, 0);
    EXPECT_EQ(exp(Interval(-kInfinity, 0)).lo, 0);
}

TEST(Interval, OverflowAndInfinityNeverGiveNaN) {
    const std::vector<Interval> all{Interval(0.0),
                                    Interval(-kInfinity, kInfinity),
                                    Interval(0, kInfinity),
                                    Interval(-kInfinity, 0),
                                    Interval(-kInfinity, -1),
                                    Interval(1, kInfinity),
                                    Interval(-kLargest, kLargest),
                                    Interval(kLargest),
                                    Interval(-kLargest),
                                    Interval(kLargest, kInfinity),
                                    Interval(kTiniest),
                                    Interval(-kTiniest, kTiniest),
                                    Interval(-1, 2),
                                    Interval::nothing(),
                                    Interval(2, 1)};
    const auto sound = [](const Interval& a) { return !std::isnan(a.lo) && !std::isnan(a.hi); };
    for (const Interval& a : all) {
        for (const Interval& b : all) {
            for (const Interval& c : {a + b, a - b, a * b, a / b, min(a, b), max(a, b), intersect(a, b), hull(a, b)})
                EXPECT_TRUE(sound(c)) << a.lo << " " << a.hi << " with " << b.lo << " " << b.hi;
            if (!a.empty() && !b.empty()) continue;
            for (const Interval& c : {a + b, a - b, a * b, a / b, min(a, b), max(a, b), intersect(a, b)})
                EXPECT_TRUE(c.empty());
        }
        for (const Interval& c : {-a, square(a), abs(a), sqrt(a), exp(a), log(a), sin(a), cos(a), tan(a), step(a),
                                  power(a, 3), power(a, 4), power(a, -1), power(a, -2), power(a, -5)}) {
            EXPECT_TRUE(sound(c)) << a.lo << " " << a.hi;
            EXPECT_TRUE(c.empty() || !a.empty());
        }
    }
    const Interval big = Interval(kLargest) + Interval(kLargest);
    EXPECT_EQ(big.lo, kLargest);
    EXPECT_EQ(big.hi, kInfinity);
    EXPECT_EQ(exp(Interval(1000)).hi, kInfinity);
    EXPECT_LE(exp(Interval(1000)).lo, kLargest);
    EXPECT_EQ((Interval(0.0) * Interval(-kInfinity, kInfinity)).continuous, true);
}

TEST(Interval, DivisionByAnIntervalWithZeroIsNotContinuous) {
    const Interval inside = Interval(1, 2) / Interval(-1, 3);
    EXPECT_EQ(inside.lo, -kInfinity);
    EXPECT_EQ(inside.hi, kInfinity);
    EXPECT_FALSE(inside.continuous);

    const Interval right = Interval(1, 2) / Interval(0, 4);
    EXPECT_LE(right.lo, 0.25);
    EXPECT_GT(right.lo, 0.2499);
    EXPECT_EQ(right.hi, kInfinity);
    EXPECT_FALSE(right.continuous);
    EXPECT_EQ((Interval(1, 2) / Interval(-4, 0)).lo, -kInfinity);
    EXPECT_GE((Interval(1, 2) / Interval(-4, 0)).hi, -0.25);
    EXPECT_LT((Interval(1, 2) / Interval(-4, 0)).hi, -0.2499);
    EXPECT_EQ((Interval(-2, -1) / Interval(0, 4)).lo, -kInfinity);
    EXPECT_GT((Interval(-2, -1) / Interval(-4, 0)).lo, 0.2499);

    EXPECT_TRUE((Interval(1, 2) / Interval(0.0)).empty());
    EXPECT_FALSE((Interval(1, 2) / Interval(0.0)).continuous);
    EXPECT_TRUE((Interval(1, 2) / Interval(1, 3)).continuous);
    EXPECT_FALSE(power(Interval(-1, 1), -1).continuous);
    EXPECT_GE(power(Interval(-1, 1), -2).lo, 0);
    EXPECT_LE(power(Interval(-2, 0), -3).hi, -0.1249);
}

TEST(Interval, DomainsAreClippedAndTold) {
    EXPECT_FALSE(sqrt(Interval(-1, 4)).continuous);
    EXPECT_EQ(sqrt(Interval(-1, 4)).lo, 0);
    EXPECT_GE(sqrt(Interval(-1, 4)).hi, 2);
    EXPECT_TRUE(sqrt(Interval(0, 4)).continuous);
    EXPECT_TRUE(sqrt(Interval(-2, -1)).empty());
    EXPECT_FALSE(log(Interval(0, 1)).continuous);
    EXPECT_EQ(log(Interval(-1, 1)).lo, -kInfinity);
    EXPECT_TRUE(log(Interval(-1, 0)).empty());
    EXPECT_TRUE(log(Interval(0.1, 1)).continuous);
    EXPECT_FALSE(tan(Interval(1, 2)).continuous);
    EXPECT_EQ(tan(Interval(1, 2)).lo, -kInfinity);
    EXPECT_TRUE(tan(Interval(-1.5, 1.5)).continuous);
    EXPECT_FALSE(tan(Interval(2, 6)).continuous);
    EXPECT_TRUE(tan(Interval(1.6, 4.7)).continuous);
}

TEST(Interval, DoubtIsPassedOnByEveryOperation) {
    const Interval sure(1, 2);
    const Interval doubtful(1, 2, false);
    for (const Interval& c : {-doubtful, doubtful + sure, sure + doubtful, sure - doubtful, sure * doubtful,
                              doubtful * sure, doubtful / sure, sure / doubtful, square(doubtful), abs(doubtful),
                              sqrt(doubtful), exp(doubtful), log(doubtful), sin(doubtful), cos(doubtful),
                              tan(Interval(1, 1.2, false)), min(sure, doubtful), max(doubtful, sure), step(doubtful),
                              power(doubtful, 3), power(doubtful, 0), power(doubtful, -2), hull(sure, doubtful),
                              intersect(doubtful, doubtful)})
        EXPECT_FALSE(c.continuous);
    EXPECT_TRUE(intersect(sure, doubtful).continuous);
    EXPECT_TRUE((sure * sure + sure / sure).continuous);
}

TEST(Interval, StepSpeaksOfTheSignOfItsArgument) {
    EXPECT_EQ(step(Interval(0, 1)).lo, 1);
    EXPECT_EQ(step(Interval(-1, 1)).lo, 0);
    EXPECT_EQ(step(Interval(-1, 1)).hi, 1);
    EXPECT_EQ(step(Interval(-2, -1)).hi, 0);
}

TEST(Interval, TheTestSeesArithmeticWithoutOutwardRounding) {
    // The wrong twin: bounds as doubles round them.
    Doubles draw(5);
    int missed = 0;
    for (int trial = 0; trial < 200; ++trial) {
        const double p = draw.usual();
        const double q = draw.usual();
        missed += contains(Interval(p * q), Exact(Exact(p) * Exact(q))) ? 0 : 1;
    }
    EXPECT_GT(missed, 100);
}

}  // namespace
}  // namespace pellucid
