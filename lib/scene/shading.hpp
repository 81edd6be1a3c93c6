// The lights of a scene as seen from its camera, and the colour of a point of an object under them.
#pragma once

#include "scene/prepared_scene.hpp"

namespace pellucid {

/// Linear colour of a visible point: Blinn-Phong of the scene's contract, evaluated by
/// kernel/shading_twin.h in float32. May exceed 1.
///   normal  for shading, world; any length but zero, either side
[[nodiscard]] Vec3 shade(const PreparedScene& scene, const Object& object, const Vec3& world, const Vec3& normal);

/// No colour of the scene is larger than this.
[[nodiscard]] double brightest_color(const PreparedScene& scene);

}  // namespace pellucid
