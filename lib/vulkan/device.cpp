#include "vulkan/device.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cctype>
#include <cstdio>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "core/error.hpp"
#include "vulkan/context.hpp"

namespace pellucid::vulkan {
namespace {

constexpr const char* kValidationLayer = "VK_LAYER_KHRONOS_validation";

template <class... Args>
[[nodiscard]] Error device_error(fmt::format_string<Args...> format, Args&&... args) {
    return {Failure::device, fmt::format(format, std::forward<Args>(args)...)};
}

// Instance

VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT,
                                          VkDebugUtilsMessageTypeFlagsEXT,
                                          const VkDebugUtilsMessengerCallbackDataEXT* data, void* log) {
    ValidationLog& to = *static_cast<ValidationLog*>(log);
    std::string message = one_line(data->pMessage != nullptr ? data->pMessage : "", 2000);
    const std::lock_guard lock(to.mutex);
    if (std::find(to.messages.begin(), to.messages.end(), message) != to.messages.end()) return VK_FALSE;
    const std::string line = "validation: " + message + "\n";
    std::fputs(line.c_str(), stderr);
    to.messages.push_back(std::move(message));
    return VK_FALSE;
}

[[nodiscard]] bool validation_layer_there() {
    std::uint32_t count = 0;
    if (vkEnumerateInstanceLayerProperties(&count, nullptr) != VK_SUCCESS) return false;
    std::vector<VkLayerProperties> layers(count);
    if (vkEnumerateInstanceLayerProperties(&count, layers.data()) < 0) return false;
    return std::any_of(layers.begin(), layers.end(), [](const VkLayerProperties& layer) {
        return std::string_view(layer.layerName) == kValidationLayer;
    });
}

/// An instance that lives as long as the process, so that drivers (and the layer) stay loaded: to load them
/// takes tens of milliseconds, and they forget some of their memory each time they are unloaded.
void keep_loaded(bool validation_layer) {
    static std::once_flag drivers, layer;
    std::call_once(validation_layer ? layer : drivers, [&] {
        auto create = structure<VkInstanceCreateInfo>(VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO);
        create.enabledLayerCount = validation_layer ? 1 : 0;
        create.ppEnabledLayerNames = &kValidationLayer;
        VkInstance kept = VK_NULL_HANDLE;  // the loader knows it; a failure shows again where it matters
        static_cast<void>(vkCreateInstance(&create, nullptr, &kept));
    });
}

/// Into context.instance and context.messenger.
[[nodiscard]] VkResult create_instance(Context& context, bool validate) {
    keep_loaded(validate);
    auto application = structure<VkApplicationInfo>(VK_STRUCTURE_TYPE_APPLICATION_INFO);
    application.pApplicationName = "pellucid";
    application.apiVersion = VK_API_VERSION_1_3;
    auto create = structure<VkInstanceCreateInfo>(VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO);
    create.pApplicationInfo = &application;
    if (!validate) return vkCreateInstance(&create, nullptr, &context.instance);

    // The messenger listens to the creation and the end of the instance too.
    auto listen = structure<VkDebugUtilsMessengerCreateInfoEXT>(
        VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT);
    listen.messageSeverity =
        VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
    listen.messageType =
        VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT;
    listen.pfnUserCallback = on_message;
    listen.pUserData = &context.log;
    const VkValidationFeatureEnableEXT synchronisation =
        VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT;
    auto features = structure<VkValidationFeaturesEXT>(VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT);
    features.pNext = &listen;
    features.enabledValidationFeatureCount = 1;
    features.pEnabledValidationFeatures = &synchronisation;
    const std::array<const char*, 2> extensions{VK_EXT_DEBUG_UTILS_EXTENSION_NAME,
                                                VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME};
    create.pNext = &features;
    create.enabledLayerCount = 1;
    create.ppEnabledLayerNames = &kValidationLayer;
    create.enabledExtensionCount = static_cast<std::uint32_t>(extensions.size());
    create.ppEnabledExtensionNames = extensions.data();
    const VkResult result = vkCreateInstance(&create, nullptr, &context.instance);
    if (result != VK_SUCCESS) return result;
    const auto create_messenger = reinterpret_cast<PFN_vkCreateDebugUtilsMessengerEXT>(
        vkGetInstanceProcAddr(context.instance, "vkCreateDebugUtilsMessengerEXT"));
    assert(create_messenger != nullptr);
    return create_messenger(context.instance, &listen, nullptr, &context.messenger);
}

// Physical devices

/// Discrete before integrated before virtual GPUs, software last.
constexpr int kSoftware = 3;
[[nodiscard]] int rank(VkPhysicalDeviceType type) {
    switch (type) {
        case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU: return 0;
        case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU: return 1;
        case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU: return 2;
        default: return kSoftware;
    }
}

struct Candidate {
    VkPhysicalDevice physical = VK_NULL_HANDLE;
    int rank = 0;
    DeviceInfo info;
    std::uint32_t queue_family = 0;
};

/// The features asked of every device, chained for a query or for vkCreateDevice. Not to be copied.
struct Features {
    VkPhysicalDeviceFeatures2 core{};
    VkPhysicalDeviceVulkan12Features v12{};
    VkPhysicalDeviceVulkan13Features v13{};

