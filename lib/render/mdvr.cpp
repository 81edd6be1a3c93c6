// The method `mdvr`: conventional multi-volume ray-casting behind the common face of all methods.
#include "cpu/multi_volume_caster.hpp"
#include "render/methods.hpp"

namespace pellucid {
namespace {

[[nodiscard]] MultiVolumeSettings read_settings(const RenderInput& input) {
    MultiVolumeSettings s;
    s.step = input.settings.number("step", s.step, {.lo = 1e-3, .hi = 1e3});
    s.mixing = input.settings.choice<SlabMixing>("mixing", s.mixing,
                                                 {{"average", SlabMixing::average},
                                                  {"normalised", SlabMixing::normalised},
                                                  {"extinction", SlabMixing::extinction}});
    s.skip = input.settings.boolean("skip", s.skip);
    s.rays = static_cast<int>(input.settings.integer("rays", s.rays, {.lo = 1, .hi = 64}));
    s.opaque_at = static_cast<float>(
        input.settings.number("opaque_at", static_cast<double>(s.opaque_at), {.lo = 0, .hi = 1, .lo_open = true}));
    return s;
}

[[nodiscard]] std::vector<Stage> plan_mdvr(const RenderInput& input) {
    const MultiVolumeSettings settings = read_settings(input);
    std::int64_t blocks = 0;
    const auto count = [&](const std::array<int, 3>& cells) {
        std::int64_t product = 1;
        for (const int n : cells) product *= (n + EmptySpace::kBlock - 1) / EmptySpace::kBlock;
        blocks += product;
    };
    for (const VolumeObject& volume : input.scene.volumes)
        if (!volume.bounds().empty()) count(volume.cells());
    for (const Object& object : input.scene.objects)
        if (const auto surface = object.geometry->field_surface()) {
            const Vec3 last = surface->bounds.hi;
            count({static_cast<int>(last.x), static_cast<int>(last.y), static_cast<int>(last.z)});
        }
    return {
        {"read scene", 0, static_cast<std::int64_t>(input.scene.bytes()), fmt::format("{} objects", input.scene.object_count())},
        {"find empty space", 0, settings.skip ? blocks : 0, settings.skip ? fmt::format("{} blocks", blocks) : "mdvr.skip = false"},
        {"cast", 0, 0, fmt::format("{} rays a pixel, steps of {:.4g}", settings.rays * settings.rays, common_step(input.scene, settings.step))},
        {"image", 0, std::int64_t{20} * input.scene.camera.width() * input.scene.camera.height(), "5 planes"},
    };
}

[[nodiscard]] std::optional<std::string> refusal_of_mdvr(const Scene& scene) {
    for (const Surface& surface : scene.surfaces) {
        const auto* iso = std::get_if<IsosurfaceShape>(&surface.shape);
        if (iso == nullptr)
            return fmt::format("surface \"{}\": it draws volumes and isosurfaces", surface.name);
        if (iso->interpolation == Interpolation::nearest)
            return fmt::format("surface \"{}\": isosurfaces with interpolation = \"nearest\"", surface.name);
        if (!surface.contours.empty()) return fmt::format("surface \"{}\": it has contours", surface.name);
    }
    return std::nullopt;
}

}  // namespace

Method mdvr_method() {
    return {
        "mdvr",
        "conventional ray-casting, all volumes sampled at the same places; volumes and isosurfaces",
        {
            {"mdvr.step", "1", "length of a step in smallest voxels of the scene"},
            {"mdvr.rays", "1", "n: n x n rays a pixel"},
            {"mdvr.mixing", "\"average\"", "of volumes within a step: \"average\" (4.4), \"normalised\" (4.3), \"extinction\""},
            {"mdvr.skip", "true", "whether empty blocks are skipped; no pixel changes"},
            {"mdvr.opaque_at", "0.999", "opacity at which a ray ends"},
        },
        refusal_of_mdvr,
        [](const RenderInput& input) { (void)read_settings(input); },
        plan_mdvr,
        [](const RenderInput& input, RenderStats& stats) {
            MultiVolumeStats cast;
            Image image = cast_volumes(input.scene, read_settings(input), cast, input.progress);
            stats.stages.push_back({"find empty space", cast.prepare_s, cast.bytes, ""});
            stats.stages.push_back({"cast", cast.cast_s, 0, ""});
            stats.rays = cast.rays;
            return image;
        },
    };
}

}  // namespace pellucid
