// Triangle meshes: a triangle a patch, in world space.
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

class MeshGeometry final : public SurfaceGeometry {
public:
    explicit MeshGeometry(TriangleMesh world) : mesh_(std::move(world)) {
        for (const Vec3& p : mesh_.positions) bounds_.include(p);
    }

    [[nodiscard]] std::size_t patch_count() const override { return mesh_.triangles.size(); }
    [[nodiscard]] int max_crossings() const override { return 1; }

    [[nodiscard]] Body body(std::size_t patch) const override {
        const auto& [a, b, c] = mesh_.triangles[patch];
        const Vec3& corner = mesh_.positions[a];
        return {Body::Kind::triangle, corner, {mesh_.positions[b] - corner, mesh_.positions[c] - corner, Vec3(0.0)}};
    }

    int crossings(std::size_t patch, const Line& line, CrossingList& out) const override {
        out.hits.clear();
        // Möller-Trumbore, in double.
        const Body b = body(patch);
        const Vec3 normal = cross(b.edge[0], b.edge[1]);
        const double against = dot(normal, line.direction);
        if (against == 0) return 0;
        const Vec3 from = line.origin - b.corner;
        const Vec3 q = cross(line.direction, from);
        const double u = dot(b.edge[1], q) / against;
        const double v = -dot(b.edge[0], q) / against;
        const double t = -dot(normal, from) / against;
        if (!(u >= 0 && v >= 0 && u + v <= 1 && t >= line.t_lo && t <= line.t_hi)) return 0;
        out.hits.push_back({t, normal});
        return 1;
    }

    [[nodiscard]] Vec3 shading_normal(std::size_t patch, const Vec3& point, const Vec3& geometric) const override {
        if (mesh_.normals.empty()) return geometric;
        const Body b = body(patch);
        const Vec3 normal = cross(b.edge[0], b.edge[1]);
        const Vec3 from = point - b.corner;
        const double area2 = dot(normal, normal);
        const double v1 = dot(cross(from, b.edge[1]), normal) / area2;
        const double v2 = dot(cross(b.edge[0], from), normal) / area2;
        const auto& [i, j, k] = mesh_.triangles[patch];
        const Vec3 shading = (1 - v1 - v2) * mesh_.normals[i] + v1 * mesh_.normals[j] + v2 * mesh_.normals[k];
        // Normals of the file may cancel, or be wrong by more than a right angle; only zero is unusable.
        return shading == Vec3(0.0) ? geometric : shading;
    }

    [[nodiscard]] Box bounds() const override { return bounds_; }
    [[nodiscard]] const TriangleMesh* mesh() const override { return &mesh_; }
    [[nodiscard]] std::size_t bytes() const override {
        return sizeof(Vec3) * (mesh_.positions.size() + mesh_.normals.size()) + 12 * mesh_.triangles.size();
    }

private:
    TriangleMesh mesh_;
    Box bounds_;
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_mesh_geometry(TriangleMesh world) {
    return std::make_unique<MeshGeometry>(std::move(world));
}

std::unique_ptr<SurfaceGeometry> make_mesh(const Surface& surface, const MeshShape& shape) {
    TriangleMesh mesh = read_mesh(shape.file);
    for (Vec3& p : mesh.positions) p = surface.to_world.point(p);
    for (Vec3& n : mesh.normals) {
        const Vec3 carried = surface.to_world.normal(n);
        n = carried == Vec3(0.0) ? carried : normalize(carried);
    }
    return std::make_unique<MeshGeometry>(std::move(mesh));
}

}  // namespace pellucid
