// Projection, nearest-wins and the ensemble's sums, against a serial rewriting of them: bit for bit.
#include "cpu/plain_particles.hpp"

#include <map>

#include <gtest/gtest.h>
#include <unistd.h>

#include "core/error.hpp"
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

TEST(PlainDrawer, SumsAreThoseOfASerialRendering) {
    const PreparedScene scene = two_glossy_tori();
    const auto samplers = make_samplers(scene);
    const ParticleSet set = sample_particles(scene, samplers, {}, 0, 9);
    const twin::Projection projection = set.frame.projection(scene.camera);
    std::vector<EnsembleSums::Pixel> expected(61 * 47);
    std::vector<Vec3> color_sum(expected.size(), Vec3(0.0));
    std::uint64_t covered = 0;
    for (const RepeatParticles& repeat : set.repeats) {
        std::vector<std::uint32_t> unused;
        for (const auto& [pixel, winner] : winners_one_by_one(repeat.particles, projection, unused)) {
            const Particle& p = repeat.particles[winner.index];
            const twin::Vec3f n = twin::unpack_normal(p.normal);
            // In world space and in double but for the highlight: another way than the particles' own.
            color_sum[pixel] += shade(scene, scene.objects[repeat.bin_of(winner.index) % 2],
                                      scene.camera.to_world(set.frame.view_position(p)),
                                      scene.camera.world_vector({n.x, n.y, n.z}));
            ++expected[pixel].covered;
            ++covered;
            expected[pixel].depth = std::min(expected[pixel].depth, winner.depth);
        }
    }
    ASSERT_GT(covered, expected.size() / 2);  // there is something to compare

    EnsembleSums sums = make_sums(scene);
    make_plain_drawer(scene)->draw(set, sums);
    EXPECT_EQ(sums.repeats, 9U);
    EXPECT_EQ(sums.particles, set.count());
    for (std::size_t i = 0; i < expected.size(); ++i) {
        ASSERT_EQ(sums.pixels[i].covered, expected[i].covered) << i;
        ASSERT_EQ(sums.pixels[i].depth, expected[i].depth) << i;
        for (int c = 0; c < 3; ++c) {
            // Rounding to units, and float32 on both sides: at most one unit for each colour.
            const double units = color_sum[i][c] * 65535;
            ASSERT_NEAR(static_cast<double>(sums.pixels[i].color[c]), units, 1.0 * expected[i].covered) << i;
        }
    }
}

TEST(PlainDrawer, SquaresAreThoseOfTheColors) {
    const PreparedScene scene = two_glossy_tori();
    const ParticleSet set = sample_particles(scene, make_samplers(scene), {}, 0, 1);
    EnsembleSums sums = make_sums(scene);
    make_plain_drawer(scene)->draw(set, sums);
    for (const EnsembleSums::Pixel& p : sums.pixels)
        for (int c = 0; c < 3; ++c) ASSERT_EQ(p.square[c], p.color[c] * p.color[c]);
}

TEST(PlainDrawer, WinnersAreThoseOfTheFrame) {
    const PreparedScene scene = two_glossy_tori();
    const ParticleSet set = sample_particles(scene, make_samplers(scene), {}, 0, 3);
    const twin::Projection projection = set.frame.projection(scene.camera);
    const std::vector<Winners> winners = make_plain_drawer(scene)->winners(set);
    ASSERT_EQ(winners.size(), 3U);
    for (std::size_t r = 0; r < winners.size(); ++r) {
        std::vector<std::uint32_t> unused;
        Winners expected(set.repeats[r].particles.size(), kNoPixel);
        for (const auto& [pixel, winner] : winners_one_by_one(set.repeats[r].particles, projection, unused))
            expected[winner.index] = pixel;
        EXPECT_EQ(winners[r], expected);
    }
}

TEST(SortByTile, KeepsEveryParticleAndItsObjectInItsTile) {
    const PreparedScene scene = two_glossy_tori();
    twin::Projection projection = ParticleFrame(scene.camera).projection(scene.camera);
    for (const std::size_t count : {0U, 1U, 3U, 100U, 50000U}) {
        std::vector<Particle> particles = scattered(count);
        for (std::size_t i = 0; i < count; ++i)
            particles[i].normal = static_cast<std::uint32_t>(i);  // its name
        const std::vector<std::uint32_t> ends{static_cast<std::uint32_t>(count / 3),
                                              static_cast<std::uint32_t>(count / 3),
                                              static_cast<std::uint32_t>(count)};
        const RepeatParticles sorted = sort_by_tile(particles, ends, projection);
        const TileGrid grid(projection.width, projection.height);
        ASSERT_EQ(sorted.particles.size(), count);
        std::uint32_t last_bin = 0;
        std::uint32_t last_name = 0;
        std::vector<bool> seen(count, false);
        for (std::uint32_t i = 0; i < count; ++i) {
            const Particle& p = sorted.particles[i];
            const std::uint32_t bin = sorted.bin_of(i);
            EXPECT_EQ(bin % 3, p.normal < ends[0] ? 0U : 2U);
            const twin::PixelDepth at = twin::project_particle(projection, p);
            EXPECT_EQ(bin / 3, at.column < 0 ? grid.count() : grid.tile(at.column, at.row));
            EXPECT_GE(bin, last_bin);
            if (i > 0 && bin == last_bin) {
                EXPECT_GT(p.normal, last_name);
            }
            last_bin = bin;
            last_name = p.normal;
            EXPECT_FALSE(seen[p.normal]);
            seen[p.normal] = true;
        }
        for (std::size_t run = 1; run < sorted.runs.size(); ++run)
            EXPECT_LT(sorted.runs[run - 1].bin, sorted.runs[run].bin);
    }
}

TEST(MakeSums, RefusesAnImageThatTheMachineCannotHold) {
    const PreparedScene scene = two_glossy_tori();
    Scene wide = scene.settings;
    wide.image = {.width = 65536, .height = 32768};
    const PreparedScene prepared = prepare(wide);
    if (static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE)) > 180e9)
        GTEST_SKIP() << "skipped: this machine holds it";
    try {
        (void)make_sums(prepared);
        FAIL();
    } catch (const Error& e) {
        EXPECT_EQ(e.exit_code(), 4);
        EXPECT_NE(std::string(e.what()).find("65536 x 32768"), std::string::npos) << e.what();
    }
}

TEST(ColorUnits, KeepTwentyBitsForAnyBrightness) {
    for (const double brightest : {0.0, 1.0, 15.9, 16.0, 16.1, 1000.0, 65536.0, 1e30}) {
        const double units = color_units_of(brightest);
        EXPECT_LT(brightest * units + 0.5, 0x1p20) << brightest;
        if (brightest <= 16) {
            EXPECT_EQ(units, 65535) << brightest;
        } else {
            EXPECT_GE(brightest * units, 0x1p18) << brightest;
        }
    }
}

}  // namespace
}  // namespace pellucid
