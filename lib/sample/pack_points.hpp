// Points as particles, many at once: equal bits to ParticleFrame::pack.
#pragma once

#include <span>

#include "sample/line_sampler.hpp"

namespace pellucid {

/// `out` has the size of `points`.
void pack_points(const ParticleFrame& frame, std::span<const LineSampler::Point> points,
                 std::span<Particle> out);

}  // namespace pellucid
