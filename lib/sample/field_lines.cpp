#include "sample/field_lines.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/real.hpp"
#include "field/safeguarded_newton.hpp"

namespace pellucid {
namespace {

using Triple = std::array<double, 3>;

template <std::size_t outputs>
[[nodiscard]] std::array<double, outputs> numbers_at(const Program& program, const Triple& x) {
    const auto results = evaluate_at<Real, outputs>(program, {Real(x[0]), Real(x[1]), Real(x[2])});
    std::array<double, outputs> numbers;
    for (std::size_t i = 0; i < outputs; ++i) numbers[i] = results[i].value;
    return numbers;
}

}  // namespace

FieldStep refine_slowly(const Expression& field, std::size_t axis, Triple x, double lo, double hi, bool rising) {
    FieldStep found;
    found.root = safeguarded_newton(lo, hi, lo + 0.5 * (hi - lo), rising, [&](double t) {
        x[axis] = t;
        const auto fg = numbers_at<4>(field.gradient(), x);
        found.gradient = {fg[1], fg[2], fg[3]};
        return std::pair(fg[0], fg[1 + axis]);
    });
    return found;
}

namespace {

/// The crossing in one of SurfaceCells.
[[nodiscard]] bool cross_cell_of_field(const LineView& view, const FieldBlock& block, std::uint32_t piece, double u,
                                       double v, double chance, LinePoint& out) {
    const auto a = static_cast<std::size_t>(block.axis);
    const std::size_t b = (a + 1) % 3;
    const std::size_t c = (a + 2) % 3;
    const FieldPiece& p = block.pieces[piece];
    Triple x{};
    x[b] = p.lo[b] + u * (p.hi[b] - p.lo[b]);
    x[c] = p.lo[c] + v * (p.hi[c] - p.lo[c]);
    double root = 0;
    Triple gradient{};
    block.cells->cross_along({a, 1, block.cell + piece, {&x[0], &x[1], &x[2]}, &p.lo[a], &p.hi[a]},
                             {&root, {&gradient[0], &gradient[1], &gradient[2]}});
    if (std::isnan(root)) return false;
    x[a] = root;
    Triple reach{};
    reach[a] = p.reach;
    return keep_crossing(view, x, gradient, reach, p.bound, chance, out);
}

}  // namespace

bool cross_field(const LineView& view, const FieldBlock& block, std::uint32_t piece, double u, double v,
                 double chance, LinePoint& out) {
    if (block.programs == nullptr) return cross_cell_of_field(view, block, piece, u, v, chance, out);
    const auto a = static_cast<std::size_t>(block.axis);
    const std::size_t b = (a + 1) % 3;
    const std::size_t c = (a + 2) % 3;
    const FieldPiece& p = block.pieces[piece];
    const Expression& field = block.programs->field;
    Triple x;
    x[b] = p.lo[b] + u * (p.hi[b] - p.lo[b]);
    x[c] = p.lo[c] + v * (p.hi[c] - p.lo[c]);
    const double lo = p.lo[a];
    const double hi = p.hi[a];
    x[a] = lo;
    const double f0 = numbers_at<1>(field.value(), x)[0];
    x[a] = hi;
    const double f1 = numbers_at<1>(field.value(), x)[0];
    if ((f0 >= 0) == (f1 >= 0)) return false;

    // The secant's guess; then the cubic t(f) through both ends and this place with its slope, at f = 0.
    const double t0 = std::min(lo + f0 / (f0 - f1) * (hi - lo), hi);
    x[a] = t0;
    const auto [f, slope] = numbers_at<2>(field.slope(block.axis), x);
    const double per_slope = 1 / slope;
    const double from_lo = f0 - f;
    const double from_hi = f1 - f;
    const double bend_lo = ((lo - t0) / from_lo - per_slope) / from_lo;
    const double bend_hi = ((hi - t0) / from_hi - per_slope) / from_hi;
    const double turn = (bend_hi - bend_lo) / (f1 - f0);
    const double newton = t0 - f * per_slope;
    const double t1 = newton + f * f * (bend_lo - f0 * turn);
    const auto inside = [&](double t) { return t >= lo && t <= hi; };
    FieldStep step{inside(t1) ? t1 : inside(newton) ? newton : t0, {}};
    bool close = false;
    for (int k = 0; k < kPlainSteps && !close && inside(step.root); ++k) {
        x[a] = step.root;
        const auto fg = numbers_at<4>(field.gradient(), x);
        step = {x[a] - fg[0] / fg[1 + a], {fg[1], fg[2], fg[3]}};
        close = std::abs(step.root - x[a]) <= kSmallStep * (hi - lo);
    }
    if (!close) step = refine_slowly(field, a, x, lo, hi, f0 < 0);
    x[a] = step.root;
    Triple reach{};
    reach[a] = p.reach;
    return keep_crossing(view, x, step.gradient, reach, p.bound, chance, out);
}

}  // namespace pellucid
