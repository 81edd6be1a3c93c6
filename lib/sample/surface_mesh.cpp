#include "sample/surface_mesh.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <memory>
#include <numeric>
#include <optional>

#include "core/box_corners.hpp"
#include "core/error.hpp"
#include "core/parallel.hpp"
#include "field/safeguarded_newton.hpp"
#include "sample/marching_blocks.hpp"

namespace pellucid {
namespace {

constexpr int kNewtonSteps = 4;
/// Vertices, or triangles, that a thread takes at a time.
constexpr std::size_t kAtOnce = 256;
constexpr double kRoom = 1e-3;
/// Of a cell: Newton's method leaves far less, but beside nodes and kinks.
constexpr double kNearRoot = 0.1;
/// A leaf's tangent plane may pass through it where the surface passes beside it: leaves are looked at as far as this share
/// of their size from the surface, or the area would be off in the first order.
constexpr double kLeafRoom = 0.5;
constexpr std::size_t kMostLeaves = std::size_t{1} << 24U;

/// A closed surface that touches its box from inside is not cut by it: room is added there.
void widen_where_closed(FieldSurface& surface, const Vec3& room) {
    const auto* catalogue = dynamic_cast<const CatalogueSurface*>(surface.field);
    if (catalogue == nullptr || !catalogue->bounded()) return;
    for (int axis = 0; axis < 3; ++axis) {
        if (surface.bounds.lo[axis] <= catalogue->bounds().lo[axis]) surface.bounds.lo[axis] -= room[axis];
        if (surface.bounds.hi[axis] >= catalogue->bounds().hi[axis]) surface.bounds.hi[axis] += room[axis];
    }
}

[[nodiscard]] FieldSurface field_surface_of(const Object& object, const char* sampler) {
    auto surface = object.geometry->field_surface();
    if (!surface)
        throw input_error("surface \"{}\": particles.sampler = \"{}\" needs a mesh, or a surface that is f = 0 of a field "
                          "(implicit, expression, isosurface, points): use \"lines\"",
                          object.surface.name, sampler);
    if (surface->bounds.empty()) return *surface;
    widen_where_closed(*surface, kRoom * surface->bounds.size());
    return *surface;
}

/// Distance of a place from f = 0 to first order, world.
[[nodiscard]] double distance_from(const FieldSurface& surface, const Mat3& inverse_transposed, const Vec3& at) {
    const Vec3 gradient = inverse_transposed * surface.field->gradient(at);
    const double size = length(gradient);
    return size > 0 ? std::abs(surface.field->value(at)) / size : 0;
}

/// Moves a place to f = 0 within its cell; places on a face of the bounds stay on it. False where there is none.
[[nodiscard]] bool move_to_surface(const FieldSurface& surface, const Vec3& spacing, Vec3& at) {
    const Vec3 from = at;
    const Vec3 hair = 1e-9 * surface.bounds.size();
    for (int step = 0; step < kNewtonSteps; ++step) {
        const double value = surface.field->value(at);
        Vec3 gradient = surface.field->gradient(at);
        for (int axis = 0; axis < 3; ++axis)
            if (at[axis] <= surface.bounds.lo[axis] + hair[axis] || at[axis] >= surface.bounds.hi[axis] - hair[axis])
                gradient[axis] = 0;
        // In units of the cell, so that a flat cell is not left.
        const Vec3 slope = spacing * gradient;
        const double square = dot(slope, slope);
        if (!std::isfinite(value) || !(square < kInfinity)) return false;
        if (value == 0 || square == 0) return true;
        const Vec3 by = -(value / square) * slope;
        if (!(dot(by, by) <= 4)) return step > 0;  // a kink, or a node: as good as it was
        at = glm::clamp(at + spacing * by, surface.bounds.lo, surface.bounds.hi);
        const Vec3 moved = (at - from) / spacing;
        if (!(dot(moved, moved) <= 4)) {
            at = from;
            return true;
        }
    }
    return true;
}

/// Whether f vanishes at a place, and does not only jump there: it is smaller than a cell beside it.
[[nodiscard]] bool is_root(const FieldSurface& surface, const Vec3& spacing, const Vec3& at) {
    const double value = std::abs(surface.field->value(at));
    const Vec3 slope = spacing * surface.field->gradient(at);
    const double size = length(slope);
    if (!std::isfinite(value) || !(size < kInfinity)) return false;
    if (value > kNearRoot * size) return false;
    const Vec3 by = size > 0 ? spacing * slope / size : Vec3(0.0);
    double beside = 0;
    for (const double side : {-1.0, 1.0})
        if (const double f = std::abs(surface.field->value(at + side * by)); f > beside) beside = f;
    return value <= 0.5 * beside;
}

// ---- Marching Cubes

class FieldGrid {
public:
    FieldGrid(const FieldSurface& surface, int cells) : surface_(surface) {
        const Vec3 size = surface.bounds.size();
        Vec3 world;
        for (int axis = 0; axis < 3; ++axis) world[axis] = size[axis] * length(surface.to_world.linear[axis]);
        const double longest = std::max({world.x, world.y, world.z});
        for (int axis = 0; axis < 3; ++axis) {
            const auto a = static_cast<std::size_t>(axis);
            cells_[a] = std::max(1, static_cast<int>(std::ceil(cells * world[axis] / longest - 1e-9)));
            spacing_[axis] = size[axis] / cells_[a];
        }
    }

