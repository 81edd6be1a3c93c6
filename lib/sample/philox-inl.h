// Random numbers of counters (core/random.hpp) over SIMD lanes of 64 bits, after sample/edge_lines-inl.h.
//
// A Highway header: it may be included once for every target.
#if defined(PELLUCID_SAMPLE_PHILOX_INL) == defined(HWY_TARGET_TOGGLE)
#ifdef PELLUCID_SAMPLE_PHILOX_INL
#undef PELLUCID_SAMPLE_PHILOX_INL
#else
#define PELLUCID_SAMPLE_PHILOX_INL
#endif

#include <hwy/highway.h>

#include "sample/edge_lines-inl.h"

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

/// Product of the lower halves of all lanes.
HWY_INLINE VU multiply_low_halves(VU a, VU b) {
#if HWY_TARGET == HWY_SCALAR
    const VU low = hn::Set(du, 0xffffffffU);
    return hn::Mul(hn::And(a, low), b);
#else
    constexpr hn::Repartition<std::uint32_t, DU> d32;
    return hn::MulEven(hn::BitCast(d32, a), hn::BitCast(d32, b));
#endif
}

struct Words {  // 32 bits a lane
    VU w[4];
};

/// The seed as every round of Philox takes it.
struct RoundKeys {
    std::uint64_t key[2][10];

    explicit RoundKeys(std::uint64_t seed) {
        auto k0 = static_cast<std::uint32_t>(seed);
        auto k1 = static_cast<std::uint32_t>(seed >> 32U);
        for (std::size_t round = 0; round < 10; ++round) {
            key[0][round] = k0;
            key[1][round] = k1;
            k0 += 0x9E3779B9U;
            k1 += 0xBB67AE85U;
        }
    }
};

/// Philox4x32-10 for counters (low, high, repeat, object) in lanes of 64 bits; highs[i] of block i.
template <std::size_t blocks>
HWY_INLINE void philox(VU low_word, const VU (&highs)[blocks], std::uint32_t repeat, std::uint32_t object, const RoundKeys& rounds,
                       Words (&out)[blocks]) {
    const VU m0 = hn::Set(du, 0xD2511F53U);
    const VU m1 = hn::Set(du, 0xCD9E8D57U);
    for (std::size_t i = 0; i < blocks; ++i)
        out[i] = {{low_word, highs[i], hn::Set(du, std::uint64_t{repeat}), hn::Set(du, std::uint64_t{object})}};
#pragma GCC unroll 10
    for (std::size_t round = 0; round < 10; ++round) {
        const VU key0 = hn::Set(du, rounds.key[0][round]);
        const VU key1 = hn::Set(du, rounds.key[1][round]);
        for (Words& c : out) {
            const VU p0 = multiply_low_halves(c.w[0], m0);
            const VU p1 = multiply_low_halves(c.w[2], m1);
            c.w[0] = hn::Xor(hn::Xor(hn::ShiftRight<32>(p1), c.w[1]), key0);
            c.w[1] = p1;  // the upper halves are noise that nothing reads
            c.w[2] = hn::Xor(hn::Xor(hn::ShiftRight<32>(p0), c.w[3]), key1);
            c.w[3] = p0;
        }
    }
    const VU low = hn::Set(du, 0xffffffffU);
    for (Words& c : out)
        for (VU& w : c.w) w = hn::And(w, low);
}

/// A double from 32 bits in lanes of 64: exact.
HWY_INLINE V to_double(VU bits) {
    const VU magic = hn::Set(du, 0x4330000000000000ULL);
    return hn::Sub(hn::BitCast(d, hn::Or(bits, magic)), hn::Set(d, 0x1p52));
}
HWY_INLINE V unit(VU bits) { return hn::Mul(hn::Add(to_double(bits), hn::Set(d, 0.5)), hn::Set(d, 0x1p-32)); }

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#endif
