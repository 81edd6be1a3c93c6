// The polygon stage on Vulkan: peeled by passes (vulkan/peeling.hpp) and composed on the device.
#pragma once

#include "stage/surface_drawer.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {

/// All must outlive it.
[[nodiscard]] std::unique_ptr<SurfaceDrawer> make_surface_drawer(const Device& device, const PreparedScene& scene,
                                                                 const SceneMeshes& meshes);

/// Bytes that it will hold on the device.
[[nodiscard]] std::int64_t planned_surface_bytes(const Device& device, const PreparedScene& scene, double triangles,
                                                 double vertices);

}  // namespace pellucid::vulkan
