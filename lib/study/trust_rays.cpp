#include "study/trust_rays.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include <boost/math/special_functions/gamma.hpp>
#include <boost/multiprecision/cpp_int.hpp>

namespace pellucid {
namespace {

using Rational = boost::multiprecision::cpp_rational;
template <class T>
using Vector = std::array<T, 3>;

template <class T>
T determinant(const Vector<T>& a, const Vector<T>& b, const Vector<T>& c) {
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
           a[2] * (b[0] * c[1] - b[1] * c[0]);
}

Vector<Rational> exact(const Vec3& v) {
    return {Rational(v.x), Rational(v.y), Rational(v.z)};
}

Vector<Rational> difference(const Vec3& a, const Vec3& b) {
    const Vector<Rational> x = exact(a);
    const Vector<Rational> y = exact(b);
    return {x[0] - y[0], x[1] - y[1], x[2] - y[2]};
}

/// On which side of the edge a → b the line passes: the sign of det(d, a−o, b−o). Moved aside by
/// ε·e_i + ε²·e_j (e_i, e_j axes that span space with d) it is D + det(d, ε·e_i + ε²·e_j, a−b): never 0
/// unless the edge is parallel to the line.
int side_of_edge(const Ray& ray, const Vec3& a, const Vec3& b) {
    const Vec3 u = a - ray.origin;
    const Vec3 v = b - ray.origin;
    const Vec3& d = ray.direction;
    const double value = dot(d, cross(u, v));
    // Six products of three factors, each factor and each operation rounded once: fewer than 16 roundings a
    // term. u and v are differences of given numbers, whose own rounding is part of that.
    const double size = std::abs(d.x) * (std::abs(u.y * v.z) + std::abs(u.z * v.y)) +
                        std::abs(d.y) * (std::abs(u.z * v.x) + std::abs(u.x * v.z)) +
                        std::abs(d.z) * (std::abs(u.x * v.y) + std::abs(u.y * v.x));
    if (std::abs(value) > 16 * kRoundoff * size && size > std::numeric_limits<double>::min() / kRoundoff)
        return value > 0 ? 1 : -1;

    const Vector<Rational> along = exact(d);
    Rational sign = determinant(along, difference(a, ray.origin), difference(b, ray.origin));
    int longest = 0;
    for (int axis = 1; axis < 3; ++axis)
        if (std::abs(d[axis]) > std::abs(d[longest])) longest = axis;
    const Vector<Rational> edge = difference(a, b);
    for (int k = 1; k < 3 && sign == 0; ++k) {
        Vector<Rational> aside{};
        aside[static_cast<std::size_t>((longest + k) % 3)] = 1;
        sign = determinant(along, aside, edge);
    }
    return sign.sign();
}

}  // namespace

std::array<double, 3> random_numbers(Seed seed, std::uint64_t number, std::uint32_t block) {
    const auto bits = random_bits(seed, {static_cast<std::uint32_t>(Purpose::test), 0, number, block});
    return {unit_interval(bits[0]), unit_interval(bits[1]), unit_interval(bits[2])};
}

Vec3 random_direction(Seed seed, std::uint64_t number) {
    const auto [u, v, unused] = random_numbers(seed, number, 100);
    const double z = 2 * u - 1;
    const double r = std::sqrt((1 - z) * (1 + z));
    const double angle = 2 * std::numbers::pi * v;
    return normalize(Vec3(r * std::cos(angle), r * std::sin(angle), z));
}

Frame frame_around(const Vec3& along) {
    const Vec3 other = std::abs(along.x) < 0.5 ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
    const Vec3 aside = normalize(cross(along, other));
    return {aside, cross(along, aside)};
}

LineShooter::LineShooter(const PreparedScene& scene) : rays_(scene) {
    Box box;
    for (const Object& object : scene.objects) box.include(object.geometry->bounds());
    center_ = box.center();
    radius_ = 0.5 * length(box.size());
    const double near = scene.camera.near();
    const double far = scene.camera.far();
    t_middle_ = 0.5 * (near + far);
    // The half between near and far becomes three radii, whatever the direction: a point in the box is at
    // most one from the centre, and the ray's far end at most two from there.
    stretch_ = 3 * radius_ / (0.5 * (far - near));
}

Ray LineShooter::through(const Vec3& point, const Vec3& direction) const {
    const Vec3 along = stretch_ * direction;
    return {point - t_middle_ * along, along};
}

void LineShooter::gather(std::span<const Ray> rays, std::vector<std::vector<RayHit>>& hits) const {
    hits.resize(rays.size());
    PacketHits found;
    std::array<Ray, kPacket> packet;
    for (std::size_t first = 0; first < rays.size(); first += kPacket) {
        const std::size_t count = std::min<std::size_t>(kPacket, rays.size() - first);
        for (std::size_t i = 0; i < kPacket; ++i) packet[i] = rays[first + std::min(i, count - 1)];
        rays_.gather(packet, found);
        for (std::size_t i = 0; i < count; ++i) std::swap(hits[first + i], found.rays[i]);
    }
}

std::vector<std::uint32_t> exact_crossings(const TriangleMesh& mesh, const Ray& ray) {
    std::vector<std::uint32_t> crossed;
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
        const auto& [a, b, c] = mesh.triangles[i];
        const Vec3& p = mesh.positions[a];
        const Vec3& q = mesh.positions[b];
        const Vec3& r = mesh.positions[c];
        const int first = side_of_edge(ray, p, q);
        if (first == 0 || side_of_edge(ray, q, r) != first || side_of_edge(ray, r, p) != first) continue;
        crossed.push_back(static_cast<std::uint32_t>(i));
    }
    return crossed;
}

CountBounds poisson_bounds(double events, double level) {
    const double tail = 0.5 * (1 - level);
    return {events > 0 ? boost::math::gamma_p_inv(events, tail) : 0.0,
            boost::math::gamma_q_inv(events + 1, tail)};
}

}  // namespace pellucid
