#include "sample/line_sampler.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "scene/shading.hpp"

namespace pellucid {
namespace {

/// A piece is cut while the area that a pixel sees varies on it by more than this: what varies is
/// paid in trials that are thrown away. 4 = a factor of 2 in depth.
constexpr double kMostAreaRatio = 4;
/// A piece that reaches out of view is cut while it spans more virtual pixels than this.
constexpr double kMostPixelsOutside = 1024;
constexpr int kMostCuts = 40;
/// Pieces a block: with their tables they fit into a level-2 cache.
constexpr std::size_t kBlockPieces = 4096;
/// Boxes around a catalogue surface are cut while this saves trials, but not into blocks so small
/// that their Poisson numbers cost more than their lines.
constexpr int kMostBoxCuts = 3;
constexpr double kLeastBoxShare = 1.0 / 64;
constexpr double kWorthACut = 0.85;
/// Lines along the one axis that suits a formula's cell are given up for lines along all, each some ten times as dear,
/// where they are so many times as many: walls such as those of x^1000 − y.
constexpr double kTooSteep = 16;
/// Of the diagonal: a surface may lie in a face of its bounds (a plane, thin as its box).
constexpr double kBoxRoom = 1e-9;

/// (cos, sin) of 2πu by + − × only: std::sin may differ between instruction sets in the last bit.
[[nodiscard]] Vec2 unit_circle(double u) {
    const double quarter = std::floor(4 * u + 0.5);
    const double x = (4 * u - quarter) * 1.57079632679489661923;  // [−π/4, π/4]
    const double x2 = x * x;
    // Taylor to x^15 and x^14: below 2^-53 on this interval.
    double s = -1.0 / 1307674368000.0;
    for (const double c :
         {1.0 / 6227020800.0, -1.0 / 39916800.0, 1.0 / 362880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0})
        s = s * x2 + c;
    s *= x;
    double c = -1.0 / 87178291200.0;
    for (const double k :
         {1.0 / 479001600.0, -1.0 / 3628800.0, 1.0 / 40320.0, -1.0 / 720.0, 1.0 / 24.0, -0.5, 1.0})
        c = c * x2 + k;
    switch (static_cast<int>(quarter) & 3) {
        case 0: return {c, s};
        case 1: return {-s, c};
        case 2: return {-c, -s};
        default: return {s, -c};
    }
}

/// Where a line from the border of a parallelepiped leaves it.
[[nodiscard]] double exit_distance(const Body& body, const Vec3& origin, const Vec3& direction) {
    const Vec3 normals[3] = {cross(body.edge[1], body.edge[2]), cross(body.edge[2], body.edge[0]),
                             cross(body.edge[0], body.edge[1])};
    double t_hi = kInfinity;
    for (int axis = 0; axis < 3; ++axis) {
        const double volume = dot(normals[axis], body.edge[axis]);
        const double from = dot(normals[axis], origin - body.corner) / volume;
        const double slope = dot(normals[axis], direction) / volume;
        if (slope != 0) t_hi = std::min(t_hi, slope > 0 ? (1 - from) / slope : -from / slope);
    }
    return std::max(t_hi, 0.0);
}

[[nodiscard]] std::array<double, 3> triple(const Vec3& v) { return {v.x, v.y, v.z}; }
[[nodiscard]] Vec3 vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

[[nodiscard]] Body body_of(const Box& box, const Affine& to_world) {
    const Vec3 size = box.size();
    return {Body::Kind::parallelepiped,
            to_world.point(box.lo),
            {size.x * to_world.linear[0], size.y * to_world.linear[1], size.z * to_world.linear[2]}};
}

[[nodiscard]] double least_depth(const Camera& camera, const Vec3* corners, int count) {
    double least = kInfinity;
    for (int i = 0; i < count; ++i) least = std::min(least, camera.to_view(corners[i]).z);
    return std::max(least, camera.near());
}

/// Area of the face across an edge, in the box's own coordinates.
[[nodiscard]] double face_area(const Box& box, int axis) {
    const Vec3 size = box.size();
    return size[(axis + 1) % 3] * size[(axis + 2) % 3];
}

/// Lines through the box along one axis: what they may meet there, K = labels = 0 where nothing.
[[nodiscard]] BoxLines lines_along(const CatalogueSurface& field, const Box& box, int axis) {
    BoxLines lines;
    const auto a = static_cast<std::size_t>(axis);
    lines.axis = axis;
    lines.lo = triple(box.lo);
    lines.size = triple(box.size());
    lines.root_lo = box.lo[axis];
    lines.root_hi = box.hi[axis];
    lines.both_signs = lines.root_lo < 0 && lines.root_hi > 0;
    lines.negative = lines.root_hi <= 0;
    lines.labels = lines.both_signs ? 2 : 1;
    if (field.torus()) {
        lines.kind = axis == 2 ? BoxLines::Kind::torus_along : BoxLines::Kind::torus_across;
        lines.major = field.major();
        lines.minor = field.minor();
        if (axis != 2) {
            // Inside of the circle in the tube's middle, outside, or both.
            const auto nearest = [](double lo, double hi) { return lo > 0 ? lo : hi < 0 ? -hi : 0.0; };
            const double least = std::hypot(nearest(box.lo.x, box.hi.x), nearest(box.lo.y, box.hi.y));
            const double most = std::hypot(std::max(-box.lo.x, box.hi.x), std::max(-box.lo.y, box.hi.y));
            const double hair = 1e-12 * field.major();
            lines.inner = most <= field.major() - hair;
            lines.both_rings = !lines.inner && least < field.major() + hair;
            if (lines.both_rings) lines.labels *= 2;
        }
        return lines;
    }
    lines.square = triple(field.square());
    lines.linear = triple(field.linear());
    lines.constant = field.constant();
    if (lines.square[a] != 0) {
        lines.kind = BoxLines::Kind::quadric;
        lines.inverse = -1 / lines.square[a];
        assert(lines.linear[a] == 0);  // no surface of the catalogue has both along one axis
    } else {
        lines.kind = BoxLines::Kind::plane;
        lines.labels = lines.linear[a] != 0 ? 1 : 0;
        lines.inverse = lines.labels != 0 ? -1 / lines.linear[a] : 0;
    }
    return lines;
}

/// A box in two along each axis: at 0, where a surface of the catalogue has its planes of symmetry, and
/// else beside the middle.
int cut(const Box& box, std::array<Box, 8>& out) {
    constexpr double kShare = 0.4871;
    for (std::size_t i = 0; i < 8; ++i) {
        out[i] = box;
        for (int axis = 0; axis < 3; ++axis) {
            const bool across = box.lo[axis] < 0 && box.hi[axis] > 0;
            const double middle = across ? 0 : box.lo[axis] + kShare * (box.hi[axis] - box.lo[axis]);
            ((i >> axis & 1U) != 0 ? out[i].lo : out[i].hi)[axis] = middle;
        }
    }
    return 8;
}

/// The parts of a body cut in two along each of its edges (4 triangles, 4 or 8 parallel ones). Flat ones in
/// halves; others beside the middle, where a surface may lie flat (a plane in the middle of its
/// bounds, an isosurface half-way through a cell): it would belong to both parts, or to none.
int cut(const Body& body, std::array<Body, 8>& out) {
    constexpr double kShare = 0.4871;
    Body half = body;
    for (Vec3& e : half.edge) e *= 0.5;
    const Vec3& a = half.edge[0];
    const Vec3& b = half.edge[1];
    if (body.kind == Body::Kind::triangle) {
        for (std::size_t i = 0; i < 4; ++i) out[i] = half;
        out[1].corner += a;
        out[2].corner += b;
        out[3].corner += a + b;
        out[3].edge[0] = -a;
        out[3].edge[1] = -b;
        return 4;
    }
    const std::size_t count = body.kind == Body::Kind::parallelogram ? 4 : 8;
    const double share = body.flat() ? 0.5 : kShare;
    for (std::size_t i = 0; i < count; ++i) {
        out[i] = body;
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const bool second = (i >> axis & 1U) != 0;
            if (second) out[i].corner += share * body.edge[axis];
            out[i].edge[axis] *= second ? 1 - share : share;
        }
    }
    return static_cast<int>(count);
}

}  // namespace

