// Private to lib/vulkan: volumes on a device as the shaders of cast_volume.glsl read them, and their rays.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "cpu/volume_caster.hpp"
#include "kernel/cast_rays_twin.h"
#include "stage/slab_settings.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {

/// The device; throws Error(device) where its shaders have no double precision.
[[nodiscard]] const Device& with_doubles(const Device& device);
/// Throws Error(run) where a shader has left word here that the loops of a ray were cut before its end:
/// Vulkan in software leaves every loop, and silently, once an invocation went round its loops 65535 times
/// all told (Mesa, gallivm: LP_MAX_TGSI_LOOP_ITERATIONS). A GPU knows no such number. Else the most layers of
/// a ray.
std::uint32_t check_status(const Device& device, const Buffer& status);

/// A buffer of the device that holds these values.
template <class T>
[[nodiscard]] Buffer filled(const Device& device, std::span<const T> values) {
    Buffer buffer(device, values.size_bytes());
    upload(device, buffer, std::as_bytes(values));
    return buffer;
}
template <class T>
[[nodiscard]] Buffer filled(const Device& device, const std::vector<T>& values) {
    return filled(device, std::span<const T>(values));
}

[[nodiscard]] inline twin::Vec3d twin_of(const Vec3& v) {
    return {v.x, v.y, v.z};
}
[[nodiscard]] twin::CastCamera camera_of(const Camera& camera, double step, int rays);
[[nodiscard]] twin::CastPlace place_of(const Affine& to_index, const Vec3& last);
[[nodiscard]] std::vector<twin::CastPlane> planes_of(std::span<const ClipPlane> planes);

[[nodiscard]] std::vector<twin::CastLight> lights_of(const PreparedScene& scene);
[[nodiscard]] bool has_holes(const VoxelGrid& grid);  // samples that are not a number

/// Workgroup size: whole packets of rays.
[[nodiscard]] std::uint32_t cast_group_size(const Device& device);
/// Packets of rays that are cast at a time, at least a row of them; fewer where each takes so many times as
/// long.
[[nodiscard]] std::uint32_t packets_of_band(const Device& device, const Camera& camera,
                                            std::uint32_t times = 1);
[[nodiscard]] std::uint32_t packets_of_row(const Camera& camera);
[[nodiscard]] std::uint32_t packets_of_image(const Camera& camera);

/// Volumes in float32, and what all of their rays share.
class CastVolumes {
public:
    /// Precondition: PackedVolume::takes each of them; they and the scene outlive it.
    CastVolumes(const Device& device, const PreparedScene& scene,
                std::span<const VolumeObject* const> volumes, const CastSettings& settings, int rays);

    /// Bits of the specialisation constants of cast_volume.glsl.
    [[nodiscard]] std::vector<std::uint32_t> constants(SlabMixing mixing = SlabMixing::average) const;
    /// Records the rays of some packets: first … first + count − 1 of the image, and this part of each pixel.
    void record_rays(Commands& commands, std::uint32_t first, std::uint32_t count, std::uint32_t part) const;

    /// What the shaders read; begin() sends it.
    twin::CastSetup setup{};
    void begin(Commands& commands) const;
    /// After all has run: check_status().
    std::uint32_t check() const;
    [[nodiscard]] std::uint64_t address() const { return setup_.address(); }
    [[nodiscard]] std::uint32_t band() const { return band_; }
    [[nodiscard]] std::uint32_t group_size() const { return group_size_; }
    [[nodiscard]] std::uint64_t bytes() const { return bytes_; }

private:
    struct Held {
        Buffer samples, pieces, distance, planes;
    };
    [[nodiscard]] twin::CastVolume place_on_device(const VolumeObject& volume, const CastSettings& settings);

    const Device* device_;
    std::uint32_t group_size_, band_;
    std::uint32_t kinds_ = 0, most_pieces_ = 0, extremes_ = 0;
    bool lit_ = false, glossy_ = false, holes_ = false, skip_ = false;
    std::uint64_t bytes_ = 0;
    std::vector<Held> held_;
    Buffer setup_, status_, volumes_, lights_, packet_rays_, volume_rays_, ray_steps_;
    Kernel rays_kernel_;
};

}  // namespace pellucid::vulkan
