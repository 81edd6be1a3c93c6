// A value and its derivative along a line, over numbers or intervals: an algebra for `run_program`.
#pragma once

#include "core/interval.hpp"
#include "core/real.hpp"

namespace pellucid {

/// T is Real or Interval. The derivative bounds those of every point where there is one.
template <class T>
struct Dual {
    T value;
    T slope;

    Dual() = default;
    explicit Dual(double v) : value(v), slope(0.0) {}
    Dual(const T& v, const T& s) : value(v), slope(s) {}
};

namespace detail {

/// The first slope where a <= b, the second where a > b.
[[nodiscard]] inline Real slope_where_below(Real a, Real b, Real below, Real above) {
    return a.value > b.value ? above : below;
}
[[nodiscard]] inline Interval slope_where_below(const Interval& a, const Interval& b, const Interval& below,
                                                const Interval& above) {
    if (a.hi < b.lo) return below;
    if (b.hi < a.lo) return above;
    return hull(below, above);
}

[[nodiscard]] inline Real slope_of_root(Real slope, Real root) { return slope / (Real(2.0) * root); }
[[nodiscard]] inline Interval slope_of_root(const Interval& slope, const Interval& root) {
    // Not empty: what stands under the root may be constant.
    if (root.hi == 0) return Interval::everything(false);
    return slope / (Interval(2.0) * root);
}

}  // namespace detail

template <class T>
[[nodiscard]] Dual<T> operator-(const Dual<T>& a) {
    return {-a.value, -a.slope};
}
template <class T>
[[nodiscard]] Dual<T> operator+(const Dual<T>& a, const Dual<T>& b) {
    return {a.value + b.value, a.slope + b.slope};
}
template <class T>
[[nodiscard]] Dual<T> operator-(const Dual<T>& a, const Dual<T>& b) {
    return {a.value - b.value, a.slope - b.slope};
}
template <class T>
[[nodiscard]] Dual<T> operator*(const Dual<T>& a, const Dual<T>& b) {
    return {a.value * b.value, a.slope * b.value + a.value * b.slope};
}
template <class T>
[[nodiscard]] Dual<T> operator/(const Dual<T>& a, const Dual<T>& b) {
    const T q = a.value / b.value;
    return {q, (a.slope - q * b.slope) / b.value};
}
template <class T>
[[nodiscard]] Dual<T> square(const Dual<T>& a) {
    return {square(a.value), T(2.0) * a.value * a.slope};
}
template <class T>
[[nodiscard]] Dual<T> power(const Dual<T>& a, int exponent) {
    return {power(a.value, exponent), T(exponent) * power(a.value, exponent - 1) * a.slope};
}
template <class T>
[[nodiscard]] Dual<T> abs(const Dual<T>& a) {
    return {abs(a.value), (T(2.0) * step(a.value) - T(1.0)) * a.slope};
}
template <class T>
[[nodiscard]] Dual<T> sqrt(const Dual<T>& a) {
    const T root = sqrt(a.value);
    return {root, detail::slope_of_root(a.slope, root)};
}
template <class T>
[[nodiscard]] Dual<T> exp(const Dual<T>& a) {
    const T value = exp(a.value);
    return {value, value * a.slope};
}
template <class T>
[[nodiscard]] Dual<T> log(const Dual<T>& a) {
    return {log(a.value), a.slope / a.value};
}
template <class T>
[[nodiscard]] Dual<T> sin(const Dual<T>& a) {
    return {sin(a.value), cos(a.value) * a.slope};
}
template <class T>
[[nodiscard]] Dual<T> cos(const Dual<T>& a) {
    return {cos(a.value), -sin(a.value) * a.slope};
}
template <class T>
[[nodiscard]] Dual<T> tan(const Dual<T>& a) {
    const T value = tan(a.value);
    return {value, (T(1.0) + square(value)) * a.slope};
}
template <class T>
[[nodiscard]] Dual<T> min(const Dual<T>& a, const Dual<T>& b) {
    return {min(a.value, b.value), detail::slope_where_below(a.value, b.value, a.slope, b.slope)};
}
template <class T>
[[nodiscard]] Dual<T> max(const Dual<T>& a, const Dual<T>& b) {
    return {max(a.value, b.value), detail::slope_where_below(b.value, a.value, a.slope, b.slope)};
}
/// Stands in derivatives only, where it counts as constant.
template <class T>
[[nodiscard]] Dual<T> step(const Dual<T>& a) {
    return {step(a.value), T(0.0)};
}

}  // namespace pellucid
