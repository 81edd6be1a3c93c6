#include "vulkan/slab_pipeline.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <optional>

#include "core/gauss_legendre.hpp"
#include "kernel/slab_twin.h"
#include "stage/slab_compression.hpp"
#include "stage/virtual_slab.hpp"
#include "vulkan/cast_volumes.hpp"
#include "vulkan/peeling.hpp"
#include "vulkan/volume_caster.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kIntermixWords[] = {
#include "shaders/slab_intermix.comp.inc"
};
constexpr std::uint32_t kFragmentsWords[] = {
#include "shaders/slab_fragments.comp.inc"
};
constexpr std::uint32_t kImageWords[] = {
#include "shaders/slab_image.comp.inc"
};
constexpr std::uint32_t kOrderFreeWords[] = {
#include "shaders/slab_order_free.comp.inc"
};

/// As slab_frame.glsl has it.
struct FrameSetup {
    std::uint64_t words, flags, nearest;
    std::uint64_t nodes, costs, merged, given, arrivals;
    std::uint32_t stride;
    std::uint32_t layers;
    float opaque_at;
    float negligible;
    std::uint32_t given_room;
    std::uint32_t seen;
};
static_assert(sizeof(FrameSetup) == 8 * 8 + 6 * 4 && offsetof(FrameSetup, stride) == 64);
constexpr std::uint64_t kNodeBytes = sizeof(twin::Slab) + 2 * sizeof(float);
constexpr std::uint64_t kArrivalBytes = 3 * sizeof(std::uint32_t);

/// Pixels whose rooms are there at a time, where no ray is cast.
constexpr std::uint32_t kPixelsAtOnce = 1U << 16U;
/// Virtual slabs of one object in one pixel: what comes behind joins the last of them.
constexpr std::uint32_t kMostGiven = 64;
/// Of the rooms of all invocations together: fewer at a time where arrays are long.
constexpr std::uint64_t kMostRoomBytes = std::uint64_t{1} << 30U;
constexpr std::uint64_t kMostRoomBytesInSoftware = std::uint64_t{1} << 26U;

/// Nodes that an invocation has room for: the collector's, or the order-free merge's of so many arrays.
[[nodiscard]] std::uint64_t nodes_of_room(int layers, std::size_t frames) {
    return std::max<std::uint64_t>({2 * (static_cast<std::uint64_t>(layers) - 1), 8, frames});
}
[[nodiscard]] std::uint64_t bytes_of_room(int layers, std::uint32_t given_room, std::size_t frames) {
    return nodes_of_room(layers, frames) * (kNodeBytes + sizeof(float)) +
           (static_cast<std::uint64_t>(layers) - 1 + given_room) * sizeof(twin::Slab) + kArrivalBytes;
}
[[nodiscard]] std::uint32_t invocations_of_rooms(const Device& device, int layers, std::uint32_t given_room, std::size_t frames) {
    const std::uint64_t most = device.info().is_gpu ? kMostRoomBytes : kMostRoomBytesInSoftware;
    return static_cast<std::uint32_t>(std::max<std::uint64_t>(1, most / bytes_of_room(layers, given_room, frames)));
}

/// A z-thickness buffer and what is nearest in each pixel.
struct DeviceFrame {
    DeviceFrame(const Device& device, const ZThicknessSize& size)
        : words(device, ZThicknessBuffer::planned_bytes(size)),
          flags(device, (pixels(size) + 31) / 32 * sizeof(std::uint32_t)),
          nearest(device, pixels(size) * sizeof(float)),
          setup(device, sizeof(FrameSetup)) {
        Commands commands(device);
        commands.fill(flags, 0, flags.bytes(), 0);
        commands.fill(nearest, 0, nearest.bytes(), 0x7f800000U);  // +inf
        commands.submit_and_wait();
    }
    [[nodiscard]] static std::uint64_t pixels(const ZThicknessSize& size) {
        return static_cast<std::uint64_t>(size.width) * static_cast<std::uint64_t>(size.height);
    }
    [[nodiscard]] std::uint64_t bytes() const { return words.bytes() + flags.bytes() + nearest.bytes(); }

