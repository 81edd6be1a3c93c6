// The volume stage on the CPU, fast: packets of 4 × 4 rays in step, in float32 SIMD of whatever width there
// is, chosen at run time; trilinear volumes in bricks (cpu/packed_volume.hpp). Other interpolations, and
// volumes beyond 2 GB, go the plain way.
//
// Beside the plain version (cpu/volume_caster.hpp), where a ray is not within rounding of a face of the hull
// or of a cell that changes its normal: opacity of a ray within 2e-5, colour within 2e-4 for steps up to a
// voxel and 1e-3 for three. Pre-integration is the same closed form, colour that changes within a step to
// first order. Skipping changes no bit.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <vector>

#include "cpu/multi_volume_caster.hpp"
#include "cpu/packet_nodes.hpp"

namespace pellucid {

/// One volume; safe from several threads.
class FastVolumeCaster {
public:
    /// Scene and volume must outlive it.
    FastVolumeCaster(const PreparedScene& scene, const VolumeObject& volume, const CastSettings& settings);
    ~FastVolumeCaster();
    FastVolumeCaster(FastVolumeCaster&&) noexcept;

    /// What stays of one thread's packet.
    using PacketSlabs = std::array<std::vector<twin::Slab>, kPacketRays>;
    /// The slabs with opacity > 0 of the rays of pixel centres x0 … x0 + 3, y0 … y0 + 3, row by row; of
    /// pixels beyond the image none. A ray ends where its accumulated opacity reaches `opaque_at`.
    void cast(int x0, int y0, float opaque_at, PacketSlabs& out) const;
    /// What a collector keeps of a ray.
    struct Collected {
        std::vector<twin::Slab> slabs;
        std::size_t seen = 0;  // slabs that came
        float nearest = 0;     // front of the first one
    };
    using CollectedPacket = std::array<Collected, kPacketRays>;
    /// The same slabs through the collector, bit by bit; in lanes where it collects by `transmittance` and no
    /// more than nine layers.
    void cast_collected(int x0, int y0, SlabCollector& collector, CollectedPacket& out) const;
    [[nodiscard]] std::size_t bytes() const;

private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

/// As cast_volumes, which draws scenes with a volume that is not trilinear, or more than 16 volumes.
[[nodiscard]] Image cast_volumes_fast(const PreparedScene& scene, const MultiVolumeSettings& settings,
                                      MultiVolumeStats& stats, const std::function<void(double)>& progress,
                                      const FindSurfaces& surfaces = {});

}  // namespace pellucid
