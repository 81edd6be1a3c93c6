#include <algorithm>
#include <cassert>

#include "core/error.hpp"
#include "vulkan/context.hpp"

namespace pellucid::vulkan {
namespace {

/// Timestamps in a pool; a list of commands has as many pools as it needs.
constexpr std::uint32_t kPoolMarks = 512;

/// Stages that read and write buffers; those that draw only where the queue has them.
[[nodiscard]] VkPipelineStageFlags2 work(const Context& context) {
    constexpr VkPipelineStageFlags2 kComputes =
        VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT;
    constexpr VkPipelineStageFlags2 kDraws =
        VK_PIPELINE_STAGE_2_VERTEX_SHADER_BIT | VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT;
    return context.info.why_no_triangles.empty() ? kComputes | kDraws : kComputes;
}
constexpr VkAccessFlags2 kReads = VK_ACCESS_2_SHADER_READ_BIT | VK_ACCESS_2_TRANSFER_READ_BIT;
constexpr VkAccessFlags2 kWrites = VK_ACCESS_2_SHADER_WRITE_BIT | VK_ACCESS_2_TRANSFER_WRITE_BIT;

void memory_barrier(VkCommandBuffer list, VkPipelineStageFlags2 from, VkPipelineStageFlags2 to, VkAccessFlags2 access) {
    auto all = structure<VkMemoryBarrier2>(VK_STRUCTURE_TYPE_MEMORY_BARRIER_2);
    all.srcStageMask = from;
    all.srcAccessMask = kWrites;
    all.dstStageMask = to;
    all.dstAccessMask = access;
    auto dependency = structure<VkDependencyInfo>(VK_STRUCTURE_TYPE_DEPENDENCY_INFO);
    dependency.memoryBarrierCount = 1;
    dependency.pMemoryBarriers = &all;
    vkCmdPipelineBarrier2(list, &dependency);
}

}  // namespace

struct Commands::State {
    std::shared_ptr<Context> context;
    VkCommandPool pool = VK_NULL_HANDLE;
    VkCommandBuffer list = VK_NULL_HANDLE;
    VkFence fence = VK_NULL_HANDLE;
    bool recording = false;

    std::vector<VkQueryPool> mark_pools;
    std::uint32_t marks = 0;                // timestamps of this recording: begin, end, begin, …
    std::vector<std::string> stage_names;   // one for each pair of marks
    bool in_stage = false;

    State() = default;
    State(const State&) = delete;
    State& operator=(const State&) = delete;
    ~State();

    /// The list, open for recording.
    [[nodiscard]] VkCommandBuffer open();
    void mark();
    [[nodiscard]] std::vector<StageTime> stage_times() const;
};

Commands::State::~State() {
    for (VkQueryPool queries : mark_pools) vkDestroyQueryPool(context->device, queries, nullptr);
    if (fence != VK_NULL_HANDLE) vkDestroyFence(context->device, fence, nullptr);
    if (pool != VK_NULL_HANDLE) vkDestroyCommandPool(context->device, pool, nullptr);  // frees its list too
}

VkCommandBuffer Commands::State::open() {
    if (recording) return list;
    check(vkResetCommandPool(context->device, pool, 0), "vkResetCommandPool");
    auto begin = structure<VkCommandBufferBeginInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO);
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    check(vkBeginCommandBuffer(list, &begin), "vkBeginCommandBuffer");
    recording = true;
    marks = 0;
    stage_names.clear();
    return list;
}

void Commands::State::mark() {
    VkCommandBuffer to = open();
    const std::uint32_t place = marks % kPoolMarks;
    const std::size_t which = marks / kPoolMarks;
    if (which == mark_pools.size()) {
        auto create = structure<VkQueryPoolCreateInfo>(VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO);
        create.queryType = VK_QUERY_TYPE_TIMESTAMP;
        create.queryCount = kPoolMarks;
        VkQueryPool queries = VK_NULL_HANDLE;
        mark_pools.reserve(which + 1);
        check(vkCreateQueryPool(context->device, &create, nullptr, &queries), "vkCreateQueryPool");
        mark_pools.push_back(queries);
    }
    if (place == 0) vkCmdResetQueryPool(to, mark_pools[which], 0, kPoolMarks);
    vkCmdWriteTimestamp2(to, VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT, mark_pools[which], place);
    ++marks;
}

