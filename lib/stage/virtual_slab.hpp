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

/// Half of a pixel's size on the surface: side/(2·|cosθ|), `side` that of a pixel at this distance, θ between normal and
/// ray, 1/|cosθ| at most kMostStretch (edge-on a surface leaves the pixel long before its tangent plane does).
///
/// Two opaque slabs of thickness d whose surfaces' depths part by g in a pixel give way to one another over ±d/g pixels
/// as a triangle (measure/transition_fit.hpp, exponent 2): the variance of a pixel's box has d = g/√2. What g will be
/// one surface does not know. Of two that are seen face on g is small; of two that are tilted it is between nothing and
/// the sum of their tilts. This is g/√2 where both are tilted by 45 degrees and cross at 40; experiment
/// virtual_thickness measures what is lost: the range of depth within a pixel, |∂z/∂x| + |∂z/∂y|, blurs three times
/// as much where two surfaces tilt the same way.
///   view, normal  of the place, in view space; the normal (geometric) of any length but zero
[[nodiscard]] double pixel_thickness(const Camera& camera, const Vec3& view, const Vec3& normal);

/// What of a thickness lies before the eye's plane, for a surface at depth z.
[[nodiscard]] inline double seen_thickness(double thickness, double z) {
    return thickness > z ? (z > 0 ? z : 0) : thickness;
}

inline constexpr double kMostStretch = 8;  // seen under 83 degrees

}  // namespace pellucid
