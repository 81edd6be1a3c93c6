// Conventional multi-volume ray-casting, the baseline of zSlabs: one ray samples all volumes at the same
// places and mixes each step (zSlab dissertation, 1.3.1 and 6.2.1; mixing: 4.3); surfaces lie between
// the parts of a step.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "core/image.hpp"
#include "cpu/volume_caster.hpp"
#include "stage/slab_settings.hpp"

namespace pellucid {

struct MultiVolumeSettings {
    double step = 1;  // in smallest voxels of all volumes and isosurfaces
    SlabMixing mixing = SlabMixing::average;
    bool skip = true;  // what is empty in all volumes
    int rays = 1;      // rays × rays a pixel, in the middles of its parts
    float opaque_at = 0.999F;
};

struct MultiVolumeStats {
    std::uint64_t rays = 0;
    std::int64_t bytes = 0;  // of the casters
    double prepare_s = 0, surfaces_s = 0, cast_s = 0;
    double cast_device_s = 0;  // by a device's own clock
};

/// Surfaces that are no isosurfaces, on the rays of some rows of pixels: sorted, thickness 0.
struct SurfaceLayers {
    std::vector<std::size_t> first;  // of ray i in `slabs`, and the number of all
    std::vector<twin::Slab> slabs;

    [[nodiscard]] std::span<const twin::Slab> of(std::size_t ray) const {
        if (first.empty()) return {};
        return std::span(slabs).subspan(first[ray], first[ray + 1] - first[ray]);
    }
};
/// Of the rows y0 … y1 − 1; rays row by row of an image that is `rays` times as fine.
using FindSurfaces = std::function<SurfaceLayers(int y0, int y1)>;

/// World length of a step: in the smallest voxels of volumes and isosurfaces. Where there is neither, the
/// scene's size.
[[nodiscard]] double common_step(const PreparedScene& scene, double step_in_voxels);
/// Slabs that share an interval, mixed. Two in average: (4.4); more: each with what the ones before made.
[[nodiscard]] twin::Slab mix_shared(std::span<const twin::Slab> slabs, SlabMixing mixing);

/// Planes R G B A (associated) and Z: depth of the front of the nearest step that is seen, +inf where there
/// is none. Isosurfaces (IsosurfaceCaster::casts) are found along the rays, other surfaces by `surfaces`.
[[nodiscard]] Image cast_volumes(const PreparedScene& scene, const MultiVolumeSettings& settings,
                                 MultiVolumeStats& stats, const std::function<void(double)>& progress,
                                 const FindSurfaces& surfaces = {});

// ---- What the fast version shares

/// What lies between the parts of volumes, at one depth.
struct DepthLayer {
    double t;
    twin::Slab slab;
};
/// Isosurfaces of a scene and given layers on one ray, sorted; what shares a depth is mixed.
class LayersOfRay {
public:
    LayersOfRay(const PreparedScene& scene, const CastSettings& settings);
    void find(const Ray& ray, std::span<const twin::Slab> others, SlabMixing mixing,
              std::vector<DepthLayer>& out) const;
    [[nodiscard]] bool none() const { return isosurfaces_.empty(); }
    [[nodiscard]] std::size_t bytes() const;

private:
    std::vector<IsosurfaceCaster> isosurfaces_;
};

/// Bands of rows with so many rays that their surfaces may be held together.
[[nodiscard]] int rows_of_band(const Camera& camera, int rays);

}  // namespace pellucid