    Buffer words, flags, nearest, setup;
};

struct IntermixPush {
    std::uint64_t frame;
    std::uint32_t count;
};
struct FragmentsPush {
    std::uint64_t frame, passes;
    std::uint32_t pass_count, pixels, first, count;
};
struct ImagePush {
    std::uint64_t frame, planes;
    std::uint32_t pixels;
};
struct OrderFreePush {
    std::uint64_t frames, nodes, planes;
    std::uint32_t frame_count, pixels, first, count;
};

class DevicePipeline final : public SlabPipeline {
public:
    DevicePipeline(const Device& device, const PreparedScene& scene, const ZThicknessSize& size, const SlabSettings& settings)
        : device_(with_doubles(device)),
          scene_(scene),
          size_(size),
          settings_(settings),
          pixels_(static_cast<std::uint32_t>(DeviceFrame::pixels(size))),
          group_(cast_group_size(device)),
          intermix_(make_kernel(kIntermixWords, sizeof(IntermixPush))),
          fragments_(make_kernel(kFragmentsWords, sizeof(FragmentsPush))) {}

    void add_polygons(const SceneMeshes& meshes, std::uint32_t object, int surfaces, SlabStageStats& stats) override {
        if (!peeler_) peeler_.emplace(device_, scene_, meshes, PeelerSettings{.targets = settings_.targets});
        DeviceFrame& frame = next_frame();
        struct Targets {
            Buffer slabs, counts;
        };
        std::vector<Targets> passes;
        const PeelStats peeled = peeler_->peel(std::span(&object, 1), {.layers = surfaces}, [&](const PeeledTargets& found) {
            Targets& kept = passes.emplace_back(Buffer(device_, found.slabs.bytes()), Buffer(device_, found.counts.bytes()));
            Commands commands(device_);
            commands.copy(found.slabs, 0, kept.slabs, 0, kept.slabs.bytes());
            commands.copy(found.counts, 0, kept.counts, 0, kept.counts.bytes());
            commands.submit_and_wait();
        });
        stats.fragments += peeled.fragments;
        // The peeler counts all that the device holds.
        stats.bytes = std::max(stats.bytes, static_cast<std::int64_t>(peeled.bytes) - static_cast<std::int64_t>(bytes()));
        if (passes.empty()) return;
        std::vector<std::uint64_t> table;
        for (const Targets& pass : passes) {
            table.push_back(pass.slabs.address());
            table.push_back(pass.counts.address());
        }
        const Buffer addresses = filled(device_, table);
        const auto targets = static_cast<std::uint32_t>(settings_.targets);
        const std::uint32_t given = std::max(most_slabs(), std::min(kMostGiven, static_cast<std::uint32_t>(passes.size()) * targets));
        const std::uint32_t at_once = std::min({pixels_, kPixelsAtOnce, most_invocations(given)});
        use(frame, at_once, given);
        Commands commands(device_);
        commands.begin_stage("kernel");
        for (std::uint32_t first = 0; first < pixels_; first += at_once) {
            const std::uint32_t count = std::min(at_once, pixels_ - first);
            commands.dispatch(fragments_,
                              FragmentsPush{frame.setup.address(), addresses.address(), static_cast<std::uint32_t>(passes.size()), pixels_,
                                            first, count},
                              device_.groups_for(count, group_));
            commands.barrier();
        }
        commands.end_stage();
        run(commands);
    }

