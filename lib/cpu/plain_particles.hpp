// STEPs 2 and 3 of PBSR on the CPU, plain: the specification that every other one is tested against.
//
// Costs go with particles, not with repeats × pixels: a frame is cleared only where it was hit, and
// only hit pixels are shaded and added.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "stage/particle_drawer.hpp"
#include "stage/particle_shading.hpp"

namespace pellucid {

/// One repeat's nearest particle in every pixel.
class WinnerFrame {
public:
    WinnerFrame(int width, int height);

    /// Projects all particles; the nearest wins its pixel, at equal depth the lower of the scrambled indices.
    void draw(std::span<const Particle> particles, const twin::Projection& projection);
    /// The pixels that were hit, in order of their first hit.
    [[nodiscard]] std::span<const std::uint32_t> hit_pixels() const { return hit_; }
    /// Index of the particle that won. Precondition: the pixel was hit.
    [[nodiscard]] std::uint32_t winner(std::uint32_t pixel) const {
        return twin::restore_index(static_cast<std::uint32_t>(keys_[pixel]));
    }
    /// Forgets the hits: touches only pixels that were hit.
    void clear();

private:
    std::vector<std::uint64_t> keys_;  // depth in the high, scrambled index in the low half; all ones: no hit
    std::vector<std::uint32_t> hit_;
    int width_;
};

/// Repeats in parallel, a frame and sums a thread. The scene must outlive the drawer.
[[nodiscard]] std::unique_ptr<ParticleDrawer> make_plain_drawer(const PreparedScene& scene);

}  // namespace pellucid
