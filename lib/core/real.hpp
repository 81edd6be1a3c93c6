// A double as an algebra of formulas, with functions that give the same bits on every machine.
//
// + − × ÷ √ are exact to half a unit everywhere; exp, log, sin, cos and tan of the C library are not the same in the
// last bit on every processor. These are: made of + − × ÷ by elementary-inl.h, which SIMD code shares.
#pragma once

namespace pellucid {

struct Real {
    double value = 0;

    Real() = default;
    explicit Real(double v) : value(v) {}
};

[[nodiscard]] inline Real operator-(Real a) { return Real(-a.value); }
[[nodiscard]] inline Real operator+(Real a, Real b) { return Real(a.value + b.value); }
[[nodiscard]] inline Real operator-(Real a, Real b) { return Real(a.value - b.value); }
[[nodiscard]] inline Real operator*(Real a, Real b) { return Real(a.value * b.value); }
[[nodiscard]] inline Real operator/(Real a, Real b) { return Real(a.value / b.value); }
[[nodiscard]] inline Real square(Real a) { return a * a; }
/// NaN where either is: what is undefined stays so. Of equal operands a.
[[nodiscard]] inline Real min(Real a, Real b) { return a.value > b.value || b.value != b.value ? b : a; }
[[nodiscard]] inline Real max(Real a, Real b) { return a.value < b.value || b.value != b.value ? b : a; }
[[nodiscard]] inline Real step(Real a) { return Real(a.value >= 0 ? 1.0 : 0.0); }
[[nodiscard]] Real abs(Real a);
[[nodiscard]] Real sqrt(Real a);
/// Within kElementaryUlp units in the last place (tan: 3.6 seen). NaN outside of their domain. Beyond ±1.6e6 sin, cos
/// and tan are the C library's, whose last bit may differ between processors.
[[nodiscard]] Real exp(Real a);
[[nodiscard]] Real log(Real a);
[[nodiscard]] Real sin(Real a);
[[nodiscard]] Real cos(Real a);
[[nodiscard]] Real tan(Real a);
inline constexpr double kElementaryUlp = 6;
/// By repeated squaring, from the lowest bit up; a negative exponent is one division at the end.
[[nodiscard]] Real power(Real a, int exponent);

}  // namespace pellucid
