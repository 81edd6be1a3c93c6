#include "field/mpu_lanes.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "field/mpu_lanes_simd.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef PELLUCID_FIELD_MPU_LANES
#define PELLUCID_FIELD_MPU_LANES
namespace pellucid {
namespace {

constexpr std::size_t kMostLanes = 8;
/// Steps of Newton's, or halvings, before a line is given up; a step below this share of the bracket is the last.
constexpr int kMostSteps = 60;
constexpr double kLastLaneStep = 0x1p-26;  // Newton's errors are squared: 2^-52

constexpr std::size_t kRows = kMpuLaneLeaves + 1;  // one to be overwritten

/// A local fit on its line: Q = a0 + o (a1 + o a2) with o = (x − middle)·per; weights by near2 + o².
struct alignas(64) LaneFits {
    using Row = double[kMostLanes];
    Row a0[kRows], a1[kRows], a2[kRows];
    Row middle[kRows], per[kRows], near2[kRows];
    Row off[2][kRows];                           // across, in edges
    Row across[2][kRows], bend[2][kRows];  // ∂Q/∂across = across + o·bend
};

}  // namespace
}  // namespace pellucid
#endif

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<double, kMostLanes>;
using V = hn::Vec<D>;
using Mask = hn::Mask<D>;
inline constexpr D d;

/// Number of c_ab in MpuLeaf::q.
constexpr std::size_t kMixed[3][3] = {{4, 7, 8}, {7, 5, 9}, {8, 9, 6}};

/// 1/2^k, by the bits of its exponent: what edges of an octree's leaves are.
[[nodiscard]] double over_power_of_two(float x) {
    return static_cast<double>(std::bit_cast<float>(0x7f000000U - std::bit_cast<std::uint32_t>(x)));
}

/// The fits that reach a line between its ends; how many.
template <std::size_t a>
std::size_t restrict_fits(const MpuLeaf* leaves, const MpuLaneLine& line, std::size_t lane, LaneFits& fits) {
    constexpr std::size_t b = (a + 1) % 3;
    constexpr std::size_t c = (a + 2) % 3;
    const double line_middle = 0.5 * (line.lo + line.hi);
    const double line_half = 0.5 * (line.hi - line.lo) * (1 + 1e-9);
    // One in two reaches the line, in no order that a branch could learn: what is not counted is overwritten.
    std::uint32_t reach[kRows];
    std::size_t count = 0;
    for (const std::uint32_t number : line.leaves) {
        const MpuLeaf& leaf = leaves[number];
        const double edge = leaf.edge;
        const double u = line.at[0] - static_cast<double>(leaf.center[b]);
        const double v = line.at[1] - static_cast<double>(leaf.center[c]);
        const double ahead = std::abs(line_middle - static_cast<double>(leaf.center[a])) - line_half;
        const double beside = 0.5 * (ahead + std::abs(ahead));  // the larger of it and 0, exactly, without a branch
        reach[count] = number;
        count += u * u + v * v + beside * beside < kMpuSupport2 * (edge * edge) ? 1U : 0U;
    }
    for (std::size_t n = 0; n < count; ++n) {
        const MpuLeaf& leaf = leaves[reach[n]];
        const double edge = leaf.edge;
        const double per = over_power_of_two(leaf.edge);
        const double middle = leaf.center[a];
        const double u = (line.at[0] - static_cast<double>(leaf.center[b])) * per;
        const double v = (line.at[1] - static_cast<double>(leaf.center[c])) * per;
        const double near2 = u * u + v * v;
        const auto q = [&](std::size_t i) { return static_cast<double>(leaf.q[i]); };
        const double qb = q(1 + b) + u * q(kMixed[b][b]) + v * q(kMixed[b][c]);
        fits.a0[n][lane] = edge * (q(0) + u * qb + v * (q(1 + c) + v * q(kMixed[c][c])));
        fits.a1[n][lane] = edge * (q(1 + a) + u * q(kMixed[a][b]) + v * q(kMixed[a][c]));
        fits.a2[n][lane] = edge * q(kMixed[a][a]);
        fits.middle[n][lane] = middle;
        fits.per[n][lane] = per;
        fits.near2[n][lane] = near2;
        fits.off[0][n][lane] = u;
        fits.off[1][n][lane] = v;
        fits.across[0][n][lane] = qb + u * q(kMixed[b][b]);
        fits.across[1][n][lane] = q(1 + c) + 2 * (v * q(kMixed[c][c])) + u * q(kMixed[b][c]);
        fits.bend[0][n][lane] = q(kMixed[a][b]);
        fits.bend[1][n][lane] = q(kMixed[a][c]);
    }
    return count;
}

