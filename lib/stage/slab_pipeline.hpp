// The zSlab pipeline on any backend (zSlab dissertation, section 5.2): each object of a scene becomes a sorted array of
// slabs in every pixel that it covers, and arrays are intermixed in z-thickness buffers.
//   CPU     cpu/slab_stages.hpp
//   Vulkan  vulkan/slab_pipeline.hpp
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/image.hpp"
#include "scene/prepared_scene.hpp"
#include "stage/particle_drawer.hpp"
#include "stage/scene_meshes.hpp"
#include "stage/slab_settings.hpp"
#include "stage/z_thickness_buffer.hpp"

namespace pellucid {

struct SlabStageStats {
    std::uint64_t fragments = 0;  // of polygons
    std::uint64_t slabs = 0;      // of rays through volumes and isosurfaces, before any compression
    std::int64_t bytes = 0;       // that the stage held, meshes and buffers aside; on the device if there is one
    double kernel_s = 0;          // of its wall time, for merging, compressing and storing arrays; the CPU's
};

/// Draws the objects of one scene, one after the other. With SlabIntermix::order_free each of them goes into a
/// z-thickness buffer of its own, else all into one.
class SlabPipeline {
public:
    virtual ~SlabPipeline() = default;

    /// Polygon stage: one object's triangles, peeled, as virtual slabs.
    ///   object    its number in SceneMeshes::objects
    ///   surfaces  L, most surfaces a pixel, the nearest; 0: all
    virtual void add_polygons(const SceneMeshes& meshes, std::uint32_t object, int surfaces, SlabStageStats& stats) = 0;
    /// Volume stage: an isosurface, as virtual slabs. Precondition: IsosurfaceCaster::casts(object).
    virtual void add_isosurface(const Object& object, const CastSettings& settings, SlabStageStats& stats) = 0;
    /// Volume stage: a volume. `on_the_fly`: its slabs meet what is there one by one, before any compression.
    virtual void add_volume(const VolumeObject& volume, const CastSettings& settings, bool on_the_fly, SlabStageStats& stats) = 0;

    /// Planes R, G, B, A (associated) and Z: depth of the nearest thing, +inf where there is none.
    [[nodiscard]] virtual Image image() = 0;
    /// Of all z-thickness buffers, and how many there are.
    [[nodiscard]] virtual std::size_t bytes() const = 0;
    [[nodiscard]] virtual std::size_t buffers() const = 0;
    /// Device time by stage of all that was drawn; empty for the CPU.
    [[nodiscard]] virtual std::vector<StageTime> device_times() const { return {}; }
};

/// Bytes of one z-thickness buffer and the depths of what is nearest.
[[nodiscard]] inline std::size_t planned_slab_bytes(const ZThicknessSize& size) {
    return ZThicknessBuffer::planned_bytes(size) +
           sizeof(float) * static_cast<std::size_t>(size.width) * static_cast<std::size_t>(size.height);
}

}  // namespace pellucid
