// The z-thickness buffer (zSlab dissertation, sections 2.1 and 5.2.1): N layers a pixel, of which layer 0 is the image
// and the others hold its sorted zSlabs, and a flag a pixel, 32 in a word. A pixel that was never written costs
// nothing: clearing touches flags alone, and reading it gives no slabs.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "kernel/slab_twin.h"
#include "stage/slab_settings.hpp"

namespace pellucid {

/// How a slab is kept. Colours are associated and linear; depth z >= 0 but for float32.
///   float32  24 bytes, all bits
///   half     12 bytes: 24 bits of z (8 exponent, 16 mantissa: to 2^-17 of it), 13 of d (8 and 5, cut off, so thinner
///            by up to 1/32), colours as half floats without the sign, opacity in 14 bits (half floats
///            up to 1 need no more): to 2^-11 of it, below 6e-5 to 3e-8
///   byte     12 bytes: z and d as float32, 8 bits a channel: to 1/510; a colour above 1 becomes 1
/// Neighbours do not overlap after rounding: what would, is made thinner. A slab whose colour and opacity
/// round to 0 is not kept.
enum class SlabFormat : std::uint8_t { float32, half, byte };
[[nodiscard]] std::size_t bytes_of(SlabFormat format);

struct ZThicknessSize {
    int width = 0;
    int height = 0;
    int layers = 8;  // N >= 2
    SlabFormat format = SlabFormat::float32;
};

class ZThicknessBuffer {
public:
    /// Throws Error(input) for a size whose bytes are too many to count; std::bad_alloc where they are not there.
    explicit ZThicknessBuffer(const ZThicknessSize& size);

    /// What a buffer of this size holds, flags included. The same error.
    [[nodiscard]] static std::size_t planned_bytes(const ZThicknessSize& size);
    /// What this one holds.
    [[nodiscard]] std::size_t bytes() const;
    [[nodiscard]] const ZThicknessSize& size() const { return size_; }
    [[nodiscard]] std::size_t most_slabs() const { return static_cast<std::size_t>(size_.layers) - 1; }

    /// No pixel has anything from now on.
    void clear();
    [[nodiscard]] bool touched(std::size_t pixel) const {
        return (flags_[pixel / 32] >> (pixel % 32) & 1U) != 0;
    }
    /// Flags of pixels 32·word …: 0 where none of them was written.
    [[nodiscard]] std::uint32_t flags(std::size_t word) const { return flags_[word]; }

    /// Replaces a pixel's slabs and its image, which is their composite before rounding. Safe beside writes to other
    /// pixels. Precondition: a sorted array of at most most_slabs().
    void write(std::size_t pixel, std::span<const twin::Slab> slabs);

    /// A pixel's slabs, in `room` of at least most_slabs(); none where it was not written.
    [[nodiscard]] std::span<const twin::Slab> read(std::size_t pixel, std::span<twin::Slab> room) const;
    /// Layer 0: the composite, from the first front to the last back; all zero where it was not written.
    [[nodiscard]] twin::Slab image(std::size_t pixel) const;

private:
    [[nodiscard]] std::uint32_t* words_of(std::size_t pixel) const;
    [[nodiscard]] twin::Slab slab_of(const std::uint32_t* words) const;

    ZThicknessSize size_;
    std::size_t slab_words_;
    std::size_t pixel_words_;
    std::size_t total_words_;
    struct Release {
        void operator()(std::uint32_t* memory) const noexcept;
    };
    std::unique_ptr<std::uint32_t[], Release> words_;  // left as the system gives it
    std::vector<std::uint32_t> flags_;
};

}  // namespace pellucid
