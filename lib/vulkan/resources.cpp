// Buffers and kernels.
#include <algorithm>
#include <array>
#include <cassert>
#include <cstring>
#include <optional>

#include <fmt/format.h>

#include "core/error.hpp"
#include "vulkan/context.hpp"

namespace pellucid::vulkan {
namespace {

/// So much at a time where a buffer is not mapped: enough to hide the submission, small beside a heap.
constexpr std::uint64_t kStagingBytes = std::uint64_t{64} << 20;

constexpr VkMemoryPropertyFlags kHostMemory =
    VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
constexpr VkMemoryPropertyFlags kDeviceMemory = VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;

[[nodiscard]] bool shares_memory_with_host(const VkPhysicalDeviceMemoryProperties& memory) {
    const std::span heaps(memory.memoryHeaps, memory.memoryHeapCount);
    return std::all_of(heaps.begin(), heaps.end(), [](const VkMemoryHeap& heap) {
        return (heap.flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT) != 0;
    });
}

/// First type among `allowed` that has all of `wanted` and none of `unwanted`.
[[nodiscard]] std::optional<std::uint32_t> memory_type(const VkPhysicalDeviceMemoryProperties& memory,
                                                       std::uint32_t allowed, VkMemoryPropertyFlags wanted,
                                                       VkMemoryPropertyFlags unwanted) {
    for (std::uint32_t i = 0; i < memory.memoryTypeCount; ++i) {
        const VkMemoryPropertyFlags flags = memory.memoryTypes[i].propertyFlags;
        if ((allowed >> i & 1U) != 0 && (flags & wanted) == wanted && (flags & unwanted) == 0) return i;
    }
    return std::nullopt;
}

[[nodiscard]] std::uint32_t memory_type_for(BufferKind kind, const VkPhysicalDeviceMemoryProperties& memory,
                                            std::uint32_t allowed) {
    struct Wish {
        VkMemoryPropertyFlags wanted, unwanted;
    };
    // From the best to what the specification promises. What the host only writes need not be cached.
    std::vector<Wish> wishes;
    switch (kind) {
        case BufferKind::device:
            if (shares_memory_with_host(memory)) wishes.push_back({kDeviceMemory | kHostMemory, 0});
            wishes.push_back({kDeviceMemory, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT});
            wishes.push_back({kDeviceMemory, 0});
            wishes.push_back({0, 0});
            break;
        case BufferKind::upload:
            wishes = {{kHostMemory, kDeviceMemory | VK_MEMORY_PROPERTY_HOST_CACHED_BIT}, {kHostMemory, 0}};
            break;
        case BufferKind::readback:
            wishes = {{kHostMemory | VK_MEMORY_PROPERTY_HOST_CACHED_BIT, 0}, {kHostMemory, 0}};
            break;
    }
    for (const Wish& wish : wishes)
        if (const auto type = memory_type(memory, allowed, wish.wanted, wish.unwanted)) return *type;
    throw run_error("no Vulkan memory type for a buffer, among those of mask {:#x}", allowed);
}

[[nodiscard]] bool is_out_of_memory(VkResult result) {
    return result == VK_ERROR_OUT_OF_DEVICE_MEMORY || result == VK_ERROR_OUT_OF_HOST_MEMORY ||
           result == VK_ERROR_TOO_MANY_OBJECTS;
}

}  // namespace

// Buffers

Buffer::State::~State() {
    if (buffer != VK_NULL_HANDLE) vkDestroyBuffer(context->device, buffer, nullptr);
    if (memory != VK_NULL_HANDLE) {
        vkFreeMemory(context->device, memory, nullptr);  // unmaps too
        context->bytes_held -= bytes;
        --context->allocations;
    }
}

Buffer::Buffer() noexcept = default;
Buffer::Buffer(Buffer&& other) noexcept = default;
Buffer& Buffer::operator=(Buffer&& other) noexcept = default;
Buffer::~Buffer() = default;

Buffer::Buffer(const Device& device, std::uint64_t bytes, BufferKind kind) {
    if (bytes == 0) return;
    state_ = std::make_unique<State>();
    State& s = *state_;
    s.context = device.context_;
    s.bytes = bytes;
    Context& context = *s.context;
    const auto refuse = [&](const std::string& reason) {
        return run_error("a buffer of {} bytes on \"{}\": {}; the heap has {} bytes, other buffers hold {}",
                         bytes, context.info.name, reason, context.info.heap_bytes, context.bytes_held);
    };
    if (bytes > context.info.largest_allocation)
        throw refuse(fmt::format("at most {} bytes at a time", context.info.largest_allocation));
    if (context.allocations >= context.limits.maxMemoryAllocationCount)
        throw refuse(fmt::format("at most {} allocations", context.limits.maxMemoryAllocationCount));
    const auto check_memory = [&](VkResult result, const char* call) {
        if (is_out_of_memory(result)) throw refuse(fmt::format("{}: {}", call, result_name(result)));
        check(result, call);
    };

    auto create = structure<VkBufferCreateInfo>(VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO);
    create.size = bytes;
    create.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT |
                   VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
    check_memory(vkCreateBuffer(context.device, &create, nullptr, &s.buffer), "vkCreateBuffer");

    VkMemoryRequirements needs;
    vkGetBufferMemoryRequirements(context.device, s.buffer, &needs);
    auto flags = structure<VkMemoryAllocateFlagsInfo>(VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO);
    flags.flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT;
    auto allocate = structure<VkMemoryAllocateInfo>(VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO);
    allocate.pNext = &flags;
    allocate.allocationSize = needs.size;
    allocate.memoryTypeIndex = memory_type_for(kind, context.memory, needs.memoryTypeBits);
    check_memory(vkAllocateMemory(context.device, &allocate, nullptr, &s.memory), "vkAllocateMemory");
    context.bytes_held += bytes;
    context.peak_bytes = std::max(context.peak_bytes, context.bytes_held);
    ++context.allocations;
    check(vkBindBufferMemory(context.device, s.buffer, s.memory, 0), "vkBindBufferMemory");

    auto where = structure<VkBufferDeviceAddressInfo>(VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO);
    where.buffer = s.buffer;
    s.address = vkGetBufferDeviceAddress(context.device, &where);
    const VkMemoryPropertyFlags has = context.memory.memoryTypes[allocate.memoryTypeIndex].propertyFlags;
    if ((has & kHostMemory) == kHostMemory && !(kind == BufferKind::device && context.stage_all))
        check_memory(vkMapMemory(context.device, s.memory, 0, VK_WHOLE_SIZE, 0, &s.mapped), "vkMapMemory");
}

std::uint64_t Buffer::bytes() const { return state_ ? state_->bytes : 0; }
std::uint64_t Buffer::address() const { return state_ ? state_->address : 0; }

std::span<std::byte> Buffer::mapped() const {
    if (!state_ || state_->mapped == nullptr) return {};
    return {static_cast<std::byte*>(state_->mapped), static_cast<std::size_t>(state_->bytes)};
}

void upload(const Device& device, const Buffer& buffer, std::span<const std::byte> bytes,
            std::uint64_t offset) {
    assert(offset <= buffer.bytes() && bytes.size() <= buffer.bytes() - offset);
    if (bytes.empty()) return;
    if (const std::span<std::byte> mapped = buffer.mapped(); !mapped.empty()) {
        std::memcpy(mapped.data() + offset, bytes.data(), bytes.size());
        return;
    }
    const Buffer staging(device, std::min<std::uint64_t>(bytes.size(), kStagingBytes), BufferKind::upload);
    Commands commands(device);
    for (std::uint64_t done = 0; done < bytes.size(); done += staging.bytes()) {
        const std::uint64_t part = std::min<std::uint64_t>(bytes.size() - done, staging.bytes());
        std::memcpy(staging.mapped().data(), bytes.data() + done, part);
        commands.copy(staging, 0, buffer, offset + done, part);
        commands.submit_and_wait();
    }
}

void download(const Device& device, const Buffer& buffer, std::span<std::byte> bytes, std::uint64_t offset) {
    assert(offset <= buffer.bytes() && bytes.size() <= buffer.bytes() - offset);
    if (bytes.empty()) return;
    if (const std::span<std::byte> mapped = buffer.mapped(); !mapped.empty()) {
        std::memcpy(bytes.data(), mapped.data() + offset, bytes.size());
        return;
    }
    const Buffer staging(device, std::min<std::uint64_t>(bytes.size(), kStagingBytes), BufferKind::readback);
    Commands commands(device);
    for (std::uint64_t done = 0; done < bytes.size(); done += staging.bytes()) {
        const std::uint64_t part = std::min<std::uint64_t>(bytes.size() - done, staging.bytes());
        commands.copy(buffer, offset + done, staging, 0, part);
        commands.submit_and_wait();
        std::memcpy(bytes.data() + done, staging.mapped().data(), part);
    }
}

// Kernels

namespace {

[[nodiscard]] VkShaderModule make_shader(VkDevice device, std::span<const std::uint32_t> spirv) {
    auto create = structure<VkShaderModuleCreateInfo>(VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO);
    create.codeSize = spirv.size_bytes();
    create.pCode = spirv.data();
    VkShaderModule shader = VK_NULL_HANDLE;
    check(vkCreateShaderModule(device, &create, nullptr, &shader), "vkCreateShaderModule");
    return shader;
}

[[nodiscard]] VkPipelineLayout make_layout(VkDevice device, VkShaderStageFlags stages, std::uint32_t push_bytes) {
    const VkPushConstantRange push{stages, 0, push_bytes};
    auto create = structure<VkPipelineLayoutCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO);
    create.pushConstantRangeCount = push_bytes > 0 ? 1 : 0;
    create.pPushConstantRanges = &push;
    VkPipelineLayout layout = VK_NULL_HANDLE;
    check(vkCreatePipelineLayout(device, &create, nullptr, &layout), "vkCreatePipelineLayout");
    return layout;
}

/// Specialisation constants 0, 1, … as Vulkan wants them; not to be copied.
class Constants {
public:
    explicit Constants(std::span<const std::uint32_t> values) {
        for (std::uint32_t id = 0; id < values.size(); ++id) entries_.push_back({id, 4 * id, 4});
        info_.mapEntryCount = static_cast<std::uint32_t>(entries_.size());
        info_.pMapEntries = entries_.data();
        info_.dataSize = values.size_bytes();
        info_.pData = values.data();
    }
    Constants(const Constants&) = delete;
    Constants& operator=(const Constants&) = delete;
    [[nodiscard]] const VkSpecializationInfo* info() const { return entries_.empty() ? nullptr : &info_; }

private:
    std::vector<VkSpecializationMapEntry> entries_;
    VkSpecializationInfo info_{};
};

}  // namespace

