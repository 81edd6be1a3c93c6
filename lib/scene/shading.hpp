// The lights of a scene as seen from its camera, and the colour of a point of an object under them.
#pragma once

#include <span>

#include "scene/prepared_scene.hpp"

namespace pellucid {

/// Linear colour of a visible point: Blinn-Phong of the scene's contract, evaluated by
/// kernel/shading_twin.h in float32. May exceed 1.
///   normal  for shading, world; any length but zero, either side
[[nodiscard]] Vec3 shade(const PreparedScene& scene, const Object& object, const Vec3& world, const Vec3& normal);

/// The same for a point with a colour of its own.
[[nodiscard]] Vec3 shade(const Camera& camera, std::span<const Light> lights, const Shading& shading, const Vec3& color,
                         const Vec3& world, const Vec3& normal);
/// The same where the direction to the viewer is known: unit length.
[[nodiscard]] Vec3 shade(std::span<const Light> lights, const Shading& shading, const Vec3& color, const Vec3& to_viewer,
                         const Vec3& normal);
/// Of a volume, from its value there. Normal −∇f/|∇f|; the unlit colour where ∇f = 0.
///   gradient  per index
[[nodiscard]] Vec3 shade(const PreparedScene& scene, const VolumeObject& volume, const Vec3& world, const Vec3& color,
                         const Vec3& gradient);

/// No channel of the object's (the volume's) colours is larger, however it is lit.
[[nodiscard]] Vec3 brightest_color(std::span<const Light> lights, const Object& object);
[[nodiscard]] Vec3 brightest_color(std::span<const Light> lights, const VolumeObject& volume);
/// What a painted particle carries: each channel as a share of the brightest, 0 … 1.
[[nodiscard]] Vec3 share_of(const Vec3& color, const Vec3& brightest);
/// No colour of the scene is larger than this.
[[nodiscard]] double brightest_color(const PreparedScene& scene);

}  // namespace pellucid
