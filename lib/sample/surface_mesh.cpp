#include "sample/surface_mesh.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>
#include <memory>
#include <optional>

#include <gts.h>

#include "core/error.hpp"

namespace pellucid {
namespace {

/// Nodes of a block along an axis, less one: what is excluded at once.
constexpr int kBlockCells = 8;
constexpr int kNewtonSteps = 4;
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

// ---- Marching Tetrahedra

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
            blocks_[a] = (cells_[a] + kBlockCells - 1) / kBlockCells;
            spacing_[axis] = size[axis] / cells_[a];
        }
        find_signs();
    }

    [[nodiscard]] GtsCartesianGrid grid() const {
        const Vec3& lo = surface_.bounds.lo;
        return {static_cast<guint>(cells_[0] + 1), static_cast<guint>(cells_[1] + 1), static_cast<guint>(cells_[2] + 1),
                lo.x, spacing_.x, lo.y, spacing_.y, lo.z, spacing_.z};
    }
    [[nodiscard]] const Vec3& spacing() const { return spacing_; }

    /// Values at the nodes of slice k; in blocks without a zero ±1, which crosses no edge.
    void slice(gdouble** values, int k) const {
        for (int i = 0; i <= cells_[0]; ++i)
            for (int j = 0; j <= cells_[1]; ++j) {
                const double known = sign_at(i, j, k);
                double value = known;
                if (known == 0) {
                    value = surface_.field->value(node(i, j, k));
                    if (!std::isfinite(value)) value = 1;  // no surface there: its triangles are dropped
                }
                values[i][j] = value;
            }
    }

private:
    [[nodiscard]] Vec3 node(int i, int j, int k) const {
        const int at[3] = {i, j, k};
        Vec3 place;
        for (int axis = 0; axis < 3; ++axis)
            place[axis] = at[axis] == cells_[static_cast<std::size_t>(axis)]
                              ? surface_.bounds.hi[axis]
                              : surface_.bounds.lo[axis] + at[axis] * spacing_[axis];
        return place;
    }
    [[nodiscard]] std::size_t block(int i, int j, int k) const {
        return (static_cast<std::size_t>(k) * static_cast<std::size_t>(blocks_[1]) + static_cast<std::size_t>(j)) *
                   static_cast<std::size_t>(blocks_[0]) +
               static_cast<std::size_t>(i);
    }
    void find_signs() {
        signs_.assign(block(0, 0, blocks_[2]), 0);
        for (int k = 0; k < blocks_[2]; ++k)
            for (int j = 0; j < blocks_[1]; ++j)
                for (int i = 0; i < blocks_[0]; ++i) {
                    const auto upper = [&](int b, std::size_t axis) { return std::min(cells_[axis], (b + 1) * kBlockCells); };
                    const Box box{node(i * kBlockCells, j * kBlockCells, k * kBlockCells),
                                  node(upper(i, 0), upper(j, 1), upper(k, 2))};
                    if (!surface_.field->excludes(box)) continue;
                    const double value = surface_.field->value(box.center());
                    if (std::isfinite(value)) signs_[block(i, j, k)] = value > 0 ? 1 : -1;
                }
    }
    /// ±1 where every block of the node has that sign, else 0.
    [[nodiscard]] double sign_at(int i, int j, int k) const {
        const auto range = [](int node, int count) {
            const int own = std::min(node / kBlockCells, count - 1);
            return std::pair{node % kBlockCells == 0 && node > 0 && own > 0 ? own - 1 : own, own};
        };
        const auto [i0, i1] = range(i, blocks_[0]);
        const auto [j0, j1] = range(j, blocks_[1]);
        const auto [k0, k1] = range(k, blocks_[2]);
        const int sign = signs_[block(i0, j0, k0)];
        for (int c = k0; c <= k1; ++c)
            for (int b = j0; b <= j1; ++b)
                for (int a = i0; a <= i1; ++a)
                    if (signs_[block(a, b, c)] != sign) return 0;
        return sign;
    }

    const FieldSurface& surface_;
    std::array<int, 3> cells_{}, blocks_{};
    Vec3 spacing_{0.0};
    std::vector<std::int8_t> signs_;  // of a block; 0: not known
};

void slice_for_gts(gdouble** values, GtsCartesianGrid, guint k, gpointer data) {
    static_cast<const FieldGrid*>(data)->slice(values, static_cast<int>(k));
}

gint append_vertex(gpointer item, gpointer data) {
    auto& positions = *static_cast<std::vector<Vec3>*>(data);
    GTS_OBJECT(item)->reserved = GUINT_TO_POINTER(static_cast<guint>(positions.size()));
    const GtsPoint* p = GTS_POINT(item);
    positions.emplace_back(p->x, p->y, p->z);
    return 0;
}
gint append_face(gpointer item, gpointer data) {
    GtsVertex* v[3] = {};
    gts_triangle_vertices(GTS_TRIANGLE(item), &v[0], &v[1], &v[2]);
    const auto index = [](GtsVertex* vertex) { return std::uint32_t{GPOINTER_TO_UINT(GTS_OBJECT(vertex)->reserved)}; };
    static_cast<std::vector<std::array<std::uint32_t, 3>>*>(data)->push_back({index(v[0]), index(v[1]), index(v[2])});
    return 0;
}