struct LineSampler::Doubts {
    std::atomic<std::uint64_t> undecided = 0, touching = 0, poles = 0, exact = 0;

    void add(const IsolationStats& more) {
        if (more.undecided != 0) undecided += more.undecided;
        if (more.touching != 0) touching += more.touching;
        if (more.poles != 0) poles += more.poles;
        if (more.exact != 0) exact += more.exact;
    }
};

std::string LineSampler::label() const { return fmt::format("surface \"{}\"", object_->surface.name); }

double LineSampler::optical_depth() const {
    return object_->optical_depth(1, kMostParticleOpacity, object_->geometry->most_opacity());
}

IsolationStats LineSampler::isolation() const {
    return {doubts_->undecided, doubts_->touching, doubts_->poles, doubts_->exact};
}

/// What the pieces of each kind weigh, while they are collected.
struct LineSampler::Weights {
    std::vector<FlatPiece> patches, parts;
    std::vector<double> patch_weights, part_weights;
    std::array<std::vector<double>, 3> cells;  // along each axis
    std::vector<double> lines;
    std::array<std::vector<FieldPiece>, 3> fields;  // along each axis
    std::array<std::vector<std::uint32_t>, 3> field_cell;
    std::array<std::vector<double>, 3> field_weights;
    std::array<std::vector<FieldLines>, SurfaceCells::kMostRoots + 1> field_lines;  // by their K
    std::array<std::vector<double>, SurfaceCells::kMostRoots + 1> field_line_weights;
};

LineSampler::LineSampler(const Object& object, const Camera& camera, std::uint32_t object_id, std::span<const Light> lights)
    : object_(&object),
      camera_(&camera),
      object_id_(object_id),
      lights_(lights),
      brightest_(object.geometry->painted() ? brightest_color(lights, object) : Vec3(0.0)),
      clipped_(!object.surface.clip.empty() ||
               (object.surface.bounds && !object.bounds_are_geometry())) {
    doubts_ = std::make_shared<Doubts>();
    const SurfaceGeometry& geometry = *object.geometry;
    const bool constant = object.surface.opacity_law == OpacityLaw::constant;
    const auto implicit = geometry.implicit();
    const auto trilinear = geometry.trilinear();
    const auto field = geometry.field();
    if (field) to_world_ = field->to_world;
    if (implicit) to_world_ = implicit->to_world;
    if (trilinear) {
        to_world_ = trilinear->to_world;
        isovalue_ = trilinear->isovalue;
    }
    view_ = LineView(camera, to_world_, constant);
    flat_view_ = LineView(camera, Affine(), constant);

    const std::size_t patches = geometry.patch_count();
    if (implicit) {
        if (patches > 0) {
            const Vec3 room(kBoxRoom * length(implicit->bounds.size()));
            virtual_pixels_ =
                add_boxes(*implicit, {implicit->bounds.lo - room, implicit->bounds.hi + room}, 0, 0);
        }
    } else {
        Weights weights;
        if (field) {
            add_fields(*field->cells, weights);
        } else {
            for (std::size_t patch = 0; patch < patches; ++patch)
                virtual_pixels_ +=
                    add_pieces(static_cast<std::uint32_t>(patch), geometry.body(patch), 0, weights);
        }
        flats_ = std::move(weights.patches);
        flat_parts_ = flats_.size();
        flats_.insert(flats_.end(), weights.parts.begin(), weights.parts.end());
        add_blocks(Kind::flat_patches, 0, 1, 0, weights.patch_weights);
        make_records();
        add_blocks(Kind::flat_parts, 0, 1, flat_parts_, weights.part_weights);
        for (int axis = 0; axis < 3; ++axis)
            add_blocks(Kind::cells, axis, 1, 0, weights.cells[static_cast<std::size_t>(axis)]);
        add_blocks(Kind::lines, 0, geometry.max_crossings(), 0, weights.lines);
    }
    cells_.shrink_to_fit();
    std::vector<double> sums;
    for (const Block& block : blocks_) sums.push_back(block.virtual_pixels);
    if (virtual_pixels_ > 0) block_table_ = AliasTable(sums);
}

/// Virtual pixels of the lines along one axis through a box, for each of their K crossings.
double LineSampler::edge_weight(const Affine& to_world, const Box& box, int axis, double reach,
                                double least_depth, double least_area) const {
    const double across = face_area(box, axis);
    if (object_->surface.opacity_law == OpacityLaw::oblique) {
        const Vec3 cofactor = cross(to_world.linear[(axis + 1) % 3], to_world.linear[(axis + 2) % 3]);
        // The view's normals are scaled, and a reach with them: that of its own is the cofactor's length.
        return across * (length(cofactor) * (reach / view_.reach[static_cast<std::size_t>(axis)])) / least_area;
    }
    const double side = camera_->pixel_size() * (camera_->perspective() ? least_depth : 1);
    const double depth = camera_->perspective() ? least_depth : 1;
    return std::abs(to_world.determinant()) * across * reach / (side * side * depth);
}

