// Elementary functions in float32 out of + - ×, comparisons, conversions and bits alone: the same bits from
// g++ at any SIMD width (-ffp-contract=off) and from any Vulkan device that rounds to nearest, where
// built-ins and even the division are granted 2.5 ULP and more. Largest errors in units in the last place of
// the exact result, over all 2^32 floats (tests/math_twin_test.cpp):
//
//   twin_reciprocal(x)  1/x        0.502        twin_expm1(x)     e^x - 1              1.11
//   twin_sqrt(x)        √x         0.59         twin_log2(x)      log2 x               0.502
//   twin_rsqrt(x)       1/√x       0.501        twin_exp2(x)      2^x                  1.08
//   twin_log1p(x)       ln(1 + x)  0.92         twin_power(x, y)  x^y for x, y >= 0    1.2 (a grid, y <= 1e4)
//
// A subnormal argument is read as the zero of its sign and a subnormal result is given as the zero of its
// sign, by integers: so a device that flushes subnormals and one that keeps them agree. Results too large are
// infinite; NaN gives NaN (a device need not keep infinity and NaN as arguments). No branch: g++ vectorises.
//
// Heads and tails: a number of 24 bits is the sum of two of 12, whose products are exact; an error that
// matters is computed that way and added last. Polynomials: own fits, the largest error made least (Lawson's
// iteration at 150 Chebyshev points), coefficients rounded to float from the lowest on and the others fitted
// again; their errors are stated where they stand.
#ifndef PELLUCID_KERNEL_MATH_TWIN_H
#define PELLUCID_KERNEL_MATH_TWIN_H
#include "kernel/twin.h"
TWIN_BEGIN

const uint kSignBit = 0x80000000u;
const uint kInfinityBits = 0x7f800000u;
const uint kNanBits = 0x7fc00000u;
const uint kOneBits = 0x3f800000u;
const int kSmallestNormalBits = 0x00800000;

const float kLn2Head = 0.693145752f;  // 15 bits: its products with integers below 2^9 are exact
const float kLn2Tail = 1.42860677e-6f;

// Bits a where c, else b; masks, as g++ may turn ?: into a branch around floating-point work and then
// does not vectorise.
TWIN_FN uint bits_where(bool c, uint a, uint b) { return b ^ ((a ^ b) & (0u - uint(c))); }

// First 12 bits of v: cut off, and rounded.
TWIN_FN float cut_head(float v) { return uintBitsToFloat(floatBitsToUint(v) & 0xfffff000u); }
TWIN_FN float round_head(float v) { return uintBitsToFloat((floatBitsToUint(v) + 0x800u) & 0xfffff000u); }

// Integer next to v, |v| < 2^22: 1.5·2^23 pushes the fraction out of the last place.
TWIN_FN int nearest_integer(float v) {
    TWIN_PRECISE float pushed = v + 12582912.0f;
    return int(floatBitsToUint(pushed) - 0x4b400000u);
}

// m in [1, 2): y next to 1/m by a line (error 1/17) and a step of third order (17^-3), cut to 12 bits; its
// residual e = 1 - m·y is exact, and 1/m = y/(1 - e) = y + y(e + e²) but for e³ < 2^-32.
TWIN_FN float twin_reciprocal(float x) {
    uint sign = floatBitsToUint(x) & kSignBit;
    uint size = floatBitsToUint(x) ^ sign;
    TWIN_PRECISE float m = uintBitsToFloat((size & 0x007fffffu) | kOneBits);
    TWIN_PRECISE float line = 1.41176471f - 0.470588235f * m;
    TWIN_PRECISE float e0 = 1.0f - m * line;
    TWIN_PRECISE float y0 = line + line * (e0 + e0 * e0);
    TWIN_PRECISE float y = round_head(y0);
    TWIN_PRECISE float m_head = cut_head(m);
    TWIN_PRECISE float m_tail = m - m_head;
    TWIN_PRECISE float e = (1.0f - m_head * y) - m_tail * y;
    TWIN_PRECISE float r = y + y * (e + e * e);
    uint scaled = floatBitsToUint(r) + kOneBits - (size & kInfinityBits);
    uint bits = bits_where(int(scaled) < kSmallestNormalBits, 0u, scaled);
    bits = bits_where(int(size) < kSmallestNormalBits, kInfinityBits, bits);
    bits = bits_where(int(size) > int(kInfinityBits), kNanBits, bits | sign);
    return uintBitsToFloat(bits);
}

