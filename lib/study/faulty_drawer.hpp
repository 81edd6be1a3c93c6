// Drawers that are wrong on purpose: what a comparison of backends must see.
#pragma once

#include <memory>

#include "scene/prepared_scene.hpp"
#include "stage/particle_drawer.hpp"

namespace pellucid {

enum class DrawFault {
    none,            // plain, and right
    float32_pixels,  // the pixel by float32 alone, without the integers that decide near a border
    ties_by_index,   // at equal depth the lower index wins, not the lower of the scrambled ones
};

/// One thread; the scene must outlive the drawer.
[[nodiscard]] std::unique_ptr<ParticleDrawer> make_faulty_drawer(const PreparedScene& scene, DrawFault fault);

}  // namespace pellucid
