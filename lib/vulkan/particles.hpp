// STEPs 2 and 3 of PBSR on Vulkan: projection with occlusion, shading, sums over the repeats.
#pragma once

#include <cstdint>
#include <memory>

#include "scene/prepared_scene.hpp"
#include "stage/particle_drawer.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {

struct DrawerSettings {
    /// Most bytes of particles on the device at a time; more are streamed. 0: what the device holds well.
    std::uint64_t particle_bytes = 0;
    /// Invocations a workgroup, rounded up to whole subgroups, at most 256; 0: 256 on a GPU, one subgroup in
    /// software, where more cost switching. Where its limit on loops asks for more there are 256
    /// (particles.cpp).
    std::uint32_t workgroup_size = 0;
};

/// Device and scene must outlive the drawer. Throws Error(run) where the scene's image does not fit into the
/// device's memory; so does drawing, on Vulkan in software, where one repeat has more particles in one tile
/// than its limit on loops lets through.
[[nodiscard]] std::unique_ptr<ParticleDrawer> make_particle_drawer(const Device& device,
                                                                   const PreparedScene& scene,
                                                                   const DrawerSettings& settings = {});

}  // namespace pellucid::vulkan
