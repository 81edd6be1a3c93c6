#include "vulkan/volume_caster.hpp"

#include <algorithm>
#include <array>

#include "core/error.hpp"
#include "cpu/packed_volume.hpp"
#include "vulkan/cast_volumes.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kListWords[] = {
#include "shaders/volume_list.comp.inc"
};

struct CastPush {
    std::uint64_t setup;
    std::uint64_t sink;
    std::uint32_t first, count;
};

/// Nothing that a ray of this many steps meets is lost to float32.
constexpr double kMostSteps = 1 << 20;

[[nodiscard]] std::span<const std::uint32_t> shader_of(SinkKind) { return kListWords; }

}  // namespace

struct VolumeCaster::Parts {
    const Device* device;
    std::uint32_t packets;  // of the image
    std::unique_ptr<CastVolumes> fast;
    std::optional<Kernel> cast;
};

VolumeCaster::VolumeCaster(const Device& device, const PreparedScene& scene, const VolumeObject& volume,
                           const CastSettings& settings, SinkKind sink)
    : parts_(std::make_unique<Parts>()) {
    Parts& p = *parts_;
    p.device = &device;
    p.packets = packets_of_image(scene.camera);
    if (volume.bounds().empty()) return;
    const bool fits = scene.camera.far() / settings.step < kMostSteps ||
                      length(volume.bounds().size()) / settings.step < kMostSteps;
    if (!PackedVolume::takes(volume) || !fits) throw run_error("not yet");
    const std::array<const VolumeObject*, 1> one{&volume};
    p.fast = std::make_unique<CastVolumes>(device, scene, one, settings, 1);
    if (!device.info().is_gpu && p.fast->most_iterations() > kMostIterations)
        throw run_error("volume \"{}\": {:.0f} steps a ray are more than Vulkan in software walks", volume.settings().name,
                        length(volume.bounds().size()) / settings.step);
    p.cast.emplace(device, shader_of(sink),
                   KernelSettings{.push_bytes = sizeof(CastPush), .constants = p.fast->constants()});
}
VolumeCaster::~VolumeCaster() = default;
VolumeCaster::VolumeCaster(VolumeCaster&&) noexcept = default;

std::uint64_t VolumeCaster::bytes() const { return parts_->fast ? parts_->fast->bytes() : 0; }

std::uint32_t VolumeCaster::band_rays() const {
    return (parts_->fast ? parts_->fast->band() : 0) * twin::kPacketRaysT;
}

void VolumeCaster::record(Commands& commands, std::uint64_t sink, float least_clear) {
    Parts& p = *parts_;
    if (!p.fast) return;
    p.fast->setup.least_clear = least_clear;
    p.fast->send();
    for (std::uint32_t first = 0; first < p.packets; first += p.fast->band()) {
        const std::uint32_t count = std::min(p.fast->band(), p.packets - first);
        commands.begin_stage("rays");
        p.fast->record_rays(commands, first, count, 0);
        commands.end_stage();
        commands.barrier();
        commands.begin_stage("cast");
        commands.dispatch(*p.cast, CastPush{p.fast->address(), sink, first, count},
                          p.device->groups_for(std::uint64_t{count} * twin::kPacketRaysT, p.fast->group_size()));
        commands.end_stage();
        commands.barrier();
    }
}

// ---- All slabs of every pixel

namespace {

/// As slab_list.glsl reads it.
struct ListSink {
    std::uint64_t slabs, counts;
    std::uint32_t room;
    float opaque_at;
};

/// Runs until no pixel has more slabs than there is room for.
template <class Record>
[[nodiscard]] SlabLists gather_lists(const Device& device, std::size_t pixels, float opaque_at, const Record& record) {
    Buffer counts(device, pixels * sizeof(std::uint32_t));
    std::vector<std::uint32_t> count(pixels);
    for (std::uint32_t room = 64;;) {
        Buffer slabs(device, pixels * room * sizeof(twin::Slab));
        const ListSink list{slabs.address(), counts.address(), room, opaque_at};
        const Buffer sink = filled(device, std::span(&list, 1));
        Commands commands(device);
        commands.fill(counts, 0, counts.bytes(), 0);
        commands.barrier();
        record(commands, sink.address());
        commands.submit_and_wait();
        download(device, counts, std::as_writable_bytes(std::span(count)));
        const std::uint32_t most = *std::ranges::max_element(count);
        if (most > room) {
            room = most;
            continue;
        }
        std::vector<twin::Slab> all(pixels * room);
        download(device, slabs, std::as_writable_bytes(std::span(all)));
        SlabLists lists(pixels);
        for (std::size_t i = 0; i < pixels; ++i) {
            const auto first = all.begin() + static_cast<std::ptrdiff_t>(i * room);
            lists[i].assign(first, first + static_cast<std::ptrdiff_t>(count[i]));
        }
        return lists;
    }
}

[[nodiscard]] std::size_t pixels_of(const PreparedScene& scene) {
    return static_cast<std::size_t>(scene.camera.width()) * static_cast<std::size_t>(scene.camera.height());
}

}  // namespace

SlabLists cast_slabs(const Device& device, const PreparedScene& scene, const VolumeObject& volume,
                     const CastSettings& settings, float opaque_at) {
    VolumeCaster caster(device, scene, volume, settings, SinkKind::list);
    return gather_lists(device, pixels_of(scene), opaque_at, [&](Commands& commands, std::uint64_t sink) {
        caster.record(commands, sink, 1 - opaque_at);
    });
}

}  // namespace pellucid::vulkan
