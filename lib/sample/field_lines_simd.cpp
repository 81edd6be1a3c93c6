// The trials of field_lines.cpp over SIMD lanes.
#include "sample/field_lines.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sample/field_lines_simd.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "sample/edge_lines-inl.h"

#ifndef PELLUCID_SAMPLE_FIELD_LINES_LANES
#define PELLUCID_SAMPLE_FIELD_LINES_LANES
namespace pellucid {
namespace {

/// A chunk of lines on its way: coordinates across the axis, the bracket along it, and f at both ends.
struct alignas(64) FieldLanes {
    double across[2][kChunkRoom], lo[kChunkRoom], hi[kChunkRoom], f_lo[kChunkRoom], f_hi[kChunkRoom];
    double chance[kChunkRoom];
    double guess[kChunkRoom];
    double value[kChunkRoom];
    double gradient[3][kChunkRoom];
    std::uint64_t piece[kChunkRoom], line[kChunkRoom];
    std::uint32_t cell[kChunkRoom];
    std::uint64_t far[kChunkRoom];  // lanes whose last step was too large
    double far_across[2][kChunkRoom], far_guess[kChunkRoom], far_value[kChunkRoom], far_gradient[3][kChunkRoom];
};

}  // namespace
}  // namespace pellucid
#endif

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

/// Runs a program with `along` as coordinate of the axis.
void evaluate_lanes(const PointEvaluator& program, int axis, std::size_t count, const FieldLanes& lanes,
                    const double* along, double* const* out) {
    const double* at[3];
    at[axis] = along;
    at[(axis + 1) % 3] = lanes.across[0];
    at[(axis + 2) % 3] = lanes.across[1];
    program(count, at[0], at[1], at[2], out);
}

/// A step of Newton's for the lanes in lanes.far; how many stay there. Those whose guess has left the bracket do not
/// move: they are for refine_slowly.
template <int a>
std::size_t step_again(const FieldBlock& block, FieldLanes& lanes, std::size_t far) {
    for (std::size_t i = 0; i < far; ++i) {
        const std::size_t lane = lanes.far[i];
        lanes.far_across[0][i] = lanes.across[0][lane];
        lanes.far_across[1][i] = lanes.across[1][lane];
        lanes.far_guess[i] = lanes.guess[lane];
    }
    const double* at[3];
    at[a] = lanes.far_guess;
    at[(a + 1) % 3] = lanes.far_across[0];
    at[(a + 2) % 3] = lanes.far_across[1];
    double* const out[] = {lanes.far_value, lanes.far_gradient[0], lanes.far_gradient[1], lanes.far_gradient[2]};
    block.programs->gradient(far, at[0], at[1], at[2], out);
    std::size_t left = 0;
    for (std::size_t i = 0; i < far; ++i) {
        const std::size_t lane = lanes.far[i];
        const double guess = lanes.far_guess[i];
        bool close = false;
        if (guess >= lanes.lo[lane] && guess <= lanes.hi[lane]) {
            const double root = guess - lanes.far_value[i] / lanes.far_gradient[a][i];
            close = std::abs(root - guess) <= kSmallStep * (lanes.hi[lane] - lanes.lo[lane]);
            lanes.guess[lane] = root;
            for (std::size_t axis = 0; axis < 3; ++axis) lanes.gradient[axis][lane] = lanes.far_gradient[axis][i];
        }
        if (!close) lanes.far[left++] = lane;
    }
    return left;
}

[[nodiscard]] HWY_INLINE V of_piece(const FieldBlock& block, VU piece, int word) {
    static_assert(sizeof(FieldPiece) == 8 * sizeof(double));
    return hn::GatherIndex(d, reinterpret_cast<const double*>(block.pieces) + word,
                           hn::BitCast(di, hn::ShiftLeft<3>(piece)));
}

/// Where the lines run.
template <int a>
void place_lines(const FieldBlock& block, const LineWords& words, std::uint32_t count, FieldLanes& lanes) {
    for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
        const VU piece = hn::Load(du, words.piece + i);
        const auto across = [&](int axis, const double* share) {
            const V lo = of_piece(block, piece, axis);
            return hn::Add(lo, hn::Mul(hn::Load(d, share + i), hn::Sub(of_piece(block, piece, 3 + axis), lo)));
        };
        hn::Store(across((a + 1) % 3, words.u), d, lanes.across[0] + i);
        hn::Store(across((a + 2) % 3, words.v), d, lanes.across[1] + i);
        hn::Store(of_piece(block, piece, a), d, lanes.lo + i);
        hn::Store(of_piece(block, piece, 3 + a), d, lanes.hi + i);
    }
}

