// Opaque particles of a scene, sampled for one view: repeat by repeat, 16 bytes each.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "kernel/projection_twin.h"
#include "scene/camera.hpp"

namespace pellucid {

using twin::Particle;

/// How stored particles relate to view space: coordinates are divided by 2^exponent, depth counts
/// from the near plane. So float32 keeps the order of two sheets that are close to each other and far
/// from the camera, and scenes of any size.
struct ParticleFrame {
    double near = 0;
    int exponent = 0;
    double shrink = 1;  // 2^-exponent

    explicit ParticleFrame(const Camera& camera);
    [[nodiscard]] Particle pack(const Vec3& view, const Vec3& view_normal) const;
    [[nodiscard]] Vec3 view_position(const Particle& particle) const;
    /// The integers by which every backend projects these particles.
    [[nodiscard]] twin::Projection projection(const Camera& camera) const;
};

/// The particles of one repeat, object after object.
struct RepeatParticles {
    std::vector<Particle> particles;
    std::vector<std::uint32_t> object_ends;  // past the last particle of each object
};

struct ParticleSet {
    ParticleFrame frame;
    std::vector<RepeatParticles> repeats;

    [[nodiscard]] std::uint64_t count() const;
    [[nodiscard]] std::uint64_t bytes() const;
};

}  // namespace pellucid
