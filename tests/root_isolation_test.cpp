#include "field/root_isolation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <boost/multiprecision/cpp_int.hpp>
#include <fmt/format.h>
#include <gtest/gtest.h>


namespace pellucid {
namespace {

using Number = boost::multiprecision::cpp_rational;

// ---- The oracle: polynomials of t with exact coefficients, and Sturm's theorem ----------------------------

struct Powers {
    std::vector<Number> c;  // c[0] + c[1] t + …

    Powers() = default;
    explicit Powers(double v) : c{Number(v)} {}
};
[[nodiscard]] Powers operator+(Powers a, const Powers& b) {
    a.c.resize(std::max(a.c.size(), b.c.size()));
    for (std::size_t i = 0; i < b.c.size(); ++i) a.c[i] += b.c[i];
    return a;
}
[[nodiscard]] Powers operator*(const Powers& a, const Powers& b) {
    Powers p;
    if (a.c.empty() || b.c.empty()) return p;
    p.c.resize(a.c.size() + b.c.size() - 1);
    for (std::size_t i = 0; i < a.c.size(); ++i)
        for (std::size_t j = 0; j < b.c.size(); ++j) p.c[i + j] += a.c[i] * b.c[j];
    return p;
}
[[nodiscard]] Powers operator-(const Powers& a, const Powers& b) { return a + Powers(-1.0) * b; }
[[nodiscard]] Powers operator*(double a, const Powers& b) { return Powers(a) * b; }

/// Coefficients without common factor: a positive multiple of the same polynomial.
using Whole = std::vector<boost::multiprecision::cpp_int>;

[[nodiscard]] Whole primitive(Whole p) {
    while (!p.empty() && p.back() == 0) p.pop_back();
    boost::multiprecision::cpp_int content = 0;
    for (const auto& c : p) content = gcd(content, c);
    for (auto& c : p) c /= content;
    return p;
}

[[nodiscard]] Whole whole(const Powers& p) {
    boost::multiprecision::cpp_int common = 1;
    for (const Number& c : p.c) common = lcm(common, denominator(c));
    Whole w;
    for (const Number& c : p.c) w.push_back(numerator(Number(c * common)));
    return primitive(w);
}

[[nodiscard]] int sign(const Whole& p, const Number& t) {
    boost::multiprecision::cpp_int sum = 0, power = 1;
    for (std::size_t i = p.size(); i-- > 0;) {
        sum = sum * numerator(t) + p[i] * power;
        power *= denominator(t);
    }
    return sum.sign();
}

class Sturm {
public:
    explicit Sturm(const Powers& p) {
        chain_ = {whole(p), {}};
        for (std::size_t i = 1; i < chain_[0].size(); ++i) chain_[1].push_back(chain_[0][i] * i);
        while (chain_.back().size() > 1) {
            Whole r = chain_[chain_.size() - 2];
            const Whole b = chain_.back();
            while (r.size() >= b.size()) {
                // r·|lead b| − (…)·b: a positive multiple, so signs stay.
                const auto q = b.back() > 0 ? r.back() : -r.back();
                for (auto& c : r) c *= abs(b.back());
                for (std::size_t i = 0; i < b.size(); ++i) r[r.size() - b.size() + i] -= q * b[i];
                while (!r.empty() && r.back() == 0) r.pop_back();
            }
            if (r.empty()) break;
            for (auto& c : r) c = -c;
            chain_.push_back(primitive(r));
        }
    }
    /// Different roots in (a, b]; neither end may be a multiple root.
    [[nodiscard]] int roots(const Number& a, const Number& b) const { return changes(a) - changes(b); }
    [[nodiscard]] int sign_at(const Number& t) const { return sign(chain_[0], t); }

private:
    [[nodiscard]] int changes(const Number& t) const {
        int count = 0, last = 0;
        for (const Whole& p : chain_) {
            const int here = sign(p, t);
            if (here == 0) continue;
            count += last == -here ? 1 : 0;
            last = here;
        }
        return count;
    }
    std::vector<Whole> chain_;
};

// ---- Surfaces and lines -----------------------------------------------------------------------------------

struct Surface {
    const char* name;
    const char* formula;
    std::function<Powers(const Powers&, const Powers&, const Powers&)> along;
};

[[nodiscard]] const std::vector<Surface>& surfaces() {
    static const std::vector<Surface> all{
        {"Barth sextic",
         "4*(2.618033988749895*x^2-y^2)*(2.618033988749895*y^2-z^2)*(2.618033988749895*z^2-x^2)"
         "-4.23606797749979*(x^2+y^2+z^2-1)^2",
         [](const Powers& x, const Powers& y, const Powers& z) {
             const double a = 2.618033988749895, b = 4.23606797749979;
             const Powers q = x * x + y * y + z * z - Powers(1);
             return 4 * ((a * (x * x) - y * y) * (a * (y * y) - z * z)) * (a * (z * z) - x * x) - b * (q * q);
         }},
        {"Clebsch cubic",
         "81*(x^3+y^3+z^3)-189*(x^2*y+x^2*z+y^2*x+y^2*z+z^2*x+z^2*y)+54*x*y*z+126*(x*y+x*z+y*z)"
         "-9*(x^2+y^2+z^2)-9*(x+y+z)+1",
         [](const Powers& x, const Powers& y, const Powers& z) {
             return 81 * (x * x * x + y * y * y + z * z * z) -
                    189 * (x * x * (y + z) + y * y * (x + z) + z * z * (x + y)) + 54 * (x * y * z) +
                    126 * (x * y + x * z + y * z) - 9 * (x * x + y * y + z * z) - 9 * (x + y + z) + Powers(1);
         }},
        {"tangle cube", "x^4-5*x^2+y^4-5*y^2+z^4-5*z^2+11.8",
         [](const Powers& x, const Powers& y, const Powers& z) {
             const auto well = [](const Powers& s) { return s * s * s * s - 5 * (s * s); };
             return well(x) + well(y) + well(z) + Powers(11.8);
         }},
        {"torus", "(x^2+y^2+z^2+0.75)^2-4*(x^2+y^2)",
         [](const Powers& x, const Powers& y, const Powers& z) {
             const Powers q = x * x + y * y + z * z + Powers(0.75);
             return q * q - 4 * (x * x + y * y);
         }},
        {"Cassini", "((x-1)^2+y^2+z^2)*((x+1)^2+y^2+z^2)-1.25",
         [](const Powers& x, const Powers& y, const Powers& z) {
             const Powers l = x - Powers(1), r = x + Powers(1), side = y * y + z * z;
             return (l * l + side) * (r * r + side) - Powers(1.25);
         }},
    };
    return all;
}

struct Ray {
    Vec3 origin, direction;
    double lo, hi;
};

[[nodiscard]] Powers along(const Surface& s, const Ray& ray) {
    const auto x = [](double o, double d) {
        Powers p;
        p.c = {Number(o), Number(d)};
        return p;
    };
    return s.along(x(ray.origin.x, ray.direction.x), x(ray.origin.y, ray.direction.y),
                   x(ray.origin.z, ray.direction.z));
}

class Rays {
public:
    explicit Rays(unsigned seed) : engine_(seed) {}
    [[nodiscard]] double uniform(double lo, double hi) {
        return std::uniform_real_distribution<double>(lo, hi)(engine_);
    }
    /// Multiples of 2^-bits: exact arithmetic stays short, and degenerate lines are met.
    [[nodiscard]] double coarse(double lo, double hi, int bits) {
        return std::ldexp(std::round(std::ldexp(uniform(lo, hi), bits)), -bits);
    }
    [[nodiscard]] Ray through_box(double size, int bits) {
        Ray ray;
        const auto vector = [&] {
            Vec3 v;
            v.x = coarse(-size, size, bits);
            v.y = coarse(-size, size, bits);
            v.z = coarse(-size, size, bits);
            return v;
        };
        ray.origin = vector();
        do ray.direction = vector();
        while (ray.direction.x == 0 && ray.direction.y == 0 && ray.direction.z == 0);
        const double l = std::max({std::abs(ray.direction.x), std::abs(ray.direction.y), std::abs(ray.direction.z)});
        ray.lo = -std::ceil(2 * size / l * 16) / 16;
        ray.hi = -ray.lo;
        return ray;
    }

private:
    std::mt19937_64 engine_;
};

struct Found {
    std::vector<Root> roots;
    IsolationStats stats;
    [[nodiscard]] std::size_t crossings() const {
        return static_cast<std::size_t>(
            std::count_if(roots.begin(), roots.end(), [](const Root& r) { return !r.touching; }));
    }
};

[[nodiscard]] Found isolate(const RootIsolator& f, const Ray& ray) {
    Found found;
    f.isolate(ray.origin, ray.direction, ray.lo, ray.hi, found.roots, found.stats);
    return found;
}
[[nodiscard]] Found by_intervals(const RootIsolator& f, const Ray& ray) {
    Found found;
    f.isolate_by_intervals(ray.origin, ray.direction, ray.lo, ray.hi, found.roots, found.stats);
    return found;
}
/// f of x alone, along x.
[[nodiscard]] Ray x_axis(double lo, double hi) { return {Vec3{0.0}, Vec3{1, 0, 0}, lo, hi}; }
[[nodiscard]] RootIsolator isolator(const std::string& formula) { return RootIsolator(Expression(formula)); }

void expect_roots(const Found& found, const std::vector<double>& expected, double tolerance,
                  const std::string& what) {
    ASSERT_EQ(found.roots.size(), expected.size()) << what;
    for (std::size_t i = 0; i < expected.size(); ++i)
        EXPECT_NEAR(found.roots[i].t, expected[i], tolerance) << what << ", root " << i;
}

// ---- Polynomials ------------------------------------------------------------------------------------------

void compare_with_sturm(const Surface& surface, int lines, int bits, unsigned seed) {
    const RootIsolator f = isolator(surface.formula);
    ASSERT_TRUE(f.polynomial());
    Rays rays(seed);
    int with_roots = 0;
    for (int i = 0; i < lines; ++i) {
        const Ray ray = rays.through_box(2, bits);
        const Sturm sturm(along(surface, ray));
        int sign = sturm.sign_at(Number(ray.lo));
        if (sign == 0 || sturm.sign_at(Number(ray.hi)) == 0) continue;
        const Found found = isolate(f, ray);
        ASSERT_EQ(found.roots.size(), static_cast<std::size_t>(sturm.roots(Number(ray.lo), Number(ray.hi))))
            << surface.name << ", line " << i;
        EXPECT_EQ(found.stats.undecided, 0U);
        with_roots += found.roots.empty() ? 0 : 1;
        const Number near(1e-12 * (ray.hi - ray.lo));
        for (const Root& root : found.roots) {
            const Number t(root.t);
            if (root.touching) {
                ASSERT_EQ(sturm.roots(t - near, t + near), 1)
                    << surface.name << ", line " << i << ", t = " << root.t;
            } else {
                ASSERT_EQ(sturm.sign_at(t + near), -sturm.sign_at(t - near))
                    << surface.name << ", line " << i << ", t = " << root.t;
                sign = -sign;
            }
        }
        EXPECT_EQ(sign, sturm.sign_at(Number(ray.hi)));
    }
    EXPECT_GT(with_roots, lines / 20);
}

TEST(PolynomialRoots, AreThoseThatSturmsTheoremCountsOnManyLines) {
    for (const Surface& surface : surfaces()) compare_with_sturm(surface, 2500, 5, 11);
}

TEST(PolynomialRoots, AreThoseThatSturmsTheoremCountsForArbitraryDoubles) {
    for (const Surface& surface : surfaces()) compare_with_sturm(surface, 500, 50, 12);
}

TEST(PolynomialRoots, SamplingSignsAtSixtyFourPointsWouldLoseSome) {
    // The wrong twin, so that the lines above are known to be hard enough.
    const Surface& barth = surfaces()[0];
    const Expression f(barth.formula);
    const RootIsolator isolator_of_f(f);
    Rays rays(11);
    int lost = 0;
    for (int i = 0; i < 2500; ++i) {
        const Ray ray = rays.through_box(2, 5);
        std::size_t changes = 0;
        const auto positive = [&](double t) { return f.at(ray.origin + t * ray.direction) >= 0; };
        const auto at = [&](int k) { return ray.lo + (ray.hi - ray.lo) * k / 64; };
        for (int k = 0; k < 64; ++k)
            changes += positive(at(k)) != positive(at(k + 1)) ? 1U : 0U;
        lost += changes != isolate(isolator_of_f, ray).crossings() ? 1 : 0;
    }
    EXPECT_GT(lost, 10);
}

[[nodiscard]] std::string product(const std::vector<double>& roots) {
    std::string formula;
    for (const double r : roots) formula += fmt::format("{}(x-({:.17g}))", formula.empty() ? "" : "*", r);
    return formula;
}

TEST(PolynomialRoots, ProductsGiveBackTheirRoots) {
    Rays draw(3);
    for (int trial = 0; trial < 2000; ++trial) {
        std::vector<double> roots(static_cast<std::size_t>(1 + trial % 12));
        for (double& r : roots) r = draw.uniform(-1, 1);
        std::sort(roots.begin(), roots.end());
        const Found found = isolate(isolator(product(roots)), x_axis(-1, 1));
        ASSERT_EQ(found.roots.size(), roots.size()) << product(roots);
        EXPECT_EQ(found.stats.undecided, 0U);
        for (std::size_t i = 0; i < roots.size(); ++i) {
            EXPECT_FALSE(found.roots[i].touching);
            EXPECT_NEAR(found.roots[i].t, roots[i], 1e-12) << product(roots);
        }
    }
}

TEST(PolynomialRoots, ClustersAreToldApart) {
    for (const double gap : {1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-12}) {
        for (const double at : {-0.7311, 0.0, 0.25, 0.61803}) {
            const std::vector<double> roots{at, at + gap, at + 3 * gap, 0.9};
            const Found found = isolate(isolator(product(roots)), x_axis(-1, 1));
            expect_roots(found, roots, 1e-15, fmt::format("gap {} at {}", gap, at));
            EXPECT_EQ(found.stats.undecided, 0U);
        }
    }
}

TEST(PolynomialRoots, WilkinsonChebyshevAndMignotte) {
    std::vector<double> integers;
    for (int i = 1; i <= 12; ++i) integers.push_back(i);
    expect_roots(isolate(isolator(product(integers)), x_axis(0, 13)), integers, 1e-11, "Wilkinson");

    std::vector<double> nodes;
    for (int i = 12; i >= 1; --i) nodes.push_back(std::cos((2 * i - 1) * std::acos(-1.0) / 24));
    const Found chebyshev =
        isolate(isolator("2048*x^12-6144*x^10+6912*x^8-3584*x^6+840*x^4-72*x^2+1"), x_axis(-1, 1));
    expect_roots(chebyshev, nodes, 1e-13, "Chebyshev");

    // x^8 − 2(1024x − 1)²: two roots near 2^-10, about 2^-46 apart.
    const Found mignotte = isolate(isolator("x^8-2*(1024*x-1)^2"), x_axis(-1, 1));
    EXPECT_EQ(mignotte.roots.size(), 2U);
    EXPECT_EQ(mignotte.stats.undecided, 0U);
    for (const Root& root : mignotte.roots) EXPECT_NEAR(root.t, 0x1p-10, 1e-13);
}

TEST(PolynomialRoots, OddMultiplicityCrossesAndEvenTouches) {
    const auto check = [](const std::string& formula, const Ray& ray, const std::vector<double>& expected,
                          const std::vector<bool>& touching) {
        const Found found = isolate(isolator(formula), ray);
        expect_roots(found, expected, 1e-12, formula);
        if (found.roots.size() != touching.size()) return;
        std::uint64_t count = 0;
        for (std::size_t i = 0; i < touching.size(); ++i) {
            EXPECT_EQ(found.roots[i].touching, touching[i]) << formula;
            count += touching[i] ? 1U : 0U;
        }
        EXPECT_EQ(found.stats.touching, count) << formula;
        EXPECT_EQ(found.stats.undecided, 0U) << formula;
    };
    check("(x^2+y^2+z^2-1)^2", x_axis(-2, 2), {-1, 1}, {true, true});
    check("(x^2+y^2+z^2-1)^2", {Vec3{-3, 0.6, 0}, Vec3{1, 0, 0}, 0, 10}, {2.2, 3.8}, {true, true});
    check("-(x^2+y^2+z^2-1)^2", x_axis(-2, 2.5), {-1, 1}, {true, true});
    check("(x^2+y^2+z^2-1)^3", x_axis(-2, 2.5), {-1, 1}, {false, false});
    check("x^2+y^2+z^2-1", {Vec3{-3, 1, 0}, Vec3{1, 0, 0}, 0, 10}, {3}, {true});  // a tangent
    check("x^3", x_axis(-1, 1.5), {0}, {false});
    check("x^3/3", x_axis(-1, 1.5), {0}, {false});
    check("(x-0.25)^2*(x-0.5)^3*(x-0.75)*(x^2+1)", x_axis(0, 1), {0.25, 0.5, 0.75}, {true, false, false});
    check("(x-0.3)^4*(x-0.31)^4*(x-0.9)^4", x_axis(0, 1), {0.3, 0.31, 0.9}, {true, true, true});
    check("(x^2+x/3)^2", x_axis(-1, 1.5), {-1.0 / 3, 0}, {true, true});
}

TEST(PolynomialRoots, ZeroAllAlongOrNowhereGivesNone) {
    for (const char* formula : {"x*y", "y^2", "x-x", "y*z-3*y", "x^2+1", "1", "-1", "0"}) {
        const Found found = isolate(isolator(formula), x_axis(-1, 1));
        EXPECT_TRUE(found.roots.empty()) << formula;
        EXPECT_EQ(found.stats.undecided, 0U) << formula;
    }
    EXPECT_TRUE(isolate(isolator("x"), x_axis(0.0, 0.0)).roots.empty());
}

TEST(PolynomialRoots, AtAnEndZeroCountsAsPositive) {
    const auto count = [](const char* formula, double lo, double hi) {
        return isolate(isolator(formula), x_axis(lo, hi)).crossings();
    };
    EXPECT_EQ(count("x", -1, 0), 1U);  // − to 0
    EXPECT_EQ(count("x", 0, 1), 0U);   // 0 to +
    EXPECT_EQ(count("-x", -1, 0), 0U);
    EXPECT_EQ(count("-x", 0, 1), 1U);
    EXPECT_EQ(count("x^2", -1, 0), 0U);
    EXPECT_EQ(count("x^2", 0, 1), 0U);
    EXPECT_EQ(count("-x^2", -1, 0), 1U);
    EXPECT_EQ(count("-x^2", 0, 1), 1U);
    EXPECT_EQ(count("(x-1)*(x-2)", 1, 2), 2U);
    EXPECT_EQ(count("-(x-1)*(x-2)", 1, 2), 0U);
}

TEST(Roots, SplittingAnIntervalNeitherLosesNorDoublesACrossing) {
    Rays rays(21);
    const std::vector<const char*> formulas{surfaces()[0].formula, surfaces()[2].formula, "x*y*z-x+0.5",
                                            "sin(3*x)*cos(2*y)+sin(z)-0.25", "exp(x)-y*y-0.5"};
    for (const char* formula : formulas) {
        const RootIsolator f = isolator(formula);
        for (int i = 0; i < 200; ++i) {
            const Ray ray = rays.through_box(2, i % 2 == 0 ? 50 : 4);
            const Found whole = isolate(f, ray);
            double m = rays.uniform(ray.lo, ray.hi);
            if (i % 3 == 0 && !whole.roots.empty()) m = whole.roots[0].t;  // at a root, as well as doubles can
            Ray left = ray, right = ray;
            left.hi = right.lo = m;
            const Found a = isolate(f, left), b = isolate(f, right);
            if (whole.stats.touching + a.stats.touching + b.stats.touching != 0) continue;
            ASSERT_EQ(a.crossings() + b.crossings(), whole.crossings())
                << formula << ", line " << i << " at " << m;
        }
    }
}

TEST(PolynomialRoots, KeepAtEveryScaleAndDistance) {
    for (const double scale : {1e-100, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e100}) {
        const RootIsolator f(Expression("x^2+y^2+z^2-r*r", {{"r", scale}}));
        const Found found = isolate(f, {Vec3{-3 * scale, 0, 0}, Vec3{1, 0, 0}, 0, 10 * scale});
        expect_roots(found, {2 * scale, 4 * scale}, 1e-14 * scale, fmt::format("scale {}", scale));
    }
    // Sphere seen from far away: the roots are those of the exact line.
    const RootIsolator unit = isolator("x^2+y^2+z^2-1");
    for (const double far : {1e3, 1e6, 1e9}) {
        const Found found = isolate(unit, {Vec3{-far, 0, 0}, Vec3{1, 0, 0}, 0, 2 * far});
        expect_roots(found, {far - 1, far + 1}, 4e-16 * far, fmt::format("distance {}", far));
    }
    const RootIsolator high = isolator("x^12-1");
    expect_roots(isolate(high, x_axis(-1e100, 1e100)), {-1, 1}, 1e87, "overflow");
}

// ---- By intervals -----------------------------------------------------------------------------------------

TEST(IntervalRoots, AreThoseOfThePolynomialPath) {
    Rays rays(31);
    int roots = 0;
    for (const Surface& surface : surfaces()) {
        const RootIsolator f = isolator(surface.formula);
        for (int i = 0; i < 300; ++i) {
            const Ray ray = rays.through_box(2, 50);
            const Found exact = isolate(f, ray);
            const Found found = by_intervals(f, ray);
            ASSERT_EQ(found.roots.size(), exact.roots.size()) << surface.name << ", line " << i;
            EXPECT_EQ(found.stats.undecided, 0U);
            for (std::size_t k = 0; k < found.roots.size(); ++k)
                EXPECT_NEAR(found.roots[k].t, exact.roots[k].t, 1e-8) << surface.name << ", line " << i;
            roots += static_cast<int>(found.roots.size());
        }
    }
    EXPECT_GT(roots, 1000);
}

TEST(IntervalRoots, ClosedFormsAreMet) {
    const double pi = std::acos(-1.0);
    std::vector<double> multiples;
    for (int k = -6; k <= 6; ++k) multiples.push_back(k * pi / 20);
    const auto check = [](const std::string& formula, const Ray& ray, const std::vector<double>& expected,
                          std::uint64_t poles = 0, std::uint64_t undecided = 0) {
        const RootIsolator f = isolator(formula);
        EXPECT_FALSE(f.polynomial()) << formula;
        const Found found = isolate(f, ray);
        expect_roots(found, expected, 1e-14, formula);
        for (const Root& root : found.roots) EXPECT_FALSE(root.touching) << formula;
        EXPECT_EQ(found.stats.undecided, undecided) << formula;
        EXPECT_EQ(found.stats.undecided, undecided) << formula;
        EXPECT_EQ(found.stats.poles, poles) << formula;
    };
    check("sin(20*x)", x_axis(-1, 1), multiples);
    check("exp(x)-2", x_axis(-1, 1), {std::log(2.0)});
    check("tan(x)", x_axis(-2, 2.5), {0}, 2);
    check("tan(x)-1", x_axis(-1, 4.5), {pi / 4, 5 * pi / 4}, 1);
    check("1/x", x_axis(-1, 1.5), {}, 1);
    check("x/abs(x)", x_axis(-1, 1.5), {}, 1);
    check("1/x-2", x_axis(-1, 1.5), {0.5}, 1);
    check("log(x)", x_axis(-1, 3), {1});
    check("log(x)+1", x_axis(-1, 3), {std::exp(-1.0)});
    check("sqrt(x)-0.5", x_axis(-1, 3), {0.25});
    check("abs(x)-0.25", x_axis(-1, 3), {-0.25, 0.25});
    check("sqrt(x^2+y^2+z^2)-1", {Vec3{-3, 0.6, 0}, Vec3{1, 0, 0}, 0, 10}, {2.2, 3.8});
    check("min(x^2+y^2+z^2-1,(x-1)^2+y^2+z^2-1)", x_axis(-3, 3), {-1, 2});
    check("max(x^2+y^2+z^2-1,(x-1)^2+y^2+z^2-1)", x_axis(-3, 3), {0, 1});
    check("max(x^2+y^2+z^2-1,-((x-1)^2+y^2+z^2-1))", x_axis(-3, 3), {-1, 0});
    check("x^3*exp(x)", x_axis(-1, 1.5), {0}, 0, 1);  // three roots may be there
    check("x^13", x_axis(-1, 1.5), {0});
    check("x^-3-8", x_axis(0.1, 1.5), {0.5});
    check("cos(x)-x", x_axis(-10, 10), {0.73908513321516064});
    check("sin(y)", x_axis(-1, 1), {});  // zero all along
    check("exp(-x^2)-2", x_axis(-1e6, 1e6), {});
}

TEST(IntervalRoots, TouchingIsToldAndCounted) {
    const double pi = std::acos(-1.0);
    const auto check = [](const std::string& formula, const Ray& ray, const std::vector<double>& expected,
                          double tolerance) {
        const RootIsolator f = isolator(formula);
        const Found found = by_intervals(f, ray);
        expect_roots(found, expected, tolerance, formula);
        for (const Root& root : found.roots) EXPECT_TRUE(root.touching) << formula;
        EXPECT_EQ(found.stats.touching, expected.size()) << formula;
    };
    // sin is flat there: zero within rounding over 1e-8.
    check("sin(x)-1", x_axis(0, 10), {pi / 2, 5 * pi / 2}, 1e-7);
    check("1-sin(x)", x_axis(0, 10), {pi / 2, 5 * pi / 2}, 1e-7);
    check("(exp(x)-2)^2", x_axis(-1, 1), {std::log(2.0)}, 1e-9);
    check("abs(sin(x)-0.5)", x_axis(0, 2), {std::asin(0.5)}, 1e-8);
    check("(x^2+y^2+z^2-1)^2", x_axis(-2, 2.5), {-1, 1}, 1e-8);
}

TEST(IntervalRoots, CloserThanTheLeastShareTheyAreFoundOrCounted) {
    for (const double gap : {1e-3, 1e-6, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12}) {
        const RootIsolator f(Expression("cos(x-0.3)-c", {{"c", std::cos(gap)}}));
        // In doubles 1 − cos(gap) has few digits: the two roots are as far apart as the constant says.
        const double apart = 2 * std::sqrt(2 * (1 - std::cos(gap)));
        const Found found = isolate(f, x_axis(-1, 1.5));
        EXPECT_TRUE(found.crossings() == 2 || found.stats.touching == 1 || found.stats.undecided > 0) << gap;
        if (gap >= 1e-6) {
            EXPECT_EQ(found.crossings(), 2U) << gap;
        }
        for (const Root& root : found.roots) EXPECT_NEAR(root.t, 0.3, apart + 1e-7);
    }
}

TEST(IntervalRoots, WorkIsBoundedAndWhatIsLeftIsCounted) {
    // Poles and roots without end towards 0.
    const Found found = isolate(isolator("sin(1/x)"), x_axis(-1, 1.5));
    EXPECT_GT(found.stats.undecided, 0U);
    EXPECT_GT(found.roots.size(), 100U);
}

TEST(IntervalRoots, KeepFarFromTheOriginAndAtEveryScale) {
    for (const double scale : {1e-6, 1e-3, 1.0, 1e3, 1e6}) {
        const RootIsolator f(Expression("sqrt(x^2+y^2+z^2)-r", {{"r", scale}}));
        const Found found = isolate(f, {Vec3{-3 * scale, 0.6 * scale, 0}, Vec3{1, 0, 0}, 0, 10 * scale});
        expect_roots(found, {2.2 * scale, 3.8 * scale}, 1e-14 * scale, fmt::format("scale {}", scale));
        EXPECT_EQ(found.stats.undecided, 0U);
    }
    const Found far = isolate(isolator("exp(x-1000000)-2"), x_axis(999990, 1000010));
    expect_roots(far, {1000000 + std::log(2.0)}, 3e-10, "far");
}

TEST(Roots, AscendAndMostRootsIsKept) {
    Rays rays(41);
    for (const char* formula : {surfaces()[0].formula, "sin(5*x)*cos(3*y)+sin(4*z)"}) {
        const RootIsolator f = isolator(formula);
        for (int i = 0; i < 300; ++i) {
            const Ray ray = rays.through_box(2, 6);
            const Found found = isolate(f, ray);
            EXPECT_TRUE(std::is_sorted(found.roots.begin(), found.roots.end(),
                                       [](const Root& a, const Root& b) { return a.t < b.t; }));
            for (const Root& root : found.roots) EXPECT_TRUE(root.t >= ray.lo && root.t <= ray.hi);
            if (f.most_roots() > 0) {
                EXPECT_LE(found.roots.size(), static_cast<std::size_t>(f.most_roots()));
            }
        }
    }
    EXPECT_EQ(isolator(surfaces()[0].formula).most_roots(), 6);
    EXPECT_EQ(isolator("sin(x)").most_roots(), 0);
}

TEST(Roots, IntervalsOfEveryLengthAreBroughtToAnEnd) {
    const double most = std::numeric_limits<double>::max();
    for (const char* formula : {"x", "x^3-x", "sin(x)", "exp(x)-2", "1/x", "x*abs(x)"}) {
        const RootIsolator f = isolator(formula);
        for (const Ray& ray : {x_axis(-most, most), x_axis(-1e300, 1e200), x_axis(0, most)})
            for (const Root& root : isolate(f, ray).roots)
                EXPECT_TRUE(root.t >= ray.lo && root.t <= ray.hi) << formula;
    }
    // Between neighbouring doubles there is room for one crossing.
    const double pi = std::acos(-1.0);  // below π, so sin > 0
    const double above = std::nextafter(pi, 4);
    for (const char* formula : {"sin(x)", "-sin(x)", "abs(sin(x))*(3.2-x)"}) {
        const std::size_t expected = formula[0] == 'a' ? 0 : 1;
        EXPECT_EQ(isolate(isolator(formula), x_axis(pi, above)).crossings(), expected) << formula;
    }
}

TEST(Roots, AppendToWhatIsThere) {
    Found found;
    found.roots.push_back({99, false});
    isolator("x").isolate(Vec3{0.0}, Vec3{1, 0, 0}, -1, 1.5, found.roots, found.stats);
    isolator("sin(x)").isolate(Vec3{0.0}, Vec3{1, 0, 0}, -1, 1.5, found.roots, found.stats);
    ASSERT_EQ(found.roots.size(), 3U);
    EXPECT_EQ(found.roots[0].t, 99);
    EXPECT_NEAR(found.roots[1].t, 0, 1e-15);
    EXPECT_NEAR(found.roots[2].t, 0, 1e-15);
}

}  // namespace
}  // namespace pellucid
