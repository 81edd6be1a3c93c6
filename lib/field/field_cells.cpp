#include "field/field_cells.hpp"

#include <algorithm>
#include <cmath>

#include "core/parallel.hpp"
#include "core/real.hpp"
#include "field/rounded.hpp"

namespace pellucid {
namespace {

/// Beyond the bounds, of their size: a surface may lie in a face of them.
constexpr double kHair = 1e-9;
/// A cell is flat enough where |∇f|/|∂f/∂axis| is at most so many times what it is in the middle: what lines
/// along that axis give too much is thrown away again.
constexpr double kFlat = 1.5;
/// Cells that are neither empty nor flat are cut until their faces are less than this share of all.
constexpr double kLeastShareLeft = 0.01;
/// Steps of programs in intervals that a surface may cost: some seconds.
constexpr double kMostWork = 4e8;

/// Program, point, result: one scratch a thread and algebra.
template <class T, std::size_t outputs>
[[nodiscard]] std::array<T, outputs> evaluate_at(const Program& program, const std::array<T, 3>& at) {
    thread_local std::vector<T> values;
    std::array<T, outputs> out;
    run_program<T>(program, at, values, out);
    return out;
}

[[nodiscard]] std::array<Real, 3> reals(const Vec3& x) { return {Real(x.x), Real(x.y), Real(x.z)}; }

[[nodiscard]] std::array<Interval, 3> intervals(const Box& box) {
    return {Interval(box.lo.x, box.hi.x), Interval(box.lo.y, box.hi.y), Interval(box.lo.z, box.hi.z)};
}

[[nodiscard]] bool positive(double value) { return value >= 0; }

[[nodiscard]] bool bounded(const Interval& a) { return a.lo > -kInfinity && a.hi < kInfinity; }

}  // namespace

/// The search, level by level.
struct FieldCells::Builder {
    /// A cell, and how far the value of `run_program<Real>` may be off in it.
    struct Found {
        FieldCell cell;
        double noise;
        bool flat;
    };

    const FieldCells& cells;

    /// Whether anything of the surface may be in the cell; then its gradient is known. `found.noise` comes from a larger cell.
    [[nodiscard]] bool look(Found& found) const {
        const Box box = cells.box(found.cell);
        const auto at = intervals(box);
        const auto fg = evaluate_at<Interval, 4>(cells.field_.gradient(), at);
        const auto excluded = [&](const Interval& f) {
            return f.empty() || f.lo > found.noise || f.hi < -found.noise;
        };
        if (excluded(fg[0])) return false;
        found.cell.continuous = fg[0].continuous;
        found.cell.gradient = {fg[1], fg[2], fg[3]};
        if (fg[0].continuous && bounded(fg[1]) && bounded(fg[2]) && bounded(fg[3])) {
            // f(x) = f(c) + ∇f(ξ)·(x − c)
            const Vec3 c = box.center();
            Interval f = evaluate_at<Interval, 1>(cells.field_.value(), {Interval(c.x), Interval(c.y), Interval(c.z)})[0];
            for (std::size_t axis = 0; axis < 3; ++axis)
                f = f + fg[axis + 1] * (at[axis] - Interval(c[static_cast<int>(axis)]));
            if (excluded(intersect(f, fg[0]))) return false;
        }
        const Rounded f = evaluate_at<Rounded, 1>(
            cells.field_.value(), {Rounded(at[0], 0), Rounded(at[1], 0), Rounded(at[2], 0)})[0];
        found.noise = std::min(found.noise, f.error);
        found.flat = is_flat(found.cell);
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
            const double least = g.lo > 0 ? g.lo : -g.hi;
            const double middle = 0.5 * std::abs(g.lo + g.hi);
            if (std::sqrt(reach2) * middle <= kFlat * std::sqrt(middle2) * least) return true;
        }
        return false;
    }

