// Particle-based surface rendering (PBSR, Tanaka et al. 2012).
#pragma once

#include <cstdint>
#include <functional>
#include <optional>

#include "render/method.hpp"
#include "sample/particle_sampler.hpp"
#include "stage/ensemble.hpp"

namespace pellucid {

struct ParticleSettings {
    std::uint32_t repeats = 500;  // L_R
    std::uint32_t first_repeat = 0;  // of a shard
    SamplerKind kind = SamplerKind::lines;
    SourceSettings source{};  // its seed is sampler.seed
    SamplerSettings sampler{};
    /// MiB of particles held at a time, though at least one repeat a thread: repeats are sampled, drawn and
    /// forgotten in batches.
    std::int64_t memory_mib = 1024;
    /// Stop before `repeats` once every pixel's estimated standard error is at most this.
    std::optional<double> max_error{};
    Backend backend = Backend::cpu();
};

/// Particle generation (on the CPU) → projection with occlusion → sums (on settings.backend), batch by batch.
/// Throws Error(input) where a colour of the scene may exceed kMostParticleColor. `progress` is given the
/// share that is done, (0, 1].
[[nodiscard]] EnsembleSums draw_particles(
    const PreparedScene& scene, const ParticleSettings& settings, RenderStats& stats,
    const std::function<void(double)>& progress = [](double) {});

/// The same and the mean over the repeats. Planes: see ensemble_image.
[[nodiscard]] Image render_particles(
    const PreparedScene& scene, const ParticleSettings& settings, RenderStats& stats,
    const std::function<void(double)>& progress = [](double) {});

}  // namespace pellucid
