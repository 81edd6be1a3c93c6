// exp, log, sin, cos, tan in double from + − × ÷ and bit patterns: the same bits on every instruction set, one lane or many.
//
// Reductions and polynomials are those of fdlibm (Sun Microsystems, e_exp.c, e_log.c, k_sin.c, k_cos.c), without its
// branches. No fused multiply-add. Errors: at most kElementaryUlp (core/real.hpp), tested against the C library.
// Above kLargestTurn sin and cos fall back to the C library.
//
// A Highway header: it may be included once for every target.
#if defined(PELLUCID_CORE_ELEMENTARY_INL) == defined(HWY_TARGET_TOGGLE)
#ifdef PELLUCID_CORE_ELEMENTARY_INL
#undef PELLUCID_CORE_ELEMENTARY_INL
#else
#define PELLUCID_CORE_ELEMENTARY_INL
#endif

#include <cmath>
#include <limits>

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace elementary {

namespace hn = hwy::HWY_NAMESPACE;

/// Up to here k·π/2 is subtracted in exact steps: k < 2^20, and the parts of π/2 below have 33 bits.
inline constexpr double kLargestTurn = 1.6e6;

/// Σ c[i] x^i, highest first.
template <class D, std::size_t n, class V = hn::Vec<D>>
HWY_INLINE V polynomial(D d, V x, const double (&c)[n]) {
    V sum = hn::Set(d, c[0]);
    for (std::size_t i = 1; i < n; ++i) sum = hn::Add(hn::Mul(sum, x), hn::Set(d, c[i]));
    return sum;
}

/// 2^k for whole k in [−1022, 1023].
template <class D, class V = hn::Vec<D>>
HWY_INLINE V power_of_two(D d, V k) {
    const hn::RebindToUnsigned<D> du;
    // 2^52 + 1023 + k has the exponent's bits at its end.
    const V shifted = hn::Add(k, hn::Set(d, 0x1p52 + 1023));
    return hn::BitCast(d, hn::ShiftLeft<52>(hn::BitCast(du, shifted)));
}

template <class D, class V = hn::Vec<D>>
HWY_INLINE V exp(D d, V x) {
    const V most = hn::Set(d, 709.782712893383973096);
    const V least = hn::Set(d, -745.13321910194110842);
    const V inside = hn::Min(hn::Max(x, least), most);
    const V k = hn::Round(hn::Mul(inside, hn::Set(d, 1.44269504088896338700)));
    const V hi = hn::Sub(inside, hn::Mul(k, hn::Set(d, 6.93147180369123816490e-01)));
    const V lo = hn::Mul(k, hn::Set(d, 1.90821492927058770002e-10));
    const V r = hn::Sub(hi, lo);
    // e^r = 1 − ((lo − r·c/(2 − c)) − hi), c = r − r² P(r²)
    const V r2 = hn::Mul(r, r);
    constexpr double kP[] = {4.13813679705723846039e-08, -1.65339022054652515390e-06, 6.61375632143793436117e-05,
                             -2.77777777770155933842e-03, 1.66666666666666019037e-01};
    const V c = hn::Sub(r, hn::Mul(r2, polynomial(d, r2, kP)));
    const V q = hn::Div(hn::Mul(r, c), hn::Sub(hn::Set(d, 2.0), c));
    const V e = hn::Sub(hn::Set(d, 1.0), hn::Sub(hn::Sub(lo, q), hi));
    // Twice, since 2^k alone may overflow or vanish where the product does not.
    const V half = hn::Floor(hn::Mul(k, hn::Set(d, 0.5)));
    const V scaled = hn::Mul(hn::Mul(e, power_of_two(d, half)), power_of_two(d, hn::Sub(k, half)));
    const V large = hn::IfThenElse(hn::Gt(x, most), hn::Set(d, std::numeric_limits<double>::infinity()), scaled);
    const V all = hn::IfThenElse(hn::Lt(x, least), hn::Zero(d), large);
    return hn::IfThenElse(hn::Eq(x, x), all, x);
}

template <class D, class V = hn::Vec<D>>
HWY_INLINE V log(D d, V x) {
    const hn::RebindToUnsigned<D> du;
    const auto tiny = hn::Lt(x, hn::Set(d, 0x1p-1022));
    const V normal = hn::IfThenElse(tiny, hn::Mul(x, hn::Set(d, 0x1p54)), x);
    // x = 2^k m, m in [√½, √2)
    const auto bits = hn::BitCast(du, normal);
    const auto from_root_half = hn::Add(bits, hn::Set(du, 0x3ff0000000000000ULL - 0x3fe6a09e667f3bcdULL));
    const auto exponent = hn::ShiftRight<52>(from_root_half);  // of a positive x: 0 … 2047
    const auto mantissa = hn::Add(hn::And(from_root_half, hn::Set(du, 0x000fffffffffffffULL)),
                                  hn::Set(du, 0x3fe6a09e667f3bcdULL));
    const V biased = hn::Sub(hn::BitCast(d, hn::Or(exponent, hn::Set(du, 0x4330000000000000ULL))), hn::Set(d, 0x1p52));
    const V k = hn::Sub(biased, hn::IfThenElse(tiny, hn::Set(d, 1077.0), hn::Set(d, 1023.0)));
    const V f = hn::Sub(hn::BitCast(d, mantissa), hn::Set(d, 1.0));
    const V s = hn::Div(f, hn::Add(f, hn::Set(d, 2.0)));
    const V z = hn::Mul(s, s);
    constexpr double kL[] = {1.479819860511658591e-01, 1.531383769920937332e-01, 1.818357216161805012e-01,
                             2.222219843214978396e-01, 2.857142874366239149e-01, 3.999999999940941908e-01,
                             6.666666666666735130e-01};
    const V r = hn::Mul(z, polynomial(d, z, kL));
    const V half_square = hn::Mul(hn::Set(d, 0.5), hn::Mul(f, f));
    const V low = hn::Add(hn::Mul(s, hn::Add(half_square, r)), hn::Mul(k, hn::Set(d, 1.90821492927058770002e-10)));
    const V high = hn::Mul(k, hn::Set(d, 6.93147180369123816490e-01));
    V result = hn::Sub(high, hn::Sub(hn::Sub(half_square, low), f));
    const V infinity = hn::Set(d, std::numeric_limits<double>::infinity());
    result = hn::IfThenElse(hn::Eq(x, infinity), infinity, result);
    result = hn::IfThenElse(hn::Eq(x, hn::Zero(d)), hn::Neg(infinity), result);
    const V none = hn::Set(d, std::numeric_limits<double>::quiet_NaN());
    return hn::IfThenElse(hn::Ge(x, hn::Zero(d)), result, none);
}

/// sin and cos of the same angle.
template <class V>
struct SinCos {
    V sin, cos;
};

template <class D, class V = hn::Vec<D>>
HWY_INLINE SinCos<V> sin_cos(D d, V x) {
    const V k = hn::Round(hn::Mul(x, hn::Set(d, 6.36619772367581382433e-01)));
    V r = hn::Sub(x, hn::Mul(k, hn::Set(d, 1.57079632673412561417e+00)));
    r = hn::Sub(r, hn::Mul(k, hn::Set(d, 6.07710050630396597660e-11)));
    r = hn::Sub(r, hn::Mul(k, hn::Set(d, 2.02226624879595063154e-21)));
    const V z = hn::Mul(r, r);
    constexpr double kS[] = {1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06,
                             -1.98412698298579493134e-04, 8.33333333332248946124e-03, -1.66666666666666324348e-01};
    constexpr double kC[] = {-1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07,
                             2.48015872894767294178e-05, -1.38888888888741095749e-03, 4.16666666666666019037e-02};
    const V sine = hn::Add(r, hn::Mul(hn::Mul(r, z), polynomial(d, z, kS)));
    const V half = hn::Mul(hn::Set(d, 0.5), z);
    const V one = hn::Set(d, 1.0);
    const V rest = hn::Sub(one, half);
    const V lost = hn::Sub(hn::Sub(one, rest), half);
    const V cosine = hn::Add(rest, hn::Add(lost, hn::Mul(hn::Mul(z, z), polynomial(d, z, kC))));
    // quarter = k mod 4
    const V quarter = hn::Sub(k, hn::Mul(hn::Set(d, 4.0), hn::Floor(hn::Mul(k, hn::Set(d, 0.25)))));
    const auto odd = hn::Or(hn::Eq(quarter, one), hn::Eq(quarter, hn::Set(d, 3.0)));
    const V s = hn::IfThenElse(odd, cosine, sine);
    const V c = hn::IfThenElse(odd, sine, cosine);
    const auto sin_negative = hn::Ge(quarter, hn::Set(d, 2.0));
    const auto cos_negative = hn::Or(hn::Eq(quarter, one), hn::Eq(quarter, hn::Set(d, 2.0)));
    SinCos<V> result{hn::IfThenElse(sin_negative, hn::Neg(s), s), hn::IfThenElse(cos_negative, hn::Neg(c), c)};
    // −0 stays −0: sums above have lost its sign.
    result.sin = hn::IfThenElse(hn::Eq(x, hn::Zero(d)), x, result.sin);
    const auto large = hn::Not(hn::Le(hn::Abs(x), hn::Set(d, kLargestTurn)));  // and NaN
    if (!hn::AllFalse(d, large)) {
        HWY_ALIGN double at[HWY_MAX_BYTES / sizeof(double)];
        HWY_ALIGN double sines[HWY_MAX_BYTES / sizeof(double)];
        HWY_ALIGN double cosines[HWY_MAX_BYTES / sizeof(double)];
        hn::Store(x, d, at);
        for (std::size_t i = 0; i < hn::Lanes(d); ++i) {
            sines[i] = std::sin(at[i]);
            cosines[i] = std::cos(at[i]);
        }
        result.sin = hn::IfThenElse(large, hn::Load(d, sines), result.sin);
        result.cos = hn::IfThenElse(large, hn::Load(d, cosines), result.cos);
    }
    return result;
}

}  // namespace elementary
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#endif
