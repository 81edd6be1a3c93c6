// The steps of brownian_walk.cpp over SIMD lanes, a walker a lane: Highway, with the instruction set chosen at run time.
// The same bits on every instruction set: + − × ÷ √ without fused multiply-add, and elementary-inl.h.
#include "sample/brownian_walk.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sample/brownian_simd.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/elementary-inl.h"
#include "sample/edge_lines-inl.h"
#include "sample/philox-inl.h"

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

/// As many corrections as all but few walkers need; the others are left to the scalar walk.
constexpr int kMostNewton = 4;

HWY_INLINE V all(double value) { return hn::Set(d, value); }
HWY_INLINE V3 scaled(V by, const V3& v) { return {hn::Mul(by, v.x), hn::Mul(by, v.y), hn::Mul(by, v.z)}; }
HWY_INLINE V3 added(const V3& a, const V3& b) { return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)}; }

struct Slope {
    V value, square;  // |gradient|²
    V3 gradient;
};

struct Pair {
    V first, second;
};
/// Box and Muller's, for u and v in (0, 1): elementary-inl.h without what is not met there.
HWY_INLINE Pair gaussian_pair(V u, V v) {
    // u = 2^k m, m in [√½, √2): ln u.
    const VU from_root_half = hn::Add(hn::BitCast(du, u), hn::Set(du, 0x3ff0000000000000ULL - 0x3fe6a09e667f3bcdULL));
    const VU mantissa = hn::Add(hn::And(from_root_half, hn::Set(du, 0x000fffffffffffffULL)), hn::Set(du, 0x3fe6a09e667f3bcdULL));
    const V biased = hn::BitCast(d, hn::Or(hn::ShiftRight<52>(from_root_half), hn::Set(du, 0x4330000000000000ULL)));
    const V k = hn::Sub(biased, all(0x1p52 + 1023));
    const V f = hn::Sub(hn::BitCast(d, mantissa), all(1));
    const V s = hn::Div(f, hn::Add(f, all(2)));
    const V z = hn::Mul(s, s);
    constexpr double kL[] = {1.479819860511658591e-01, 1.531383769920937332e-01, 1.818357216161805012e-01,
                             2.222219843214978396e-01, 2.857142874366239149e-01, 3.999999999940941908e-01,
                             6.666666666666735130e-01};
    const V half_square = hn::Mul(all(0.5), hn::Mul(f, f));
    const V tail = hn::Mul(s, hn::Add(half_square, hn::Mul(z, elementary::polynomial(d, z, kL))));
    const V log = hn::Add(hn::Mul(k, all(6.93147180559945286e-01)), hn::Add(hn::Sub(f, half_square), tail));
    const V radius = hn::Sqrt(hn::Mul(all(-2), log));

    // 2πv = a quarter of turns and what is left, in [−π/4, π/4].
    const V quarters = hn::Mul(all(4), v);
    const V whole = hn::Round(quarters);  // 0 … 4
    const V r = hn::Mul(hn::Sub(quarters, whole), all(1.57079632679489661923));
    const V r2 = hn::Mul(r, r);
    constexpr double kS[] = {1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06,
                             -1.98412698298579493134e-04, 8.33333333332248946124e-03, -1.66666666666666324348e-01};
    constexpr double kC[] = {-1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07,
                             2.48015872894767294178e-05, -1.38888888888741095749e-03, 4.16666666666666019037e-02};
    const V sine = hn::Add(r, hn::Mul(hn::Mul(r, r2), elementary::polynomial(d, r2, kS)));
    const V cosine = hn::Add(hn::Sub(all(1), hn::Mul(all(0.5), r2)), hn::Mul(hn::Mul(r2, r2), elementary::polynomial(d, r2, kC)));
    // The last bits of `whole` say where to: odd quarters swap, signs follow.
    const VU turn = hn::BitCast(du, hn::Add(whole, all(0x1p52)));
    const Mask odd = hn::MaskFromVec(hn::BitCast(d, hn::Sub(hn::Zero(du), hn::And(turn, hn::Set(du, 1)))));
    const VU sine_sign = hn::ShiftLeft<62>(hn::And(turn, hn::Set(du, 2)));
    const VU cosine_sign = hn::ShiftLeft<62>(hn::And(hn::Add(turn, hn::Set(du, 1)), hn::Set(du, 2)));
    const V ca = hn::Xor(hn::IfThenElse(odd, sine, cosine), hn::BitCast(d, cosine_sign));
    const V sa = hn::Xor(hn::IfThenElse(odd, cosine, sine), hn::BitCast(d, sine_sign));
    return {hn::Mul(radius, ca), hn::Mul(radius, sa)};
}