    void add_isosurface(const Object& object, const CastSettings& settings, SlabStageStats& stats) override {
        const double pitch = voxel_pitch(object.geometry->field_surface()->to_world);
        IsosurfaceCaster caster(device_, scene_, object, fixed_thickness(scene_, object).value_or(pitch), settings, {SinkKind::give, slab_constants()});
        DeviceFrame& frame = next_frame();
        const std::uint32_t given = std::max(most_slabs(), kMostGiven);
        caster.limit_band(most_invocations(given));
        use(frame, std::max(1U, caster.band_rays()), given);
        Commands commands(device_);
        caster.record(commands, frame.setup.address(), hooks(commands, frame));
        run(commands);
        caster.check();
        stats.slabs += seen(frame);
        stats.bytes = std::max(stats.bytes, static_cast<std::int64_t>(caster.bytes()));
    }

    void add_volume(const VolumeObject& volume, const CastSettings& settings, bool on_the_fly, SlabStageStats& stats) override {
        VolumeCaster caster(device_, scene_, volume, settings, {on_the_fly ? SinkKind::merge : SinkKind::collect, slab_constants()});
        DeviceFrame& frame = next_frame();
        caster.limit_band(most_invocations(most_slabs()));
        use(frame, std::max(1U, caster.band_rays()), most_slabs(), SlabCollector::negligible_cost(settings_, settings.step));
        Commands commands(device_);
        const float least = 1 - settings_.opaque_at;
        if (on_the_fly) caster.record(commands, frame.setup.address(), least);
        else caster.record(commands, frame.setup.address(), std::max(least, SlabCollector::kNothing), hooks(commands, frame));
        run(commands);
        caster.check();
        stats.slabs += seen(frame);
        stats.bytes = std::max(stats.bytes, static_cast<std::int64_t>(caster.bytes()));
    }

    [[nodiscard]] Image image() override {
        if (frames_.empty()) (void)next_frame();
        Image image(size_.width, size_.height);
        const Buffer planes(device_, std::uint64_t{5} * pixels_ * sizeof(float));
        if (settings_.intermix == SlabIntermix::order_free) order_free(planes);
        else first_layer(planes);
        std::vector<float> all(std::size_t{5} * pixels_);
        const Buffer back(device_, planes.bytes(), BufferKind::readback);
        Commands commands(device_);
        commands.begin_stage("read-back");
        commands.copy(planes, 0, back, 0, planes.bytes());
        commands.end_stage();
        run(commands);
        download(device_, back, std::as_writable_bytes(std::span(all)));
        const std::array<const char*, 5> names{"R", "G", "B", "A", "Z"};
        for (std::size_t i = 0; i < names.size(); ++i) {
            const auto from = all.begin() + static_cast<std::ptrdiff_t>(i * pixels_);
            std::copy(from, from + pixels_, image.add(names[i]).begin());
        }
        return image;
    }

    [[nodiscard]] std::size_t bytes() const override {
        std::uint64_t sum = nodes_.bytes() + costs_.bytes() + merged_.bytes() + given_.bytes() + arrivals_.bytes();
        for (const auto& frame : frames_) sum += frame->bytes();
        return sum;
    }
    [[nodiscard]] std::size_t buffers() const override { return frames_.size(); }
    [[nodiscard]] std::vector<pellucid::StageTime> device_times() const override {
        std::vector<pellucid::StageTime> all = peeler_ ? peeler_->device_times() : std::vector<pellucid::StageTime>();
        for (const pellucid::StageTime& time : times_) add_time(all, time.name, time.device_s);
        return all;
    }

private:
    [[nodiscard]] Kernel make_kernel(std::span<const std::uint32_t> words, std::size_t push_bytes) const {
        std::vector<std::uint32_t> constants(kSlabConstants);
        constants[0] = group_;
        for (const std::uint32_t constant : slab_constants()) constants.push_back(constant);
        return {device_, words, {.push_bytes = static_cast<std::uint32_t>(push_bytes), .constants = constants}};
    }
    /// As slab_frame.glsl has them.
    [[nodiscard]] std::array<std::uint32_t, 4> slab_constants() const {
        return {static_cast<std::uint32_t>(settings_.interpolation), static_cast<std::uint32_t>(settings_.mixing),
                static_cast<std::uint32_t>(settings_.compression), static_cast<std::uint32_t>(size_.format)};
    }
    [[nodiscard]] std::uint32_t most_slabs() const { return static_cast<std::uint32_t>(size_.layers) - 1; }

