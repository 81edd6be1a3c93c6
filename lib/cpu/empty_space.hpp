// Block-wise empty-space skipping: blocks of cells in which nothing can be seen, and how far from each the
// nearest one is that must be visited. D. Cohen, Z. Sheffer, Proximity clouds, The Visual Computer 11 (1994).
//
// What is skipped changes no result. Neighbouring blocks share samples, so the ranges of their values
// overlap, and on a way through empty blocks every number between the values at its two ends is invisible:
// pre-integrated or not. Samples that are not a number break the chain, so a block with some of them is
// visited, and blocks of nothing else are a kind of their own.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <vector>

#include "core/vec.hpp"
#include "scene/volume_object.hpp"

namespace pellucid {

class EmptySpace {
public:
    static constexpr int kBlock = VolumeObject::kBlock;
    enum class Kind : std::uint8_t { visit, clear, not_a_number };

    /// Blocks of so many cells.
    [[nodiscard]] static std::int64_t count_of(const std::array<int, 3>& cells) {
        std::int64_t product = 1;
        for (const int n : cells) product *= (n + kBlock - 1) / kBlock;
        return product;
    }

    /// Everything is visited.
    EmptySpace() = default;
    /// kind(first, end): of the cells from `first` up to, not including, `end`; called from several threads.
    EmptySpace(
        const std::array<int, 3>& cells,
        const std::function<Kind(const std::array<int, 3>& first, const std::array<int, 3>& end)>& kind);

    /// Blocks along each axis; 0: everything is visited.
    [[nodiscard]] const std::array<int, 3>& blocks() const { return blocks_; }
    /// 0 where a block must be visited; d: all blocks less than d away along every axis are of its kind.
    [[nodiscard]] const std::vector<std::uint8_t>& distance() const { return distance_; }
    [[nodiscard]] bool anything() const { return anything_; }

    /// Depth until which a line p = from + t·along (in cells) surely meets nothing, from depth t on; t itself
    /// where its block must be visited, infinite where nothing comes any more.
    [[nodiscard]] double empty_until(const Vec3& from, const Vec3& along, double t) const;
    [[nodiscard]] std::size_t bytes() const { return distance_.size(); }

private:
    std::array<int, 3> blocks_{};
    std::vector<std::uint8_t> distance_;
    bool anything_ = false;
};

/// not_a_number or visit where some samples of these cells are no numbers; clear where all are.
[[nodiscard]] EmptySpace::Kind kind_of_samples(const VoxelGrid& grid, const std::array<int, 3>& first,
                                               const std::array<int, 3>& end);

/// Of a volume's transfer function. `room`: by what share of its size a value may be off by rounding.
[[nodiscard]] EmptySpace find_empty_space(const VolumeObject& volume, double room);

}  // namespace pellucid
