#include "field/mpu_gradients.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "field/mpu_gradients_simd.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<double, kMpuPlaces>;
using V = hn::Vec<D>;
inline constexpr D d;

/// The arithmetic of mpu_gradient, operation by operation. Edges are powers of two: to divide by one is to multiply.
void gradients(const MpuLeaf* leaves, std::span<const std::uint32_t> list, const MpuPlaces& places, MpuPlaces& out) {
    const auto all = [](double value) { return hn::Set(d, value); };
    const V zero = hn::Zero(d);
    for (std::size_t i = 0; i < kMpuPlaces; i += hn::Lanes(d)) {
        const V x[3] = {hn::LoadU(d, places[0].data() + i), hn::LoadU(d, places[1].data() + i),
                        hn::LoadU(d, places[2].data() + i)};
        V weights = zero;
        V sum = zero;
        V gradient[3] = {zero, zero, zero};
        V weights_gradient[3] = {zero, zero, zero};
        for (const std::uint32_t number : list) {
            const MpuLeaf& leaf = leaves[number];
            const double edge = leaf.edge;
            const V per = all(1 / edge);
            V u[3];
            for (std::size_t k = 0; k < 3; ++k) u[k] = hn::Mul(hn::Sub(x[k], all(leaf.center[k])), per);
            const V u2 = hn::Add(hn::Add(hn::Mul(u[0], u[0]), hn::Mul(u[1], u[1])), hn::Mul(u[2], u[2]));
            const auto reached = hn::Lt(u2, all(kMpuSupport2));
            if (hn::AllFalse(d, reached)) continue;
            const V t2 = hn::Mul(all(kMpuPerEdge2), u2);
            const V t = hn::Sqrt(t2);
            const auto near = hn::Lt(t2, all(0.25));
            const V rest = hn::Sub(all(1.5), t);
            V w = hn::IfThenElse(near, hn::Sub(all(0.75), t2), hn::Mul(hn::Mul(all(0.5), rest), rest));
            w = hn::IfThenElseZero(reached, w);
            V slope = hn::IfThenElse(near, all(2 * kMpuPerEdge2),
                                     hn::Mul(all(kMpuPerEdge2), hn::Sub(hn::Div(all(1.5), t), all(1.0))));
            slope = hn::IfThenElseZero(hn::Gt(w, zero), slope);
            V c[10];
            for (std::size_t k = 0; k < 10; ++k) c[k] = all(leaf.q[k]);
            const auto term = [](V a, V b) { return hn::Mul(a, b); };
            const V along_x = hn::Add(hn::Add(hn::Add(c[1], term(c[4], u[0])), term(c[7], u[1])), term(c[8], u[2]));
            const V along_y = hn::Add(hn::Add(c[2], term(c[5], u[1])), term(c[9], u[2]));
            const V along_z = hn::Add(c[3], term(c[6], u[2]));
            const V value = hn::Add(hn::Add(hn::Add(c[0], term(u[0], along_x)), term(u[1], along_y)), term(u[2], along_z));
            const V q = hn::Mul(all(edge), value);
            const V twice = all(2.0);
            const auto bent = [&](std::size_t k, V at) { return hn::Mul(hn::Mul(twice, c[k]), at); };
            const V g[3] = {hn::Add(hn::Add(hn::Add(c[1], bent(4, u[0])), term(c[7], u[1])), term(c[8], u[2])),
                            hn::Add(hn::Add(hn::Add(c[2], bent(5, u[1])), term(c[7], u[0])), term(c[9], u[2])),
                            hn::Add(hn::Add(hn::Add(c[3], bent(6, u[2])), term(c[8], u[0])), term(c[9], u[1]))};
            const V steep = hn::Neg(hn::Mul(slope, per));
            weights = hn::Add(weights, w);
            sum = hn::Add(sum, hn::Mul(w, q));
            for (std::size_t k = 0; k < 3; ++k) {
                const V push = hn::Mul(steep, u[k]);
                weights_gradient[k] = hn::Add(weights_gradient[k], push);
                gradient[k] = hn::Add(gradient[k], hn::Add(hn::Mul(w, g[k]), hn::Mul(q, push)));
            }
        }
        const V f = hn::Div(sum, weights);
        for (std::size_t k = 0; k < 3; ++k)
            hn::StoreU(hn::Div(hn::Sub(gradient[k], hn::Mul(f, weights_gradient[k])), weights), d, out[k].data() + i);
    }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {

HWY_EXPORT(gradients);

MpuPlaces mpu_gradients(const MpuLeaf* leaves, std::span<const std::uint32_t> list, const MpuPlaces& places) {
    MpuPlaces out;
    HWY_DYNAMIC_DISPATCH(gradients)(leaves, list, places, out);
    return out;
}

}  // namespace pellucid
#endif
