#include <array>

#include "bench/probes.hpp"

namespace pellucid::bench {
namespace {

constexpr std::uint32_t kVertexWords[] = {
#include "shaders/raster_probe.vert.inc"
};
constexpr std::uint32_t kFragmentWords[] = {
#include "shaders/raster_probe.frag.inc"
};

struct Push {
    std::uint64_t corners;
    std::uint64_t keys;
    std::uint32_t size;
    std::uint32_t unused = 0;
};

}  // namespace

VulkanRasterProbe::VulkanRasterProbe(const vulkan::Device& device, std::span<const Corner> corners, int size)
    : count_(static_cast<std::uint32_t>(corners.size())),
      size_(static_cast<std::uint32_t>(size)),
      kernel_(device, kVertexWords, kFragmentWords, {.push_bytes = sizeof(Push)}),
      commands_(device),
      corners_(device, corners.size_bytes()),
      keys_(device, std::uint64_t{size_} * size_ * sizeof(std::uint64_t)) {
    vulkan::upload(device, corners_, std::as_bytes(corners));
}

double VulkanRasterProbe::run() {
    const Push push{corners_.address(), keys_.address(), size_};
    const vulkan::VertexRange all{0, count_};
    commands_.fill(keys_, 0, keys_.bytes(), ~0U);
    commands_.barrier();
    commands_.begin_stage("raster");
    commands_.draw(kernel_, std::as_bytes(std::span(&push, 1)), {0, 0, size_, size_, size_}, {&all, 1});
    commands_.end_stage();
    return commands_.submit_and_wait().front().seconds;
}

}  // namespace pellucid::bench