    [[nodiscard]] DeviceFrame& next_frame() {
        if (frames_.empty() || settings_.intermix == SlabIntermix::order_free)
            frames_.push_back(std::make_unique<DeviceFrame>(device_, size_));
        return *frames_.back();
    }

    [[nodiscard]] std::uint32_t most_invocations(std::uint32_t given_room) const {
        return invocations_of_rooms(device_, size_.layers, given_room, frames_.size());
    }

    /// Rooms for so many invocations at a time, of which each may be given so many slabs; the frame's setup says where.
    /// negligible: as SlabCollector's, of what is cast next.
    void use(DeviceFrame& frame, std::uint32_t stride, std::uint32_t given_room, float negligible = 0) {
        const auto grow = [&](Buffer& buffer, std::uint64_t bytes) {
            if (buffer.bytes() >= bytes) return;
            buffer = {};
            buffer = Buffer(device_, bytes);
        };
        const std::uint64_t node_room = nodes_of_room(size_.layers, frames_.size());
        grow(nodes_, stride * node_room * kNodeBytes);
        grow(costs_, stride * node_room * sizeof(float));
        grow(merged_, std::uint64_t{stride} * most_slabs() * sizeof(twin::Slab));
        grow(given_, std::uint64_t{stride} * given_room * sizeof(twin::Slab));
        grow(arrivals_, stride * kArrivalBytes);
        const FrameSetup setup{.words = frame.words.address(),
                               .flags = frame.flags.address(),
                               .nearest = frame.nearest.address(),
                               .nodes = nodes_.address(),
                               .costs = costs_.address(),
                               .merged = merged_.address(),
                               .given = given_.address(),
                               .arrivals = arrivals_.address(),
                               .stride = stride,
                               .layers = static_cast<std::uint32_t>(size_.layers),
                               .opaque_at = settings_.opaque_at,
                               .negligible = negligible,
                               .given_room = given_room,
                               .seen = 0};
        upload(device_, frame.setup, std::as_bytes(std::span(&setup, 1)));
    }
    [[nodiscard]] std::uint32_t seen(const DeviceFrame& frame) const {
        FrameSetup setup;
        download(device_, frame.setup, std::as_writable_bytes(std::span(&setup, 1)));
        return setup.seen;
    }

    /// Of a band: no ray has left anything; then the kernel takes what they have left.
    [[nodiscard]] BandHooks hooks(Commands& commands, const DeviceFrame& frame) {
        return {.before =
                    [&] {
                        commands.fill(arrivals_, 0, arrivals_.bytes(), 0);
                        commands.barrier();
                    },
                .after =
                    [&](std::uint32_t rays) {
                        commands.begin_stage("kernel");
                        commands.dispatch(intermix_, IntermixPush{frame.setup.address(), rays}, device_.groups_for(rays, group_));
                        commands.end_stage();
                        commands.barrier();
                    }};
    }

    void first_layer(const Buffer& planes) {
        const Kernel kernel = make_kernel(kImageWords, sizeof(ImagePush));
        use(*frames_.front(), 1, most_slabs());
        Commands commands(device_);
        commands.begin_stage("kernel");
        commands.dispatch(kernel, ImagePush{frames_.front()->setup.address(), planes.address(), pixels_},
                          device_.groups_for(pixels_, group_));
        commands.end_stage();
        run(commands);
    }

