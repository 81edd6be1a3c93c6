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
/// Bytes that it will hold in z-thickness buffers and rooms of invocations, of so many objects.
[[nodiscard]] std::int64_t planned_slab_bytes(const Device& device, const PreparedScene& scene, const ZThicknessSize& size,
                                              const SlabSettings& settings, std::size_t objects);
/// The same of a volume that is cast, at most.
[[nodiscard]] std::int64_t planned_cast_bytes(const Device& device, const PreparedScene& scene, const VolumeObject& volume);

}  // namespace pellucid::vulkan