    [[nodiscard]] const std::array<int, 3>& cells() const { return cells_; }

    /// Places at which f is no number count as positive: what is found beside them is dropped.
    [[nodiscard]] GridSigns signs() const {
        return {[this](const GridSigns::Node& first, const GridSigns::Node& last) {
                    const Box box{place(first), place(last)};
                    if (!surface_.field->excludes(box)) return 0;
                    const double value = surface_.field->value(box.center());
                    return !std::isfinite(value) ? 0 : value < 0 ? -1 : 1;
                },
                [this](const GridSigns::Node& node) { return surface_.field->value(place(node)) < 0; }};
    }

    struct Root {
        Vec3 place, gradient;
        bool good;  // f vanishes there, and does not only jump
    };
    [[nodiscard]] Root root(const GridEdge& edge) const {
        Vec3 at = place(edge.node);
        auto next = edge.node;
        ++next[static_cast<std::size_t>(edge.axis)];
        const double lo = at[edge.axis];
        const double hi = place(next)[edge.axis];
        at[edge.axis] = safeguarded_newton(lo, hi, lo + 0.5 * (hi - lo), edge.rising, [&](double x) {
            at[edge.axis] = x;
            const FieldJet jet = surface_.field->jet(at);
            return std::pair(std::isnan(jet.value) ? kInfinity : jet.value, jet.gradient[edge.axis]);
        });
        const FieldJet jet = surface_.field->jet(at);
        // Beside a pole f rises where it should fall. What looks odd is looked at more closely.
        const double slope = jet.gradient[edge.axis];
        const bool plain = std::abs(jet.value) <= kNearRoot * std::abs(slope) * spacing_[edge.axis] &&
                           (edge.rising ? slope > 0 : slope < 0) && std::abs(slope) < kInfinity;
        return {at, jet.gradient, plain || is_root(surface_, spacing_, at)};
    }

private:
    [[nodiscard]] Vec3 place(const std::array<int, 3>& node) const {
        Vec3 at;
        for (int axis = 0; axis < 3; ++axis) {
            const auto a = static_cast<std::size_t>(axis);
            at[axis] = node[a] == cells_[a] ? surface_.bounds.hi[axis] : surface_.bounds.lo[axis] + node[a] * spacing_[axis];
        }
        return at;
    }

