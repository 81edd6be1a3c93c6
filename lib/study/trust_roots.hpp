// Algebraic surfaces of known counts: how many roots a line has, by certified isolation and by Sturm's
// theorem.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/random.hpp"
#include "core/vec.hpp"
#include "field/root_isolation.hpp"

namespace pellucid {

/// The numbers in the formulas are doubles given as parameters: no constant is rounded on the way to the
/// polynomial.
struct AlgebraicSurface {
    std::string_view name;
    std::string_view formula;
    std::map<std::string, double> parameters;
    int degree;     // Bézout: no line has more roots, but those that lie on it
    double radius;  // of a sphere around what is worth a look
    bool even;      // f(−x) = f(x): the roots of a line through the origin come in pairs ±t
};
/// Barth sextic, Clebsch and Cayley cubic, Kummer quartic, tangle cube.
[[nodiscard]] std::span<const AlgebraicSurface> algebraic_surfaces();

/// A line from lo to hi.
struct RootLine {
    Vec3 origin, direction;
    double lo, hi;
};
enum class RootAim { random, center };
/// random: uniform among the lines that meet the sphere; center: through the origin, lo = −hi.
[[nodiscard]] RootLine root_line(const AlgebraicSurface& surface, RootAim aim, Seed seed,
                                 std::uint64_t number);
/// Those of the 27 lines on the Clebsch cubic that are rational and not at infinity: twelve.
[[nodiscard]] std::vector<RootLine> lines_on_clebsch();

/// What exact arithmetic says of a line: distinct roots in (lo, hi] by Sturm's theorem, or −1 where f = 0 all
/// along; and whether the signs at the ends differ (a value of zero counts as positive). Written anew, not by
/// Expression.
struct ExactCount {
    int roots = 0;
    bool signs_differ = false;
};
[[nodiscard]] ExactCount exact_count(const AlgebraicSurface& surface, const RootLine& line);

using FindRoots = std::function<void(const RootLine&, std::vector<Root>&, IsolationStats&)>;
[[nodiscard]] FindRoots certified_roots(const AlgebraicSurface& surface);
/// The same by the truth: all hits of the ray with the formula as a surface of a scene.
[[nodiscard]] FindRoots traced_roots(const AlgebraicSurface& surface);
/// Wrong twin: changes of sign between `points` equal steps.
[[nodiscard]] FindRoots sampled_roots(const AlgebraicSurface& surface, int points);

inline constexpr int kMostDegree = 6;
struct RootCounts {
    std::uint64_t lines = 0;
    std::uint64_t roots = 0;
    std::array<std::uint64_t, kMostDegree + 1> lines_with{};  // this many roots
    std::uint64_t above_degree = 0;
    std::uint64_t asymmetric = 0;  // lines through the centre of an even surface whose roots are no pairs
    IsolationStats stats;
    std::uint64_t checked = 0;     // lines compared with exact arithmetic
    std::uint64_t mismatched = 0;  // another number of distinct roots
    std::uint64_t wrong_parity =
        0;  // changes of sign odd where the signs at the ends agree, or even where not
};
/// Roots ±t are a pair where they differ by at most this share of the interval: each lies within 1e-11 of it
/// (kMostDoubt, lib/field/line_polynomial.cpp).
inline constexpr double kPairShare = 2e-11;
[[nodiscard]] RootCounts count_roots(const AlgebraicSurface& surface, const FindRoots& find, RootAim aim,
                                     std::uint64_t lines, std::uint64_t checked, Seed seed);

}  // namespace pellucid
