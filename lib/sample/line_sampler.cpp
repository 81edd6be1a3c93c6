#include "sample/line_sampler.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "scene/shading.hpp"

namespace pellucid {
namespace {

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

}  // namespace

std::string LineSampler::label() const { return fmt::format("surface \"{}\"", object_->surface.name); }

double LineSampler::optical_depth() const {
    return object_->optical_depth(1, kMostParticleOpacity, object_->geometry->most_opacity());
}

IsolationStats LineSampler::isolation() const {
    return {doubts_->undecided, doubts_->touching, doubts_->poles, doubts_->exact};
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
