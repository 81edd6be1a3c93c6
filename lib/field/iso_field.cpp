#include "field/iso_field.hpp"

#include <algorithm>
#include <cmath>

#include "core/parallel.hpp"
#include "field/tricubic.hpp"

namespace pellucid {
namespace {

/// Catmull-Rom's weights sum to 1, their sizes to 5/4 at most along an axis: values go beyond the samples by
/// so much of their spread.
constexpr double kOvershoot = 1.25 * 1.25 * 1.25;
/// The linear continuation beyond a border goes as far again as its two samples lie apart, to both sides.
constexpr double kContinuation = 3;
constexpr double kRounding = 0x1p-44;

}  // namespace

IsoField::IsoField(std::shared_ptr<const VolumeField> volume, double isovalue)
    : volume_(std::move(volume)), isovalue_(isovalue) {
    const auto cells = volume_->cells();
    std::size_t count = 1;
    for (std::size_t a = 0; a < 3; ++a) {
        bricks_[a] = (cells[a] + kBrick - 1) / kBrick;
        count *= static_cast<std::size_t>(bricks_[a]);
    }
    may_hold_.resize(count);
    parallel_for(count, 64, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) may_hold_[i] = may_hold(cells_of_brick(i)) ? 1 : 0;
    });
}

IsoField::CellRange IsoField::cells_of_brick(std::size_t brick) const {
    const auto cells = volume_->cells();
    CellRange range{};
    for (std::size_t a = 0; a < 3; ++a) {
        const auto along = static_cast<std::size_t>(bricks_[a]);
        range.first[a] = kBrick * static_cast<int>(brick % along);
        range.last[a] = std::min(range.first[a] + kBrick, cells[a]);
        brick /= along;
    }
    return range;
}

bool IsoField::may_hold(const CellRange& cells) const {
    const bool smooth = volume_->interpolation() == Interpolation::catmull_rom;
    const VoxelGrid& grid = volume_->grid();
    double room = smooth ? kOvershoot : 1;
    std::array<int, 3> first{}, last{};
    for (std::size_t a = 0; a < 3; ++a) {
        first[a] = cells.first[a] - (smooth ? 1 : 0);
        last[a] = cells.last[a] + (smooth ? 1 : 0);
        if (smooth && (first[a] < 0 || last[a] > grid.size[a] - 1)) room *= kContinuation;
        first[a] = std::max(first[a], 0);
        last[a] = std::min(last[a], grid.size[a] - 1);
    }
    float least = std::numeric_limits<float>::infinity();
    float most = -least;
    for (int k = first[2]; k <= last[2]; ++k)
        for (int j = first[1]; j <= last[1]; ++j)
            for (int i = first[0]; i <= last[0]; ++i) {
                const float value = grid.at(i, j, k);
                if (!std::isfinite(value)) continue;
                least = std::min(least, value);
                most = std::max(most, value);
            }
    if (!(least <= most)) return false;
    const double lo = static_cast<double>(least) - isovalue_;
    const double hi = static_cast<double>(most) - isovalue_;
    const double reach = 0.5 * (hi - lo) * room + kRounding * std::max(std::abs(lo), std::abs(hi));
    const double middle = 0.5 * (lo + hi);
    return middle - reach <= 0 && middle + reach >= 0;
}

bool IsoField::cell_excludes(const std::array<int, 3>& cell, const Box& box) const {
    Vec3 lo, hi;
    for (int axis = 0; axis < 3; ++axis) {
        const double base = cell[static_cast<std::size_t>(axis)];
        lo[axis] = std::clamp(box.lo[axis] - base, 0.0, 1.0);
        hi[axis] = std::clamp(box.hi[axis] - base, 0.0, 1.0);
    }
    if (volume_->interpolation() == Interpolation::catmull_rom) {
        const Tricubic f = Tricubic::in_cell(volume_->samples_around(cell), isovalue_);
        const Interval whole = f.range();
        if (!whole.has_zero()) return true;  // nor where it is not a number
        return !f.part(lo, hi).range().has_zero();
    }
    // Trilinear: between the values at the corners.
    std::array<double, 8> sample{};
    double largest = 0;
    for (std::size_t corner = 0; corner < 8; ++corner) {
        std::array<int, 3> at{};
        for (std::size_t a = 0; a < 3; ++a)
            at[a] = std::min(cell[a] + static_cast<int>(corner >> a & 1U), volume_->grid().size[a] - 1);
        sample[corner] = static_cast<double>(volume_->grid().at(at[0], at[1], at[2])) - isovalue_;
        if (!std::isfinite(sample[corner])) return true;
        largest = std::max(largest, std::abs(sample[corner]));
    }
    double least = kInfinity, most = -kInfinity;
    for (std::size_t corner = 0; corner < 8; ++corner) {
        double value = 0;
        for (std::size_t i = 0; i < 8; ++i) {
            double weight = 1;
            for (int axis = 0; axis < 3; ++axis) {
                const double t = ((corner >> axis & 1U) != 0 ? hi : lo)[axis];
                weight *= (i >> axis & 1U) != 0 ? t : 1 - t;
            }
            value += weight * sample[i];
        }
        least = std::min(least, value);
        most = std::max(most, value);
    }
    return least > kRounding * largest || most < -kRounding * largest;
}

bool IsoField::excludes(const Box& box) const {
    const auto cells = volume_->cells();
    CellRange range{};
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        const double end = volume_->grid().size[a] - 1;
        if (!(box.lo[axis] <= end && box.hi[axis] >= 0)) return true;
        const double last = cells[a] - 1;
        // A box that ends in a face touches the cells on both its sides.
        range.first[a] = static_cast<int>(std::clamp(std::ceil(box.lo[axis]) - 1, 0.0, last));
        range.last[a] = static_cast<int>(std::clamp(std::floor(box.hi[axis]), 0.0, last)) + 1;
    }
    const auto brick_of = [](int cell) { return cell / kBrick; };
    for (int bz = brick_of(range.first[2]); bz <= brick_of(range.last[2] - 1); ++bz)
        for (int by = brick_of(range.first[1]); by <= brick_of(range.last[1] - 1); ++by)
            for (int bx = brick_of(range.first[0]); bx <= brick_of(range.last[0] - 1); ++bx) {
                const auto brick = static_cast<std::size_t>(bx) +
                                   static_cast<std::size_t>(bricks_[0]) *
                                       (static_cast<std::size_t>(by) +
                                        static_cast<std::size_t>(bricks_[1]) * static_cast<std::size_t>(bz));
                if (!brick_may_hold(brick)) continue;
                const CellRange own = cells_of_brick(brick);
                for (int k = std::max(own.first[2], range.first[2]); k < std::min(own.last[2], range.last[2]);
                     ++k)
                    for (int j = std::max(own.first[1], range.first[1]);
                         j < std::min(own.last[1], range.last[1]); ++j)
                        for (int i = std::max(own.first[0], range.first[0]);
                             i < std::min(own.last[0], range.last[0]); ++i)
                            if (!cell_excludes({i, j, k}, box)) return false;
            }
    return true;
}

}  // namespace pellucid
