// Formulas of the catalogue against what is known of the surfaces: nodes, lines, symmetries, parametrisations.
#include "field/catalogue.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <numbers>
#include <random>
#include <sstream>

#include <gtest/gtest.h>

#include "core/error.hpp"
#include "core/real.hpp"
#include "scene/geometry.hpp"

namespace pellucid {
namespace {

using Values = std::map<std::string, double>;
constexpr double kPi = std::numbers::pi;
const double kPhi = (1 + std::sqrt(5.0)) / 2;

CatalogueFormula formula(const std::string& name, const Values& parameters = {}) {
    return catalogue_formula(catalogue_entry(name), parameters);
}

std::vector<std::string> formula_names() {
    std::vector<std::string> names;
    for (const CatalogueEntry& entry : catalogue())
        if (entry.is_formula()) names.emplace_back(entry.name);
    return names;
}

Vec3 inside(const Box& box, std::mt19937_64& random) {
    std::uniform_real_distribution<double> u(0, 1);
    return box.lo + box.size() * Vec3(u(random), u(random), u(random));
}

std::string message_of(const std::function<void()>& f) {
    try {
        f();
    } catch (const Error& error) {
        EXPECT_EQ(error.kind(), Failure::input);
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
        return error.what();
    }
    return "nothing was thrown";
}

// ---- singular points

struct Jet2 {
    double f;
    Vec3 gradient;
    Mat3 hessian;
};

Jet2 jet(const Expression& f, const Vec3& x) {
    std::vector<Real> values;
    std::array<Real, 10> out;
    run_program<Real>(f.hessian(), {Real(x.x), Real(x.y), Real(x.z)}, values, out);
    const auto v = [&](std::size_t i) { return out[i].value; };
    return {v(0), {v(1), v(2), v(3)},
            Mat3(Vec3(v(4), v(7), v(8)), Vec3(v(7), v(5), v(9)), Vec3(v(8), v(9), v(6)))};
}

/// Nodes by Newton's method on the gradient from a grid of places in the box: f = 0, ∇f = 0, Hessian of full rank.
std::vector<Vec3> nodes(const Expression& f, const Box& box) {
    constexpr int kPlaces = 14;
    std::vector<Vec3> found;
    for (int i = 0; i < kPlaces * kPlaces * kPlaces; ++i) {
        const Vec3 cell(i % kPlaces, i / kPlaces % kPlaces, i / kPlaces / kPlaces);
        Vec3 x = box.lo + box.size() * (cell + Vec3(0.53)) / static_cast<double>(kPlaces);
        bool settled = false;
        for (int k = 0; k < 60 && !settled; ++k) {
            const Jet2 at = jet(f, x);
            const Vec3 step = glm::inverse(at.hessian) * at.gradient;
            if (!(length(step) < 1e6)) break;
            x -= step;
            settled = length(step) < 1e-12 * (1 + length(x));
        }
        if (!settled || std::abs(jet(f, x).f) > 1e-10) continue;
        if (std::abs(glm::determinant(jet(f, x).hessian)) < 1e-6) continue;
        const auto near = [&](const Vec3& other) { return length(other - x) < 1e-6; };
        if (std::none_of(found.begin(), found.end(), near)) found.push_back(x);
    }
    return found;
}

void expect_node(const Expression& f, const Vec3& x) {
    const Jet2 at = jet(f, x);
    EXPECT_NEAR(at.f, 0, 1e-11) << x.x << " " << x.y << " " << x.z;
    EXPECT_LT(length(at.gradient), 1e-10) << x.x << " " << x.y << " " << x.z;
    EXPECT_GT(std::abs(glm::determinant(at.hessian)), 1e-3);
}

TEST(CatalogueNodes, BarthsSexticHas50And15AtInfinity) {
    const CatalogueFormula barth = formula("barth_sextic");
    EXPECT_EQ(nodes(barth.field, barth.bounds).size(), 50U);
    // The corners of a dodecahedron, and of an icosidodecahedron of radius 1.
    int corners = 0;
    for (int signs = 0; signs < 8; ++signs) {
        const double a = (signs & 1) != 0 ? -1 : 1, b = (signs & 2) != 0 ? -1 : 1, c = (signs & 4) != 0 ? -1 : 1;
        std::vector<Vec3> places{{a, b, c}};
        for (int turn = 0; turn < 3; ++turn) {
            const auto place = [&](double u, double v, double w) {
                const std::array<double, 3> p{u, v, w};
                const auto at = [&](int i) { return p[static_cast<std::size_t>((i + turn) % 3)]; };
                places.emplace_back(at(0), at(1), at(2));
            };
            if (b > 0) place(a * kPhi, 0, c / kPhi);
            if (b > 0 && c > 0) place(a, 0, 0);
            place(a * kPhi / 2, b / kPhi / 2, c * 0.5);
        }
        for (const Vec3& x : places) expect_node(barth.field, x);
        corners += static_cast<int>(places.size());
    }
    EXPECT_EQ(corners, 50);

    // At infinity: of the six planes that it tends to, every two meet, and the second term has w².
    std::vector<Vec3> planes;
    for (const double s : {-1.0, 1.0}) {
        planes.emplace_back(kPhi, s, 0);
        planes.emplace_back(0, kPhi, s);
        planes.emplace_back(s, 0, kPhi);
    }
    const Expression far = formula("barth_sextic", {{"radius", 1e-100}}).field;
    std::vector<Vec3> ways;
    for (std::size_t i = 0; i < 6; ++i)
        for (std::size_t j = 0; j < i; ++j) {
            const Vec3 way = normalize(cross(planes[i], planes[j]));
            for (const Vec3& other : ways) EXPECT_GT(length(cross(way, other)), 0.1);
            ways.push_back(way);
            EXPECT_NEAR(far.at(way), 0, 1e-14);
            EXPECT_LT(length(far.gradient_at(way)), 1e-13);
        }
    EXPECT_EQ(ways.size(), 15U);
}

TEST(CatalogueNodes, KummersQuarticHas16) {
    for (const double mu : {1.1, 1.3, 1.6}) {
        const Expression f = formula("kummer", {{"mu", mu}}).field;
        EXPECT_EQ(nodes(f, {Vec3(-2.5), Vec3(2.5)}).size(), 16U) << mu;
        // On the sphere of radius mu, where both factors of the second term vanish in squares.
        const double x = std::sqrt(mu * mu - 1);
        expect_node(f, {x, 0, -1});
        expect_node(f, {0, x, 1});
    }
}

TEST(CatalogueNodes, CayleysCubicHas4AndSmoothSurfacesNone) {
    const CatalogueFormula cayley = formula("cayley");
    EXPECT_EQ(nodes(cayley.field, cayley.bounds).size(), 4U);
    for (const Vec3& x : {Vec3(1, 1, 1), Vec3(1, -1, -1), Vec3(-1, 1, -1), Vec3(-1, -1, 1)}) expect_node(cayley.field, x);
    for (const char* smooth : {"clebsch", "tangle", "goursat", "chmutov", "metaballs", "gyroid", "schwarz_p", "schwarz_d"}) {
        const CatalogueFormula f = formula(smooth);
        EXPECT_TRUE(nodes(f.field, f.bounds).empty()) << smooth;
    }
}

TEST(CatalogueNodes, HuntsSurfaceIsSingularWhereBothBracketsVanish) {
    const Expression f = formula("hunt").field;
    const Vec3 cusp(8 / std::sqrt(7.0), 0, std::sqrt(27.0 / 7));
    EXPECT_NEAR(f.at(cusp), 0, 1e-9);
    EXPECT_LT(length(f.gradient_at(cusp)), 1e-9);
}

// ---- lines

TEST(CatalogueLines, ClebschsCubicHas27RealOnes) {
    const Expression f = formula("clebsch").field;
    // Sylvester's pentahedron: Σ X = 0 and Σ X³ = 6 f.
    const auto pentahedron = [](const Vec3& x) {
        std::array<double, 5> X{9 * x.x - 3 * x.y - 3 * x.z - 1, 9 * x.y - 3 * x.x - 3 * x.z - 1,
                                9 * x.z - 3 * x.x - 3 * x.y - 1, 3 * (x.x + x.y + x.z) + 1, 0};
        X[4] = -(X[0] + X[1] + X[2] + X[3]);
        return X;
    };
    std::mt19937_64 random(2);
    for (int i = 0; i < 20; ++i) {
        const Vec3 x = inside({Vec3(-2), Vec3(2)}, random);
        double cubes = 0;
        for (const double X : pentahedron(x)) cubes += X * X * X;
        EXPECT_NEAR(cubes, 6 * f.at(x), 1e-10 * (1 + std::abs(cubes)));
    }
    // A line of the surface by two of its points in those coordinates.
    using Five = std::array<double, 5>;
    std::vector<std::array<Five, 2>> lines;
    for (std::size_t m = 0; m < 5; ++m) {  // X_i + X_j = X_k + X_l = X_m = 0: 15
        std::vector<std::size_t> rest;
        for (std::size_t i = 0; i < 5; ++i)
            if (i != m) rest.push_back(i);
        for (std::size_t j = 1; j < 4; ++j) {
            Five a{}, b{};
            a[rest[0]] = 1;
            a[rest[j]] = -1;
            double sign = 1;
            for (std::size_t k = 1; k < 4; ++k)
                if (k != j) b[rest[k]] = std::exchange(sign, -1.0);
            lines.push_back({a, b});
        }
    }
    std::array<int, 5> order{0, 1, 2, 3, 4};  // a double six: fifth roots of unity in every order: 12
    do {
        if (order[0] != 0 || order[1] > order[4]) continue;
        Five a{}, b{};
        for (std::size_t i = 0; i < 5; ++i) {
            a[static_cast<std::size_t>(order[i])] = std::cos(2 * kPi * static_cast<double>(i) / 5);
            b[static_cast<std::size_t>(order[i])] = std::sin(2 * kPi * static_cast<double>(i) / 5);
        }
        lines.push_back({a, b});
    } while (std::next_permutation(order.begin(), order.end()));
    ASSERT_EQ(lines.size(), 27U);

    // Back to (x, y, z): X is linear in (x, y, z, w), here solved for; w = 1 makes it a point.
    const auto point = [](const Five& X) -> std::optional<Vec3> {
        // X3 = 3 s + w and X0 + X1 + X2 = 3 s − 3 w with s = x + y + z; X0 = 12 x − 3 s − w.
        const double w = (X[3] - (X[0] + X[1] + X[2])) / 4;
        const double s = (X[3] - w) / 3;
        if (std::abs(w) < 1e-9) return std::nullopt;
        return Vec3((X[0] + w) / 12 + s / 4, (X[1] + w) / 12 + s / 4, (X[2] + w) / 12 + s / 4) / w;
    };
    std::vector<std::array<Vec3, 2>> finite;
    for (const auto& [a, b] : lines) {
        std::vector<Vec3> on;
        for (int k = 0; k < 9; ++k) {
            Five X;
            for (std::size_t i = 0; i < 5; ++i) X[i] = std::cos(0.7 * k + 0.1) * a[i] + std::sin(0.7 * k + 0.1) * b[i];
            const auto x = point(X);
            if (!x || length(*x) > 50) continue;
            EXPECT_NEAR(f.at(*x), 0, 1e-9 * (1 + std::pow(length(*x), 3) * 300));
            on.push_back(*x);
        }
        ASSERT_GE(on.size(), 2U);  // no line at infinity
        finite.push_back({on[0], normalize(on[1] - on[0])});
        for (std::size_t i = 0; i + 1 < finite.size(); ++i)
            EXPECT_GT(length(cross(finite[i][1], finite.back()[1])) +
                          length(cross(finite[i][0] - finite.back()[0], finite.back()[1])), 1e-6);
    }
}

// ---- parametrisations and known points

TEST(CatalogueFormulas, VanishOnTheirParametrisations) {
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> angle(0, 2 * kPi);
    const Expression boy = formula("boy").field;
    const Expression steiner = formula("steiner", {{"radius", 3}}).field;
    const Expression cross_cap = formula("cross_cap").field;
    const Expression umbrella = formula("whitney_umbrella").field;
    const Expression bicorn = formula("bicorn", {{"a", 1.5}}).field;
    const double b = 0.8, c = 0.5, d = 0.7, a = std::hypot(b, c);
    const Expression cyclide = formula("dupin_cyclide", {{"b", b}, {"c", c}, {"d", d}}).field;
    for (int i = 0; i < 200; ++i) {
        const double u = angle(random), v = angle(random);
        const double cu = std::cos(u), su = std::sin(u), cv = std::cos(v), sv = std::sin(v);
        const double r2 = std::numbers::sqrt2;
        // Apéry's, two thirds of the usual size.
        const Vec3 p = Vec3(r2 * cv * cv * std::cos(2 * u) + cu * std::sin(2 * v),
                            r2 * cv * cv * std::sin(2 * u) - su * std::sin(2 * v), 3 * cv * cv) *
                       (2 / (3 * (2 - r2 * std::sin(3 * u) * std::sin(2 * v))));
        EXPECT_NEAR(boy.at(p), 0, 1e-10 * (1 + 1000 * std::pow(length(p), 6)));
        // Of the sphere's point s: radius (s_y s_z, s_z s_x, s_x s_y).
        const Vec3 s(cu * cv, su * cv, sv);
        EXPECT_NEAR(steiner.at(3.0 * Vec3(s.y * s.z, s.z * s.x, s.x * s.y)), 0, 1e-12);
        EXPECT_NEAR(cross_cap.at({s.y * s.z, 2 * s.x * s.y, s.x * s.x - s.y * s.y}), 0, 1e-12);
        EXPECT_NEAR(umbrella.at({u * v, u, v * v}), 0, 1e-10 * (1 + u * u * v * v));
        // The bicorn (a sin t, a cos² t (2 + cos t)/(3 + sin² t)), turned.
        const double rho = 1.5 * sv;
        EXPECT_NEAR(bicorn.at({rho * cu, rho * su, 1.5 * cv * cv * (2 + cv) / (3 + sv * sv)}), 0, 1e-11);
        const double below = a - c * cu * cv;
        EXPECT_NEAR(cyclide.at({(d * (c - a * cu * cv) + b * b * cu) / below, b * su * (a - d * cv) / below,
                                b * sv * (c * cu - d) / below}), 0, 1e-12);
    }
}

TEST(CatalogueFormulas, VanishAtKnownPoints) {
    const auto zero = [](const char* name, const Vec3& x, const Values& parameters = {}) {
        EXPECT_NEAR(formula(name, parameters).field.at(x), 0, 1e-12) << name;
    };
    zero("cassini_oval", {0, 0, std::sqrt(1 + 1.44)}, {{"b", 1.2}});
    zero("cassini_oval", {std::sqrt(1.44 - 1), 0, 0}, {{"b", 1.2}});
    zero("cassini", {0, std::sqrt(0.81 - 0.25), 0.9});           // product of distances 0.9²
    zero("cross_cap", {0, 0.6, 0.8});                            // the circle y² + z² = 1 in x = 0
    zero("cross_cap", {0.5, 0, -0.5});                           // and (z + ½)² + x² = ¼ in y = 0
    zero("miter", {0, 0.6, 0.8});
    zero("heart", {1, 0, 0});
    zero("heart", {0, 2.0 / 3, 0});
    zero("heart", {0, 0, 1});
    zero("klein_bottle", {0, std::sqrt(2.0) - 1, 0});            // both factors, on the y axis
    zero("klein_bottle", {0, std::sqrt(2.0) + 1, 0});
    zero("chmutov", Vec3(std::cos(kPi / 12)));                   // T6(cos t) = cos 6t
    zero("chmutov", {std::cos(0.1), std::cos(0.1 + kPi / 9), std::cos(0.1 + 2 * kPi / 9)});
    zero("tangle", {std::sqrt((5 + std::sqrt(27.8)) / 2), std::sqrt(2.5), std::sqrt(2.5)});
    zero("goursat", {1, 0, 0}, {{"a", 1}, {"b", 1}, {"c", -3}});
    zero("chair", {0, 0, 2}, {{"a", 1}, {"b", 1}, {"k", 1}});      // (4 − 1)² = 1·3²
    zero("gyroid", {0.5, 0.5, -0.5}, {{"period", 2}});
    zero("schwarz_p", Vec3(0.5), {{"period", 2}});
    zero("schwarz_d", {0, 0, 0}, {{"period", 2}});
    // Where its own ball gives ½: two of the others give as much as each other, the third half of what stands below it.
    const double depth = 0.6 * std::sqrt(std::log(2.0));
    zero("metaballs", {0.5, 0.5, 0.5 - depth},
         {{"threshold", 0.5 + 2 * std::exp(-(1 + (1 - depth) * (1 - depth)) / 0.36) + 0.5 * std::exp(-2 / 0.36)}});
    zero("hunt", {0, 3.5, 0});                                 // 4·(−¾)³ + 27·(¼)² = 0
}

/// By another way to the atoms: thirds of the edges of an icosahedron.
TEST(CatalogueFormulas, BuckyBallHasItsChargesAtTheThirdsOfAnIcosahedronsEdges) {
    std::vector<Vec3> corners;
    for (const double a : {-1.0, 1.0})
        for (const double b : {-kPhi, kPhi})
            for (const Vec3& corner : {Vec3(0, a, b), Vec3(a, b, 0), Vec3(b, 0, a)}) corners.push_back(corner);
    std::vector<Vec3> atoms;
    for (const Vec3& p : corners)
        for (const Vec3& q : corners)
            if (const double edge = length(p - q); edge > 0 && edge < 2.1) atoms.push_back((2.0 * p + q) / 3.0);
    ASSERT_EQ(atoms.size(), 60U);
    const double radius = 1.7;
    const double scale = radius / length(atoms[0]);
    const Expression f = formula("bucky_ball", {{"radius", radius}, {"level", 83}}).field;
    std::mt19937_64 random(8);
    for (int i = 0; i < 100; ++i) {
        const Vec3 x = inside({Vec3(-2.5), Vec3(2.5)}, random);
        double potential = 0;
        for (const Vec3& atom : atoms) potential += radius * radius / dot(x - scale * atom, x - scale * atom);
        EXPECT_NEAR(f.at(x), 83 - potential, 1e-10 * potential);
    }
    // Hollow, and open in every face: of the twelve pentagons and twenty hexagons none holds the level on its axis.
    const Expression usual = formula("bucky_ball").field;
    for (const Vec3& axis : {Vec3(0, 1, kPhi), Vec3(1, 1, 1)})
        for (int i = 0; i <= 300; ++i) EXPECT_GT(usual.at(0.01 * i * normalize(axis)), 0) << i;
}

// ---- symmetries

Mat3 turned(const Vec3& axis, double degrees) {
    const Vec3 n = normalize(axis);
    const double angle = degrees * kPi / 180;
    const Mat3 skew(Vec3(0, n.z, -n.y), Vec3(-n.z, 0, n.x), Vec3(n.y, -n.x, 0));
    return Mat3(1.0) + std::sin(angle) * skew + (1 - std::cos(angle)) * skew * skew;
}

struct Symmetry {
    const char* name;
    Mat3 map;
    Vec3 shift{0.0};
    double sign = 1;  // f(map·x + shift) = sign·f(x)
};

TEST(CatalogueFormulas, HaveTheirSymmetries) {
    const Mat3 cycle = turned({1, 1, 1}, 120);
    const Mat3 mx(Vec3(-1, 0, 0), Vec3(0, 1, 0), Vec3(0, 0, 1)), my(Vec3(1, 0, 0), Vec3(0, -1, 0), Vec3(0, 0, 1)),
        mz(Vec3(1, 0, 0), Vec3(0, 1, 0), Vec3(0, 0, -1)), one(1.0);
    const Mat3 half = turned({0, 0, 1}, 180), quarter = turned({0, 0, 1}, 90), swap = half * mx * turned({0, 0, 1}, -90);
    const Mat3 rotoreflection = mz * quarter;  // of a tetrahedron
    std::vector<Symmetry> all{
        {"barth_sextic", turned({1, 0, kPhi}, 72)}, {"barth_sextic", cycle}, {"barth_sextic", -one},
        {"clebsch", cycle}, {"clebsch", swap},
        {"cayley", cycle}, {"cayley", rotoreflection}, {"kummer", rotoreflection}, {"kummer", mx},
        {"steiner", cycle}, {"steiner", rotoreflection}, {"chair", rotoreflection}, {"chair", mx}, {"chair", turned({std::numbers::sqrt2, 0, 1}, 120)},
        {"kummer", turned({std::numbers::sqrt2, 0, 1}, 120)},
        {"cross_cap", mx}, {"cross_cap", my}, {"boy", turned({0, 0, 1}, 120)}, {"klein_bottle", turned({0, 1, 0}, 180)}, {"cassini", mx}, {"cassini", my}, {"cassini", mz},
        {"cassini_oval", turned({0, 0, 1}, 33)}, {"cassini_oval", mz}, {"dupin_cyclide", my}, {"dupin_cyclide", mz},
        {"heart", mx}, {"heart", my}, {"bicorn", turned({0, 0, 1}, 33)}, {"bicorn", my},
        {"hunt", mx}, {"hunt", my}, {"hunt", mz}, {"miter", mx}, {"miter", my}, {"miter", mz},
        {"whitney_umbrella", mx}, {"whitney_umbrella", my},
        {"gyroid", cycle}, {"gyroid", one, Vec3(0.5)}, {"gyroid", one, {1, 0, 0}}, {"gyroid", -one, {}, -1},
        {"bucky_ball", turned({0, 1, kPhi}, 72)}, {"bucky_ball", cycle}, {"bucky_ball", -one},
        {"metaballs", cycle}, {"metaballs", half}, {"metaballs", rotoreflection}, {"metaballs", swap},
        {"schwarz_p", cycle}, {"schwarz_p", quarter}, {"schwarz_p", one, Vec3(0.5), -1}, {"schwarz_p", one, {0, 1, 0}},
        {"schwarz_d", cycle}, {"schwarz_d", one, Vec3(0.5), -1}, {"schwarz_d", swap}, {"schwarz_d", -one, {}, -1},
    };
    for (const char* octahedral : {"tangle", "goursat", "chmutov"})
        for (const Mat3& map : {cycle, quarter, -one}) all.push_back({octahedral, map});
    std::mt19937_64 random(4);
    for (const Symmetry& s : all) {
        const CatalogueFormula f = formula(s.name);
        for (int i = 0; i < 20; ++i) {
            const Vec3 x = inside(f.bounds, random);
            const double value = f.field.at(x);
            EXPECT_NEAR(f.field.at(s.map * x + s.shift), s.sign * value, 1e-9 * (1 + std::abs(value))) << s.name;
        }
    }
    for (const std::string& name : formula_names())
        EXPECT_TRUE(std::any_of(all.begin(), all.end(), [&](const Symmetry& s) { return s.name == name; })) << name;
}

// ---- as geometry

class EachFormula : public testing::TestWithParam<std::string> {};

TEST_P(EachFormula, IsCrossedAsItsSignsSay) {
    const CatalogueFormula f = formula(GetParam());
    Surface surface;
    surface.name = GetParam();
    surface.shape = ImplicitShape{GetParam(), {}};
    const auto geometry = make_geometry(surface);
    std::mt19937_64 random(5);
    CrossingList hits;
    int crossings = 0;
    for (int i = 0; i < 60; ++i) {
        const Vec3 from = inside(f.bounds, random), to = inside(f.bounds, random);
        int count = 0;
        for (std::size_t patch = 0; patch < geometry->patch_count(); ++patch) {
            count += geometry->crossings(patch, {from, to - from, 0, 1}, hits);
            for (const Crossing& hit : hits.hits) {
                const Vec3 x = from + hit.t * (to - from);
                EXPECT_NEAR(f.field.at(x), 0, 1e-9 * (1 + length(f.field.gradient_at(x))));
            }
        }
        EXPECT_EQ(count % 2 == 1, (f.field.at(from) < 0) != (f.field.at(to) < 0)) << i;
        crossings += count;
    }
    EXPECT_GT(crossings, 5);
}

/// Where a surface is bounded, its default bounds hold all of it: no sign changes in their faces.
TEST_P(EachFormula, IsWholeInItsBoundsOrKnownToBeCut) {
    constexpr std::array kCut{"barth_sextic", "clebsch", "cayley", "kummer", "cassini", "whitney_umbrella",
                              "gyroid",       "schwarz_p", "schwarz_d"};
    const bool cut = std::find(kCut.begin(), kCut.end(), GetParam()) != kCut.end();
    const CatalogueFormula f = formula(GetParam());
    std::mt19937_64 random(6);
    bool positive = false, negative = false;
    for (int i = 0; i < 6000; ++i) {
        Vec3 x = inside(f.bounds, random);
        x[i % 3] = i % 2 == 0 ? f.bounds.lo[i % 3] : f.bounds.hi[i % 3];
        const double value = f.field.at(x);
        positive = positive || value > 1e-12;
        negative = negative || value < -1e-12;
    }
    EXPECT_EQ(positive && negative, cut);
}

INSTANTIATE_TEST_SUITE_P(Catalogue, EachFormula, testing::ValuesIn(formula_names()),
                         [](const auto& test) { return test.param; });

TEST(CatalogueFormulas, TakeTheBoundsOfTheScene) {
    Surface surface;
    surface.shape = ImplicitShape{"cayley", {}};
    surface.bounds = Box{{0.5, -3, -3}, {3, 3, 3}};
    const Box box = make_geometry(surface)->bounds();
    EXPECT_GE(box.lo.x, 0.5 - 1e-6);  // less than the catalogue's
    EXPECT_GT(box.hi.x, 1.7);         // and more than its 1.6
}

// ---- names and parameters

TEST(CatalogueEntries, RefuseParametersOutsideTheirRange) {
    const auto refusal = [](const char* name, const Values& parameters) {
        Surface surface;
        surface.name = "s";
        surface.shape = ImplicitShape{name, parameters};
        return message_of([&] { static_cast<void>(make_geometry(surface)); });
    };
    EXPECT_EQ(refusal("barth_sextic", {{"radius", 0}}),
              "surface \"s\": implicit = \"barth_sextic\": radius = 0, expected > 0 and finite");
    EXPECT_EQ(refusal("torus", {{"minor", -1}}), "surface \"s\": implicit = \"torus\": minor = -1, expected > 0 and finite");
    EXPECT_EQ(refusal("gyroid", {{"size", 1}}), "surface \"s\": implicit = \"gyroid\": it has no parameter \"size\"");
    for (const double mu : {0.9, 1.0, 1.8})
        EXPECT_NE(refusal("kummer", {{"mu", mu}}).find("expected > 1 and < 1.73205"), std::string::npos);
    EXPECT_NE(refusal("goursat", {{"b", kInfinity}}).find("b = inf, expected finite"), std::string::npos);
    EXPECT_NE(refusal("goursat", {{"b", std::nan("")}}).find("b = nan, expected finite"), std::string::npos);
    EXPECT_NE(refusal("barth", {}).find("expected one of sphere, "), std::string::npos);
    EXPECT_NO_THROW(static_cast<void>(formula("goursat", {{"a", -0.2}, {"b", -3}})));
}

TEST(CatalogueEntries, ClosedFormsAreThoseOfTheirEquations) {
    const std::vector<std::string> closed{"sphere", "ellipsoid", "torus",  "plane",       "cylinder",
                                          "cone",   "paraboloid", "saddle", "hyperboloid", "hyperboloid_two_sheets"};
    std::mt19937_64 random(7);
    for (std::size_t i = 0; i < catalogue().size(); ++i) {
        const CatalogueEntry& entry = catalogue()[i];
        ASSERT_EQ(entry.is_formula(), i >= closed.size()) << entry.name;
        if (entry.is_formula()) continue;
        EXPECT_EQ(entry.name, closed[i]);
        const CatalogueSurface surface(closed[i], {});
        const Expression equation(entry.equation, catalogue_parameters(entry, {}));
        for (int k = 0; k < 200; ++k) {
            const Vec3 x = inside({Vec3(-1.5), Vec3(1.5)}, random);
            if (std::abs(equation.at(x)) <= 1e-9) continue;
            EXPECT_EQ(surface.value(x) < 0, equation.at(x) < 0) << entry.name;
        }
    }
}

/// | `name` | `equation` | parameters | bounds |, as the scene documentation lists them.
TEST(CatalogueEntries, AreThoseOfTheSceneDocumentation) {
    std::ifstream file(PELLUCID_SOURCE_DIR "/scenes/README.md");
    std::vector<std::string> names;
    bool in_table = false;
    for (std::string line; std::getline(file, line);) {
        if (line.starts_with("| name | equation")) in_table = true;
        if (in_table && line.empty()) break;
        if (!in_table || !line.starts_with("| `")) continue;
        const std::string name = line.substr(3, line.find('`', 3) - 3);
        names.push_back(name);
        const CatalogueEntry& entry = catalogue_entry(name);
        const std::size_t at = line.find('`', line.find('|', 3)) + 1;
        EXPECT_EQ(line.substr(at, line.find('`', at) - at), entry.equation);
        for (const auto& p : entry.parameters) {
            std::ostringstream text;
            text << p.name << " = " << p.value;
            EXPECT_NE(line.find(text.str()), std::string::npos) << name << ": " << text.str();
        }
    }
    std::vector<std::string> expected;
    for (const CatalogueEntry& entry : catalogue()) expected.emplace_back(entry.name);
    EXPECT_EQ(names, expected);
}

}  // namespace
}  // namespace pellucid
