// Vectors, boxes and affine maps: double precision, GLM underneath.
#pragma once

#include <limits>

#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

namespace pellucid {

using Vec2 = glm::dvec2;
using Vec3 = glm::dvec3;
using Mat3 = glm::dmat3;  // column major: m[column][row]

using glm::cross;
using glm::dot;
using glm::length;
using glm::normalize;

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Axis-aligned box. The default is empty (lo > hi) and grows by `include`.
struct Box {
    Vec3 lo{kInfinity, kInfinity, kInfinity};
    Vec3 hi{-kInfinity, -kInfinity, -kInfinity};

    [[nodiscard]] bool empty() const { return !(lo.x <= hi.x && lo.y <= hi.y && lo.z <= hi.z); }
    [[nodiscard]] Vec3 center() const { return lo + 0.5 * (hi - lo); }
    [[nodiscard]] Vec3 size() const { return hi - lo; }
    void include(const Vec3& p) {
        lo = glm::min(lo, p);
        hi = glm::max(hi, p);
    }
    void include(const Box& b) {
        lo = glm::min(lo, b.lo);
        hi = glm::max(hi, b.hi);
    }
};

/// p ↦ linear·p + offset.
struct Affine {
    Mat3 linear{1.0};
    Vec3 offset{0.0};

    [[nodiscard]] Vec3 point(const Vec3& p) const { return linear * p + offset; }
    [[nodiscard]] Vec3 vector(const Vec3& v) const { return linear * v; }
    /// A normal (covector) of the source space carried along; not normalised.
    /// The cofactor matrix det·M⁻ᵀ, not M⁻ᵀ: it exists for every M, and its sign is mended below.
    [[nodiscard]] Vec3 normal(const Vec3& n) const {
        const Mat3 cofactor(cross(linear[1], linear[2]), cross(linear[2], linear[0]),
                            cross(linear[0], linear[1]));
        const Vec3 carried = cofactor * n;
        return determinant() < 0 ? -carried : carried;
    }
    [[nodiscard]] double determinant() const { return glm::determinant(linear); }
    /// Precondition: determinant() != 0.
    [[nodiscard]] Affine inverse() const {
        const Mat3 inv = glm::inverse(linear);
        return {inv, -(inv * offset)};
    }
};

/// (a ∘ b)(p) = a(b(p)).
[[nodiscard]] inline Affine compose(const Affine& a, const Affine& b) {
    return {a.linear * b.linear, a.point(b.offset)};
}

}  // namespace pellucid