// size = m·4^half with m in [1, 4).
struct EvenScaled {
    float m;
    int half_exponent;
};
TWIN_FN EvenScaled even_scaled(uint size) {
    int exponent = int(size >> 23u) - 127;
    EvenScaled r;
    r.m = uintBitsToFloat((size & 0x007fffffu) | (uint(127 + (exponent & 1)) << 23u));
    r.half_exponent = exponent >> 1;
    return r;
}

// 1/√m for m in [1, 4) to 2^-14: a parabola (fit: 2^-5.4) and a step of third order.
TWIN_FN float rough_rsqrt(float m) {
    TWIN_PRECISE float parabola = 1.33538949f + m * (-0.410630405f + m * 0.0511952415f);
    TWIN_PRECISE float e = 1.0f - m * parabola * parabola;
    TWIN_PRECISE float y = parabola + parabola * (e * (0.5f + 0.375f * e));
    return y;
}

// s of 12 bits next to √m leaves d = m - s² exact, and √m = s + (d + (√m - s)²)/(2√m). √-0 = -0.
TWIN_FN float twin_sqrt(float x) {
    uint sign = floatBitsToUint(x) & kSignBit;
    uint size = floatBitsToUint(x) ^ sign;
    EvenScaled scaled = even_scaled(size);
    TWIN_PRECISE float m = scaled.m;
    TWIN_PRECISE float y = rough_rsqrt(m);
    TWIN_PRECISE float s = round_head(m * y);
    TWIN_PRECISE float d = m - s * s;
    TWIN_PRECISE float step = 0.5f * d * y;
    TWIN_PRECISE float r = s + (step + 0.5f * step * step * y);
    uint bits = floatBitsToUint(r) + (uint(scaled.half_exponent) << 23u);
    bits = bits_where(size == kInfinityBits, kInfinityBits, bits);
    bits = bits_where(int(size) > int(kInfinityBits), kNanBits, bits);
    bits = bits_where(sign != 0u, kNanBits, bits);
    bits = bits_where(int(size) < kSmallestNormalBits, sign, bits);
    return uintBitsToFloat(bits);
}

// y of 12 bits next to 1/√m leaves e = 1 - m·y² to 2^-35, and 1/√m = y/√(1 - e). 1/√-0 = -infinity.
TWIN_FN float twin_rsqrt(float x) {
    uint sign = floatBitsToUint(x) & kSignBit;
    uint size = floatBitsToUint(x) ^ sign;
    EvenScaled scaled = even_scaled(size);
    TWIN_PRECISE float m = scaled.m;
    TWIN_PRECISE float y = round_head(rough_rsqrt(m));
    TWIN_PRECISE float y2 = y * y;
    TWIN_PRECISE float m_head = cut_head(m);
    TWIN_PRECISE float m_tail = m - m_head;
    TWIN_PRECISE float y2_head = cut_head(y2);
    TWIN_PRECISE float y2_tail = y2 - y2_head;
    TWIN_PRECISE float e0 = (1.0f - m_head * y2_head) - m_head * y2_tail;
    TWIN_PRECISE float e = (e0 - m_tail * y2_head) - m_tail * y2_tail;
    TWIN_PRECISE float r = y + y * (e * (0.5f + 0.375f * e));
    uint bits = floatBitsToUint(r) - (uint(scaled.half_exponent) << 23u);
    bits = bits_where(size == kInfinityBits, 0u, bits);
    bits = bits_where(int(size) > int(kInfinityBits), kNanBits, bits);
    bits = bits_where(sign != 0u, kNanBits, bits);
    bits = bits_where(int(size) < kSmallestNormalBits, sign | kInfinityBits, bits);
    return uintBitsToFloat(bits);
}

