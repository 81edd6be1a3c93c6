#include "sample/make_sources.hpp"

#include "sample/volume_source.hpp"

namespace pellucid {

SourceRefs::SourceRefs(const Sources& sources) {
    for (const auto& source : sources) refs_.push_back(source.get());
}

SourceRefs::SourceRefs(const std::vector<LineSampler>& samplers) {
    for (const LineSampler& sampler : samplers) refs_.push_back(&sampler);
}

Sources make_sources(const PreparedScene& scene, SamplerKind kind, const WalkSettings& walk) {
    Sources sources;
    for (std::size_t i = 0; i < scene.objects.size(); ++i) {
        switch (kind) {
            case SamplerKind::lines:
            case SamplerKind::stratified:
                sources.push_back(std::make_unique<LineSampler>(scene.objects[i], scene.camera, static_cast<std::uint32_t>(i), scene.settings.lights));
                break;
            case SamplerKind::brownian:
                sources.push_back(
                    std::make_unique<BrownianSource>(scene.objects[i], scene.camera, static_cast<std::uint32_t>(i), walk));
                break;
        }
    }
    for (std::size_t i = 0; i < scene.volumes.size(); ++i) sources.push_back(std::make_unique<VolumeSource>(scene, i));
    return sources;
}

std::vector<LineSampler> make_samplers(const PreparedScene& scene) {
    std::vector<LineSampler> samplers;
    samplers.reserve(scene.objects.size());
    for (std::size_t i = 0; i < scene.objects.size(); ++i)
        samplers.emplace_back(scene.objects[i], scene.camera, static_cast<std::uint32_t>(i), scene.settings.lights);
    return samplers;
}

}  // namespace pellucid
