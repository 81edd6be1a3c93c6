// MPU fields on a line: each local fit is a quadratic there, and its weight a function of the distance along it.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/interval.hpp"
#include "field/mpu.hpp"

namespace pellucid {

/// f along origin + t·direction, from the leaves of a list. What a leaf adds at t depends on line, leaf and t alone: lists
/// that differ in leaves which do not reach t give the same bits.
class MpuLine {
public:
    /// Object space; for t in [lo, hi] alone.
    void set(const MpuField& field, std::span<const std::uint32_t> leaves, const Vec3& origin, const Vec3& direction,
             double lo, double hi);

    struct Slope {
        double value = 0;
        double slope = 0;
    };
    /// f/size(): only its sign and zeros count.
    [[nodiscard]] double value(double t) const;
    [[nodiscard]] Slope value_and_slope(double t) const;
    struct Range {
        Interval value, slope;
    };
    /// Sure but for rounding; [lo, hi] where leaves of the list are all that reach.
    [[nodiscard]] Range range(double lo, double hi) const;

private:
    struct Piece {
        double a0, a1, a2;  // of t − middle
    };
    struct Part {
        double middle;      // t nearest to the leaf's centre
        double near2, per2; // |u|² = near2 + per2·(t − middle)²
        Join join;
        std::array<Piece, 3> pieces;
    };
    std::vector<Part> parts_;
};

/// ∇f at a place, object space, from the leaves of a list.
[[nodiscard]] Vec3 mpu_gradient(const MpuField& field, std::span<const std::uint32_t> leaves, const Vec3& place);

}  // namespace pellucid
