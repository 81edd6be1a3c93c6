// The method `reference`: the Embree truth behind the common face of all methods.
#include <bit>

#include "reference/truth.hpp"
#include "render/methods.hpp"

namespace pellucid {
namespace {

[[nodiscard]] TruthSettings read_settings(const RenderInput& input) {
    TruthSettings s;
    s.filter = input.settings.choice<PixelFilter>("filter", PixelFilter::box,
                                                  {{"box", PixelFilter::box}, {"particle", PixelFilter::particle}});
    s.max_error = input.settings.number("max_error", s.max_error, above(0));
    s.max_samples = static_cast<int>(input.settings.integer("max_samples", s.max_samples, {.lo = 64, .hi = 1 << 20}));
    if (input.max_error) s.max_error = *input.max_error;
    if (input.settings.has("samples")) {
        const auto samples = input.settings.integer("samples", kRequired, {.lo = 16, .hi = 1 << 20});
        if (!std::has_single_bit(static_cast<std::uint64_t>(samples)) || std::countr_zero(static_cast<std::uint64_t>(samples)) % 2 != 0)
            throw input.settings.error("samples", fmt::format("= {}, expected 16, 64, 256, … (a power of 4)", samples));
        s.samples = static_cast<int>(samples);
    }
    s.seed = input.seed;
    return s;
}

[[nodiscard]] std::vector<Stage> plan_reference(const RenderInput& input) {
    const TruthSettings settings = read_settings(input);
    std::size_t patches = 0;
    for (const Object& object : input.scene.objects) patches += object.geometry->patch_count();
    const std::int64_t planes = settings.filter == PixelFilter::particle ? 13 : 9;
    // Embree's own estimate of a BVH is about 100 bytes a primitive at medium quality.
    return {
        {"read scene", 0, static_cast<std::int64_t>(input.scene.bytes()), fmt::format("{} objects", input.scene.object_count())},
        {"build ray scene", 0, static_cast<std::int64_t>(100 * patches), fmt::format("{} patches", patches)},
        {"trace", 0, 0,
         settings.samples
             ? fmt::format("{} rays a pixel", *settings.samples)
             : fmt::format("64 to {} rays a pixel, standard error <= {}", settings.max_samples, settings.max_error)},
        {"image", 0, 4 * planes * input.scene.camera.width() * input.scene.camera.height(), fmt::format("{} planes", planes)},
    };
}

}  // namespace

Method reference_method() {
    static const std::string kSummary = fmt::format("ray-traced truth, all crossings in order: {}; volumes", kEveryShape);
    return {
        "reference",
        kSummary,
        {
            {"reference.filter", "\"box\"", "\"box\": mean over the pixel; \"particle\": what particles converge to"},
            {"reference.max_error", "0.002", "standard error to reach in every channel (also --max-error)"},
            {"reference.max_samples", "4096", "most sub-rays a pixel; the first estimate takes 64"},
            {"reference.samples", "none", "exactly 16, 64, 256, … sub-rays in every pixel, whatever the error"},
        },
        refusal_of_ray_and_particle_methods,
        [](const RenderInput& input) { (void)read_settings(input); },
        plan_reference,
        [](const RenderInput& input, RenderStats& stats) {
            TruthStats truth;
            Image image = trace_truth(input.scene, read_settings(input), truth, input.progress);
            stats.stages.push_back({"build ray scene", truth.build_s, truth.embree_bytes, ""});
            stats.stages.push_back({"trace", truth.trace_s, 0, ""});
            stats.rays = truth.rays;
            stats.hits = truth.hits;
            stats.unresolved_pixels = truth.unresolved_pixels;
            stats.worst_error = truth.worst_error;
            stats.isolation = truth.isolation;
            return image;
        },
    };
}

}  // namespace pellucid
