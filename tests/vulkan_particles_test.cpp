// Vulkan against the plain CPU version: winners and sums bit for bit, with validation on.
#include "vulkan/particles.hpp"

#include "cpu/plain_particles.hpp"
#include "drawer_scenes.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

class VulkanDrawer : public testing::Test {
protected:
    void SetUp() override {
        if (!Backend::has_vulkan()) GTEST_SKIP() << "skipped: no Vulkan device";
    }
};

void expect_vulkan_is_plain(const vulkan::Device& device, const DrawerScene& each,
                            const vulkan::DrawerSettings& settings = {}) {
    SCOPED_TRACE(each.name);
    const ParticleSet set = drawer_particles(each);
    const auto plain = make_plain_drawer(each.scene);
    const auto drawer = vulkan::make_particle_drawer(device, each.scene, settings);
    EXPECT_EQ(hash_of(drawer->winners(set)), hash_of(plain->winners(set)));
    EnsembleSums by_plain = make_sums(each.scene);
    EnsembleSums by_vulkan = make_sums(each.scene);
    for (int twice = 0; twice < 2; ++twice) {
        plain->draw(set, by_plain);
        drawer->draw(set, by_vulkan);
    }
    expect_equal_sums(by_vulkan, by_plain);
}

TEST_F(VulkanDrawer, IsThePlainOneOnEveryScene) {
    const vulkan::Device device({.validate = true});
    for (const DrawerScene& each : drawer_scenes()) expect_vulkan_is_plain(device, each);
    EXPECT_TRUE(device.validation_messages().empty());
}

TEST_F(VulkanDrawer, StreamsWhatDoesNotFit) {
    const vulkan::Device device({.validate = true, .stage_all = true});
    const DrawerScene each = std::move(drawer_scenes()[0]);
    for (const std::uint64_t bytes : {1U, 10000U, 300000U})
        expect_vulkan_is_plain(device, each, {.particle_bytes = bytes});
    EXPECT_TRUE(device.validation_messages().empty());
}

// Software devices end all loops of an invocation after 65535 rounds, without a word.
TEST_F(VulkanDrawer, DrawsAnyNumberOfParticlesInOneTile) {
    const vulkan::Device device({.validate = true});
    const DrawerScene each{
        "one tile, opaque",
        prepare(scene_from(
            "[image]\nresolution = [64, 64]\n[camera]\nposition = [0, 0, 3]\n"
            "fov_degrees = 20\n[[surface]]\nname = \"near\"\nrectangle = {}\nopacity = 0.9999\n"
            "[[surface]]\nname = \"far\"\n"
            "rectangle = { center = [0, 0, -1] }\nopacity = 0.9\n",
            test_folder())),
        100};
    ASSERT_GT(drawer_particles(each).count(), 5U * 65535U * 8U);
    expect_vulkan_is_plain(device, each);
    expect_vulkan_is_plain(device, each, {.workgroup_size = 1});
}

// … also where a single repeat has more than narrow workgroups can take.
TEST_F(VulkanDrawer, DrawsAnyNumberOfParticlesOfOneRepeatInOneTile) {
    const vulkan::Device device({.validate = true});
    const PreparedScene scene = prepare(
        scene_from("[image]\nresolution = [64, 64]\n[camera]\nposition = [0, 0, 3]\nfov_degrees = 20\n"
                   "[[surface]]\nname = \"a\"\nrectangle = {}\n",
                   test_folder()));
    const ParticleSet set =
        sample_particles(scene, make_samplers(scene), {.seed = {4}, .exact_count = 500'000}, 0, 2);
    const auto plain = make_plain_drawer(scene);
    const auto drawer = vulkan::make_particle_drawer(device, scene);
    EXPECT_EQ(hash_of(drawer->winners(set)), hash_of(plain->winners(set)));
    EnsembleSums by_plain = make_sums(scene);
    EnsembleSums by_vulkan = make_sums(scene);
    plain->draw(set, by_plain);
    drawer->draw(set, by_vulkan);
    expect_equal_sums(by_vulkan, by_plain);
}

// … and so where the particles are few and the repeats many.
TEST_F(VulkanDrawer, DrawsAnyNumberOfRepeats) {
    const vulkan::Device device({.validate = true});
    const DrawerScene each{
        "many repeats",
        prepare(scene_from("[image]\nresolution = [250, 250]\n[camera]\nposition = [0, 0, 3]\n"
                           "[[surface]]\nname = \"a\"\nrectangle = {}\nopacity = 0.0001\n",
                           test_folder())),
        40000};
    expect_vulkan_is_plain(device, each);
}

TEST_F(VulkanDrawer, DoesNotDependOnTheSizeOfWorkgroups) {
    const vulkan::Device device({.validate = true});
    const DrawerScene each = std::move(drawer_scenes()[1]);
    for (const std::uint32_t size : {1U, 24U, 64U, 256U}) {
        SCOPED_TRACE(size);
        expect_vulkan_is_plain(device, each, {.workgroup_size = size});
    }
    EXPECT_TRUE(device.validation_messages().empty());
}

}  // namespace
}  // namespace pellucid