/// What a trial's payment is compared with: see edge_lines.hpp.
double LineSampler::edge_bound(double least_depth, double least_area) const {
    if (!camera_->perspective()) return 1;
    const double scale = flat_view_.depth_scale;
    if (object_->surface.opacity_law == OpacityLaw::oblique) {
        const double far_side = camera_->pixel_size() / scale;
        return least_area / (far_side * far_side);
    }
    const double z = least_depth * scale;
    return z * z * z;
}

/// Adds a box, whole or in parts, whichever needs fewer trials; returns its virtual pixels. `most`: those of
/// the whole surface.
double LineSampler::add_boxes(const ImplicitPatch& patch, const Box& box, int depth, double most) {
    std::array<Vec3, 8> corners;
    const int count = body_of(box, patch.to_world).vertices(corners);
    const auto area = camera_->pixel_area_range(corners.data(), count);
    if (!area || patch.field->excludes(box)) return 0;
    const double nearest = least_depth(*camera_, corners.data(), count);
    std::array<BoxLines, 3> lines;
    std::array<double, 3> weights{};
    double whole = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        lines[a] = lines_along(*patch.field, box, axis);
        lines[a].bound = edge_bound(nearest, area->least);
        lines[a].reach = view_.reach;
        if (view_.perspective && view_.constant_law)
            for (int k = 0; k < 3; ++k) {
                const auto i = static_cast<std::size_t>(k);
                lines[a].reach[i] =
                    std::max(std::abs(box.lo[k] - view_.eye[i]), std::abs(box.hi[k] - view_.eye[i]));
            }
        weights[a] =
            lines[a].labels * edge_weight(patch.to_world, box, axis, lines[a].reach[a], nearest, area->least);
        whole += weights[a];
    }
    if (!(whole > 0)) return 0;
    if (depth == 0) most = whole;

    const bool cut_by_view = whole > kMostPixelsOutside && !camera_->wholly_in_view(corners.data(), count);
    const bool must = cut_by_view || (area->most > kMostAreaRatio * area->least && whole > 1);
    const bool may = depth < kMostBoxCuts && whole > kLeastBoxShare * most;
    if (depth < kMostCuts && (must || may)) {
        const std::size_t blocks_before = blocks_.size();
        const std::size_t boxes_before = box_count_;
        std::array<Box, 8> parts;
        const int part_count = cut(box, parts);
        double sum = 0;
        for (int i = 0; i < part_count; ++i)
            sum += add_boxes(patch, parts[static_cast<std::size_t>(i)], depth + 1, most);
        if (sum < (must ? 1 : kWorthACut) * whole) return sum;
        blocks_.resize(blocks_before);
        box_count_ = boxes_before;
    }
    for (std::size_t a = 0; a < 3; ++a)
        if (weights[a] > 0) blocks_.push_back({Kind::box, static_cast<int>(a), lines[a].labels, 0, 1, weights[a], {}, lines[a]});
    ++box_count_;
    return whole;
}

/// Adds one body, whole or in parts, whichever needs fewer trials; returns its virtual pixels.
double LineSampler::add_pieces(std::uint32_t patch, const Body& body, int depth, Weights& weights) {
    std::array<Vec3, 8> corners;
    const int count = body.vertices(corners);
    const auto area = camera_->pixel_area_range(corners.data(), count);
    if (!area) return 0;
    if (!body.flat() && object_->geometry->excludes(patch, body)) return 0;
    const double nearest = least_depth(*camera_, corners.data(), count);
    const bool cell = depth == 0 && object_->geometry->trilinear().has_value();
    double whole = 0;
    if (cell) {
        whole = add_cell(patch, body, nearest, area->least, weights);
    } else if (body.flat() && object_->surface.opacity_law == OpacityLaw::constant) {
        // |n·r| is the same all over a plane.
        const Vec3 normal =
            cross(body.edge[0], body.edge[1]) * (body.kind == Body::Kind::triangle ? 0.5 : 1.0);
        const double depth_cubed = camera_->perspective() ? nearest * nearest * nearest : 1;
        whole = std::abs(dot(normal, camera_->ray_direction(body.corner))) /
                (camera_->pixel_size() * camera_->pixel_size() * depth_cubed);
    } else {
        whole = object_->geometry->max_crossings() * body.crofton_area() / area->least;
    }
    if (!(whole > 0)) return 0;  // a body without extent

    const bool cut_by_view = whole > kMostPixelsOutside && !camera_->wholly_in_view(corners.data(), count);
    if (depth < kMostCuts && (cut_by_view || (area->most > kMostAreaRatio * area->least && whole > 1))) {
        // Whole cells come first in their lists, so a cell that is cut takes its own entry back.
        const CellRecord own = cell ? cells_.back() : CellRecord{};
        std::array<double, 3> own_weights{};
        if (cell) {
            cells_.pop_back();
            for (std::size_t a = 0; a < 3; ++a) {
                own_weights[a] = weights.cells[a].back();
                weights.cells[a].pop_back();
            }
        }
        const std::size_t lines_before = weights.lines.size();
        const std::size_t bodies_before = parts_.size();
        const std::size_t flats_before = weights.parts.size();
        std::array<Body, 8> parts;
        const int part_count = cut(body, parts);
        double sum = 0;
        for (int i = 0; i < part_count; ++i)
            sum += add_pieces(patch, parts[static_cast<std::size_t>(i)], depth + 1, weights);
        if (sum < whole) return sum;
        pieces_.resize(lines_before);
        weights.lines.resize(lines_before);
        parts_.resize(bodies_before);
        weights.parts.resize(flats_before);
        weights.part_weights.resize(flats_before);
        own_positions_.resize(3 * flats_before);
        own_triangles_.resize(flats_before);
        own_patches_.resize(flats_before);
        if (cell) {
            cells_.push_back(own);
            for (std::size_t a = 0; a < 3; ++a) weights.cells[a].push_back(own_weights[a]);
        }
    }
    if (cell) return whole;
    if (!body.flat()) {
        std::int32_t part = -1;  // the patch's own body
        if (depth > 0) {
            part = static_cast<std::int32_t>(parts_.size());
            parts_.push_back(body);
        }
        pieces_.push_back({patch, part, area->least});
        weights.lines.push_back(whole);
        return whole;
    }
    const double bound = edge_bound(nearest, area->least);
    if (depth == 0 && object_->geometry->mesh() != nullptr) {
        weights.patches.push_back({patch, -1, bound});
        weights.patch_weights.push_back(whole);
        return whole;
    }
    const auto vertex = static_cast<std::uint32_t>(own_positions_.size());
    own_positions_.insert(own_positions_.end(),
                          {body.corner, body.corner + body.edge[0], body.corner + body.edge[1]});
    own_triangles_.push_back({vertex, vertex + 1, vertex + 2});
    own_patches_.push_back(patch);
    weights.parts.push_back({static_cast<std::uint32_t>(own_triangles_.size() - 1), 0, bound});
    weights.part_weights.push_back(whole);
    return whole;
}

