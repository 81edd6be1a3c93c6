#include "study/trust_roots.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <mutex>
#include <numbers>

#include <boost/multiprecision/cpp_int.hpp>
#include <fmt/format.h>

#include "core/parallel.hpp"
#include "study/trust_meshes.hpp"
#include "study/trust_rays.hpp"

namespace pellucid {
namespace {

using Number = boost::multiprecision::cpp_rational;

/// A polynomial in t, constant first, no leading zeros; empty = 0.
struct Powers {
    std::vector<Number> c;

    Powers() = default;
    Powers(double constant) : c{Number(constant)} { trim(); }
    void trim() {
        while (!c.empty() && c.back() == 0) c.pop_back();
    }
    [[nodiscard]] int sign(const Number& t) const {
        Number sum = 0;
        for (std::size_t i = c.size(); i-- > 0;) sum = sum * t + c[i];
        return sum.sign();
    }
};

Powers operator+(Powers a, const Powers& b) {
    a.c.resize(std::max(a.c.size(), b.c.size()));
    for (std::size_t i = 0; i < b.c.size(); ++i) a.c[i] += b.c[i];
    a.trim();
    return a;
}
Powers operator*(const Powers& a, const Powers& b) {
    Powers p;
    if (a.c.empty() || b.c.empty()) return p;
    p.c.resize(a.c.size() + b.c.size() - 1);
    for (std::size_t i = 0; i < a.c.size(); ++i)
        for (std::size_t j = 0; j < b.c.size(); ++j) p.c[i + j] += a.c[i] * b.c[j];
    return p;
}
Powers operator-(const Powers& a, const Powers& b) {
    return a + Powers(-1.0) * b;
}

/// The surfaces once more, by hand.
Powers along(const AlgebraicSurface& s, const Powers& x, const Powers& y, const Powers& z) {
    const Powers x2 = x * x, y2 = y * y, z2 = z * z;
    const auto number = [&](const char* name) { return Powers(s.parameters.at(name)); };
    if (s.name == "Barth sextic") {
        const Powers a = number("a");
        const Powers ball = x2 + y2 + z2 - 1;
        return Powers(4) * (a * x2 - y2) * (a * y2 - z2) * (a * z2 - x2) - number("b") * ball * ball;
    }
    if (s.name == "Clebsch cubic") {
        const Powers sum = x + y + z + 1;
        return x * x2 + y * y2 + z * z2 + 1 - sum * sum * sum;
    }
    if (s.name == "Cayley cubic") return Powers(4) * (x2 + y2 + z2) + Powers(16) * x * y * z - 1;
    if (s.name == "Kummer quartic") {
        const Powers r = number("r");
        const Powers ball = x2 + y2 + z2 - number("m");
        const Powers one = 1;
        return ball * ball -
               number("l") * (one - z - r * x) * (one - z + r * x) * (one + z + r * y) * (one + z - r * y);
    }
    const Powers five = 5;  // tangle cube
    return x2 * x2 - five * x2 + y2 * y2 - five * y2 + z2 * z2 - five * z2 + number("c");
}

Powers slope(const Powers& p) {
    Powers d;
    for (std::size_t i = 1; i < p.c.size(); ++i) d.c.push_back(p.c[i] * static_cast<unsigned>(i));
    return d;
}

/// −(a mod b), made monic but for its sign: only signs count, and numbers stay short.
Powers next_in_chain(Powers a, const Powers& b) {
    while (a.c.size() >= b.c.size()) {
        const Number q = a.c.back() / b.c.back();
        const std::size_t shift = a.c.size() - b.c.size();
        for (std::size_t i = 0; i < b.c.size(); ++i) a.c[i + shift] -= q * b.c[i];
        a.c.pop_back();
        a.trim();
    }
    if (!a.c.empty()) {
        const Number size = -abs(a.c.back());
        for (Number& c : a.c) c /= size;
    }
    return a;
}

int sign_changes(const std::vector<Powers>& chain, const Number& t) {
    int changes = 0, last = 0;
    for (const Powers& p : chain) {
        const int sign = p.sign(t);
        changes += sign != 0 && last != 0 && sign != last ? 1 : 0;
        if (sign != 0) last = sign;
    }
    return changes;
}

/// The formula with its numbers in the place of their names, which are single letters.
std::string literal(const AlgebraicSurface& surface) {
    std::string text;
    for (const char letter : surface.formula) {
        const auto number = surface.parameters.find(std::string(1, letter));
        text += number == surface.parameters.end() ? std::string(1, letter)
                                                   : fmt::format("{:.17g}", number->second);
    }
    return text;
}

/// In a box that holds all of every root_line.
Surface as_surface(const AlgebraicSurface& surface) {
    Surface s;
    s.name = surface.name;
    s.shape = ExpressionShape{literal(surface)};
    s.bounds = Box{Vec3(-3 * surface.radius), Vec3(3 * surface.radius)};
    return s;
}

struct TracedSurface {
    PreparedScene scene;
    LineShooter shooter;
    explicit TracedSurface(const AlgebraicSurface& surface)
        : scene(scene_for_lines({as_surface(surface)})), shooter(scene) {}
};

}  // namespace

std::span<const AlgebraicSurface> algebraic_surfaces() {
    constexpr double kPhi = std::numbers::phi;
    constexpr double kMu2 = 1.69;  // of Kummer's surface: between 1/3 and 3, all sixteen nodes real
    static const std::vector<AlgebraicSurface> all{
        {"Barth sextic",
         "4*(a*x^2-y^2)*(a*y^2-z^2)*(a*z^2-x^2) - b*(x^2+y^2+z^2-1)^2",
         {{"a", kPhi * kPhi}, {"b", 1 + 2 * kPhi}},
         6,
         2,
         true},
        {"Clebsch cubic", "x^3 + y^3 + z^3 + 1 - (x+y+z+1)^3", {}, 3, 4, false},
        {"Cayley cubic", "4*(x^2+y^2+z^2) + 16*x*y*z - 1", {}, 3, 1.5, false},
        {"Kummer quartic",
         "(x^2+y^2+z^2-m)^2 - l*(1-z-r*x)*(1-z+r*x)*(1+z+r*y)*(1+z-r*y)",
         {{"m", kMu2}, {"l", (3 * kMu2 - 1) / (3 - kMu2)}, {"r", std::numbers::sqrt2}},
         4,
         3,
         false},
        {"tangle cube", "x^4 - 5*x^2 + y^4 - 5*y^2 + z^4 - 5*z^2 + c", {{"c", 11.8}}, 4, 4, true},
    };
    return all;
}

RootLine root_line(const AlgebraicSurface& surface, RootAim aim, Seed seed, std::uint64_t number) {
    const Vec3 direction = random_direction(seed, number);
    const double reach = 2 * surface.radius;
    if (aim == RootAim::center) return {Vec3(0.0), direction, -reach, reach};
    const auto [u, v, unused] = random_numbers(seed, number);
    const Frame frame = frame_around(direction);
    const double r = surface.radius * std::sqrt(u);
    const double angle = 2 * std::numbers::pi * v;
    const Vec3 point = r * (std::cos(angle) * frame.aside + std::sin(angle) * frame.up);
    return {point - reach * direction, direction, 0, 2 * reach};
}

std::vector<RootLine> lines_on_clebsch() {
    // With w = 1 and v = −(x+y+z+1) it is Σ of five cubes = 0 where their bases sum to 0: on it lies every
    // line where one of the five is 0 and the others cancel in pairs. Where w is the 0, it lies at infinity.
    std::vector<RootLine> lines;
    const auto add = [&](const Vec3& origin, const Vec3& direction) {
        lines.push_back({origin, direction, -5, 5});
    };
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3;
        const int k = (i + 2) % 3;
        Vec3 e_i(0.0), e_j(0.0), e_k(0.0);
        e_i[i] = e_j[j] = e_k[k] = 1;
        // v = 0: one of x, y, z cancels w, the other two each other.
        add(-e_i, e_j - e_k);
        // x_i = 0: w cancels x_j, x_k or v.
        add(-e_j, e_k);             // x_k + v = 0
        add(-e_k, e_j);             // x_j + v = 0
        add(Vec3(0.0), e_j - e_k);  // v = −1
    }
    return lines;
}

