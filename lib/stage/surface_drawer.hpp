// The polygon stage on any backend: triangles of a scene's surfaces to one colour a pixel.
//   CPU     cpu/surface_drawer.hpp: peels by tiles
//   Vulkan  vulkan/surface_drawer.hpp: peels by passes of the device's rasteriser
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/image.hpp"
#include "scene/prepared_scene.hpp"
#include "stage/particle_drawer.hpp"
#include "stage/scene_meshes.hpp"

namespace pellucid {

/// How the fragments of a pixel become its colour.
enum class SurfaceMixing : std::uint8_t {
    nearest,   // the nearest alone, as if opaque
    by_depth,  // front to back (1.3 to 1.5), those at one depth by (4.4)
    blended,   // one over the other in their order
};

struct SurfaceDrawSettings {
    SurfaceMixing mixing = SurfaceMixing::by_depth;
    /// L: most surfaces of a pixel, the nearest; 0: all.
    int layers = 0;
    /// Rank of every triangle, the foremost 0, in place of its depth. Empty: by depth.
    std::span<const std::uint32_t> order = {};
};

struct SurfaceDrawStats {
    std::uint64_t fragments = 0;
    std::uint64_t layers = 0;  // most of a pixel
    std::uint64_t passes = 0;  // over all triangles
    std::int64_t bytes = 0;    // held at most, meshes aside: on the device if there is one
};

/// Draws the surfaces of one scene. Fragments and their depths are the same on every backend, but where a device divides or
/// rounds doubles by rules of its own.
class SurfaceDrawer {
public:
    virtual ~SurfaceDrawer() = default;

    /// Planes R, G, B, A (associated) and Z: the least depth of all fragments, +inf where there is none.
    [[nodiscard]] virtual Image draw(const SurfaceDrawSettings& settings, SurfaceDrawStats& stats) = 0;
    /// Device time by stage of all that was drawn; empty for the CPU.
    [[nodiscard]] virtual std::vector<StageTime> device_times() const { return {}; }
};

/// Planes R, G, B, A of nothing, and Z of +inf.
[[nodiscard]] inline Image empty_surface_image(const Camera& camera) {
    Image image(camera.width(), camera.height());
    for (const char* name : {"R", "G", "B", "A"}) (void)image.add(name);
    (void)image.add("Z", std::numeric_limits<float>::infinity());
    return image;
}

}  // namespace pellucid
