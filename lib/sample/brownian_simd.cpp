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
    V value;
    V3 gradient;
};

template <bool torus>
HWY_INLINE Slope slope(const QuickWalk& w, const V3& x) {
    if constexpr (torus) {
        const V rho = hn::Sqrt(hn::Add(hn::Mul(x.x, x.x), hn::Mul(x.y, x.y)));
        const V ring = hn::Sub(rho, all(w.major));
        const V inward = hn::Add(hn::Div(ring, rho), hn::Div(ring, rho));
        const V value = hn::Sub(hn::Add(hn::Mul(ring, ring), hn::Mul(x.z, x.z)), all(w.minor * w.minor));
        return {value, {hn::Mul(inward, x.x), hn::Mul(inward, x.y), hn::Add(x.z, x.z)}};
    } else {
        const V3 bent{hn::Mul(all(w.square[0]), x.x), hn::Mul(all(w.square[1]), x.y), hn::Mul(all(w.square[2]), x.z)};
        const V3 sum = added(bent, {all(w.linear[0]), all(w.linear[1]), all(w.linear[2])});
        return {hn::Add(dot3(sum, x), all(w.constant)), added(sum, bent)};
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

        // Two Gaussian numbers.
        Words bits[1];
        philox(low, {hn::Iota(du, high + i)}, key.repeat, key.object, rounds, bits);
        const V radius = hn::Mul(all(w.step), hn::Sqrt(hn::Mul(all(-2), elementary::log(d, unit(bits[0].w[0])))));
        const auto turn = elementary::sin_cos(d, hn::Mul(all(6.283185307179586477), unit(bits[0].w[1])));
        const V first = hn::Mul(radius, turn.cos);
        const V second = hn::Mul(radius, turn.sin);

        // dx^(T) in a basis of the tangent plane.
        const V square = dot3(g, g);
        const V3 n = scaled(hn::Div(one, hn::Sqrt(square)), g);
        const V sign = hn::CopySign(one, n.z);
        const V a = hn::Div(all(-1), hn::Add(sign, n.z));
        const V b = hn::Mul(hn::Mul(n.x, n.y), a);
        const V sx = hn::Mul(sign, n.x);
        const V3 t1{hn::Add(one, hn::Mul(hn::Mul(sx, n.x), a)), hn::Mul(sign, b), hn::Neg(sx)};
        const V3 t2{b, hn::Add(sign, hn::Mul(hn::Mul(n.y, n.y), a)), hn::Neg(n.y)};
        V3 x = added(from, added(scaled(first, t1), scaled(second, t2)));
        if (w.drift) x = added(x, scaled(hn::Div(hn::Mul(all(-0.5 * w.step * w.step), bending<torus>(w, from, n)), square), g));

        // Back to the surface.
        V3 gradient = g;
        V last = all(kInfinity);
        Mask going = hn::FirstN(d, count - i);
        Mask done = hn::Lt(one, hn::Zero(d));
        for (int k = 0; k < kMostNewton && !hn::AllFalse(d, going); ++k) {
            const Slope f = slope<torus>(w, x);
            const V s = dot3(f.gradient, f.gradient);
            const V distance = hn::Div(hn::Abs(f.value), hn::Sqrt(s));
            const Mask good = hn::And(hn::Le(distance, all(w.reach)), hn::Le(distance, hn::Add(last, last)));
            going = hn::And(going, good);
            const V by = hn::IfThenElseZero(going, hn::Div(f.value, s));
            x = {hn::Sub(x.x, hn::Mul(by, f.gradient.x)), hn::Sub(x.y, hn::Mul(by, f.gradient.y)),
                 hn::Sub(x.z, hn::Mul(by, f.gradient.z))};
            gradient = {hn::IfThenElse(going, f.gradient.x, gradient.x), hn::IfThenElse(going, f.gradient.y, gradient.y),
                        hn::IfThenElse(going, f.gradient.z, gradient.z)};
            const Mask near = hn::And(going, hn::Le(distance, all(w.near)));
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

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {

HWY_EXPORT(walk_all);

void walk_herd(const QuickWalk& walk, Seed seed, const DrawKey& key, const HerdArrays& herd, std::size_t count,
               std::vector<std::uint32_t>& left) {
    HWY_DYNAMIC_DISPATCH(walk_all)(walk, seed.value, key, herd, count, left);
}

}  // namespace pellucid
#endif