ExactCount exact_count(const AlgebraicSurface& surface, const RootLine& line) {
    std::array<Powers, 3> x;
    for (int k = 0; k < 3; ++k) {
        Powers& coordinate = x[static_cast<std::size_t>(k)];
        coordinate.c = {Number(line.origin[k]), Number(line.direction[k])};
        coordinate.trim();
    }
    const Powers p = along(surface, x[0], x[1], x[2]);
    if (p.c.empty()) return {-1, false};
    const Number lo(line.lo), hi(line.hi);
    std::vector<Powers> chain{p, slope(p)};
    while (!chain.back().c.empty()) chain.push_back(next_in_chain(chain[chain.size() - 2], chain.back()));
    return {sign_changes(chain, lo) - sign_changes(chain, hi), (p.sign(lo) >= 0) != (p.sign(hi) >= 0)};
}

FindRoots certified_roots(const AlgebraicSurface& surface) {
    const RootIsolator isolator(Expression(surface.formula, surface.parameters));
    return [isolator](const RootLine& line, std::vector<Root>& roots, IsolationStats& stats) {
        isolator.isolate(line.origin, line.direction, line.lo, line.hi, roots, stats);
    };
}

FindRoots traced_roots(const AlgebraicSurface& surface) {
    const auto traced = std::make_shared<const TracedSurface>(surface);
    return [traced](const RootLine& line, std::vector<Root>& roots, IsolationStats&) {
        const double middle = 0.5 * (line.lo + line.hi);
        const Ray ray = traced->shooter.through(line.origin + middle * line.direction, line.direction);
        std::vector<std::vector<RayHit>> hits;
        traced->shooter.gather({&ray, 1}, hits);
        for (const RayHit& hit : hits[0]) {
            const double t = dot(ray.origin + hit.t * ray.direction - line.origin, line.direction);
            if (t > line.lo && t <= line.hi) roots.push_back({t, false});
        }
    };
}

