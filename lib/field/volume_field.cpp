#include "field/volume_field.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace pellucid {
namespace {

/// Two or four weights along one axis, and their derivatives.
template <std::size_t taps>
struct Axis {
    std::array<double, taps> value, slope, bend;
};

[[nodiscard]] Axis<2> linear(double t) { return {{1 - t, t}, {-1, 1}, {0, 0}}; }
[[nodiscard]] Axis<4> cubic(double t) {
    const CatmullRomWeights w(t);
    return {w.value, w.slope, w.bend};
}

/// Σ of samples (x fastest, `stride` a row) by the tensor product of the axes' weights.
template <std::size_t taps, class Sample>
[[nodiscard]] FieldJet tensor_jet(const Axis<taps>& x, const Axis<taps>& y, const Axis<taps>& z, const Sample& sample) {
    FieldJet jet;
    for (std::size_t k = 0; k < taps; ++k) {
        // Value, ∂x, ∂xx, ∂y, ∂yy, ∂xy of a slice.
        std::array<double, 6> slice{};
        for (std::size_t j = 0; j < taps; ++j) {
            double row = 0, row_x = 0, row_xx = 0;
            for (std::size_t i = 0; i < taps; ++i) {
                const double v = sample(i, j, k);
                row += x.value[i] * v;
                row_x += x.slope[i] * v;
                row_xx += x.bend[i] * v;
            }
            slice[0] += y.value[j] * row;
            slice[1] += y.value[j] * row_x;
            slice[2] += y.value[j] * row_xx;
            slice[3] += y.slope[j] * row;
            slice[4] += y.bend[j] * row;
            slice[5] += y.slope[j] * row_x;
        }
        jet.value += z.value[k] * slice[0];
        jet.gradient += Vec3(z.value[k] * slice[1], z.value[k] * slice[3], z.slope[k] * slice[0]);
        const std::array<double, 6> second{z.value[k] * slice[2], z.value[k] * slice[4], z.bend[k] * slice[0],
                                           z.value[k] * slice[5], z.slope[k] * slice[1], z.slope[k] * slice[3]};
        for (std::size_t n = 0; n < 6; ++n) jet.hessian[n] += second[n];
    }
    return jet;
}

}  // namespace

CatmullRomWeights::CatmullRomWeights(double t)
    : value{t * (-0.5 + t * (1 - 0.5 * t)), 1 + t * t * (-2.5 + 1.5 * t), t * (0.5 + t * (2 - 1.5 * t)),
            t * t * (-0.5 + 0.5 * t)},
      slope{-0.5 + t * (2 - 1.5 * t), t * (-5 + 4.5 * t), 0.5 + t * (4 - 4.5 * t), t * (-1 + 1.5 * t)},
      bend{2 - 3 * t, -5 + 9 * t, 4 - 9 * t, -1 + 3 * t} {}

VolumeField::VolumeField(std::shared_ptr<const VoxelGrid> grid, Interpolation interpolation)
    : grid_(std::move(grid)), interpolation_(interpolation) {}

Box VolumeField::hull() const {
    return {Vec3(0.0), Vec3(grid_->size[0] - 1, grid_->size[1] - 1, grid_->size[2] - 1)};
}

std::array<int, 3> VolumeField::cell_of(const Vec3& p) const {
    std::array<int, 3> cell{};
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        cell[a] = std::clamp(static_cast<int>(std::floor(p[axis])), 0, std::max(0, grid_->size[a] - 2));
    }
    return cell;
}

VolumeField::Samples VolumeField::samples_around(const std::array<int, 3>& cell) const {
    Samples out;
    // Where the four samples of an axis stand; the outer ones may be continued from two.
    struct Tap {
        int at, other;  // v = at, or 2·at − other where other >= 0
    };
    std::array<std::array<Tap, 4>, 3> taps;
    for (std::size_t a = 0; a < 3; ++a)
        for (int i = 0; i < 4; ++i) {
            const int last = grid_->size[a] - 1;
            const int at = cell[a] + i - 1;
            Tap& tap = taps[a][static_cast<std::size_t>(i)];
            if (at < 0)
                tap = {0, last > 0 ? 1 : -1};
            else if (at > last)
                tap = {last, last > 0 ? last - 1 : -1};
            else
                tap = {at, -1};
        }
    std::size_t n = 0;
    for (const Tap& z : taps[2])
        for (const Tap& y : taps[1])
            for (const Tap& x : taps[0]) {
                double sum = 0;
                for (int corner = 0; corner < 8; ++corner) {
                    const bool ox = (corner & 1) != 0, oy = (corner & 2) != 0, oz = (corner & 4) != 0;
                    if ((ox && x.other < 0) || (oy && y.other < 0) || (oz && z.other < 0)) continue;
                    double weight = 1;
                    for (const auto& [tap, other] : {std::pair(x, ox), std::pair(y, oy), std::pair(z, oz)})
                        if (tap.other >= 0) weight *= other ? -1 : 2;
                    sum += weight * static_cast<double>(grid_->at(ox ? x.other : x.at, oy ? y.other : y.at, oz ? z.other : z.at));
                }
                out[n++] = static_cast<float>(sum);
            }
    return out;
}

double VolumeField::value(const Vec3& p) const { return jet(p).value; }

FieldJet VolumeField::jet(const Vec3& p) const {
    FieldJet nothing;
    nothing.value = std::numeric_limits<double>::quiet_NaN();
    for (int axis = 0; axis < 3; ++axis)
        if (!(p[axis] >= 0 && p[axis] <= grid_->size[static_cast<std::size_t>(axis)] - 1)) return nothing;
    if (interpolation_ == Interpolation::nearest) {
        const auto near = [&](int axis) { return static_cast<int>(std::floor(p[axis] + 0.5)); };
        nothing.value = static_cast<double>(grid_->at(near(0), near(1), near(2)));
        return nothing;
    }
    const std::array<int, 3> cell = cell_of(p);
    const double x = p.x - cell[0], y = p.y - cell[1], z = p.z - cell[2];
    if (interpolation_ == Interpolation::catmull_rom) {
        const Samples around = samples_around(cell);
        return tensor_jet<4>(cubic(x), cubic(y), cubic(z), [&](std::size_t i, std::size_t j, std::size_t k) {
            return static_cast<double>(around[i + 4 * j + 16 * k]);
        });
    }
    const auto& size = grid_->size;
    return tensor_jet<2>(linear(x), linear(y), linear(z), [&](std::size_t i, std::size_t j, std::size_t k) {
        return static_cast<double>(grid_->at(std::min(cell[0] + static_cast<int>(i), size[0] - 1),
                                             std::min(cell[1] + static_cast<int>(j), size[1] - 1),
                                             std::min(cell[2] + static_cast<int>(k), size[2] - 1)));
    });
}

}  // namespace pellucid