std::vector<StageTime> Commands::State::stage_times() const {
    std::vector<std::uint64_t> ticks(marks);
    for (std::uint32_t first = 0; first < marks; first += kPoolMarks) {
        const std::uint32_t count = std::min(kPoolMarks, marks - first);
        check(vkGetQueryPoolResults(context->device, mark_pools[first / kPoolMarks], 0, count,
                                    count * sizeof(ticks[0]), ticks.data() + first, sizeof(ticks[0]),
                                    VK_QUERY_RESULT_64_BIT | VK_QUERY_RESULT_WAIT_BIT),
              "vkGetQueryPoolResults");
    }
    const double tick_s = 1e-9 * static_cast<double>(context->limits.timestampPeriod);
    std::vector<StageTime> times;
    for (std::size_t i = 0; i < stage_names.size(); ++i) {
        const std::uint64_t took = (ticks[2 * i + 1] - ticks[2 * i]) & context->timestamp_mask;
        const auto is_this = [&](const StageTime& t) { return t.name == stage_names[i]; };
        auto at = std::find_if(times.begin(), times.end(), is_this);
        if (at == times.end()) at = times.insert(at, {stage_names[i], 0});
        at->seconds += tick_s * static_cast<double>(took);
    }
    return times;
}

Commands::Commands(Commands&& other) noexcept = default;
Commands& Commands::operator=(Commands&& other) noexcept = default;
Commands::~Commands() = default;

Commands::Commands(const Device& device) : state_(std::make_unique<State>()) {
    State& s = *state_;
    s.context = device.context_;
    VkDevice logical = s.context->device;
    auto pool = structure<VkCommandPoolCreateInfo>(VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO);
    pool.flags = VK_COMMAND_POOL_CREATE_TRANSIENT_BIT;
    pool.queueFamilyIndex = s.context->queue_family;
    check(vkCreateCommandPool(logical, &pool, nullptr, &s.pool), "vkCreateCommandPool");
    auto allocate = structure<VkCommandBufferAllocateInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO);
    allocate.commandPool = s.pool;
    allocate.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
    allocate.commandBufferCount = 1;
    check(vkAllocateCommandBuffers(logical, &allocate, &s.list), "vkAllocateCommandBuffers");
    auto fence = structure<VkFenceCreateInfo>(VK_STRUCTURE_TYPE_FENCE_CREATE_INFO);
    check(vkCreateFence(logical, &fence, nullptr, &s.fence), "vkCreateFence");
}

void Commands::dispatch(const Kernel& kernel, std::span<const std::byte> push, Groups groups) {
    const Kernel::State& k = *kernel.state_;
    [[maybe_unused]] const std::uint32_t* most = state_->context->limits.maxComputeWorkGroupCount;
    assert(push.size() == k.push_bytes);
    assert(groups.x <= most[0] && groups.y <= most[1] && groups.z <= most[2]);
    if (groups.x == 0 || groups.y == 0 || groups.z == 0) return;
    VkCommandBuffer list = state_->open();
    vkCmdBindPipeline(list, VK_PIPELINE_BIND_POINT_COMPUTE, k.pipeline);
    if (k.push_bytes > 0)
        vkCmdPushConstants(list, k.layout, VK_SHADER_STAGE_COMPUTE_BIT, 0, k.push_bytes, push.data());
    vkCmdDispatch(list, groups.x, groups.y, groups.z);
}