/// Adds a whole cell; returns its virtual pixels.
double LineSampler::add_cell(std::uint32_t patch, const Body& body, double least_depth, double least_area,
                             Weights& weights) {
    const TrilinearCorners cell = object_->geometry->cell(patch);
    cells_.push_back({cell.value, cell.base, patch, edge_bound(least_depth, least_area)});
    const Box unit{Vec3(0.0), Vec3(1.0)};
    double whole = 0;
    for (std::size_t a = 0; a < 3; ++a) {
        double reach = view_.reach[a];
        if (view_.perspective && view_.constant_law)
            reach =
                std::max(std::abs(cell.base[a] - view_.eye[a]), std::abs(cell.base[a] + 1 - view_.eye[a]));
        const double weight =
            edge_weight(to_world_, unit, static_cast<int>(a), reach, least_depth, least_area);
        weights.cells[a].push_back(weight);
        whole += weight;
    }
    return body.flat() ? 0 : whole;
}

void LineSampler::add_blocks(Kind kind, int axis, int labels, std::size_t offset,
                             std::span<const double> weights) {
    for (std::size_t first = 0; first < weights.size(); first += kBlockPieces) {
        const auto block = weights.subspan(first, std::min(kBlockPieces, weights.size() - first));
        double sum = 0;
        for (const double w : block) sum += w;
        if (sum > 0) blocks_.push_back({kind, axis, labels, offset + first, block.size(), sum, AliasTable(block), {}});
    }
}

/// Adds what can be seen of a formula's cells.
void LineSampler::add_fields(const SurfaceCells& cells, Weights& weights) {
    if (cells.formula() != nullptr) programs_ = std::make_shared<FieldPrograms>(*cells.formula());
    // What cells say of themselves may have to be found first: by all threads, some at a time.
    constexpr std::size_t kAtOnce = std::size_t{1} << 16U;
    std::vector<SurfaceCell> some;
    for (std::size_t first = 0; first < cells.count(); first += kAtOnce) {
        some.resize(std::min(kAtOnce, cells.count() - first));
        parallel_for(some.size(), 256, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) some[i] = cells.cell(first + i);
        });
        for (std::size_t i = 0; i < some.size(); ++i)
            virtual_pixels_ += add_field(cells, static_cast<std::uint32_t>(first + i), some[i], some[i].tight, 0, weights);
    }
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const std::size_t offset = fields_.size();
        fields_.insert(fields_.end(), weights.fields[axis].begin(), weights.fields[axis].end());
        fields_cell_.insert(fields_cell_.end(), weights.field_cell[axis].begin(), weights.field_cell[axis].end());
        add_blocks(Kind::fields, static_cast<int>(axis), 1, offset, weights.field_weights[axis]);
    }
    // The lines of a block have the same K.
    for (std::size_t labels = 1; labels < weights.field_lines.size(); ++labels) {
        const std::size_t offset = field_lines_.size();
        const auto& lines = weights.field_lines[labels];
        field_lines_.insert(field_lines_.end(), lines.begin(), lines.end());
        add_blocks(Kind::field_lines, 0, static_cast<int>(labels), offset, weights.field_line_weights[labels]);
    }
}

/// The largest that |g·ρ|/|g_a| (constant law) or |N|/|g_a| (oblique) can be in a box of a cell in which f is
/// monotone along a: both are functions of g_b/g_a alone. Infinite where intervals know no bound.
double LineSampler::field_reach(const SurfaceCell& cell, const Box& box, std::size_t a) const {
    const std::size_t b = (a + 1) % 3;
    const std::size_t c = (a + 2) % 3;
    const Interval ratio[2] = {cell.gradient[b] / cell.gradient[a], cell.gradient[c] / cell.gradient[a]};
    for (const Interval& r : ratio)
        if (r.empty() || !(r.lo > -kInfinity && r.hi < kInfinity)) return kInfinity;
    constexpr double kRounding = 1 + 1e-12;
    if (view_.constant_law) {
        const auto rho = [&](std::size_t axis) {
            const auto k = static_cast<int>(axis);
            return view_.perspective ? Interval(box.lo[k], box.hi[k]) - Interval(view_.eye[axis])
                                     : Interval(view_.eye[axis]);
        };
        return kRounding * (rho(a) + ratio[0] * rho(b) + ratio[1] * rho(c)).reach();
    }
    // |M_a + Σ (g_b/g_a) M_b| is convex in the ratios: largest at a corner.
    double largest = 0;
    for (const double u : {ratio[0].lo, ratio[0].hi})
        for (const double v : {ratio[1].lo, ratio[1].hi}) {
            double square = 0;
            for (const auto& row : view_.normal) {
                const double sum = row[a] + u * row[b] + v * row[c];
                square += sum * sum;
            }
            largest = std::max(largest, square);
        }
    return kRounding * std::sqrt(largest);
}

