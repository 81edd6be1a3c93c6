#include "field/mpu_cells.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/parallel.hpp"
#include "field/mpu_gradients.hpp"
#include "field/mpu_lanes.hpp"
#include "field/mpu_lines.hpp"
#include "field/safeguarded_newton.hpp"

namespace pellucid {
namespace {

/// A cell is flat enough where |∇f|/|∂f/∂axis| is at most so many times what it is in the middle.
constexpr double kFlat = 1.5;
/// A leaf is cut so often for flatness, and so often for being monotone along any axis.
constexpr int kCutsForFlat = 1;
constexpr int kCutsForMonotone = 5;
/// A box is looked into again where its volume has become less than this share.
constexpr double kShrunkMuch = 0.6;
/// Boxes around the surface are larger than they need be by this share of their cell.
constexpr double kShrinkRoom = 1e-6;
/// Neighbours that tell the local spacing: π of them fill a disc of one spacing's radius.
constexpr std::size_t kNeighbours = 8;
constexpr double kNeighboursReach = 1.6;
/// An outlier's neighbours are far away; its spacing is believed up to so many of the median.
constexpr double kMostSpacing = 4;
/// Gradients are looked at in so many places, and may go beyond what was seen by this share of it and by so much.
constexpr int kPlacesSeen = 15;
constexpr double kRoomBeyondSeen = 0.3;
constexpr double kLeastRoom = 0.01;
/// Roots along an axis where ranges say nothing: parts of leaves, in which f is a few quadrics. What goes beyond is counted as
/// undecided by the sampler.
constexpr int kUnsureRoots = 3;
/// Pieces that a line may cost in one cell, and how often they are halved.
constexpr int kMostPieces = 512;
constexpr int kMostHalvings = 24;

/// Rounding of values in the unit cube, with room.
constexpr double kValueSlack = 1e-13;

[[nodiscard]] bool positive(double value) { return value >= 0; }

[[nodiscard]] float below(double x) { return std::nextafter(static_cast<float>(x), -INFINITY); }
[[nodiscard]] float above(double x) { return std::nextafter(static_cast<float>(x), INFINITY); }

}  // namespace

struct MpuCells::Builder {
    struct Kept {
        std::vector<MpuCell> cells;
        std::vector<std::uint32_t> lists;
    };
    struct Cube {
        std::array<std::uint32_t, 3> base;
        std::uint32_t extent;

        [[nodiscard]] Box box() const {
            const double edge = std::ldexp(static_cast<double>(extent), -kDepth);
            const Vec3 lo = std::ldexp(1.0, -kDepth) * Vec3(base[0], base[1], base[2]);
            return {lo, lo + edge};
        }
        [[nodiscard]] Cube part(unsigned corner) const {
            Cube out{base, extent / 2};
            for (std::size_t k = 0; k < 3; ++k)
                if ((corner >> k & 1U) != 0) out.base[k] += out.extent;
            return out;
        }
    };

    const MpuField& field;
    double reach = 0;  // of the leaf at hand
    [[nodiscard]] static double half_diagonal(const Box& box) { return 0.5 * length(box.size()); }

    using List = std::vector<std::uint32_t>;
    /// Those of a list whose balls meet a box, with room: lines end in faces but for rounding.
    [[nodiscard]] List reaching(const List& list, const Box& box) const {
        const Vec3 center = box.center();
        const Vec3 half = 0.5 * box.size();
        const Vec3 roomy = half + 1e-9 * half + 1e-15;
        List out;
        out.reserve(list.size());
        for (const std::uint32_t number : list) {
            const MpuLeaf& leaf = field.leaves()[number];
            const Vec3 off(leaf.center[0] - center.x, leaf.center[1] - center.y, leaf.center[2] - center.z);
            const Vec3 near = glm::max(glm::abs(off) - roomy, Vec3(0.0));
            const double edge = leaf.edge;
            if (dot(near, near) < kMpuSupport2 * edge * edge) out.push_back(number);
        }
        return out;
    }

