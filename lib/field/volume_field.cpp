#include "field/volume_field.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace pellucid {
namespace {

/// Two or four weights along one axis, and their derivatives.
template <std::size_t taps>
struct Axis {
    std::array<double, taps> value, slope, bend;
};

[[nodiscard]] Axis<2> linear(double t) {
    return {{1 - t, t}, {-1, 1}, {0, 0}};
}
[[nodiscard]] Axis<4> cubic(double t) {
    const CatmullRomWeights w(t);
    return {w.value, w.slope, w.bend};
}

/// Σ of samples (x fastest, `stride` a row) by the tensor product of the axes' weights.
template <std::size_t taps, class Sample>
[[nodiscard]] FieldJet tensor_jet(const Axis<taps>& x, const Axis<taps>& y, const Axis<taps>& z,
                                  const Sample& sample) {
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
        const std::array<double, 6> second{z.value[k] * slice[2], z.value[k] * slice[4],
                                           z.bend[k] * slice[0],  z.value[k] * slice[5],
                                           z.slope[k] * slice[1], z.slope[k] * slice[3]};
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

std::array<int, 3> VolumeField::cells() const {
    const auto& size = grid_->size;
    return {std::max(1, size[0] - 1), std::max(1, size[1] - 1), std::max(1, size[2] - 1)};
}

std::array<int, 3> VolumeField::cell_of(const Vec3& p) const {
    std::array<int, 3> cell{};
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        cell[a] = std::clamp(static_cast<int>(std::floor(p[axis])), 0, std::max(0, grid_->size[a] - 2));
    }
    return cell;
}

bool VolumeField::is_inside(const std::array<int, 3>& cell) const {
    for (std::size_t a = 0; a < 3; ++a)
        if (cell[a] < 1 || cell[a] + 2 >= grid_->size[a]) return false;
    return true;
}

VolumeField::Samples VolumeField::samples_around(const std::array<int, 3>& cell) const {
    Samples out;
    std::size_t n = 0;
    if (is_inside(cell)) {
        for (int k = -1; k < 3; ++k)
            for (int j = -1; j < 3; ++j, n += 4)
                std::memcpy(&out[n], &grid_->values[grid_->index(cell[0] - 1, cell[1] + j, cell[2] + k)],
                            4 * sizeof(float));
        return out;
    }
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
                    sum += weight * static_cast<double>(grid_->at(ox ? x.other : x.at, oy ? y.other : y.at,
                                                                  oz ? z.other : z.at));
                }
                // A continuation beyond what a float holds ends at its largest: samples that are finite stay so.
                constexpr double kMost = std::numeric_limits<float>::max();
                out[n++] = static_cast<float>(std::isfinite(sum) ? std::clamp(sum, -kMost, kMost) : sum);
            }
    return out;
}

bool VolumeField::holds(const Vec3& p) const {
    for (int axis = 0; axis < 3; ++axis)
        if (!(p[axis] >= 0 && p[axis] <= grid_->size[static_cast<std::size_t>(axis)] - 1)) return false;
    return true;
}

double VolumeField::nearest_at(const Vec3& p, double less) const {
    const auto near = [&](int axis) { return static_cast<int>(std::floor(p[axis] + 0.5)); };
    return static_cast<double>(grid_->at(near(0), near(1), near(2))) - less;
}

std::array<double, 8> VolumeField::corners_of(const std::array<int, 3>& cell, double less) const {
    std::array<double, 8> corners{};
    for (std::size_t corner = 0; corner < 8; ++corner) {
        std::array<int, 3> at{};
        for (std::size_t a = 0; a < 3; ++a)
            at[a] = std::min(cell[a] + static_cast<int>(corner >> a & 1U), grid_->size[a] - 1);
        corners[corner] = static_cast<double>(grid_->at(at[0], at[1], at[2])) - less;
    }
    return corners;
}

double VolumeField::value(const Vec3& p, double less) const {
    if (!holds(p)) return std::numeric_limits<double>::quiet_NaN();
    if (interpolation_ == Interpolation::nearest) return nearest_at(p, less);
    const std::array<int, 3> cell = cell_of(p);
    const Vec3 t(p.x - cell[0], p.y - cell[1], p.z - cell[2]);
    if (interpolation_ == Interpolation::catmull_rom) return catmull_rom_value(samples_around(cell), less, t);
    const auto v = corners_of(cell, less);
    const auto mix = [](double a, double b, double share) { return (1 - share) * a + share * b; };
    return mix(mix(mix(v[0], v[1], t.x), mix(v[2], v[3], t.x), t.y),
               mix(mix(v[4], v[5], t.x), mix(v[6], v[7], t.x), t.y), t.z);
}

FieldJet VolumeField::jet(const Vec3& p, double less) const {
    FieldJet nothing;
    nothing.value = std::numeric_limits<double>::quiet_NaN();
    if (!holds(p)) return nothing;
    if (interpolation_ == Interpolation::nearest) {
        nothing.value = nearest_at(p, less);
        return nothing;
    }
    const std::array<int, 3> cell = cell_of(p);
    const double x = p.x - cell[0], y = p.y - cell[1], z = p.z - cell[2];
    if (interpolation_ == Interpolation::catmull_rom) {
        const Samples around = samples_around(cell);
        return tensor_jet<4>(cubic(x), cubic(y), cubic(z), [&](std::size_t i, std::size_t j, std::size_t k) {
            return static_cast<double>(around[i + 4 * j + 16 * k]) - less;
        });
    }
    const auto corners = corners_of(cell, less);
    return tensor_jet<2>(linear(x), linear(y), linear(z), [&](std::size_t i, std::size_t j, std::size_t k) {
        return corners[i + 2 * j + 4 * k];
    });
}

double catmull_rom_sum(const VolumeField::Samples& samples, double less, const std::array<double, 4>& x,
                       const std::array<double, 4>& y, const std::array<double, 4>& z) {
    // Rows of four along x stay apart to the end: four lanes.
    std::array<double, 4> sum{};
    for (std::size_t k = 0; k < 4; ++k) {
        std::array<double, 4> slice{};
        for (std::size_t j = 0; j < 4; ++j)
            for (std::size_t i = 0; i < 4; ++i)
                slice[i] += y[j] * (static_cast<double>(samples[i + 4 * j + 16 * k]) - less);
        for (std::size_t i = 0; i < 4; ++i) sum[i] += z[k] * slice[i];
    }
    return x[0] * sum[0] + x[1] * sum[1] + x[2] * sum[2] + x[3] * sum[3];
}

double catmull_rom_value(const VolumeField::Samples& samples, double less, const Vec3& t) {
    return catmull_rom_sum(samples, less, CatmullRomWeights(t.x).value, CatmullRomWeights(t.y).value,
                           CatmullRomWeights(t.z).value);
}

Vec3 catmull_rom_gradient(const VolumeField::Samples& samples, double less, const Vec3& t) {
    const CatmullRomWeights x(t.x), y(t.y), z(t.z);
    return {catmull_rom_sum(samples, less, x.slope, y.value, z.value),
            catmull_rom_sum(samples, less, x.value, y.slope, z.value),
            catmull_rom_sum(samples, less, x.value, y.value, z.slope)};
}

}  // namespace pellucid
