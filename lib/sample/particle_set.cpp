#include "sample/particle_set.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "core/error.hpp"
#include "kernel/normal_twin.h"
#include "kernel/paint_twin.h"

namespace pellucid {
namespace {

/// Least e with value <= 2^e.
[[nodiscard]] int ceil_exponent(double value) {
    return value > 0 ? static_cast<int>(std::ceil(std::log2(value))) : 0;
}

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
    exponent = ceil_exponent(
        std::max({camera.far() - camera.near(), half, camera.perspective() ? camera.far() : 0.0}));
    shrink = std::ldexp(1.0, -exponent);
}

Particle ParticleFrame::pack(const Vec3& view, const Vec3& view_normal) const {
    // Into float's range by a power of two: exact, and without a root or a division.
    const double largest =
        std::max({std::abs(view_normal.x), std::abs(view_normal.y), std::abs(view_normal.z)});
    const auto exponent_bits = std::bit_cast<std::uint64_t>(largest) >> 52U;
    const Vec3 n = std::bit_cast<double>((std::uint64_t{2045} - exponent_bits) << 52U) * view_normal;
    return {static_cast<float>(view.x * shrink), static_cast<float>(view.y * shrink),
            static_cast<float>(std::max(0.0, view.z - near) * shrink),
            twin::pack_normal({static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)})};
}

Particle ParticleFrame::pack_painted(const Vec3& view, const Vec3& color) const {
    Particle q{static_cast<float>(view.x * shrink), static_cast<float>(view.y * shrink),
               static_cast<float>(std::max(0.0, view.z - near) * shrink), 0};
    q.normal = twin::pack_paint({static_cast<float>(color.x), static_cast<float>(color.y), static_cast<float>(color.z)},
                                twin::place_hash(q.x, q.y, q.above_near));
    return q;
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
        p.focal_fixed =
            std::llround(std::ldexp(1 / camera.pixel_size(), exponent + lateral_exponent + p.fraction_bits));
    }
    set_quick(p, camera);
    return p;
}

/// The roundings of float32: two of the focal product, two of w, 2.5 ULP of the division, two of the sum:
/// below 8 ULP of the largest coordinate, doubled. The fixed point: 29 bits for half of the image.
void ParticleFrame::set_quick(twin::Projection& p, const Camera& camera) const {
    const double scaled_near = std::ldexp(near, -exponent);
    p.quick_near = static_cast<float>(scaled_near);
    p.quick_focal = static_cast<float>(camera.perspective() ? 1 / camera.pixel_size()
                                                            : std::ldexp(1 / camera.pixel_size(), exponent));
    p.quick_center_x = static_cast<float>(camera.center().x);
    p.quick_center_y = static_cast<float>(camera.center().y);
    const double reach = 2 * half_size(camera);
    p.doubt = static_cast<float>(reach * (0x1p-20 + 0x1p-26) + std::ldexp(2.0, -p.fraction_bits));
    // A near plane that the fixed point cannot hold, or numbers beyond float32: always the integers.
    const bool near_is_coarse =
        p.perspective != 0 && (p.near_fixed < (std::int64_t{1} << 60) || !(scaled_near > 1e-30));
    if (near_is_coarse || !std::isfinite(p.quick_focal) || !(p.doubt < 0.5F)) p.doubt = 1;
}

std::uint64_t ParticleSet::count() const {
    std::uint64_t sum = 0;
    for (const RepeatParticles& r : repeats) sum += r.particles.size();
    return sum;
}

std::uint64_t ParticleSet::bytes() const {
    std::uint64_t sum = 0;
    for (const RepeatParticles& r : repeats)
        sum += r.particles.capacity() * sizeof(Particle) + r.runs.capacity() * sizeof(ParticleRun);
    return sum;
}

std::uint32_t RepeatParticles::bin_of(std::uint32_t index) const {
    const auto after =
        std::upper_bound(runs.begin(), runs.end(), index,
                         [](std::uint32_t i, const ParticleRun& run) { return i < run.begin; });
    return std::prev(after)->bin;
}

namespace {

/// Particles and runs in ascending order of bins, equal ones as they came.
[[nodiscard]] RepeatParticles in_order(std::span<const Particle> particles,
                                       std::span<const std::uint64_t> bin_and_index) {
    RepeatParticles sorted;
    sorted.particles.reserve(particles.size());
    for (const std::uint64_t each : bin_and_index) {
        const auto bin = static_cast<std::uint32_t>(each >> 32U);
        if (sorted.runs.empty() || sorted.runs.back().bin != bin)
            sorted.runs.push_back({static_cast<std::uint32_t>(sorted.particles.size()), bin});
        sorted.particles.push_back(particles[static_cast<std::uint32_t>(each)]);
    }
    return sorted;
}

}  // namespace

RepeatParticles sort_by_tile(std::span<const Particle> particles, std::span<const std::uint32_t> object_ends,
                             const twin::Projection& projection) {
    const std::size_t objects = object_ends.size();
    const TileGrid grid(projection.width, projection.height);
    const std::size_t bins = (grid.count() + 1) * objects;
    if (bins > 0xffffffffU)
        throw run_error("{} objects over {} tiles of the image are more than 2^32", objects, grid.count());
    std::vector<std::uint32_t> bin(particles.size());
    std::size_t object = 0;
    for (std::size_t i = 0; i < particles.size(); ++i) {
        while (i >= object_ends[object]) ++object;
        const twin::PixelDepth at = twin::project_quickly(projection, particles[i]);
        bin[i] = static_cast<std::uint32_t>(
            (at.column < 0 ? grid.count() : grid.tile(at.column, at.row)) * objects + object);
    }
    // Few particles over many bins: sorting them costs less than counting bins.
    if (particles.size() < bins / 4) {
        std::vector<std::uint64_t> keys(particles.size());
        for (std::size_t i = 0; i < keys.size(); ++i) keys[i] = std::uint64_t{bin[i]} << 32U | i;
        std::sort(keys.begin(), keys.end());
        return in_order(particles, keys);
    }
    std::vector<std::uint32_t> next(bins + 1, 0);
    for (const std::uint32_t b : bin) ++next[b + 1];
    RepeatParticles sorted;
    for (std::size_t b = 0; b < bins; ++b) {
        if (next[b + 1] > 0) sorted.runs.push_back({next[b], static_cast<std::uint32_t>(b)});
        next[b + 1] += next[b];
    }
    sorted.runs.shrink_to_fit();
    sorted.particles.resize(particles.size());
    for (std::size_t i = 0; i < particles.size(); ++i) sorted.particles[next[bin[i]]++] = particles[i];
    return sorted;
}

}  // namespace pellucid
