#include "field/catalogue.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "field/catalogue_formulas.hpp"
#include "field/polynomial.hpp"

namespace pellucid {
namespace {

std::vector<CatalogueEntry> entries() {
    std::vector<CatalogueEntry> all{
        {"sphere", "x^2 + y^2 + z^2 - radius^2", {{"radius", 1}}, "tight"},
        {"ellipsoid", "(x/a)^2 + (y/b)^2 + (z/c)^2 - 1", {{"a", 1}, {"b", 0.7}, {"c", 0.5}}, "tight"},
        {"torus", "(sqrt(x^2 + y^2) - major)^2 + z^2 - minor^2", {{"major", 1}, {"minor", 0.4}}, "tight"},
        {"plane", "z", {}, "[-1, 1]^3"},
        {"cylinder", "x^2 + y^2 - radius^2", {{"radius", 1}, {"height", 2}}, "|z| <= height/2, open"},
        {"cone", "x^2 + y^2 - (radius/height*z)^2", {{"radius", 1}, {"height", 2}}, "|z| <= height, open"},
        {"paraboloid", "x^2 + y^2 - (radius^2/height)*z", {{"radius", 1}, {"height", 1}}, "0 <= z <= height, open"},
        {"saddle", "x^2/a^2 - y^2/b^2 - z", {{"a", 1}, {"b", 1}}, "[-1, 1]^3"},
        {"hyperboloid", "(x^2 + y^2)/a^2 - z^2/c^2 - 1", {{"a", 0.5}, {"c", 0.5}}, "|z| <= 1, open"},
        {"hyperboloid_two_sheets", "(x^2 + y^2)/a^2 - z^2/c^2 + 1", {{"a", 0.5}, {"c", 0.25}}, "|z| <= 1, open"},
    };
    const std::span<const CatalogueEntry> formulas = catalogue_formulas();
    all.insert(all.end(), formulas.begin(), formulas.end());
    return all;
}

/// Crossings of a t² + 2 b t + c = 0 in [lo, hi]; the root of smaller size comes from the product,
/// so that b² ≫ ac costs no digits.
int quadratic_crossings(double a, double b, double c, double lo, double hi, std::span<double, 4> t) {
    int found = 0;
    const auto keep = [&](double root) {
        if (root >= lo && root <= hi) t[static_cast<std::size_t>(found++)] = root;
    };
    if (a == 0) {
        if (b != 0) keep(-c / (2 * b));
        return found;
    }
    const double discriminant = b * b - a * c;
    if (!(discriminant > 0)) return 0;
    const double q = -(b + std::copysign(std::sqrt(discriminant), b));
    double first = q / a;
    double second = c / q;
    if (first > second) std::swap(first, second);
    keep(first);
    keep(second);
    return found;
}

/// Range of q x² + l x over [lo, hi].
[[nodiscard]] Vec2 quadratic_range(double q, double l, double lo, double hi) {
    const double at_lo = (q * lo + l) * lo;
    const double at_hi = (q * hi + l) * hi;
    Vec2 range(std::min(at_lo, at_hi), std::max(at_lo, at_hi));
    if (q != 0) {
        const double turn = -l / (2 * q);
        if (turn > lo && turn < hi) {
            const double there = (q * turn + l) * turn;
            range = {std::min(range.x, there), std::max(range.y, there)};
        }
    }
    return range;
}

}  // namespace

std::span<const CatalogueEntry> catalogue() {
    static const std::vector<CatalogueEntry> all = entries();
    return all;
}

std::string range_of(const CatalogueEntry::Parameter& p) {
    if (p.above == -kInfinity) return p.below == kInfinity ? "finite" : fmt::format("< {:.6g}", p.below);
    return fmt::format("> {:.6g}{}", p.above, p.below == kInfinity ? "" : fmt::format(" and < {:.6g}", p.below));
}

const CatalogueEntry& catalogue_entry(const std::string& name) {
    const auto all = catalogue();
    const auto entry = std::find_if(all.begin(), all.end(), [&](const CatalogueEntry& e) { return e.name == name; });
    if (entry == all.end()) {
        std::string known;
        for (const CatalogueEntry& e : all) known += (known.empty() ? "" : ", ") + std::string(e.name);
        throw input_error("implicit = \"{}\", expected one of {}", name, known);
    }
    return *entry;
}

std::map<std::string, double> catalogue_parameters(const CatalogueEntry& entry,
                                                   const std::map<std::string, double>& given) {
    std::map<std::string, double> values;
    for (const auto& parameter : entry.parameters) values[std::string(parameter.name)] = parameter.value;
    for (const auto& [key, value] : given) {
        const auto& all = entry.parameters;
        const auto parameter = std::find_if(all.begin(), all.end(), [&](const auto& p) { return p.name == key; });
        if (parameter == all.end())
            throw input_error("implicit = \"{}\": it has no parameter \"{}\"", entry.name, key);
        if (!(value > parameter->above && value < parameter->below))
            throw input_error("implicit = \"{}\": {} = {}, expected {}{}", entry.name, key, value, range_of(*parameter),
                              parameter->above == 0 && parameter->below == kInfinity ? " and finite" : "");
        values[key] = value;
    }
    return values;
}

CatalogueFormula catalogue_formula(const CatalogueEntry& entry, const std::map<std::string, double>& parameters) {
    const std::map<std::string, double> values = catalogue_parameters(entry, parameters);
    const auto corner = [&](std::size_t first) {
        Vec3 x;
        for (std::size_t i = 0; i < 3; ++i)
            x[static_cast<int>(i)] = Expression(entry.box[first + i], values).at(Vec3(0.0));
        return x;
    };
    return {Expression(entry.long_equation.empty() ? entry.equation : entry.long_equation, values), Box{corner(0), corner(3)}};
}

CatalogueSurface::CatalogueSurface(const std::string& name, const std::map<std::string, double>& parameters) {
    std::map<std::string, double> p = catalogue_parameters(catalogue_entry(name), parameters);

    const auto quadric = [&](const Vec3& q, const Vec3& l, double c, const Box& box) {
        square_ = q;
        linear_ = l;
        constant_ = c;
        bounds_ = box;
    };
    const auto half_box = [](const Vec3& half) { return Box{-half, half}; };
    if (name == "sphere") {
        const double r = p["radius"];
        quadric({1 / (r * r), 1 / (r * r), 1 / (r * r)}, Vec3(0), -1, half_box(Vec3(r)));
    } else if (name == "ellipsoid") {
        const Vec3 axes(p["a"], p["b"], p["c"]);
        quadric(1.0 / (axes * axes), Vec3(0), -1, half_box(axes));
    } else if (name == "torus") {
        torus_ = true;
        major_ = p["major"];
        minor_ = p["minor"];
        bounds_ = half_box({major_ + minor_, major_ + minor_, minor_});
    } else if (name == "plane") {
        quadric(Vec3(0), {0, 0, 1}, 0, half_box(Vec3(1)));
    } else if (name == "cylinder") {
        const double r = p["radius"];
        quadric({1 / (r * r), 1 / (r * r), 0}, Vec3(0), -1, half_box({r, r, 0.5 * p["height"]}));
    } else if (name == "cone") {
        const double r = p["radius"];
        const double h = p["height"];
        quadric({1 / (r * r), 1 / (r * r), -1 / (h * h)}, Vec3(0), 0, half_box({r, r, h}));
    } else if (name == "paraboloid") {
        const double r = p["radius"];
        const double h = p["height"];
        quadric({1 / (r * r), 1 / (r * r), 0}, {0, 0, -1 / h}, 0, {{-r, -r, 0}, {r, r, h}});
    } else if (name == "saddle") {
        quadric({1 / (p["a"] * p["a"]), -1 / (p["b"] * p["b"]), 0}, {0, 0, -1}, 0, half_box(Vec3(1)));
    } else {  // the hyperboloids, cut at |z| = 1
        const double a = p["a"];
        const double c = p["c"];
        const double sheet = name == "hyperboloid" ? 1 : -1;
        const double rim = a * std::sqrt(std::max(0.0, 1 / (c * c) + sheet));
        quadric({1 / (a * a), 1 / (a * a), -1 / (c * c)}, Vec3(0), -sheet, half_box({rim, rim, 1}));
    }
}

int CatalogueSurface::max_crossings() const {
    if (torus_) return 4;
    return square_ == Vec3(0) ? 1 : 2;
}

double CatalogueSurface::value(const Vec3& x) const {
    if (!torus_) return dot(square_ * x + linear_, x) + constant_;
    const double ring = std::hypot(x.x, x.y) - major_;
    return ring * ring + x.z * x.z - minor_ * minor_;
}

Vec3 CatalogueSurface::gradient(const Vec3& x) const {
    if (!torus_) return 2.0 * square_ * x + linear_;
    const double rho = std::hypot(x.x, x.y);
    const double inward = rho > 0 ? 1 - major_ / rho : 0;
    return 2.0 * Vec3(inward * x.x, inward * x.y, x.z);
}

FieldJet CatalogueSurface::jet(const Vec3& x) const {
    FieldJet jet{value(x), gradient(x), {}};
    if (!torus_) {
        jet.hessian = {2 * square_.x, 2 * square_.y, 2 * square_.z, 0, 0, 0};
        return jet;
    }
    // (ρ − R)² has the second derivatives 2δ − 2R(δ/ρ − x_i x_j/ρ³).
    const double rho = std::hypot(x.x, x.y);
    const double ring = rho > 0 ? 2 * major_ / rho : 0;
    const Vec2 out = rho > 0 ? Vec2(x.x, x.y) / rho : Vec2(0.0);
    jet.hessian = {2 - ring * (1 - out.x * out.x), 2 - ring * (1 - out.y * out.y), 2, ring * out.x * out.y, 0, 0};
    return jet;
}

bool CatalogueSurface::excludes(const Box& box) const {
    if (!torus_) {
        Vec2 range(constant_);
        for (int axis = 0; axis < 3; ++axis)
            range += quadratic_range(square_[axis], linear_[axis], box.lo[axis], box.hi[axis]);
        return range.x > 0 || range.y < 0;
    }
    const auto square_range = [](double lo, double hi) { return quadratic_range(1, 0, lo, hi); };
    const Vec2 rho2 = square_range(box.lo.x, box.hi.x) + square_range(box.lo.y, box.hi.y);
    const Vec2 tube = square_range(std::sqrt(rho2.x) - major_, std::sqrt(rho2.y) - major_) +
                      square_range(box.lo.z, box.hi.z) - Vec2(minor_ * minor_);
    return tube.x > 0 || tube.y < 0;
}

int CatalogueSurface::crossings(const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
                                std::span<double, kMaxCatalogueCrossings> t) const {
    if (!(t_lo < t_hi)) return 0;
    // Around the middle of the piece, where coordinates are as small as the surface itself.
    const double middle = 0.5 * (t_lo + t_hi);
    const double half = 0.5 * (t_hi - t_lo);
    const Vec3 m = origin + middle * direction;
    if (!torus_) {
        const double a = dot(square_ * direction, direction);
        const double b = dot(square_ * m, direction) + 0.5 * dot(linear_, direction);
        const int found = quadratic_crossings(a, b, value(m), -half, half, t);
        for (int i = 0; i < found; ++i) t[static_cast<std::size_t>(i)] += middle;
        return found;
    }

    // (|x|² + R² − r²)² = 4 R² (x² + y²), a quartic in u = (t − t_lo)/(t_hi − t_lo).
    const Vec3 start = m - half * direction;
    const Vec3 d = 2 * half * direction;
    const double k0 = dot(start, start) + (major_ - minor_) * (major_ + minor_);
    const double k1 = 2 * dot(start, d);
    const double k2 = dot(d, d);
    const double four_r2 = 4 * major_ * major_;
    const std::array<double, 5> c{
        k0 * k0 - four_r2 * (start.x * start.x + start.y * start.y),
        2 * k0 * k1 - 2 * four_r2 * (start.x * d.x + start.y * d.y),
        k1 * k1 + 2 * k0 * k2 - four_r2 * (d.x * d.x + d.y * d.y),
        2 * k1 * k2,
        k2 * k2,
    };
    const int found = sign_changes(bernstein_from_powers(c), t);
    int kept = 0;
    for (int i = 0; i < found; ++i) {
        const double root = t_lo + 2 * half * t[static_cast<std::size_t>(i)];
        // Squared, the equation also has (|(x, y)| + R)² + z² = r²: the lemon inside a torus with r > R.
        const Vec3 x = origin + root * direction;
        if (minor_ > major_ && dot(x, x) + (major_ - minor_) * (major_ + minor_) < 0) continue;
        t[static_cast<std::size_t>(kept++)] = root;
    }
    return kept;
}

}  // namespace pellucid