/// Adds the surface in one box of a cell, whole or in parts; returns its virtual pixels.
double LineSampler::add_field(const SurfaceCells& cells, std::uint32_t index, const SurfaceCell& cell,
                              const Box& box, int depth, Weights& weights) {
    std::array<Vec3, 8> corners;
    const int count = body_of(box, to_world_).vertices(corners);
    const auto area = camera_->pixel_area_range(corners.data(), count);
    if (!area || (depth > 0 && cells.excludes(box))) return 0;
    const double nearest = least_depth(*camera_, corners.data(), count);

    // Along the one axis that gives least, else along all.
    int best = -1;
    double whole = kInfinity;
    double best_reach = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        if (!cell.monotone(a)) continue;
        const double reach = field_reach(cell, box, a);
        const double weight = edge_weight(to_world_, box, axis, reach, nearest, area->least);
        if (weight < whole) {
            best = axis;
            whole = weight;
            best_reach = reach;
        }
    }
    std::array<double, 3> reach = view_.reach;
    std::array<double, 3> along{};
    std::array<std::size_t, 3> labels{};
    if (view_.perspective && view_.constant_law)
        for (int k = 0; k < 3; ++k) {
            const auto i = static_cast<std::size_t>(k);
            reach[i] = std::max(std::abs(box.lo[k] - view_.eye[i]), std::abs(box.hi[k] - view_.eye[i]));
        }
    double once = 0;  // with one crossing a line
    for (int axis = 0; axis < 3; ++axis)
        once += edge_weight(to_world_, box, axis, reach[static_cast<std::size_t>(axis)], nearest, area->least);
    if (!(whole < kTooSteep * once)) {
        best = -1;
        whole = 0;
        for (int axis = 0; axis < 3; ++axis) {
            const auto a = static_cast<std::size_t>(axis);
            labels[a] = static_cast<std::size_t>(cells.most_roots(index, axis));
            along[a] = static_cast<double>(labels[a]) * edge_weight(to_world_, box, axis, reach[a], nearest, area->least);
            whole += along[a];
        }
    }
    if (!(whole > 0)) return 0;

    const bool cut_by_view = whole > kMostPixelsOutside && !camera_->wholly_in_view(corners.data(), count);
    if (depth < kMostCuts && (cut_by_view || (area->most > kMostAreaRatio * area->least && whole > 1))) {
        std::array<std::size_t, 3> before{};
        std::array<std::size_t, SurfaceCells::kMostRoots + 1> lines_before{};
        for (std::size_t a = 0; a < before.size(); ++a) before[a] = weights.fields[a].size();
        for (std::size_t k = 0; k < lines_before.size(); ++k) lines_before[k] = weights.field_lines[k].size();
        const std::size_t cells_before = field_cells_;
        std::array<Box, 8> parts;
        const int part_count = cut(box, parts);
        double sum = 0;
        for (int i = 0; i < part_count; ++i)
            sum += add_field(cells, index, cell, parts[static_cast<std::size_t>(i)], depth + 1, weights);
        if (sum < whole) return sum;
        for (std::size_t a = 0; a < 3; ++a) {
            weights.fields[a].resize(before[a]);
            weights.field_cell[a].resize(before[a]);
            weights.field_weights[a].resize(before[a]);
        }
        field_cells_ = cells_before;
        for (std::size_t k = 0; k < lines_before.size(); ++k) {
            weights.field_lines[k].resize(lines_before[k]);
            weights.field_line_weights[k].resize(lines_before[k]);
        }
    }
    FieldPiece piece{triple(box.lo), triple(box.hi), best_reach, edge_bound(nearest, area->least)};
    if (best >= 0) {
        weights.fields[static_cast<std::size_t>(best)].push_back(piece);
        weights.field_cell[static_cast<std::size_t>(best)].push_back(index);
        weights.field_weights[static_cast<std::size_t>(best)].push_back(whole);
        return whole;
    }
    ++field_cells_;
    for (std::size_t a = 0; a < 3; ++a) {
        if (!(along[a] > 0)) continue;
        weights.field_lines[labels[a]].push_back({piece, reach, index, static_cast<int>(a)});
        weights.field_line_weights[labels[a]].push_back(along[a]);
    }
    return whole;
}

struct LineSampler::Bits {
    Bits(Seed seed, std::uint32_t object, std::uint32_t repeat, std::uint64_t index)
        : first(random_bits(seed, {.object = object, .repeat = repeat, .index = index, .block = 0})),
          second(random_bits(seed, {.object = object, .repeat = repeat, .index = index, .block = 1})) {}

    [[nodiscard]] double u() const { return unit_interval(first[0]); }
    [[nodiscard]] double v() const { return unit_interval(first[1]); }
    [[nodiscard]] std::uint32_t choice() const { return first[2]; }
    [[nodiscard]] double chance() const { return unit_interval(first[3]); }
    std::array<std::uint32_t, 4> first, second;
};

/// Whole triangles of a mesh, for throw_triangles.
void LineSampler::make_records() {
    records_.resize(flat_parts_);
    constexpr std::size_t kAtOnce = 4096;
    parallel_for(flat_parts_, kAtOnce, [&](std::size_t begin, std::size_t end) {
        const TriangleMesh& mesh = *object_->geometry->mesh();
        for (std::size_t i = begin; i < end; ++i) {
            const auto& corner = mesh.triangles[flats_[i].triangle];
            std::array<Vec3, 3> places;
            for (std::size_t k = 0; k < 3; ++k) places[k] = mesh.positions[corner[k]];
            const Vec3 flat = cross(places[1] - places[0], places[2] - places[0]);
            std::array<Vec3, 3> normals;
            normals.fill(length(flat) > 0 ? camera_->view_vector(normalize(flat)) : Vec3(0.0));
            if (!mesh.normals.empty())
                for (std::size_t k = 0; k < 3; ++k) normals[k] = camera_->view_vector(mesh.normals[corner[k]]);
            for (Vec3& place : places) place = camera_->to_view(place);
            records_[i] = TriangleRecord(flat_view_, places, normals, flats_[i].bound);
        }
    });
}

TriangleBlock LineSampler::triangle_block(const Block& block) const {
    return {&flat_view_, records_.data() + block.first, &block.table};
}

FlatBlock LineSampler::flat_block(const Block& block) const {
    const TriangleMesh* mesh = object_->geometry->mesh();
    const FlatPiece* pieces = flats_.data() + block.first;
    if (block.kind == Kind::flat_patches)
        return {&mesh->positions[0].x, mesh->triangles[0].data(), pieces, true};
    return {&own_positions_[0].x, own_triangles_[0].data(), pieces, mesh != nullptr};
}

CellBlock LineSampler::cell_block(const Block& block) const {
    return {cells_.data() + block.first, isovalue_, block.axis};
}

FieldBlock LineSampler::field_block(const Block& block) const {
    if (programs_) return {fields_.data() + block.first, programs_.get(), nullptr, nullptr, block.axis};
    return {fields_.data() + block.first, nullptr, object_->geometry->field()->cells, fields_cell_.data() + block.first,
            block.axis};
}

/// The point that a kernel has kept, unless it is clipped away.
std::optional<LineSampler::Point> LineSampler::finish(const Block& block, std::uint32_t piece,
                                                      const LinePoint& found, std::uint32_t choice) const {
    const Vec3 view = vector(found.view);
    if (gives_object_points(block)) {
        if (clipped_ && !object_->keeps(to_world_.point(vector(found.place)))) return std::nullopt;
        return Point{view, vector(found.normal)};
    }
    const FlatBlock flats = flat_block(block);
    const FlatPiece& flat = flats.pieces[piece];
    const std::uint32_t* corner = flats.triangles + std::size_t{3} * flat.triangle;
    const auto position = [&](std::size_t i) {
        const double* p = flats.positions + std::size_t{3} * corner[i];
        return Vec3(p[0], p[1], p[2]);
    };
    const Vec3 edges[2] = {position(1) - position(0), position(2) - position(0)};
    const double u = found.place[0];
    const double v = found.place[1];
    Vec3 normal = cross(edges[0], edges[1]);
    const TriangleMesh* mesh = object_->geometry->mesh();
    const bool smooth = mesh != nullptr && !mesh->normals.empty();
    if (clipped_ || painted() || smooth) {
        const Vec3 world = position(0) + u * edges[0] + v * edges[1];
        if (clipped_ && !object_->keeps(world)) return std::nullopt;
        if (painted()) return paint(view, world, normal, choice);
        if (smooth) normal = object_->geometry->shading_normal(own_patches_[flat.triangle], world, normal);
    }
    return Point{view, camera_->view_vector(normal)};
}

