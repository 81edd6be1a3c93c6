// Standard forms, as E. W. Weisstein's MathWorld lists most of them; where another source was needed it is named.
// tests/catalogue_test.cpp holds each to what is known of it: nodes, lines, symmetries, a parametrisation.
#include "field/catalogue_formulas.hpp"

#include <cmath>
#include <numbers>
#include <string>

#include <fmt/format.h>

namespace pellucid {
namespace {

using Parameters = std::vector<CatalogueEntry::Parameter>;

CatalogueEntry formula(std::string_view name, std::string_view equation, Parameters parameters, std::string_view bounds,
                       std::array<std::string_view, 6> box) {
    return {name, equation, std::move(parameters), bounds, box};
}

/// level − Σ radius²/|x − x_j|², x_j the 60 vertices of a truncated icosahedron on the sphere of that radius: even
/// permutations of (0, ±1, ±3φ), (±1, ±(2 + φ), ±2φ), (±φ, ±2, ±(2φ + 1)), over √(9φ + 10).
const std::string& bucky_ball_equation() {
    static const std::string equation = [] {
        using std::numbers::phi;
        const double size = std::sqrt(9 * phi + 10);
        const std::array<std::array<double, 3>, 3> kinds{{{0, 1, 3 * phi}, {1, 2 + phi, 2 * phi}, {phi, 2, 2 * phi + 1}}};
        std::string sum = "level";
        for (const auto& kind : kinds)
            for (unsigned signs = 0; signs < 8; ++signs) {
                if (kind[0] == 0 && (signs & 1U) != 0) continue;
                for (std::size_t turn = 0; turn < 3; ++turn) {
                    sum += " - radius^2/(";
                    for (std::size_t axis = 0; axis < 3; ++axis) {
                        const std::size_t from = (axis + turn) % 3;
                        const double at = kind[from] / size;
                        const char* plus = axis == 0 ? "" : " + ";
                        if (at == 0)
                            sum += fmt::format("{}{}^2", plus, "xyz"[axis]);
                        else
                            sum += fmt::format("{}({} {} {:.17g}*radius)^2", plus, "xyz"[axis],
                                               (signs >> from & 1U) != 0 ? '+' : '-', at);
                    }
                    sum += ")";
                }
            }
        return sum;
    }();
    return equation;
}

std::vector<CatalogueEntry> entries() {
    using std::numbers::sqrt3;
    return {
        // 65 nodes, the most of any sextic: 50 here, 15 at infinity. Icosahedral (W. Barth, J. Algebraic Geom. 5, 1996).
        formula("barth_sextic",
                "4*((3 + sqrt(5))/2*x^2 - y^2)*((3 + sqrt(5))/2*y^2 - z^2)*((3 + sqrt(5))/2*z^2 - x^2)"
                " - (2 + sqrt(5))*radius^2*(x^2 + y^2 + z^2 - radius^2)^2",
                {{"radius", 1}}, "[-2 radius, 2 radius]^3",
                {"-2*radius", "-2*radius", "-2*radius", "2*radius", "2*radius", "2*radius"}),
        // All 27 lines are real and none lies at infinity. 3-fold about (1, 1, 1).
        formula("clebsch",
                "81*(x^3 + y^3 + z^3) - 189*(x^2*(y + z) + y^2*(x + z) + z^2*(x + y)) + 54*x*y*z"
                " + 126*(x*y + y*z + z*x) - 9*(x^2 + y^2 + z^2) - 9*(x + y + z) + 1",
                {}, "[-1, 1]^3", {"-1", "-1", "-1", "1", "1", "1"}),
        // 4 nodes, at every other corner of the cube; 9 lines. Tetrahedral.
        formula("cayley", "x^2 + y^2 + z^2 - 2*x*y*z - 1", {}, "[-1.6, 1.6]^3",
                {"-1.6", "-1.6", "-1.6", "1.6", "1.6", "1.6"}),
        // 16 nodes for 1 < mu < sqrt(3); at 1 it is Steiner's surface, at sqrt(3) four planes.
        formula("kummer",
                "(x^2 + y^2 + z^2 - mu^2)^2"
                " - (3*mu^2 - 1)/(3 - mu^2)*((1 - z)^2 - 2*x^2)*((1 + z)^2 - 2*y^2)",
                {{"mu", 1.3, 1, sqrt3}}, "[-2.5, 2.5]^3", {"-2.5", "-2.5", "-2.5", "2.5", "2.5", "2.5"}),
        // The Roman surface: a projective plane, three double segments, a triple point. Tetrahedral.
        formula("steiner", "x^2*y^2 + y^2*z^2 + z^2*x^2 - radius*x*y*z", {{"radius", 2}}, "[-radius/2, radius/2]^3",
                {"-radius/2", "-radius/2", "-radius/2", "radius/2", "radius/2", "radius/2"}),
        formula("cross_cap", "4*x^2*(x^2 + y^2 + z^2 + z) + y^2*(y^2 + z^2 - 1)", {}, "|x| <= 0.6, |y|, |z| <= 1",
                {"-0.6", "-1", "-1", "0.6", "1", "1"}),
        // A projective plane without pinch points (F. Apery, Models of the Real Projective Plane, 1987).
        formula("boy",
                "48*(1 - z)^2*z^2*(3*x^2 + 3*y^2 + 2*z^2) - 64*(1 - z)^3*z^3"
                " - 12*(1 - z)*z*(27*(x^2 + y^2)^2 - 24*z^2*(x^2 + y^2) + 36*sqrt(2)*y*z*(y^2 - 3*x^2) + 4*z^4)"
                " - (9*x^2 + 9*y^2 - 2*z^2)"
                "*(-81*(x^2 + y^2)^2 - 72*z^2*(x^2 + y^2) + 108*sqrt(2)*x*z*(x^2 - 3*y^2) + 4*z^4)",
                {}, "|x|, |y| <= 1.5, 0 <= z <= 2", {"-1.5", "-1.5", "0", "1.5", "1.5", "2"}),
        // I. Stewart's sextic.
        formula("klein_bottle",
                "(x^2 + y^2 + z^2 + 2*y - 1)*((x^2 + y^2 + z^2 - 2*y - 1)^2 - 8*z^2)"
                " + 16*x*z*(x^2 + y^2 + z^2 - 2*y - 1)",
                {}, "[-4, 4]^3", {"-4", "-4", "-4", "4", "4", "4"}),
        // At each height an oval of Cassini with foci at x = +-a.
        formula("cassini", "((x - a)^2 + y^2)*((x + a)^2 + y^2) - z^4", {{"a", 0.5}},
                "[-2 a, 2 a]^3", {"-2*a", "-2*a", "-2*a", "2*a", "2*a", "2*a"}),
        // One oval of Cassini turned about the axis of its foci: a peanut for b > a, two drops for b < a.
        formula("cassini_oval", "(x^2 + y^2 + z^2 + a^2)^2 - 4*a^2*z^2 - b^4", {{"a", 1}, {"b", 1.05}}, "|x|, |y| <= min(b, b^2/(2 a)), z tight",
                {"-min(b, b^2/(2*a))", "-min(b, b^2/(2*a))", "-sqrt(a^2 + b^2)", "min(b, b^2/(2*a))",
                 "min(b, b^2/(2*a))", "sqrt(a^2 + b^2)"}),
        // Envelope of spheres of radius d - c cos t about the ellipse (a cos t, b sin t, 0), a^2 = b^2 + c^2.
        formula("dupin_cyclide",
                "(x^2 + y^2 + z^2 + b^2 - d^2)^2 - 4*(sqrt(b^2 + c^2)*x - c*d)^2 - 4*b^2*y^2",
                {{"b", 0.95}, {"c", 0.3}, {"d", 0.5}}, "tight",
                {"-sqrt(b^2 + c^2) - c - d", "-sqrt(b^2 + c^2) - d", "-c - d", "sqrt(b^2 + c^2) + abs(c - d)",
                 "sqrt(b^2 + c^2) + d", "c + d"}),
        formula("tangle", "x^4 + y^4 + z^4 - 5*(x^2 + y^2 + z^2) + 11.8", {}, "[-2.4, 2.4]^3",
                {"-2.4", "-2.4", "-2.4", "2.4", "2.4", "2.4"}),
        // Octahedral. Bounded for a > -1/3.
        formula("goursat", "x^4 + y^4 + z^4 + a*(x^2 + y^2 + z^2)^2 + b*(x^2 + y^2 + z^2) + c",
                {{"a", -0.27, -kInfinity}, {"b", -0.5, -kInfinity}, {"c", -1, -kInfinity}}, "[-2, 2]^3",
                {"-2", "-2", "-2", "2", "2", "2"}),
        // G. Taubin's.
        formula("heart", "(x^2 + 9/4*y^2 + z^2 - 1)^3 - x^2*z^3 - 9/80*y^2*z^3", {}, "[-1.3, 1.3]^3",
                {"-1.3", "-1.3", "-1.3", "1.3", "1.3", "1.3"}),
        // T(x) + T(y) + T(z) with Chebyshev's polynomial of degree 6 (T. Banchoff, S. Chmutov).
        formula("chmutov", "32*(x^6 + y^6 + z^6) - 48*(x^4 + y^4 + z^4) + 18*(x^2 + y^2 + z^2) - 3", {},
                "[-1.1, 1.1]^3", {"-1.1", "-1.1", "-1.1", "1.1", "1.1", "1.1"}),
        // Tetrahedral.
        formula("chair",
                "(x^2 + y^2 + z^2 - a*k^2)^2 - b*((z - k)^2 - 2*x^2)*((z + k)^2 - 2*y^2)",
                {{"a", 0.95}, {"b", 0.8}, {"k", 1}}, "[-1.5 k, 1.5 k]^3",
                {"-1.5*k", "-1.5*k", "-1.5*k", "1.5*k", "1.5*k", "1.5*k"}),
        // The bicorn (cocked hat) turned about its axis; its rim is a cusp.
        formula("bicorn", "(x^2 + y^2 + 2*a*z - a^2)^2 - z^2*(a^2 - x^2 - y^2)", {{"a", 1}}, "tight",
                {"-a", "-a", "0", "a", "a", "a"}),
        // Cuspidal where the two brackets vanish together.
        formula("hunt", "4*(x^2 + y^2 + z^2 - 13)^3 + 27*(3*x^2 + y^2 - 4*z^2 - 12)^2", {}, "[-3.7, 3.7]^3",
                {"-3.7", "-3.7", "-3.7", "3.7", "3.7", "3.7"}),
        formula("miter", "4*x^2*(x^2 + y^2 + z^2) - y^2*(1 - y^2 - z^2)", {}, "|x| <= 0.4, |y|, |z| <= 1",
                {"-0.4", "-1", "-1", "0.4", "1", "1"}),
        // Its handle, the axis below 0, is a line and not drawn.
        formula("whitney_umbrella", "x^2 - y^2*z", {}, "|x|, |y| <= 1, 0 <= z <= 1",
                {"-1", "-1", "0", "1", "1", "1"}),
        // Four blobs at every other corner of a cube of half-edge distance, each exp(-r^2/radius^2), where their sum is the
        // threshold (J. F. Blinn, A generalization of algebraic surface drawing, 1982). Negative inside. Tetrahedral. The box:
        // beyond radius*sqrt(log(4/threshold)) of the outermost centre, the four together are less.
        formula("metaballs",
                "threshold - exp(-((x - distance)^2 + (y - distance)^2 + (z - distance)^2)/radius^2)"
                " - exp(-((x - distance)^2 + (y + distance)^2 + (z + distance)^2)/radius^2)"
                " - exp(-((x + distance)^2 + (y - distance)^2 + (z + distance)^2)/radius^2)"
                " - exp(-((x + distance)^2 + (y + distance)^2 + (z - distance)^2)/radius^2)",
                {{"distance", 0.5}, {"radius", 0.6}, {"threshold", 0.5, 0, 4}},
                "[-h, h]^3, h = distance + radius sqrt(log(4/threshold))",
                {"-distance - radius*sqrt(log(4/threshold))", "-distance - radius*sqrt(log(4/threshold))",
                 "-distance - radius*sqrt(log(4/threshold))", "distance + radius*sqrt(log(4/threshold))",
                 "distance + radius*sqrt(log(4/threshold))", "distance + radius*sqrt(log(4/threshold))"}),
        // Harbinson et al. 2008, (1): 60 equal charges at the atoms of C60. Negative inside, with a pole at every charge.
        // Hollow, with a hole in every face, for levels from 81.3 to 98.9; below 73 a closed shell. Beyond the box the
        // charges, each at least radius*sqrt(60/level) away, give less. Icosahedral.
        {"bucky_ball", "level - sum_j radius^2/((x - x_j)^2 + (y - y_j)^2 + (z - z_j)^2)",
         {{"radius", 1}, {"level", 90}},
         "[-h, h]^3, h = 1.25 radius; (x_j, y_j, z_j): 60 vertices of a truncated icosahedron",
         {"-1.25*radius", "-1.25*radius", "-1.25*radius",
          "1.25*radius", "1.25*radius", "1.25*radius"},
         bucky_ball_equation()},
        // The three minimal surfaces' level sets, one period of each.
        formula("gyroid",
                "sin(2*pi/period*x)*cos(2*pi/period*y) + sin(2*pi/period*y)*cos(2*pi/period*z)"
                " + sin(2*pi/period*z)*cos(2*pi/period*x)",
                {{"period", 1}}, "[-period/2, period/2]^3",
                {"-period/2", "-period/2", "-period/2", "period/2", "period/2", "period/2"}),
        formula("schwarz_p", "cos(2*pi/period*x) + cos(2*pi/period*y) + cos(2*pi/period*z)", {{"period", 1}},
                "[-period/2, period/2]^3", {"-period/2", "-period/2", "-period/2", "period/2", "period/2", "period/2"}),
        formula("schwarz_d",
                "sin(2*pi/period*x)*sin(2*pi/period*y)*sin(2*pi/period*z)"
                " + sin(2*pi/period*x)*cos(2*pi/period*y)*cos(2*pi/period*z)"
                " + cos(2*pi/period*x)*sin(2*pi/period*y)*cos(2*pi/period*z)"
                " + cos(2*pi/period*x)*cos(2*pi/period*y)*sin(2*pi/period*z)",
                {{"period", 1}}, "[-period/2, period/2]^3",
                {"-period/2", "-period/2", "-period/2", "period/2", "period/2", "period/2"}),
    };
}

}  // namespace

std::span<const CatalogueEntry> catalogue_formulas() {
    static const std::vector<CatalogueEntry> all = entries();
    return all;
}

}  // namespace pellucid
