// Private to lib/vulkan: the Vulkan handles behind device.hpp, and the check of every call.
#pragma once

#include <map>
#include <mutex>
#include <string>
#include <vector>

#include <vulkan/vulkan.h>

#include "vulkan/device.hpp"

namespace pellucid::vulkan {

/// "VK_ERROR_DEVICE_LOST"; a result without a name here is its number.
[[nodiscard]] std::string result_name(VkResult result);

/// Throws run_error("call: VK_ERROR_…") unless VK_SUCCESS.
void check(VkResult result, const char* call);

/// A Vulkan structure that says what it is, all else zero.
template <class T>
[[nodiscard]] T structure(VkStructureType type) {
    T s{};
    s.sType = type;
    return s;
}

/// Messages of the validation layer. The layer may call from any thread.
struct ValidationLog {
    mutable std::mutex mutex;
    std::vector<std::string> messages;
};

struct Context {
    VkInstance instance = VK_NULL_HANDLE;
    VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
    VkPhysicalDevice physical = VK_NULL_HANDLE;
    VkDevice device = VK_NULL_HANDLE;
    VkQueue queue = VK_NULL_HANDLE;
    std::uint32_t queue_family = 0;
    std::uint64_t timestamp_mask = 0;
    bool stage_all = false;

    DeviceInfo info;
    VkPhysicalDeviceLimits limits{};
    VkPhysicalDeviceMemoryProperties memory{};
    ValidationLog log;

    /// Compute pipelines that were made, by push bytes, constants and code: drivers compile for seconds. They live as long
    /// as the device.
    struct Pipeline {
        VkShaderModule shader = VK_NULL_HANDLE;
        VkPipelineLayout layout = VK_NULL_HANDLE;
        VkPipeline pipeline = VK_NULL_HANDLE;
    };
    std::map<std::vector<std::uint32_t>, Pipeline> pipelines;

    std::uint64_t bytes_held = 0;
    std::uint64_t peak_bytes = 0;
    std::uint32_t allocations = 0;

    Context() = default;
    Context(const Context&) = delete;
    Context& operator=(const Context&) = delete;
    ~Context();
};

struct Buffer::State {
    std::shared_ptr<Context> context;
    VkBuffer buffer = VK_NULL_HANDLE;
    VkDeviceMemory memory = VK_NULL_HANDLE;
    std::uint64_t bytes = 0;
    std::uint64_t address = 0;
    void* mapped = nullptr;

    State() = default;
    State(const State&) = delete;
    State& operator=(const State&) = delete;
    ~State();
};

struct Kernel::State {
    std::shared_ptr<Context> context;
    VkPipelineLayout layout = VK_NULL_HANDLE;  // the context's
    VkPipeline pipeline = VK_NULL_HANDLE;
    std::uint32_t push_bytes = 0;
};

struct RasterKernel::State {
    std::shared_ptr<Context> context;
    VkShaderModule vertex = VK_NULL_HANDLE;
    VkShaderModule fragment = VK_NULL_HANDLE;
    VkPipelineLayout layout = VK_NULL_HANDLE;
    VkPipeline pipeline = VK_NULL_HANDLE;
    std::uint32_t push_bytes = 0;

    State() = default;
    State(const State&) = delete;
    State& operator=(const State&) = delete;
    ~State();
};

}  // namespace pellucid::vulkan
