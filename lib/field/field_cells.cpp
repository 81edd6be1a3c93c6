#include "field/field_cells.hpp"

#include <algorithm>
#include <cmath>
#include <ranges>
#include <utility>

#include "core/parallel.hpp"
#include "core/real.hpp"
#include "field/point_evaluator.hpp"
#include "field/rounded.hpp"
#include "field/safeguarded_newton.hpp"

namespace pellucid {
namespace {

/// Beyond the bounds, of their size: a surface may lie in a face of them.
constexpr double kHair = 1e-9;
/// A cell is flat enough where |∇f|/|∂f/∂axis| is at most so many times what it is in the middle: what lines
/// along that axis give too much is thrown away again.
constexpr double kFlat = 1.5;
/// … and where so many of so many lines meet the surface.
constexpr std::size_t kProbes = 16;
constexpr std::size_t kWantedHits = 5;
/// Cells that are neither empty nor flat are cut until their faces are less than this share of all.
constexpr double kLeastShareLeft = 0.002;
constexpr double kFewCells = 0.05;
constexpr double kLeastShareOfFew = 1e-5;
/// Steps of programs in intervals that a surface may cost: some seconds.
constexpr double kMostWork = 4e8;
/// Of longer formulas the Hessian, of some three times as many steps, is not asked for.
constexpr std::size_t kMostGradientSteps = 2000;
/// A box is looked into again where its volume has become less than this share.
constexpr double kShrunkMuch = 0.6;
/// A place on a line, computed, is off by less than this share of the bounds and of its distance from the origin.
constexpr double kPlaceRounding = 0x1p-50;
/// Boxes around the surface are larger than they need be by this share of their cell.
constexpr double kShrinkRoom = 1e-6;

[[nodiscard]] std::array<Real, 3> reals(const Vec3& x) { return {Real(x.x), Real(x.y), Real(x.z)}; }

[[nodiscard]] std::array<Interval, 3> intervals(const Box& box) {
    return {Interval(box.lo.x, box.hi.x), Interval(box.lo.y, box.hi.y), Interval(box.lo.z, box.hi.z)};
}

[[nodiscard]] bool positive(double value) { return value >= 0; }

/// A derivative: where its own formula has no value (0/0 where a root's argument vanishes) nothing is known of it.
[[nodiscard]] Interval known(const Interval& derivative) {
    return derivative.empty() ? Interval::everything(false) : derivative;
}

[[nodiscard]] bool bounded(const Interval& a) { return a.lo > -kInfinity && a.hi < kInfinity; }

/// The signs at the ends are those that the neighbours see: a root within rounding of a face is on their side or on ours.
/// Each end is judged by itself, against a place well between the roots: both may be wrong.
template <class F>
void agree_with_ends(std::vector<Root>& found, double lo, double hi, double f_lo, double f_hi, const F& value) {
    double widest = -1;
    double middle = lo;
    std::size_t split = 0;  // roots before the middle
    for (std::size_t i = 0; i <= found.size(); ++i) {
        const double from = i > 0 ? found[i - 1].t : lo;
        const double to = i < found.size() ? found[i].t : hi;
        if (to - from <= widest) continue;
        widest = to - from;
        middle = from + 0.5 * widest;
        split = i;
    }
    const bool inside = positive(value(middle));
    const double close = 1e-6 * (hi - lo);
    const auto crosses = [](const Root& r) { return !r.touching; };
    const auto odd = [&](auto begin, auto end) { return std::count_if(begin, end, crosses) % 2 != 0; };
    const auto at = found.begin() + static_cast<std::ptrdiff_t>(split);
    if (odd(at, found.end()) != (positive(f_hi) != inside)) {
        const auto last = std::find_if(found.rbegin(), std::make_reverse_iterator(at), crosses);
        if (last != std::make_reverse_iterator(at) && hi - last->t <= close)
            found.erase(std::next(last).base());
        else
            found.push_back({hi, false});
    }
    const auto end = found.begin() + static_cast<std::ptrdiff_t>(split);
    if (odd(found.begin(), end) != (positive(f_lo) != inside)) {
        const auto first = std::find_if(found.begin(), end, crosses);
        if (first != end && first->t - lo <= close)
            found.erase(first);
        else
            found.insert(found.begin(), {lo, false});
    }
}

}  // namespace

/// The search, level by level.
struct FieldCells::Builder {
    /// A cell, and how far the value of `run_program<Real>` at a computed place on a line may be from that at the place
    /// itself: a surface may lie an ulp beside a face that lines cross.
    struct Found {
        FieldCell cell;
        double noise;
        bool flat;
    };