    void order_free(const Buffer& planes) {
        const Kernel kernel = make_kernel(kOrderFreeWords, sizeof(OrderFreePush));
        const auto count = static_cast<std::uint32_t>(frames_.size());
        // Next slabs, what has begun, and parts: of each array one without thickness besides.
        const std::uint32_t room = 6 * count + 2;
        const std::uint32_t at_once = std::min({pixels_, kPixelsAtOnce, most_invocations(std::max(room, most_slabs()))});
        std::vector<std::uint64_t> table;
        for (const auto& frame : frames_) {
            use(*frame, at_once, std::max(room, most_slabs()));
            table.push_back(frame->setup.address());
        }
        // Rooms may have grown since the first frame's setup was written.
        for (const auto& frame : frames_) use(*frame, at_once, std::max(room, most_slabs()));
        std::vector<QuadratureNode> nodes;
        for (std::uint32_t n = 1; n <= count + 1; ++n)
            for (const QuadratureNode& node : gauss_legendre(n)) nodes.push_back(node);
        const Buffer addresses = filled(device_, table), quadrature = filled(device_, nodes);
        Commands commands(device_);
        commands.begin_stage("kernel");
        for (std::uint32_t first = 0; first < pixels_; first += at_once) {
            const std::uint32_t now = std::min(at_once, pixels_ - first);
            commands.dispatch(kernel, OrderFreePush{addresses.address(), quadrature.address(), planes.address(), count, pixels_, first, now},
                              device_.groups_for(now, group_));
            commands.barrier();
        }
        commands.end_stage();
        run(commands);
    }

    static void add_time(std::vector<pellucid::StageTime>& all, const std::string& name, double seconds) {
        const auto found = std::ranges::find(all, name, &pellucid::StageTime::name);
        if (found == all.end()) all.push_back({name, seconds});
        else found->device_s += seconds;
    }
    void run(Commands& commands) {
        for (const StageTime& time : commands.submit_and_wait()) add_time(times_, time.name, time.seconds);
    }

    const Device& device_;
    const PreparedScene& scene_;
    ZThicknessSize size_;
    SlabSettings settings_;
    std::uint32_t pixels_;
    std::uint32_t group_;
    Kernel intermix_, fragments_;
    std::optional<Peeler> peeler_;
    std::vector<std::unique_ptr<DeviceFrame>> frames_;
    Buffer nodes_, costs_, merged_, given_, arrivals_;
    std::vector<pellucid::StageTime> times_;
};

}  // namespace

std::unique_ptr<SlabPipeline> make_slab_pipeline(const Device& device, const PreparedScene& scene, const ZThicknessSize& size,
                                                 const SlabSettings& settings) {
    return std::make_unique<DevicePipeline>(device, scene, size, settings);
}

std::int64_t planned_slab_bytes(const Device& device, const PreparedScene& scene, const ZThicknessSize& size, const SlabSettings& settings,
                                std::size_t objects) {
    const std::size_t frames = settings.intermix == SlabIntermix::order_free ? objects : 1;
    const std::uint32_t given = std::max(static_cast<std::uint32_t>(size.layers) - 1, kMostGiven);
    const std::uint64_t rooms = std::min(packets_of_band(device, scene.camera) * twin::kPacketRaysT,
                                         invocations_of_rooms(device, size.layers, given, frames));
    return static_cast<std::int64_t>(frames * pellucid::planned_slab_bytes(size) + rooms * bytes_of_room(size.layers, given, frames));
}

std::int64_t planned_cast_bytes(const Device& device, const PreparedScene& scene, const VolumeObject& volume) {
    // Words of four samples each, distances of blocks; states of rays.
    const std::uint64_t rays = std::uint64_t{packets_of_band(device, scene.camera)} * twin::kPacketRaysT;
    return static_cast<std::int64_t>(volume.field().grid().values.size() * sizeof(std::uint64_t) +
                                     rays * (sizeof(twin::PacketRay) + sizeof(twin::VolumeRay) + sizeof(twin::RaySteps))) +
           EmptySpace::count_of(volume.cells());
}

}  // namespace pellucid::vulkan
