#include "sample/make_sources.hpp"

#include <cmath>

#include "core/error.hpp"
#include "sample/mesh_sampler.hpp"
#include "sample/volume_source.hpp"

namespace pellucid {

SourceRefs::SourceRefs(const Sources& sources) {
    for (const auto& source : sources) refs_.push_back(source.get());
}

SourceRefs::SourceRefs(const std::vector<LineSampler>& samplers) {
    for (const LineSampler& sampler : samplers) refs_.push_back(&sampler);
}

namespace {

[[nodiscard]] int mesh_cells(const Object& object, const Camera& camera, const SourceSettings& settings) {
    if (!(settings.mesh_error_px > 0)) return settings.mesh_cells;
    const auto pixel = ViewThinning(object, camera).least_pixel_area();
    return pixel ? cells_for_error(object, settings.mesh_error_px * std::sqrt(*pixel)) : settings.mesh_cells;
}

[[nodiscard]] std::unique_ptr<const ParticleSource> octree_source(const Object& object, const Camera& camera, std::uint32_t id,
                                                                 int cells) {
    SurfaceTriangles found = octree_triangles(object, cells);
    std::string complaint;
    if (found.dropped > 0)
        complaint = fmt::format("surface \"{}\": in {} leaves of the octree f changes its sign and no tangent plane was found: raise "
                                "particles.octree.cells = {}",
                                object.surface.name, found.dropped, cells);
    return std::make_unique<MeshSampler>(object, std::move(found.mesh), camera, id, std::move(complaint));
}

/// The source of one surface.
[[nodiscard]] std::unique_ptr<const ParticleSource> make_source(const PreparedScene& scene, std::uint32_t id,
                                                                SamplerKind kind, const SourceSettings& settings) {
    const Object& object = scene.objects[id];
    const Camera& camera = scene.camera;
    switch (kind) {
        case SamplerKind::lines:
        case SamplerKind::stratified: break;
        case SamplerKind::brownian: return std::make_unique<BrownianSource>(object, camera, id, settings.walk);
        case SamplerKind::mesh:
            // Meshes, rectangles and slices are flat already: lines take them as they are.
            if (!object.geometry->field_surface()) break;
            return std::make_unique<MeshSampler>(
                object, tessellate(object, mesh_cells(object, camera, settings)).mesh, camera, id);
        case SamplerKind::octree: return octree_source(object, camera, id, settings.octree_cells);
    }
    return std::make_unique<LineSampler>(object, camera, id, scene.settings.lights);
}

}  // namespace

Sources make_sources(const PreparedScene& scene, SamplerKind kind, const SourceSettings& settings) {
    Sources sources;
    for (std::size_t i = 0; i < scene.objects.size(); ++i) {
        const Object& object = scene.objects[i];
        auto source = make_source(scene, static_cast<std::uint32_t>(i), kind, settings);
        if (settings.counting_spheres)
            source = counted_source(std::move(source), object, scene.camera, settings.counting, settings.seed);
        sources.push_back(std::move(source));
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
