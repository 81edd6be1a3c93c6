// The method `mdvr`: conventional multi-volume ray-casting behind the common face of all methods. Isosurfaces
// are found along the rays; other surfaces are the fragments of depth peeling.
#include <algorithm>

#include "cpu/depth_peeling.hpp"
#include "cpu/multi_volume_caster.hpp"
#include "cpu/packed_volume.hpp"
#include "core/stopwatch.hpp"
#include "render/methods.hpp"
#include "render/shared_settings.hpp"

namespace pellucid {
namespace {

[[nodiscard]] MultiVolumeSettings read_settings(const RenderInput& input) {
    MultiVolumeSettings s;
    s.step = input.settings.number("step", s.step, {.lo = 1e-3, .hi = 1e3});
    s.mixing = read_mixing(input.settings, s.mixing);
    s.skip = input.settings.boolean("skip", s.skip);
    s.rays = static_cast<int>(input.settings.integer("rays", s.rays, {.lo = 1, .hi = 64}));
    s.opaque_at = static_cast<float>(input.settings.number("opaque_at", static_cast<double>(s.opaque_at),
                                                           {.lo = 0, .hi = 1, .lo_open = true}));
    return s;
}

/// The surfaces that become triangles, alone in a scene whose image has n × n pixels for each.
[[nodiscard]] PreparedScene polygons_of(const PreparedScene& scene, int n) {
    std::vector<Object> polygons;
    Box visible;
    for (const Object& object : scene.objects) {
        if (object.geometry->patch_count() > 0) visible.include(object.geometry->bounds());
        if (!IsosurfaceCaster::casts(object)) polygons.push_back(object);
    }
    for (const VolumeObject& volume : scene.volumes) visible.include(volume.bounds());
    Scene settings = scene.settings;
    settings.image.width *= n;
    settings.image.height *= n;
    PixelRect crop = scene.camera.crop();
    for (int* edge : {&crop.x0, &crop.y0, &crop.x1, &crop.y1}) *edge *= n;
    const Camera camera(settings.camera, settings.image, visible, crop);
    return {settings, std::move(polygons), {}, camera};
}

/// The fragments of some rows of pixels.
[[nodiscard]] SurfaceLayers layers_of_rows(const PreparedScene& fine, const SceneMeshes& meshes, int n,
                                           int y0, int y1, double opaque_at) {
    PixelRect crop = fine.camera.crop();
    crop.y1 = crop.y0 + n * y1;
    crop.y0 += n * y0;
    Box visible;
    for (const Object& object : fine.objects)
        if (object.geometry->patch_count() > 0) visible.include(object.geometry->bounds());
    PreparedScene band = fine;
    CameraSettings camera = fine.settings.camera;
    camera.near = fine.camera.near();
    camera.far = fine.camera.far();
    band.camera = Camera(camera, fine.settings.image, visible, crop);
    const auto width = static_cast<std::size_t>(crop.x1 - crop.x0);
    std::vector<std::vector<twin::Slab>> of(width * static_cast<std::size_t>(crop.y1 - crop.y0));
    (void)peel(band, meshes, all_objects(meshes), {.opaque_at = opaque_at, .thickness = false},
               [&](int x, int y, std::span<const SurfaceFragment> fragments) {
                   auto& slabs = of[static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x)];
                   for (const SurfaceFragment& f : fragments) slabs.push_back(f.slab);
               });
    SurfaceLayers layers;
    layers.first.push_back(0);
    for (const auto& slabs : of) {
        layers.slabs.insert(layers.slabs.end(), slabs.begin(), slabs.end());
        layers.first.push_back(layers.slabs.size());
    }
    return layers;
}

[[nodiscard]] std::vector<Stage> plan_mdvr(const RenderInput& input) {
    const MultiVolumeSettings settings = read_settings(input);
    std::int64_t bytes = 0;
    for (const VolumeObject& volume : input.scene.volumes)
        if (!volume.bounds().empty()) bytes += PackedVolume::planned_bytes(volume, settings.skip);
    bool polygons = false;
    for (const Object& object : input.scene.objects) {
        if (!IsosurfaceCaster::casts(object)) polygons = true;
        else if (settings.skip) bytes += IsosurfaceCaster::planned_bytes(object);
    }
    std::vector<Stage> stages{{"read scene", 0, static_cast<std::int64_t>(input.scene.bytes()),
                               fmt::format("{} objects", input.scene.object_count())}};
    if (polygons) {
        const MeshPlan plan = plan_meshes(polygons_of(input.scene, settings.rays), read_tessellation(input));
        stages.push_back({"triangles", 0, plan.bytes, fmt::format("{:.0f} triangles of {} objects", plan.triangles, plan.objects)});
        stages.push_back({"polygons", 0, planned_peel_bytes(plan.triangles, plan.triangles / 2), "all surfaces, in bands of rows"});
    }
    if (bytes > 0) stages.push_back({"pack volumes", 0, bytes, "at most, where samples are integers"});
    stages.push_back({"cast", 0, 0,
                      fmt::format("{} rays a pixel, steps of {:.4g}", settings.rays * settings.rays,
                                  common_step(input.scene, settings.step))});
    stages.push_back({"image", 0, std::int64_t{20} * input.scene.camera.width() * input.scene.camera.height(),
                      "5 planes"});
    return stages;
}

[[nodiscard]] Image draw_mdvr(const RenderInput& input, RenderStats& stats) {
    const MultiVolumeSettings settings = read_settings(input);
    const PreparedScene& scene = input.scene;
    MultiVolumeStats cast;
    Stopwatch watch;
    double triangles_s = 0;
    FindSurfaces find;
    std::optional<PreparedScene> fine;
    std::optional<SceneMeshes> meshes;
    if (!std::ranges::all_of(scene.objects, IsosurfaceCaster::casts)) {
        warn_of_rough_depths(scene);
        fine = polygons_of(scene, settings.rays);
        meshes.emplace(*fine, read_tessellation(input));
        triangles_s = watch.lap();
        find = [&](int y0, int y1) {
            SurfaceLayers layers = layers_of_rows(*fine, *meshes, settings.rays, y0, y1, static_cast<double>(settings.opaque_at));
            stats.hits += layers.slabs.size();
            return layers;
        };
    }
    Image image = input.backend.cast_volumes(scene, settings, cast, input.progress, find);
    if (meshes) {
        stats.stages.push_back({"triangles", triangles_s, static_cast<std::int64_t>(meshes->bytes()),
                                fmt::format("{} triangles", meshes->triangle_count())});
        stats.stages.push_back({"polygons", cast.surfaces_s, 0, fmt::format("{} fragments", stats.hits)});
    }
    stats.stages.push_back({"pack volumes", cast.prepare_s, cast.bytes, ""});
    stats.stages.push_back({"cast", cast.cast_s, 0, ""});
    if (input.backend.on_device()) stats.stages.back().device_s = cast.cast_device_s;
    stats.rays = cast.rays;
    return image;
}

}  // namespace

Method mdvr_method() {
    return {
        "mdvr",
        "conventional ray-casting, all volumes sampled at the same places, surfaces between the parts of a "
        "step; all "
        "surfaces, volumes",
        {
            {"mdvr.step", "1", "length of a step in smallest voxels of the scene"},
            {"mdvr.rays", "1", "n: n x n rays a pixel"},
            {"mdvr.mixing", "\"average\"",
             "of volumes within a step: \"average\" (4.4), \"normalised\" (4.3), \"extinction\""},
            {"mdvr.skip", "true", "whether empty blocks are skipped; no pixel changes"},
            {"mdvr.opaque_at", "0.999", "opacity at which a ray ends"},
            {"tessellate.error_px", "0.25",
             "surfaces without triangles: largest distance of theirs, in pixels"},
        },
        refusal_of_ray_and_particle_methods,
        [](const RenderInput& input) {
            (void)read_settings(input);
            (void)read_tessellation(input);
        },
        plan_mdvr,
        draw_mdvr,
        true,
    };
}

}  // namespace pellucid