// 1 + x = 2^k·(1 + f), 1 + f in [√½, √2] with f = 2^-k·x + (2^-k - 1) in head and tail, f = x where k = 0.
// ln(1 + x) = k·ln 2 + f - f²Q(f) + tail/(1 + f); fit of Q: 2^-27.8 of ln(1 + f).
TWIN_FN float twin_log1p(float x) {
    uint sign = floatBitsToUint(x) & kSignBit;
    uint size = floatBitsToUint(x) ^ sign;
    TWIN_PRECISE float sum = 1.0f + x;
    int k = int(floatBitsToUint(sum) - 0x3f3504f3u) >> 23;
    TWIN_PRECISE float k_float = float(k);
    TWIN_PRECISE float a = uintBitsToFloat(floatBitsToUint(x) - (uint(k) << 23u));
    TWIN_PRECISE float b = uintBitsToFloat(uint(127 - min(k, 30)) << 23u) - 1.0f;
    TWIN_PRECISE float f = a + b;
    TWIN_PRECISE float b_part = f - a;
    TWIN_PRECISE float f_tail = (a - (f - b_part)) + (b - b_part);
    TWIN_PRECISE float from_tail = f_tail * (1.0554f - 0.94118f * f);  // 1/(1 + f) to 1/17
    TWIN_PRECISE float q = -0.128991991f + f * 0.0760712698f;
    q = -0.141825289f + f * (0.132459491f + f * q);
    q = -0.200019553f + f * (0.166088f + f * q);
    q = -0.333333254f + f * (0.250015974f + f * q);
    q = f * f * (0.499999881f + f * q);
    TWIN_PRECISE float k_ln2 = k_float * kLn2Head;
    TWIN_PRECISE float head = k_ln2 + f;
    TWIN_PRECISE float head_error = f - (head - k_ln2);
    TWIN_PRECISE float r = head + (((k_float * kLn2Tail + from_tail) + head_error) - q);
    uint bits = floatBitsToUint(r);
    bits = bits_where(int(size) < kSmallestNormalBits, sign, bits);
    bits = bits_where(size == kInfinityBits, kInfinityBits, bits);
    bits = bits_where(floatBitsToUint(x) == 0xbf800000u, kSignBit | kInfinityBits, bits);
    bits = bits_where(floatBitsToUint(x) > 0xbf800000u, kNanBits, bits);
    bits = bits_where(int(size) > int(kInfinityBits), kNanBits, bits);
    return uintBitsToFloat(bits);
}

// x = n·ln 2 + r + c with |r| <= ln(2)/2 and c the rounding of r (Cody and Waite), e^r - 1 = r + r²Q(r) (fit:
// 2^-31), e^x - 1 = (2^n - 1) + 2^n·r + 2^n(r²Q + c·e^r), the first sum in head and tail; all of it halved,
// since 2^128 is no float.
TWIN_FN float twin_expm1(float x) {
    uint sign = floatBitsToUint(x) & kSignBit;
    uint size = floatBitsToUint(x) ^ sign;
    TWIN_PRECISE float near_x = uintBitsToFloat(bits_where(x > 89.0f, 0u, floatBitsToUint(x)));
    near_x = uintBitsToFloat(bits_where(x < -20.0f, 0xc1a00000u, floatBitsToUint(near_x)));
    int n = nearest_integer(near_x * 1.44269502f);
    TWIN_PRECISE float n_float = float(n);
    TWIN_PRECISE float r_head = near_x - n_float * kLn2Head;
    TWIN_PRECISE float r_tail = n_float * kLn2Tail;
    TWIN_PRECISE float r = r_head - r_tail;
    TWIN_PRECISE float c = (r_head - r) - r_tail;
    TWIN_PRECISE float q = 0.0013932318f + r * 0.000197601126f;
    q = 0.0416664928f + r * (0.00833354797f + r * q);
    q = r * r * (0.5f + r * (0.166666657f + r * q)) + (c + c * r);
    TWIN_PRECISE float half_scale = uintBitsToFloat(uint(n + 126) << 23u);
    TWIN_PRECISE float base = half_scale - 0.5f;
    TWIN_PRECISE float scaled_r = half_scale * r;
    TWIN_PRECISE float head = base + scaled_r;
    TWIN_PRECISE float head_error = scaled_r - (head - base);
    TWIN_PRECISE float half_result = head + (half_scale * q + head_error);
    TWIN_PRECISE float result = 2.0f * half_result;
    uint bits = floatBitsToUint(result);
    bits = bits_where(int(size) < 0x33000000, floatBitsToUint(x), bits);  // below 2^-25: x
    bits = bits_where(int(size) < kSmallestNormalBits, sign, bits);
    bits = bits_where(int(floatBitsToUint(x)) >= 0x42b17218, kInfinityBits, bits);  // from 88.7228394
    bits = bits_where(int(size) > int(kInfinityBits), kNanBits, bits);
    return uintBitsToFloat(bits);
}