    enum class Nearness { nowhere, far, part, near };
    /// Whether what the box has of the surface is near points; boxes are cut for it until they are half the reach. `known`:
    /// set to the box's range where that had to be found.
    [[nodiscard]] Nearness nearness(const List& list, const Box& box, std::optional<MpuRange>* known = nullptr) const {
        const double half = half_diagonal(box);
        const double d = field.tree().distance(box.center(), reach + half);
        if (d >= reach + half) return Nearness::far;
        if (d + half <= reach) return Nearness::near;
        const MpuRange range = field.range(list, box);
        if (known != nullptr) *known = range;
        if (!range.value.has_zero()) return Nearness::nowhere;
        if (half <= 0.5 * reach) return d <= reach ? Nearness::near : Nearness::far;
        bool near = false;
        bool far = false;
        for (unsigned corner = 0; corner < 8 && !(near && far); ++corner) {
            const Vec3 quarter = 0.25 * box.size();
            const Vec3 side((corner & 1U) != 0 ? 1 : -1, (corner & 2U) != 0 ? 1 : -1, (corner & 4U) != 0 ? 1 : -1);
            const Vec3 center = box.center() + side * quarter;
            const Box part{center - quarter, center + quarter};
            const Nearness there = nearness(reaching(list, part), part);
            near = near || there == Nearness::near || there == Nearness::part;
            far = far || there == Nearness::far || there == Nearness::part;
        }
        return near && far ? Nearness::part : near ? Nearness::near : far ? Nearness::far : Nearness::nowhere;
    }

    /// field.range at a place: f, with its slack.
    [[nodiscard]] Interval value_at(const List& list, const Vec3& place) const {
        double sum = 0;
        double weights = 0;
        for (const std::uint32_t number : list) {
            const MpuLeaf& leaf = field.leaves()[number];
            const double edge = leaf.edge;
            const Vec3 u = (place - Vec3(leaf.center[0], leaf.center[1], leaf.center[2])) / edge;
            const MpuWeight w(dot(u, u));
            if (!(w.value > 0)) continue;
            weights += w.value;
            std::array<double, 3> q{};
            for (std::size_t k = 0; k < piece_count(leaf.join); ++k) {
                Quadric quadric;
                std::ranges::copy(field.piece(leaf, k), quadric.c.begin());
                q[k] = edge * quadric.value(u);
            }
            sum += w.value * q[deciding_piece(leaf.join, q)];
        }
        if (!(weights > 0)) return Interval::everything(true);
        const double f = sum / weights;
        return {f - kValueSlack, f + kValueSlack};
    }

    /// The box of those x in `box` where f may be 0: f(c) + Σ g_j (x_j − c_j) solved for each x_i in turn. False if none.
    [[nodiscard]] bool shrink(const List& list, const MpuRange& range, Box& box) const {
        const Vec3 c = box.center();
        const Interval f = value_at(list, c);
        std::array<Interval, 3> off;
        for (std::size_t k = 0; k < 3; ++k) {
            const auto axis = static_cast<int>(k);
            off[k] = Interval(box.lo[axis] - c[axis], box.hi[axis] - c[axis]);
        }
        for (std::size_t i = 0; i < 3; ++i) {
            if (range.gradient[i].has_zero()) continue;
            Interval rest = f;
            for (std::size_t j = 0; j < 3; ++j)
                if (j != i) rest = rest + range.gradient[j] * off[j];
            off[i] = intersect(off[i], -(rest / range.gradient[i]));
            if (off[i].empty()) return false;
            const auto axis = static_cast<int>(i);
            const double room = kShrinkRoom * (box.hi[axis] - box.lo[axis]);
            box.lo[axis] = std::max(box.lo[axis], c[axis] + off[i].lo - room);
            box.hi[axis] = std::min(box.hi[axis], c[axis] + off[i].hi + room);
        }
        return true;
    }