template <bool torus>
HWY_INLINE Slope slope(const QuickWalk& w, const V3& x) {
    if constexpr (torus) {
        const V rho = hn::Sqrt(hn::Add(hn::Mul(x.x, x.x), hn::Mul(x.y, x.y)));
        const V ring = hn::Sub(rho, all(w.major));
        const V inward = hn::Add(hn::Div(ring, rho), hn::Div(ring, rho));
        const V tube = hn::Add(hn::Mul(ring, ring), hn::Mul(x.z, x.z));
        return {hn::Sub(tube, all(w.minor * w.minor)), hn::Mul(all(4), tube), {hn::Mul(inward, x.x), hn::Mul(inward, x.y), hn::Add(x.z, x.z)}};
    } else {
        const V3 bent{hn::Mul(all(w.square[0]), x.x), hn::Mul(all(w.square[1]), x.y), hn::Mul(all(w.square[2]), x.z)};
        const V3 sum = added(bent, {all(w.linear[0]), all(w.linear[1]), all(w.linear[2])});
        const V3 gradient = added(sum, bent);
        return {hn::Add(dot3(sum, x), all(w.constant)), dot3(gradient, gradient), gradient};
    }
}

/// Tr(HP) = Tr H − n·Hn.
template <bool torus>
HWY_INLINE V bending(const QuickWalk& w, const V3& x, const V3& n) {
    if constexpr (torus) {
        // H = 2 − (2R/ρ) tt, t the unit vector around the axis: Tr(HP) = 4 − (2R/ρ)(1 − (n·t)²), and n·t = 0.
        const V rho = hn::Sqrt(hn::Add(hn::Mul(x.x, x.x), hn::Mul(x.y, x.y)));
        return hn::Sub(all(4), hn::Div(all(2 * w.major), rho));
    } else {
        const V3 square{hn::Mul(n.x, n.x), hn::Mul(n.y, n.y), hn::Mul(n.z, n.z)};
        const V3 q{all(2 * w.square[0]), all(2 * w.square[1]), all(2 * w.square[2])};
        return hn::Sub(all(2 * (w.square[0] + w.square[1] + w.square[2])), dot3(q, square));
    }
}

template <bool torus>
void walk_lanes(const QuickWalk& w, std::uint64_t seed, const DrawKey& key, const HerdArrays& herd, std::size_t count,
                std::vector<std::uint32_t>& left) {
    const RoundKeys rounds(seed);
    const V one = all(1);
    const VU low = hn::Set(du, key.index & 0xffffffffU);
    const std::uint64_t high = (key.index >> 32U) | std::uint64_t{key.block} << 24U;
    for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
        const auto load = [&](const std::array<double*, 3>& from) {
            return V3{hn::LoadU(d, from[0] + i), hn::LoadU(d, from[1] + i), hn::LoadU(d, from[2] + i)};
        };
        const V3 from = load(herd.at);
        const V3 g = load(herd.gradient);

        Words bits[1];
        philox(low, {hn::Iota(du, high + i)}, key.repeat, key.object, rounds, bits);
        hn::StoreU(unit(bits[0].w[2]), d, herd.chance + i);
        const Pair noise = gaussian_pair(unit(bits[0].w[0]), unit(bits[0].w[1]));
        const V first = hn::Mul(all(w.step), noise.first);
        const V second = hn::Mul(all(w.step), noise.second);

        // dx^(T) in a basis of the tangent plane.
        const V inverse = hn::Div(one, hn::Sqrt(dot3(g, g)));
        const V3 n = scaled(inverse, g);
        const V sign = hn::CopySign(one, n.z);
        const V a = hn::Div(all(-1), hn::Add(sign, n.z));
        const V b = hn::Mul(hn::Mul(n.x, n.y), a);
        const V sx = hn::Mul(sign, n.x);
        const V3 t1{hn::Add(one, hn::Mul(hn::Mul(sx, n.x), a)), hn::Mul(sign, b), hn::Neg(sx)};
        const V3 t2{b, hn::Add(sign, hn::Mul(hn::Mul(n.y, n.y), a)), hn::Neg(n.y)};
        V3 x = added(from, added(scaled(first, t1), scaled(second, t2)));
        if (w.drift)
            x = added(x, scaled(hn::Mul(hn::Mul(all(-0.5 * w.step * w.step), bending<torus>(w, from, n)), inverse), n));

        // Back to the surface.
        V3 gradient = g;
        V last = all(kInfinity);  // squares of distances
        Mask going = hn::FirstN(d, count - i);
        Mask done = hn::Lt(one, hn::Zero(d));
        for (int k = 0; k < kMostNewton && !hn::AllFalse(d, going); ++k) {
            const Slope f = slope<torus>(w, x);
            const V share = hn::Div(f.value, f.square);
            const V distance = hn::Mul(share, f.value);
            going = hn::And(going, hn::And(hn::Le(distance, all(w.reach * w.reach)), hn::Le(distance, hn::Mul(all(4), last))));
            const V by = hn::IfThenElseZero(going, share);
            x = {hn::Sub(x.x, hn::Mul(by, f.gradient.x)), hn::Sub(x.y, hn::Mul(by, f.gradient.y)),
                 hn::Sub(x.z, hn::Mul(by, f.gradient.z))};
            gradient = {hn::IfThenElse(going, f.gradient.x, gradient.x), hn::IfThenElse(going, f.gradient.y, gradient.y),
                        hn::IfThenElse(going, f.gradient.z, gradient.z)};
            const Mask near = hn::And(going, hn::Le(distance, all(w.near * w.near)));
            done = hn::Or(done, near);
            going = hn::AndNot(near, going);
            last = distance;
        }
        for (const QuickWalk::Plane& plane : w.planes)
            done = hn::And(done, hn::Le(hn::Sub(dot3(plane.normal_offset, x), all(plane.normal_offset[3])), all(w.hair)));

        const auto store = [&](const V3& moved, const V3& was, const std::array<double*, 3>& to) {
            hn::StoreU(hn::IfThenElse(done, moved.x, was.x), d, to[0] + i);
            hn::StoreU(hn::IfThenElse(done, moved.y, was.y), d, to[1] + i);
            hn::StoreU(hn::IfThenElse(done, moved.z, was.z), d, to[2] + i);
        };
        store(x, from, herd.at);
        store(gradient, g, herd.gradient);
        const Mask lost = hn::AndNot(done, hn::FirstN(d, count - i));
        if (hn::AllFalse(d, lost)) continue;
        std::uint8_t lanes[8] = {};
        (void)hn::StoreMaskBits(d, lost, lanes);
        for (std::uint32_t lane = 0; lane < hn::Lanes(d); ++lane)
            if ((lanes[lane / 8] >> (lane % 8) & 1U) != 0) left.push_back(static_cast<std::uint32_t>(i) + lane);
    }
}