// A number as the sum of two floats, the tail at most half a unit in the last place of the head.
struct HeadTail {
    float head;
    float tail;
};

// log2 x to 2^-33 of it, for normal x > 0. x = 2^k·m with m in [√½, √2), and with s = (m - 1)/(m + 1)
// log2 m = 2/ln 2·atanh s = s·V, V = K + s²(K/3 + s²R(s²)), K = 2/ln 2; fit of R: 2^-37 of log2 m.
TWIN_FN HeadTail log2_parts(float x) {
    const float kHead = 2.885742188f;  // K in 12 bits and the rest, K/3 alike
    const float kTail = -0.000352105708f;
    const float kThirdHead = 0.9619140625f;
    const float kThirdTail = -0.000117368574f;
    int k = int(floatBitsToUint(x) - 0x3f3504f3u) >> 23;
    TWIN_PRECISE float m = uintBitsToFloat(floatBitsToUint(x) - (uint(k) << 23u));

    // s in head and tail: a line through 1/(m + 1) (error 1/67), a step of third order, one of Newton.
    TWIN_PRECISE float f = m - 1.0f;
    TWIN_PRECISE float d = 2.0f + f;
    TWIN_PRECISE float d_error = f - (d - 2.0f);
    TWIN_PRECISE float line = 0.98508f - 0.23902f * d;
    TWIN_PRECISE float e0 = 1.0f - d * line;
    TWIN_PRECISE float y0 = line + line * (e0 + e0 * e0);
    TWIN_PRECISE float y = y0 + y0 * (1.0f - d * y0);
    TWIN_PRECISE float s_head = round_head(f * y0);
    TWIN_PRECISE float d_head = cut_head(d);
    TWIN_PRECISE float d_tail = d - d_head;
    TWIN_PRECISE float rest = ((f - s_head * d_head) - s_head * d_tail) - s_head * d_error;
    TWIN_PRECISE float s_tail = rest * y;

    // V in head (12 bits) and tail.
    TWIN_PRECISE float s2_head = s_head * s_head;
    TWIN_PRECISE float s2_tail = (2.0f * s_head + s_tail) * s_tail;
    TWIN_PRECISE float s2 = s2_head + s2_tail;
    TWIN_PRECISE float slope_tail = kThirdTail + s2 * (0.57708019f + s2 * (0.411849916f + s2 * 0.337820888f));
    TWIN_PRECISE float s2_cut = cut_head(s2_head);
    TWIN_PRECISE float w_head = s2_cut * kThirdHead;
    TWIN_PRECISE float w_tail = (s2_head - s2_cut) * kThirdHead + (s2_tail * kThirdHead + s2 * slope_tail);
    TWIN_PRECISE float v = kHead + w_head;
    TWIN_PRECISE float v_error = w_head - (v - kHead);
    TWIN_PRECISE float v_head = cut_head(v);
    TWIN_PRECISE float v_tail = (v - v_head) + ((v_error + kTail) + w_tail);

    TWIN_PRECISE float product = s_head * v_head;
    TWIN_PRECISE float product_tail = s_head * v_tail + s_tail * (v_head + v_tail);
    TWIN_PRECISE float k_float = float(k);
    TWIN_PRECISE float sum = k_float + product;
    TWIN_PRECISE float tail = (product - (sum - k_float)) + product_tail;
    TWIN_PRECISE float head = sum + tail;
    TWIN_PRECISE float head_error = tail - (head - sum);
    HeadTail r;
    r.head = head;
    r.tail = head_error;
    return r;
}

