// Crossings of spheres, ellipsoids, tori and slabs against closed forms in fifty digits; grazing rays.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/random.hpp"
#include "scene/scene.hpp"
#include "study/trust_meshes.hpp"

namespace pellucid {

enum class TrustShape { sphere, ellipsoid, torus, slab };
[[nodiscard]] const char* name_of(TrustShape shape);
inline constexpr TrustShape kTrustShapes[] = {TrustShape::sphere, TrustShape::ellipsoid, TrustShape::torus,
                                              TrustShape::slab};

struct ClosedFormCase {
    TrustShape shape = TrustShape::sphere;
    double scale = 1;
    double offset = 0;    // of the surface from the world's origin, in its own size
    double distance = 4;  // of the camera from the surface, in its size
    Projection projection = Projection::perspective;
};

/// Depths in units of their conditioning: what one rounding, 2^-53, of each coordinate that takes part does
/// to t,
///   unit = 2^-53·(|origin| + |centre| + t·|d| + size) / (|d|·max(|cosθ|, sqrt(2^-53·(…)/size))):
/// a plane moved by δ is met δ/cosθ later; near a tangent a curved surface is met sqrt(δ·size) later, not
/// more.
struct ClosedFormResult {
    std::uint64_t rays = 0;
    std::uint64_t hits = 0;  // in the closed form
    std::uint64_t borderline =
        0;  // rays whose number of hits changes if the surface grows or shrinks by kCloseUnits δ
    std::uint64_t wrong = 0;  // of the others: another number of hits than the closed form's
    double worst_units = 0;   // largest error of a depth
    double rms_units = 0;
    double worst_error = 0;  // the same in sizes of the surface
};

/// Roundings that lie between a ray and the depth of its hit: 12 of the affine maps to the object and back,
/// 12 of the equation's coefficients, 8 of its solution. Twice that for rays on the border between hit and
/// miss.
inline constexpr double kDepthUnits = 32;
inline constexpr double kCloseUnits = 2 * kDepthUnits;

/// What the truth found, made wrong by `relative_error` in depth (0: as found), against the closed form.
[[nodiscard]] ClosedFormResult measure_closed_form(const ClosedFormCase& c, std::uint64_t rays, Seed seed,
                                                   double relative_error = 0);

struct GrazingResult {
    std::uint64_t rays = 0;
    std::uint64_t found_two = 0;  // rays with two hits
    std::uint64_t exact_two = 0;  // the closed form of the rays as rounded
    std::uint64_t wrong = 0;      // rays where the two differ
    std::uint64_t intended = 0;   // rays whose rounding leaves them on the side they were made for
};
/// Rays that pass the centre of a sphere in random directions at (1 + delta) radii, delta < 0: inside.
///   offset  of the sphere from the world's origin, in radii
[[nodiscard]] GrazingResult measure_grazing(double delta, double offset, std::uint64_t rays, Seed seed);
/// The share of the radius that rounding moves a ray by: from there on nothing may be wrong.
[[nodiscard]] double grazing_resolution(double offset);

}  // namespace pellucid
