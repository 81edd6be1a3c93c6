// A volume and its transfer function as the fast caster reads them.
//
// Integers of 8 or 16 bits stand in bricks of 8³ cells with an apron, 9³ samples, so that the two neighbours
// along x come in one load and memory is read alike from every direction; float32 stays as it is.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "cpu/empty_space.hpp"
#include "scene/volume_object.hpp"

namespace pellucid {

/// TransferFunction in float32, for values less an offset. Piece k holds for from[k] <= value < from[k + 1].
struct PackedTransfer {
    std::uint32_t count = 0;
    // Padded so that a whole vector can be read.
    std::vector<float> begin, end;                    // of the piece; ∓infinity at its ends
    std::vector<float> base, opacity, opacity_slope;  // opacity + (value − base)·slope
    std::array<std::vector<float>, 3> color, color_slope;
    bool ever_opaque = false;  // somewhere opacity is 1
};

struct PackedVolume {
    enum class Kind : std::uint8_t { bytes, words, floats };

    /// Trilinear, with less than 2 GB, and a transfer function whose values and slopes are no extremes.
    [[nodiscard]] static bool takes(const VolumeObject& volume);
    /// The object must outlive it. Precondition: takes(volume). Without bricks: for who lays out samples himself;
    /// then `data` and `step` say nothing of integers.
    PackedVolume(const VolumeObject& volume, bool skip, bool with_bricks = true);

    /// What bytes() will be at most: samples stay where they are, or are integers and stand in bricks.
    [[nodiscard]] static std::int64_t planned_bytes(const VolumeObject& volume, bool skip) {
        constexpr std::int64_t kMostBytesABlock = 1472;
        return EmptySpace::count_of(volume.cells()) * (kMostBytesABlock + (skip ? 1 : 0));
    }
    [[nodiscard]] std::size_t bytes() const { return bricks.size() + space.bytes(); }

    const VolumeObject* object;
    Kind kind;
    /// Bytes: of cell (i, j, k), sample (0, 0, 0): in bricks i·step + (i/8)·jump for each axis, summed.
    std::array<std::int32_t, 3> step{}, jump{};
    std::array<float, 3> last{};  // sample along each axis
    std::array<std::int32_t, 3> last_cell{};
    std::vector<std::uint8_t> bricks;  // empty for floats
    const std::uint8_t* data;          // bricks, or the object's own samples
    double offset = 0;                 // value = offset + what is stored
    PackedTransfer transfer;
    EmptySpace space;
};

}  // namespace pellucid
