#include "field/mpu.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace pellucid {
namespace {

/// A node that is no leaf has the number of its first child.
constexpr std::uint32_t kLeaf = 1U << 31U;
/// The cube is larger than the points by so much, so that the surface does not end at a face that points touch.
constexpr double kRoom = 0.05;
/// Coarse fits are tried on so many points first: where these miss by kSurelyBad times what is allowed, the cell is cut.
constexpr std::size_t kTryPoints = 160;
constexpr double kSurelyBad = 1.5;
/// Edges and corners are looked for among so few points: the paper's 2·15.
constexpr std::size_t kFewPoints = 30;
/// Radius of a leaf's ball, in edges.
const double kSupport = std::sqrt(kMpuSupport2);
/// An enlarged ball is so much larger than the distance of its last point, which else had no weight.
constexpr double kBeyondLast = 1.1;
const double kPerEdge = std::sqrt(kMpuPerEdge2);
/// Neighbours whose normals contradict each other: as many of so many are warned of.
constexpr std::size_t kProbedPoints = 20'000;
constexpr double kContradictions = 0.01;
/// So many neighbours tell how the surface lies. To a normal across it they have a square of the cosine near 0, to one in it
/// 1/2 on the mean; noise in all directions 1/3.
constexpr std::size_t kAcrossPoints = 8;
constexpr double kMostAlong = 0.4;
/// Of the points in every coordinate, left out at both ends before the width of the others is taken; and how many widths
/// farther a point may be. A handle with fewer points would have to be as long as that to be taken for outliers.
constexpr double kQuantile = 0.025;
constexpr double kFarOut = 2;
/// Points nearer to a line, of their distance from the middle (root mean squares), are on it.
constexpr double kOnALine = 1e-6;
/// Rounding of places and values in the unit cube, with room.
constexpr double kSlack = 1e-13;
constexpr double kGradientSlack = 1e-9;
/// Σw is nowhere less: at its own corners a leaf's weight is 1/8.
constexpr double kLeastWeight = 0.1249;
/// A box that so many leaves reach is not looked into.
constexpr std::size_t kManyLeaves = 4096;

[[nodiscard]] Vec3 vector(const std::array<float, 3>& v) { return {v[0], v[1], v[2]}; }

[[nodiscard]] Quadric quadric(const std::array<float, 10>& q) {
    Quadric out;
    std::ranges::copy(q, out.c.begin());
    return out;
}

/// Points of one place become one, with the mean of their normals.
[[nodiscard]] std::vector<OrientedPoint> without_duplicates(std::vector<OrientedPoint> points) {
    const auto key = [](const OrientedPoint& p) {
        return std::tuple(p.position.x, p.position.y, p.position.z, p.normal[0], p.normal[1], p.normal[2]);
    };
    std::ranges::sort(points, {}, key);
    std::size_t kept = 0;
    std::size_t merged = 0;
    std::size_t opposed = 0;
    for (std::size_t i = 0; i < points.size();) {
        std::size_t end = i;
        Vec3 normal(0.0);
        for (; end < points.size() && points[end].position == points[i].position; ++end)
            normal += vector(points[end].normal);
        merged += end - i - 1;
        OrientedPoint one = points[i];
        const double size = length(normal);
        if (end > i + 1 && size > 0)
            for (std::size_t k = 0; k < 3; ++k) one.normal[k] = static_cast<float>(normal[static_cast<int>(k)] / size);
        i = end;
        if (size > 1e-6)
            points[kept++] = one;
        else
            ++opposed;
    }
    points.resize(kept);
    if (merged > 0) warn("points: {} stand where another one does and are merged with it", merged);
    if (opposed > 0) warn("points: {} places have normals that cancel and are left out", opposed);
    return points;
}

[[nodiscard]] Box cube_around(const std::vector<OrientedPoint>& points) {
    Box box;
    for (const OrientedPoint& p : points) box.include(p.position);
    const Vec3 size = box.size();
    const Vec3 half((0.5 + kRoom) * std::max({size.x, size.y, size.z}));
    return {box.center() - half, box.center() + half};
}

[[nodiscard]] std::vector<OrientedPoint> in_unit_cube(std::vector<OrientedPoint> points, const Box& cube) {
    const double size = cube.hi.x - cube.lo.x;
    for (OrientedPoint& p : points) p.position = (p.position - cube.lo) / size;
    return points;
}

/// Where the points are, but for outliers.
struct Extent {
    Box box;
    std::size_t outside = 0;
    bool is_line = false;