    Features() {
        core.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2;
        v12.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES;
        v13.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES;
        core.pNext = &v12;
        v12.pNext = &v13;
    }
    Features(const Features&) = delete;
    Features& operator=(const Features&) = delete;

    struct Named {
        const char* name;
        VkBool32* value;
    };
    /// maintenance4: workgroup sizes by specialisation constants.
    [[nodiscard]] std::array<Named, 6> required() {
        return {{{"shaderInt64", &core.features.shaderInt64},
                 {"bufferDeviceAddress", &v12.bufferDeviceAddress},
                 {"scalarBlockLayout", &v12.scalarBlockLayout},
                 {"shaderBufferInt64Atomics", &v12.shaderBufferInt64Atomics},
                 {"synchronization2", &v13.synchronization2},
                 {"maintenance4", &v13.maintenance4}}};
    }
    /// What else it takes to draw triangles as RasterKernel does.
    [[nodiscard]] std::array<Named, 3> for_triangles() {
        return {{{"shaderFloat64", &core.features.shaderFloat64},
                 {"fragmentStoresAndAtomics", &core.features.fragmentStoresAndAtomics},
                 {"dynamicRendering", &v13.dynamicRendering}}};
    }
};

struct QueueFamily {
    std::uint32_t index;
    bool draws;
};
/// A family that computes and has timestamps; one that draws too goes first.
[[nodiscard]] std::optional<QueueFamily> find_queue_family(VkPhysicalDevice physical) {
    std::uint32_t count = 0;
    vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, nullptr);
    std::vector<VkQueueFamilyProperties> families(count);
    vkGetPhysicalDeviceQueueFamilyProperties(physical, &count, families.data());
    for (const bool draws : {true, false})
        for (std::uint32_t i = 0; i < count; ++i) {
            const VkQueueFlags wanted = VK_QUEUE_COMPUTE_BIT | (draws ? VK_QUEUE_GRAPHICS_BIT : 0);
            const bool has = (families[i].queueFlags & wanted) == wanted;
            if (has && families[i].timestampValidBits > 0) return QueueFamily{i, draws};
        }
    return std::nullopt;
}

[[nodiscard]] std::uint64_t largest_device_heap(VkPhysicalDevice physical) {
    VkPhysicalDeviceMemoryProperties memory;
    vkGetPhysicalDeviceMemoryProperties(physical, &memory);
    VkDeviceSize largest = 0;
    for (const VkMemoryHeap& heap : std::span(memory.memoryHeaps, memory.memoryHeapCount))
        if ((heap.flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT) != 0) largest = std::max(largest, heap.size);
    return largest;
}

