// The surface f = 0 in cells: what the line sampler and the truth ask of a field that has no closed form.
//   formulas     cells of an octree       field/field_cells.hpp
//   volumes      cells of the grid        field/catmull_rom.hpp
//   points       cells of an octree       field/mpu_cells.hpp
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/interval.hpp"
#include "core/vec.hpp"
#include "field/isolation_stats.hpp"

namespace pellucid {

class Expression;

/// A root on a line. The gradient there, or where it vanishes beside it: its direction is the normal's.
struct FieldRoot {
    double t;
    Vec3 gradient;
};

/// One cell, object space. Cells do not overlap but in faces.
struct SurfaceCell {
    bool continuous = false;  // f is, all over the cell; otherwise gradients say nothing
    std::array<Interval, 3> gradient;  // contains ∇f, all over `tight`
    Box tight;                         // holds all of the surface that is the cell's

    /// Whether f is strictly monotone along an axis.
    [[nodiscard]] bool monotone(std::size_t axis) const {
        return continuous && !gradient[axis].has_zero() && !gradient[axis].empty();
    }
};

/// Lines along an axis, one a cell that is monotone along it (a cell may come more than once): structure of arrays.
struct AxisLines {
    std::size_t axis = 0;
    std::size_t count = 0;
    const std::uint32_t* cell = nullptr;
    std::array<const double*, 3> at{};  // coordinates; that of the axis itself is not set
    const double* lo = nullptr;         // along the axis, within the cell
    const double* hi = nullptr;
};
/// Their roots: NaN where there is none; f < 0 on one side only, a value of zero counts as positive.
struct AxisRoots {
    double* root = nullptr;
    std::array<double*, 3> gradient{};
};

/// Safe from several threads.
class SurfaceCells {
public:
    /// Above most_roots(): nothing is known.
    static constexpr int kMostRoots = 8;

    virtual ~SurfaceCells() = default;
    [[nodiscard]] virtual std::size_t count() const = 0;
    [[nodiscard]] virtual SurfaceCell cell(std::size_t index) const = 0;
    /// Holds cell(index).tight, and costs nothing.
    [[nodiscard]] virtual Box box(std::size_t index) const { return cell(index).tight; }
    /// True where f surely has no root in a box.
    [[nodiscard]] virtual bool excludes(const Box& box) const = 0;
    /// Appends the roots in one cell with t in [t_lo, t_hi], ascending. Of the cells along a line each root is in one.
    virtual void cross(std::size_t index, const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
                       std::vector<FieldRoot>& roots, IsolationStats& stats) const = 0;
    /// Most roots of a line along an axis through a cell; where nothing is known (or more) kMostRoots.
    [[nodiscard]] virtual int most_roots(std::size_t index, int axis) const = 0;
    /// Many lines at once, in SIMD where it pays: the roots of `cross` but for rounding. What is found on a line does not
    /// depend on the others to the last bit.
    virtual void cross_along(const AxisLines& lines, const AxisRoots& out) const;
    /// The formula, where the cells are a formula's; else null.
    [[nodiscard]] virtual const Expression* formula() const { return nullptr; }
    [[nodiscard]] virtual std::size_t bytes() const = 0;
};

}  // namespace pellucid