    [[nodiscard]] static bool bounded(const MpuRange& range) {
        return std::ranges::all_of(range.gradient, [](const Interval& g) { return g.reach() < kInfinity; });
    }
    [[nodiscard]] static bool monotone(const MpuRange& range) {
        return std::ranges::any_of(range.gradient, [](const Interval& g) { return !g.has_zero(); });
    }
    [[nodiscard]] static bool flat(const MpuRange& range) {
        double reach2 = 0;
        double middle2 = 0;
        for (const Interval& g : range.gradient) {
            reach2 += g.reach() * g.reach();
            middle2 += 0.25 * (g.lo + g.hi) * (g.lo + g.hi);
        }
        return std::ranges::any_of(range.gradient, [&](const Interval& g) {
            if (g.has_zero()) return false;
            const double least = g.lo > 0 ? g.lo : -g.hi;
            return std::sqrt(reach2) * 0.5 * std::abs(g.lo + g.hi) <= kFlat * std::sqrt(middle2) * least;
        });
    }

    /// ∇f from places all over a box, with room, where the sure range says nothing: of noisy points the local fits differ
    /// by what absolute values add up and signs cancel. False beside edges and corners.
    [[nodiscard]] bool estimate(const List& list, const Box& box, MpuRange& range) const {
        for (const std::uint32_t number : list)
            if (field.leaves()[number].join != Join::one) return false;
        std::array<Interval, 3> seen{Interval::nothing(), Interval::nothing(), Interval::nothing()};
        // Corners first: often they say that the rest need not be asked.
        for (int first = 0; first < kPlacesSeen; first += static_cast<int>(kMpuPlaces)) {
            MpuPlaces places;
            for (std::size_t lane = 0; lane < kMpuPlaces; ++lane) {
                const int i = std::min(first + static_cast<int>(lane), kPlacesSeen - 1);
                const Vec3 share = i < 8 ? Vec3(i & 1, (i >> 1) & 1, (i >> 2) & 1)
                                         : i < 14 ? Vec3((i - 8) / 2 == 0 ? i & 1 : 0.5, (i - 8) / 2 == 1 ? i & 1 : 0.5,
                                                         (i - 8) / 2 == 2 ? i & 1 : 0.5)
                                                  : Vec3(0.5);
                const Vec3 place = field.to_unit(field.bounds().lo + field.size() * (box.lo + share * box.size()));
                for (std::size_t k = 0; k < 3; ++k) places[k][lane] = place[static_cast<int>(k)];
            }
            const MpuPlaces g = mpu_gradients(field.leaves().data(), list, places);
            for (std::size_t k = 0; k < 3; ++k)
                for (const double slope : g[k]) seen[k] = Interval(std::min(seen[k].lo, slope), std::max(seen[k].hi, slope));
            if (seen[0].has_zero() && seen[1].has_zero() && seen[2].has_zero()) return false;
        }
        for (std::size_t k = 0; k < 3; ++k) {
            const double room = kRoomBeyondSeen * seen[k].width() + kLeastRoom;
            range.gradient[k] = intersect(range.gradient[k], Interval(seen[k].lo - room, seen[k].hi + room));
        }
        return true;
    }

    void look(const List& list, const Cube& cube, int cuts, bool surely_near, Kept& kept) const {
        const Box whole = cube.box();
        bool split = false;
        std::optional<MpuRange> known;
        if (!surely_near) {
            const Nearness near = nearness(list, whole, &known);
            if (near == Nearness::far || near == Nearness::nowhere) return;
            surely_near = near == Nearness::near;
            split = !surely_near;
        }
        MpuRange range = known ? *known : field.range(list, whole);
        if (!range.value.has_zero()) return;
        Box tight = whole;
        if (!split) {
            if (!monotone(range)) (void)estimate(list, tight, range);
            for (int pass = 0; pass < 2 && bounded(range); ++pass) {
                const Vec3 before = tight.size();
                if (!shrink(list, range, tight)) return;
                const Vec3 after = tight.size();
                if (after.x * after.y * after.z > kShrunkMuch * before.x * before.y * before.z) break;
                MpuRange again = field.range(list, tight);
                if (!again.value.has_zero()) return;
                if (!monotone(again)) (void)estimate(list, tight, again);
                range = again;
            }
            split = cuts < kCutsForFlat ? !flat(range) : cuts < kCutsForMonotone && !monotone(range);
        }
        if (split && cube.extent > 1) {
            for (unsigned corner = 0; corner < 8; ++corner) {
                const Cube part = cube.part(corner);
                look(reaching(list, part.box()), part, cuts + (surely_near ? 1 : 0), surely_near, kept);
            }
            return;
        }
        MpuCell cell;
        cell.base = cube.base;
        cell.extent = cube.extent;
        const double edge = whole.hi.x - whole.lo.x;
        for (std::size_t k = 0; k < 3; ++k) {
            const auto axis = static_cast<int>(k);
            cell.tight_lo[k] = std::max(below((tight.lo[axis] - whole.lo[axis]) / edge), 0.0F);
            cell.tight_hi[k] = std::min(above((tight.hi[axis] - whole.lo[axis]) / edge), 1.0F);
            cell.gradient_lo[k] = below(range.gradient[k].lo);
            cell.gradient_hi[k] = above(range.gradient[k].hi);
        }
        cell.first_leaf = static_cast<std::uint32_t>(kept.lists.size());
        kept.lists.insert(kept.lists.end(), list.begin(), list.end());
        cell.leaf_count = static_cast<std::uint32_t>(kept.lists.size()) - cell.first_leaf;
        cell.sharp = std::ranges::any_of(list, [&](std::uint32_t i) { return field.leaves()[i].join != Join::one; });
        kept.cells.push_back(cell);
    }

