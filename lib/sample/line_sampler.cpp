#include "sample/line_sampler.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace pellucid {
namespace {

/// A piece is cut while the area that a pixel sees varies on it by more than this: what varies is
/// paid in trials that are thrown away. 4 = a factor of 2 in depth.
constexpr double kMostAreaRatio = 4;
/// A piece that reaches out of view is cut while it spans more virtual pixels than this.
constexpr double kMostPixelsOutside = 1024;
constexpr int kMostCuts = 40;
/// Pieces a block: with their table and eight voxels each they fit into a level-2 cache.
constexpr std::size_t kBlockPieces = 4096;

/// (cos, sin) of 2πu by + − × only: std::sin may differ between instruction sets in the last bit.
[[nodiscard]] Vec2 unit_circle(double u) {
    const double quarter = std::floor(4 * u + 0.5);
    const double x = (4 * u - quarter) * 1.57079632679489661923;  // [−π/4, π/4]
    const double x2 = x * x;
    // Taylor to x^15 and x^14: below 2^-53 on this interval.
    double s = -1.0 / 1307674368000.0;
    for (const double c : {1.0 / 6227020800.0, -1.0 / 39916800.0, 1.0 / 362880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0})
        s = s * x2 + c;
    s *= x;
    double c = -1.0 / 87178291200.0;
    for (const double k : {1.0 / 479001600.0, -1.0 / 3628800.0, 1.0 / 40320.0, -1.0 / 720.0, 1.0 / 24.0, -0.5, 1.0})
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

LineSampler::LineSampler(const Object& object, const Camera& camera, std::uint32_t object_id)
    : object_(&object), camera_(&camera), object_id_(object_id) {
    std::vector<double> weights;
    const std::size_t patches = object.geometry->patch_count();
    for (std::size_t patch = 0; patch < patches; ++patch)
        add_pieces(static_cast<std::uint32_t>(patch), object.geometry->body(patch), 0, weights);
    for (const double w : weights) virtual_pixels_ += w;
    if (virtual_pixels_ > 0) build_blocks(weights);
}

/// Adds one body, whole or in parts, whichever needs fewer trials; returns its virtual pixels.
double LineSampler::add_pieces(std::uint32_t patch, const Body& body, int depth, std::vector<double>& weights) {
    std::array<Vec3, 8> corners;
    const int count = body.vertices(corners);
    const auto area = camera_->pixel_area_range(corners.data(), count);
    if (!area) return 0;
    if (!body.flat() && object_->geometry->excludes(patch, body)) return 0;
    const std::optional<double> own = depth == 0 ? object_->geometry->throw_area(patch) : std::nullopt;
    const double whole = own.value_or(object_->geometry->max_crossings() * body.crofton_area()) / area->least;
    if (!(whole > 0)) return 0;  // a body without extent

    const bool cut_by_view = whole > kMostPixelsOutside && !camera_->wholly_in_view(corners.data(), count);
    if (depth < kMostCuts && (cut_by_view || (area->most > kMostAreaRatio * area->least && whole > 1))) {
        const std::size_t pieces_before = pieces_.size();
        const std::size_t parts_before = parts_.size();
        std::array<Body, 8> parts;
        const int part_count = cut(body, parts);
        double sum = 0;
        for (int i = 0; i < part_count; ++i)
            sum += add_pieces(patch, parts[static_cast<std::size_t>(i)], depth + 1, weights);
        if (sum < whole) return sum;
        pieces_.resize(pieces_before);
        weights.resize(pieces_before);
        parts_.resize(parts_before);
    }
    std::int32_t part = -1;  // the patch's own body
    if (depth > 0) {
        part = static_cast<std::int32_t>(parts_.size());
        parts_.push_back(body);
    }
    pieces_.push_back({patch, part, area->least});
    weights.push_back(whole);
    return whole;
}

void LineSampler::build_blocks(std::span<const double> weights) {
    std::vector<double> sums;
    for (std::size_t first = 0; first < weights.size(); first += kBlockPieces) {
        const auto block = weights.subspan(first, std::min(kBlockPieces, weights.size() - first));
        double sum = 0;
        for (const double w : block) sum += w;
        sums.push_back(sum);
        blocks_.push_back({first, sum, AliasTable(block)});
    }
    block_table_ = AliasTable(sums);
}

struct LineSampler::Bits {
    Bits(Seed seed, std::uint32_t object, std::uint32_t repeat, std::uint64_t index)
        : first(random_bits(seed, {.object = object, .repeat = repeat, .index = index, .block = 0})),
          second(random_bits(seed, {.object = object, .repeat = repeat, .index = index, .block = 1})) {}

    /// Which piece: 53 bits.
    [[nodiscard]] double pick() const {
        return static_cast<double>(((static_cast<std::uint64_t>(second[0]) << 32U) | second[1]) >> 11U) * 0x1p-53;
    }
    std::array<std::uint32_t, 4> first, second;
};

const LineSampler::Piece& LineSampler::pick_piece(const Bits& bits) const {
    const AliasTable::Pick block = block_table_.pick(bits.pick());
    return pieces_[blocks_[block.index].first_piece + blocks_[block.index].pieces.pick(block.rest).index];
}

int LineSampler::shoot(const Piece& piece, const std::array<std::uint32_t, 4>& bits, std::uint32_t more_bits,
                       std::span<Crossing, kMaxCrossings> hits, Vec3& origin, Vec3& direction) const {
    const Body body = piece.part < 0 ? object_->geometry->body(piece.patch)
                                     : parts_[static_cast<std::size_t>(piece.part)];
    double u = unit_interval(bits[0]);
    double v = unit_interval(bits[1]);
    if (body.flat()) {
        if (body.kind == Body::Kind::triangle && u + v > 1) {
            u = 1 - u;
            v = 1 - v;
        }
        origin = body.corner + u * body.edge[0] + v * body.edge[1];
        hits[0] = {0, cross(body.edge[0], body.edge[1])};
        return 1;
    }

    // A uniform point on the body's surface, which comes in three pairs of faces…
    const double areas[3] = {length(cross(body.edge[1], body.edge[2])), length(cross(body.edge[2], body.edge[0])),
                             length(cross(body.edge[0], body.edge[1]))};
    double pick = unit_interval(more_bits) * 2 * (areas[0] + areas[1] + areas[2]);
    int face = 0;
    while (face < 5 && pick >= areas[face >> 1]) pick -= areas[face++ >> 1];
    const int axis = face >> 1;
    const Vec3& a = body.edge[(axis + 1) % 3];
    const Vec3& b = body.edge[(axis + 2) % 3];
    origin = body.corner + u * a + v * b;
    Vec3 inward = normalize(cross(a, b));
    if (dot(inward, body.edge[axis]) < 0) inward = -inward;
    if ((face & 1) != 0) {
        origin += body.edge[axis];
        inward = -inward;
    }
    // … and a direction by the cosine law: together a uniform random line through the body.
    const double disc = unit_interval(bits[2]);
    const Vec2 turn = std::sqrt(disc) * unit_circle(unit_interval(bits[3]));
    const Vec3 side = normalize(a);
    direction = turn.x * side + turn.y * cross(inward, side) + std::sqrt(1 - disc) * inward;

    const double t_hi = exit_distance(body, origin, direction);
    // A hair beyond both ends: a surface may lie in a face of the body, where rounding would lose it.
    const double hair = 1e-12 * t_hi;
    return object_->geometry->crossings(piece.patch, {origin, direction, -hair, t_hi + hair}, hits);
}

std::optional<LineSampler::Point> LineSampler::keep(const Piece& piece, const SurfacePoint& at, double chance) const {
    const auto& [world, normal] = at;
    const Vec3 view = camera_->to_view(world);
    if (!(view.z >= camera_->near() && view.z <= camera_->far())) return std::nullopt;
    const double area = camera_->pixel_area(view);
    if (chance * area >= piece.least_area) return std::nullopt;
    if (object_->surface.opacity_law == OpacityLaw::constant) {
        const Vec3 ray = camera_->ray_direction(world);
        const double cosine = std::abs(dot(normal, ray)) / (length(normal) * length(ray));
        if (chance * area >= piece.least_area * cosine) return std::nullopt;
    }
    const Vec2 pixel = camera_->project(view);
    if (!(pixel.x >= 0 && pixel.x < camera_->width() && pixel.y >= 0 && pixel.y < camera_->height()))
        return std::nullopt;
    if (!object_->keeps(world)) return std::nullopt;
    return Point{view, camera_->view_vector(object_->geometry->shading_normal(piece.patch, world, normal))};
}

std::optional<LineSampler::Point> LineSampler::trial_on(const Piece& piece, const Bits& bits) const {
    const auto& [first, second] = bits;
    const double chance = unit_interval(second[3]);
    if (throws_itself(piece)) {
        const auto point = object_->geometry->throw_point(piece.patch, {unit_interval(first[0]), unit_interval(first[1]),
                                                                        unit_interval(first[2]), unit_interval(first[3])});
        return point ? keep(piece, *point, chance) : std::nullopt;
    }
    std::array<Crossing, kMaxCrossings> hits;
    Vec3 origin, direction(0.0);
    // One word serves two choices: its high part the crossing, what is left of it the face.
    const auto choices = static_cast<std::uint64_t>(second[2]) * static_cast<std::uint64_t>(max_crossings());
    const int found = shoot(piece, first, static_cast<std::uint32_t>(choices), hits, origin, direction);
    const auto j = static_cast<int>(choices >> 32U);
    if (j >= found) return std::nullopt;
    const Crossing& hit = hits[static_cast<std::size_t>(j)];
    return keep(piece, {origin + hit.t * direction, hit.normal}, chance);
}

std::optional<LineSampler::Point> LineSampler::trial(Seed seed, std::uint32_t repeat, std::uint64_t index) const {
    const Bits bits(seed, object_id_, repeat, index);
    return trial_on(pick_piece(bits), bits);
}

std::optional<LineSampler::Point> LineSampler::trial_in_block(std::size_t block, Seed seed, std::uint32_t repeat,
                                                              std::uint32_t index) const {
    const Bits bits(seed, object_id_, repeat, (static_cast<std::uint64_t>(block) << 32U) | index);
    const Block& b = blocks_[block];
    return trial_on(pieces_[b.first_piece + b.pieces.pick(bits.pick()).index], bits);
}

int LineSampler::trial_keeping_all(Seed seed, std::uint32_t repeat, std::uint64_t index,
                                   std::span<Point, kMaxCrossings> out) const {
    const Bits bits(seed, object_id_, repeat, index);
    const auto third = random_bits(seed, {.object = object_id_, .repeat = repeat, .index = index, .block = 2});
    const Piece& piece = pick_piece(bits);
    assert(!throws_itself(piece));
    std::array<Crossing, kMaxCrossings> hits;
    Vec3 origin, direction(0.0);
    const int found = shoot(piece, bits.first, bits.second[2], hits, origin, direction);
    int kept = 0;
    for (int i = 0; i < found; ++i) {
        const Crossing& hit = hits[static_cast<std::size_t>(i)];
        const auto point = keep(piece, {origin + hit.t * direction, hit.normal},
                                unit_interval(third[static_cast<std::size_t>(i)]));
        if (point) out[static_cast<std::size_t>(kept++)] = *point;
    }
    return kept;
}

std::size_t LineSampler::bytes() const {
    std::size_t sum = pieces_.capacity() * sizeof(Piece) + parts_.capacity() * sizeof(Body) +
                      blocks_.capacity() * sizeof(Block) + block_table_.bytes();
    for (const Block& block : blocks_) sum += block.pieces.bytes();
    return sum;
}

}  // namespace pellucid
