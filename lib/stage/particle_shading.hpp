// A scene's materials, lights and images as numbers in view space: what every backend shades particles from.
#pragma once

#include <cstdint>
#include <vector>

#include "kernel/particle_twin.h"
#include "sample/particle_set.hpp"
#include "scene/prepared_scene.hpp"
#include "stage/ensemble.hpp"

namespace pellucid {

/// Plain arrays, so that they can be copied to a device as they are.
struct ParticleShading {
    twin::ShadingView view{};
    std::vector<twin::Material> materials;  // one an object, volumes after surfaces
    std::vector<twin::ViewLight> lights;
    std::vector<twin::Vec3f> texels;        // of all images, row by row

    ParticleShading(const PreparedScene& scene, const ParticleFrame& frame);
};

/// Colour of a particle of an object (its place in the scene), by kernel/particle_twin.h. The fast CPU does
/// the same in SIMD, and calls this where an object has an image.
[[nodiscard]] twin::ColorUnits shade_particle(const ParticleShading& shading, std::uint32_t object,
                                              const Particle& particle);

/// What a particle of an object adds to the sums of the pixel that it won.
[[nodiscard]] EnsembleSums::Pixel winner_sums(const ParticleShading& shading, std::uint32_t object,
                                              const Particle& particle);

}  // namespace pellucid