    void look_into_leaf(const MpuLeaf& leaf, Kept& kept) {
        const double planes = kPlanes;
        const double edge = leaf.edge;
        Cube cube{{}, static_cast<std::uint32_t>(edge * planes)};
        for (std::size_t k = 0; k < 3; ++k)
            cube.base[k] = static_cast<std::uint32_t>((static_cast<double>(leaf.center[k]) - 0.5 * edge) * planes);
        const Box box = cube.box();
        const double median = field.spacing();
        const double half = half_diagonal(box);
        const double most = kMpuReach * kMostSpacing * median;
        if (field.tree().distance(box.center(), most + half) >= most + half) return;
        thread_local std::vector<std::uint32_t> near;
        field.tree().nearest(box.center(), 1, near);
        const Vec3 nearest = field.tree().points()[near[0]].position;
        field.tree().nearest(nearest, 1 + kNeighbours, near);
        const double local = length(field.tree().points()[near.back()].position - nearest) / kNeighboursReach;
        reach = kMpuReach * std::clamp(local, median, kMostSpacing * median);
        const Vec3 room(1e-9 * edge + 1e-15);
        List list;
        field.leaves_at({box.lo - room, box.hi + room}, list);
        look(list, cube, 0, false, kept);
    }
};

MpuCells::MpuCells(const MpuField& field) : field_(field) {
    constexpr std::size_t kChunk = 1024;
    const auto leaves = field.leaves();
    const std::size_t chunks = (leaves.size() + kChunk - 1) / kChunk;
    std::vector<Builder::Kept> kept(chunks);
    parallel_for(chunks, 1, [&](std::size_t begin, std::size_t end) {
        Builder builder{field};
        for (std::size_t c = begin; c < end; ++c)
            for (std::size_t i = c * kChunk; i < std::min(leaves.size(), (c + 1) * kChunk); ++i)
                builder.look_into_leaf(leaves[i], kept[c]);
    });
    std::size_t cell_count = 0;
    std::size_t list_size = 0;
    for (const auto& part : kept) {
        cell_count += part.cells.size();
        list_size += part.lists.size();
    }
    cells_.reserve(cell_count);
    lists_.reserve(list_size);
    for (auto& part : kept) {
        for (MpuCell& cell : part.cells) {
            cell.first_leaf += static_cast<std::uint32_t>(lists_.size());
            cells_.push_back(cell);
        }
        lists_.insert(lists_.end(), part.lists.begin(), part.lists.end());
        part = {};
    }
    if (cells_.empty()) return;
    std::vector<std::uint32_t> extents;
    for (const MpuCell& cell : cells_) extents.push_back(cell.extent);
    const auto middle = extents.begin() + static_cast<std::ptrdiff_t>(extents.size() / 2);
    std::nth_element(extents.begin(), middle, extents.end());
    typical_width_ = field.size() * std::ldexp(static_cast<double>(*middle), -kDepth);
}

double MpuCells::plane(int axis, std::uint32_t i) const {
    return field_.bounds().lo[axis] + field_.size() * std::ldexp(static_cast<double>(i), -kDepth);
}

SurfaceCell MpuCells::cell(std::size_t index) const {
    const MpuCell& c = cells_[index];
    SurfaceCell cell{.continuous = true, .gradient = {}, .tight = {}};
    for (std::size_t k = 0; k < 3; ++k) {
        const auto axis = static_cast<int>(k);
        const double lo = plane(axis, c.base[k]);
        const double hi = plane(axis, c.base[k] + c.extent);
        const double width = hi - lo;
        cell.gradient[k] = Interval(c.gradient_lo[k], c.gradient_hi[k]);
        cell.tight.lo[axis] = std::max(lo, lo + width * static_cast<double>(c.tight_lo[k]));
        cell.tight.hi[axis] = c.tight_hi[k] < 1 ? std::min(hi, lo + width * static_cast<double>(c.tight_hi[k])) : hi;
    }
    return cell;
}

namespace {

/// Roots between two places, by halving until each piece has none or one for sure; the signs at its ends decide.
struct Isolation {
    const MpuLine& line;
    std::vector<double>& roots;
    IsolationStats& stats;
    int pieces = 0;

