#include "field/rounded.hpp"

#include <algorithm>
#include <cmath>

#include "core/real.hpp"
#include "core/vec.hpp"

namespace pellucid {
namespace {

/// Half a unit in the last place, relative.
constexpr double kHalfUnit = 0x1p-53 * (1 + 1e-6);
/// Pays for the rounding of the errors themselves, which may be much larger than the values.
constexpr double kHair = 1 + 0x1p-49;
/// What the functions of core/real.hpp may be off.
constexpr double kFunctionError = 2 * kElementaryUlp * kHalfUnit;

/// A result with what its operands' errors made of it, `carried`, and one more rounding of `relative`.
[[nodiscard]] Rounded rounded(const Interval& range, double carried, double relative = kHalfUnit) {
    if (range.empty()) return {range, 0};
    const double error = kHair * carried + relative * (range.reach() + carried) + 0x1p-1074;
    return {range, error >= 0 && !range.continuous ? kInfinity : error >= 0 ? error : kInfinity};
}

}  // namespace

Rounded operator-(const Rounded& a) { return {-a.range, a.error}; }
Rounded operator+(const Rounded& a, const Rounded& b) { return rounded(a.range + b.range, a.error + b.error); }
Rounded operator-(const Rounded& a, const Rounded& b) { return rounded(a.range - b.range, a.error + b.error); }

Rounded operator*(const Rounded& a, const Rounded& b) {
    const double carried =
        a.range.reach() * b.error + b.range.reach() * a.error + a.error * b.error;
    return rounded(a.range * b.range, carried);
}

Rounded operator/(const Rounded& a, const Rounded& b) {
    const Interval range = a.range / b.range;
    // (a + ε)/(b + δ) − a/b = (ε − δ a/b)/(b + δ)
    const double least = abs(b.range).lo - b.error;
    if (!(least > 0)) return {range, kInfinity};
    return rounded(range, (a.error + b.error * range.reach()) / least);
}

Rounded square(const Rounded& a) {
    return rounded(square(a.range), (2 * a.range.reach() + a.error) * a.error);
}

Rounded power(const Rounded& a, int exponent) {
    // The same multiplications as power(Real, int), for their errors; the range is tighter by itself.
    auto n = exponent < 0 ? 0U - static_cast<unsigned>(exponent) : static_cast<unsigned>(exponent);
    Rounded result(1.0);
    for (Rounded factor = a; n != 0; n >>= 1U) {
        if ((n & 1U) != 0) result = result * factor;
        if (n > 1) factor = square(factor);
    }
    if (exponent < 0) result = Rounded(1.0) / result;
    return {power(a.range, exponent), result.error};
}

Rounded abs(const Rounded& a) { return {abs(a.range), a.error}; }

Rounded sqrt(const Rounded& a) {
    // |√(a + ε) − √a| <= min(ε/√a, √ε), also from below.
    const double low = std::max(a.range.lo, 0.0);
    const double carried = std::min(low > 0 ? a.error / std::sqrt(low) : kInfinity, std::sqrt(a.error));
    return rounded(sqrt(a.range), carried);
}

Rounded exp(const Rounded& a) {
    const Interval range = exp(a.range);
    // e^ε − 1 <= ε(1 + ε) for ε <= 1
    const double growth = a.error <= 1 ? a.error * (1 + a.error) : kInfinity;
    return rounded(range, growth == 0 ? 0 : range.reach() * growth, kFunctionError);
}

Rounded log(const Rounded& a) {
    const double least = a.range.lo - a.error;
    return rounded(log(a.range), least > 0 ? a.error / least : kInfinity, kFunctionError);
}

Rounded sin(const Rounded& a) { return rounded(sin(a.range), std::min(a.error, 2.0), kFunctionError); }
Rounded cos(const Rounded& a) { return rounded(cos(a.range), std::min(a.error, 2.0), kFunctionError); }

Rounded tan(const Rounded& a) {
    // Over the operand with its error, where the slope is at most 1 + tan².
    const Interval wide = tan(a.range + Interval(-a.error, a.error));
    const double steepest = 1 + wide.reach() * wide.reach();
    return rounded(tan(a.range), wide.continuous ? steepest * a.error : kInfinity, kFunctionError);
}

Rounded min(const Rounded& a, const Rounded& b) { return {min(a.range, b.range), std::max(a.error, b.error)}; }
Rounded max(const Rounded& a, const Rounded& b) { return {max(a.range, b.range), std::max(a.error, b.error)}; }
Rounded step(const Rounded& a) { return {step(a.range), a.range.has_zero() || a.error > 0 ? 1.0 : 0.0}; }

}  // namespace pellucid
