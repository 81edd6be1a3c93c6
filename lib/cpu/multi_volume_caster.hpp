// Conventional multi-volume ray-casting, the baseline of zSlabs: one ray samples all volumes at the same places and
// mixes each step (zSlab dissertation, sections 2.2 and 4; (4.1) to (4.4)); surfaces lie between the parts of a step.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

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
    double prepare_s = 0, cast_s = 0;
};

/// World length of a step; 0 where the scene has neither volume nor isosurface.
[[nodiscard]] double common_step(const PreparedScene& scene, double step_in_voxels);
/// Slabs that share an interval, mixed. Two in average: (4.4); more: each with what the ones before made.
[[nodiscard]] twin::Slab mix_shared(std::span<const twin::Slab> slabs, SlabMixing mixing);

/// Planes R G B A (associated) and Z: depth of the front of the nearest step that is seen, +inf where there is none.
/// Precondition: all surfaces are isosurfaces that IsosurfaceCaster casts.
[[nodiscard]] Image cast_volumes(const PreparedScene& scene, const MultiVolumeSettings& settings,
                                 MultiVolumeStats& stats, const std::function<void(double)>& progress);

}  // namespace pellucid