    const FieldCells& cells;
    bool curvature_is_worth_it;
    PointEvaluator values;
    double place_error;

    /// Whether anything of the surface may be in the cell; then what is known of it there. `found.noise` comes from a
    /// larger cell.
    [[nodiscard]] bool look(Found& found) const {
        FieldCell& cell = found.cell;
        cell.tight = cells.box(cell);
        cell.continuous = true;
        // A second look, where the box has shrunk much, sees more.
        for (int pass = 0; pass < 2; ++pass) {
            const Vec3 before = cell.tight.size();
            if (!look_into(found, cell.tight)) return false;
            const Vec3 after = cell.tight.size();
            if (after.x * after.y * after.z > kShrunkMuch * before.x * before.y * before.z) break;
        }
        found.flat = is_flat(cell);
        return true;
    }

    /// The same for a box in the cell that holds all of the surface in it.
    [[nodiscard]] bool look_into(Found& found, const Box box) const {
        const auto at = intervals(box);
        const auto fg = evaluate_at<Interval, 4>(cells.field_.gradient(), at);
        const auto excluded = [&](const Interval& f) {
            return f.empty() || f.lo > found.noise || f.hi < -found.noise;
        };
        if (excluded(fg[0])) return false;
        FieldCell& cell = found.cell;
        cell.continuous = cell.continuous && fg[0].continuous;
        cell.gradient = {known(fg[1]), known(fg[2]), known(fg[3])};
        const std::array<Rounded, 3> places{Rounded(at[0], place_error), Rounded(at[1], place_error),
                                            Rounded(at[2], place_error)};
        found.noise = std::min(found.noise, evaluate_at<Rounded, 1>(cells.field_.value(), places)[0].error);
        if (excluded(fg[0])) return false;
        if (!fg[0].continuous || !std::ranges::all_of(cell.gradient, bounded)) return true;
        const Vec3 c = box.center();
        const auto middle =
            evaluate_at<Interval, 4>(cells.field_.gradient(), {Interval(c.x), Interval(c.y), Interval(c.z)});
        std::array<Interval, 3> off;  // x − c
        for (std::size_t axis = 0; axis < 3; ++axis) off[axis] = at[axis] - Interval(c[static_cast<int>(axis)]);
        if (curvature_is_worth_it) bend(cell, middle, at, off);
        // f(x) = f(c) + ∇f(ξ)·(x − c)
        Interval f = middle[0];
        for (std::size_t axis = 0; axis < 3; ++axis) f = f + cell.gradient[axis] * off[axis];
        return !excluded(intersect(f, fg[0])) && shrink(found, c, middle[0], off);
    }