Kernel::Kernel(Kernel&& other) noexcept = default;
Kernel& Kernel::operator=(Kernel&& other) noexcept = default;
Kernel::~Kernel() = default;

Kernel::Kernel(const Device& device, std::span<const std::uint32_t> spirv, const KernelSettings& settings)
    : state_(std::make_unique<State>()) {
    assert(settings.push_bytes <= 128 && settings.push_bytes % 4 == 0);
    State& s = *state_;
    s.context = device.context_;
    s.push_bytes = settings.push_bytes;
    VkDevice logical = s.context->device;

    std::vector<std::uint32_t> key{settings.push_bytes, static_cast<std::uint32_t>(settings.constants.size())};
    key.insert(key.end(), settings.constants.begin(), settings.constants.end());
    key.insert(key.end(), spirv.begin(), spirv.end());
    Context::Pipeline& made = s.context->pipelines[std::move(key)];
    if (made.pipeline == VK_NULL_HANDLE) {
        // What a failed attempt has left is used again.
        if (made.shader == VK_NULL_HANDLE) made.shader = make_shader(logical, spirv);
        if (made.layout == VK_NULL_HANDLE)
            made.layout = make_layout(logical, VK_SHADER_STAGE_COMPUTE_BIT, settings.push_bytes);
        const Constants constants(settings.constants);
        auto pipeline = structure<VkComputePipelineCreateInfo>(VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO);
        pipeline.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
        pipeline.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
        pipeline.stage.module = made.shader;
        pipeline.stage.pName = "main";
        pipeline.stage.pSpecializationInfo = constants.info();
        pipeline.layout = made.layout;
        check(vkCreateComputePipelines(logical, VK_NULL_HANDLE, 1, &pipeline, nullptr, &made.pipeline),
              "vkCreateComputePipelines");
    }
    s.layout = made.layout;
    s.pipeline = made.pipeline;
}

