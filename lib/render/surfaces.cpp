// Methods that draw surfaces as triangles: depth test, depth peeling, painters' blending. One pipeline:
//   triangles of all surfaces -> fragments of each pixel in the method's order -> one colour
#include <algorithm>
#include <numeric>

#include "core/stopwatch.hpp"
#include "render/methods.hpp"
#include "render/shared_settings.hpp"
#include "stage/scene_meshes.hpp"
#include "stage/surface_drawer.hpp"

namespace pellucid {
namespace {

enum class Sort { none, object, triangle };

[[nodiscard]] Sort read_sort(const RenderInput& input) {
    return input.settings.choice<Sort>("sort", Sort::none,
                                       {{"none", Sort::none}, {"object", Sort::object}, {"triangle", Sort::triangle}});
}

[[nodiscard]] int read_layers(const RenderInput& input) {
    return static_cast<int>(input.settings.integer("layers", 0, {.lo = 0, .hi = 1 << 20}));
}

/// Rank of every triangle from the foremost, which is blended last.
[[nodiscard]] std::vector<std::uint32_t> painters_order(const PreparedScene& scene, const SceneMeshes& meshes, Sort sort) {
    std::vector<double> depth(sort == Sort::none ? 0 : meshes.triangle_count());
    for (std::size_t o = 0; o < meshes.objects().size() && sort != Sort::none; ++o) {
        const ObjectMesh& object = meshes.objects()[o];
        Box bounds;
        for (const Vec3& p : object.mesh->positions) bounds.include(p);
        const double center = object.view.empty() ? 0 : scene.camera.to_view(bounds.center()).z;
        for (std::uint32_t i = 0; i < object.mesh->triangles.size(); ++i) {
            const auto& [a, b, c] = object.mesh->triangles[i];
            depth[meshes.first_triangle(o) + i] =
                sort == Sort::object ? center : (object.view[a].z + object.view[b].z + object.view[c].z) / 3;
        }
    }
    // Farthest first; at the same depth as the file has them.
    std::vector<std::uint32_t> drawn(meshes.triangle_count());
    std::iota(drawn.begin(), drawn.end(), 0U);
    if (sort != Sort::none)
        std::stable_sort(drawn.begin(), drawn.end(), [&](std::uint32_t a, std::uint32_t b) { return depth[a] > depth[b]; });
    std::vector<std::uint32_t> rank(drawn.size());
    for (std::size_t i = 0; i < drawn.size(); ++i) rank[drawn[i]] = static_cast<std::uint32_t>(drawn.size() - 1 - i);
    return rank;
}

// ---- The pipeline

[[nodiscard]] Image draw_surfaces(const RenderInput& input, RenderStats& stats, SurfaceDrawSettings settings,
                                  std::optional<Sort> sort = {}) {
    Stopwatch watch;
    const PreparedScene& scene = input.scene;
    warn_of_rough_depths(scene);
    const SceneMeshes meshes(scene, read_tessellation(input));
    stats.stages.push_back({"triangles", watch.lap(), static_cast<std::int64_t>(meshes.bytes()),
                            fmt::format("{} triangles, error <= {:.2g} pixels", meshes.triangle_count(), meshes.error_px())});
    std::vector<std::uint32_t> order;
    if (sort) {
        order = painters_order(scene, meshes, *sort);
        stats.stages.push_back({"sort", watch.lap(), static_cast<std::int64_t>(4 * order.size()), ""});
    }
    settings.order = order;

    const auto drawer = input.backend.make_surface_drawer(scene, meshes);
    SurfaceDrawStats drawn;
    Image image = drawer->draw(settings, drawn);
    stats.stages.push_back({"draw", watch.lap(), drawn.bytes,
                            fmt::format("{} fragments, up to {} a pixel, {} passes", drawn.fragments, drawn.layers, drawn.passes)});
    // What the device's clock says of parts of the drawing; their wall time is in "draw".
    for (const StageTime& time : drawer->device_times())
        stats.stages.push_back({time.name, 0, 0, "part of the drawing", time.device_s});
    stats.hits = drawn.fragments;
    stats.layers = drawn.layers;
    input.progress(1);
    return image;
}

[[nodiscard]] std::vector<Stage> plan_surfaces(const RenderInput& input, bool sorted) {
    const PreparedScene& scene = input.scene;
    const MeshPlan plan = plan_meshes(scene, read_tessellation(input));
    const Camera& camera = scene.camera;
    std::vector<Stage> stages{
        {"read scene", 0, static_cast<std::int64_t>(scene.bytes()), fmt::format("{} objects", scene.object_count())},
        {"triangles", 0, plan.bytes,
         fmt::format("{:.0f} triangles of {} objects, {} tessellated", plan.triangles, plan.objects, plan.tessellated)}};
    if (sorted) stages.push_back({"sort", 0, static_cast<std::int64_t>(4 * plan.triangles), ""});
    stages.push_back({"draw", 0, input.backend.planned_surface_bytes(scene, plan.triangles, plan.triangles / 2),
                      input.backend.on_device() ? "on the device" : "without the fragments of tiles at work"});
    stages.push_back({"image", 0, std::int64_t{4} * 5 * camera.width() * camera.height(), "5 planes"});
    return stages;
}

[[nodiscard]] std::optional<std::string> refusal_of_surface_methods(const Scene& scene) {
    if (!scene.volumes.empty()) return fmt::format("volume \"{}\": it draws surfaces only", scene.volumes.front().name);
    return refusal_of_ray_and_particle_methods(scene);
}

constexpr SettingInfo kErrorSetting{"tessellate.error_px", "0.25", "surfaces without triangles: largest distance of theirs, in pixels"};

}  // namespace

Method z_test_method() {
    return {
        "z-test",
        "depth test: the nearest surface of a pixel's centre alone, as if opaque (whatever its opacity, but 0); all surfaces, "
        "no volumes",
        {kErrorSetting},
        refusal_of_surface_methods,
        [](const RenderInput& input) { (void)read_tessellation(input); },
        [](const RenderInput& input) { return plan_surfaces(input, false); },
        [](const RenderInput& input, RenderStats& stats) {
            return draw_surfaces(input, stats, {.mixing = SurfaceMixing::nearest, .layers = 1});
        },
        true,
    };
}

Method depth_peeling_method() {
    return {
        "depth-peeling",
        "exact order at every pixel's centre, surfaces at one depth mixed as in the truth; all surfaces, no volumes",
        {{"depth-peeling.layers", "0", "most surfaces a pixel, the nearest; 0: all"}, kErrorSetting},
        refusal_of_surface_methods,
        [](const RenderInput& input) {
            (void)read_layers(input);
            (void)read_tessellation(input);
        },
        [](const RenderInput& input) { return plan_surfaces(input, false); },
        [](const RenderInput& input, RenderStats& stats) {
            return draw_surfaces(input, stats, {.mixing = SurfaceMixing::by_depth, .layers = read_layers(input)});
        },
        true,
    };
}

Method alpha_blend_method() {
    return {
        "alpha-blend",
        "triangles blended one over the other without a depth test, in the file's order or sorted; all surfaces, no volumes",
        {{"alpha-blend.sort", "\"none\"",
          "\"none\": as in the file; \"object\", \"triangle\": farthest first, by the depth of their centres"},
         kErrorSetting},
        refusal_of_surface_methods,
        [](const RenderInput& input) {
            (void)read_sort(input);
            (void)read_tessellation(input);
        },
        [](const RenderInput& input) { return plan_surfaces(input, read_sort(input) != Sort::none); },
        [](const RenderInput& input, RenderStats& stats) {
            return draw_surfaces(input, stats, {.mixing = SurfaceMixing::blended}, read_sort(input));
        },
        true,
    };
}

}  // namespace pellucid
