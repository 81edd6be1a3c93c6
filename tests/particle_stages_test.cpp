// Projection, nearest-wins and the ensemble's sums, against a serial rewriting of them: bit for bit.
#include "cpu/particle_stages.hpp"

#include <map>

#include <gtest/gtest.h>

#include "core/random.hpp"
#include "kernel/normal_twin.h"
#include "sample/particle_sampler.hpp"
#include "scene/shading.hpp"

namespace pellucid {
namespace {

PreparedScene two_glossy_tori() {
    Scene scene;
    scene.source = "test";
    scene.image = {.width = 61, .height = 47};
    scene.camera.position = {1, 2, 4};
    scene.lights = {{.headlight = true}, {.direction = {0, 1, 0}, .intensity = 0.5}};
    for (const double lift : {0.0, 0.3}) {
        Surface surface;
        surface.name = "torus";
        surface.shape = ImplicitShape{"torus", {}};
        surface.color = {0.9, 0.5 + lift, 0.1};
        surface.opacity = 0.4;
        surface.shading.specular = 0.4;
        surface.to_world.offset = {lift, lift, 0};
        scene.surfaces.push_back(surface);
    }
    return prepare(scene);
}

/// Particles anywhere around the view, many at equal depth, some out of view.
std::vector<Particle> scattered(std::size_t count) {
    RandomStream random({7}, {.object = static_cast<std::uint32_t>(Purpose::test)});
    const auto side = [&] { return static_cast<float>(2 * unit_interval(random()) - 1); };
    std::vector<Particle> particles(count);
    for (Particle& p : particles) p = {side(), side(), static_cast<float>(random() % 4) * 0.25F, random()};
    return particles;
}

struct Winner {
    std::uint32_t depth;
    std::uint32_t index;
};

/// One particle after the other: the nearest, at equal depth the first.
std::map<std::uint32_t, Winner> winners_one_by_one(std::span<const Particle> particles,
                                                   const twin::Projection& projection,
                                                   std::vector<std::uint32_t>& first_hits) {
    std::map<std::uint32_t, Winner> winners;
    for (std::uint32_t i = 0; i < particles.size(); ++i) {
        const twin::PixelDepth at = twin::project_particle(projection, particles[i]);
        if (at.column < 0) continue;
        const auto pixel = static_cast<std::uint32_t>(at.row * projection.width + at.column);
        const auto [place, is_new] = winners.try_emplace(pixel, Winner{at.depth, i});
        if (is_new) {
            first_hits.push_back(pixel);
        } else if (std::pair(at.depth, twin::scramble_index(i)) <
                   std::pair(place->second.depth, twin::scramble_index(place->second.index))) {
            place->second = {at.depth, i};
        }
    }
    return winners;
}

TEST(WinnerFrame, AgreesWithOneParticleAfterTheOtherForAnyCount) {
    const PreparedScene scene = two_glossy_tori();
    const twin::Projection projection = ParticleFrame(scene.camera).projection(scene.camera);
    WinnerFrame frame(scene.camera.width(), scene.camera.height());
    for (const std::size_t count : {0U, 1U, 255U, 256U, 257U, 512U, 20000U}) {
        const std::vector<Particle> particles = scattered(count);
        std::vector<std::uint32_t> first_hits;
        const auto expected = winners_one_by_one(particles, projection, first_hits);
        frame.draw(particles, projection);
        const std::vector<std::uint32_t> hit(frame.hit_pixels().begin(), frame.hit_pixels().end());
        EXPECT_EQ(hit, first_hits) << count;
        for (const auto& [pixel, winner] : expected) ASSERT_EQ(frame.winner(pixel), winner.index) << count;
        frame.clear();
        EXPECT_TRUE(frame.hit_pixels().empty());
    }
}

TEST(WinnerFrame, NearestWins) {
    const PreparedScene scene = two_glossy_tori();
    const twin::Projection projection = ParticleFrame(scene.camera).projection(scene.camera);
    WinnerFrame frame(scene.camera.width(), scene.camera.height());
    const Particle far{0, 0, 0.5F, 0};
    const Particle near{0, 0, 0.25F, 0};
    const std::vector<Particle> particles{far, far, near, far};
    frame.draw(particles, projection);
    ASSERT_EQ(frame.hit_pixels().size(), 1U);
    EXPECT_EQ(frame.winner(frame.hit_pixels()[0]), 2U);
}

TEST(WinnerFrame, AtEqualDepthNeitherOfTwoObjectsIsPreferred) {
    // Pairs (i, n + i), as of two coincident surfaces: the first wins as often as the second.
    int first_wins = 0;
    constexpr std::uint32_t kPairs = 100000;
    for (std::uint32_t i = 0; i < kPairs; ++i) {
        EXPECT_EQ(twin::restore_index(twin::scramble_index(i)), i);
        first_wins += twin::scramble_index(i) < twin::scramble_index(kPairs + 3 * i + i % 7) ? 1 : 0;
    }
    EXPECT_NEAR(first_wins / double{kPairs}, 0.5, 3.3 * 0.5 / std::sqrt(double{kPairs}));
}

TEST(DrawEnsemble, SumsAreThoseOfASerialRendering) {
    const PreparedScene scene = two_glossy_tori();
    const auto samplers = make_samplers(scene);
    const ParticleSet set = sample_particles(scene, samplers, {}, 0, 9);
    const twin::Projection projection = set.frame.projection(scene.camera);
    const std::size_t pixels = 61 * 47;
    std::vector<EnsembleSums::Pixel> expected(pixels);
    std::uint64_t covered = 0;
    for (const RepeatParticles& repeat : set.repeats) {
        std::vector<std::uint32_t> unused;
        for (const auto& [pixel, winner] : winners_one_by_one(repeat.particles, projection, unused)) {
            const Particle& p = repeat.particles[winner.index];
            const twin::Vec3f n = twin::unpack_normal(p.normal);
            const Object& object = scene.objects[winner.index < repeat.object_ends[0] ? 0 : 1];
            const Vec3 color = shade(scene, object, scene.camera.to_world(set.frame.view_position(p)),
                                     scene.camera.world_vector({n.x, n.y, n.z}));
            EnsembleSums::Pixel& sum = expected[pixel];
            for (int c = 0; c < 3; ++c) {
                const auto units = static_cast<std::uint64_t>(color[c] * 65535 + 0.5);
                sum.color[c] += units;
                sum.square[c] += units * units;
            }
            ++sum.covered;
            ++covered;
            sum.depth = std::min(sum.depth, winner.depth);
        }
    }
    ASSERT_GT(covered, pixels / 2);  // there is something to compare

    EnsembleSums sums{.pixels = std::vector<EnsembleSums::Pixel>(pixels)};
    draw_ensemble(scene, set, sums);
    EXPECT_EQ(sums.repeats, 9U);
    EXPECT_EQ(sums.particles, set.count());
    for (std::size_t i = 0; i < pixels; ++i) {
        for (int c = 0; c < 3; ++c) {
            ASSERT_EQ(sums.pixels[i].color[c], expected[i].color[c]) << i;
            ASSERT_EQ(sums.pixels[i].square[c], expected[i].square[c]) << i;
        }
        ASSERT_EQ(sums.pixels[i].covered, expected[i].covered) << i;
        ASSERT_EQ(sums.pixels[i].depth, expected[i].depth) << i;
    }
}

}  // namespace
}  // namespace pellucid