/// Properties, and what is missing; what Vulkan 1.3 brought is asked of such devices only.
[[nodiscard]] Candidate examine(VkPhysicalDevice physical) {
    Candidate c;
    c.physical = physical;
    VkPhysicalDeviceProperties basic;
    vkGetPhysicalDeviceProperties(physical, &basic);
    c.info.name = basic.deviceName;
    c.rank = rank(basic.deviceType);
    c.info.is_gpu = c.rank < kSoftware;
    c.info.max_workgroup_size = basic.limits.maxComputeWorkGroupInvocations;
    c.info.shared_bytes = basic.limits.maxComputeSharedMemorySize;
    c.info.heap_bytes = largest_device_heap(physical);
    c.info.subpixel_bits = basic.limits.subPixelPrecisionBits;
    c.info.largest_viewport =
        std::min({basic.limits.maxViewportDimensions[0], basic.limits.maxViewportDimensions[1],
                  basic.limits.maxFramebufferWidth, basic.limits.maxFramebufferHeight});
    if (basic.apiVersion < VK_API_VERSION_1_3) {
        c.info.why_not =
            fmt::format("it has Vulkan {}.{}, 1.3 is needed", VK_API_VERSION_MAJOR(basic.apiVersion),
                        VK_API_VERSION_MINOR(basic.apiVersion));
        return c;
    }

    VkPhysicalDeviceVulkan13Properties v13{};
    VkPhysicalDeviceVulkan12Properties v12{};
    VkPhysicalDeviceVulkan11Properties v11{};
    v13.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_PROPERTIES;
    v12.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_PROPERTIES;
    v11.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_PROPERTIES;
    auto properties = structure<VkPhysicalDeviceProperties2>(VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2);
    v12.pNext = &v13;
    v11.pNext = &v12;
    properties.pNext = &v11;
    vkGetPhysicalDeviceProperties2(physical, &properties);
    c.info.driver = one_line(fmt::format("{} {}", v12.driverName, v12.driverInfo));
    c.info.subgroup_size = v11.subgroupSize;
    if ((v11.subgroupSupportedOperations & VK_SUBGROUP_FEATURE_VOTE_BIT) == 0) {
        c.info.why_not = "it lacks votes of subgroups";
        return c;
    }
    c.info.largest_allocation =
        std::min<std::uint64_t>({v11.maxMemoryAllocationSize, v13.maxBufferSize, c.info.heap_bytes});

    Features there;
    vkGetPhysicalDeviceFeatures2(physical, &there.core);
    c.info.shared_int64_atomics = there.v12.shaderSharedInt64Atomics == VK_TRUE;
    c.info.float64 = there.core.features.shaderFloat64 == VK_TRUE;
    std::vector<std::string> missing;
    for (const Features::Named& feature : there.required())
        if (*feature.value == VK_FALSE) missing.emplace_back(feature.name);
    const std::optional<QueueFamily> family = find_queue_family(physical);
    if (!family) missing.emplace_back("a compute queue with timestamps");
    c.queue_family = family ? family->index : 0;
    std::vector<std::string> missing_for_triangles;
    for (const Features::Named& feature : there.for_triangles())
        if (*feature.value == VK_FALSE) missing_for_triangles.emplace_back(feature.name);
    if (!family || !family->draws) missing_for_triangles.emplace_back("a queue that computes and draws");
    if (!missing_for_triangles.empty())
        c.info.why_no_triangles = fmt::format("it lacks {}", fmt::join(missing_for_triangles, ", "));
    c.info.usable = missing.empty();
    if (!missing.empty()) c.info.why_not = fmt::format("it lacks {}", fmt::join(missing, ", "));
    return c;
}

[[nodiscard]] std::vector<Candidate> find_candidates(VkInstance instance) {
    std::uint32_t count = 0;
    if (vkEnumeratePhysicalDevices(instance, &count, nullptr) != VK_SUCCESS) return {};
    std::vector<VkPhysicalDevice> devices(count);
    if (vkEnumeratePhysicalDevices(instance, &count, devices.data()) < 0) return {};
    devices.resize(count);
    std::vector<Candidate> candidates;
    for (VkPhysicalDevice physical : devices) candidates.push_back(examine(physical));
    return candidates;
}

[[nodiscard]] std::string lower_case(std::string text) {
    for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return text;
}

