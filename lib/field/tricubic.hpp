// A polynomial of degree 3 along each axis on a box, by its Bernstein control points: between the least and
// the largest of them lie all its values (G. Farin, Curves and Surfaces for CAGD, 2002, chapter 6).
#pragma once

#include <array>

#include "core/interval.hpp"
#include "core/vec.hpp"
#include "field/volume_field.hpp"

namespace pellucid {

struct Tricubic {
    std::array<double, 64> b{};  // x fastest
    double rounding = 0;         // no control point is further off

    /// The interpolant in a cell, less the isovalue. Not a number where a sample is not, or is infinite.
    [[nodiscard]] static Tricubic in_cell(const VolumeField::Samples& samples, double isovalue);
    /// The same polynomial on a part of its box, given in shares of it.
    [[nodiscard]] Tricubic part(const Vec3& lo, const Vec3& hi) const;
    /// Contains all values on the box.
    [[nodiscard]] Interval range() const;
    /// Contains all first (second) derivatives along an axis, per width of the box.
    [[nodiscard]] Interval slope(int axis) const;
    [[nodiscard]] Interval bend(int axis) const;
    /// A box, in shares, that holds all zeros; empty where there is none. Outside of it the sign does not
    /// change. Bézier clipping (T. W. Sederberg, T. Nishita, Curve intersection using Bézier clipping, 1990).
    [[nodiscard]] Box zeros() const;
};

}  // namespace pellucid