/// Kept with τ(x)/τ, and shaded.
std::optional<LineSampler::Point> LineSampler::paint(const Vec3& view, const Vec3& world, const Vec3& normal,
                                                     std::uint32_t choice) const {
    const SurfaceGeometry& geometry = *object_->geometry;
    const double own = object_->optical_depth(1, kMostParticleOpacity, geometry.opacity_at(world));
    if (!(unit_interval(choice) * optical_depth() < own)) return std::nullopt;
    const Vec3 color = shade(*camera_, lights_, object_->surface.shading, geometry.color(world), world, normal);
    return Point{view, share_of(color, brightest_)};
}

std::span<const FieldRoot> LineSampler::field_roots(const FieldLines& lines, int labels, double u, double v,
                                                    Vec3& place) const {
    thread_local std::vector<FieldRoot> roots;
    roots.clear();
    const SurfaceCells& cells = *object_->geometry->field()->cells;
    const int a = lines.axis;
    const Vec3 lo = vector(lines.piece.lo);
    const Vec3 hi = vector(lines.piece.hi);
    const int b = (a + 1) % 3;
    const int c = (a + 2) % 3;
    place[a] = 0;
    place[b] = lo[b] + u * (hi[b] - lo[b]);
    place[c] = lo[c] + v * (hi[c] - lo[c]);
    Vec3 along(0.0);
    along[a] = 1;
    IsolationStats stats;
    cells.cross(lines.cell, place, along, lo[a], hi[a], roots, stats);
    const auto most = static_cast<std::size_t>(labels);
    if (roots.size() > most) {
        stats.undecided += roots.size() - most;
        roots.resize(most);
    }
    doubts_->add(stats);
    return roots;
}

std::optional<LineSampler::Point> LineSampler::keep_field_root(const Block& block, const FieldLines& lines, Vec3 place,
                                                               const FieldRoot& root, double chance) const {
    place[lines.axis] = root.t;
    LinePoint found;
    if (!keep_crossing(view_, triple(place), triple(root.gradient), lines.reach, lines.piece.bound, chance, found))
        return std::nullopt;
    return finish(block, 0, found, 0);
}

std::optional<LineSampler::Point> LineSampler::trial_on(const Block& block, const Bits& bits) const {
    const std::uint32_t piece =
        table(block) != nullptr ? block.table.pick(bits.second[0], bits.second[1]) : 0;
    LinePoint found;
    bool kept = false;
    switch (block.kind) {
        case Kind::flat_patches: {
            Point point{};
            if (!throw_triangle(triangle_block(block), bits.first, point)) return std::nullopt;
            if (clipped_ && !object_->keeps(camera_->to_world(point.view))) return std::nullopt;
            return point;
        }
        case Kind::flat_parts:
            kept = throw_flat(flat_view_, flat_block(block), piece, bits.u(), bits.v(), bits.chance(), found);
            break;
        case Kind::cells:
            kept = cross_cell(view_, cells_[block.first + piece], isovalue_, block.axis, bits.u(), bits.v(),
                              bits.chance(), found);
            break;
        case Kind::box:
            kept = cross_box(view_, block.box, chosen_label(bits.choice(), block.box.labels), bits.u(),
                             bits.v(), bits.chance(), found);
            break;
        case Kind::fields:
            kept = cross_field(view_, field_block(block), piece, bits.u(), bits.v(), bits.chance(), found);
            break;
        case Kind::field_lines: {
            const FieldLines& lines = field_lines_[block.first + piece];
            Vec3 place;
            const auto roots = field_roots(lines, block.labels, bits.u(), bits.v(), place);
            const auto label = static_cast<std::size_t>(chosen_label(bits.choice(), block.labels));
            if (label >= roots.size()) return std::nullopt;
            return keep_field_root(block, lines, place, roots[label], bits.chance());
        }
        case Kind::lines: return shoot_and_keep(pieces_[block.first + piece], bits);
    }
    return kept ? finish(block, piece, found, bits.choice()) : std::nullopt;
}

std::optional<LineSampler::Point> LineSampler::trial(Seed seed, std::uint32_t repeat,
                                                     std::uint64_t index) const {
    const auto third =
        random_bits(seed, {.object = object_id_, .repeat = repeat, .index = index, .block = 2});
    return trial_on(blocks_[block_table_.pick(third[0], third[1])], Bits(seed, object_id_, repeat, index));
}

std::optional<LineSampler::Point> LineSampler::trial_in_block(std::size_t block, Seed seed,
                                                              std::uint32_t repeat,
                                                              std::uint32_t index) const {
    return trial_on(blocks_[block],
                    Bits(seed, object_id_, repeat, (static_cast<std::uint64_t>(block) << 32U) | index));
}

void LineSampler::finish_chunk(const Block& block, const LineWords& words, const PointChunk& chunk,
                               std::vector<Point>& out) const {
    const bool ready = !clipped_ && gives_object_points(block);
    for (std::size_t i = 0; i < chunk.count; ++i) {
        const auto at = [&](const double(&lanes)[3][kChunkRoom]) {
            return std::array<double, 3>{lanes[0][i], lanes[1][i], lanes[2][i]};
        };
        if (ready) {
            out.push_back({vector(at(chunk.view)), vector(at(chunk.normal))});
        } else if (const auto point = finish(block, static_cast<std::uint32_t>(chunk.piece[i]),
                                             {at(chunk.view), at(chunk.normal), at(chunk.place)},
                                             static_cast<std::uint32_t>(words.choice[chunk.line[i]]))) {
            out.push_back(*point);
        }
    }
}