RasterKernel::State::~State() {
    if (pipeline != VK_NULL_HANDLE) vkDestroyPipeline(context->device, pipeline, nullptr);
    if (layout != VK_NULL_HANDLE) vkDestroyPipelineLayout(context->device, layout, nullptr);
    if (fragment != VK_NULL_HANDLE) vkDestroyShaderModule(context->device, fragment, nullptr);
    if (vertex != VK_NULL_HANDLE) vkDestroyShaderModule(context->device, vertex, nullptr);
}

RasterKernel::RasterKernel(RasterKernel&& other) noexcept = default;
RasterKernel& RasterKernel::operator=(RasterKernel&& other) noexcept = default;
RasterKernel::~RasterKernel() = default;

RasterKernel::RasterKernel(const Device& device, std::span<const std::uint32_t> vertex,
                           std::span<const std::uint32_t> fragment, const KernelSettings& settings)
    : state_(std::make_unique<State>()) {
    assert(settings.push_bytes <= 128 && settings.push_bytes % 4 == 0);
    if (const DeviceInfo& info = device.info(); !info.why_no_triangles.empty())
        throw Error(Failure::device,
                    fmt::format("Vulkan device \"{}\" cannot draw triangles: {}", info.name, info.why_no_triangles));
    State& s = *state_;
    s.context = device.context_;
    s.push_bytes = settings.push_bytes;
    VkDevice logical = s.context->device;
    s.vertex = make_shader(logical, vertex);
    s.fragment = make_shader(logical, fragment);
    s.layout = make_layout(logical, VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT, settings.push_bytes);

    const Constants constants(settings.constants);
    std::array<VkPipelineShaderStageCreateInfo, 2> stages{};
    for (VkPipelineShaderStageCreateInfo& stage : stages) {
        stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
        stage.pName = "main";
        stage.pSpecializationInfo = constants.info();
    }
    stages[0].stage = VK_SHADER_STAGE_VERTEX_BIT;
    stages[0].module = s.vertex;
    stages[1].stage = VK_SHADER_STAGE_FRAGMENT_BIT;
    stages[1].module = s.fragment;

    // Triangles by number, either side, one sample a pixel, no image, no depth; the viewport comes with the draw.
    auto input = structure<VkPipelineVertexInputStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO);
    auto assembly =
        structure<VkPipelineInputAssemblyStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO);
    assembly.topology = VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST;
    auto viewport = structure<VkPipelineViewportStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO);
    viewport.viewportCount = 1;
    viewport.scissorCount = 1;
    auto raster =
        structure<VkPipelineRasterizationStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO);
    raster.lineWidth = 1;
    auto samples = structure<VkPipelineMultisampleStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO);
    samples.rasterizationSamples = VK_SAMPLE_COUNT_1_BIT;
    auto blend = structure<VkPipelineColorBlendStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO);
    auto depth = structure<VkPipelineDepthStencilStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_DEPTH_STENCIL_STATE_CREATE_INFO);
    const std::array<VkDynamicState, 2> later{VK_DYNAMIC_STATE_VIEWPORT, VK_DYNAMIC_STATE_SCISSOR};
    auto dynamic = structure<VkPipelineDynamicStateCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_DYNAMIC_STATE_CREATE_INFO);
    dynamic.dynamicStateCount = static_cast<std::uint32_t>(later.size());
    dynamic.pDynamicStates = later.data();
    auto rendering = structure<VkPipelineRenderingCreateInfo>(VK_STRUCTURE_TYPE_PIPELINE_RENDERING_CREATE_INFO);

    auto pipeline = structure<VkGraphicsPipelineCreateInfo>(VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO);
    pipeline.pNext = &rendering;
    pipeline.stageCount = static_cast<std::uint32_t>(stages.size());
    pipeline.pStages = stages.data();
    pipeline.pVertexInputState = &input;
    pipeline.pInputAssemblyState = &assembly;
    pipeline.pViewportState = &viewport;
    pipeline.pRasterizationState = &raster;
    pipeline.pMultisampleState = &samples;
    pipeline.pDepthStencilState = &depth;
    pipeline.pColorBlendState = &blend;
    pipeline.pDynamicState = &dynamic;
    pipeline.layout = s.layout;
    check(vkCreateGraphicsPipelines(logical, VK_NULL_HANDLE, 1, &pipeline, nullptr, &s.pipeline),
          "vkCreateGraphicsPipelines");
}

}  // namespace pellucid::vulkan
