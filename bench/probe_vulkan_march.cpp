#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "bench/probes.hpp"
#include "core/parallel.hpp"

namespace pellucid::bench {
namespace {

constexpr std::uint32_t kWords[] = {
#include "shaders/march_probe.comp.inc"
};
constexpr std::uint32_t kGroup = 16;

struct MarchRay {
    std::array<float, 3> p, d;
    std::uint32_t steps;
};
struct Push {
    std::uint64_t words, rays, sums;
    std::uint32_t count, samples;
};

/// A pinhole's view through the pixels from twice the cube's size away that it fills, as TrilinearProbe has it.
[[nodiscard]] MarchRay ray_of(double a, double b, double n) {
    const std::array<double, 3> eye{1.9 * n, 1.4 * n, 2.1 * n};
    const std::array<double, 3> forward{-0.584, -0.375, -0.667 * 1.08}, right{0.773, 0, -0.634}, up{0.24, 0.921, 0.29};
    std::array<double, 3> d{};
    double size = 0, lo = 0, hi = 1e9;
    for (std::size_t c = 0; c < 3; ++c) {
        d[c] = forward[c] + 0.62 * (a * right[c] - b * up[c]);
        size += d[c] * d[c];
    }
    for (std::size_t c = 0; c < 3; ++c) {
        d[c] /= std::sqrt(size);
        const double t0 = -eye[c] / d[c], t1 = (n - eye[c]) / d[c];
        lo = std::max(lo, std::min(t0, t1));
        hi = std::min(hi, std::max(t0, t1));
    }
    MarchRay ray{};
    for (std::size_t c = 0; c < 3; ++c) {
        ray.p[c] = static_cast<float>(eye[c] + lo * d[c]);
        ray.d[c] = static_cast<float>(d[c]);
    }
    ray.steps = hi > lo ? static_cast<std::uint32_t>(hi - lo) + 1 : 0;
    return ray;
}

}  // namespace

VulkanMarchProbe::VulkanMarchProbe(const vulkan::Device& device, int samples, int pixels, std::uint8_t (*value)(int, int, int), bool packed)
    : device_(device),
      count_(static_cast<std::uint32_t>(pixels) * static_cast<std::uint32_t>(pixels)),
      samples_(static_cast<std::uint32_t>(samples)),
      kernel_(device, kWords, {.push_bytes = sizeof(Push), .constants = std::array{packed ? 1U : 0U}}),
      commands_(device),
      words_(device, std::uint64_t{samples_} * samples_ * samples_ * sizeof(std::uint32_t)),
      rays_(device, count_ * sizeof(MarchRay)),
      sums_(device, count_ * sizeof(float)) {
    const auto n = static_cast<std::size_t>(samples);
    std::vector<std::uint32_t> words(n * n * n);
    parallel_for(n, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t z = begin; z < end; ++z)
            for (std::size_t y = 0; y < n; ++y)
                for (std::size_t x = 0; x < n; ++x) {
                    const auto at = [&](std::size_t i, std::size_t j) -> std::uint32_t {
                        return value(static_cast<int>(std::min(i, n - 1)), static_cast<int>(std::min(j, n - 1)), static_cast<int>(z));
                    };
                    words[x + n * (y + n * z)] = !packed ? std::bit_cast<std::uint32_t>(static_cast<float>(at(x, y))) : at(x, y) | at(x + 1, y) << 8U | at(x, y + 1) << 16U | at(x + 1, y + 1) << 24U;
                }
    });
    vulkan::upload(device, words_, std::as_bytes(std::span(words)));
    std::vector<MarchRay> rays;
    for (std::uint32_t i = 0; i < count_; ++i) {
        const std::uint32_t packet = i / 16, columns = static_cast<std::uint32_t>(pixels) / 4;
        const std::uint32_t x = 4 * (packet % columns) + i % 4, y = 4 * (packet / columns) + i % 16 / 4;
        rays.push_back(ray_of((x + 0.5) / pixels - 0.5, (y + 0.5) / pixels - 0.5, samples - 1));
        taken_ += rays.back().steps;
    }
    vulkan::upload(device, rays_, std::as_bytes(std::span(rays)));
}

double VulkanMarchProbe::run() {
    commands_.begin_stage("march");
    commands_.dispatch(kernel_, Push{words_.address(), rays_.address(), sums_.address(), count_, samples_},
                       device_.groups_for(count_, kGroup));
    commands_.end_stage();
    return commands_.submit_and_wait().front().seconds;
}

}  // namespace pellucid::bench
