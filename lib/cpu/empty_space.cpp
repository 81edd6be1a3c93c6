#include "cpu/empty_space.hpp"

#include <algorithm>
#include <cmath>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

/// Distances are kept in a byte.
constexpr int kFarthest = 255;

[[nodiscard]] std::size_t wide(int n) {
    return static_cast<std::size_t>(n);
}

/// Along one axis, both ways: out = min over neighbours at distance k of max(k, in), which turns distances
/// within planes into those within the body (the greatest of three coordinates). In place, a line at a time.
void spread(std::vector<std::uint8_t>& distance, const std::array<int, 3>& size, std::size_t axis) {
    const std::size_t stride = axis == 0 ? 1 : axis == 1 ? wide(size[0]) : wide(size[0]) * wide(size[1]);
    const std::size_t lines = distance.size() / wide(size[axis]);
    parallel_for(lines, 64, [&](std::size_t begin, std::size_t end) {
        std::vector<std::uint8_t> line(wide(size[axis]));
        for (std::size_t i = begin; i < end; ++i) {
            const std::size_t first = i / stride * stride * wide(size[axis]) + i % stride;
            for (std::size_t k = 0; k < line.size(); ++k) line[k] = distance[first + k * stride];
            for (std::size_t k = 0; k < line.size(); ++k) {
                int least = line[k];
                for (int away = 1; away < least; ++away) {
                    if (k >= wide(away)) least = std::min(least, std::max<int>(away, line[k - wide(away)]));
                    if (k + wide(away) < line.size())
                        least = std::min(least, std::max<int>(away, line[k + wide(away)]));
                }
                distance[first + k * stride] = static_cast<std::uint8_t>(least);
            }
        }
    });
}

}  // namespace

EmptySpace::EmptySpace(
    const std::array<int, 3>& cells,
    const std::function<Kind(const std::array<int, 3>& first, const std::array<int, 3>& end)>& kind) {
    for (std::size_t a = 0; a < 3; ++a) blocks_[a] = (cells[a] + kBlock - 1) / kBlock;
    std::vector<Kind> kinds(wide(blocks_[0]) * wide(blocks_[1]) * wide(blocks_[2]));
    parallel_for(kinds.size(), 8, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            std::array<int, 3> first{}, last{};
            std::size_t rest = i;
            for (std::size_t a = 0; a < 3; ++a) {
                first[a] = kBlock * static_cast<int>(rest % wide(blocks_[a]));
                last[a] = std::min(first[a] + kBlock, cells[a]);
                rest /= wide(blocks_[a]);
            }
            kinds[i] = kind(first, last);
        }
    });
    // A step from one empty kind over the other to the first again may pass values that neither has.
    anything_ = std::ranges::any_of(kinds, [&](Kind k) { return k == Kind::visit || k != kinds.front(); });
    distance_.assign(kinds.size(), 0);
    for (const Kind own : {Kind::clear, Kind::not_a_number}) {
        if (std::ranges::none_of(kinds, [&](Kind k) { return k == own; })) continue;
        std::vector<std::uint8_t> away(kinds.size());
        for (std::size_t i = 0; i < kinds.size(); ++i) away[i] = kinds[i] == own ? kFarthest : 0;
        for (std::size_t axis = 0; axis < 3; ++axis) spread(away, blocks_, axis);
        for (std::size_t i = 0; i < kinds.size(); ++i)
            if (kinds[i] == own) distance_[i] = away[i];
    }
}

double EmptySpace::empty_until(const Vec3& from, const Vec3& along, double t) const {
    if (distance_.empty()) return t;
    if (!anything_) return kInfinity;
    std::array<int, 3> block{};
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        const double cell = std::floor((from[axis] + t * along[axis]) / kBlock);
        block[a] = static_cast<int>(std::clamp(cell, 0.0, blocks_[a] - 1.0));
    }
    const int away =
        distance_[wide(block[0]) + wide(blocks_[0]) * (wide(block[1]) + wide(blocks_[1]) * wide(block[2]))];
    if (away == 0) return t;
    double end = kInfinity;
    for (int axis = 0; axis < 3; ++axis) {
        if (along[axis] == 0) continue;
        const int face = along[axis] > 0 ? block[static_cast<std::size_t>(axis)] + away
                                         : block[static_cast<std::size_t>(axis)] - away + 1;
        end = std::min(end, (kBlock * face - from[axis]) / along[axis]);
    }
    return std::max(t, end);
}

EmptySpace::Kind kind_of_samples(const VoxelGrid& grid, const std::array<int, 3>& first,
                                 const std::array<int, 3>& end) {
    bool numbers = false, others = false;
    for (int k = first[2]; k <= std::min(end[2], grid.size[2] - 1); ++k)
        for (int j = first[1]; j <= std::min(end[1], grid.size[1] - 1); ++j)
            for (int i = first[0]; i <= std::min(end[0], grid.size[0] - 1); ++i)
                (std::isfinite(grid.at(i, j, k)) ? numbers : others) = true;
    if (!others) return EmptySpace::Kind::clear;
    return numbers ? EmptySpace::Kind::visit : EmptySpace::Kind::not_a_number;
}

EmptySpace find_empty_space(const VolumeObject& volume, double room) {
    if (volume.bounds().empty()) return {};
    const auto kind = [&](const std::array<int, 3>& first, const std::array<int, 3>& end) {
        const EmptySpace::Kind samples = kind_of_samples(volume.field().grid(), first, end);
        if (samples != EmptySpace::Kind::clear) return samples;
        ValueRange range = volume.range(first, end);
        if (range.lo < range.hi) {
            const double more = room * std::max(std::abs(range.lo), std::abs(range.hi));
            range.lo -= more;
            range.hi += more;
        }
        return volume.transfer().most_opacity(range.lo, range.hi) > 0 ? EmptySpace::Kind::visit
                                                                      : EmptySpace::Kind::clear;
    };
    return {volume.cells(), kind};
}

}  // namespace pellucid
