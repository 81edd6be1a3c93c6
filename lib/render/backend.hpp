// Where the stages run: on the CPU, or on one Vulkan device that is opened once. Call sites ask it for stages
// and never which it is.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "scene/prepared_scene.hpp"
#include "stage/particle_drawer.hpp"
#include "stage/slab_pipeline.hpp"
#include "stage/surface_drawer.hpp"

namespace pellucid {

namespace vulkan {
class Device;
}
class Image;
struct MultiVolumeSettings;  // cpu/multi_volume_caster.hpp
struct MultiVolumeStats;
struct SurfaceLayers;

struct VulkanSettings {
    std::string device = {};  // part of its name; empty: a real GPU before one in software
    bool validate = false;    // with the validation layers, whose messages fail the run
};

class Backend {
public:
    [[nodiscard]] static Backend cpu() { return {}; }
    /// Throws Error(device) where there is no such device.
    [[nodiscard]] static Backend open_vulkan(const VulkanSettings& settings = {});
    /// Whether a usable Vulkan device is there at all.
    [[nodiscard]] static bool has_vulkan();

    [[nodiscard]] bool on_device() const { return device_ != nullptr; }
    /// "cpu" or "vulkan".
    [[nodiscard]] std::string name() const { return on_device() ? "vulkan" : "cpu"; }
    /// Name and driver of the device; empty for the CPU.
    [[nodiscard]] std::string device_name() const;
    [[nodiscard]] std::string driver() const;
    /// Most bytes held on the device so far; 0 for the CPU.
    [[nodiscard]] std::int64_t device_bytes() const;
    /// Throws Error(run) with the first message of the validation layers, if there was any.
    void check_validation() const;

    /// The fast drawer of the CPU, or the device's. The scene must outlive it.
    [[nodiscard]] std::unique_ptr<ParticleDrawer> make_particle_drawer(const PreparedScene& scene) const;
    /// Multi-volume ray-casting: cpu/multi_volume_caster.hpp.
    [[nodiscard]] Image cast_volumes(const PreparedScene& scene, const MultiVolumeSettings& settings,
                                     MultiVolumeStats& stats, const std::function<void(double)>& progress,
                                     const std::function<SurfaceLayers(int y0, int y1)>& surfaces) const;
    /// zSlabs. The scene must outlive it.
    [[nodiscard]] std::unique_ptr<SlabPipeline> make_slab_pipeline(const PreparedScene& scene, const ZThicknessSize& size,
                                                                   const SlabSettings& settings) const;
    /// Bytes that it will hold: in arrays of so many objects, and for a volume that is cast.
    [[nodiscard]] std::int64_t planned_slab_bytes(const PreparedScene& scene, const ZThicknessSize& size, const SlabSettings& settings,
                                                  std::size_t objects) const;
    [[nodiscard]] std::int64_t planned_cast_bytes(const PreparedScene& scene, const VolumeObject& volume, bool skip) const;
    /// Scene and meshes must outlive it.
    [[nodiscard]] std::unique_ptr<SurfaceDrawer> make_surface_drawer(const PreparedScene& scene, const SceneMeshes& meshes) const;
    /// Bytes that it will hold beside the meshes: on the device if there is one.
    [[nodiscard]] std::int64_t planned_surface_bytes(const PreparedScene& scene, double triangles, double vertices) const;

private:
    std::shared_ptr<const vulkan::Device> device_;
};

}  // namespace pellucid
