// Headless Vulkan in six things: a device, buffers that shaders reach by their address, kernels (and kernels that draw
// triangles), one list of commands at a time, and the times of its stages. A pass reads: barrier, push, dispatch.
//
// Shaders get addresses in their push constants (GL_EXT_buffer_reference) and no descriptors, so a buffer
// may be larger than the largest storage-buffer binding. Buffers, kernels and commands keep what they
// need of their device alive, so they may go in any order. One thread uses a device at a time.
//
// Every call is checked in every build type: `run_error("vkAllocateMemory: VK_ERROR_OUT_OF_HOST_MEMORY")`.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace pellucid::vulkan {

struct DeviceInfo {
    std::string name;
    std::string driver;  // its name and version
    bool is_gpu = false;
    bool usable = false;
    std::string why_not;                   // one line where not usable
    std::uint64_t heap_bytes = 0;          // largest device-local heap
    std::uint64_t largest_allocation = 0;  // bytes of one buffer
    std::uint64_t shared_bytes = 0;        // of one workgroup
    std::uint32_t subgroup_size = 0;
    std::uint32_t max_workgroup_size = 0;  // invocations
    bool shared_int64_atomics = false;
    bool float64 = false;                  // double precision in shaders
    std::string why_no_triangles;          // what RasterKernel would need, one line; empty where it is there
    std::uint32_t subpixel_bits = 0;       // of the rasteriser
    std::uint32_t largest_viewport = 0;    // pixels, in either direction
};

/// All devices, usable or not; empty without a driver.
[[nodiscard]] std::vector<DeviceInfo> list_devices();

struct DeviceOptions {
    std::string name = {};   // part of a device's name in any case; several match, or empty: a real GPU first
    bool validate = false;   // the Khronos validation layer with synchronisation validation
    bool stage_all = false;  // buffers of kind `device` are never mapped, as on a GPU with memory of its own
};

/// Workgroups along x, y, z.
struct Groups {
    std::uint32_t x = 1;
    std::uint32_t y = 1;
    std::uint32_t z = 1;
};

struct Context;  // what the objects below share: instance, device, queue, counts (context.hpp)

class Device {
public:
    /// Throws Error of kind `device` where no device of that name is there or it lacks a feature that the
    /// shaders need: Vulkan 1.3, 64-bit integers and atomics, buffer addresses, scalar layout, timestamps.
    explicit Device(const DeviceOptions& options = {});

    [[nodiscard]] const DeviceInfo& info() const;
    /// Bytes of all buffers there are now, and the most there have been at a time.
    [[nodiscard]] std::uint64_t bytes_held() const;
    [[nodiscard]] std::uint64_t peak_bytes() const;
    /// What the validation layer said: warnings and errors, each text once. Also printed on stderr.
    [[nodiscard]] std::vector<std::string> validation_messages() const;

    /// Enough workgroups for so many invocations, in as few rows as the device allows. The last may reach
    /// beyond; an invocation's number is its place in
    /// `gl_WorkGroupID.x + gl_NumWorkGroups.x * gl_WorkGroupID.y` workgroups.
    [[nodiscard]] Groups groups_for(std::uint64_t invocations, std::uint32_t workgroup_size) const;

private:
    friend class Buffer;
    friend class Kernel;
    friend class RasterKernel;
    friend class Commands;
    std::shared_ptr<Context> context_;
};

enum class BufferKind {
    device,    // fast for shaders; mapped too where host and device share their memory
    upload,    // written by the host, mapped
    readback,  // read by the host, mapped
};

/// Uninitialised memory that shaders read and write; goes with its owner.
class Buffer {
public:
    /// No memory: 0 bytes at address 0.
    Buffer() noexcept;
    /// Throws an Error of kind `run` where the device has not so much.
    Buffer(const Device& device, std::uint64_t bytes, BufferKind kind = BufferKind::device);
    Buffer(Buffer&& other) noexcept;
    Buffer& operator=(Buffer&& other) noexcept;
    ~Buffer();

