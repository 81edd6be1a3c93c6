// Virtual slabs: polygons are surfaces, and become slabs with a thickness towards the camera. zSlab, section 5.4.
#pragma once

#include <optional>

#include "scene/prepared_scene.hpp"

namespace pellucid {

/// Least distance of two neighbouring samples of all volumes and isosurfaces of the scene, world; empty where it has none.
[[nodiscard]] std::optional<double> smallest_voxel_pitch(const PreparedScene& scene);

/// The thickness of an object where it is the same all over: given by hand, or the smallest voxel pitch where the scene has
/// a volume. Empty: it is pixel_thickness, place by place.
[[nodiscard]] std::optional<double> fixed_thickness(const PreparedScene& scene, const Object& object);

/// The range of depth that a surface has within one pixel: |∂z/∂x| + |∂z/∂y| for a step of one pixel, on its tangent plane.
/// Two surfaces that cross then blend over d₁ + d₂ of depth, which is |∇z₁|₁ + |∇z₂|₁ >= |∇(z₁ − z₂)|₁: at least the pixel's
/// width, so no edge is jagged, and exactly that where they tilt opposite ways. Held between kLeastTilt and kMostTilt
/// sides of a pixel there: outlines are no better known than to 1/256 pixel, and at a silhouette the tangent plane
/// leaves a curved surface long before it leaves the pixel.
///   view, normal  of the place, in view space; the normal (geometric) of any length but zero
[[nodiscard]] double pixel_thickness(const Camera& camera, const Vec3& view, const Vec3& normal);

inline constexpr double kLeastTilt = 1.0 / 256;
inline constexpr double kMostTilt = 8;  // seen under 83 degrees

}  // namespace pellucid