/// Of the roots lanes.guess of n lines, those that are kept.
template <int a>
void keep_roots(const LineView& view, const FieldBlock& block, std::size_t n, const FieldLanes& lanes, PointChunk& out) {
    const V zero = hn::Zero(d);
    for (std::size_t i = 0; i < n; i += hn::Lanes(d)) {
        const VU piece = hn::Load(du, lanes.piece + i);
        const V3 x = turned<a>(hn::Load(d, lanes.guess + i), hn::Load(d, lanes.across[0] + i),
                               hn::Load(d, lanes.across[1] + i));
        const V3 g{hn::Load(d, lanes.gradient[0] + i), hn::Load(d, lanes.gradient[1] + i),
                   hn::Load(d, lanes.gradient[2] + i)};
        // Lanes beyond the last one hold what an earlier chunk left: gathers must not follow it.
        const Mask alive = hn::FirstN(d, n - i);
        const VU safe = hn::IfThenElseZero(hn::RebindMask(du, alive), piece);
        const V3 reach = turned<a>(of_piece(block, safe, 6), zero, zero);
        keep(view, x, g, reach, of_piece(block, safe, 7), hn::Load(d, lanes.chance + i), alive, piece,
             hn::Load(du, lanes.line + i), out);
    }
}

/// Lines through SurfaceCells.
template <int a>
void cells_along(const LineView& view, const FieldBlock& block, const LineWords& words, std::uint32_t count,
                 FieldLanes& lanes, PointChunk& out) {
    place_lines<a>(block, words, count, lanes);
    for (std::size_t i = 0; i < count; ++i) lanes.cell[i] = block.cell[words.piece[i]];
    AxisLines lines{a, count, lanes.cell, {}, lanes.lo, lanes.hi};
    lines.at[(a + 1) % 3] = lanes.across[0];
    lines.at[(a + 2) % 3] = lanes.across[1];
    block.cells->cross_along(lines, {lanes.guess, {lanes.gradient[0], lanes.gradient[1], lanes.gradient[2]}});
    std::size_t n = 0;
    for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
        const V root = hn::Load(d, lanes.guess + i);
        const Packer packed(hn::And(hn::FirstN(d, count - i), hn::Eq(root, root)));
        const auto put = [&](double* values) {
            const V value = hn::Load(d, values + i);
            hn::StoreU(packed(value), d, values + n);
        };
        put(lanes.guess);
        put(lanes.across[0]);
        put(lanes.across[1]);
        for (auto& part : lanes.gradient) put(part);
        hn::StoreU(packed(hn::Load(d, words.chance + i)), d, lanes.chance + n);
        hn::StoreU(packed(hn::Load(du, words.piece + i)), du, lanes.piece + n);
        hn::StoreU(packed(hn::Iota(du, i)), du, lanes.line + n);
        n += packed.count;
    }
    keep_roots<a>(view, block, n, lanes, out);
}

