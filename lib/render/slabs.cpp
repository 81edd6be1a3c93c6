// The method `slabs`: zSlabs, polygons and volumes intermixed per pixel (dissertation, figure 5.1).
//   polygon stage -> intermix -> volume stage -> intermix -> image
#include <algorithm>
#include <memory>
#include <optional>

#include "core/stopwatch.hpp"
#include "cpu/depth_peeling.hpp"
#include "cpu/volume_caster.hpp"
#include "render/methods.hpp"
#include "render/shared_settings.hpp"
#include "stage/slab_pipeline.hpp"

namespace pellucid {
namespace {

struct Settings {
    SlabSettings slabs;
    SlabFormat format = SlabFormat::float32;
    int surfaces = 0;  // L; 0: all
    double step = 1;   // voxels
    bool skip = true;
    TessellationSettings triangles;
};

[[nodiscard]] Settings read_settings(const RenderInput& input) {
    const ConfigTable& t = input.settings;
    Settings s;
    s.slabs.layers = static_cast<int>(t.integer("layers", s.slabs.layers, {.lo = 2, .hi = 1024}));
    s.slabs.interpolation = t.choice<SlabInterpolation>("interpolation", s.slabs.interpolation,
                                                        {{"modified", SlabInterpolation::modified},
                                                         {"original", SlabInterpolation::original},
                                                         {"original-textbook", SlabInterpolation::original_textbook}});
    s.slabs.intermix = t.choice<SlabIntermix>("intermix", s.slabs.intermix,
                                              {{"image", SlabIntermix::image},
                                               {"hybrid", SlabIntermix::hybrid},
                                               {"order-free", SlabIntermix::order_free}});
    s.slabs.mixing = read_mixing(t, s.slabs.mixing);
    s.slabs.compression = t.choice<SlabCompression>("compression", s.slabs.compression,
                                                    {{"transmittance", SlabCompression::transmittance},
                                                     {"slope", SlabCompression::slope},
                                                     {"tail", SlabCompression::tail}});
    s.slabs.opaque_at = static_cast<float>(
        t.number("opaque_at", static_cast<double>(s.slabs.opaque_at), {.lo = 0, .hi = 1, .lo_open = true}));
    s.format = t.choice<SlabFormat>(
        "format", s.format, {{"float", SlabFormat::float32}, {"half", SlabFormat::half}, {"byte", SlabFormat::byte}});
    s.surfaces = static_cast<int>(t.integer("surfaces", s.surfaces, {.lo = 0, .hi = 1 << 20}));
    s.step = t.number("step", s.step, {.lo = 1e-3, .hi = 1e3});
    s.skip = t.boolean("skip", s.skip);
    s.slabs.targets = static_cast<int>(t.integer("targets", s.slabs.targets, {.lo = 1, .hi = 64}));
    s.triangles = read_tessellation(input);
    return s;
}

[[nodiscard]] bool is_polygons(const Object& object) { return !IsosurfaceCaster::casts(object); }

/// Which of the three kinds of work a scene requires.
struct Parts {
    std::vector<std::uint32_t> polygons, isosurfaces;  // numbers in PreparedScene::objects
    std::vector<std::size_t> volumes;                  // that show anything
    [[nodiscard]] std::size_t count() const { return polygons.size() + isosurfaces.size() + volumes.size(); }
};
[[nodiscard]] Parts parts_of(const PreparedScene& scene) {
    Parts parts;
    for (std::uint32_t i = 0; i < scene.objects.size(); ++i)
        (is_polygons(scene.objects[i]) ? parts.polygons : parts.isosurfaces).push_back(i);
    for (std::size_t i = 0; i < scene.volumes.size(); ++i)
        if (!scene.volumes[i].bounds().empty()) parts.volumes.push_back(i);
    return parts;
}

[[nodiscard]] ZThicknessSize frame_size(const PreparedScene& scene, const Settings& settings) {
    return {scene.camera.width(), scene.camera.height(), settings.slabs.layers, settings.format};
}

[[nodiscard]] Image draw_slabs(const RenderInput& input, RenderStats& stats) {
    const Settings settings = read_settings(input);
    const PreparedScene& scene = input.scene;
    warn_of_rough_depths(scene);
    const Parts parts = parts_of(scene);
    const ZThicknessSize size = frame_size(scene, settings);
    Stopwatch watch;
    const std::unique_ptr<SlabPipeline> pipeline = input.backend.make_slab_pipeline(scene, size, settings.slabs);
    std::size_t done = 0;
    const auto step_done = [&] { input.progress(static_cast<double>(++done) / static_cast<double>(parts.count() + 1)); };

    double kernel_s = 0;  // which the stages took, and belongs to the last
    const auto lap_without_kernel = [&](const SlabStageStats& stage) {
        kernel_s += stage.kernel_s;
        return std::max(0.0, watch.lap() - stage.kernel_s);
    };

    std::optional<SceneMeshes> meshes;
    if (!parts.polygons.empty()) {
        meshes.emplace(scene, settings.triangles, is_polygons);
        stats.stages.push_back({"triangles", watch.lap(), static_cast<std::int64_t>(meshes->bytes()),
                                fmt::format("{} triangles", meshes->triangle_count())});
        SlabStageStats peeled;
        for (std::uint32_t object = 0; object < meshes->objects().size(); ++object) {
            pipeline->add_polygons(*meshes, object, settings.surfaces, peeled);
            step_done();
        }
        stats.stages.push_back({"polygons", lap_without_kernel(peeled), peeled.bytes, fmt::format("{} fragments", peeled.fragments)});
        stats.hits += peeled.fragments;
    }
    if (!parts.isosurfaces.empty()) {
        SlabStageStats cast;
        for (const std::uint32_t i : parts.isosurfaces) {
            const Object& object = scene.objects[i];
            const double pitch = voxel_pitch(object.geometry->field_surface()->to_world);
            pipeline->add_isosurface(object, {.step = settings.step * pitch, .skip = settings.skip}, cast);
            step_done();
        }
        stats.stages.push_back({"isosurfaces", lap_without_kernel(cast), cast.bytes, fmt::format("{} crossings", cast.slabs)});
        stats.hits += cast.slabs;
    }
    if (!parts.volumes.empty()) {
        SlabStageStats cast;
        for (const std::size_t i : parts.volumes) {
            const VolumeObject& volume = scene.volumes[i];
            const bool on_the_fly = settings.slabs.intermix == SlabIntermix::hybrid && i == parts.volumes.back();
            pipeline->add_volume(volume, {.step = settings.step * voxel_pitch(volume.to_world()), .skip = settings.skip}, on_the_fly, cast);
            step_done();
        }
        stats.stages.push_back({"volumes", lap_without_kernel(cast), cast.bytes, fmt::format("{} slabs", cast.slabs)});
    }
    Image image = pipeline->image();
    stats.stages.push_back({"intermix", kernel_s + watch.lap(), static_cast<std::int64_t>(pipeline->bytes()),
                            fmt::format("{} z-thickness buffers", pipeline->buffers())});
    for (const StageTime& time : pipeline->device_times()) stats.stages.push_back({time.name, 0, 0, "", time.device_s});
    step_done();
    return image;
}

[[nodiscard]] std::vector<Stage> plan_slabs(const RenderInput& input) {
    const Settings settings = read_settings(input);
    const PreparedScene& scene = input.scene;
    const Parts parts = parts_of(scene);
    std::vector<Stage> stages{
        {"read scene", 0, static_cast<std::int64_t>(scene.bytes()), fmt::format("{} objects", scene.object_count())}};
    if (!parts.polygons.empty()) {
        const MeshPlan plan = plan_meshes(scene, settings.triangles, is_polygons);
        stages.push_back({"triangles", 0, plan.bytes, fmt::format("{:.0f} triangles", plan.triangles)});
        stages.push_back({"polygons", 0, input.backend.planned_surface_bytes(scene, plan.triangles, plan.triangles / 2),
                          settings.surfaces > 0 ? fmt::format("{} objects, {} surfaces each", parts.polygons.size(), settings.surfaces)
                                                : fmt::format("{} objects, all surfaces", parts.polygons.size())});
    }
    if (!parts.isosurfaces.empty()) {
        std::int64_t most = 0;
        for (const std::uint32_t i : parts.isosurfaces)
            if (settings.skip) most = std::max(most, IsosurfaceCaster::planned_bytes(scene.objects[i]));
        stages.push_back({"isosurfaces", 0, most, fmt::format("{} objects, one at a time", parts.isosurfaces.size())});
    }
    if (!parts.volumes.empty()) {
        std::int64_t most = 0;
        for (const std::size_t i : parts.volumes)
            most = std::max(most, input.backend.planned_cast_bytes(scene, scene.volumes[i], settings.skip));
        stages.push_back({"volumes", 0, most, fmt::format("{} volumes, one at a time", parts.volumes.size())});
    }
    const std::size_t objects = std::max<std::size_t>(1, parts.count());
    const std::size_t frames = settings.slabs.intermix == SlabIntermix::order_free ? objects : 1;
    stages.push_back({"intermix", 0, input.backend.planned_slab_bytes(scene, frame_size(scene, settings), settings.slabs, objects),
                      fmt::format("{} z-thickness buffer{} of {} layers, {} bytes a slab", frames, frames == 1 ? "" : "s",
                                  settings.slabs.layers, bytes_of(settings.format))});
    stages.push_back({"image", 0, std::int64_t{4} * 5 * scene.camera.width() * scene.camera.height(), "5 planes"});
    return stages;
}

}  // namespace

Method slabs_method() {
    static const std::string kSummary = fmt::format("zSlabs, intermixed per pixel: {}; volumes", kEveryShape);
    return {
        "slabs",
        kSummary,
        {
            {"slabs.layers", "8", "N: the image and up to N - 1 slabs a pixel, 2 to 1024"},
            {"slabs.interpolation", "\"modified\"",
             "opacity inside of a slab: \"modified\" (linear, 3.4), \"original\" (a medium's, 3.2), \"original-textbook\" (3.2 as it stands)"},
            {"slabs.intermix", "\"image\"", "\"image\", \"hybrid\" (the last volume meets the array sample by sample), \"order-free\""},
            {"slabs.mixing", "\"average\"", "of slabs in one place: \"average\" (4.4), \"normalised\" (4.3), \"extinction\""},
            {"slabs.compression", "\"transmittance\"", "of what does not fit: \"transmittance\", \"slope\" (2.6, 2.7), \"tail\""},
            {"slabs.format", "\"float\"", "of a slab: \"float\" (24 bytes), \"half\", \"byte\" (12 bytes)"},
            {"slabs.surfaces", "0", "L: most surfaces an object and pixel, the nearest (the dissertation: 4); 0: all"},
            {"slabs.targets", "4", "M: surfaces of a pixel that a device finds in one pass, 1 to 64; no pixel changes"},
            {"slabs.step", "1", "length of a ray's step in voxels of its volume"},
            {"slabs.skip", "true", "whether empty blocks are skipped; no pixel changes"},
            {"slabs.opaque_at", "0.999", "opacity at which a pixel is finished"},
            {"tessellate.error_px", "0.25", "surfaces without triangles: largest distance of theirs, in pixels"},
        },
        refusal_of_ray_and_particle_methods,
        [](const RenderInput& input) { (void)read_settings(input); },
        plan_slabs,
        draw_slabs,
        true,
    };
}

}  // namespace pellucid
