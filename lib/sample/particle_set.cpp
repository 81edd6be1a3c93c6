#include "sample/particle_set.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "kernel/normal_twin.h"

namespace pellucid {
namespace {

/// Least e with value <= 2^e.
[[nodiscard]] int ceil_exponent(double value) { return value > 0 ? static_cast<int>(std::ceil(std::log2(value))) : 0; }

/// Most pixels between the view axis and a border of the image, at least one.
[[nodiscard]] double half_size(const Camera& camera) {
    const Vec2 size(camera.width(), camera.height());
    const Vec2 half = glm::max(glm::abs(camera.center()), glm::abs(size - camera.center()));
    return std::max({half.x, half.y, 1.0});
}

}  // namespace

ParticleFrame::ParticleFrame(const Camera& camera) : near(camera.near()) {
    const double reach = camera.perspective() ? camera.far() : 1;
    const double half = half_size(camera) * camera.pixel_size() * reach;
    exponent = ceil_exponent(std::max({camera.far() - camera.near(), half, camera.perspective() ? camera.far() : 0.0}));
    shrink = std::ldexp(1.0, -exponent);
}

Particle ParticleFrame::pack(const Vec3& view, const Vec3& view_normal) const {
    // Into float's range by a power of two: exact, and without a root or a division.
    const double largest = std::max({std::abs(view_normal.x), std::abs(view_normal.y), std::abs(view_normal.z)});
    const auto exponent_bits = std::bit_cast<std::uint64_t>(largest) >> 52U;
    const Vec3 n = std::bit_cast<double>((std::uint64_t{2045} - exponent_bits) << 52U) * view_normal;
    return {static_cast<float>(view.x * shrink), static_cast<float>(view.y * shrink),
            static_cast<float>(std::max(0.0, view.z - near) * shrink),
            twin::pack_normal({static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)})};
}

Vec3 ParticleFrame::view_position(const Particle& p) const {
    const auto grow = [&](float v) { return std::ldexp(static_cast<double>(v), exponent); };
    return {grow(p.x), grow(p.y), near + grow(p.above_near)};
}

twin::Projection ParticleFrame::projection(const Camera& camera) const {
    twin::Projection p{};
    p.width = camera.width();
    p.height = camera.height();
    p.perspective = camera.perspective() ? 1 : 0;
    // w < 2^31 and |center| <= 2^size_bits: their product keeps below 2^62.
    const int size_bits = ceil_exponent(half_size(camera) + 1) + 1;
    p.fraction_bits = std::min(24, 30 - size_bits);
    p.center_x = std::llround(std::ldexp(camera.center().x, p.fraction_bits));
    p.center_y = std::llround(std::ldexp(camera.center().y, p.fraction_bits));

    // In view |x| <= w·half/focal: x keeps as many bits as w has, focal the rest.
    const double half = half_size(camera) * camera.pixel_size();  // of the image, at depth 1
    if (p.perspective != 0) {
        p.lateral_shift = -ceil_exponent(half);
        p.focal_fixed = std::llround(std::ldexp(1 / camera.pixel_size(), p.fraction_bits - p.lateral_shift));
        // Not so small that a scaling by 2^(29 - near_exponent + lateral_shift) leaves float's range.
        p.near_exponent = -97 + std::max(0, p.lateral_shift);
        const double scaled_near = std::ldexp(near, -exponent);
        if (scaled_near > 0)
            p.near_exponent = std::max(p.near_exponent, static_cast<int>(std::floor(std::log2(scaled_near))));
        p.near_bits = 60 - p.near_exponent;
        p.near_fixed = std::llround(std::ldexp(scaled_near, p.near_bits));
    } else {
        const int lateral_exponent = ceil_exponent(half) - exponent;  // |x| < 2^this, as stored
        p.lateral_shift = 30 - lateral_exponent;
        p.focal_fixed = std::llround(std::ldexp(1 / camera.pixel_size(), exponent + lateral_exponent + p.fraction_bits));
    }
    return p;
}

std::uint64_t ParticleSet::count() const {
    std::uint64_t sum = 0;
    for (const RepeatParticles& r : repeats) sum += r.particles.size();
    return sum;
}

std::uint64_t ParticleSet::bytes() const {
    std::uint64_t sum = 0;
    for (const RepeatParticles& r : repeats)
        sum += r.particles.capacity() * sizeof(Particle) + r.object_ends.capacity() * sizeof(std::uint32_t);
    return sum;
}

}  // namespace pellucid