    void refine(double lo, double f_lo, double hi, double f_hi) const {
        const double guess = lo - f_lo * ((hi - lo) / (f_hi - f_lo));
        roots.push_back(safeguarded_newton(lo, hi, guess, !positive(f_lo), [&](double t) {
            const auto f = line.value_and_slope(t);
            return std::pair(f.value, f.slope);
        }));
    }

    void look(double lo, double f_lo, double hi, double f_hi, const MpuLine::Range& range, int depth) {
        const bool differ = positive(f_lo) != positive(f_hi);
        if (!differ && !range.value.has_zero()) return;
        const bool one = !range.slope.has_zero();
        const double middle = lo + 0.5 * (hi - lo);
        ++pieces;
        if (one || depth == kMostHalvings || pieces > kMostPieces || !(middle > lo && middle < hi)) {
            if (!one) ++stats.undecided;
            if (differ) refine(lo, f_lo, hi, f_hi);
            return;
        }
        const double f = line.value(middle);
        look(lo, f_lo, middle, f, line.range(lo, middle), depth + 1);
        look(middle, f, hi, f_hi, line.range(middle, hi), depth + 1);
    }
};

}  // namespace

void MpuCells::cross(std::size_t index, const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
                     std::vector<FieldRoot>& roots, IsolationStats& stats) const {
    const MpuCell& cell = cells_[index];
    // Where the line enters and leaves the cell, not the box in it: neighbours share these places. Half-open along axes
    // across which it does not move.
    double lo = t_lo;
    double hi = t_hi;
    double least = 0;
    double most = 0;
    double sum = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const auto k = static_cast<std::size_t>(axis);
        const double first = plane(axis, cell.base[k]);
        const double last = plane(axis, cell.base[k] + cell.extent);
        if (direction[axis] == 0) {
            if (!(origin[axis] >= first && origin[axis] < last)) return;
            continue;
        }
        const double a = (first - origin[axis]) / direction[axis];
        const double b = (last - origin[axis]) / direction[axis];
        lo = std::max(lo, std::min(a, b));
        hi = std::min(hi, std::max(a, b));
        const double g = static_cast<double>(cell.gradient_lo[k]) * direction[axis];
        const double h = static_cast<double>(cell.gradient_hi[k]) * direction[axis];
        least += std::min(g, h);
        most += std::max(g, h);
        sum += std::max(std::abs(g), std::abs(h));
    }
    if (!(lo < hi)) return;
    const auto leaves = leaves_of(cell);
    thread_local MpuLine line;
    line.set(field_, leaves, origin, direction, lo, hi);
    const double rounding = 1e-12 * sum;
    const bool one = least > rounding || most < -rounding;
    // Most lines that are not known to have one root at most have none, as one range says.
    const MpuLine::Range range = one ? MpuLine::Range{} : line.range(lo, hi);
    if (!one && !range.value.has_zero()) return;
    const double f_lo = line.value(lo);
    const double f_hi = line.value(hi);
    thread_local std::vector<double> found;
    found.clear();
    Isolation isolation{line, found, stats};
    if (one) {
        if (positive(f_lo) != positive(f_hi)) isolation.refine(lo, f_lo, hi, f_hi);
    } else {
        isolation.look(lo, f_lo, hi, f_hi, range, 0);
    }
    for (const double t : found) roots.push_back({t, mpu_gradient(field_, leaves, origin + t * direction)});
}