    const FieldSurface& surface_;
    std::array<int, 3> cells_{};
    Vec3 spacing_{0.0};
};

[[nodiscard]] bool has_area(const std::vector<Vec3>& positions, const std::array<std::uint32_t, 3>& t) {
    const Vec3 normal = cross(positions[t[1]] - positions[t[0]], positions[t[2]] - positions[t[0]]);
    return dot(normal, normal) > 0;
}

/// Normals of length one or zero, from gradients.
[[nodiscard]] Vec3 unit_normal(const Mat3& inverse_transposed, const Vec3& gradient) {
    const Vec3 normal = inverse_transposed * gradient;
    const double size = length(normal);
    return size > 0 && size < kInfinity ? normal / size : Vec3(0.0);
}

/// Of the triangles' middles, by f; of their edges' middles, by the normals at their ends: a quadratic surface over an edge e
/// with normals n, m is |(m − n)·e|/8 away from its middle. Before places go to the world.
[[nodiscard]] double error_of(const FieldSurface& surface, const Mat3& inverse_transposed, const TriangleMesh& mesh) {
    std::vector<double> largest(mesh.triangles.size() / kAtOnce + 1, 0);
    parallel_for(largest.size(), 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t part = begin; part < end; ++part)
            for (std::size_t i = part * kAtOnce; i < std::min(mesh.triangles.size(), (part + 1) * kAtOnce); ++i) {
                const auto& t = mesh.triangles[i];
                const auto& p = mesh.positions;
                double& most = largest[part];
                most = std::max(most, distance_from(surface, inverse_transposed, (p[t[0]] + p[t[1]] + p[t[2]]) / 3.0));
                if (mesh.normals.empty()) continue;
                for (std::size_t k = 0; k < 3; ++k) {
                    const std::uint32_t a = t[k];
                    const std::uint32_t b = t[(k + 1) % 3];
                    const Vec3 edge = surface.to_world.vector(p[b] - p[a]);
                    most = std::max(most, std::abs(dot(mesh.normals[b] - mesh.normals[a], edge)) / 8);
                }
            }
    });
    return *std::max_element(largest.begin(), largest.end());
}

/// Vertices that no triangle has are left out.
void leave_out_unused(TriangleMesh& mesh) {
    std::vector<std::uint32_t> place(mesh.positions.size(), 0);
    for (const auto& t : mesh.triangles)
        for (const std::uint32_t corner : t) place[corner] = 1;
    std::uint32_t kept = 0;
    for (std::size_t i = 0; i < place.size(); ++i) {
        if (place[i] == 0) continue;
        mesh.positions[kept] = mesh.positions[i];
        mesh.normals[kept] = mesh.normals[i];
        place[i] = kept++;
    }
    mesh.positions.resize(kept);
    mesh.normals.resize(kept);
    for (auto& t : mesh.triangles)
        for (std::uint32_t& corner : t) corner = place[corner];
}

/// Counter-clockwise seen from where the normals point to, all of them or none.
void turn_outward(TriangleMesh& mesh) {
    double sum = 0;
    for (const auto& t : mesh.triangles) {
        const auto& p = mesh.positions;
        sum += dot(cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]), mesh.normals[t[0]] + mesh.normals[t[1]] + mesh.normals[t[2]]);
    }
    if (sum < 0)
        for (auto& t : mesh.triangles) std::swap(t[1], t[2]);
}

}  // namespace

SurfaceTriangles tessellate(const FieldSurface& surface, int cells) {
    SurfaceTriangles out;
    out.cells = cells;
    if (surface.bounds.empty()) return out;
    const FieldGrid grid(surface, cells);
    GridTriangles found = march(grid.cells(), grid.signs());
    TriangleMesh& mesh = out.mesh;
    mesh.triangles = std::move(found.triangles);
    const Mat3 inverse_transposed = glm::transpose(surface.to_world.inverse().linear);
    mesh.positions.resize(found.edges.size());
    mesh.normals.resize(found.edges.size());
    std::vector<std::uint8_t> good(found.edges.size());
    parallel_for(found.edges.size(), kAtOnce, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const auto root = grid.root(found.edges[i]);
            mesh.positions[i] = root.place;
            mesh.normals[i] = unit_normal(inverse_transposed, root.gradient);
            good[i] = root.good ? 1 : 0;
        }
    });
    out.dropped = std::erase_if(mesh.triangles, [&](const auto& t) { return (good[t[0]] & good[t[1]] & good[t[2]]) == 0; });
    leave_out_unused(mesh);
    out.error = error_of(surface, inverse_transposed, mesh);
    for (Vec3& p : mesh.positions) p = surface.to_world.point(p);
    turn_outward(mesh);
    return out;
}

