// How a surface is cut into pieces for the line sampler, and what each piece weighs.
#include <algorithm>
#include <cassert>
#include <cmath>

#include "core/parallel.hpp"
#include "sample/line_sampler.hpp"
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
    std::size_t field_cells = 0;  // that field_lines serve
    double field_pixels = 0;

    /// The fields of other cells, which come after these.
    void append_fields(const Weights& more) {
        const auto append = [](auto& to, const auto& from) { to.insert(to.end(), from.begin(), from.end()); };
        for (std::size_t axis = 0; axis < 3; ++axis) {
            append(fields[axis], more.fields[axis]);
            append(field_cell[axis], more.field_cell[axis]);
            append(field_weights[axis], more.field_weights[axis]);
        }
        for (std::size_t k = 0; k < field_lines.size(); ++k) {
            append(field_lines[k], more.field_lines[k]);
            append(field_line_weights[k], more.field_line_weights[k]);
        }
        field_cells += more.field_cells;
        field_pixels += more.field_pixels;
    }
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
    // What cells say of themselves may have to be found first: by all threads, some cells each. Sums are in the order of
    // the cells, however many threads there are.
    constexpr std::size_t kChunk = 256, kChunksAtOnce = 256;
    const std::size_t chunks = (cells.count() + kChunk - 1) / kChunk;
    std::vector<Weights> found;
    for (std::size_t first = 0; first < chunks; first += kChunksAtOnce) {
        found.assign(std::min(kChunksAtOnce, chunks - first), {});
        parallel_for(found.size(), 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t chunk = begin; chunk < end; ++chunk)
                for (std::size_t i = (first + chunk) * kChunk; i < std::min((first + chunk + 1) * kChunk, cells.count()); ++i) {
                    const SurfaceCell cell = cells.cell(i);
                    found[chunk].field_pixels += add_field(cells, static_cast<std::uint32_t>(i), cell, cell.tight, 0, found[chunk]);
                }
        });
        for (const Weights& each : found) weights.append_fields(each);
    }
    virtual_pixels_ += weights.field_pixels;
    field_cells_ += weights.field_cells;
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
                              const Box& box, int depth, Weights& weights) const {
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
        const std::size_t cells_before = weights.field_cells;
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
        weights.field_cells = cells_before;
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
    ++weights.field_cells;
    for (std::size_t a = 0; a < 3; ++a) {
        if (!(along[a] > 0)) continue;
        weights.field_lines[labels[a]].push_back({piece, reach, index, static_cast<int>(a)});
        weights.field_line_weights[labels[a]].push_back(along[a]);
    }
    return whole;
}

}  // namespace pellucid
