// The surface f = 0 in a box as cells of an octree: what sampler and truth share of a formula.
//
// Intervals throw away cells without a zero, bound the gradient in those that stay, and shrink them to a box around
// their part of the surface. Where a component of the gradient keeps its sign, a line along that axis crosses the surface at most once, and two values of f tell whether: certain
// for two evaluations. Cells are cut until that holds along one axis and the gradient's direction varies little, or
// until what is left of the surface is not worth it.
//
// Every decision on signs in cells is that of `run_program<Real>`, at places that neighbouring cells share to the last
// bit; cells are thrown away only where |f| is above its rounding. So a line's crossings in all cells together are
// those of one sequence of signs: none is lost or doubled at a face. Through an edge or corner of cells the sequence
// may show rounding as three changes for one; the truth drops such repeats (reference/ray_scene.cpp).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "field/expression.hpp"
#include "field/root_isolation.hpp"
#include "field/surface_cells.hpp"

namespace pellucid {

/// `tight` is in the octree's cell; outside of it, in the cell, f keeps its sign, so what is monotone there has one root
/// at most on all of a line's way through the cell.
struct FieldCell : SurfaceCell {
    std::array<std::uint32_t, 3> base{};    // of 2^FieldCells::kDepth along each axis
    std::array<std::uint32_t, 3> extent{};  // powers of two: long sides of the bounds are halved more often
};

struct FieldCellLimits {
    std::size_t wanted = 1 << 13;  // all cells are cut until there are so many …
    std::size_t most = 1 << 18;    // … and none when there are so many
};

class FieldCells final : public SurfaceCells {
public:
    static constexpr int kDepth = 30;
    static constexpr std::uint32_t kPlanes = 1U << kDepth;
    using Limits = FieldCellLimits;

    /// `bounds` has a volume. Fewer cells where the formula is long, so that the work is bounded.
    FieldCells(Expression f, const Box& bounds, const Limits& limits = {});

    [[nodiscard]] const Expression& field() const { return field_; }
    [[nodiscard]] const Box& bounds() const { return bounds_; }
    [[nodiscard]] std::span<const FieldCell> cells() const { return cells_; }
    /// Place of plane i of 0 … kPlanes along an axis: the same for all cells that touch it.
    [[nodiscard]] double plane(int axis, std::uint32_t i) const;
    [[nodiscard]] Box box(const FieldCell& cell) const;

    /// True where f surely has no root in a box.
    [[nodiscard]] bool excludes(const Box& box) const override;

    /// Roots in one cell with t in [t_lo, t_hi], ascending. Of the cells along a line each root is in one: a cell has
    /// those at which the sign changes between the places where the line enters and leaves it.
    void cross(const FieldCell& cell, const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
               std::vector<FieldRoot>& roots, IsolationStats& stats) const;

    /// Most roots of a line along an axis through a cell, from degree and intervals; where these say nothing (or
    /// more) kMostRoots.
    [[nodiscard]] int most_roots(const FieldCell& cell, int axis) const;

    [[nodiscard]] std::size_t count() const override { return cells_.size(); }
    [[nodiscard]] SurfaceCell cell(std::size_t index) const override { return cells_[index]; }
    void cross(std::size_t index, const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
               std::vector<FieldRoot>& roots, IsolationStats& stats) const override {
        cross(cells_[index], origin, direction, t_lo, t_hi, roots, stats);
    }
    [[nodiscard]] int most_roots(std::size_t index, int axis) const override { return most_roots(cells_[index], axis); }
    [[nodiscard]] const Expression* formula() const override { return &field_; }
    [[nodiscard]] std::size_t bytes() const override { return cells_.capacity() * sizeof(FieldCell); }

private:
    struct Builder;
    [[nodiscard]] Vec3 gradient_near(const Vec3& x, const Vec3& aside) const;
    [[nodiscard]] FieldRoot refine(const Vec3& origin, const Vec3& direction, double lo, double hi, double f_lo,
                                   double f_hi) const;

    Expression field_;
    RootIsolator isolator_;
    Box bounds_;
    std::vector<FieldCell> cells_;
};

}  // namespace pellucid