TWIN_FN float twin_log2(float x) {
    uint sign = floatBitsToUint(x) & kSignBit;
    uint size = floatBitsToUint(x) ^ sign;
    HeadTail parts = log2_parts(x);
    uint bits = floatBitsToUint(parts.head);
    bits = bits_where(size == kInfinityBits, kInfinityBits, bits);
    bits = bits_where(int(size) > int(kInfinityBits), kNanBits, bits);
    bits = bits_where(sign != 0u, kNanBits, bits);
    bits = bits_where(int(size) < kSmallestNormalBits, kSignBit | kInfinityBits, bits);
    return uintBitsToFloat(bits);
}

// 2^(head + tail) for any head but NaN, |tail| < 2^-16 where |head| <= 128. 2^n·(1 + r·P(r)) with |r| <= 1/2;
// fit of P: 2^-28.3 of 2^r.
TWIN_FN float exp2_of_parts(float head, float tail) {
    const uint k128Bits = 0x43000000u;
    bool far = int(floatBitsToUint(head) & ~kSignBit) > int(k128Bits);
    uint limit = (floatBitsToUint(head) & kSignBit) | k128Bits;
    TWIN_PRECISE float near_head = uintBitsToFloat(bits_where(far, limit, floatBitsToUint(head)));
    TWIN_PRECISE float near_tail = uintBitsToFloat(bits_where(far, 0u, floatBitsToUint(tail)));
    int n = nearest_integer(near_head);
    TWIN_PRECISE float r = (near_head - float(n)) + near_tail;
    TWIN_PRECISE float p = 0.00133909716f + r * 0.000153290937f;
    p = 0.0555035956f + r * (0.00961850025f + r * p);
    p = 1.0f + r * (0.693147182f + r * (0.240226477f + r * p));
    int scaled = int(floatBitsToUint(p) + (uint(n) << 23u));
    uint bits = bits_where(scaled < kSmallestNormalBits, 0u, uint(min(scaled, int(kInfinityBits))));
    return uintBitsToFloat(bits);
}

TWIN_FN float twin_exp2(float x) {
    bool not_a_number = int(floatBitsToUint(x) & ~kSignBit) > int(kInfinityBits);
    uint bits = floatBitsToUint(exp2_of_parts(x, 0.0f));
    return uintBitsToFloat(bits_where(not_a_number, kNanBits, bits));
}

// NaN or below -0: 0x80800000 is the first of the negative normal numbers.
TWIN_FN bool is_invalid(float x) {
    uint bits = floatBitsToUint(x);
    uint kept = bits_where(bits >= 0x80800000u, kNanBits, bits & ~kSignBit);
    return int(kept) > int(kInfinityBits);
}

// x^y = 2^(y·log2 x), the product in head and tail: up to 128 in size it is good to 2^-26, half of what its
// fraction is rounded to. x^0 = 1 even for x = 0 and infinity, 1^y = 1; negative arguments count as NaN.
TWIN_FN float twin_power(float x, float y) {
    uint x_size = floatBitsToUint(x) & ~kSignBit;
    uint y_size = floatBitsToUint(y) & ~kSignBit;
    HeadTail l = log2_parts(x);
    // No x but 1 is so near to 1 that 2^32 does not bring it out of range.
    const uint k2To32Bits = 0x4f800000u;
    uint near_y_bits = bits_where(int(y_size) > int(k2To32Bits), k2To32Bits, y_size);
    TWIN_PRECISE float near_y = uintBitsToFloat(near_y_bits);
    TWIN_PRECISE float y_head = cut_head(near_y);
    TWIN_PRECISE float y_tail = near_y - y_head;
    TWIN_PRECISE float l_head = cut_head(l.head);
    TWIN_PRECISE float l_tail = l.head - l_head;
    TWIN_PRECISE float product = near_y * l.head;
    TWIN_PRECISE float product_error =
        (((y_head * l_head - product) + y_head * l_tail) + y_tail * l_head) + y_tail * l_tail;
    TWIN_PRECISE float tail = product_error + near_y * l.tail;
    uint bits = floatBitsToUint(exp2_of_parts(product, tail));
    bits = bits_where(int(x_size) < kSmallestNormalBits, 0u, bits);
    bits = bits_where(x_size == kInfinityBits, kInfinityBits, bits);
    bits = bits_where(int(y_size) < kSmallestNormalBits, kOneBits, bits);
    bits = bits_where(is_invalid(x), kNanBits, bits);
    bits = bits_where(is_invalid(y), kNanBits, bits);
    return uintBitsToFloat(bits);
}