/// The best usable one whose name has `name` in it. Precondition: there are candidates.
[[nodiscard]] Candidate choose(const std::vector<Candidate>& candidates, const std::string& name) {
    std::vector<Candidate> named;
    for (const Candidate& c : candidates)
        if (lower_case(c.info.name).find(lower_case(name)) != std::string::npos) named.push_back(c);
    if (named.empty()) {
        std::vector<std::string> names;
        for (const Candidate& c : candidates) names.push_back(fmt::format("\"{}\"", c.info.name));
        throw device_error("no Vulkan device \"{}\"; there is {}", one_line(name, 100),
                           fmt::join(names, ", "));
    }
    std::stable_sort(named.begin(), named.end(), [](const Candidate& a, const Candidate& b) {
        return std::pair(!a.info.usable, a.rank) < std::pair(!b.info.usable, b.rank);
    });
    if (!named[0].info.usable)
        throw device_error("Vulkan device \"{}\" cannot be used: {}", named[0].info.name,
                           named[0].info.why_not);
    return named[0];
}

void create_device(Context& context) {
    const float priority = 1;
    auto queue = structure<VkDeviceQueueCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO);
    queue.queueFamilyIndex = context.queue_family;
    queue.queueCount = 1;
    queue.pQueuePriorities = &priority;
    Features wanted;
    for (const Features::Named& feature : wanted.required()) *feature.value = VK_TRUE;
    for (const Features::Named& feature : wanted.for_triangles())
        *feature.value = context.info.why_no_triangles.empty() ? VK_TRUE : VK_FALSE;
    wanted.v12.shaderSharedInt64Atomics = context.info.shared_int64_atomics ? VK_TRUE : VK_FALSE;
    wanted.core.features.shaderFloat64 = context.info.float64 ? VK_TRUE : VK_FALSE;
    auto create = structure<VkDeviceCreateInfo>(VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO);
    create.pNext = &wanted.core;
    create.queueCreateInfoCount = 1;
    create.pQueueCreateInfos = &queue;
    check(vkCreateDevice(context.physical, &create, nullptr, &context.device), "vkCreateDevice");
    vkGetDeviceQueue(context.device, context.queue_family, 0, &context.queue);
}

void read_limits(Context& context) {
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(context.physical, &properties);
    context.limits = properties.limits;
    vkGetPhysicalDeviceMemoryProperties(context.physical, &context.memory);
    std::uint32_t count = context.queue_family + 1;
    std::vector<VkQueueFamilyProperties> families(count);
    vkGetPhysicalDeviceQueueFamilyProperties(context.physical, &count, families.data());
    const std::uint32_t bits = families[context.queue_family].timestampValidBits;
    context.timestamp_mask = bits >= 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << bits) - 1;
}

}  // namespace

std::string result_name(VkResult result) {
    switch (result) {
        case VK_SUCCESS: return "VK_SUCCESS";
        case VK_NOT_READY: return "VK_NOT_READY";
        case VK_TIMEOUT: return "VK_TIMEOUT";
        case VK_INCOMPLETE: return "VK_INCOMPLETE";
        case VK_ERROR_OUT_OF_HOST_MEMORY: return "VK_ERROR_OUT_OF_HOST_MEMORY";
        case VK_ERROR_OUT_OF_DEVICE_MEMORY: return "VK_ERROR_OUT_OF_DEVICE_MEMORY";
        case VK_ERROR_INITIALIZATION_FAILED: return "VK_ERROR_INITIALIZATION_FAILED";
        case VK_ERROR_DEVICE_LOST: return "VK_ERROR_DEVICE_LOST";
        case VK_ERROR_MEMORY_MAP_FAILED: return "VK_ERROR_MEMORY_MAP_FAILED";
        case VK_ERROR_LAYER_NOT_PRESENT: return "VK_ERROR_LAYER_NOT_PRESENT";
        case VK_ERROR_EXTENSION_NOT_PRESENT: return "VK_ERROR_EXTENSION_NOT_PRESENT";
        case VK_ERROR_FEATURE_NOT_PRESENT: return "VK_ERROR_FEATURE_NOT_PRESENT";
        case VK_ERROR_INCOMPATIBLE_DRIVER: return "VK_ERROR_INCOMPATIBLE_DRIVER";
        case VK_ERROR_TOO_MANY_OBJECTS: return "VK_ERROR_TOO_MANY_OBJECTS";
        case VK_ERROR_OUT_OF_POOL_MEMORY: return "VK_ERROR_OUT_OF_POOL_MEMORY";
        case VK_ERROR_INVALID_EXTERNAL_HANDLE: return "VK_ERROR_INVALID_EXTERNAL_HANDLE";
        case VK_ERROR_INVALID_OPAQUE_CAPTURE_ADDRESS: return "VK_ERROR_INVALID_OPAQUE_CAPTURE_ADDRESS";
        case VK_ERROR_INVALID_SHADER_NV: return "VK_ERROR_INVALID_SHADER_NV";
        case VK_ERROR_UNKNOWN: return "VK_ERROR_UNKNOWN";
        default: return fmt::format("VkResult {}", static_cast<int>(result));
    }
}