// At the ball's surface rest is 0 to the last bit.
static_assert(kMpuPerEdge2 * kMpuSupport2 == 2.25);
/// Rows without a fit: beyond a ball, of weight 0. What else is in them is of another line, and finite.
void clear_fits(std::size_t from, std::size_t to, std::size_t lane, LaneFits& fits) {
    for (std::size_t n = from; n < to; ++n) fits.near2[n][lane] = 2 * kMpuSupport2;
}

struct LaneWeight {
    V value, slope;
};

/// MpuWeight of |u|².
HWY_INLINE LaneWeight weight(V u2) {
    const auto all = [](double x) { return hn::Set(d, x); };
    const V t2 = hn::Mul(all(kMpuPerEdge2), hn::Min(u2, all(kMpuSupport2)));
    const V t = hn::Sqrt(t2);
    const Mask near = hn::Lt(t2, all(0.25));
    const V rest = hn::Max(hn::Sub(all(1.5), t), hn::Zero(d));
    const V value = hn::IfThenElse(near, hn::Sub(all(0.75), t2), hn::Mul(all(0.5), hn::Mul(rest, rest)));
    const V slope = hn::Mul(all(kMpuPerEdge2), hn::IfThenElse(near, all(2.0), hn::Div(rest, hn::Max(t, all(0.25)))));
    return {value, slope};
}

/// Only its sign is right: f·Σw.
HWY_INLINE V value_at(const LaneFits& fits, std::size_t count, V x) {
    const auto all = [](double value) { return hn::Set(d, value); };
    V sum = hn::Zero(d);
    for (std::size_t n = 0; n < count; ++n) {
        const V off = hn::Mul(hn::Sub(x, hn::Load(d, fits.middle[n])), hn::Load(d, fits.per[n]));
        const V u2 = hn::Add(hn::Load(d, fits.near2[n]), hn::Mul(off, off));
        const V t2 = hn::Mul(all(kMpuPerEdge2), hn::Min(u2, all(kMpuSupport2)));
        const V rest = hn::Max(hn::Sub(all(1.5), hn::Sqrt(t2)), hn::Zero(d));
        const V w =
            hn::IfThenElse(hn::Lt(t2, all(0.25)), hn::Sub(all(0.75), t2), hn::Mul(all(0.5), hn::Mul(rest, rest)));
        const V q = hn::Add(hn::Load(d, fits.a0[n]),
                            hn::Mul(off, hn::Add(hn::Load(d, fits.a1[n]), hn::Mul(off, hn::Load(d, fits.a2[n])))));
        sum = hn::Add(sum, hn::Mul(w, q));
    }
    return sum;
}

struct ValueSlope {
    V value, slope;
};
HWY_INLINE ValueSlope slope_at(const LaneFits& fits, std::size_t count, V x) {
    V sum = hn::Zero(d);
    V weights = hn::Zero(d);
    V sum_slope = hn::Zero(d);
    V weights_slope = hn::Zero(d);
    for (std::size_t n = 0; n < count; ++n) {
        const V per = hn::Load(d, fits.per[n]);
        const V off = hn::Mul(hn::Sub(x, hn::Load(d, fits.middle[n])), per);
        const LaneWeight w = weight(hn::Add(hn::Load(d, fits.near2[n]), hn::Mul(off, off)));
        const V a1 = hn::Load(d, fits.a1[n]);
        const V bent = hn::Mul(off, hn::Load(d, fits.a2[n]));
        const V q = hn::Add(hn::Load(d, fits.a0[n]), hn::Mul(off, hn::Add(a1, bent)));
        const V dq = hn::Mul(per, hn::Add(a1, hn::Add(bent, bent)));
        const V dw = hn::Neg(hn::Mul(hn::Mul(w.slope, off), per));
        sum = hn::Add(sum, hn::Mul(w.value, q));
        weights = hn::Add(weights, w.value);
        sum_slope = hn::Add(sum_slope, hn::Add(hn::Mul(w.value, dq), hn::Mul(dw, q)));
        weights_slope = hn::Add(weights_slope, dw);
    }
    const V f = hn::Div(sum, weights);
    return {f, hn::Div(hn::Sub(sum_slope, hn::Mul(f, weights_slope)), weights)};
}

