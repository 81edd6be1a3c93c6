// The ensemble of repeats: what every backend adds up, and the image that is made of it (STEP 3 of PBSR).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/huge_pages.hpp"
#include "core/image.hpp"
#include "sample/particle_set.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

/// Sums over repeats, in integers, so that their order does not matter.
struct EnsembleSums {
    struct Pixel {
        std::uint64_t color[3]{};     // in units: below 2^20 each
        std::uint64_t square[3]{};
        std::uint32_t covered = 0;    // repeats in which the pixel was hit
        std::uint32_t depth = ~0U;    // bits of the least depth beyond near

        void add(const Pixel& other);
    };
    std::vector<Pixel, HugePageAllocator<Pixel>> pixels;  // row by row
    double units = 65535;             // color units of 1.0: see color_units_of
    std::uint64_t particles = 0;
    std::uint64_t repeats = 0;
    /// Repeats of each pixel, where they differ (adaptive runs, in which tiles stop one by one); else empty.
    std::vector<std::uint32_t> pixel_repeats;
    /// Where repeats depend on each other in groups (sample/stratify.hpp): Σ S²/n over the groups, S a group's sum in units
    /// and n its repeats, for R, G, B and A. Groups are independent, so they tell the variance. Else empty. Of complete
    /// groups only: a part of one has a larger variance than its number of repeats says.
    std::vector<std::array<double, 4>> group_squares;
    std::uint32_t groups = 0;                  // complete ones
    std::uint64_t group_repeats = 0;           // of each
    std::vector<std::uint32_t> pixel_groups;   // as pixel_repeats
    /// Where the last group is a part of one: Σ S over the complete ones. Else empty.
    std::vector<std::array<double, 4>> complete_sums;

    /// Nothing yet, for the camera's image.
    EnsembleSums(const Camera& camera, double units);
    EnsembleSums(std::size_t pixel_count, double units);
    /// Precondition: as many pixels and the same units.
    void add(const EnsembleSums& other);
    [[nodiscard]] double repeats_of(std::size_t pixel) const {
        return static_cast<double>(pixel_repeats.empty() ? repeats : pixel_repeats[pixel]);
    }
    /// Adds a group's own sums. Precondition: this one has none but groups, all with as many repeats as the first; the last
    /// one may have fewer, a random choice of a group's.
    void add_group(const EnsembleSums& group);
    /// Sample variance over the repeats (or groups) of a pixel's R, G, B (0, 1, 2) or A (3), over their number: the
    /// variance of its mean. +inf for a single repeat or less than two complete groups. Too small where repeats depend on each other
    /// (LineMode::fast): by a factor of up to K, the crossings of a line, in pixels that hold several of one line.
    [[nodiscard]] double variance_of_mean(std::size_t pixel, int channel) const;
    /// The same as if all repeats were independent, whether they are or not.
    [[nodiscard]] double variance_of_independent(std::size_t pixel, int channel) const;

private:
    [[nodiscard]] double variance_by_groups(std::size_t pixel, std::size_t channel) const;
};

/// Most repeats that the sums hold: 2^24 squares of 40 bits.
inline constexpr std::uint32_t kMostRepeats = 1U << 24U;

/// Brighter scenes are refused: shading in float32 would overflow.
inline constexpr double kMostParticleColor = 1e30;

/// Color units of 1.0 for colours up to `brightest`: 65535 up to 16, halved with every doubling beyond. So a
/// colour is quantised to 1/65535, or to 2^-20 of the brightest one.
[[nodiscard]] double color_units_of(double brightest);

/// Sums of nothing yet, for a scene's image and its brightest colour. Throws Error(run) where the machine's memory
/// does not hold them and the image.
[[nodiscard]] EnsembleSums make_sums(const PreparedScene& scene);

/// R, G, B (associated), A, Z, and variance.R/G/B/A of the pixel's mean: the sample variance over the
/// repeats divided by their number; +inf for a single repeat, of which nothing can be said. Of an adaptive run also
/// `repeats`: those of the pixel's tile.
[[nodiscard]] Image ensemble_image(const Camera& camera, const ParticleFrame& frame,
                                   const EnsembleSums& sums);

/// The same without a camera, into `image`, which has as many pixels as the sums.
void add_ensemble_planes(const ParticleFrame& frame, const EnsembleSums& sums, Image& image);

}  // namespace pellucid