    explicit Extent(std::span<const OrientedPoint> points) {
        Box core;
        double width = 0;
        std::vector<double> values(points.size());
        const auto skipped = static_cast<std::ptrdiff_t>(kQuantile * static_cast<double>(points.size()));
        for (int axis = 0; axis < 3; ++axis) {
            std::ranges::transform(points, values.begin(), [&](const OrientedPoint& p) { return p.position[axis]; });
            const auto quantile = [&](std::ptrdiff_t k) {
                std::nth_element(values.begin(), values.begin() + k, values.end());
                return values[static_cast<std::size_t>(k)];
            };
            core.lo[axis] = quantile(skipped);
            core.hi[axis] = quantile(static_cast<std::ptrdiff_t>(points.size()) - 1 - skipped);
            width = std::max(width, core.hi[axis] - core.lo[axis]);
        }
        const Box wide{core.lo - Vec3(kFarOut * width), core.hi + Vec3(kFarOut * width)};
        std::vector<Vec3> inner;
        for (const OrientedPoint& p : points) {
            if (width > 0 && !(glm::all(glm::greaterThanEqual(p.position, wide.lo)) &&
                               glm::all(glm::lessThanEqual(p.position, wide.hi)))) {
                ++outside;
                continue;
            }
            box.include(p.position);
            inner.push_back(p.position);
        }
        is_line = lie_along_a_line(inner);
    }

private:
    [[nodiscard]] static bool lie_along_a_line(const std::vector<Vec3>& points) {
        Vec3 middle(0.0);
        for (const Vec3& p : points) middle += p / static_cast<double>(points.size());
        Mat3 moments(0.0);
        for (const Vec3& p : points)
            for (int k = 0; k < 3; ++k) moments[k] += (p - middle)[k] * (p - middle);
        // The direction of most of them, by powers; from the column that is longest.
        Vec3 along = moments[0];
        for (int k = 1; k < 3; ++k)
            if (length(moments[k]) > length(along)) along = moments[k];
        for (int i = 0; i < 20 && length(along) > 0; ++i) along = normalize(moments * normalize(along));
        double off = 0;
        double far = 0;
        for (const Vec3& p : points) {
            const Vec3 x = p - middle;
            const Vec3 across = x - dot(x, along) * along;
            off += dot(across, across);
            far += dot(x, x);
        }
        return off <= kOnALine * kOnALine * far;
    }
};

[[nodiscard]] std::vector<OrientedPoint> enough(std::vector<OrientedPoint> points) {
    points = without_duplicates(std::move(points));
    if (points.size() < kMpuLeastPoints)
        throw input_error("{} different points, expected at least {}", points.size(), kMpuLeastPoints);
    return points;
}

}  // namespace

struct MpuField::Builder {
    struct Node {
        std::array<std::uint32_t, 3> base{};  // of 2^depth
        std::uint32_t parent = 0;             // in the level above
    };
    struct Result {
        LocalFit fit;
        bool cut = false;
    };

    const PointTree& tree;
    const MpuOptions& options;
    double accuracy;  // in the unit cube

    [[nodiscard]] static Vec3 center_of(const Node& node, double edge) {
        return edge * (Vec3(node.base[0], node.base[1], node.base[2]) + 0.5);
    }

    /// The fit of one cell.
    [[nodiscard]] Result look(const Node& node, int depth, const LocalFit* parent) const {
        const double edge = std::ldexp(1.0, -depth);
        const Vec3 center = center_of(node, edge);
        thread_local std::vector<std::uint32_t> found;
        thread_local std::vector<LocalPoint> points;
        tree.within(center, kSupport * edge, found);
        const std::size_t own = found.size();
        if (own == 0 && parent != nullptr) return {seen_from_child(*parent, node), false};

        double radius = kSupport;
        if (own < options.least_points) {
            tree.nearest(center, options.least_points, found);
            radius = kBeyondLast * length(tree.points()[found.back()].position - center) / edge;
            radius = std::max(radius, kSupport);
        }
        const auto take = [&](std::size_t step) {
            points.clear();
            for (std::size_t i = 0; i < found.size(); i += step) {
                const OrientedPoint& p = tree.points()[found[i]];
                points.push_back({(p.position - center) / edge, vector(p.normal)});
            }
        };
        LocalFitOptions how{.radius = radius,
                            .own_radius = kSupport,
                            .few = kFewPoints,
                            .sharp = options.sharp,
                            .good_enough = accuracy / edge};
        const bool may_cut = own >= options.least_points && depth < options.most_depth;
        if (may_cut && found.size() > 2 * kTryPoints) {
            take(found.size() / kTryPoints);
            Result first{fit_locally(points, how), true};
            if (first.fit.error * edge > kSurelyBad * accuracy) return first;
        }
        take(1);
        Result result{fit_locally(points, how), false};
        result.cut = may_cut && result.fit.error * edge > accuracy;
        return result;
    }

