#include "vulkan/multi_volume_caster.hpp"

#include <algorithm>
#include <array>
#include <optional>

#include "core/stopwatch.hpp"
#include "cpu/packed_volume.hpp"
#include "vulkan/cast_volumes.hpp"
#include "vulkan/plain_casts.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kMultiVolume[] = {
#include "shaders/multi_volume.comp.inc"
};
constexpr std::uint32_t kPlainMultiVolume[] = {
#include "shaders/plain_multi_volume.comp.inc"
};
constexpr std::uint32_t kMultiLayers[] = {
#include "shaders/multi_layers.comp.inc"
};
static_assert(sizeof(twin::RayLayer) == 24 && sizeof(twin::PixelTotal) == 40);

struct Push {
    std::uint64_t setup;
    std::uint32_t first, count, part;
};

/// As in cpu/fast_volume_caster.cpp.
constexpr double kMostSteps = 1 << 20;
constexpr std::size_t kMostVolumes = 16;
/// Layers a ray at first; more are made room for where there are more.
constexpr std::uint32_t kLayerRoom = 8;

/// The volumes of a scene, on one of the two ways, and the kernel that casts all of them.
struct Volumes {
    Volumes(const Device& device, const PreparedScene& scene, const CastSettings& cast,
            const MultiVolumeSettings& settings, bool layers) {
        std::vector<const VolumeObject*> volumes;
        bool all = true;
        double reach = scene.camera.far() - scene.camera.near();
        for (const VolumeObject& volume : scene.volumes) {
            if (volume.bounds().empty()) continue;
            all = all && PackedVolume::takes(volume);
            reach += length(volume.bounds().size());
            volumes.push_back(&volume);
        }
        const auto count = static_cast<std::uint32_t>(std::max<std::size_t>(1, volumes.size()));
        if (all && volumes.size() <= kMostVolumes && reach / cast.step <= kMostSteps) {
            fast.emplace(device, scene, volumes, cast, settings.rays);
            std::vector<std::uint32_t> constants = fast->constants(settings.mixing);
            constants.push_back(layers ? 1 : 0);
            kernel.emplace(device, kMultiVolume, KernelSettings{sizeof(Push), constants});
        } else {
            plain.emplace(device, scene, volumes, cast, settings.rays);
            std::vector<std::uint32_t> constants = plain->constants();
            constants.push_back(count);
            kernel.emplace(device, kPlainMultiVolume, KernelSettings{sizeof(Push), constants});
        }
    }
    [[nodiscard]] twin::CastSetup& setup() { return fast ? fast->setup : plain->setup; }
    [[nodiscard]] std::uint64_t address() const { return fast ? fast->address() : plain->address(); }
    [[nodiscard]] std::uint64_t bytes() const { return fast ? fast->bytes() : plain->bytes(); }
    [[nodiscard]] std::uint32_t band() const { return fast ? fast->band() : plain->band(); }
    [[nodiscard]] std::uint32_t group_size() const { return fast ? fast->group_size() : plain->group_size(); }
    void begin(Commands& commands) const { fast ? fast->begin(commands) : plain->begin(commands); }
    /// Throws where loops were cut; the most layers of a ray.
    [[nodiscard]] std::uint32_t check() const { return fast ? fast->check() : plain->check(); }

    std::optional<CastVolumes> fast;
    std::optional<PlainCasts> plain;
    std::optional<Kernel> kernel;
};

/// What lies between the volumes: isosurfaces, and what is given for some rows of pixels.
class Layers {
public:
    Layers(const Device& device, const PreparedScene& scene, const CastSettings& cast, int rays)
        : device_(&device) {
        std::vector<const Object*> objects;
        for (const Object& object : scene.objects)
            if (pellucid::IsosurfaceCaster::casts(object)) objects.push_back(&object);
        count_ = static_cast<std::uint32_t>(objects.size());
        surfaces_.emplace(device, scene, objects, std::vector<double>(objects.size(), 0), cast, rays);
        kernel_.emplace(device, kMultiLayers, KernelSettings{sizeof(Push), surfaces_->constants()});
    }
    [[nodiscard]] const Kernel& kernel() const { return *kernel_; }
    [[nodiscard]] std::uint64_t bytes() const {
        return surfaces_->bytes() + layers_.bytes() + given_.bytes();
    }

    void give(const SurfaceLayers& layers, int first_row) {
        given_row_ = static_cast<std::uint32_t>(first_row);
        const std::vector<std::uint32_t> first(layers.first.begin(), layers.first.end());
        given_ = filled(*device_, layers.slabs);
        given_first_ = filled(*device_, first);
    }
    void make_room(std::uint64_t rays, std::uint32_t layers_a_ray) {
        room_ = layers_a_ray;
        layers_ = Buffer();  // the old one first: both may not fit
        layers_ = Buffer(*device_, rays * room_ * sizeof(twin::RayLayer));
        if (counts_.bytes() == 0) counts_ = Buffer(*device_, rays * sizeof(std::uint32_t));
    }
    [[nodiscard]] std::uint32_t room() const { return room_; }
    void tell(twin::CastSetup& setup) const {
        setup.layers = layers_.address();
        setup.layer_counts = counts_.address();
        setup.surfaces = surfaces_->setup.volumes;
        setup.given = given_.address();
        setup.given_first = given_first_.address();
        setup.surface_count = count_;
        setup.layer_room = room_;
        setup.given_row = given_row_;
    }

private:
    const Device* device_;
    std::uint32_t count_ = 0, room_ = 0, given_row_ = 0;
    std::optional<PlainCasts> surfaces_;
    std::optional<Kernel> kernel_;
    Buffer layers_, counts_, given_, given_first_;
};

}  // namespace