/// GTS keeps its items by their addresses, which differ from run to run: vertices by place, equal ones joined, triangles by
/// their vertices.
void put_in_order(TriangleMesh& mesh) {
    std::vector<std::uint32_t> order(mesh.positions.size());
    std::iota(order.begin(), order.end(), 0U);
    const auto before = [](const Vec3& a, const Vec3& b) {
        return a.z != b.z ? a.z < b.z : a.y != b.y ? a.y < b.y : a.x < b.x;
    };
    std::sort(order.begin(), order.end(),
              [&](std::uint32_t a, std::uint32_t b) { return before(mesh.positions[a], mesh.positions[b]); });
    std::vector<Vec3> positions;
    std::vector<std::uint32_t> place(order.size());
    for (const std::uint32_t i : order) {
        if (positions.empty() || positions.back() != mesh.positions[i]) positions.push_back(mesh.positions[i]);
        place[i] = static_cast<std::uint32_t>(positions.size() - 1);
    }
    mesh.positions = std::move(positions);
    for (auto& t : mesh.triangles) {
        for (std::uint32_t& corner : t) corner = place[corner];
        std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
    }
    std::sort(mesh.triangles.begin(), mesh.triangles.end());
}

[[nodiscard]] bool has_area(const std::vector<Vec3>& positions, const std::array<std::uint32_t, 3>& t) {
    const Vec3 normal = cross(positions[t[1]] - positions[t[0]], positions[t[2]] - positions[t[0]]);
    return dot(normal, normal) > 0;
}

/// To the world, with normals; counter-clockwise seen from outside, where f is positive.
void finish(const FieldSurface& surface, SurfaceTriangles& out) {
    TriangleMesh& mesh = out.mesh;
    const Mat3 inverse_transposed = glm::transpose(surface.to_world.inverse().linear);
    for (const auto& t : mesh.triangles) {
        const Vec3 middle = (mesh.positions[t[0]] + mesh.positions[t[1]] + mesh.positions[t[2]]) / 3.0;
        out.error = std::max(out.error, distance_from(surface, inverse_transposed, middle));
    }
    mesh.normals.reserve(mesh.positions.size());
    for (Vec3& p : mesh.positions) {
        const Vec3 gradient = inverse_transposed * surface.field->gradient(p);
        const double size = length(gradient);
        mesh.normals.push_back(size > 0 && size < kInfinity ? gradient / size : Vec3(0.0));
        p = surface.to_world.point(p);
    }
    for (auto& t : mesh.triangles) {
        const Vec3 normal = cross(mesh.positions[t[1]] - mesh.positions[t[0]], mesh.positions[t[2]] - mesh.positions[t[0]]);
        if (dot(normal, mesh.normals[t[0]] + mesh.normals[t[1]] + mesh.normals[t[2]]) < 0) std::swap(t[1], t[2]);
    }
    std::erase_if(mesh.triangles, [&](const auto& t) { return !has_area(mesh.positions, t); });
}

}  // namespace

SurfaceTriangles tessellate(const Object& object, int cells) {
    const FieldSurface surface = field_surface_of(object, "mesh");
    SurfaceTriangles out;
    if (surface.bounds.empty() || object.geometry->patch_count() == 0) return out;
    FieldGrid field(surface, cells);
    struct Deleter {
        void operator()(GtsSurface* s) const { gts_object_destroy(GTS_OBJECT(s)); }
    };
    const std::unique_ptr<GtsSurface, Deleter> found(
        gts_surface_new(gts_surface_class(), gts_face_class(), gts_edge_class(), gts_vertex_class()));
    gts_isosurface_tetra(found.get(), field.grid(), slice_for_gts, &field, 0);
    std::vector<Vec3>& positions = out.mesh.positions;
    gts_surface_foreach_vertex(found.get(), append_vertex, &positions);
    gts_surface_foreach_face(found.get(), append_face, &out.mesh.triangles);
    put_in_order(out.mesh);

    // On the surface; where f only jumps there is none.
    std::vector<bool> good(positions.size());
    for (std::size_t i = 0; i < positions.size(); ++i)
        good[i] = move_to_surface(surface, field.spacing(), positions[i]) && is_root(surface, field.spacing(), positions[i]);
    const auto before = out.mesh.triangles.size();
    std::erase_if(out.mesh.triangles, [&](const auto& t) { return !(good[t[0]] && good[t[1]] && good[t[2]]); });
    out.dropped = before - out.mesh.triangles.size();
    finish(surface, out);
    return out;
}

int cells_for_error(const Object& object, double error) {
    constexpr int kCoarse = 32;
    constexpr int kMostRounds = 3;
    int cells = kCoarse;
    for (int round = 0; round < kMostRounds; ++round) {
        const double seen = tessellate(object, cells).error;
        if (!(seen > error)) return cells;
        // Of second order in the spacing; a tenth more, for the next grid meets other places.
        const double wanted = 1.1 * cells * std::sqrt(seen / error);
        cells = static_cast<int>(std::min<double>(std::ceil(wanted), kMostMeshCells));
        if (cells == kMostMeshCells) break;
    }
    return cells;
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
    double height[8];
    Vec3 corner[8];
    for (unsigned i = 0; i < 8; ++i) {
        corner[i] = {(i & 1U) != 0 ? box.hi.x : box.lo.x, (i & 2U) != 0 ? box.hi.y : box.lo.y,
                     (i & 4U) != 0 ? box.hi.z : box.lo.z};
        height[i] = dot(normal, corner[i] - at);
    }
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
        Vec3 corner[8];
        double value[8];
        for (unsigned i = 0; i < 8; ++i) {
            corner[i] = {(i & 1U) != 0 ? box.hi.x : box.lo.x, (i & 2U) != 0 ? box.hi.y : box.lo.y,
                         (i & 4U) != 0 ? box.hi.z : box.lo.z};
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