    /// A cell without points has its parent's fit.
    [[nodiscard]] static LocalFit seen_from_child(const LocalFit& parent, const Node& node) {
        LocalFit fit = parent;
        Vec3 offset;
        for (std::size_t k = 0; k < 3; ++k) offset[static_cast<int>(k)] = (node.base[k] & 1U) != 0 ? 0.25 : -0.25;
        for (Quadric& q : fit.pieces) {
            q = q.seen_from(offset, 0.5);
            for (double& c : q.c) c *= 2;  // Q = edge·q, and the edge is half as long
        }
        return fit;
    }

    /// Level by level; leaves come in the order of levels.
    void build(MpuField& field) const {
        std::vector<std::uint32_t>& nodes = field.nodes_;
        std::vector<MpuLeaf>& leaves = field.leaves_;
        std::vector<Node> level(1);
        std::vector<Result> above;
        nodes.assign(1, 0);
        std::size_t first_node = 0;
        for (int depth = 0; !level.empty(); ++depth) {
            std::vector<Result> results(level.size());
            parallel_for(level.size(), 32, [&](std::size_t begin, std::size_t end) {
                for (std::size_t i = begin; i < end; ++i)
                    results[i] = look(level[i], depth, depth > 0 ? &above[level[i].parent].fit : nullptr);
            });
            std::vector<Node> next;
            const std::size_t next_first = first_node + level.size();
            for (std::size_t i = 0; i < level.size(); ++i) {
                if (!results[i].cut) {
                    nodes[first_node + i] = kLeaf | static_cast<std::uint32_t>(leaves.size());
                    leaves.push_back(leaf(level[i], depth, results[i].fit, field.rest_));
                    continue;
                }
                nodes[first_node + i] = static_cast<std::uint32_t>(next_first + next.size());
                for (std::uint32_t corner = 0; corner < 8; ++corner) {
                    Node child{.base = {}, .parent = static_cast<std::uint32_t>(i)};
                    for (std::size_t k = 0; k < 3; ++k) child.base[k] = 2 * level[i].base[k] + (corner >> k & 1U);
                    next.push_back(child);
                }
            }
            if (next_first + next.size() >= kLeaf) throw run_error("the octree of the points has too many cells");
            nodes.resize(next_first + next.size());
            first_node = next_first;
            above = std::move(results);
            level = std::move(next);
        }
        sort_leaves(field);
        nodes.shrink_to_fit();
        field.rest_.shrink_to_fit();
    }

    [[nodiscard]] static MpuLeaf leaf(const Node& node, int depth, const LocalFit& fit,
                                      std::vector<std::array<float, 10>>& rest) {
        const double edge = std::ldexp(1.0, -depth);
        const Vec3 center = center_of(node, edge);
        const auto floats = [](const Quadric& q) {
            std::array<float, 10> out;
            std::ranges::transform(q.c, out.begin(), [](double c) { return static_cast<float>(c); });
            return out;
        };
        MpuLeaf leaf;
        for (std::size_t k = 0; k < 3; ++k) leaf.center[k] = static_cast<float>(center[static_cast<int>(k)]);
        leaf.edge = static_cast<float>(edge);
        leaf.q = floats(fit.pieces[0]);
        leaf.join = fit.join;
        leaf.rest = static_cast<std::uint32_t>(rest.size());
        for (std::size_t k = 1; k < piece_count(fit.join); ++k) rest.push_back(floats(fit.pieces[k]));
        return leaf;
    }

