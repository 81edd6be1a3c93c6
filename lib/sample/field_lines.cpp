#include "sample/field_lines.hpp"

#include <cmath>

#include "core/real.hpp"

namespace pellucid {
namespace {

using Triple = std::array<double, 3>;

template <std::size_t outputs>
[[nodiscard]] std::array<double, outputs> evaluate_at(const Program& program, const Triple& x) {
    thread_local std::vector<Real> values;
    std::array<Real, outputs> out;
    run_program<Real>(program, {Real(x[0]), Real(x[1]), Real(x[2])}, values, out);
    std::array<double, outputs> plain;
    for (std::size_t i = 0; i < outputs; ++i) plain[i] = out[i].value;
    return plain;
}

}  // namespace

FieldStep refine_slowly(const Expression& field, std::size_t axis, Triple x, double lo, double hi, bool rising) {
    const double small = kSmallStep * (hi - lo);
    double t = lo + 0.5 * (hi - lo);
    double last_step = hi - lo;
    FieldStep found;
    for (int step = 0; step < 100; ++step) {
        x[axis] = t;
        const auto fg = evaluate_at<4>(field.gradient(), x);
        found.gradient = {fg[1], fg[2], fg[3]};
        ((fg[0] >= 0) == rising ? hi : lo) = t;
        double next = t - fg[0] / fg[1 + axis];
        if (!(next >= lo && next <= hi) || std::abs(next - t) > 0.5 * last_step) next = lo + 0.5 * (hi - lo);
        last_step = std::abs(next - t);
        t = next;
        if (last_step <= small || hi - lo <= 0x1p-52 * std::abs(t)) break;
    }
    found.root = t;
    return found;
}

bool cross_field(const LineView& view, const FieldBlock& block, std::uint32_t piece, double u, double v,
                 double chance, LinePoint& out) {
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
    const double f0 = evaluate_at<1>(field.value(), x)[0];
    x[a] = hi;
    const double f1 = evaluate_at<1>(field.value(), x)[0];
    if ((f0 >= 0) == (f1 >= 0)) return false;

    // The secant's guess; then the cubic t(f) through both ends and this place with its slope, at f = 0.
    const double t0 = lo + f0 / (f0 - f1) * (hi - lo);
    x[a] = t0;
    const auto [f, slope] = evaluate_at<2>(field.slope(block.axis), x);
    const double per_slope = 1 / slope;
    const double from_lo = f0 - f;
    const double from_hi = f1 - f;
    const double bend_lo = ((lo - t0) / from_lo - per_slope) / from_lo;
    const double bend_hi = ((hi - t0) / from_hi - per_slope) / from_hi;
    const double turn = (bend_hi - bend_lo) / (f1 - f0);
    const double newton = t0 - f * per_slope;
    const double t1 = newton + f * f * (bend_lo - f0 * turn);
    const auto inside = [&](double t) { return t >= lo && t <= hi; };
    const double guess = inside(t1) ? t1 : inside(newton) ? newton : t0;
    x[a] = guess;
    const auto fg = evaluate_at<4>(field.gradient(), x);
    FieldStep step{guess - fg[0] / fg[1 + a], {fg[1], fg[2], fg[3]}};
    if (!(std::abs(step.root - guess) <= kSmallStep * (hi - lo)))
        step = refine_slowly(field, a, x, lo, hi, f0 < 0);
    x[a] = step.root;
    Triple reach{};
    reach[a] = p.reach;
    return keep_crossing(view, x, step.gradient, reach, p.bound, chance, out);
}

}  // namespace pellucid
