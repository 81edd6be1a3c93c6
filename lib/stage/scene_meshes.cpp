#include "stage/scene_meshes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "sample/surface_mesh.hpp"
#include "sample/view_thinning.hpp"

namespace pellucid {
namespace {

constexpr std::size_t kVerticesAtOnce = 4096;

/// Patches that are flat: triangles as they are, parallelograms as two.
[[nodiscard]] TriangleMesh flat_patches(const SurfaceGeometry& geometry) {
    TriangleMesh mesh;
    for (std::size_t patch = 0; patch < geometry.patch_count(); ++patch) {
        std::array<Vec3, 8> corner;
        const int count = geometry.body(patch).vertices(corner);
        const auto first = static_cast<std::uint32_t>(mesh.positions.size());
        mesh.positions.insert(mesh.positions.end(), corner.begin(), corner.begin() + count);
        mesh.triangles.push_back({first, first + 1, first + 2});
        if (count == 4) mesh.triangles.push_back({first + 3, first + 2, first + 1});
    }
    return mesh;
}

/// Side of a pixel where the surface is nearest; empty where none of it is in view.
[[nodiscard]] std::optional<double> least_pixel_side(const Object& object, const Camera& camera) {
    const auto area = ViewThinning(object, camera).least_pixel_area();
    return area ? std::optional(std::sqrt(*area)) : std::nullopt;
}

[[nodiscard]] ObjectMesh mesh_of(const PreparedScene& scene, std::size_t number, const TessellationSettings& settings) {
    const Object& object = scene.objects[number];
    const SurfaceGeometry& geometry = *object.geometry;
    ObjectMesh out;
    out.object = static_cast<std::uint32_t>(number);
    if (geometry.mesh() != nullptr) {
        out.mesh = {object.geometry, geometry.mesh()};
    } else if (geometry.field_surface()) {
        out.of_field = true;
        TriangleMesh mesh;
        const auto side = least_pixel_side(object, scene.camera);
        if (geometry.patch_count() > 0 && side) {
            SurfaceTriangles found = tessellate(object, cells_for_error(object, settings.error_px * *side));
            out.error_px = found.error / *side;
            if (out.error_px > settings.error_px)
                warn("surface \"{}\": its triangles are up to {:.2g} pixels from it, tessellate.error_px = {}",
                     object.surface.name, out.error_px, settings.error_px);
            mesh = std::move(found.mesh);
        }
        out.mesh = std::make_shared<const TriangleMesh>(std::move(mesh));
    } else {
        out.mesh = std::make_shared<const TriangleMesh>(flat_patches(geometry));
    }
    out.view.resize(out.mesh->positions.size());
    parallel_for(out.view.size(), kVerticesAtOnce, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) out.view[i] = scene.camera.to_view(out.mesh->positions[i]);
    });
    return out;
}

}  // namespace

std::size_t ObjectMesh::bytes() const {
    return sizeof(Vec3) * (view.size() + mesh->positions.size() + mesh->normals.size()) + 12 * mesh->triangles.size();
}

SceneMeshes::SceneMeshes(const PreparedScene& scene, const TessellationSettings& settings) {
    std::size_t count = 0;
    for (std::size_t i = 0; i < scene.objects.size(); ++i) {
        first_.push_back(static_cast<std::uint32_t>(count));
        objects_.push_back(mesh_of(scene, i, settings));
        count += objects_.back().mesh->triangles.size();
        if (count > std::numeric_limits<std::uint32_t>::max())
            throw input_error("{}: more than 2^32 triangles", scene.settings.source);
    }
    first_.push_back(static_cast<std::uint32_t>(count));
}

std::size_t SceneMeshes::object_of(std::uint32_t triangle) const {
    return static_cast<std::size_t>(std::upper_bound(first_.begin(), first_.end(), triangle) - first_.begin()) - 1;
}

double SceneMeshes::error_px() const {
    double most = 0;
    for (const ObjectMesh& each : objects_) most = std::max(most, each.error_px);
    return most;
}

std::size_t SceneMeshes::bytes() const {
    std::size_t sum = 0;
    for (const ObjectMesh& each : objects_) sum += each.bytes();
    return sum;
}

MeshPlan plan_meshes(const PreparedScene& scene, const TessellationSettings& settings) {
    constexpr int kCoarse = 16;
    constexpr double kBytesATriangle = 12 + 0.5 * 3 * sizeof(Vec3);  // half a vertex each
    MeshPlan plan;
    for (const Object& object : scene.objects) {
        ++plan.objects;
        const SurfaceGeometry& geometry = *object.geometry;
        if (geometry.mesh() != nullptr) {
            plan.triangles += static_cast<double>(geometry.mesh()->triangles.size());
            plan.bytes += static_cast<std::int64_t>(sizeof(Vec3) * geometry.mesh()->positions.size());
        } else if (geometry.field_surface()) {
            ++plan.tessellated;
            const auto side = least_pixel_side(object, scene.camera);
            if (geometry.patch_count() == 0 || !side) continue;
            // Triangles grow with the square of the cells, and the error falls with it.
            const SurfaceTriangles coarse = tessellate(object, kCoarse);
            const double error = settings.error_px * *side;
            const double most = double{kMostMeshCells} / kCoarse;
            const double finer = std::min(std::max(4.0, 1.1 * 1.1 * coarse.error / error), most * most);
            const double triangles = finer * static_cast<double>(coarse.mesh.triangles.size());
            plan.triangles += triangles;
            plan.bytes += static_cast<std::int64_t>(kBytesATriangle * triangles);
        } else {
            plan.triangles += 2 * static_cast<double>(geometry.patch_count());
            plan.bytes += static_cast<std::int64_t>(2 * 4 * sizeof(Vec3) * geometry.patch_count());
        }
    }
    return plan;
}

}  // namespace pellucid