    /// Neighbours in space become neighbours in memory.
    static void sort_leaves(MpuField& field) {
        std::vector<MpuLeaf> sorted;
        sorted.reserve(field.leaves_.size());
        const auto walk = [&](const auto& self, std::size_t node) -> void {
            std::uint32_t& n = field.nodes_[node];
            if ((n & kLeaf) == 0) {
                for (std::size_t child = 0; child < 8; ++child) self(self, n + child);
                return;
            }
            sorted.push_back(field.leaves_[n & ~kLeaf]);
            n = kLeaf | static_cast<std::uint32_t>(sorted.size() - 1);
        };
        walk(walk, 0);
        field.leaves_ = std::move(sorted);
    }
};

MpuField::MpuField(std::vector<OrientedPoint> points, const MpuOptions& options)
    : tree_([&] {
          points = enough(std::move(points));
          bounds_ = cube_around(points);
          size_ = bounds_.hi.x - bounds_.lo.x;
          return PointTree(in_unit_cube(std::move(points), bounds_));
      }()) {
    const auto all = tree_.points();
    const Extent extent(all);
    if (extent.outside > 0)
        warn("points: {} of {} lie farther than {} widths from the others, by which alone the fit's accuracy is measured",
             extent.outside, all.size(), kFarOut);
    if (extent.is_line)
        throw input_error("the points lie along a line, expected points of a surface");

    // Neighbours: how far they are, whether they agree, and whether they lie across the normals.
    const std::size_t step = all.size() / kProbedPoints + 1;
    std::vector<double> distances;
    std::vector<std::uint32_t> near;
    std::size_t contradict = 0;
    double along = 0;
    for (std::size_t i = 0; i < all.size(); i += step) {
        tree_.nearest(all[i].position, kAcrossPoints + 1, near);
        const Vec3 normal = vector(all[i].normal);
        double squares = 0;
        bool first = true;
        for (const std::uint32_t k : near) {
            if (k == i) continue;
            const Vec3 off = all[k].position - all[i].position;
            if (std::exchange(first, false)) {
                distances.push_back(length(off));
                contradict += dot(vector(all[k].normal), normal) < -0.5 ? 1U : 0U;
            }
            squares += dot(off, normal) * dot(off, normal) / dot(off, off);
        }
        along += squares / kAcrossPoints;
    }
    if (along > kMostAlong * static_cast<double>(distances.size()))
        throw input_error("the normals lie in the surface that the points make (mean square of their cosine with the way to a "
                          "neighbour {:.2f}), expected across it",
                          along / static_cast<double>(distances.size()));
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    spacing_ = *middle;
    if (static_cast<double>(contradict) > kContradictions * static_cast<double>(distances.size()))
        warn("points: of {} looked at, {} have a normal against that of their nearest neighbour; the surface is not to be "
             "trusted there",
             distances.size(), contradict);

    Builder{tree_, options, options.accuracy * length(extent.box.size())}.build(*this);
}

/// Calls visit(leaf) for the leaves whose balls meet a box, ascending.
template <class Visit>
void MpuField::visit(const Box& box, const Visit& visit) const {
    const auto walk = [&](const auto& self, std::uint32_t node, const Vec3& center, double edge) -> void {
        const Vec3 off = glm::max(glm::max(box.lo - center, center - box.hi), Vec3(0.0));
        const std::uint32_t n = nodes_[node];
        if ((n & kLeaf) != 0) {
            if (dot(off, off) < kMpuSupport2 * edge * edge) visit(n & ~kLeaf);
            return;
        }
        // Balls of leaves below reach out of the cell by 0.8 of half its edge.
        const double reach = 0.901 * edge;
        if (off.x > reach || off.y > reach || off.z > reach) return;
        for (std::uint32_t corner = 0; corner < 8; ++corner) {
            const Vec3 side((corner & 1U) != 0 ? 0.25 : -0.25, (corner & 2U) != 0 ? 0.25 : -0.25,
                            (corner & 4U) != 0 ? 0.25 : -0.25);
            self(self, n + corner, center + edge * side, 0.5 * edge);
        }
    };
    walk(walk, 0, Vec3(0.5), 1);
}

void MpuField::leaves_at(const Box& box, std::vector<std::uint32_t>& out) const {
    out.clear();
    visit(box, [&](std::uint32_t leaf) { out.push_back(leaf); });
}