Image cast_volumes(const Device& device, const PreparedScene& scene, const MultiVolumeSettings& settings,
                   MultiVolumeStats& stats, const std::function<void(double)>& progress,
                   const FindSurfaces& surfaces) {
    Stopwatch watch;
    const Camera& camera = scene.camera;
    const CastSettings cast{.step = common_step(scene, settings.step), .skip = settings.skip};
    const bool has_layers =
        static_cast<bool>(surfaces) || std::ranges::any_of(scene.objects, pellucid::IsosurfaceCaster::casts);
    Volumes volumes(device, scene, cast, settings, has_layers);
    std::optional<Layers> layers;
    if (has_layers) layers.emplace(device, scene, cast, settings.rays);

    const std::uint64_t pixels =
        static_cast<std::uint64_t>(camera.width()) * static_cast<std::uint64_t>(camera.height());
    const Buffer totals(device, pixels * sizeof(twin::PixelTotal));
    const Buffer planes(device, pixels * 5 * sizeof(float));
    twin::CastSetup& setup = volumes.setup();
    setup.least_clear = 1 - settings.opaque_at;
    setup.mixing = static_cast<std::uint32_t>(settings.mixing);
    setup.totals = totals.address();
    setup.planes = planes.address();
    const std::uint32_t all_packets = packets_of_image(camera);
    const std::uint32_t columns = setup.packet_columns;
    // Surfaces come by rows of pixels.
    std::uint32_t band = volumes.band();
    if (layers) band = std::min(band, packets_of_band(device, camera, kPlainTimes));
    if (surfaces) {
        const auto rows = static_cast<std::uint32_t>(rows_of_band(camera, settings.rays));
        band = std::max(1U, std::min(band / columns, rows / twin::kPacketSideT)) * columns;
    }
    if (layers) layers->make_room(std::uint64_t{band} * twin::kPacketRaysT, kLayerRoom);
    stats.prepare_s += watch.lap();

    Commands commands(device);
    const auto run = [&](const Kernel& kernel, const char* stage, const Push& push) {
        commands.begin_stage(stage);
        commands.dispatch(
            kernel, push,
            device.groups_for(std::uint64_t{push.count} * twin::kPacketRaysT, volumes.group_size()));
        commands.end_stage();
        commands.barrier();
    };
    const auto parts = static_cast<std::uint32_t>(settings.rays * settings.rays);
    for (std::uint32_t first = 0; first < all_packets;) {
        const std::uint32_t count = std::min(band, all_packets - first);
        if (surfaces) {
            const auto side = static_cast<int>(twin::kPacketSideT);
            const int y0 = static_cast<int>(first / columns) * side;
            const int y1 = std::min(camera.height(), static_cast<int>((first + count) / columns) * side);
            layers->give(surfaces(y0, y1), y0);
            stats.surfaces_s += watch.lap();
        }
        for (bool fits = false; !fits;) {
            if (layers) layers->tell(setup);
            volumes.begin(commands);
            for (std::uint32_t part = 0; part < parts; ++part) {
                const Push push{volumes.address(), first, count, part};
                if (layers) run(layers->kernel(), "layers", push);
                if (volumes.fast) {
                    commands.begin_stage("rays");
                    volumes.fast->record_rays(commands, first, count, part);
                    commands.end_stage();
                    commands.barrier();
                }
                run(*volumes.kernel, "cast", push);
            }
            for (const StageTime& time : commands.submit_and_wait()) stats.cast_device_s += time.seconds;
            const std::uint32_t most = volumes.check();
            fits = !layers || most <= layers->room();
            if (!fits) layers->make_room(std::uint64_t{band} * twin::kPacketRaysT, most);
        }
        first += count;
        stats.cast_s += watch.lap();
        progress(static_cast<double>(first) / all_packets);
    }
    stats.bytes += static_cast<std::int64_t>(volumes.bytes() + (layers ? layers->bytes() : 0) +
                                             totals.bytes() + planes.bytes());

    Image image(camera.width(), camera.height());
    std::uint64_t offset = 0;
    for (const char* name : {"R", "G", "B", "A", "Z"}) {
        const std::span<float> plane = image.add(name);
        download(device, planes, std::as_writable_bytes(plane), offset);
        offset += plane.size_bytes();
    }
    stats.rays += pixels * parts;
    stats.cast_s += watch.lap();
    return image;
}

}  // namespace pellucid::vulkan
