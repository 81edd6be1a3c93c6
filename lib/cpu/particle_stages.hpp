// STEPs 2 and 3 of PBSR on the CPU, plain: projection with occlusion, and the ensemble mean.
//
// Costs go with particles, not with repeats × pixels: a frame is cleared only where it was hit, and
// only hit pixels are shaded and added.
#pragma once

#include <cstdint>
#include <vector>

#include "core/image.hpp"
#include "sample/particle_set.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

__extension__ using WideCount = unsigned __int128;

/// One repeat's nearest particle in every pixel.
class WinnerFrame {
public:
    WinnerFrame(int width, int height);

    /// Projects all particles; the nearest wins its pixel. At equal depth the lower of the indices, scrambled,
    /// wins: as good as a coin, and the same on every backend, so the order of objects does not matter.
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

/// Brightest colour that the sums hold without cutting it.
inline constexpr double kMostParticleColor = 65536;

/// Sums over repeats, in integers, so that their order does not matter. Colours in units of 1/65535;
/// a channel is cut at 2^32 − 1 units, that is 65537.
struct EnsembleSums {
    struct Pixel {
        std::uint64_t color[3]{};
        WideCount square[3]{};      // 128 bits: bright colours of many repeats do not fit into 64
        std::uint32_t covered = 0;    // repeats in which the pixel was hit
        std::uint32_t depth = ~0U;    // bits of the least depth beyond near
    };
    std::vector<Pixel> pixels;
    std::uint64_t particles = 0;
    std::uint64_t repeats = 0;

    void add(const EnsembleSums& other);
    /// Sample variance over the repeats of a pixel's R, G, B (0, 1, 2) or A (3), over their number: the variance of
    /// its mean. +inf for a single repeat.
    [[nodiscard]] double variance_of_mean(std::size_t pixel, int channel) const;
};

/// Draws every repeat of the set and adds it to `sums` (whose pixels are width·height).
void draw_ensemble(const PreparedScene& scene, const ParticleSet& set, EnsembleSums& sums);

/// R, G, B (associated), A, Z, and variance.R/G/B/A of the pixel's mean: the sample variance over the
/// repeats divided by their number; +inf for a single repeat, of which nothing can be said.
[[nodiscard]] Image ensemble_image(const Camera& camera, const ParticleFrame& frame, const EnsembleSums& sums);

}  // namespace pellucid
