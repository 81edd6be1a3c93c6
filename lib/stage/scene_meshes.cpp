#include "stage/scene_meshes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "sample/surface_mesh.hpp"
#include "sample/view_thinning.hpp"
#include "stage/refine_mesh.hpp"
#include "stage/singular_mesh.hpp"

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

/// Cells of the grid that finds the surface before it is refined: a part of it that is smaller than a cell may be missed.
constexpr double kCellPixels = 6;
constexpr int kLeastCells = 32;
constexpr int kMostCells = 192;

/// What refining leaves of a smooth surface is far less.
constexpr double kSingularPx = 1;

/// Along the longest edge of the bounds.
[[nodiscard]] int cells_of(const Object& object, double pixel_side) {
    const Vec3 size = object.geometry->bounds().size();
    const double wanted = std::max({size.x, size.y, size.z}) / (kCellPixels * pixel_side);
    return static_cast<int>(std::clamp<double>(std::ceil(wanted), kLeastCells, kMostCells));
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
            RefinedMesh found =
                refine_mesh(object, scene.camera, tessellate(object, cells_of(object, *side)).mesh, settings.error_px);
            // Formulas that stay far off have places where no grid's signs show the surface.
            if (found.error_px > kSingularPx && geometry.field_surface()->cell_width == 0) {
                RefinedMesh other = refine_mesh(object, scene.camera, singular_mesh(surface_for_triangles(object), scene.camera, {}),
                                                settings.error_px);
                if (other.error_px < found.error_px) found = std::move(other);
            }
            out.error_px = found.error_px;
            if (found.off > 0)
                warn("surface \"{}\": {} of its {} triangles are off by more than tessellate.error_px = {}, up to {:.2g}: beside "
                     "places where its gradient vanishes or jumps",
                     object.surface.name, found.off, found.mesh.triangles.size(), settings.error_px, found.error_px);
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

SceneMeshes::SceneMeshes(const PreparedScene& scene, const TessellationSettings& settings,
                         const std::function<bool(const Object&)>& takes) {
    std::size_t count = 0;
    for (std::size_t i = 0; i < scene.objects.size(); ++i) {
        first_.push_back(static_cast<std::uint32_t>(count));
        if (!takes || takes(scene.objects[i]))
            objects_.push_back(mesh_of(scene, i, settings));
        else
            objects_.push_back({.object = static_cast<std::uint32_t>(i), .mesh = std::make_shared<TriangleMesh>(), .view = {}});
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

MeshPlan plan_meshes(const PreparedScene& scene, const TessellationSettings& settings,
                     const std::function<bool(const Object&)>& takes) {
    constexpr int kCoarse = 16;
    constexpr double kBytesATriangle = 12 + 0.5 * 3 * sizeof(Vec3);  // half a vertex each
    MeshPlan plan;
    for (const Object& object : scene.objects) {
        if (takes && !takes(object)) continue;
        ++plan.objects;
        const SurfaceGeometry& geometry = *object.geometry;
        if (geometry.mesh() != nullptr) {
            plan.triangles += static_cast<double>(geometry.mesh()->triangles.size());
            plan.bytes += static_cast<std::int64_t>(sizeof(Vec3) * geometry.mesh()->positions.size());
        } else if (geometry.field_surface()) {
            ++plan.tessellated;
            const auto side = least_pixel_side(object, scene.camera);
            if (geometry.patch_count() == 0 || !side) continue;
            // Triangles grow with the square of the cells; or with the error, which falls with it.
            const SurfaceTriangles coarse = tessellate(object, kCoarse);
            const double finest = std::pow(static_cast<double>(cells_of(object, *side)) / kCoarse, 2);
            const double refined = coarse.error / (settings.error_px * *side);
            const double triangles = std::max(finest, std::min(refined, 16 * finest)) * static_cast<double>(coarse.mesh.triangles.size());
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
