// Samplers by the names that experiments know them by: those of `particles.sampler`, and "fast" for random lines whose
// crossings are dealt to different repeats.
#pragma once

#include <string>

#include "render/particles.hpp"

namespace pellucid {

struct SamplerChoice {
    SamplerKind kind = SamplerKind::lines;
    LineMode lines = LineMode::exact;

    void apply(ParticleSettings& settings) const {
        settings.kind = kind;
        settings.sampler.lines = lines;
    }
};

/// Throws Error(input) that lists the names.
[[nodiscard]] SamplerChoice sampler_choice(const std::string& name);

}  // namespace pellucid
