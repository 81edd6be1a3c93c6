// The isosurface of a Catmull-Rom volume in cells of the grid and parts of them: what sampler and truth share
// of it.
//
// Control points throw away cells without a zero, shrink those that stay to a box around their part of the
// surface and bound the gradient there. Cells in which lines along no one axis suit are cut into octants, up
// to twice, where that makes lines much fewer. Eight bytes a cell are kept, all else is found again when it
// is asked for.
//
// Along a line the field is a polynomial of degree 9 in each cell. Which cell a root belongs to is decided by
// signs of the field where the line crosses a face: there the coordinate across is put on the face exactly,
// the weights of Catmull-Rom are exactly 0 and 1, and both cells sum the same products. So the crossings of a
// line in all cells are those of one sequence of signs: none is lost or doubled. A sample equal to the
// isovalue counts as above it.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "field/iso_field.hpp"
#include "field/surface_cells.hpp"
#include "field/tricubic.hpp"

namespace pellucid {

class CatmullRomCells final : public SurfaceCells {
public:
    /// Throws Error(input) where an axis has more than 2^18 samples. Precondition: the volume is Catmull-Rom.
    CatmullRomCells(std::shared_ptr<const VolumeField> volume, double isovalue);

    [[nodiscard]] const IsoField& field() const { return field_; }
    /// Cells of the grid that are empty because a sample around them is NaN or infinite.
    [[nodiscard]] std::size_t lost() const { return lost_; }

    [[nodiscard]] std::size_t count() const override { return cells_.size(); }
    [[nodiscard]] SurfaceCell cell(std::size_t index) const override;
    [[nodiscard]] Box box(std::size_t index) const override;
    [[nodiscard]] bool excludes(const Box& box) const override { return field_.excludes(box); }
    void cross(std::size_t index, const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
               std::vector<FieldRoot>& roots, IsolationStats& stats) const override;
    [[nodiscard]] int most_roots(std::size_t index, int axis) const override;
    void cross_along(const AxisLines& lines, const AxisRoots& out) const override;
    [[nodiscard]] std::size_t bytes() const override {
        return cells_.capacity() * sizeof(cells_[0]) + field_.bytes() + field_.volume().bytes();
    }

    /// A cell of the grid, or an octant of an octant … of it.
    struct Place {
        std::array<int, 3> base;  // its cell of the grid
        Vec3 lo, hi;              // in that cell, multiples of 1/4
    };
    [[nodiscard]] Place place(std::size_t index) const { return place_of(cells_[index]); }

private:
    static constexpr unsigned kPathBits = 10;
    static constexpr unsigned kAxisBits = 18;
    [[nodiscard]] static std::array<int, 3> base_of(std::uint64_t code) {
        const auto along = [&](unsigned axis) {
            return static_cast<int>(code >> (kPathBits + axis * kAxisBits) & ((1U << kAxisBits) - 1));
        };
        return {along(0), along(1), along(2)};
    }
    [[nodiscard]] static Place place_of(std::uint64_t code);

    IsoField field_;
    std::vector<std::uint64_t>
        cells_;  // base, 18 bits an axis; then 1 and three bits for every octant on the way
    std::size_t lost_ = 0;
};

}  // namespace pellucid
