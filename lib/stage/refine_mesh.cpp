#include "stage/refine_mesh.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

/// Each quarters the error: from 64 pixels to ¼ in 4. More would only pile up triangles at singular places.
constexpr int kMostRounds = 4;
/// What is left beside singular places must not fill the memory.
constexpr std::size_t kMostTriangles = std::size_t{1} << 24U;
constexpr int kNewtonSteps = 4;
/// Of the distance before, or of the error that is asked: what counts as found.
constexpr double kNearer = 0.1;
constexpr std::size_t kGrain = 256;
constexpr std::uint32_t kWhole = ~0U;

class Surroundings {
public:
    Surroundings(const Object& object, const Camera& camera)
        : surface_(*object.geometry->field_surface()),
          camera_(camera),
          to_object_(object_of(surface_)),
          inverse_transposed_(glm::transpose(to_object_.linear)),
          hair_(1e-9 * surface_.bounds.size()),
          corner_(camera.pixel_size() * length(glm::max(camera.center(), Vec2(camera.width(), camera.height()) - camera.center()))) {}

    struct Place {
        Vec3 normal{0.0};     // world, not normalised
        double distance = 0;  // from the surface, world, to first order
    };
    [[nodiscard]] Place look(const Vec3& world) const { return look(to_object_.point(world), Vec3(1.0)); }

    /// Distance in pixels at the depth of the place; 0 behind the near plane.
    [[nodiscard]] double off_px(const Vec3& world) const {
        const Vec3 view = camera_.to_view(world);
        if (view.z < camera_.near()) return 0;
        // What is aside of the view counts where it would enter it: beside the eye pixels have no size.
        const double z = std::max(view.z, length(Vec2(view)) / corner_);
        const double side = camera_.pixel_size() * (camera_.perspective() ? z : 1);
        return look(world).distance / side;
    }

    /// The middle of an edge moved to f = 0, within reach of it. False where it is not found.
    [[nodiscard]] bool cut(const Vec3& a, const Vec3& b, double error_px, Vec3& middle) const {
        // An edge in a face of the bounds stays in it.
        const Vec3 in_a = to_object_.point(a);
        const Vec3 in_b = to_object_.point(b);
        Vec3 free(1.0);
        for (int axis = 0; axis < 3; ++axis)
            for (const double face : {surface_.bounds.lo[axis], surface_.bounds.hi[axis]})
                if (std::abs(in_a[axis] - face) <= hair_[axis] && std::abs(in_b[axis] - face) <= hair_[axis]) free[axis] = 0;
        const Vec3 from = 0.5 * (a + b);
        const double reach = 0.5 * length(b - a);
        Vec3 at = from;
        for (int step = 0; step < kNewtonSteps; ++step) {
            const Vec3 p = to_object_.point(at);
            const double value = surface_.field->value(p);
            const Vec3 slope = inverse_transposed_ * (free * surface_.field->gradient(p));
            const double square = dot(slope, slope);
            if (!std::isfinite(value) || !(square > 0 && square < kInfinity)) return false;
            // Along a face the world's normal may leave it where axes are not perpendicular; there the object's own is used.
            const Vec3 by = free == Vec3(1.0) ? slope / square : to_world_along(free, p);
            at -= value * by;
            if (!(length(at - from) <= reach)) return false;
        }
        middle = at;
        // An edge may be near enough itself, and cut for its triangle.
        return look(at).distance <= kNearer * look(from).distance || off_px(at) <= kNearer * error_px;
    }

private:
    [[nodiscard]] static Affine object_of(const FieldSurface& surface) { return surface.to_world.inverse(); }
    [[nodiscard]] Place look(const Vec3& p, const Vec3& free) const {
        const Vec3 normal = inverse_transposed_ * (free * surface_.field->gradient(p));
        const double size = length(normal);
        const double value = std::abs(surface_.field->value(p));
        if (!(size > 0 && size < kInfinity) || !std::isfinite(value)) return {};
        return {normal, value / size};
    }
    [[nodiscard]] Vec3 to_world_along(const Vec3& free, const Vec3& p) const {
        const Vec3 slope = free * surface_.field->gradient(p);
        return surface_.to_world.vector(slope / dot(slope, slope));
    }

    FieldSurface surface_;
    const Camera& camera_;
    Affine to_object_;
    Mat3 inverse_transposed_;
    Vec3 hair_;
    double corner_;  // tangent of the angle between the axis and the image's farthest corner (perspective)
};

/// The edges of a mesh by number.
struct Edges {
    std::vector<std::array<std::uint32_t, 2>> ends;
    std::vector<std::array<std::uint32_t, 3>> of_triangle;  // ab, bc, ca

