#include "field/volume_points.hpp"

#include <algorithm>
#include <cmath>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

/// ∂/∂index by central differences, one-sided at the border.
[[nodiscard]] Vec3 gradient_at(const VoxelGrid& grid, const std::array<int, 3>& at) {
    Vec3 gradient(0.0);
    for (std::size_t axis = 0; axis < 3; ++axis) {
        std::array<int, 3> low = at, high = at;
        low[axis] = std::max(at[axis] - 1, 0);
        high[axis] = std::min(at[axis] + 1, grid.size[axis] - 1);
        if (high[axis] == low[axis]) continue;
        gradient[static_cast<int>(axis)] =
            (static_cast<double>(grid.at(high[0], high[1], high[2])) - static_cast<double>(grid.at(low[0], low[1], low[2]))) /
            (high[axis] - low[axis]);
    }
    return gradient;
}

}  // namespace

std::vector<OrientedPoint> isosurface_points(const VoxelGrid& grid, double isovalue) {
    std::vector<std::vector<OrientedPoint>> slices(static_cast<std::size_t>(grid.size[2]));
    parallel_for(slices.size(), 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t slice = begin; slice < end; ++slice)
            for (int j = 0; j < grid.size[1]; ++j)
                for (int i = 0; i < grid.size[0]; ++i)
                    for (std::size_t axis = 0; axis < 3; ++axis) {
                        const std::array<int, 3> a{i, j, static_cast<int>(slice)};
                        std::array<int, 3> b = a;
                        if (++b[axis] >= grid.size[axis]) continue;
                        const auto from = static_cast<double>(grid.at(a[0], a[1], a[2]));
                        const auto to = static_cast<double>(grid.at(b[0], b[1], b[2]));
                        if (!std::isfinite(from) || !std::isfinite(to) || (from >= isovalue) == (to >= isovalue)) continue;
                        const double share = (isovalue - from) / (to - from);
                        Vec3 place(a[0], a[1], a[2]);
                        place[static_cast<int>(axis)] += share;
                        const Vec3 slope = (1 - share) * gradient_at(grid, a) + share * gradient_at(grid, b);
                        const Vec3 normal = grid.index_to_world.normal(-slope);
                        const double size = length(normal);
                        if (!(size > 0) || !std::isfinite(size)) continue;
                        slices[slice].push_back({grid.index_to_world.point(place),
                                                 {static_cast<float>(normal.x / size), static_cast<float>(normal.y / size),
                                                  static_cast<float>(normal.z / size)}});
                    }
    });
    std::vector<OrientedPoint> points;
    for (const auto& slice : slices) points.insert(points.end(), slice.begin(), slice.end());
    return points;
}

VoxelGrid blurred(VoxelGrid grid, double sigma) {
    const int radius = static_cast<int>(std::ceil(3 * sigma));
    if (radius == 0) return grid;
    std::vector<double> weights;
    double sum = 0;
    for (int i = -radius; i <= radius; ++i) sum += weights.emplace_back(std::exp(-0.5 * i * i / (sigma * sigma)));
    // One axis after the other; what lies beyond the border is 0.
    std::vector<float> next(grid.values.size());
    for (std::size_t axis = 0; axis < 3; ++axis) {
        parallel_for(static_cast<std::size_t>(grid.size[2]), 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t k = begin; k < end; ++k)
                for (int j = 0; j < grid.size[1]; ++j)
                    for (int i = 0; i < grid.size[0]; ++i) {
                        std::array<int, 3> at{i, j, static_cast<int>(k)};
                        const int middle = at[axis];
                        double value = 0;
                        for (int step = -radius; step <= radius; ++step) {
                            at[axis] = middle + step;
                            if (at[axis] < 0 || at[axis] >= grid.size[axis]) continue;
                            value += weights[static_cast<std::size_t>(step + radius)] *
                                     static_cast<double>(grid.at(at[0], at[1], at[2]));
                        }
                        next[grid.index(i, j, static_cast<int>(k))] = static_cast<float>(value / sum);
                    }
        });
        std::swap(grid.values, next);
    }
    return grid;
}

VoxelGrid label_mask(const VoxelGrid& labels, float label, double sigma) {
    VoxelGrid mask = labels;
    for (float& v : mask.values) v = v == label ? 1.0F : 0.0F;
    return blurred(std::move(mask), sigma);
}

}  // namespace pellucid
