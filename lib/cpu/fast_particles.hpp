// STEPs 2 and 3 of PBSR on the CPU, fast: tile by tile, so that a tile's keys stay in the first-level cache
// and its sums in the second; projection and shading in SIMD of whatever width there is, chosen at run time.
// Equal to the plain version (cpu/plain_particles.hpp) bit for bit.
#pragma once

#include <memory>

#include "scene/prepared_scene.hpp"
#include "stage/particle_drawer.hpp"

namespace pellucid {

/// Tiles in parallel, cut by repeats where there are few. The scene must outlive the drawer.
[[nodiscard]] std::unique_ptr<ParticleDrawer> make_fast_drawer(const PreparedScene& scene);

}  // namespace pellucid