/// ∇f along the axis and the two after it.
HWY_INLINE void gradient_at(const LaneFits& fits, std::size_t count, V x, V (&gradient)[3]) {
    V sum = hn::Zero(d);
    V weights = hn::Zero(d);
    V g[3] = {sum, sum, sum};
    V push[3] = {sum, sum, sum};
    for (std::size_t n = 0; n < count; ++n) {
        const V per = hn::Load(d, fits.per[n]);
        const V off = hn::Mul(hn::Sub(x, hn::Load(d, fits.middle[n])), per);
        const LaneWeight w = weight(hn::Add(hn::Load(d, fits.near2[n]), hn::Mul(off, off)));
        const V a1 = hn::Load(d, fits.a1[n]);
        const V bent = hn::Mul(off, hn::Load(d, fits.a2[n]));
        const V q = hn::Add(hn::Load(d, fits.a0[n]), hn::Mul(off, hn::Add(a1, bent)));
        const V steep = hn::Mul(w.slope, per);
        const V dq[3] = {
            hn::Mul(per, hn::Add(a1, hn::Add(bent, bent))),
            hn::Add(hn::Load(d, fits.across[0][n]), hn::Mul(off, hn::Load(d, fits.bend[0][n]))),
            hn::Add(hn::Load(d, fits.across[1][n]), hn::Mul(off, hn::Load(d, fits.bend[1][n])))};
        const V du[3] = {off, hn::Load(d, fits.off[0][n]), hn::Load(d, fits.off[1][n])};
        sum = hn::Add(sum, hn::Mul(w.value, q));
        weights = hn::Add(weights, w.value);
        for (std::size_t k = 0; k < 3; ++k) {
            const V dw = hn::Neg(hn::Mul(steep, du[k]));
            g[k] = hn::Add(g[k], hn::Add(hn::Mul(w.value, dq[k]), hn::Mul(dw, q)));
            push[k] = hn::Add(push[k], dw);
        }
    }
    const V f = hn::Div(sum, weights);
    for (std::size_t k = 0; k < 3; ++k) gradient[k] = hn::Div(hn::Sub(g[k], hn::Mul(f, push[k])), weights);
}

