#include <random>

#include "bench/probes.hpp"

namespace pellucid::bench {
namespace {

constexpr std::uint32_t kWords[] = {
#include "shaders/splat_probe.comp.inc"
};
constexpr std::uint32_t kGroup = 64;

struct Point {
    float x, y, z;
    std::uint32_t payload;
};
struct Push {
    std::uint64_t points;
    std::uint64_t keys;
    std::uint32_t count;
    std::uint32_t size;
};

}  // namespace

VulkanSplatProbe::VulkanSplatProbe(const vulkan::Device& device, std::size_t points, int size)
    : device_(device),
      count_(points),
      size_(static_cast<std::uint32_t>(size)),
      kernel_(device, kWords, {.push_bytes = sizeof(Push)}),
      commands_(device),
      points_(device, points * sizeof(Point)),
      keys_(device, std::uint64_t{size_} * size_ * sizeof(std::uint64_t)) {
    std::mt19937 random(1);
    std::uniform_real_distribution<float> side(-1, 1);
    std::vector<Point> all(points);
    std::uint32_t payload = 0;
    for (Point& p : all) p = {side(random), side(random), side(random) + 4, payload++};
    vulkan::upload(device, points_, std::as_bytes(std::span(all)));
}

double VulkanSplatProbe::run() {
    commands_.begin_stage("splat");
    commands_.fill(keys_, 0, keys_.bytes(), ~0U);
    commands_.barrier();
    commands_.dispatch(kernel_,
                       Push{points_.address(), keys_.address(), static_cast<std::uint32_t>(count_), size_},
                       device_.groups_for(count_, kGroup));
    commands_.end_stage();
    return commands_.submit_and_wait().front().seconds;
}

}  // namespace pellucid::bench
