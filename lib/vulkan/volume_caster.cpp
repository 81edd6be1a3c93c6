#include "vulkan/volume_caster.hpp"

#include <algorithm>
#include <array>
#include <optional>

#include "cpu/packed_volume.hpp"
#include "vulkan/cast_volumes.hpp"
#include "vulkan/plain_casts.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kVolumeList[] = {
#include "shaders/volume_list.comp.inc"
};
constexpr std::uint32_t kPlainVolumeList[] = {
#include "shaders/plain_volume_list.comp.inc"
};
constexpr std::uint32_t kIsosurfaceList[] = {
#include "shaders/isosurface_list.comp.inc"
};
constexpr std::uint32_t kVolumeCollect[] = {
#include "shaders/volume_collect.comp.inc"
};
constexpr std::uint32_t kPlainVolumeCollect[] = {
#include "shaders/plain_volume_collect.comp.inc"
};
constexpr std::uint32_t kVolumeMerge[] = {
#include "shaders/volume_merge.comp.inc"
};
constexpr std::uint32_t kPlainVolumeMerge[] = {
#include "shaders/plain_volume_merge.comp.inc"
};
constexpr std::uint32_t kIsosurfaceGive[] = {
#include "shaders/isosurface_give.comp.inc"
};

struct CastPush {
    std::uint64_t setup;
    std::uint64_t sink;
    std::uint32_t first, count;
};

/// The shader of a stage for each kind of sink; none where the stage has no such sink.
struct StageShaders {
    std::span<const std::uint32_t> list, collect, merge, give;
    [[nodiscard]] std::span<const std::uint32_t> of(SinkKind sink) const {
        switch (sink) {
            case SinkKind::list: return list;
            case SinkKind::collect: return collect;
            case SinkKind::merge: return merge;
            case SinkKind::give: break;
        }
        return give;
    }
};
constexpr StageShaders kVolume{kVolumeList, kVolumeCollect, kVolumeMerge, {}};
constexpr StageShaders kPlainVolume{kPlainVolumeList, kPlainVolumeCollect, kPlainVolumeMerge, {}};
constexpr StageShaders kIsosurface{kIsosurfaceList, {}, {}, kIsosurfaceGive};

/// Nothing that a ray of this many steps meets is lost to float32.
constexpr double kMostSteps = 1 << 20;

[[nodiscard]] Kernel make_kernel(const Device& device, const StageShaders& shaders, const SinkChoice& sink,
                                 std::vector<std::uint32_t> constants) {
    constants.resize(kSlabConstants);
    constants.insert(constants.end(), sink.constants.begin(), sink.constants.end());
    return {device, shaders.of(sink.kind), {.push_bytes = sizeof(CastPush), .constants = constants}};
}

/// Packets of an image: all, and at a time.
struct Bands {
    std::uint32_t packets = 0;
    std::uint32_t most = ~0U;
    void limit(std::uint32_t rays) { most = std::max(1U, rays / twin::kPacketRaysT); }
};

/// All packets of an image, as many at a time as their rays' room holds.
template <class Casts, class Before>
void record_bands(const Device& device, Commands& commands, const Casts& casts, const Kernel& kernel, const Bands& bands,
                  std::uint64_t sink, const Before& before, const BandHooks& hooks) {
    casts.begin(commands);
    const std::uint32_t band = std::min(casts.band(), bands.most);
    for (std::uint32_t first = 0; first < bands.packets; first += band) {
        const std::uint32_t count = std::min(band, bands.packets - first);
        before(first, count);
        hooks.before();
        commands.begin_stage("cast");
        commands.dispatch(kernel, CastPush{casts.address(), sink, first, count},
                          device.groups_for(std::uint64_t{count} * twin::kPacketRaysT, casts.group_size()));
        commands.end_stage();
        commands.barrier();
        hooks.after(count * twin::kPacketRaysT);
    }
}

}  // namespace

// ---- One volume

struct VolumeCaster::Parts {
    const Device* device;
    Bands bands;
    std::optional<CastVolumes> fast;
    std::optional<PlainCasts> plain;
    std::optional<Kernel> kernel;
};

VolumeCaster::VolumeCaster(const Device& device, const PreparedScene& scene, const VolumeObject& volume,
                           const CastSettings& settings, const SinkChoice& sink)
    : parts_(std::make_unique<Parts>()) {
    Parts& p = *parts_;
    p.device = &device;
    p.bands.packets = packets_of_image(scene.camera);
    if (volume.bounds().empty()) return;
    const std::array<const VolumeObject*, 1> one{&volume};
    const bool fits = scene.camera.far() / settings.step < kMostSteps ||
                      length(volume.bounds().size()) / settings.step < kMostSteps;
    if (PackedVolume::takes(volume) && fits) {
        p.fast.emplace(device, scene, one, settings, 1);
        p.kernel = make_kernel(device, kVolume, sink, p.fast->constants());
    } else {
        p.plain.emplace(device, scene, one, settings, 1);
        p.kernel = make_kernel(device, kPlainVolume, sink, p.plain->constants());
    }
}
VolumeCaster::~VolumeCaster() = default;
VolumeCaster::VolumeCaster(VolumeCaster&&) noexcept = default;

