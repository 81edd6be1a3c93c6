#include "stage/z_thickness_buffer.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cassert>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "core/huge_pages.hpp"
#include "stage/slab_merge.hpp"

namespace pellucid {
namespace {

using twin::Slab;

constexpr std::size_t kWord = sizeof(std::uint32_t);

struct Words {
    std::array<std::uint32_t, 6> at{};
};

[[nodiscard]] std::uint32_t bits(float v) { return std::bit_cast<std::uint32_t>(v); }
[[nodiscard]] float number(std::uint32_t b) { return std::bit_cast<float>(b); }

// ---- Half floats without a sign ---------------------------------------------------------------

constexpr std::uint32_t kLargestHalf = 0x7bff;  // 65504

/// Nearest, ties to even; subnormal halves included; above the largest: the largest.
[[nodiscard]] std::uint32_t half_of(float v) {
    if (!(v > 0)) return 0;
    if (v < 0x1p-14F) return static_cast<std::uint32_t>(std::nearbyint(v * 0x1p24F));
    const std::uint32_t b = bits(v);
    const std::uint32_t rounded = (b + 0xfffU + (b >> 13U & 1U)) >> 13U;
    return std::min(rounded - (112U << 10U), kLargestHalf);
}
[[nodiscard]] float from_half(std::uint32_t h) {
    if (h < 0x400) return static_cast<float>(h) * 0x1p-24F;
    return number((h << 13U) + (112U << 23U));
}

// ---- Depth and thickness of the half format ---------------------------------------------------

constexpr std::uint32_t kDepthShift = 7;       // 23 − 16 bits of mantissa
constexpr std::uint32_t kThicknessShift = 18;  // 23 − 5

[[nodiscard]] std::uint32_t depth_bits(float z) {
    if (!(z > 0)) return 0;
    const std::uint32_t b = bits(z);
    constexpr std::uint32_t kLargest = 0x7f7fffffU >> kDepthShift;
    return std::min((b + (1U << (kDepthShift - 1)) - 1 + (b >> kDepthShift & 1U)) >> kDepthShift, kLargest);
}

// ---- Slabs as words ---------------------------------------------------------------------------

[[nodiscard]] std::uint32_t byte_of(float v) {
    return static_cast<std::uint32_t>(std::lround(255.0F * std::clamp(v, 0.0F, 1.0F)));
}

/// 24 bits z, 13 d, 15 each r, g, b, 14 a, from the lowest bit of the first word on.
[[nodiscard]] Words pack_half(const Slab& s) {
    const std::uint64_t z = depth_bits(s.z);
    const std::uint64_t d = bits(s.d) >> kThicknessShift;
    const std::uint64_t r = half_of(s.r);
    const std::uint64_t g = half_of(s.g);
    const std::uint64_t b = half_of(s.b);
    const std::uint64_t low = z | d << 24U | r << 37U;  // 52 bits
    const std::uint64_t rest = g | b << 15U | std::uint64_t{half_of(s.a)} << 30U;  // 44 bits
    const std::uint64_t first = low | rest << 52U;
    return {{static_cast<std::uint32_t>(first), static_cast<std::uint32_t>(first >> 32U),
             static_cast<std::uint32_t>(rest >> 12U)}};
}
[[nodiscard]] Slab unpack_half(const std::uint32_t* w) {
    const std::uint64_t first = w[0] | std::uint64_t{w[1]} << 32U;
    const std::uint64_t rest = first >> 52U | std::uint64_t{w[2]} << 12U;
    const auto field = [](std::uint64_t v, unsigned from, unsigned size) {
        return static_cast<std::uint32_t>(v >> from & ((std::uint64_t{1} << size) - 1));
    };
    return {number(field(first, 0, 24) << kDepthShift), number(field(first, 24, 13) << kThicknessShift),
            from_half(field(first, 37, 15)), from_half(field(rest, 0, 15)), from_half(field(rest, 15, 15)),
            from_half(field(rest, 30, 14))};
}

[[nodiscard]] Words pack(const Slab& s, SlabFormat format) {
    if (format == SlabFormat::half) return pack_half(s);
    if (format == SlabFormat::byte) {
        const std::uint32_t rgba =
            byte_of(s.r) | byte_of(s.g) << 8U | byte_of(s.b) << 16U | byte_of(s.a) << 24U;
        return {{bits(s.z), bits(s.d), rgba}};
    }
    return {{bits(s.z), bits(s.d), bits(s.r), bits(s.g), bits(s.b), bits(s.a)}};
}
[[nodiscard]] Slab unpack(const std::uint32_t* w, SlabFormat format) {
    if (format == SlabFormat::half) return unpack_half(w);
    if (format == SlabFormat::byte) {
        const auto channel = [&](unsigned shift) { return static_cast<float>(w[2] >> shift & 255U) / 255.0F; };
        return {number(w[0]), number(w[1]), channel(0), channel(8), channel(16), channel(24)};
    }
    return {number(w[0]), number(w[1]), number(w[2]), number(w[3]), number(w[4]), number(w[5])};
}

/// Ends a pixel's slabs that are fewer than its layers.
[[nodiscard]] bool is_nothing(const Slab& s) { return s.r == 0 && s.g == 0 && s.b == 0 && s.a == 0; }

/// As it will be read, in words, not overlapping what ends at `end`.
[[nodiscard]] Words rounded_behind(Slab slab, float end, SlabFormat format) {
    Words words = pack(slab, format);
    if (format != SlabFormat::half) return words;
    const float z = unpack(words.at.data(), format).z;
    const float front = std::min(std::max(twin::slab_front(slab), end), z);
    slab.d = twin::thickness_between(front, z);
    return pack(slab, format);
}

[[nodiscard]] std::size_t pixels_of(const ZThicknessSize& size) {
    return static_cast<std::size_t>(size.width) * static_cast<std::size_t>(size.height);
}
[[nodiscard]] std::size_t flag_words(const ZThicknessSize& size) { return (pixels_of(size) + 31) / 32; }

}  // namespace

std::size_t bytes_of(SlabFormat format) { return format == SlabFormat::float32 ? 24 : 12; }

std::size_t ZThicknessBuffer::planned_bytes(const ZThicknessSize& size) {
    assert(size.width >= 0 && size.height >= 0 && size.layers >= 2);
    const std::size_t a_pixel = static_cast<std::size_t>(size.layers) * bytes_of(size.format);
    std::size_t slabs = 0;
    if (__builtin_mul_overflow(pixels_of(size), a_pixel, &slabs) || slabs > PTRDIFF_MAX / 2)
        throw input_error("slabs.layers = {}: {} x {} pixels of so many layers are too many bytes to count",
                          size.layers, size.width, size.height);
    return slabs + flag_words(size) * kWord;
}

ZThicknessBuffer::ZThicknessBuffer(const ZThicknessSize& size)
    : size_(size),
      slab_words_(bytes_of(size.format) / kWord),
      pixel_words_(slab_words_ * static_cast<std::size_t>(size.layers)),
      total_words_(planned_bytes(size) / kWord - flag_words(size)),
      words_(HugePageAllocator<std::uint32_t>().allocate(std::max<std::size_t>(total_words_, 1))),
      flags_(flag_words(size)) {}

void ZThicknessBuffer::Release::operator()(std::uint32_t* memory) const noexcept {
    HugePageAllocator<std::uint32_t>().deallocate(memory, 0);
}

std::size_t ZThicknessBuffer::bytes() const { return (total_words_ + flags_.size()) * kWord; }

void ZThicknessBuffer::clear() { std::fill(flags_.begin(), flags_.end(), 0U); }

std::uint32_t* ZThicknessBuffer::words_of(std::size_t pixel) const { return words_.get() + pixel * pixel_words_; }

void ZThicknessBuffer::write(std::size_t pixel, std::span<const Slab> slabs) {
    assert(slabs.size() <= most_slabs());
    std::uint32_t* to = words_of(pixel);
    const auto put = [&](const Words& words) { to = std::copy_n(words.at.begin(), slab_words_, to); };
    put(pack(composite(slabs), size_.format));
    std::size_t kept = 0;
    float end = -std::numeric_limits<float>::infinity();
    for (const Slab& slab : slabs) {
        const Words words = rounded_behind(slab, end, size_.format);
        const Slab seen = unpack(words.at.data(), size_.format);
        if (is_nothing(seen)) continue;
        put(words);
        end = seen.z;
        ++kept;
    }
    if (kept < most_slabs()) put(pack(Slab{}, size_.format));
    // Other threads write flags of the same word.
    std::atomic_ref(flags_[pixel / 32]).fetch_or(1U << (pixel % 32), std::memory_order_relaxed);
}

std::span<const Slab> ZThicknessBuffer::read(std::size_t pixel, std::span<Slab> room) const {
    assert(room.size() >= most_slabs());
    if (!touched(pixel)) return {};
    std::size_t count = 0;
    for (const std::uint32_t* from = words_of(pixel) + slab_words_; count < most_slabs(); from += slab_words_) {
        const Slab slab = unpack(from, size_.format);
        if (is_nothing(slab)) break;
        room[count++] = slab;
    }
    return {room.data(), count};
}

Slab ZThicknessBuffer::image(std::size_t pixel) const {
    return touched(pixel) ? unpack(words_of(pixel), size_.format) : Slab{};
}

}  // namespace pellucid
