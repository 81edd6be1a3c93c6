// Local fits of MPU implicits: one quadric, or two or three that meet in an edge or corner, through a few oriented points.
// Y. Ohtake, A. Belyaev, M. Alexa, G. Turk, H.-P. Seidel, Multi-level partition of unity implicits, SIGGRAPH 2003, sec. 4.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/vec.hpp"

namespace pellucid {

/// c0 + c1 x + c2 y + c3 z + c4 xx + c5 yy + c6 zz + c7 xy + c8 xz + c9 yz.
struct Quadric {
    std::array<double, 10> c{};

    [[nodiscard]] double value(const Vec3& u) const {
        return c[0] + u.x * (c[1] + c[4] * u.x + c[7] * u.y + c[8] * u.z) + u.y * (c[2] + c[5] * u.y + c[9] * u.z) +
               u.z * (c[3] + c[6] * u.z);
    }
    [[nodiscard]] Vec3 gradient(const Vec3& u) const {
        return {c[1] + 2 * c[4] * u.x + c[7] * u.y + c[8] * u.z, c[2] + 2 * c[5] * u.y + c[7] * u.x + c[9] * u.z,
                c[3] + 2 * c[6] * u.z + c[8] * u.x + c[9] * u.y};
    }
    /// u ↦ q(offset + scale·u).
    [[nodiscard]] Quadric seen_from(const Vec3& offset, double scale) const;
};

/// How pieces make one function: edges are the larger (convex) or smaller (concave) of two, corners of three; where
/// edges of both kinds meet, a corner is the larger of the last and the smaller of the first two, or the other way round.
enum class Join : std::uint32_t { one, max2, min2, max3, min3, max_min, min_max };
[[nodiscard]] constexpr std::size_t piece_count(Join join) {
    return join == Join::one ? 1 : join == Join::max2 || join == Join::min2 ? 2 : 3;
}
/// The piece that decides, from the values of all.
[[nodiscard]] std::size_t deciding_piece(Join join, const std::array<double, 3>& value);

/// In coordinates of the cell: its centre is 0 and its edge 1.
struct LocalPoint {
    Vec3 at;
    Vec3 normal;  // unit
};

struct LocalFit {
    Join join = Join::one;
    std::array<Quadric, 3> pieces;
    double error = 0;   // largest |q|/|∇q| at the points in the cell's own ball; infinite where no fit is to be trusted
};

struct LocalFitOptions {
    double radius = 1;       // of the ball that holds the points; their weights fall to 0 there
    double own_radius = 1;   // of the ball whose points are judged
    std::size_t few = 30;    // up to so many points edges and corners are looked for
    bool sharp = true;
    double good_enough = 0;  // an error below which no edge is looked for
};

/// Signed like a distance, negative inside. `points`: at least one.
[[nodiscard]] LocalFit fit_locally(std::span<const LocalPoint> points, const LocalFitOptions& options);

}  // namespace pellucid
