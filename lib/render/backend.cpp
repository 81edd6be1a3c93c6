#include "render/backend.hpp"

#include <algorithm>

#include "core/error.hpp"
#include "cpu/depth_peeling.hpp"
#include "cpu/fast_particles.hpp"
#include "cpu/fast_volume_caster.hpp"
#include "cpu/packed_volume.hpp"
#include "cpu/slab_stages.hpp"
#include "cpu/surface_drawer.hpp"
#include "vulkan/device.hpp"
#include "vulkan/multi_volume_caster.hpp"
#include "vulkan/particles.hpp"
#include "vulkan/slab_pipeline.hpp"
#include "vulkan/surface_drawer.hpp"

namespace pellucid {

Backend Backend::open_vulkan(const VulkanSettings& settings) {
    Backend backend;
    backend.device_ = std::make_shared<const vulkan::Device>(
        vulkan::DeviceOptions{.name = settings.device, .validate = settings.validate});
    return backend;
}

bool Backend::has_vulkan() {
    return std::ranges::any_of(vulkan::list_devices(), &vulkan::DeviceInfo::usable);
}

std::string Backend::device_name() const { return on_device() ? device_->info().name : ""; }

std::string Backend::driver() const { return on_device() ? device_->info().driver : ""; }

std::int64_t Backend::device_bytes() const {
    return on_device() ? static_cast<std::int64_t>(device_->peak_bytes()) : 0;
}

void Backend::check_validation() const {
    if (!on_device()) return;
    const std::vector<std::string> messages = device_->validation_messages();
    if (!messages.empty())
        throw run_error("{} validation messages, the first: {}", messages.size(), one_line(messages.front()));
}

std::unique_ptr<ParticleDrawer> Backend::make_particle_drawer(const PreparedScene& scene) const {
    return on_device() ? vulkan::make_particle_drawer(*device_, scene) : make_fast_drawer(scene);
}

Image Backend::cast_volumes(const PreparedScene& scene, const MultiVolumeSettings& settings, MultiVolumeStats& stats,
                            const std::function<void(double)>& progress, const FindSurfaces& surfaces) const {
    return on_device() ? vulkan::cast_volumes(*device_, scene, settings, stats, progress, surfaces)
                       : cast_volumes_fast(scene, settings, stats, progress, surfaces);
}

std::unique_ptr<SlabPipeline> Backend::make_slab_pipeline(const PreparedScene& scene, const ZThicknessSize& size,
                                                          const SlabSettings& settings) const {
    return on_device() ? vulkan::make_slab_pipeline(*device_, scene, size, settings)
                       : pellucid::make_slab_pipeline(scene, size, settings);
}

std::int64_t Backend::planned_slab_bytes(const PreparedScene& scene, const ZThicknessSize& size, const SlabSettings& settings,
                                         std::size_t objects) const {
    return on_device() ? vulkan::planned_slab_bytes(*device_, scene, size, settings, objects)
                       : pellucid::planned_slab_bytes(size, settings, objects);
}

std::int64_t Backend::planned_cast_bytes(const PreparedScene& scene, const VolumeObject& volume, bool skip) const {
    return on_device() ? vulkan::planned_cast_bytes(*device_, scene, volume) : PackedVolume::planned_bytes(volume, skip);
}

std::unique_ptr<SurfaceDrawer> Backend::make_surface_drawer(const PreparedScene& scene, const SceneMeshes& meshes) const {
    return on_device() ? vulkan::make_surface_drawer(*device_, scene, meshes) : pellucid::make_surface_drawer(scene, meshes);
}

std::int64_t Backend::planned_surface_bytes(const PreparedScene& scene, double triangles, double vertices) const {
    return on_device() ? vulkan::planned_surface_bytes(*device_, scene, triangles, vertices) : planned_peel_bytes(triangles, vertices);
}

}  // namespace pellucid
