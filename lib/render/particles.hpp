// Particle-based surface rendering (PBSR, Tanaka et al. 2012).
#pragma once

#include "stage/ensemble.hpp"
#include "render/method.hpp"
#include "sample/particle_sampler.hpp"

namespace pellucid {

struct ParticleSettings {
    std::uint32_t repeats = 500;  // L_R
    std::uint32_t first_repeat = 0;
    SamplerSettings sampler{};
    /// Particles held at a time: repeats are sampled, drawn and forgotten in batches of this size.
    std::int64_t memory_mib = 1024;
    /// Stop before `repeats` once every pixel's estimated standard error is at most this.
    std::optional<double> max_error{};
    Backend backend = Backend::cpu();
};

/// Particle generation → projection with occlusion → sums, batch by batch.
[[nodiscard]] EnsembleSums draw_particles(const PreparedScene& scene, const ParticleSettings& settings, RenderStats& stats,
                                          const std::function<void(double)>& progress = [](double) {});

/// The same and the mean over the repeats. Planes: see ensemble_image.
[[nodiscard]] Image render_particles(const PreparedScene& scene, const ParticleSettings& settings, RenderStats& stats,
                                     const std::function<void(double)>& progress = [](double) {});

}  // namespace pellucid