void check(VkResult result, const char* call) {
    if (result == VK_ERROR_DEVICE_LOST)
        throw run_error("{}: {}: device lost during the run", call, result_name(result));
    if (result != VK_SUCCESS) throw run_error("{}: {}", call, result_name(result));
}

Context::~Context() {
    for (const auto& [key, made] : pipelines) {
        if (made.pipeline != VK_NULL_HANDLE) vkDestroyPipeline(device, made.pipeline, nullptr);
        if (made.layout != VK_NULL_HANDLE) vkDestroyPipelineLayout(device, made.layout, nullptr);
        if (made.shader != VK_NULL_HANDLE) vkDestroyShaderModule(device, made.shader, nullptr);
    }
    if (device != VK_NULL_HANDLE) vkDestroyDevice(device, nullptr);
    if (messenger != VK_NULL_HANDLE) {
        const auto destroy_messenger = reinterpret_cast<PFN_vkDestroyDebugUtilsMessengerEXT>(
            vkGetInstanceProcAddr(instance, "vkDestroyDebugUtilsMessengerEXT"));
        destroy_messenger(instance, messenger, nullptr);
    }
    if (instance != VK_NULL_HANDLE) vkDestroyInstance(instance, nullptr);
}

std::vector<DeviceInfo> list_devices() {
    Context context;
    if (create_instance(context, false) != VK_SUCCESS) return {};
    std::vector<DeviceInfo> devices;
    for (const Candidate& c : find_candidates(context.instance)) devices.push_back(c.info);
    return devices;
}

Device::Device(const DeviceOptions& options) : context_(std::make_shared<Context>()) {
    if (options.validate && !validation_layer_there())
        throw device_error("no layer {}; Debian has it in the package vulkan-validationlayers",
                           kValidationLayer);
    if (const VkResult result = create_instance(*context_, options.validate); result != VK_SUCCESS)
        throw device_error("no Vulkan device: vkCreateInstance: {}", result_name(result));
    const std::vector<Candidate> candidates = find_candidates(context_->instance);
    if (candidates.empty())
        throw device_error("no Vulkan device; Debian has one in software in the package mesa-vulkan-drivers");
    const Candidate chosen = choose(candidates, options.name);
    context_->physical = chosen.physical;
    context_->queue_family = chosen.queue_family;
    context_->info = chosen.info;
    context_->stage_all = options.stage_all;
    read_limits(*context_);
    create_device(*context_);
}

const DeviceInfo& Device::info() const { return context_->info; }
std::uint64_t Device::bytes_held() const { return context_->bytes_held; }
std::uint64_t Device::peak_bytes() const { return context_->peak_bytes; }

std::vector<std::string> Device::validation_messages() const {
    const std::lock_guard lock(context_->log.mutex);
    return context_->log.messages;
}

Groups Device::groups_for(std::uint64_t invocations, std::uint32_t workgroup_size) const {
    assert(workgroup_size > 0);
    const std::uint64_t groups = (invocations + workgroup_size - 1) / workgroup_size;
    const std::uint64_t most = context_->limits.maxComputeWorkGroupCount[0];
    if (groups <= most) return {static_cast<std::uint32_t>(groups), 1, 1};
    // Rows of equal length: fewer than `rows` workgroups have nothing to do.
    const std::uint64_t rows = (groups + most - 1) / most;
    assert(rows <= context_->limits.maxComputeWorkGroupCount[1]);
    return {static_cast<std::uint32_t>((groups + rows - 1) / rows), static_cast<std::uint32_t>(rows), 1};
}

}  // namespace pellucid::vulkan