FieldSurface surface_for_triangles(const Object& object) { return field_surface_of(object, "mesh"); }

SurfaceTriangles tessellate(const Object& object, int cells) {
    const FieldSurface surface = field_surface_of(object, "mesh");
    if (object.geometry->patch_count() == 0) return {};
    return tessellate(surface, cells);
}

SurfaceTriangles tessellate_within(const FieldSurface& surface, double error) {
    constexpr int kCoarse = 32;
    constexpr int kMostRounds = 4;
    SurfaceTriangles out;
    int cells = kCoarse;
    for (int round = 0; round < kMostRounds; ++round) {
        out = tessellate(surface, cells);
        if (!(out.error > error) || cells == kMostMeshCells) break;
        // Of second order in the spacing; a tenth more, for the next grid meets other places.
        const double wanted = 1.1 * cells * std::sqrt(out.error / error);
        cells = static_cast<int>(std::min<double>(std::ceil(wanted), kMostMeshCells));
    }
    return out;
}

SurfaceTriangles tessellate_within(const Object& object, double error) {
    const SurfaceGeometry& geometry = *object.geometry;
    SurfaceTriangles out;
    if (geometry.patch_count() == 0) return out;
    if (geometry.field_surface()) return tessellate_within(field_surface_of(object, "mesh"), error);
    if (geometry.mesh() != nullptr) {
        out.mesh = *geometry.mesh();
        return out;
    }
    for (std::size_t patch = 0; patch < geometry.patch_count(); ++patch) {
        const Body body = geometry.body(patch);
        if (!body.flat()) throw input_error("surface \"{}\": it has no triangles", object.surface.name);
        const auto first = static_cast<std::uint32_t>(out.mesh.positions.size());
        const Vec3& a = body.edge[0];
        const Vec3& b = body.edge[1];
        const bool four = body.kind == Body::Kind::parallelogram;
        for (const Vec3& corner : {Vec3(0.0), a, b, a + b}) {
            if (out.mesh.positions.size() == first + (four ? 4U : 3U)) break;
            out.mesh.positions.push_back(body.corner + corner);
            out.mesh.normals.push_back(normalize(cross(a, b)));
        }
        out.mesh.triangles.push_back({first, first + 1, first + 2});
        if (four) out.mesh.triangles.push_back({first + 1, first + 3, first + 2});
    }
    return out;
}

int cells_for_error(const Object& object, double error) {
    const FieldSurface surface = field_surface_of(object, "mesh");
    return object.geometry->patch_count() == 0 ? 1 : tessellate_within(surface, error).cells;
}

// ---- Octree