/// The lines in `fits`.
template <std::size_t a>
void cross_vector(const LaneFits& fits, std::size_t count, MpuLaneLine* lines, std::size_t line_count) {
    alignas(64) double lo_of[kMostLanes] = {};
    alignas(64) double hi_of[kMostLanes] = {};
    for (std::size_t i = 0; i < line_count; ++i) {
        lo_of[i] = lines[i].lo;
        hi_of[i] = lines[i].hi;
    }
    const V zero = hn::Zero(d);
    V lo = hn::Load(d, lo_of);
    V hi = hn::Load(d, hi_of);
    const V f_lo = value_at(fits, count, lo);
    const V f_hi = value_at(fits, count, hi);
    const Mask rising = hn::Lt(f_lo, zero);
    const Mask crosses = hn::And(hn::Xor(rising, hn::Lt(f_hi, zero)), hn::FirstN(d, line_count));
    for (std::size_t i = 0; i < line_count; ++i) lines[i].root = std::numeric_limits<double>::quiet_NaN();
    if (hn::AllFalse(d, crosses)) return;

    const V half = hn::Set(d, 0.5);
    const V width = hn::Sub(hi, lo);
    const V small = hn::Mul(width, hn::Set(d, kLastLaneStep));
    V x = hn::Add(lo, hn::Mul(hn::Div(f_lo, hn::Sub(f_lo, f_hi)), width));
    V last = width;
    Mask open = crosses;
    for (int step = 0; step < kMostSteps && !hn::AllFalse(d, open); ++step) {
        const V middle = hn::Add(lo, hn::Mul(half, hn::Sub(hi, lo)));
        const V at = hn::IfThenElse(hn::And(hn::Ge(x, lo), hn::Le(x, hi)), x, middle);
        const ValueSlope f = slope_at(fits, count, at);
        const Mask before = hn::Xor(hn::Lt(f.value, zero), hn::Not(rising));  // on the side of lo
        lo = hn::IfThenElse(hn::And(open, before), at, lo);
        hi = hn::IfThenElse(hn::AndNot(before, open), at, hi);
        const V newton = hn::Sub(at, hn::Div(f.value, f.slope));
        const Mask good = hn::And(hn::And(hn::Ge(newton, lo), hn::Le(newton, hi)),
                                  hn::Le(hn::Abs(hn::Sub(newton, at)), hn::Mul(half, last)));
        const V next = hn::IfThenElse(good, newton, hn::Add(lo, hn::Mul(half, hn::Sub(hi, lo))));
        const V moved = hn::Abs(hn::Sub(next, at));
        x = hn::IfThenElse(open, next, x);
        last = hn::IfThenElse(open, moved, last);
        open = hn::And(open, hn::Gt(moved, small));
    }
    V gradient[3];
    gradient_at(fits, count, x, gradient);
    alignas(64) double root[kMostLanes];
    alignas(64) double g[3][kMostLanes];
    hn::Store(x, d, root);
    for (std::size_t k = 0; k < 3; ++k) hn::Store(gradient[k], d, g[k]);
    alignas(64) double met[kMostLanes];
    hn::Store(hn::IfThenElseZero(crosses, hn::Set(d, 1.0)), d, met);
    for (std::size_t i = 0; i < line_count; ++i) {
        if (met[i] == 0) continue;
        lines[i].root = root[i];
        for (std::size_t k = 0; k < 3; ++k) lines[i].gradient[(a + k) % 3] = g[k][i];
    }
}

template <std::size_t a>
void cross_axis(const MpuLeaf* leaves, std::span<MpuLaneLine> lines) {
    thread_local LaneFits fits;
    const std::size_t lanes = hn::Lanes(d);
    for (std::size_t i = 0; i < lines.size(); i += lanes) {
        const std::size_t n = std::min(lanes, lines.size() - i);
        // Lists two vectors ahead, the leaves that they name one.
        for (std::size_t k = i + 2 * lanes; k < std::min(i + 3 * lanes, lines.size()); ++k)
            for (std::size_t byte = 0; byte < lines[k].leaves.size_bytes(); byte += 64)
                __builtin_prefetch(reinterpret_cast<const char*>(lines[k].leaves.data()) + byte);
        if (i + lanes < lines.size())
            for (std::size_t k = 0; k < std::min(lanes, lines.size() - i - lanes); ++k)
                for (const std::uint32_t leaf : lines[i + lanes + k].leaves) __builtin_prefetch(leaves + leaf);
        std::size_t count[kMostLanes] = {};
        std::size_t most = 0;
        for (std::size_t lane = 0; lane < n; ++lane) {
            count[lane] = restrict_fits<a>(leaves, lines[i + lane], lane, fits);
            most = std::max(most, count[lane]);
        }
        for (std::size_t lane = 0; lane < lanes; ++lane) clear_fits(lane < n ? count[lane] : 0, most, lane, fits);
        cross_vector<a>(fits, most, lines.data() + i, n);
    }
}

void cross_lanes(const MpuLeaf* leaves, std::size_t axis, std::span<MpuLaneLine> lines) {
    if (axis == 0) return cross_axis<0>(leaves, lines);
    if (axis == 1) return cross_axis<1>(leaves, lines);
    cross_axis<2>(leaves, lines);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {

HWY_EXPORT(cross_lanes);

void cross_mpu_lanes(const MpuLeaf* leaves, std::size_t axis, std::span<MpuLaneLine> lines) {
    HWY_DYNAMIC_DISPATCH(cross_lanes)(leaves, axis, lines);
}

}  // namespace pellucid
#endif
