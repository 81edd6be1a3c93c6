#include "scene/volume_object.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

#include "core/box_corners.hpp"
#include "core/error.hpp"
#include "core/parallel.hpp"
#include "field/expression.hpp"
#include "field/point_evaluator.hpp"
#include "io/input_file.hpp"

namespace pellucid {
namespace {

/// Relative room around ranges of values, for what rounding may add.
constexpr double kRangeRoom = 1e-12;

[[nodiscard]] VoxelGrid sample(const ExpressionVolume& volume) {
    const Expression formula(volume.text);
    const PointEvaluator evaluator(formula.value());
    VoxelGrid grid;
    grid.size = volume.resolution;
    const auto wide = [](int n) { return static_cast<std::size_t>(n); };
    const std::size_t rows = wide(grid.size[1]) * wide(grid.size[2]);
    if (rows * wide(grid.size[0]) > available_memory() / sizeof(float))
        throw input_error("resolution: {} samples do not fit in memory", rows * wide(grid.size[0]));
    grid.values.resize(rows * wide(grid.size[0]));
    const Vec3 last(grid.size[0] - 1, grid.size[1] - 1, grid.size[2] - 1);
    const Vec3 spacing = volume.bounds.size() / last;
    for (int axis = 0; axis < 3; ++axis) grid.index_to_world.linear[axis][axis] = spacing[axis];
    grid.index_to_world.offset = volume.bounds.lo;
    parallel_for(rows, 16, [&](std::size_t begin, std::size_t end) {
        const std::size_t count = wide(grid.size[0]);
        std::vector<double> x(count + PointEvaluator::kRoom), y(x), z(x), out(x);
        // Both ends exactly: lo + (hi − lo) need not be hi.
        const auto place = [&](int axis, int i) {
            return i + 1 == grid.size[wide(axis)] ? volume.bounds.hi[axis]
                                                  : volume.bounds.lo[axis] + i * spacing[axis];
        };
        for (std::size_t i = 0; i < count; ++i) x[i] = place(0, static_cast<int>(i));
        for (std::size_t row = begin; row < end; ++row) {
            std::fill(y.begin(), y.end(), place(1, static_cast<int>(row % wide(grid.size[1]))));
            std::fill(z.begin(), z.end(), place(2, static_cast<int>(row / wide(grid.size[1]))));
            double* const outputs[1] = {out.data()};
            evaluator(count, x.data(), y.data(), z.data(), outputs);
            for (std::size_t i = 0; i < count; ++i) grid.values[row * count + i] = static_cast<float>(out[i]);
        }
    });
    return grid;
}

/// The rounded-up float of a number.
[[nodiscard]] float up(double value) {
    const auto f = static_cast<float>(value);
    return static_cast<double>(f) < value ? std::nextafter(f, std::numeric_limits<float>::infinity()) : f;
}

[[nodiscard]] VolumeField make_field(const Volume& volume) {
    try {
        return {std::make_shared<const VoxelGrid>(read_or_sample(volume.source)), volume.interpolation};
    } catch (const Error& error) {
        throw Error(error.kind(), fmt::format("volume \"{}\": {}", volume.name, error.what()));
    }
}

}  // namespace

VoxelGrid read_or_sample(const std::variant<std::filesystem::path, ExpressionVolume>& source) {
    const auto* file = std::get_if<std::filesystem::path>(&source);
    VoxelGrid grid = file != nullptr ? read_volume(*file) : sample(std::get<ExpressionVolume>(source));
    std::atomic<std::size_t> lost{0};
    parallel_for(grid.values.size(), std::size_t{1} << 16U, [&](std::size_t begin, std::size_t end) {
        std::size_t mine = 0;
        for (std::size_t i = begin; i < end; ++i) {
            if (std::isfinite(grid.values[i])) continue;
            grid.values[i] = std::numeric_limits<float>::quiet_NaN();
            ++mine;
        }
        lost += mine;
    });
    // Files are warned of where they are read.
    if (lost > 0 && file == nullptr)
        warn("{} samples of \"{}\" are not finite: nothing is drawn there", lost.load(),
             std::get<ExpressionVolume>(source).text);
    return grid;
}

TrilinearDifferences::TrilinearDifferences(const std::array<float, 8>& corner) {
    const auto c = [&](std::size_t i) { return static_cast<double>(corner[i]); };
    one = c(0);
    x = c(1) - c(0);
    y = c(2) - c(0);
    z = c(4) - c(0);
    xy = (c(3) - c(2)) - x;
    xz = (c(5) - c(4)) - x;
    yz = (c(6) - c(4)) - y;
    xyz = ((c(7) - c(6)) - (c(5) - c(4))) - xy;
}

VolumeObject::VolumeObject(const Volume& volume)
    : settings_(volume),
      field_(make_field(volume)),
      transfer_(volume.transfer),
      to_world_(compose(volume.to_world, field_.grid().index_to_world)),
      to_index_(to_world_.inverse()) {
    const std::array<int, 3>& size = field_.grid().size;
    opacity_step_ = volume.opacity_step.value_or(
        std::min({length(to_world_.linear[0]), length(to_world_.linear[1]), length(to_world_.linear[2])}));
    if (std::ranges::any_of(size, [](int n) { return n < 2; })) {
        warn(
            "volume \"{}\": one sample along an axis ({} x {} x {}) has no thickness: nothing of it is drawn",
            volume.name, size[0], size[1], size[2]);
        return;
    }
    bounds_ = bounds_of(to_world_, field_.hull());
    find_blocks();
}

bool VolumeObject::keeps(const Vec3& world) const {
    for (const ClipPlane& plane : settings_.clip)
        if (dot(plane.normal, world) > plane.offset) return false;
    return true;
}

double VolumeObject::value(const Vec3& index) const {
    if (settings_.interpolation == Interpolation::nearest || bounds_.empty()) return field_.value(index);
    const Vec3 hi = field_.hull().hi;
    for (int axis = 0; axis < 3; ++axis)
        if (!(index[axis] >= 0 && index[axis] <= hi[axis])) return std::numeric_limits<double>::quiet_NaN();
    const std::array<int, 3> cell = field_.cell_of(index);
    const Vec3 at = index - Vec3(cell[0], cell[1], cell[2]);
    if (settings_.interpolation == Interpolation::trilinear)
        return TrilinearDifferences(corners(cell)).value(at);
    // By differences: where all samples are equal, exactly their value.
    const VolumeField::Samples around = field_.samples_around(cell);
    const auto first = static_cast<double>(around[0]);
    return first + catmull_rom_value(around, first, at);
}

Vec3 VolumeObject::gradient(const Vec3& index) const {
    if (settings_.interpolation == Interpolation::nearest) return Vec3(0.0);
    const std::array<int, 3> cell = field_.cell_of(index);
    const Vec3 at = index - Vec3(cell[0], cell[1], cell[2]);
    if (settings_.interpolation == Interpolation::trilinear)
        return TrilinearDifferences(corners(cell)).gradient(at);
    return catmull_rom_gradient(field_.samples_around(cell), 0, at);
}

double VolumeObject::extinction_of(double opacity) const {
    return -std::log1p(-opacity) / opacity_step_;
}

double VolumeObject::most_opacity() const {
    return block_opacity_.empty() ? 0 : static_cast<double>(*std::ranges::max_element(block_opacity_));
}

std::array<int, 3> VolumeObject::cells() const {
    std::array<int, 3> count = field_.grid().size;
    if (settings_.interpolation != Interpolation::nearest)
        for (int& n : count) n = std::max(1, n - 1);
    return count;
}

std::array<float, 8> VolumeObject::corners(const std::array<int, 3>& cell) const {
    const VoxelGrid& grid = field_.grid();
    const std::size_t first = grid.index(cell[0], cell[1], cell[2]);
    const std::size_t row = static_cast<std::size_t>(grid.size[0]);
    const std::size_t slice = row * static_cast<std::size_t>(grid.size[1]);
    const float* v = grid.values.data() + first;
    return {v[0], v[1], v[row], v[row + 1], v[slice], v[slice + 1], v[slice + row], v[slice + row + 1]};
}

ValueRange VolumeObject::range(const std::array<int, 3>& first, const std::array<int, 3>& end) const {
    const VoxelGrid& grid = field_.grid();
    const Interpolation kind = settings_.interpolation;
    std::array<int, 3> lo = first;
    std::array<int, 3> hi = end;  // the last sample that counts
    double spread = 0;            // what the interpolant may leave the samples' range by, in halves of it
    if (kind == Interpolation::nearest)
        for (int& n : hi) --n;
    if (kind == Interpolation::catmull_rom) {
        // The weights' absolute values have a sum of at most 5/4 along an axis; continued samples 2·v₀ − v₁
        // reach three times as far from the middle.
        double reach = 1;
        for (std::size_t a = 0; a < 3; ++a) {
            reach *= 1.25 * (lo[a] == 0 || hi[a] + 1 >= grid.size[a] ? 3 : 1);
            lo[a] = std::max(0, lo[a] - 1);
            hi[a] = std::min(grid.size[a] - 1, hi[a] + 1);
        }
        spread = reach - 1;
    }
    float least = std::numeric_limits<float>::infinity();
    float most = -least;
    for (int k = lo[2]; k <= hi[2]; ++k)
        for (int j = lo[1]; j <= hi[1]; ++j) {
            const float* row = grid.values.data() + grid.index(0, j, k);
            for (int i = lo[0]; i <= hi[0]; ++i) {  // comparisons with NaN are false
                least = row[i] < least ? row[i] : least;
                most = row[i] > most ? row[i] : most;
            }
        }
    if (!(least <= most)) return {};
    const auto from = static_cast<double>(least);
    const auto to = static_cast<double>(most);
    const double room =
        kind == Interpolation::nearest || from == to
            ? 0
            : 0.5 * spread * (to - from) + kRangeRoom * std::max(std::abs(from), std::abs(to));
    return {from - room, to + room};
}

void VolumeObject::find_blocks() {
    const std::array<int, 3> count = cells();
    for (std::size_t a = 0; a < 3; ++a) blocks_[a] = (count[a] + kBlock - 1) / kBlock;
    block_opacity_.resize(static_cast<std::size_t>(blocks_[0]) * static_cast<std::size_t>(blocks_[1]) *
                          static_cast<std::size_t>(blocks_[2]));
    parallel_for(static_cast<std::size_t>(blocks_[1]) * static_cast<std::size_t>(blocks_[2]), 1,
                 [&](std::size_t begin, std::size_t end) {
                     for (std::size_t row = begin; row < end; ++row)
                         for (int i = 0; i < blocks_[0]; ++i) {
                             const std::array<int, 3> block{
                                 i, static_cast<int>(row % static_cast<std::size_t>(blocks_[1])),
                                 static_cast<int>(row / static_cast<std::size_t>(blocks_[1]))};
                             std::array<int, 3> first{}, last{};
                             for (std::size_t a = 0; a < 3; ++a) {
                                 first[a] = kBlock * block[a];
                                 last[a] = std::min(first[a] + kBlock, count[a]);
                             }
                             const ValueRange values = range(first, last);
                             block_opacity_[block_index(block)] =
                                 up(transfer_.most_opacity(values.lo, values.hi));
                         }
                 });
}

}  // namespace pellucid
