// Particle-based surface rendering (PBSR, Tanaka et al. 2012).
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string_view>
#include <utility>

#include "render/method.hpp"
#include "sample/particle_sampler.hpp"
#include "stage/ensemble.hpp"

namespace pellucid {

struct ParticleSettings {
    std::uint32_t repeats = 500;  // L_R
    std::uint32_t first_repeat = 0;  // of a shard
    SamplerKind kind = SamplerKind::lines;
    SourceSettings source{};               // what only some samplers read
    SamplerSettings sampler{};
    std::optional<std::uint32_t> group{};  // stratified; absent: default_group
    std::uint32_t oversampling = 8;        // stratified
    /// MiB of particles held at a time, though at least one repeat a thread: repeats are sampled, drawn and
    /// forgotten in batches.
    std::int64_t memory_mib = 1024;
    /// A tile is done before `repeats` once all of its pixels' estimated standard errors are at most this. The number of
    /// repeats doubles from one look to the next (stratified: whole groups, and blocks of 4 x 4 pixels on average). An estimate
    /// that decides when to stop is a little too small, and so is the mean: few hits look like a small error. A pixel that
    /// is alone in its tile is off by up to -0.34 of the error asked for (opacity 0.05, error 0.03), 16 like pixels by up
    /// to -0.011 of it, 256 by -0.002. A fixed number of repeats has no such bias.
    std::optional<double> max_error{};
    Backend backend = Backend::cpu();
};

/// Names of `particles.sampler`, the default first.
[[nodiscard]] std::span<const std::pair<std::string_view, SamplerKind>> sampler_names();

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