    [[nodiscard]] std::uint64_t bytes() const;
    /// For shaders; 0 where the buffer is empty, else a multiple of 16.
    [[nodiscard]] std::uint64_t address() const;
    /// The bytes as the host sees them; empty where it cannot. Only between submissions.
    [[nodiscard]] std::span<std::byte> mapped() const;

private:
    friend class Commands;
    struct State;
    std::unique_ptr<State> state_;
};

struct KernelSettings {
    std::uint32_t push_bytes = 0;                   // of push constants: <= 128, a multiple of 4
    std::span<const std::uint32_t> constants = {};  // bits of the specialisation constants 0, 1, …
};

/// A compute shader ready to run; its entry point is `main`.
class Kernel {
public:
    Kernel(const Device& device, std::span<const std::uint32_t> spirv, const KernelSettings& settings = {});
    Kernel(Kernel&& other) noexcept;
    Kernel& operator=(Kernel&& other) noexcept;
    ~Kernel();

private:
    friend class Commands;
    struct State;
    std::unique_ptr<State> state_;
};

/// A vertex and a fragment shader. They draw triangles, in any order and without an image: what comes of it is
/// what the fragment shader writes to buffers.
class RasterKernel {
public:
    /// Throws Error(device) where info().why_no_triangles says why.
    RasterKernel(const Device& device, std::span<const std::uint32_t> vertex, std::span<const std::uint32_t> fragment,
                 const KernelSettings& settings = {});
    RasterKernel(RasterKernel&& other) noexcept;
    RasterKernel& operator=(RasterKernel&& other) noexcept;
    ~RasterKernel();

private:
    friend class Commands;
    struct State;
    std::unique_ptr<State> state_;
};

/// Where normalised coordinates -1 … 1 go, in pixels; drawn are the pixels from (0, 0) to (width, height) alone.
struct Viewport {
    std::int32_t x = 0, y = 0;
    std::uint32_t side = 0;
    std::uint32_t width = 0, height = 0;
};
struct VertexRange {
    std::uint32_t first, count;
};

struct StageTime {
    std::string name;
    double seconds = 0;  // on the device's clock
};

/// A list of commands: recorded, submitted once, then recorded anew. Commands run in their order, but
/// without a barrier they may overlap. What they name must live until they have run.
class Commands {
public:
    explicit Commands(const Device& device);
    Commands(Commands&& other) noexcept;
    Commands& operator=(Commands&& other) noexcept;
    ~Commands();

    /// `push` has the kernel's push_bytes. Each number of groups is within the device's limit (groups_for).
    void dispatch(const Kernel& kernel, std::span<const std::byte> push, Groups groups);
    template <class Push>
    void dispatch(const Kernel& kernel, const Push& push, Groups groups) {
        static_assert(std::is_trivially_copyable_v<Push>);
        dispatch(kernel, std::as_bytes(std::span(&push, 1)), groups);
    }
    /// Triangles of three vertices each; gl_VertexIndex counts from a range's first.
    void draw(const RasterKernel& kernel, std::span<const std::byte> push, const Viewport& viewport,
              std::span<const VertexRange> ranges);
    /// What follows sees all that came before has written, by shaders, fills and copies.
    void barrier();
    /// Offset and bytes: multiples of 4, within the buffer.
    void fill(const Buffer& buffer, std::uint64_t offset, std::uint64_t bytes, std::uint32_t value);
    void copy(const Buffer& from, std::uint64_t from_offset, const Buffer& to, std::uint64_t to_offset,
              std::uint64_t bytes);

    /// The time of what is recorded between the two; stages do not nest, and one name may come often. A
    /// stage begins when all before it is done, so what overlaps is not counted twice.
    void begin_stage(std::string_view name);
    void end_stage();

    /// Runs all of it; mapped buffers are then up to date. Times by name, in order of first appearance.
    std::vector<StageTime> submit_and_wait();

private:
    struct State;
    std::unique_ptr<State> state_;
};

/// Host to device and back, whatever the buffer's kind: by its mapping, or else through another buffer
/// of at most 64 MiB. Offset + size lie within the buffer.
void upload(const Device& device, const Buffer& buffer, std::span<const std::byte> bytes,
            std::uint64_t offset = 0);
void download(const Device& device, const Buffer& buffer, std::span<std::byte> bytes,
              std::uint64_t offset = 0);

}  // namespace pellucid::vulkan
