#include "stage/z_thickness_buffer.hpp"

#include <algorithm>
#include <atomic>
#include <cassert>
#include <cstring>
#include <limits>

#include "core/error.hpp"
#include "core/huge_pages.hpp"
#include "kernel/z_thickness_twin.h"
#include "stage/slab_merge.hpp"

namespace pellucid {
namespace {

using twin::Slab;

constexpr std::size_t kWord = sizeof(std::uint32_t);

static_assert(twin::kFormatFloat == twin::uint(SlabFormat::float32) && twin::kFormatHalf == twin::uint(SlabFormat::half) &&
              twin::kFormatByte == twin::uint(SlabFormat::byte));

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
    const auto format = twin::uint(size_.format);
    std::uint32_t* to = words_of(pixel);
    const auto put = [&](const twin::SlabWords& words) {
        std::memcpy(to, &words, slab_words_ * kWord);
        to += slab_words_;
    };
    put(twin::pack_slab(composite(slabs), format));
    std::size_t kept = 0;
    float end = -std::numeric_limits<float>::infinity();
    for (const Slab& slab : slabs) {
        const twin::SlabWords words = twin::pack_behind(slab, end, format);
        const Slab seen = twin::unpack_slab(words, format);
        if (twin::is_no_slab(seen)) continue;
        put(words);
        end = seen.z;
        ++kept;
    }
    if (kept < most_slabs()) put(twin::pack_slab(Slab{}, format));
    // Other threads write flags of the same word.
    std::atomic_ref(flags_[pixel / 32]).fetch_or(1U << (pixel % 32), std::memory_order_relaxed);
}

Slab ZThicknessBuffer::slab_of(const std::uint32_t* words) const {
    twin::SlabWords all{};
    std::memcpy(&all, words, slab_words_ * kWord);
    return twin::unpack_slab(all, twin::uint(size_.format));
}

std::span<const Slab> ZThicknessBuffer::read(std::size_t pixel, std::span<Slab> room) const {
    assert(room.size() >= most_slabs());
    if (!touched(pixel)) return {};
    std::size_t count = 0;
    for (const std::uint32_t* from = words_of(pixel) + slab_words_; count < most_slabs(); from += slab_words_) {
        const Slab slab = slab_of(from);
        if (twin::is_no_slab(slab)) break;
        room[count++] = slab;
    }
    return {room.data(), count};
}

Slab ZThicknessBuffer::image(std::size_t pixel) const {
    return touched(pixel) ? slab_of(words_of(pixel)) : Slab{};
}

}  // namespace pellucid