void LineSampler::trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first,
                                  std::uint32_t count, std::vector<Point>& out) const {
    const Block& b = blocks_[block];
    if (b.kind == Kind::lines || b.kind == Kind::field_lines) {
        for (std::uint32_t i = 0; i < count; ++i)
            if (const auto point = trial_in_block(block, seed, repeat, first + i)) out.push_back(*point);
        return;
    }
    const LineKeys keys{seed.value, object_id_, repeat, static_cast<std::uint32_t>(block)};
    if (b.kind == Kind::flat_patches) {
        const auto before = static_cast<std::ptrdiff_t>(out.size());
        throw_triangles(triangle_block(b), keys, first, count, out);
        if (clipped_) {
            const auto gone = [&](const Point& point) { return !object_->keeps(camera_->to_world(point.view)); };
            out.erase(std::remove_if(out.begin() + before, out.end(), gone), out.end());
        }
        return;
    }
    LineWords words;
    PointChunk chunk;
    for (std::uint32_t done = 0; done < count;) {
        const std::uint32_t n = std::min(kLineChunk, count - done);
        draw_words(keys, table(b), first + done, n, words);
        if (b.kind == Kind::box) {
            cross_boxes(view_, b.box, -1, words, n, chunk);
        } else if (b.kind == Kind::cells) {
            cross_cells(view_, cell_block(b), words, n, chunk);
        } else if (b.kind == Kind::fields) {
            cross_fields(view_, field_block(b), words, n, chunk);
        } else {
            throw_flats(flat_view_, flat_block(b), words, n, chunk);
        }
        finish_chunk(b, words, chunk, out);
        done += n;
    }
}

// ---- uniform random lines: parts of cut cells, and the wrong twin that keeps all crossings

namespace {

struct Shot {
    Vec3 origin{0.0}, direction{0.0};
    CrossingList found;
    int count = 0;

    [[nodiscard]] Vec3 at(int i) const { return origin + found[static_cast<std::size_t>(i)].t * direction; }
};

/// A uniform random line through the body, and what it meets of the patch.
[[nodiscard]] Shot shoot(const SurfaceGeometry& geometry, std::uint32_t patch, const Body& body,
                         const std::array<std::uint32_t, 4>& bits, std::uint32_t more_bits) {
    Shot shot;
    const double u = unit_interval(bits[0]);
    const double v = unit_interval(bits[1]);
    // A uniform point on the body's surface, which comes in three pairs of faces…
    const double areas[3] = {length(cross(body.edge[1], body.edge[2])),
                             length(cross(body.edge[2], body.edge[0])),
                             length(cross(body.edge[0], body.edge[1]))};
    double pick = unit_interval(more_bits) * 2 * (areas[0] + areas[1] + areas[2]);
    int face = 0;
    while (face < 5 && pick >= areas[face >> 1]) pick -= areas[face++ >> 1];
    const int axis = face >> 1;
    const Vec3& a = body.edge[(axis + 1) % 3];
    const Vec3& b = body.edge[(axis + 2) % 3];
    shot.origin = body.corner + u * a + v * b;
    Vec3 inward = normalize(cross(a, b));
    if (dot(inward, body.edge[axis]) < 0) inward = -inward;
    if ((face & 1) != 0) {
        shot.origin += body.edge[axis];
        inward = -inward;
    }
    // … and a direction by the cosine law: together a uniform random line through the body.
    const double disc = unit_interval(bits[2]);
    const Vec2 turn = std::sqrt(disc) * unit_circle(unit_interval(bits[3]));
    const Vec3 side = normalize(a);
    shot.direction = turn.x * side + turn.y * cross(inward, side) + std::sqrt(1 - disc) * inward;

    const double t_hi = exit_distance(body, shot.origin, shot.direction);
    // A hair beyond both ends: a surface may lie in a face of the body, where rounding would lose it.
    const double hair = 1e-12 * t_hi;
    shot.count = geometry.crossings(patch, {shot.origin, shot.direction, -hair, t_hi + hair}, shot.found);
    return shot;
}

/// The repeat of a group to which crossing `label` of a line goes.
[[nodiscard]] std::size_t dealt(std::uint64_t bits, int label, LineSampler::Deal deal) {
    const std::uint64_t step = deal == LineSampler::Deal::apart ? 2 * (bits >> 4U & 7U) + 1 : 0;
    return ((bits & 15U) + static_cast<std::uint64_t>(label) * step) % kLineGroup;
}

}  // namespace

std::optional<LineSampler::Point> LineSampler::keep(std::uint32_t patch, const Crossing& hit,
                                                    const Vec3& world, double least_area,
                                                    double chance) const {
    const Vec3 view = camera_->to_view(world);
    if (!(view.z >= camera_->near() && view.z <= camera_->far())) return std::nullopt;
    const double area = camera_->pixel_area(view);
    if (chance * area >= least_area) return std::nullopt;
    if (object_->surface.opacity_law == OpacityLaw::constant) {
        const Vec3 ray = camera_->ray_direction(world);
        const double cosine = std::abs(dot(hit.normal, ray)) / (length(hit.normal) * length(ray));
        if (chance * area >= least_area * cosine) return std::nullopt;
    }
    const Vec2 pixel = camera_->project(view);
    if (!(pixel.x >= 0 && pixel.x < camera_->width() && pixel.y >= 0 && pixel.y < camera_->height()))
        return std::nullopt;
    if (!object_->keeps(world)) return std::nullopt;
    return Point{view, camera_->view_vector(object_->geometry->shading_normal(patch, world, hit.normal))};
}

const Body& LineSampler::body_of_piece(const Piece& piece, Body& own) const {
    if (piece.part >= 0) return parts_[static_cast<std::size_t>(piece.part)];
    own = object_->geometry->body(piece.patch);
    return own;
}

std::optional<LineSampler::Point> LineSampler::shoot_and_keep(const Piece& piece, const Bits& bits) const {
    // One word serves two choices: its high part the crossing, what is left of it the face.
    const auto choices = static_cast<std::uint64_t>(bits.second[2]) *
                         static_cast<std::uint64_t>(object_->geometry->max_crossings());
    Body own;
    const Shot shot = shoot(*object_->geometry, piece.patch, body_of_piece(piece, own), bits.first,
                            static_cast<std::uint32_t>(choices));
    const auto j = static_cast<int>(choices >> 32U);
    if (j >= shot.count) return std::nullopt;
    return keep(piece.patch, shot.found[static_cast<std::size_t>(j)], shot.at(j), piece.least_area,
                unit_interval(bits.second[3]));
}

double LineSampler::line_pixels() const {
    std::array<Vec3, 8> corners;
    const Body body = object_->geometry->body(0);
    const auto area = camera_->pixel_area_range(corners.data(), body.vertices(corners));
    return area ? body.crofton_area() / area->least : 0;
}