std::uint64_t VolumeCaster::bytes() const {
    return parts_->fast ? parts_->fast->bytes() : parts_->plain ? parts_->plain->bytes() : 0;
}

std::uint32_t VolumeCaster::band_rays() const {
    const std::uint32_t band = parts_->fast ? parts_->fast->band() : parts_->plain ? parts_->plain->band() : 0;
    return std::min(band, parts_->bands.most) * twin::kPacketRaysT;
}
void VolumeCaster::limit_band(std::uint32_t rays) {
    parts_->bands.limit(rays);
}

void VolumeCaster::record(Commands& commands, std::uint64_t sink, float least_clear, const BandHooks& hooks) {
    Parts& p = *parts_;
    if (p.fast) {
        p.fast->setup.least_clear = least_clear;
        record_bands(*p.device, commands, *p.fast, *p.kernel, p.bands, sink,
                     [&](std::uint32_t first, std::uint32_t count) {
                         commands.begin_stage("rays");
                         p.fast->record_rays(commands, first, count, 0);
                         commands.end_stage();
                         commands.barrier();
                     },
                     hooks);
    }
    if (p.plain)
        record_bands(*p.device, commands, *p.plain, *p.kernel, p.bands, sink, [](std::uint32_t, std::uint32_t) {}, hooks);
}

void VolumeCaster::check() const {
    if (parts_->fast) parts_->fast->check();
    if (parts_->plain) parts_->plain->check();
}

// ---- One isosurface

struct IsosurfaceCaster::Parts {
    Parts(const Device& device_, const PreparedScene& scene, const Object& object, double thickness,
          const CastSettings& settings, const SinkChoice& sink)
        : device(&device_),
          bands{packets_of_image(scene.camera)},
          casts(device_, scene, std::array{&object}, std::array{thickness}, settings, 1),
          kernel(make_kernel(device_, kIsosurface, sink, casts.constants())) {}

    const Device* device;
    Bands bands;
    PlainCasts casts;
    Kernel kernel;
};

IsosurfaceCaster::IsosurfaceCaster(const Device& device, const PreparedScene& scene, const Object& object,
                                   double thickness, const CastSettings& settings, const SinkChoice& sink)
    : parts_(std::make_unique<Parts>(device, scene, object, thickness, settings, sink)) {}
IsosurfaceCaster::~IsosurfaceCaster() = default;
IsosurfaceCaster::IsosurfaceCaster(IsosurfaceCaster&&) noexcept = default;

std::uint64_t IsosurfaceCaster::bytes() const {
    return parts_->casts.bytes();
}
std::uint32_t IsosurfaceCaster::band_rays() const {
    return std::min(parts_->casts.band(), parts_->bands.most) * twin::kPacketRaysT;
}
void IsosurfaceCaster::limit_band(std::uint32_t rays) {
    parts_->bands.limit(rays);
}

void IsosurfaceCaster::record(Commands& commands, std::uint64_t sink, const BandHooks& hooks) {
    Parts& p = *parts_;
    record_bands(*p.device, commands, p.casts, p.kernel, p.bands, sink, [](std::uint32_t, std::uint32_t) {}, hooks);
}

void IsosurfaceCaster::check() const {
    parts_->casts.check();
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
[[nodiscard]] SlabLists gather_lists(const Device& device, const Camera& camera, float opaque_at,
                                     const Record& record) {
    const std::size_t pixels =
        static_cast<std::size_t>(camera.width()) * static_cast<std::size_t>(camera.height());
    Buffer counts(device, pixels * sizeof(std::uint32_t));
    std::vector<std::uint32_t> count(pixels);
    std::uint32_t room = 64;
    for (;;) {
        const Buffer slabs(device, pixels * room * sizeof(twin::Slab));
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

}  // namespace

SlabLists cast_slabs(const Device& device, const PreparedScene& scene, const VolumeObject& volume,
                     const CastSettings& settings, float opaque_at) {
    VolumeCaster caster(device, scene, volume, settings, {SinkKind::list});
    SlabLists lists = gather_lists(
        device, scene.camera, opaque_at,
        [&](Commands& commands, std::uint64_t sink) { caster.record(commands, sink, 1 - opaque_at); });
    caster.check();
    return lists;
}

SlabLists cast_slabs(const Device& device, const PreparedScene& scene, const Object& object, double thickness,
                     const CastSettings& settings, float opaque_at) {
    IsosurfaceCaster caster(device, scene, object, thickness, settings, {SinkKind::list});
    SlabLists lists =
        gather_lists(device, scene.camera, opaque_at,
                     [&](Commands& commands, std::uint64_t sink) { caster.record(commands, sink); });
    caster.check();
    return lists;
}

}  // namespace pellucid::vulkan
