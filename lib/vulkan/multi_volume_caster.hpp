// Conventional multi-volume ray-casting on a Vulkan device: the method `mdvr`. cpu/multi_volume_caster.hpp is
// the specification; where all volumes are trilinear the operations are those of cast_volumes_fast.
#pragma once

#include <functional>

#include "cpu/multi_volume_caster.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {

/// As pellucid::cast_volumes. Throws Error(device) where the device has no double precision, Error(run) where
/// its memory is too small or Vulkan in software cuts the loops of a ray.
[[nodiscard]] Image cast_volumes(const Device& device, const PreparedScene& scene,
                                 const MultiVolumeSettings& settings, MultiVolumeStats& stats,
                                 const std::function<void(double)>& progress,
                                 const FindSurfaces& surfaces = {});

}  // namespace pellucid::vulkan