    /// What is left of the halves of all cells.
    [[nodiscard]] std::vector<Found> split(const std::vector<Found>& parents) const {
        std::vector<std::vector<Found>> kept(parents.size());
        parallel_for(parents.size(), 16, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i)
                for (unsigned corner = 0; corner < 8; ++corner) {
                    Found child = parents[i];
                    child.cell.extent /= 2;
                    for (std::size_t axis = 0; axis < 3; ++axis)
                        if ((corner >> axis & 1U) != 0) child.cell.base[axis] += child.cell.extent;
                    if (look(child)) kept[i].push_back(child);
                }
        });
        std::vector<Found> all;
        for (const auto& each : kept) all.insert(all.end(), each.begin(), each.end());
        return all;
    }

    [[nodiscard]] std::vector<FieldCell> build(const Limits& limits) const {
        const auto steps = static_cast<double>(cells.field_.gradient().steps.size() + cells.field_.value().steps.size());
        const auto at_most = [&](std::size_t limit, double evaluations) {
            return std::min(limit, static_cast<std::size_t>(kMostWork / (evaluations * steps)) + 8);
        };
        const std::size_t wanted = at_most(limits.wanted, 32);
        const std::size_t most = at_most(limits.most, 8);

        std::vector<FieldCell> done;
        double done_faces = 0;
        Found root{{{0, 0, 0}, kPlanes, false, {}}, kInfinity, false};
        // The noise of the whole box decides nothing: it is infinite until a cell has its own.
        std::vector<Found> pending;
        if (look(root)) pending.push_back(root);
        for (double face = 1; !pending.empty(); face /= 4) {
            if (done.size() + pending.size() >= wanted) {
                const auto rough = std::stable_partition(pending.begin(), pending.end(), [](const Found& f) { return f.flat; });
                for (auto f = pending.begin(); f != rough; ++f) done.push_back(f->cell);
                done_faces += static_cast<double>(rough - pending.begin()) * face;
                pending.erase(pending.begin(), rough);
            }
            const double left = static_cast<double>(pending.size()) * face;
            const bool full = done.size() + 4 * pending.size() > most && done.size() + pending.size() >= wanted;
            if (pending.empty() || full || pending.front().cell.extent <= 4 ||
                (!done.empty() && left < kLeastShareLeft * (left + done_faces)))
                break;
            pending = split(pending);
        }
        for (const Found& f : pending) done.push_back(f.cell);
        return done;
    }
};

FieldCells::FieldCells(Expression f, const Box& bounds, const Limits& limits)
    : field_(std::move(f)), isolator_(field_), bounds_(bounds) {
    cells_ = Builder{*this}.build(limits);
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
        box.hi[axis] = plane(axis, base + cell.extent);
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
    return length(here) >= kVanishes * size || !(size > 0) ? here : beside;
}

/// The one root between lo and hi, where f is monotone: Newton from the secant's guess, halving where it leaves
/// the bracket or does not shrink its step.
FieldRoot FieldCells::refine(const Vec3& origin, const Vec3& direction, double lo, double hi, double f_lo,
                             double f_hi) const {
    // A step so small leaves an error below rounding: Newton's errors are squared.
    const double small = 0x1p-30 * (hi - lo);
    const bool rising = !positive(f_lo);
    double t = lo - f_lo * ((hi - lo) / (f_hi - f_lo));
    double last_step = hi - lo;
    Vec3 gradient(0.0);
    for (int step = 0; step < 100; ++step) {
        if (!(t > lo && t < hi)) t = lo + 0.5 * (hi - lo);
        const auto fg = evaluate_at<Real, 4>(field_.gradient(), reals(origin + t * direction));
        const double value = fg[0].value;
        gradient = {fg[1].value, fg[2].value, fg[3].value};
        (positive(value) == rising ? hi : lo) = t;
        double next = t - value / dot(gradient, direction);
        if (!(next >= lo && next <= hi) || std::abs(next - t) > 0.5 * last_step) next = lo + 0.5 * (hi - lo);
        last_step = std::abs(next - t);
        const bool close = last_step <= small || !(t > lo - last_step && hi - lo > 0x1p-52 * std::abs(t));
        t = next;
        if (close) break;
    }
    return {t, gradient};
}

void FieldCells::cross(const FieldCell& cell, const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
                       std::vector<FieldRoot>& roots, IsolationStats& stats) const {
    // Where the line enters and leaves. Half-open along axes across which it does not move.
    double lo = t_lo;
    double hi = t_hi;
    for (int axis = 0; axis < 3; ++axis) {
        const std::uint32_t base = cell.base[static_cast<std::size_t>(axis)];
        const double first = plane(axis, base);
        const double last = plane(axis, base + cell.extent);
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
    const double f_lo = value(lo);
    const double f_hi = value(hi);

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
    if (cell.continuous) {
        // The signs at the ends are those that the neighbours see: a root within rounding of a face is on their side or on ours.
        const auto changes = static_cast<std::size_t>(
            std::count_if(found.begin(), found.end(), [](const Root& r) { return !r.touching; }));
        if ((changes % 2 != 0) != (positive(f_lo) != positive(f_hi))) {
            const bool at_lo = std::abs(f_lo) <= std::abs(f_hi);
            const auto nearest = std::min_element(found.begin(), found.end(), [&](const Root& a, const Root& b) {
                const auto off = [&](const Root& r) {
                    return r.touching ? kInfinity : at_lo ? r.t - lo : hi - r.t;
                };
                return off(a) < off(b);
            });
            const double close = 1e-6 * (hi - lo);
            if (nearest != found.end() && !nearest->touching && (at_lo ? nearest->t - lo : hi - nearest->t) <= close)
                found.erase(nearest);
            else
                found.insert(at_lo ? found.begin() : found.end(), Root{at_lo ? lo : hi, false});
        }
    }
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
