// SIMD of kernel/math_twin.h, normal_twin.h and shading_twin.h: the same operations in the same order, so the
// same bits. What drawing particles and casting rays share.
//
// A Highway header: it may be included once for every target.
#if defined(PELLUCID_CPU_TWIN_SIMD_INL) == defined(HWY_TARGET_TOGGLE)
#ifdef PELLUCID_CPU_TWIN_SIMD_INL
#undef PELLUCID_CPU_TWIN_SIMD_INL
#else
#define PELLUCID_CPU_TWIN_SIMD_INL
#endif

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using F = hn::ScalableTag<float>;
using U = hn::RebindToUnsigned<F>;
using I = hn::RebindToSigned<F>;

using V = hn::Vec<F>;

[[nodiscard]] HWY_INLINE V set(float value) {
    return hn::Set(F(), value);
}

/// a + b·c: two roundings, as in the twins.
[[nodiscard]] HWY_INLINE V add_product(V a, V b, V c) {
    return hn::Add(a, hn::Mul(b, c));
}

struct V3 {
    V x, y, z;
};

[[nodiscard]] HWY_INLINE V dot(const V3& a, const V3& b) {
    return add_product(add_product(hn::Mul(a.x, b.x), a.y, b.y), a.z, b.z);
}

[[nodiscard]] HWY_INLINE V quick_rsqrt(V x) {
    const U u;
    const V half_x = hn::Mul(set(0.5F), x);
    V y = hn::BitCast(F(), hn::Sub(hn::Set(u, 0x5f3759dfU), hn::ShiftRight<1>(hn::BitCast(u, x))));
    for (int step = 0; step < 2; ++step) {
        const V e = hn::Sub(set(0.5F), hn::Mul(hn::Mul(half_x, y), y));
        y = add_product(y, y, hn::Mul(e, add_product(set(1.0F), set(1.5F), e)));
    }
    return y;
}

[[nodiscard]] HWY_INLINE V quick_log2(V x) {
    const I s;
    const auto bits = hn::BitCast(s, x);
    const auto k = hn::ShiftRight<23>(hn::Sub(bits, hn::Set(s, 0x3f3504f3)));
    const V f = hn::Sub(hn::BitCast(F(), hn::Sub(bits, hn::ShiftLeft<23>(k))), set(1.0F));
    const auto line = [&](float c0, float c1) { return add_product(set(c0), f, set(c1)); };
    const V f2 = hn::Mul(f, f);
    const V f4 = hn::Mul(f2, f2);
    const V low = add_product(line(1.44269502F, -0.721347332F), f2, line(0.480910629F, -0.360703677F));
    const V high = add_product(line(0.287916243F, -0.238944829F), f2, line(0.215715617F, -0.207269683F));
    return add_product(hn::ConvertTo(F(), k), f,
                       add_product(low, f4, add_product(high, f4, set(0.125836894F))));
}

[[nodiscard]] HWY_INLINE V quick_exp2(V t) {
    const I s;
    const auto n = hn::Sub(hn::BitCast(s, hn::Add(t, set(12582912.0F))), hn::Set(s, 0x4b400000));
    const V r = hn::Sub(t, hn::ConvertTo(F(), n));
    const auto line = [&](float c0, float c1) { return add_product(set(c0), r, set(c1)); };
    const V r2 = hn::Mul(r, r);
    const V high = add_product(line(0.00961848907F, 0.00133999309F), r2, set(0.00015345811F));
    const V low = add_product(line(1.0F, 0.693147182F), r2, line(0.240226462F, 0.0555032864F));
    const auto scaled =
        hn::Add(hn::BitCast(s, add_product(low, hn::Mul(r2, r2), high)), hn::ShiftLeft<23>(n));
    return hn::BitCast(F(), hn::IfThenZeroElse(hn::Lt(n, hn::Set(s, -125)), scaled));
}

/// The two halves of quick_power(x, y): its exponent, and what it is raised from.
[[nodiscard]] HWY_INLINE V power_exponent(V x, float y) {
    return hn::Max(hn::Mul(set(y), quick_log2(hn::Max(x, set(1.17549435e-38F)))), set(-150.0F));
}
[[nodiscard]] HWY_INLINE V power_of(V x, float y, V exponent) {
    return hn::IfThenElse(hn::Gt(x, set(0)), quick_exp2(exponent), set(y > 0 ? 0.0F : 1.0F));
}

[[nodiscard]] HWY_INLINE V with_sign_of(V size, V sign) {
    return hn::Or(size, hn::And(sign, set(-0.0F)));
}

[[nodiscard]] HWY_INLINE V3 scaled(const V3& v, V s) {
    return {hn::Mul(v.x, s), hn::Mul(v.y, s), hn::Mul(v.z, s)};
}

[[nodiscard]] HWY_INLINE V3 turned_to(const V3& n, const V3& v) {
    const V turn = hn::And(dot(n, v), set(-0.0F));
    return {hn::Xor(n.x, turn), hn::Xor(n.y, turn), hn::Xor(n.z, turn)};
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#endif