void walk_all(const QuickWalk& w, std::uint64_t seed, const DrawKey& key, const HerdArrays& herd, std::size_t count,
              std::vector<std::uint32_t>& left) {
    if (w.torus) return walk_lanes<true>(w, seed, key, herd, count, left);
    walk_lanes<false>(w, seed, key, herd, count, left);
}

void keep_lanes(const LineView& view, double bound, const HerdArrays& herd, std::size_t first, std::size_t count,
                PointChunk& out) {
    for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
        const auto load = [&](const std::array<double*, 3>& from) {
            return V3{hn::LoadU(d, from[0] + first + i), hn::LoadU(d, from[1] + first + i), hn::LoadU(d, from[2] + first + i)};
        };
        const V3 x = load(herd.at);
        const V3 g = load(herd.gradient);
        const auto place = [&](std::size_t k) { return hn::Add(dot3(view.to_view[k], x), all(view.to_view[k][3])); };
        const V3 at{place(0), place(1), place(2)};
        const V3 normal{dot3(view.normal[0], g), dot3(view.normal[1], g), dot3(view.normal[2], g)};
        // w·(least s)/s = B |n·r|/(|n| z³) or B |r|/z³, r the way from the eye; orthographic: B |n_z|/|n| or B.
        const V chance = hn::LoadU(d, herd.chance + first + i);
        const V z = view.perspective ? at.z : all(1);
        const V paid = hn::Mul(chance, hn::Mul(hn::Mul(z, z), z));
        V left = paid;
        V right = all(bound);
        if (view.constant_law) {
            left = hn::Mul(paid, hn::Sqrt(dot3(normal, normal)));
            right = hn::Mul(right, hn::Abs(view.perspective ? dot3(normal, at) : normal.z));
        } else if (view.perspective) {
            right = hn::Mul(right, hn::Sqrt(dot3(at, at)));
        }
        const Mask alive = hn::And(hn::FirstN(d, count - i), hn::And(in_view(view, at), hn::Lt(left, right)));
        const VU lane = hn::Iota(du, i);
        append(out, alive, at, normal, x, lane, lane);
    }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {

HWY_EXPORT(walk_all);
HWY_EXPORT(keep_lanes);

void keep_herd(const LineView& view, double bound, const HerdArrays& herd, std::size_t first, std::size_t count, PointChunk& out) {
    out.count = 0;
    HWY_DYNAMIC_DISPATCH(keep_lanes)(view, bound, herd, first, count, out);
}

void walk_herd(const QuickWalk& walk, Seed seed, const DrawKey& key, const HerdArrays& herd, std::size_t count,
               std::vector<std::uint32_t>& left) {
    HWY_DYNAMIC_DISPATCH(walk_all)(walk, seed.value, key, herd, count, left);
}

}  // namespace pellucid
#endif