double MpuField::value(const Vec3& place) const {
    const Vec3 x = to_unit(place);
    double sum = 0;
    double weights = 0;
    visit({x, x}, [&](std::uint32_t number) {
        const MpuLeaf& leaf = leaves_[number];
        const double edge = leaf.edge;
        const Vec3 u = (x - vector(leaf.center)) / edge;
        const MpuWeight w(dot(u, u));
        std::array<double, 3> q{};
        for (std::size_t k = 0; k < piece_count(leaf.join); ++k) q[k] = quadric(piece(leaf, k)).value(u);
        weights += w.value;
        sum += w.value * (edge * q[deciding_piece(leaf.join, q)]);
    });
    return size_ * (sum / weights);
}

FieldJet MpuField::jet(const Vec3& place) const {
    struct Part {
        double weight, value, edge;
        Vec3 weight_gradient, gradient;
        std::array<double, 6> weight_hessian, hessian;
    };
    thread_local std::vector<Part> parts;
    parts.clear();
    const Vec3 x = to_unit(place);
    double weights = 0;
    double sum = 0;
    visit({x, x}, [&](std::uint32_t number) {
        const MpuLeaf& leaf = leaves_[number];
        const double edge = leaf.edge;
        const Vec3 u = (x - vector(leaf.center)) / edge;
        const double u2 = dot(u, u);
        const MpuWeight w(u2);
        std::array<double, 3> q{};
        for (std::size_t k = 0; k < piece_count(leaf.join); ++k) q[k] = quadric(piece(leaf, k)).value(u);
        const std::size_t decides = deciding_piece(leaf.join, q);
        const Quadric own = quadric(piece(leaf, decides));
        Part part{w.value, edge * q[decides], edge, -(w.slope / edge) * u, own.gradient(u), {}, {}};
        // ∇w = −slope(r)·u, slope' = −1.5·kPerEdge/r² beyond the knot
        const double bend = u2 * kMpuPerEdge2 < 0.25 ? 0 : 1.5 * kPerEdge / (u2 * std::sqrt(u2));
        const double per = 1 / (edge * edge);
        part.weight_hessian = {per * (bend * u.x * u.x - w.slope), per * (bend * u.y * u.y - w.slope),
                               per * (bend * u.z * u.z - w.slope), per * bend * u.x * u.y,
                               per * bend * u.x * u.z,             per * bend * u.y * u.z};
        part.hessian = {2 * own.c[4] / edge, 2 * own.c[5] / edge, 2 * own.c[6] / edge,
                        own.c[7] / edge,     own.c[8] / edge,     own.c[9] / edge};
        weights += part.weight;
        sum += part.weight * part.value;
        parts.push_back(part);
    });
    // Q_i − f instead of Q_i: Σ∇w_i f = f·∇Σw_i cancels.
    const double f = sum / weights;
    Vec3 gradient(0.0);
    Vec3 weights_gradient(0.0);
    for (const Part& p : parts) {
        gradient += p.weight * p.gradient + (p.value - f) * p.weight_gradient;
        weights_gradient += p.weight_gradient;
    }
    gradient /= weights;
    constexpr int kPlace[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
    FieldJet jet{size_ * f, gradient, {}};
    for (std::size_t k = 0; k < 6; ++k) {
        const auto [i, j] = kPlace[k];
        double h = -(gradient[i] * weights_gradient[j] + weights_gradient[i] * gradient[j]);
        for (const Part& p : parts)
            h += p.weight * p.hessian[k] + p.weight_gradient[i] * p.gradient[j] + p.gradient[i] * p.weight_gradient[j] +
                 (p.value - f) * p.weight_hessian[k];
        jet.hessian[k] = h / (weights * size_);
    }
    return jet;
}

bool MpuField::excludes(const Box& box) const {
    thread_local std::vector<std::uint32_t> list;
    const Box unit{to_unit(box.lo), to_unit(box.hi)};
    leaves_at(unit, list);
    if (list.empty()) return true;  // f has no value there
    if (list.size() > kManyLeaves) return false;
    return !range(list, unit).value.has_zero();
}

/// With φ_i = w_i/Σw, P = Σ φ_i(c) Q_i, a quadric, and D_i = Q_i − P, of which Σ φ_i(c) D_i = 0:
///   f  = P + Σ (φ_i − φ_i(c)) D_i = P + E
///   ∇f = ∇P + Σ (φ_i − φ_i(c)) ∇D_i + Σ ∇φ_i D_i, and Σ ∇φ_i D_i = Σ (∇w_i/Σw)(D_i − E), which is
/// known in the middle.
/// In small boxes φ_i − φ_i(c) is small, and D_i where the fits agree.
MpuRange MpuField::range(std::span<const std::uint32_t> list, const Box& box) const {
    // In half-widths of the box each coordinate is in [−1, 1].
    using Coefficients = std::array<double, 10>;
    struct Reach {
        double value;
        std::array<double, 3> slope;
    };
    const auto reach_of = [](const Coefficients& c) {
        const auto a = [&](std::size_t i) { return std::abs(c[i]); };
        const std::array<double, 3> bend{2 * a(4) + a(7) + a(8), 2 * a(5) + a(7) + a(9), 2 * a(6) + a(8) + a(9)};
        return Reach{a(0) + a(1) + a(2) + a(3) + a(4) + a(5) + a(6) + a(7) + a(8) + a(9),
                     {a(1) + bend[0], a(2) + bend[1], a(3) + bend[2]}};
    };
    struct Part {
        Coefficients q;
        double most, least, here;  // weights
        std::array<double, 3> push, push_here, push_varies;  // ∂w along each axis: largest |∂w|, in the middle, off it
        double reach;  // of what differs from the mean
        Reach other;  // how far the other pieces of the leaf may be from this one
    };
    thread_local std::vector<Part> parts;
    parts.clear();
    const Vec3 center = box.center();
    const Vec3 half = 0.5 * box.size();
    Coefficients mean{};
    double weight_here = 0;
    double least_weight = 0;
    double most_weight = 0;
    for (const std::uint32_t number : list) {
        const MpuLeaf& leaf = leaves_[number];
        const double edge = leaf.edge;
        const double per = 1 / edge;  // exact: edges are powers of two
        const Vec3 u = (center - vector(leaf.center)) * per;
        const Vec3 h = half * per;
        const Vec3 near = glm::max(glm::abs(u) - h, Vec3(0.0));
        const MpuWeight most(dot(near, near));
        if (!(most.value > 0)) continue;
        const Vec3 far = glm::abs(u) + h;
        const MpuWeight least(dot(far, far));
        const MpuWeight here(dot(u, u));
        Part part{{}, most.value, least.value, here.value, {}, {}, {}, 0, {0, {0, 0, 0}}};
        for (std::size_t a = 0; a < 3; ++a) {
            const auto axis = static_cast<int>(a);
            // ∂w = −slope·u_a/edge, the slope falls with the distance.
            const auto product = [&](double at) {
                const double x = most.slope * at;
                const double y = least.slope * at;
                return Interval(std::min(x, y), std::max(x, y));
            };
            const Interval both = hull(product(u[axis] - h[axis]), product(u[axis] + h[axis]));
            const double middle = here.slope * u[axis];
            part.push[a] = both.reach() * per;
            part.push_here[a] = -middle * per;
            part.push_varies[a] = std::max(both.hi - middle, middle - both.lo) * per;
        }
        const auto in_half_widths = [&](const Quadric& q) {
            const Vec3 g = q.gradient(u);
            const auto& c = q.c;
            return Coefficients{edge * q.value(u),       edge * h.x * g.x,        edge * h.y * g.y,
                                edge * h.z * g.z,        edge * h.x * h.x * c[4], edge * h.y * h.y * c[5],
                                edge * h.z * h.z * c[6], edge * h.x * h.y * c[7], edge * h.x * h.z * c[8],
                                edge * h.y * h.z * c[9]};
        };
        part.q = in_half_widths(quadric(leaf.q));
        if (leaf.join != Join::one) {
            std::array<Coefficients, 3> pieces{part.q};
            std::array<double, 3> value{part.q[0]};
            for (std::size_t k = 1; k < piece_count(leaf.join); ++k) {
                pieces[k] = in_half_widths(quadric(piece(leaf, k)));
                value[k] = pieces[k][0];
            }
            const std::size_t decides = deciding_piece(leaf.join, value);
            part.q = pieces[decides];
            const bool larger = leaf.join == Join::max2 || leaf.join == Join::max3;
            const bool smaller = leaf.join == Join::min2 || leaf.join == Join::min3;
            for (std::size_t k = 0; k < piece_count(leaf.join); ++k) {
                if (k == decides) continue;
                Coefficients off;
                for (std::size_t i = 0; i < 10; ++i) off[i] = pieces[k][i] - part.q[i];
                const Reach reach = reach_of(off);
                const double varies = reach.value - std::abs(off[0]);
                // A piece that is surely on the wrong side of another never decides.
                if ((larger && off[0] + varies < 0) || (smaller && off[0] - varies > 0)) continue;
                part.other.value = std::max(part.other.value, reach.value);
                for (std::size_t a = 0; a < 3; ++a) part.other.slope[a] = std::max(part.other.slope[a], reach.slope[a]);
            }
        }
        least_weight += part.least;
        most_weight += part.most;
        weight_here += part.here;
        for (std::size_t i = 0; i < 10; ++i) mean[i] += part.here * part.q[i];
        parts.push_back(part);
    }
    MpuRange range{Interval::everything(true),
                   {Interval::everything(true), Interval::everything(true), Interval::everything(true)}};
    if (!(weight_here > 0)) return range;
    for (double& c : mean) c /= weight_here;
    // Σw is at least what it is in the middle less what it can lose on the way; and, within the cube, a leaf's own at its
    // corners.
    double lost = 0;
    std::array<double, 3> pull{};  // largest |∂Σw|
    for (std::size_t a = 0; a < 3; ++a) {
        double middle = 0;
        double varies = 0;
        for (const Part& part : parts) {
            middle += part.push_here[a];
            varies += part.push_varies[a];
        }
        pull[a] = std::abs(middle) + varies;
        lost += half[static_cast<int>(a)] * pull[a];
    }
    least_weight = std::max(least_weight, weight_here - lost);
    most_weight = std::min(most_weight, weight_here + lost);
    if (box.lo.x >= 0 && box.lo.y >= 0 && box.lo.z >= 0 && box.hi.x <= 1 && box.hi.y <= 1 && box.hi.z <= 1)
        least_weight = std::max(least_weight, kLeastWeight);
    if (!(least_weight > 0)) return range;

    double off = 0;  // |E|
    std::array<double, 3> slope_off{};
    for (Part& part : parts) {
        for (std::size_t i = 0; i < 10; ++i) part.q[i] -= mean[i];
        const Reach reach = reach_of(part.q);
        part.reach = reach.value;
        const double share = part.here / weight_here;
        const double most = std::min(1.0, part.most / least_weight);
        double moved = 0;  // ∇φ = (∇w − φ ∇Σw)/Σw
        for (std::size_t a = 0; a < 3; ++a)
            moved += half[static_cast<int>(a)] * (part.push[a] + most * pull[a]) / least_weight;
        const double change = std::min(moved, std::max(most - share, share - part.least / most_weight));
        off += change * reach.value + most * part.other.value;
        for (std::size_t a = 0; a < 3; ++a) slope_off[a] += change * reach.slope[a] + most * part.other.slope[a];
    }
    const Reach reach = reach_of(mean);
    const double wide = reach.value - std::abs(mean[0]) + off + kSlack;
    range.value = Interval(mean[0] - wide, mean[0] + wide);
    if (!range.value.has_zero()) return range;
    for (std::size_t a = 0; a < 3; ++a) {
        const double h = half[static_cast<int>(a)];
        if (!(h > 0)) continue;
        double push = 0;
        double varies = 0;
        for (const Part& part : parts) {
            push += part.push_here[a] * part.q[0];
            varies += part.push_varies[a] * part.reach + std::abs(part.push_here[a]) * (part.reach - std::abs(part.q[0])) +
                      part.push[a] * (part.other.value + off);
        }
        const Interval drift = Interval(push - varies, push + varies) / Interval(least_weight, most_weight);
        const double slope = mean[1 + a] / h;
        const double more = (reach.slope[a] - std::abs(mean[1 + a]) + slope_off[a]) / h + kGradientSlack;
        range.gradient[a] = Interval(slope + drift.lo - more, slope + drift.hi + more);
    }
    // f(x) = f(c) + ∇f(ξ)·(x − c)
    double steps = kSlack;
    for (std::size_t a = 0; a < 3; ++a)
        if (const double h = half[static_cast<int>(a)]; h > 0) steps += h * range.gradient[a].reach();
    range.value = intersect(range.value, Interval(mean[0] - steps, mean[0] + steps));
    return range;
}

std::size_t MpuField::bytes() const {
    return tree_.bytes() + nodes_.capacity() * sizeof(nodes_[0]) + leaves_.capacity() * sizeof(MpuLeaf) +
           rest_.capacity() * sizeof(rest_[0]);
}

}  // namespace pellucid
