// Volume stage of zSlabs on a Vulkan device: rays of pixel centres through one volume, or to one isosurface,
// as slabs from front to back. zSlab dissertation, sections 5.2.4 and 6.1.
//
// Trilinear volumes: float32, the operations of cpu/fast_volume_caster.cpp in their order
// (kernel/cast_twin.h). Other interpolations, isosurfaces, and what is too large for that: double, as
// cpu/volume_caster.cpp. Samples are read from buffers and interpolated by arithmetic alone: the device's
// texture filters have 8 bits.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "cpu/volume_caster.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {

/// What takes the slabs: the shader that is made with it, and the address of what that reads.
///   list     keeps all: slab_list.glsl, for tests
///   collect  compresses them as they come and leaves an array a ray: slab_collect.glsl
///   merge    merges them with the pixel's array one by one: slab_merge_sink.glsl; not for isosurfaces
///   give     leaves all of an isosurface's: slab_given_sink.glsl
enum class SinkKind { list, collect, merge, give };
/// Specialisation constants of shaders that include slab_frame.glsl begin here; before them are those of casting.
inline constexpr std::size_t kSlabConstants = 12;
struct SinkChoice {
    SinkKind kind;
    std::array<std::uint32_t, 4> constants{};  // from kSlabConstants on
};

/// Recorded around the rays of each band: before they are cast, and when so many have been.
struct BandHooks {
    std::function<void()> before = [] {};
    std::function<void(std::uint32_t rays)> after = [](std::uint32_t) {};
};

/// Slabs of an image's pixels, row by row, as a list sink leaves them.
using SlabLists = std::vector<std::vector<twin::Slab>>;

class VolumeCaster {
public:
    /// Scene, volume and device must outlive it. Throws Error(device) where the device has no double
    /// precision, Error(run) where its memory is too small.
    VolumeCaster(const Device& device, const PreparedScene& scene, const VolumeObject& volume,
                 const CastSettings& settings, const SinkChoice& sink);
    ~VolumeCaster();
    VolumeCaster(VolumeCaster&&) noexcept;

    /// Records the casting of all rays; a ray ends where what passes is at most `least_clear`. Until it has run,
    /// nothing else of this caster may be recorded elsewhere.
    void record(Commands& commands, std::uint64_t sink, float least_clear, const BandHooks& hooks = {});
    /// After it has run: throws Error(run) where Vulkan in software has cut the loops of a ray.
    void check() const;
    /// Rays in flight at a time: invocations that a sink must have room for.
    [[nodiscard]] std::uint32_t band_rays() const;
    /// At most so many, or one packet of them.
    void limit_band(std::uint32_t rays);
    /// Held on the device.
    [[nodiscard]] std::uint64_t bytes() const;

private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

/// The same for an isosurface, as virtual slabs. Precondition: pellucid::IsosurfaceCaster::casts(object).
class IsosurfaceCaster {
public:
    /// `thickness`: of the slabs, world.
    IsosurfaceCaster(const Device& device, const PreparedScene& scene, const Object& object, double thickness,
                     const CastSettings& settings, const SinkChoice& sink);
    ~IsosurfaceCaster();
    IsosurfaceCaster(IsosurfaceCaster&&) noexcept;

    void record(Commands& commands, std::uint64_t sink, const BandHooks& hooks = {});
    void check() const;
    [[nodiscard]] std::uint32_t band_rays() const;
    void limit_band(std::uint32_t rays);
    [[nodiscard]] std::uint64_t bytes() const;

private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

/// All slabs of every pixel; a ray ends as with SlabList. For tests and small images.
[[nodiscard]] SlabLists cast_slabs(const Device& device, const PreparedScene& scene,
                                   const VolumeObject& volume, const CastSettings& settings, float opaque_at);
[[nodiscard]] SlabLists cast_slabs(const Device& device, const PreparedScene& scene, const Object& object,
                                   double thickness, const CastSettings& settings, float opaque_at);

}  // namespace pellucid::vulkan