FindRoots sampled_roots(const AlgebraicSurface& surface, int points) {
    const Expression f(surface.formula, surface.parameters);
    return [f, points](const RootLine& line, std::vector<Root>& roots, IsolationStats&) {
        const double step = (line.hi - line.lo) / points;
        bool last = f.at(line.origin + line.lo * line.direction) >= 0;
        for (int i = 1; i <= points; ++i) {
            const bool now = f.at(line.origin + (line.lo + i * step) * line.direction) >= 0;
            if (now != last) roots.push_back({line.lo + (i - 0.5) * step, false});
            last = now;
        }
    };
}

RootCounts count_roots(const AlgebraicSurface& surface, const FindRoots& find, RootAim aim,
                       std::uint64_t lines, std::uint64_t checked, Seed seed) {
    RootCounts total;
    std::mutex adding;
    parallel_for(lines, 64, [&](std::size_t begin, std::size_t end) {
        RootCounts count;
        std::vector<Root> roots;
        for (std::size_t i = begin; i < end; ++i) {
            const RootLine line = root_line(surface, aim, seed, i);
            roots.clear();
            find(line, roots, count.stats);
            ++count.lines;
            count.roots += roots.size();
            ++count.lines_with[std::min<std::size_t>(roots.size(), kMostDegree)];
            if (roots.size() > static_cast<std::size_t>(surface.degree)) ++count.above_degree;
            if (surface.even && aim == RootAim::center) {
                bool pairs = roots.size() % 2 == 0;
                for (std::size_t k = 0; pairs && k < roots.size(); ++k)
                    pairs = std::abs(roots[k].t + roots[roots.size() - 1 - k].t) <=
                            kPairShare * (line.hi - line.lo);
                if (!pairs) ++count.asymmetric;
            }
            if (i * checked / lines == (i + 1) * checked / lines) continue;
            const ExactCount exact = exact_count(surface, line);
            ++count.checked;
            if (static_cast<int>(roots.size()) != exact.roots) ++count.mismatched;
            const auto crossings =
                std::ranges::count_if(roots, [](const Root& root) { return !root.touching; });
            if ((crossings % 2 == 1) != exact.signs_differ) ++count.wrong_parity;
        }
        const std::scoped_lock lock(adding);
        total.lines += count.lines;
        total.roots += count.roots;
        for (std::size_t k = 0; k < count.lines_with.size(); ++k) total.lines_with[k] += count.lines_with[k];
        total.above_degree += count.above_degree;
        total.asymmetric += count.asymmetric;
        total.stats += count.stats;
        total.checked += count.checked;
        total.mismatched += count.mismatched;
        total.wrong_parity += count.wrong_parity;
    });
    return total;
}

}  // namespace pellucid