    /// Of cells along which lines can be thrown, those that most lines miss are not worth being kept whole.
    void probe(std::vector<Found>& all) const {
        parallel_for(all.size(), 64, [&](std::size_t begin, std::size_t end) {
            std::array<std::vector<double>, 3> at;
            std::vector<double> f(2 * kProbes + PointEvaluator::kRoom);
            for (auto& each : at) each.resize(2 * kProbes + PointEvaluator::kRoom);
            for (std::size_t i = begin; i < end; ++i) {
                Found& found = all[i];
                if (!found.flat) continue;
                const std::size_t a = steepest(found.cell);
                const Box& box = found.cell.tight;
                for (std::size_t k = 0; k < 2 * kProbes; ++k) {
                    // Fibonacci's lattice
                    const double place[3] = {k < kProbes ? 0.0 : 1.0, (static_cast<double>(k % kProbes) + 0.5) / kProbes,
                                             std::fmod(0.5 + 0.618033988749895 * static_cast<double>(k % kProbes), 1)};
                    for (std::size_t j = 0; j < 3; ++j) {
                        const auto axis = static_cast<int>((a + j) % 3);
                        at[(a + j) % 3][k] = box.lo[axis] + place[j] * (box.hi[axis] - box.lo[axis]);
                    }
                }
                double* const out[] = {f.data()};
                values(2 * kProbes, at[0].data(), at[1].data(), at[2].data(), out);
                std::size_t hits = 0;
                for (std::size_t k = 0; k < kProbes; ++k) hits += positive(f[k]) != positive(f[k + kProbes]) ? 1U : 0U;
                found.flat = hits >= kWantedHits;
            }
        });
    }

    [[nodiscard]] static bool monotone_somewhere(const FieldCell& cell) {
        return cell.monotone(0) || cell.monotone(1) || cell.monotone(2);
    }
    [[nodiscard]] static std::size_t steepest(const FieldCell& cell) {
        const auto least = [&](std::size_t axis) {
            return cell.monotone(axis) ? abs(cell.gradient[axis]).lo : 0;
        };
        const std::size_t best = least(1) > least(0) ? 1 : 0;
        return least(2) > least(best) ? 2 : best;
    }

    /// ∇f(x) = ∇f(c) + H(ξ)(x − c): in small cells much tighter than the gradient's own interval.
    void bend(FieldCell& cell, const std::array<Interval, 4>& middle, const std::array<Interval, 3>& at,
              const std::array<Interval, 3>& off) const {
        const auto fgh = evaluate_at<Interval, 10>(cells.field_.hessian(), at);
        constexpr std::size_t kPlace[3][3] = {{4, 7, 8}, {7, 5, 9}, {8, 9, 6}};
        for (std::size_t i = 0; i < 3; ++i) {
            Interval g = middle[1 + i];
            for (std::size_t j = 0; j < 3; ++j) g = g + known(fgh[kPlace[i][j]]) * off[j];
            if (bounded(g)) cell.gradient[i] = intersect(cell.gradient[i], g);
        }
    }

    /// The box of those x with |f(x)| <= noise: f(c) + Σ g_j (x_j − c_j) solved for each x_i in turn. False if
    /// there are none.
    [[nodiscard]] static bool shrink(Found& found, const Vec3& c, const Interval& f_middle, std::array<Interval, 3> off) {
        FieldCell& cell = found.cell;
        const Interval f = f_middle + Interval(-found.noise, found.noise);
        for (std::size_t i = 0; i < 3; ++i) {
            if (cell.gradient[i].has_zero()) continue;
            Interval rest = f;
            for (std::size_t j = 0; j < 3; ++j)
                if (j != i) rest = rest + cell.gradient[j] * off[j];
            off[i] = intersect(off[i], -(rest / cell.gradient[i]));
            if (off[i].empty()) return false;
            const auto axis = static_cast<int>(i);
            // With room, so that signs at the ends are certain where the surface is flat in the box.
            const double room = kShrinkRoom * (cell.tight.hi[axis] - cell.tight.lo[axis]);
            cell.tight.lo[axis] = std::max(cell.tight.lo[axis], c[axis] + off[i].lo - room);
            cell.tight.hi[axis] = std::min(cell.tight.hi[axis], c[axis] + off[i].hi + room);
        }
        return true;
    }

    [[nodiscard]] static bool is_flat(const FieldCell& cell) {
        double reach2 = 0;
        double middle2 = 0;
        for (const Interval& g : cell.gradient) {
            reach2 += g.reach() * g.reach();
            middle2 += 0.25 * (g.lo + g.hi) * (g.lo + g.hi);
        }
        for (std::size_t axis = 0; axis < 3; ++axis) {
            if (!cell.monotone(axis)) continue;
            const Interval& g = cell.gradient[axis];
            if (!bounded(g)) continue;
            const double least = g.lo > 0 ? g.lo : -g.hi;
            const double middle = 0.5 * std::abs(g.lo + g.hi);
            if (std::sqrt(reach2) * middle <= kFlat * std::sqrt(middle2) * least) return true;
        }
        return false;
    }

