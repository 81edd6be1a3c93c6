// STEP 1 of PBSR: L_R independent particle sets for all objects of a scene (fusion is concatenation).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "sample/make_sources.hpp"
#include "sample/particle_set.hpp"
#include "sample/stratify.hpp"
#include "sample/tile_mask.hpp"

namespace pellucid {

/// How many trials one object gets in one repeat. V: LineSampler::virtual_pixels.
enum class TrialLaw {
    /// Poisson with mean −ln(1−α)·V. Pixels are independent, and a pixel of which the surface covers a
    /// share c has opacity 1 − (1−α)^c exactly, for objects of any size.
    poisson,
    /// The fixed number ln(1−α)/ln(1−1/V), its fraction drawn so that the mean transmittance is
    /// exact. Particle counts are then binomial: PBSR (1) as it stands. Needs V > 1.
    binomial,
};

/// What becomes of a line that crosses a surface more than once.
enum class LineMode {
    /// One crossing in K is kept: particles are independent, within a repeat and between repeats.
    exact,
    /// All crossings, each in another repeat of a group of kLineGroup consecutive ones: a repeat alone is
    /// as in exact mode, repeats of a group depend on each other (line_sampler.hpp). Needs TrialLaw::poisson.
    fast,
};

struct SamplerSettings {
    Seed seed{};
    TrialLaw trials = TrialLaw::poisson;
    LineMode lines = LineMode::exact;
    /// Repeats that depend on each other, in groups (stratify.hpp); then only the seed counts of the rest.
    std::optional<StratifySettings> stratify{};
    /// Particles elsewhere are left out; those that stay are the same. Null: the whole image.
    std::shared_ptr<const TileMask> tiles{};
    /// Draw exactly this many particles of each object in each repeat, whatever its opacity.
    std::optional<std::uint64_t> exact_count{};
    /// Wrong twins, for tests that must reject them.
    bool keep_all_crossings = false;
    bool same_set_in_all_repeats = false;
    bool deal_to_one_repeat = false;  // fast mode
};

/// Mean number of trials that give one object its opacity in one repeat, min(α, kMostParticleOpacity).
[[nodiscard]] double mean_trials(const ParticleSource& source, TrialLaw law);

/// Samples repeats first, …, first + count − 1. A repeat depends on seed and its own number only, so
/// any split into calls, threads or machines gives the same particles.
/// Throws Error(input) where fast mode is asked for without the Poisson law; Error(run) where exact_count
/// cannot be met because nothing of the object is in view.
[[nodiscard]] ParticleSet sample_particles(const PreparedScene& scene, const SourceRefs& sources,
                                           const SamplerSettings& settings, std::uint32_t first,
                                           std::uint32_t count);

}  // namespace pellucid