void LineSampler::trial_keeping_all(Seed seed, std::uint32_t repeat, std::uint64_t index,
                                    std::vector<Point>& out) const {
    out.clear();
    const Bits bits(seed, object_id_, repeat, index);
    const auto third =
        random_bits(seed, {.object = object_id_, .repeat = repeat, .index = index, .block = 2});
    std::array<Vec3, 8> corners;
    const Body body = object_->geometry->body(0);
    const auto area = camera_->pixel_area_range(corners.data(), body.vertices(corners));
    const Shot shot = shoot(*object_->geometry, 0, body, bits.first, bits.second[2]);
    for (int i = 0; area && i < shot.count; ++i) {
        const auto k = static_cast<std::size_t>(i);
        if (const auto point = keep(0, shot.found[k], shot.at(i), area->least, unit_interval(third[k % 4])))
            out.push_back(*point);
    }
}

// ---- fast mode

std::optional<Box> LineSampler::block_bounds(std::size_t block) const {
    const Block& b = blocks_[block];
    Box bounds;
    const auto include = [&](const Body& body) { bounds.include(body.bounds()); };
    for (std::size_t i = b.first; i < b.first + b.count; ++i) {
        switch (b.kind) {
            case Kind::flat_patches:
            case Kind::flat_parts: {
                const FlatBlock flats = flat_block(b);
                const std::uint32_t* corner = flats.triangles + std::size_t{3} * flats.pieces[i - b.first].triangle;
                const auto position = [&](std::size_t k) {
                    const double* p = flats.positions + std::size_t{3} * corner[k];
                    return Vec3(p[0], p[1], p[2]);
                };
                include({Body::Kind::parallelogram, position(0), {position(1) - position(0), position(2) - position(0), Vec3(0.0)}});
                break;
            }
            case Kind::cells: {
                const Vec3 base(cells_[i].base[0], cells_[i].base[1], cells_[i].base[2]);
                include(body_of({base, base + Vec3(1.0)}, to_world_));
                break;
            }
            case Kind::box: {
                const Vec3 lo = vector(b.box.lo);
                include(body_of({lo, lo + vector(b.box.size)}, to_world_));
                break;
            }
            case Kind::fields: include(body_of({vector(fields_[i].lo), vector(fields_[i].hi)}, to_world_)); break;
            case Kind::field_lines:
                include(body_of({vector(field_lines_[i].piece.lo), vector(field_lines_[i].piece.hi)}, to_world_));
                break;
            case Kind::lines: {
                Body own;
                include(body_of_piece(pieces_[i], own));
                break;
            }
        }
    }
    return bounds;
}

int LineSampler::block_crossings(std::size_t block) const { return blocks_[block].labels; }

void LineSampler::lines_in_block(std::size_t block, Seed seed, std::uint32_t group, std::uint32_t count,
                                 Deal deal, std::span<std::vector<Point>, kLineGroup> out) const {
    const Block& b = blocks_[block];
    assert(b.kind == Kind::box || b.kind == Kind::lines || b.kind == Kind::field_lines);
    const int labels = block_crossings(block);
    if (b.kind == Kind::lines) {
        for (std::uint32_t i = 0; i < count; ++i) {
            const std::uint64_t index = (static_cast<std::uint64_t>(block) << 32U) | i;
            const Bits bits(seed, object_id_, group, index);
            const auto third =
                random_bits(seed, {.object = object_id_, .repeat = group, .index = index, .block = 2});
            const Piece& piece = pieces_[b.first + b.table.pick(bits.second[0], bits.second[1])];
            Body own;
            const Shot shot =
                shoot(*object_->geometry, piece.patch, body_of_piece(piece, own), bits.first, bits.second[2]);
            for (int l = 0; l < shot.count; ++l)
                if (const auto point =
                        keep(piece.patch, shot.found[static_cast<std::size_t>(l)], shot.at(l),
                             piece.least_area, turned_chance(unit_interval(bits.second[3]), l, labels)))
                    out[dealt(third[0], l, deal)].push_back(*point);
        }
        return;
    }
    if (b.kind == Kind::field_lines) {
        for (std::uint32_t i = 0; i < count; ++i) {
            const Bits bits(seed, object_id_, group, (static_cast<std::uint64_t>(block) << 32U) | i);
            const FieldLines& lines = field_lines_[b.first + b.table.pick(bits.second[0], bits.second[1])];
            Vec3 place;
            const auto roots = field_roots(lines, labels, bits.u(), bits.v(), place);
            for (std::size_t l = 0; l < roots.size(); ++l) {
                const auto label = static_cast<int>(l);
                if (const auto point =
                        keep_field_root(b, lines, place, roots[l], turned_chance(bits.chance(), label, labels)))
                    out[dealt(bits.choice(), label, deal)].push_back(*point);
            }
        }
        return;
    }
    const LineKeys keys{seed.value, object_id_, group, static_cast<std::uint32_t>(block)};
    LineWords words;
    PointChunk chunk;
    for (std::uint32_t done = 0; done < count;) {
        const std::uint32_t n = std::min(kLineChunk, count - done);
        draw_words(keys, nullptr, done, n, words);
        for (int label = 0; label < labels; ++label) {
            cross_boxes(view_, b.box, label, words, n, chunk);
            for (std::size_t i = 0; i < chunk.count; ++i) {
                const Vec3 place(chunk.place[0][i], chunk.place[1][i], chunk.place[2][i]);
                if (clipped_ && !object_->keeps(to_world_.point(place))) continue;
                out[dealt(words.choice[chunk.line[i]], label, deal)].push_back(
                    {{chunk.view[0][i], chunk.view[1][i], chunk.view[2][i]},
                     {chunk.normal[0][i], chunk.normal[1][i], chunk.normal[2][i]}});
            }
        }
        done += n;
    }
}

std::size_t LineSampler::bytes() const {
    std::size_t sum = pieces_.capacity() * sizeof(Piece) + parts_.capacity() * sizeof(Body) +
                      cells_.capacity() * sizeof(CellRecord) + flats_.capacity() * sizeof(FlatPiece) +
                      records_.capacity() * sizeof(TriangleRecord) +
                      own_positions_.capacity() * sizeof(Vec3) +
                      own_triangles_.capacity() * sizeof(own_triangles_[0]) +
                      own_patches_.capacity() * sizeof(std::uint32_t) +
                      fields_.capacity() * (sizeof(FieldPiece) + sizeof(std::uint32_t)) + field_lines_.capacity() * sizeof(FieldLines) +
                      blocks_.capacity() * sizeof(Block) +
                      block_table_.bytes();
    for (const Block& block : blocks_) sum += block.table.bytes();
    return sum;
}

}  // namespace pellucid