    [[nodiscard]] Vec3 size_of(const FieldCell& cell) const {
        return cells.bounds_.size() *
               (Vec3(cell.extent[0], cell.extent[1], cell.extent[2]) * (1.0 / static_cast<double>(kPlanes)));
    }

    /// The axes along which cells of this size are halved next, as bits; none where they are as small as can be.
    [[nodiscard]] unsigned long_axes(const FieldCell& cell) const {
        constexpr std::uint32_t kLeastExtent = 4;
        constexpr double kLong = 0.6;  // of the longest
        const Vec3 size = size_of(cell);
        double longest = 0;
        for (std::size_t axis = 0; axis < 3; ++axis)
            if (cell.extent[axis] > kLeastExtent) longest = std::max(longest, size[static_cast<int>(axis)]);
        unsigned halved = 0;
        for (std::size_t axis = 0; axis < 3; ++axis)
            if (cell.extent[axis] > kLeastExtent && size[static_cast<int>(axis)] > kLong * longest) halved |= 1U << axis;
        return halved;
    }

    /// What is left of the halves of all cells, which have one size.
    [[nodiscard]] std::vector<Found> split(const std::vector<Found>& parents) const {
        const unsigned halved = long_axes(parents.front().cell);
        std::vector<std::vector<Found>> kept(parents.size());
        parallel_for(parents.size(), 16, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i)
                for (unsigned corner = 0; corner < 8; ++corner) {
                    if ((corner & ~halved) != 0) continue;
                    Found child = parents[i];
                    for (std::size_t axis = 0; axis < 3; ++axis) {
                        if ((halved >> axis & 1U) != 0) child.cell.extent[axis] /= 2;
                        if ((corner >> axis & 1U) != 0) child.cell.base[axis] += child.cell.extent[axis];
                    }
                    if (look(child)) kept[i].push_back(child);
                }
        });
        std::vector<Found> all;
        for (const auto& each : kept) all.insert(all.end(), each.begin(), each.end());
        return all;
    }

    [[nodiscard]] std::vector<FieldCell> build(const Limits& limits) const {
        auto steps = static_cast<double>(2 * cells.field_.gradient().steps.size() + cells.field_.value().steps.size());
        if (curvature_is_worth_it) steps += static_cast<double>(cells.field_.hessian().steps.size());
        const auto at_most = [&](std::size_t limit, double evaluations) {
            return std::min(limit, static_cast<std::size_t>(kMostWork / (evaluations * steps)) + 8);
        };
        const std::size_t wanted = at_most(limits.wanted, 32);
        const std::size_t most = at_most(limits.most, 8);

        std::vector<FieldCell> done;
        double done_faces = 0;
        // Nothing is known of its noise.
        Found root{{{}, {0, 0, 0}, {kPlanes, kPlanes, kPlanes}}, kInfinity, false};
        std::vector<Found> pending;
        if (look(root)) pending.push_back(root);
        while (!pending.empty()) {
            const Vec3 size = size_of(pending.front().cell) / length(cells.bounds_.size());
            const double face = size.x * size.y + size.y * size.z + size.z * size.x;
            probe(pending);
            const auto finish = [&](auto&& ready) {
                const auto rest = std::stable_partition(pending.begin(), pending.end(), ready);
                for (auto f = pending.begin(); f != rest; ++f) done.push_back(f->cell);
                done_faces += static_cast<double>(rest - pending.begin()) * face;
                pending.erase(pending.begin(), rest);
            };
            const bool enough = done.size() + pending.size() >= wanted;
            const auto full = [&] { return enough && done.size() + 4 * pending.size() > most; };
            if (enough) finish([](const Found& f) { return f.flat; });
            // What is left then are those that no line along one axis serves.
            if (full()) finish([](const Found& f) { return monotone_somewhere(f.cell); });
            const double left = static_cast<double>(pending.size()) * face;
            const double share = left / (left + done_faces);
            // Few cells, around points, may as well be cut further.
            const bool few = static_cast<double>(pending.size()) < kFewCells * static_cast<double>(done.size());
            if (pending.empty() || (full() && !few) || long_axes(pending.front().cell) == 0 ||
                share < (few ? kLeastShareOfFew : kLeastShareLeft))
                break;
            pending = split(pending);
        }
        for (const Found& f : pending) done.push_back(f.cell);
        return done;
    }
};

