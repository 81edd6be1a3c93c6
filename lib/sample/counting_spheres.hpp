// How many particles give a wished opacity: by counting spheres (Tanaka et al. 2012, section 4), and exactly.
//
// Particles are made one after the other. Around places of the surface lie spheres of radius r; n is the mean number of
// particles in one, and the sphere's great circle S = πr² stands for the piece of surface inside. When (1) with n and S
// gives the wished opacity, enough particles were made. The area a that is really inside is πr² on planes and spheres and
// πr²[1 + r²(κ1 − κ2)²/32 + …] elsewhere, less at open edges, twice as large beside a second sheet: the density is then
// πr²/a of what it should be. (1) is for a fixed number of particles in S, and theirs is a Poisson number: tau is s/2S too low,
// 1.0 % where r is kLeastRadiusPixels pixels and S = 50 s. The exact way knows the area of the whole surface and needs no spheres.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/random.hpp"
#include "sample/particle_source.hpp"
#include "sample/uniform_points.hpp"

namespace pellucid {

struct CountingSpheres {
    std::uint32_t spheres = 100;
    /// In the scene's units; 0: kRadiusOfSize of the diagonal of the surface's bounds, but at least kLeastRadiusPixels.
    double radius = 0;
    std::vector<Vec3> centers{};  // in place of random ones; not a setting of users
};
inline constexpr double kRadiusOfSize = 0.02;
/// Of the side of a pixel where the surface is nearest: (1) needs S > s, and a wished opacity many particles in S.
inline constexpr double kLeastRadiusPixels = 4;

/// What came of it. Densities are particles a unit of area.
struct OpacityControl {
    double radius = 0;
    double pixel_area = 0;      // s, where the surface is nearest
    double wished = 0;          // α
    double exact_density = 0;   // (1) with all the surface for S
    double counted_density = 0;  // when the count in the spheres was reached
    double exact_opacity = 0;    // 1 − exp(−density·s), what each achieves: PBSR (1) for S >> s
    double counted_opacity = 0;
    double mean_area_ratio = 0;  // a/πr² by the particles counted: 1 where the spheres are right
    std::uint64_t particles = 0;  // made
};

/// Particles of the surface are counted until n reaches (1)'s; 1/√(n·spheres) of the density is noise. At least one and
/// at most 2^28 particles; warns where these, or no place for a sphere, end it early. Precondition: 0 < opacity < 1, S > s.
[[nodiscard]] OpacityControl control_by_counting(const UniformPoints& surface, double opacity, double pixel_area,
                                                 const CountingSpheres& spheres, double size, Seed seed);

/// A source that gives an object as many particles as counting spheres say. Without any area in view: as it was.
/// Throws Error(input) where a stated radius gives a great circle of less than one pixel.
[[nodiscard]] std::unique_ptr<const ParticleSource> counted_source(std::unique_ptr<const ParticleSource> source,
                                                                   const Object& object, const Camera& camera,
                                                                   const CountingSpheres& spheres, Seed seed);

}  // namespace pellucid