namespace {

struct Polygon {
    std::array<Vec3, 8> corner;
    std::size_t count = 0;
};

/// The plane normal·(x − at) = 0 within a box: a convex polygon.
[[nodiscard]] Polygon cut_box(const Box& box, const Vec3& at, const Vec3& normal) {
    Polygon polygon;
    const std::array<Vec3, 8> corner = corners_of(box);
    double height[8];
    for (unsigned i = 0; i < 8; ++i) height[i] = dot(normal, corner[i] - at);
    for (unsigned i = 0; i < 8; ++i)
        for (unsigned bit = 1; bit < 8; bit <<= 1U) {
            const unsigned j = i | bit;
            if (j == i || (height[i] < 0) == (height[j] < 0) || polygon.count == 6) continue;
            polygon.corner[polygon.count++] = corner[i] + height[i] / (height[i] - height[j]) * (corner[j] - corner[i]);
        }
    // In order around their middle.
    Vec3 middle(0.0);
    for (std::size_t i = 0; i < polygon.count; ++i) middle += polygon.corner[i] / static_cast<double>(polygon.count);
    const Vec3 n = normalize(normal);
    const Vec3 side = normalize(cross(n, std::abs(n.x) < 0.6 ? Vec3(1, 0, 0) : Vec3(0, 1, 0)));
    const Vec3 up = cross(n, side);
    const auto angle = [&](const Vec3& p) {
        // Monotone in the angle, and of + − ÷ alone: the same order on every machine.
        const double x = dot(p - middle, side);
        const double y = dot(p - middle, up);
        const double sum = std::abs(x) + std::abs(y);
        const double turn = sum > 0 ? y / sum : 0;
        return x >= 0 ? turn : 2 - turn;
    };
    // By insertion: they are six at most.
    for (std::size_t i = 1; i < polygon.count; ++i)
        for (std::size_t k = i; k > 0 && angle(polygon.corner[k]) < angle(polygon.corner[k - 1]); --k)
            std::swap(polygon.corner[k], polygon.corner[k - 1]);
    return polygon;
}

/// To the world, with normals; counter-clockwise seen from outside, where f is positive.
void finish(const FieldSurface& surface, SurfaceTriangles& out) {
    TriangleMesh& mesh = out.mesh;
    const Mat3 inverse_transposed = glm::transpose(surface.to_world.inverse().linear);
    out.error = error_of(surface, inverse_transposed, mesh);
    mesh.normals.resize(mesh.positions.size());
    parallel_for(mesh.positions.size(), kAtOnce, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            Vec3& p = mesh.positions[i];
            mesh.normals[i] = unit_normal(inverse_transposed, surface.field->gradient(p));
            p = surface.to_world.point(p);
        }
    });
    for (auto& t : mesh.triangles) {
        const Vec3 normal = cross(mesh.positions[t[1]] - mesh.positions[t[0]], mesh.positions[t[2]] - mesh.positions[t[0]]);
        if (dot(normal, mesh.normals[t[0]] + mesh.normals[t[1]] + mesh.normals[t[2]]) < 0) std::swap(t[1], t[2]);
    }
    std::erase_if(mesh.triangles, [&](const auto& t) { return !has_area(mesh.positions, t); });
}

class OctreeBuilder {
public:
    OctreeBuilder(const Object& object, const FieldSurface& surface, int depth, const Vec3& leaf, SurfaceTriangles& out)
        : object_(object), surface_(surface), depth_(depth), leaf_(leaf), out_(out) {}

    void add(const Box& cube, int level) {
        const Box box{glm::max(cube.lo, surface_.bounds.lo), glm::min(cube.hi, surface_.bounds.hi)};
        const Vec3 room = kLeafRoom * leaf_;
        if (box.empty() || surface_.field->excludes({box.lo - room, box.hi + room})) return;
        if (level == depth_) return add_leaf(box);
        const Vec3 middle = cube.center();
        for (unsigned i = 0; i < 8; ++i) {
            Box part = cube;
            for (int axis = 0; axis < 3; ++axis)
                ((i >> static_cast<unsigned>(axis) & 1U) != 0 ? part.lo : part.hi)[axis] = middle[axis];
            // Half-open at the bounds: a part that only touches them has no volume of its own.
            bool flat = false;
            for (int axis = 0; axis < 3; ++axis)
                flat = flat || (part.lo[axis] >= surface_.bounds.hi[axis] && surface_.bounds.size()[axis] > 0);
            if (!flat) add(part, level + 1);
        }
    }

private:
    void add_leaf(const Box& box) {
        if (++leaves_ > kMostLeaves)
            throw input_error("surface \"{}\": more than 2^24 leaves of an octree hold it, lower particles.octree.cells",
                              object_.surface.name);
        const auto found = nearest_place(box);
        if (!found) return;
        const Vec3 at = *found;
        const Vec3 normal = surface_.field->gradient(at);
        const Polygon polygon = cut_box(box, at, normal);
        if (polygon.count < 3) return;
        const auto first = static_cast<std::uint32_t>(out_.mesh.positions.size());
        for (std::size_t i = 0; i < polygon.count; ++i) out_.mesh.positions.push_back(polygon.corner[i]);
        for (std::uint32_t i = 1; i + 1 < polygon.count; ++i)
            out_.mesh.triangles.push_back({first, first + i, first + i + 1});
    }