FieldCells::FieldCells(Expression f, const Box& bounds, const Limits& limits)
    : field_(std::move(f)), isolator_(field_), bounds_(bounds) {
    // A constant has no surface, not even where it is 0.
    const Program& value = field_.value();
    if (value.steps[value.outputs[0]].op == Op::constant) return;
    // Second derivatives say nothing about kinks, and those of long formulas are too many.
    const bool curvature = !field_.has_kinks() && field_.gradient().steps.size() < kMostGradientSteps;
    double reach = length(bounds_.size());
    for (int axis = 0; axis < 3; ++axis)
        reach = std::max({reach, std::abs(bounds_.lo[axis]), std::abs(bounds_.hi[axis])});
    cells_ = Builder{*this, curvature, PointEvaluator(field_.value()), kPlaceRounding * reach}.build(limits);
    cells_.shrink_to_fit();
}

double FieldCells::plane(int axis, std::uint32_t i) const {
    const double lo = bounds_.lo[axis];
    const double hi = bounds_.hi[axis];
    const double hair = kHair * (hi - lo);
    if (i == 0) return lo - hair;
    if (i == kPlanes) return hi + hair;
    return lo + (hi - lo) * (static_cast<double>(i) * (1.0 / kPlanes));
}

Box FieldCells::box(const FieldCell& cell) const {
    Box box;
    for (int axis = 0; axis < 3; ++axis) {
        const std::uint32_t base = cell.base[static_cast<std::size_t>(axis)];
        box.lo[axis] = plane(axis, base);
        box.hi[axis] = plane(axis, base + cell.extent[static_cast<std::size_t>(axis)]);
    }
    return box;
}

/// Of a root of several multiplicities the gradient vanishes, and its direction is that beside the root.
Vec3 FieldCells::gradient_near(const Vec3& x, const Vec3& aside) const {
    constexpr double kVanishes = 1e-3;
    const auto gradient = [&](const Vec3& at) {
        const auto fg = evaluate_at<Real, 4>(field_.gradient(), reals(at));
        return Vec3(fg[1].value, fg[2].value, fg[3].value);
    };
    const Vec3 here = gradient(x);
    const Vec3 beside = gradient(x + aside);
    const double size = length(beside);
    if (!std::isfinite(size)) return here;
    return length(here) >= kVanishes * size || !(size > 0) ? here : beside;
}

/// The one root between lo and hi, from the secant's guess.
FieldRoot FieldCells::refine(const Vec3& origin, const Vec3& direction, double lo, double hi, double f_lo,
                             double f_hi) const {
    Vec3 gradient(0.0);
    const double guess = lo - f_lo * ((hi - lo) / (f_hi - f_lo));
    const double t = safeguarded_newton(lo, hi, guess, !positive(f_lo), [&](double at) {
        const auto fg = evaluate_at<Real, 4>(field_.gradient(), reals(origin + at * direction));
        gradient = {fg[1].value, fg[2].value, fg[3].value};
        return std::pair(fg[0].value, dot(gradient, direction));
    });
    return {t, gradient};
}