template <int a>
void fields_along(const LineView& view, const FieldBlock& block, const LineWords& words, std::uint32_t count,
                  FieldLanes& lanes, PointChunk& out) {
    constexpr int b = (a + 1) % 3;
    constexpr int c = (a + 2) % 3;
    const auto all = [](double value) { return hn::Set(d, value); };
    const V zero = hn::Zero(d);
    const std::size_t step = hn::Lanes(d);

    place_lines<a>(block, words, count, lanes);
    double* const at_lo[] = {lanes.f_lo};
    double* const at_hi[] = {lanes.f_hi};
    evaluate_lanes(block.programs->value, a, count, lanes, lanes.lo, at_lo);
    evaluate_lanes(block.programs->value, a, count, lanes, lanes.hi, at_hi);

    // Lines with a root move to the front; the secant's guess.
    std::size_t n = 0;
    for (std::size_t i = 0; i < count; i += step) {
        const V f0 = hn::Load(d, lanes.f_lo + i);
        const V f1 = hn::Load(d, lanes.f_hi + i);
        const Mask differ = hn::Xor(hn::Ge(f0, zero), hn::Ge(f1, zero));
        const Packer packed(hn::And(hn::FirstN(d, count - i), differ));
        const V lo = hn::Load(d, lanes.lo + i);
        const V hi = hn::Load(d, lanes.hi + i);
        const V across0 = hn::Load(d, lanes.across[0] + i);
        const V across1 = hn::Load(d, lanes.across[1] + i);
        const V secant = hn::Add(lo, hn::Mul(hn::Div(f0, hn::Sub(f0, f1)), hn::Sub(hi, lo)));
        const V guess = hn::Min(secant, hi);  // never an ulp beyond
        const auto put = [&](V value, double* to) { hn::StoreU(packed(value), d, to + n); };
        put(across0, lanes.across[0]);
        put(across1, lanes.across[1]);
        put(lo, lanes.lo);
        put(hi, lanes.hi);
        put(f0, lanes.f_lo);
        put(f1, lanes.f_hi);
        put(guess, lanes.guess);
        put(hn::Load(d, words.chance + i), lanes.chance);
        hn::StoreU(packed(hn::Load(du, words.piece + i)), du, lanes.piece + n);
        hn::StoreU(packed(hn::Iota(du, i)), du, lanes.line + n);
        n += packed.count;
    }
    if (n == 0) return;

    // The cubic t(f) through both ends and the guess with its slope, at f = 0.
    double* const with_slope[] = {lanes.value, lanes.gradient[a]};
    evaluate_lanes(block.programs->slope[a], a, n, lanes, lanes.guess, with_slope);
    for (std::size_t i = 0; i < n; i += step) {
        const V lo = hn::Load(d, lanes.lo + i);
        const V hi = hn::Load(d, lanes.hi + i);
        const V f0 = hn::Load(d, lanes.f_lo + i);
        const V f1 = hn::Load(d, lanes.f_hi + i);
        const V t0 = hn::Load(d, lanes.guess + i);
        const V f = hn::Load(d, lanes.value + i);
        const V per_slope = hn::Div(all(1.0), hn::Load(d, lanes.gradient[a] + i));
        const V from_lo = hn::Sub(f0, f);
        const V from_hi = hn::Sub(f1, f);
        const V bend_lo = hn::Div(hn::Sub(hn::Div(hn::Sub(lo, t0), from_lo), per_slope), from_lo);
        const V bend_hi = hn::Div(hn::Sub(hn::Div(hn::Sub(hi, t0), from_hi), per_slope), from_hi);
        const V turn = hn::Div(hn::Sub(bend_hi, bend_lo), hn::Sub(f1, f0));
        const V newton = hn::Sub(t0, hn::Mul(f, per_slope));
        const V t1 = hn::Add(newton, hn::Mul(hn::Mul(f, f), hn::Sub(bend_lo, hn::Mul(f0, turn))));
        const auto inside = [&](V t) { return hn::And(hn::Ge(t, lo), hn::Le(t, hi)); };
        hn::Store(hn::IfThenElse(inside(t1), t1, hn::IfThenElse(inside(newton), newton, t0)), d, lanes.guess + i);
    }

    // A step of Newton's for all, …
    double* const with_gradient[] = {lanes.value, lanes.gradient[0], lanes.gradient[1], lanes.gradient[2]};
    evaluate_lanes(block.programs->gradient, a, n, lanes, lanes.guess, with_gradient);
    std::size_t far = 0;
    for (std::size_t i = 0; i < n; i += step) {
        const V guess = hn::Load(d, lanes.guess + i);
        const V root = hn::Sub(guess, hn::Div(hn::Load(d, lanes.value + i), hn::Load(d, lanes.gradient[a] + i)));
        const V width = hn::Sub(hn::Load(d, lanes.hi + i), hn::Load(d, lanes.lo + i));
        const Mask close = hn::Le(hn::Abs(hn::Sub(root, guess)), hn::Mul(all(kSmallStep), width));
        hn::Store(root, d, lanes.guess + i);
        const Packer packed(hn::AndNot(close, hn::FirstN(d, n - i)));
        if (packed.count == 0) continue;
        hn::StoreU(packed(hn::Iota(du, i)), du, lanes.far + far);
        far += packed.count;
    }
    // … and more for the few that need it.
    for (int k = 1; k < kPlainSteps && far > 0; ++k) far = step_again<a>(block, lanes, far);
    for (std::size_t i = 0; i < far; ++i) {
        const std::size_t lane = lanes.far[i];
        std::array<double, 3> x{};
        x[b] = lanes.across[0][lane];
        x[c] = lanes.across[1][lane];
        const FieldStep slow =
            refine_slowly(block.programs->field, a, x, lanes.lo[lane], lanes.hi[lane], lanes.f_lo[lane] < 0);
        lanes.guess[lane] = slow.root;
        for (std::size_t axis = 0; axis < 3; ++axis) lanes.gradient[axis][lane] = slow.gradient[axis];
    }

    keep_roots<a>(view, block, n, lanes, out);
}

void fields(const LineView& view, const FieldBlock& block, const LineWords& words, std::uint32_t count,
            FieldLanes& lanes, PointChunk& out) {
    if (block.programs == nullptr) {
        if (block.axis == 0) return cells_along<0>(view, block, words, count, lanes, out);
        if (block.axis == 1) return cells_along<1>(view, block, words, count, lanes, out);
        return cells_along<2>(view, block, words, count, lanes, out);
    }
    if (block.axis == 0) return fields_along<0>(view, block, words, count, lanes, out);
    if (block.axis == 1) return fields_along<1>(view, block, words, count, lanes, out);
    fields_along<2>(view, block, words, count, lanes, out);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include <hwy/cache_control.h>

namespace pellucid {

HWY_EXPORT(fields);

void cross_fields(const LineView& view, const FieldBlock& block, const LineWords& words, std::uint32_t count,
                  PointChunk& out) {
    for (std::uint32_t i = 0; i < count; ++i) hwy::Prefetch(block.pieces + words.piece[i]);
    thread_local FieldLanes lanes;
    out.count = 0;
    HWY_DYNAMIC_DISPATCH(fields)(view, block, words, count, lanes, out);
}

}  // namespace pellucid
#endif