    explicit Edges(const TriangleMesh& mesh) : of_triangle(mesh.triangles.size()) {
        struct Side {
            std::uint64_t key;
            std::uint32_t triangle, side;
        };
        std::vector<Side> sides;
        sides.reserve(3 * mesh.triangles.size());
        for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t)
            for (std::uint32_t s = 0; s < 3; ++s) {
                const auto [lo, hi] = std::minmax(mesh.triangles[t][s], mesh.triangles[t][(s + 1) % 3]);
                sides.push_back({std::uint64_t{lo} << 32U | hi, t, s});
            }
        std::sort(sides.begin(), sides.end(), [](const Side& a, const Side& b) { return a.key < b.key; });
        for (std::size_t i = 0; i < sides.size(); ++i) {
            if (i == 0 || sides[i].key != sides[i - 1].key)
                ends.push_back({static_cast<std::uint32_t>(sides[i].key >> 32U), static_cast<std::uint32_t>(sides[i].key)});
            of_triangle[sides[i].triangle][sides[i].side] = static_cast<std::uint32_t>(ends.size() - 1);
        }
    }
};

/// The parts of a triangle some of whose edges have a new vertex.
void add_parts(const std::array<std::uint32_t, 3>& t, const std::array<std::uint32_t, 3>& middle,
               const std::vector<Vec3>& positions, std::vector<std::array<std::uint32_t, 3>>& out) {
    const auto is_cut = [&](std::size_t side) { return middle[side] != kWhole; };
    const int cuts = is_cut(0) + is_cut(1) + is_cut(2);
    if (cuts == 0) {
        out.push_back(t);
        return;
    }
    if (cuts == 3) {
        out.insert(out.end(), {{t[0], middle[0], middle[2]}, {middle[0], t[1], middle[1]}, {middle[2], middle[1], t[2]}, middle});
        return;
    }
    // Turned so that side 0 is cut and, of two, side 1 too.
    std::size_t first = 0;
    while (!(is_cut(first) && (cuts == 1 || is_cut((first + 1) % 3)))) ++first;
    const std::uint32_t a = t[first], b = t[(first + 1) % 3], c = t[(first + 2) % 3];
    const std::uint32_t ab = middle[first], bc = middle[(first + 1) % 3];
    if (cuts == 1) {
        out.insert(out.end(), {{a, ab, c}, {ab, b, c}});
        return;
    }
    out.push_back({ab, b, bc});
    if (length(positions[a] - positions[bc]) < length(positions[ab] - positions[c]))
        out.insert(out.end(), {{a, ab, bc}, {a, bc, c}});
    else
        out.insert(out.end(), {{a, ab, c}, {ab, bc, c}});
}

[[nodiscard]] Vec3 unit_or_zero(const Vec3& v) {
    const double size = length(v);
    return size > 0 && size < kInfinity ? v / size : Vec3(0.0);
}

}  // namespace

RefinedMesh refine_mesh(const Object& object, const Camera& camera, TriangleMesh mesh, double error_px) {
    const Surroundings around(object, camera);
    RefinedMesh out;
    for (int round = 0;; ++round) {
        const Edges edges(mesh);
        std::vector<double> edge_off(edges.ends.size()), triangle_off(mesh.triangles.size());
        parallel_for(edges.ends.size(), kGrain, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i)
                edge_off[i] = around.off_px(0.5 * (mesh.positions[edges.ends[i][0]] + mesh.positions[edges.ends[i][1]]));
        });
        parallel_for(mesh.triangles.size(), kGrain, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const auto& [a, b, c] = mesh.triangles[i];
                triangle_off[i] = around.off_px((mesh.positions[a] + mesh.positions[b] + mesh.positions[c]) / 3.0);
            }
        });
        std::vector<char> wanted(edges.ends.size(), 0);
        out.error_px = 0;
        out.off = 0;
        for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
            double most = triangle_off[i];
            for (const std::uint32_t e : edges.of_triangle[i]) {
                if (triangle_off[i] > error_px || edge_off[e] > error_px) wanted[e] = 1;
                most = std::max(most, edge_off[e]);
            }
            out.error_px = std::max(out.error_px, most);
            out.off += most > error_px ? 1 : 0;
        }
        if (out.off == 0 || round == kMostRounds || mesh.triangles.size() > kMostTriangles) break;

        // New vertices, numbered in the order of their edges.
        std::vector<Vec3> middle(edges.ends.size());
        parallel_for(edges.ends.size(), kGrain, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i)
                if (wanted[i] != 0)
                    wanted[i] = around.cut(mesh.positions[edges.ends[i][0]], mesh.positions[edges.ends[i][1]], error_px, middle[i]) ? 1 : 0;
        });
        std::vector<std::uint32_t> vertex(edges.ends.size(), kWhole);
        const std::size_t before = mesh.positions.size();
        for (std::size_t i = 0; i < vertex.size(); ++i)
            if (wanted[i] != 0) {
                vertex[i] = static_cast<std::uint32_t>(mesh.positions.size());
                mesh.positions.push_back(middle[i]);
                mesh.normals.push_back(unit_or_zero(around.look(middle[i]).normal));
            }
        if (mesh.positions.size() == before) break;
        std::vector<std::array<std::uint32_t, 3>> finer;
        finer.reserve(2 * mesh.triangles.size());
        for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
            const auto& [ab, bc, ca] = edges.of_triangle[i];
            add_parts(mesh.triangles[i], {vertex[ab], vertex[bc], vertex[ca]}, mesh.positions, finer);
        }
        mesh.triangles = std::move(finer);
    }
    out.mesh = std::move(mesh);
    return out;
}

}  // namespace pellucid