int MpuCells::most_roots(std::size_t index, int axis) const {
    const auto a = static_cast<std::size_t>(axis);
    const MpuCell& c = cells_[index];
    if (c.monotone(a)) return 1;
    const SurfaceCell whole = cell(index);
    constexpr int kPieces = 8;
    int sum = 0;
    for (int i = 0; i < kPieces; ++i) {
        Box piece{field_.to_unit(whole.tight.lo), field_.to_unit(whole.tight.hi)};
        const double lo = piece.lo[axis];
        const double width = piece.hi[axis] - lo;
        piece.lo[axis] = lo + width * i / kPieces;
        piece.hi[axis] = lo + width * (i + 1) / kPieces;
        const MpuRange range = field_.range(leaves_of(c), piece);
        if (!range.value.has_zero()) continue;
        if (range.gradient[a].has_zero()) return kUnsureRoots;
        ++sum;
    }
    return std::min(sum, kUnsureRoots);
}

std::size_t MpuCells::bytes() const {
    return cells_.capacity() * sizeof(MpuCell) + lists_.capacity() * sizeof(std::uint32_t);
}

void MpuCells::cross_along(const AxisLines& lines, const AxisRoots& out) const {
    const std::size_t a = lines.axis;
    const std::size_t axes[2] = {(a + 1) % 3, (a + 2) % 3};
    const Vec3 first = field_.bounds().lo;
    const auto along = static_cast<int>(a);
    thread_local std::vector<MpuLaneLine> lanes;
    thread_local std::vector<std::size_t> number;
    lanes.clear();
    number.clear();
    constexpr std::size_t kAhead = 16;
    for (std::size_t i = 0; i < lines.count; ++i) {
        if (i + kAhead < lines.count) __builtin_prefetch(cells_.data() + lines.cell[i + kAhead]);
        const MpuCell& cell = cells_[lines.cell[i]];
        if (cell.sharp || cell.leaf_count > kMpuLaneLeaves) {
            AxisLines one{a, 1, lines.cell + i, {}, lines.lo + i, lines.hi + i};
            for (const std::size_t axis : axes) one.at[axis] = lines.at[axis] + i;
            SurfaceCells::cross_along(one, {out.root + i, {out.gradient[0] + i, out.gradient[1] + i, out.gradient[2] + i}});
            continue;
        }
        const auto leaves = leaves_of(cell);
        __builtin_prefetch(leaves.data());
        MpuLaneLine lane{leaves, {}, 0, 0, 0, {}};
        for (std::size_t k = 0; k < 2; ++k)
            lane.at[k] = (lines.at[axes[k]][i] - first[static_cast<int>(axes[k])]) / field_.size();
        lane.lo = (lines.lo[i] - first[along]) / field_.size();
        lane.hi = (lines.hi[i] - first[along]) / field_.size();
        lanes.push_back(lane);
        number.push_back(i);
    }
    cross_mpu_lanes(field_.leaves().data(), a, lanes);
    for (std::size_t k = 0; k < lanes.size(); ++k) {
        const std::size_t i = number[k];
        out.root[i] = lanes[k].root;  // NaN passes
        if (!std::isnan(lanes[k].root))
            out.root[i] = std::clamp(first[along] + field_.size() * lanes[k].root, lines.lo[i], lines.hi[i]);
        for (std::size_t axis = 0; axis < 3; ++axis) out.gradient[axis][i] = lanes[k].gradient[axis];
    }
}

}  // namespace pellucid