void Commands::draw(const RasterKernel& kernel, std::span<const std::byte> push, const Viewport& viewport,
                    std::span<const VertexRange> ranges) {
    const RasterKernel::State& k = *kernel.state_;
    assert(push.size() == k.push_bytes);
    VkCommandBuffer list = state_->open();
    auto rendering = structure<VkRenderingInfo>(VK_STRUCTURE_TYPE_RENDERING_INFO);
    rendering.renderArea.extent = {viewport.width, viewport.height};
    rendering.layerCount = 1;
    vkCmdBeginRendering(list, &rendering);
    vkCmdBindPipeline(list, VK_PIPELINE_BIND_POINT_GRAPHICS, k.pipeline);
    const auto side = static_cast<float>(viewport.side);
    const VkViewport to{static_cast<float>(viewport.x), static_cast<float>(viewport.y), side, side, 0, 1};
    vkCmdSetViewport(list, 0, 1, &to);
    vkCmdSetScissor(list, 0, 1, &rendering.renderArea);
    if (k.push_bytes > 0)
        vkCmdPushConstants(list, k.layout, VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT, 0, k.push_bytes,
                           push.data());
    for (const VertexRange& range : ranges) vkCmdDraw(list, range.count, 1, range.first, 0);
    vkCmdEndRendering(list);
}

void Commands::barrier() {
    const VkPipelineStageFlags2 stages = work(*state_->context);
    memory_barrier(state_->open(), stages, stages, kReads | kWrites);
}

void Commands::fill(const Buffer& buffer, std::uint64_t offset, std::uint64_t bytes, std::uint32_t value) {
    assert(offset % 4 == 0 && bytes % 4 == 0 && offset <= buffer.bytes() && bytes <= buffer.bytes() - offset);
    if (bytes == 0) return;
    vkCmdFillBuffer(state_->open(), buffer.state_->buffer, offset, bytes, value);
}

void Commands::copy(const Buffer& from, std::uint64_t from_offset, const Buffer& to, std::uint64_t to_offset,
                    std::uint64_t bytes) {
    assert(from_offset <= from.bytes() && bytes <= from.bytes() - from_offset);
    assert(to_offset <= to.bytes() && bytes <= to.bytes() - to_offset);
    if (bytes == 0) return;
    const VkBufferCopy region{from_offset, to_offset, bytes};
    vkCmdCopyBuffer(state_->open(), from.state_->buffer, to.state_->buffer, 1, &region);
}

void Commands::begin_stage(std::string_view name) {
    assert(!state_->in_stage);
    state_->mark();
    // Once triangles were drawn, Mesa in software notes the time of a mark not before the next barrier.
    if (state_->context->info.why_no_triangles.empty()) barrier();
    state_->stage_names.emplace_back(name);
    state_->in_stage = true;
}

void Commands::end_stage() {
    assert(state_->in_stage);
    state_->mark();
    state_->in_stage = false;
}

std::vector<StageTime> Commands::submit_and_wait() {
    State& s = *state_;
    assert(!s.in_stage);
    if (!s.recording) return {};
    // A fence makes nothing visible: neither to the host's reads of mapped memory nor to the commands of the next list.
    const VkPipelineStageFlags2 stages = work(*s.context);
    memory_barrier(s.list, stages, VK_PIPELINE_STAGE_2_HOST_BIT | stages, VK_ACCESS_2_HOST_READ_BIT | kReads | kWrites);
    s.recording = false;
    check(vkEndCommandBuffer(s.list), "vkEndCommandBuffer");

    VkDevice device = s.context->device;
    auto list = structure<VkCommandBufferSubmitInfo>(VK_STRUCTURE_TYPE_COMMAND_BUFFER_SUBMIT_INFO);
    list.commandBuffer = s.list;
    auto submit = structure<VkSubmitInfo2>(VK_STRUCTURE_TYPE_SUBMIT_INFO_2);
    submit.commandBufferInfoCount = 1;
    submit.pCommandBufferInfos = &list;
    check(vkResetFences(device, 1, &s.fence), "vkResetFences");
    check(vkQueueSubmit2(s.context->queue, 1, &submit, s.fence), "vkQueueSubmit2");
    check(vkWaitForFences(device, 1, &s.fence, VK_TRUE, UINT64_MAX), "vkWaitForFences");
    return s.stage_times();
}

}  // namespace pellucid::vulkan
