#include <algorithm>
#include <atomic>
#include <bit>
#include <random>

#include "bench/probes.hpp"
#include "core/parallel.hpp"

namespace pellucid::bench {
namespace {

/// Points projected at once: their pixels and keys stay in the first-level cache.
constexpr std::size_t kBatch = 512;
constexpr std::uint32_t kOutside = ~0U;

}  // namespace

SplatProbe::SplatProbe(std::size_t points, int size) : size_(size), points_(points) {
    keys_.resize(static_cast<std::size_t>(size) * static_cast<std::size_t>(size));
    std::mt19937 random(1);
    std::uniform_real_distribution<float> side(-1, 1);
    std::uint32_t payload = 0;
    for (Point& p : points_) p = {side(random), side(random), side(random) + 4, payload++};
}

std::uint64_t SplatProbe::run() {
    std::fill(keys_.begin(), keys_.end(), ~std::uint64_t{0});
    parallel_for(points_.size() / kBatch, 16, [&](std::size_t begin, std::size_t end) {
        for (std::size_t batch = begin; batch < end; ++batch) splat(&points_[batch * kBatch], kBatch);
    });
    return points_.size() / kBatch * kBatch;
}

void SplatProbe::splat(const Point* points, std::size_t count) {
    alignas(64) std::uint32_t pixels[kBatch];
    alignas(64) std::uint64_t keys[kBatch];
    const float half = 0.5F * static_cast<float>(size_);
    const float focal = 3 * half;  // |x| <= 1 at z = 3 fills the image
    const auto size = static_cast<std::uint32_t>(size_);
    for (std::size_t i = 0; i < count; ++i) {
        const Point& p = points[i];
        const float scale = focal / p.z;
        const auto column = static_cast<std::uint32_t>(static_cast<int>(p.x * scale + half));
        const auto row = static_cast<std::uint32_t>(static_cast<int>(p.y * scale + half));
        pixels[i] = column < size && row < size ? row * size + column : kOutside;
        keys[i] = static_cast<std::uint64_t>(std::bit_cast<std::uint32_t>(p.z)) << 32U | p.payload;
    }
    for (std::size_t i = 0; i < count; ++i)
        if (pixels[i] != kOutside) __builtin_prefetch(&keys_[pixels[i]], 1);
    for (std::size_t i = 0; i < count; ++i) {
        if (pixels[i] == kOutside) continue;
        const std::atomic_ref<std::uint64_t> held(keys_[pixels[i]]);
        std::uint64_t old = held.load(std::memory_order_relaxed);
        while (keys[i] < old && !held.compare_exchange_weak(old, keys[i], std::memory_order_relaxed)) {}
    }
}

}  // namespace pellucid::bench
