// The surface f = 0 of an MPU field in cells: leaves of its octree and parts of them.
//
// Sure ranges of f (MpuField::range) throw away what holds no surface; ranges of ∇f shrink the rest to a box around it, and
// cut it until f is monotone along an axis and the surface nearly flat. Where the sure range of ∇f says nothing, which
// noise in the points does, it is estimated from gradients all over the box, with room: not sure, but of what is drawn
// alone. Each cell has the list of the leaves that reach it, so f needs no search.
//
// Where there are no points f is a guess: a cell is kept only if a point is within kMpuReach spacings. So a hole in a scan
// that is wider than twice that stays a hole, the border of an open surface runs beyond the outermost points by that much,
// and sheets far from all points, which quadrics have, are gone.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "field/mpu.hpp"
#include "field/surface_cells.hpp"

namespace pellucid {

/// In spacings: the local one, but at least that of half of the points and at most four times that.
inline constexpr double kMpuReach = 3;

struct MpuCell {
    std::array<std::uint32_t, 3> base{};   // of 2^MpuCells::kDepth along each axis of the cube
    std::uint32_t extent = 0;              // a power of two
    std::array<float, 3> tight_lo{}, tight_hi{};        // shares of the cell
    std::array<float, 3> gradient_lo{}, gradient_hi{};  // over `tight`; infinite where nothing is known
    std::uint32_t first_leaf = 0;          // in MpuCells::lists
    std::uint32_t leaf_count = 0;
    bool sharp = false;                    // whether one of them is

    [[nodiscard]] bool monotone(std::size_t axis) const { return gradient_lo[axis] > 0 || gradient_hi[axis] < 0; }
};

class MpuCells final : public SurfaceCells {
public:
    static constexpr int kDepth = 26;
    static constexpr std::uint32_t kPlanes = 1U << kDepth;

    /// `field` must outlive this.
    explicit MpuCells(const MpuField& field);

    [[nodiscard]] const MpuField& field() const { return field_; }
    [[nodiscard]] std::span<const MpuCell> cells() const { return cells_; }
    [[nodiscard]] std::span<const std::uint32_t> leaves_of(const MpuCell& cell) const {
        return std::span(lists_).subspan(cell.first_leaf, cell.leaf_count);
    }
    /// Place of plane i of 0 … kPlanes along an axis, object space: the same for all cells that touch it.
    [[nodiscard]] double plane(int axis, std::uint32_t i) const;
    /// Half the median edge of the cells' leaves would be too fine, the largest too coarse: their median.
    [[nodiscard]] double typical_width() const { return typical_width_; }

    [[nodiscard]] std::size_t count() const override { return cells_.size(); }
    [[nodiscard]] SurfaceCell cell(std::size_t index) const override;
    [[nodiscard]] bool excludes(const Box& box) const override { return field_.excludes(box); }
    void cross(std::size_t index, const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
               std::vector<FieldRoot>& roots, IsolationStats& stats) const override;
    [[nodiscard]] int most_roots(std::size_t index, int axis) const override;
    void cross_along(const AxisLines& lines, const AxisRoots& out) const override;
    [[nodiscard]] std::size_t bytes() const override;

private:
    struct Builder;
    const MpuField& field_;
    double typical_width_ = 0;
    std::vector<MpuCell> cells_;
    std::vector<std::uint32_t> lists_;
};

}  // namespace pellucid