void FieldCells::cross(const FieldCell& cell, const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
                       std::vector<FieldRoot>& roots, IsolationStats& stats) const {
    // Where the line enters and leaves the cell, not the box in it: neighbours share these places. Half-open along axes across which it does not move.
    double lo = t_lo;
    double hi = t_hi;
    for (int axis = 0; axis < 3; ++axis) {
        const std::uint32_t base = cell.base[static_cast<std::size_t>(axis)];
        const double first = plane(axis, base);
        const double last = plane(axis, base + cell.extent[static_cast<std::size_t>(axis)]);
        if (direction[axis] == 0) {
            if (!(origin[axis] >= first && origin[axis] < last)) return;
            continue;
        }
        const double a = (first - origin[axis]) / direction[axis];
        const double b = (last - origin[axis]) / direction[axis];
        lo = std::max(lo, std::min(a, b));
        hi = std::min(hi, std::max(a, b));
    }
    if (!(lo < hi)) return;
    const auto value = [&](double t) {
        return evaluate_at<Real, 1>(field_.value(), reals(origin + t * direction))[0].value;
    };
    // Rounding may put an end of a cell beside the domain of f, where no neighbour asks for its sign.
    const double step_inside = 1e-9 * (hi - lo);
    const auto value_at_end = [&](double t, double inside) {
        const double f = value(t);
        return std::isnan(f) && cell.continuous ? value(inside) : f;
    };
    const double f_lo = value_at_end(lo, lo + step_inside);
    const double f_hi = value_at_end(hi, hi - step_inside);

    double least = 0;
    double most = 0;
    double sum = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const Interval& g = cell.gradient[static_cast<std::size_t>(axis)];
        const double a = g.lo * direction[axis];
        const double b = g.hi * direction[axis];
        least += std::min(a, b);
        most += std::max(a, b);
        sum += std::max(std::abs(a), std::abs(b));
    }
    const double rounding = 1e-15 * sum;
    if (cell.continuous && (least > rounding || most < -rounding)) {
        if (positive(f_lo) != positive(f_hi)) roots.push_back(refine(origin, direction, lo, hi, f_lo, f_hi));
        return;
    }

    thread_local std::vector<Root> found;
    found.clear();
    isolator_.isolate(origin, direction, lo, hi, found, stats);
    if (cell.continuous) agree_with_ends(found, lo, hi, f_lo, f_hi, value);
    const Vec3 aside = 1e-4 * (hi - lo) * direction;
    for (const Root& root : found) roots.push_back({root.t, gradient_near(origin + root.t * direction, aside)});
}

bool FieldCells::excludes(const Box& box) const {
    const auto f = evaluate_at<Interval, 1>(field_.value(), intervals(box))[0];
    return f.empty() || !f.has_zero();
}

int FieldCells::most_roots(const FieldCell& cell, int axis) const {
    const auto a = static_cast<std::size_t>(axis);
    if (cell.monotone(a)) return 1;
    int most = kMostRoots;
    if (const auto degree = field_.degree_along(axis)) most = std::min(most, *degree);
    if (field_.has_kinks() || most <= 2) return most;
    // Where the second derivative keeps its sign there are at most two; pieces add up.
    constexpr int kPieces = 8;
    int sum = 0;
    const Box whole = box(cell);
    for (const int pieces : {1, kPieces}) {
        sum = 0;
        for (int i = 0; i < pieces && sum < most; ++i) {
            Box piece = whole;
            const double length = whole.hi[axis] - whole.lo[axis];
            piece.lo[axis] = whole.lo[axis] + length * i / pieces;
            piece.hi[axis] = i + 1 == pieces ? whole.hi[axis] : whole.lo[axis] + length * (i + 1) / pieces;
            const auto f = evaluate_at<Interval, 10>(field_.hessian(), intervals(piece));
            if (!f[0].continuous) return most;
            const auto sure = [](const Interval& g) { return !g.empty() && !g.has_zero(); };
            sum += sure(f[0]) ? 0 : sure(f[1 + a]) ? 1 : sure(f[4 + a]) ? 2 : most;
        }
        if (sum < most) return sum;
    }
    return most;
}

}  // namespace pellucid