    /// Whether there is a tangent plane at a place.
    [[nodiscard]] bool is_smooth(const Vec3& at) const {
        const Vec3 normal = surface_.field->gradient(at);
        return dot(normal, normal) > 0 && dot(normal, normal) < kInfinity && is_root(surface_, leaf_, at);
    }
    /// The surface's place nearest to a leaf's middle: by Newton's method from there; where that leads away, the nearest one of
    /// those from the corners and on the edges along which f changes its sign. Such a leaf without any holds surface that is lost,
    /// unless f jumps.
    [[nodiscard]] std::optional<Vec3> nearest_place(const Box& box) {
        const Vec3 middle = box.center();
        std::optional<Vec3> best;
        double least = kInfinity;
        const auto consider = [&](const Vec3& place) {
            const Vec3 off = (place - middle) / leaf_;
            constexpr double kReach = 0.5 + kLeafRoom;
            if (std::max({std::abs(off.x), std::abs(off.y), std::abs(off.z)}) > kReach || dot(off, off) >= least) return;
            if (!is_smooth(place)) return;
            least = dot(off, off);
            best = place;
        };
        Vec3 at = middle;
        if (move_to_surface(surface_, leaf_, at)) consider(at);
        if (best) return best;
        const std::array<Vec3, 8> corner = corners_of(box);
        double value[8];
        for (unsigned i = 0; i < 8; ++i) {
            value[i] = surface_.field->value(corner[i]);
            Vec3 place = corner[i];
            if (move_to_surface(surface_, leaf_, place)) consider(place);
        }
        bool crossed = false;
        for (unsigned i = 0; i < 8; ++i)
            for (unsigned bit = 1; bit < 8; bit <<= 1U) {
                const unsigned j = i | bit;
                if (j == i || !(value[i] * value[j] < 0)) continue;
                const Vec3 place = sign_change(corner[i], value[i], corner[j]);
                // Where f jumps it is as large as beside the place: there is no surface.
                crossed = crossed || std::abs(surface_.field->value(place)) < 1e-3 * std::min(std::abs(value[i]), std::abs(value[j]));
                consider(place);
            }
        if (!best && crossed) ++out_.dropped;
        return best;
    }
    /// By bisection.
    [[nodiscard]] Vec3 sign_change(Vec3 a, double at_a, Vec3 b) const {
        constexpr int kHalvings = 40;
        for (int i = 0; i < kHalvings; ++i) {
            const Vec3 middle = 0.5 * (a + b);
            ((surface_.field->value(middle) < 0) == (at_a < 0) ? a : b) = middle;
        }
        return 0.5 * (a + b);
    }

    const Object& object_;
    const FieldSurface& surface_;
    int depth_;
    Vec3 leaf_;  // its size
    SurfaceTriangles& out_;
    std::size_t leaves_ = 0;
};

}  // namespace

SurfaceTriangles octree_triangles(const Object& object, int cells) {
    FieldSurface surface = field_surface_of(object, "octree");
    SurfaceTriangles out;
    if (surface.bounds.empty() || object.geometry->patch_count() == 0) return out;
    // Cubes of the world, but for shear: in object space their edges are as long as the map needs.
    Vec3 scale;
    double longest = 0;
    for (int axis = 0; axis < 3; ++axis) {
        scale[axis] = 1 / length(surface.to_world.linear[axis]);
        longest = std::max(longest, surface.bounds.size()[axis] / scale[axis]);
    }
    const int depth = static_cast<int>(std::bit_width(static_cast<unsigned>(std::max(cells, 1)) - 1U));
    // No leaf's face in the middle of the bounds, where symmetric surfaces have planes and nodes.
    const Vec3 edge = longest * scale;
    const Vec3 leaf = edge / static_cast<double>(1U << static_cast<unsigned>(depth));
    const Vec3 corner = surface.bounds.lo - leaf;
    const Vec3 shift = 0.4871 * leaf;
    // Tangent planes near a closed surface's outermost places lie outside its box.
    widen_where_closed(surface, kLeafRoom * leaf);
    OctreeBuilder(object, surface, depth + 1, leaf, out)
        .add({corner - shift, corner - shift + 2.0 * edge}, 0);
    finish(surface, out);
    return out;
}

}  // namespace pellucid
