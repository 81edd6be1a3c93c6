// The fast CPU version against the plain one: winners and sums bit for bit, on every instruction set and any
// number of threads.
#include "cpu/fast_particles.hpp"

#include <hwy/targets.h>

#include "core/parallel.hpp"
#include "cpu/plain_particles.hpp"
#include "drawer_scenes.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

std::uint64_t hits_of(const std::vector<Winners>& winners) {
    std::uint64_t hits = 0;
    for (const Winners& repeat : winners)
        hits +=
            static_cast<std::uint64_t>(std::ranges::count_if(repeat, [](auto p) { return p != kNoPixel; }));
    return hits;
}

void expect_fast_is_plain(const DrawerScene& each, const ParticleSet& set) {
    SCOPED_TRACE(each.name);
    const auto plain = make_plain_drawer(each.scene);
    const auto fast = make_fast_drawer(each.scene);
    EXPECT_EQ(hash_of(fast->winners(set)), hash_of(plain->winners(set)));
    EnsembleSums by_plain = make_sums(each.scene);
    EnsembleSums by_fast = make_sums(each.scene);
    plain->draw(set, by_plain);
    fast->draw(set, by_fast);
    fast->draw(set, by_fast);  // keys and sums are left clean, so again
    plain->draw(set, by_plain);
    expect_equal_sums(by_fast, by_plain);
}

TEST(FastDrawer, IsThePlainOneOnEveryScene) {
    for (const DrawerScene& each : drawer_scenes()) {
        const ParticleSet set = drawer_particles(each);
        if (each.name != "nothing in view") {
            EXPECT_GT(hits_of(make_plain_drawer(each.scene)->winners(set)), 200U) << each.name;
        }
        expect_fast_is_plain(each, set);
    }
}

TEST(FastDrawer, IsThePlainOneOnEveryInstructionSet) {
    const std::vector<DrawerScene> scenes = drawer_scenes();
    int targets = 0;
    for (std::int64_t rest = hwy::SupportedTargets(); rest != 0; rest &= rest - 1) {
        hwy::SetSupportedTargetsForTest(rest & -rest);
        SCOPED_TRACE(hwy::TargetName(rest & -rest));
        for (std::size_t i = 0; i < 4; ++i) expect_fast_is_plain(scenes[i], drawer_particles(scenes[i], {2}));
        ++targets;
    }
    hwy::SetSupportedTargetsForTest(0);
    EXPECT_GT(targets, 1);
}

TEST(FastDrawer, DoesNotDependOnThreads) {
    const DrawerScene each = std::move(drawer_scenes()[0]);
    const ParticleSet set = drawer_particles(each);
    EnsembleSums expected = make_sums(each.scene);
    make_plain_drawer(each.scene)->draw(set, expected);
    for (const int threads : {1, 2, 3, 7}) {
        set_thread_count(threads);
        EnsembleSums sums = make_sums(each.scene);
        make_fast_drawer(each.scene)->draw(set, sums);
        expect_equal_sums(sums, expected);
    }
    set_thread_count(0);
}

// Particles on and around the borders of pixels, of tiles and of the image, at equal and at extreme depths.
TEST(FastDrawer, IsThePlainOneOnBorders) {
    for (const DrawerScene& each : drawer_scenes()) {
        if (each.scene.object_count() > 4) continue;
        SCOPED_TRACE(each.name);
        const Camera& camera = each.scene.camera;
        const ParticleFrame frame(camera);
        RandomStream random({3}, {.object = static_cast<std::uint32_t>(Purpose::test)});
        const auto unit = [&] { return unit_interval(random()); };
        std::vector<Particle> particles;
        for (int i = 0; i < 30000; ++i) {
            const double step = i % 3 == 0 ? twin::kTileSide : 1;
            Vec2 at(std::round(camera.width() * unit() / step) * step,
                    std::round(camera.height() * unit() / step) * step);
            at += std::pow(10.0, -8 * unit()) * Vec2(unit() - 0.5, unit() - 0.5);
            const double z = camera.near() + (camera.far() - camera.near()) * (i % 5 == 0   ? 0.5
                                                                               : i % 7 == 0 ? 0
                                                                                            : unit());
            const Vec2 side = (at - camera.center()) * camera.pixel_size() * (camera.perspective() ? z : 1);
            particles.push_back(frame.pack({side.x, side.y, z}, {unit() - 0.5, unit() - 0.5, -unit()}));
        }
        const auto objects = static_cast<std::uint32_t>(each.scene.object_count());
        std::vector<std::uint32_t> ends(objects, 30000);
        for (std::uint32_t i = 0; i + 1 < objects; ++i) ends[i] = 30000 / objects * (i + 1);
        ParticleSet set{frame, objects, {sort_by_tile(particles, ends, frame.projection(camera))}};
        expect_fast_is_plain(each, set);
    }
}

}  // namespace
}  // namespace pellucid
