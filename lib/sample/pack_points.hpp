// Points as particles, many at once: equal bits to ParticleFrame::pack.
#pragma once

#include <span>

#include "sample/particle_set.hpp"
#include "sample/particle_source.hpp"

namespace pellucid {

/// `out` has the size of `points`. Painted points have their colour for a normal: kernel/paint_twin.h.
void pack_points(const ParticleFrame& frame, std::span<const SourcePoint> points, bool painted,
                 std::span<Particle> out);

}  // namespace pellucid