// For shading, where a colour of 16 bits needs no last bit: relative errors below 3e-7 (rsqrt), and for
// powers below 2e-7·(1 + |log2 of the result|); a third of the cost, and short chains of operations (Estrin).
// Arguments are normal numbers, no special values.

// 1/√x: a guess from the bits (Blinn 1997, "Floating-point tricks"; 3.5 %) and two steps of third order.
TWIN_FN float quick_rsqrt(float x) {
    TWIN_PRECISE float y = uintBitsToFloat(0x5f3759dfu - (floatBitsToUint(x) >> 1u));
    TWIN_PRECISE float half_x = 0.5f * x;
    TWIN_PRECISE float e = 0.5f - half_x * y * y;
    TWIN_PRECISE float y1 = y + y * (e * (1.0f + 1.5f * e));
    TWIN_PRECISE float e1 = 0.5f - half_x * y1 * y1;
    TWIN_PRECISE float r = y1 + y1 * (e1 * (1.0f + 1.5f * e1));
    return r;
}

// log2 x of a normal x > 0: exponent and log2(1 + f) = f·P(f), 1 + f in [√½, √2]; fit: 2.6e-8 of it.
TWIN_FN float quick_log2(float x) {
    int k = int(floatBitsToUint(x) - 0x3f3504f3u) >> 23;
    TWIN_PRECISE float f = uintBitsToFloat(floatBitsToUint(x) - (uint(k) << 23u)) - 1.0f;
    TWIN_PRECISE float f2 = f * f;
    TWIN_PRECISE float f4 = f2 * f2;
    TWIN_PRECISE float low = (1.44269502f + f * -0.721347332f) + f2 * (0.480910629f + f * -0.360703677f);
    TWIN_PRECISE float high = (0.287916243f + f * -0.238944829f) + f2 * (0.215715617f + f * -0.207269683f);
    TWIN_PRECISE float r = float(k) + f * (low + f4 * (high + f4 * 0.125836894f));
    return r;
}

// 2^t for t in [-150, 0]; from -125.5 down: 0. Fit: 1.9e-9.
TWIN_FN float quick_exp2(float t) {
    int n = nearest_integer(t);
    TWIN_PRECISE float r = t - float(n);
    TWIN_PRECISE float r2 = r * r;
    TWIN_PRECISE float high = (0.00961848907f + r * 0.00133999309f) + r2 * 0.00015345811f;
    TWIN_PRECISE float e =
        ((1.0f + r * 0.693147182f) + r2 * (0.240226462f + r * 0.0555032864f)) + (r2 * r2) * high;
    return uintBitsToFloat(bits_where(n < -125, 0u, floatBitsToUint(e) + (uint(n) << 23u)));
}

// x^y for x in [0, 1] and y >= 0, with 0^0 = 1.
TWIN_FN float quick_power(float x, float y) {
    TWIN_PRECISE float t = max(y * quick_log2(max(x, 1.17549435e-38f)), -150.0f);
    uint at_zero = bits_where(y > 0.0f, 0u, kOneBits);
    return uintBitsToFloat(bits_where(x > 0.0f, floatBitsToUint(quick_exp2(t)), at_zero));
}

TWIN_END
#endif
