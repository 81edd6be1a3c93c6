// The zSlab pipeline on a Vulkan device: polygons by its rasteriser, rays and arrays in compute. The stages of
// cpu/slab_stages.hpp, the same operations in the same order (vulkan/shaders/slab_frame.glsl).
#pragma once

#include <memory>

#include "stage/slab_pipeline.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {

/// Device and scene must outlive it. Throws Error(run) where the device has too little memory, Error(device) where it
/// lacks double precision.
[[nodiscard]] std::unique_ptr<SlabPipeline> make_slab_pipeline(const Device& device, const PreparedScene& scene,
                                                               const ZThicknessSize& size, const SlabSettings& settings);

}  // namespace pellucid::vulkan
