// The comparison of backends itself: that it sees what is wrong, and only that.
#include "study/backend_parity.hpp"

#include <set>

#include <gtest/gtest.h>

#include "cpu/fast_particles.hpp"
#include "scene_testing.hpp"
#include "study/opacity_patch.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

ParityScene ring_at(const char* camera) {
    const fs::path file = test_folder() / "ring.toml";
    put(file, std::string("[image]\nresolution = [90, 60]\n[camera]\nposition = [0.5, 1, 3]\n") + camera +
                  "[[surface]]\nname = \"ring\"\nimplicit = \"torus\"\nopacity = 0.5\n[[surface]]\nname = "
                  "\"ball\"\nimplicit = \"sphere\"\n"
                  "scale = 0.4\nopacity = 0.6\ncolor = [0.1, 0.8, 0.3]\n");
    std::string why_not;
    auto scene = sample_parity_scene(file, 90, 4, {1}, why_not);
    EXPECT_TRUE(scene) << why_not;
    return std::move(*scene);
}

ParityDifference difference_of(const ParityStage& stage, const ParityScene& scene, DrawFault fault) {
    return run_parity(stage, scene,
                      {parity_implementations({}).front(), faulty_implementation("twin", fault)}, 0, {})[1]
        .difference;
}

/// The fast drawer, but the first winner of each repeat is forgotten.
class ForgetfulDrawer final : public ParticleDrawer {
public:
    explicit ForgetfulDrawer(const PreparedScene& scene) : right_(make_fast_drawer(scene)) {}
    void draw(const ParticleSet& set, EnsembleSums& sums) override {
        right_->draw(set, sums);
        sums.pixels[0].color[1] += 3;
    }
    [[nodiscard]] std::vector<Winners> winners(const ParticleSet& set) override {
        std::vector<Winners> all = right_->winners(set);
        for (Winners& repeat : all)
            if (const auto won = std::ranges::find_if(repeat, [](auto p) { return p != kNoPixel; });
                won != repeat.end())
                *won = kNoPixel;
        return all;
    }
    [[nodiscard]] std::int64_t bytes() const override { return 0; }

private:
    std::unique_ptr<ParticleDrawer> right_;
};

TEST(BackendParity, SceneKeepsItsShape) {
    const ParityScene scene = ring_at("");
    EXPECT_EQ(scene.name, "ring");
    EXPECT_EQ(scene.scene->camera.width(), 135);
    EXPECT_EQ(scene.scene->camera.height(), 90);
    EXPECT_EQ(scene.particles.repeats.size(), 4U);
}

TEST(BackendParity, TheDrawerWithoutAFaultIsEqualInEveryStage) {
    for (const char* camera : {"", "projection = \"orthographic\"\nview_height = 3\n"}) {
        const ParityScene sampled = ring_at(camera);
        const ParityScene borders = make_border_scene(sampled, 20000, 2, {2});
        for (const ParityScene* scene : {&sampled, &borders})
            for (const ParityStage& stage : parity_stages()) {
                const ParityDifference d = difference_of(stage, *scene, DrawFault::none);
                EXPECT_EQ(d.different, 0U) << stage.name << ", " << scene->name;
                EXPECT_GT(d.hits, 1000U);
            }
    }
}

TEST(BackendParity, WrongTwinsAreSeenOnBorders) {
    const ParityScene borders = make_border_scene(ring_at(""), 20000, 2, {2});
    const ParityStage& winners = parity_stages().front();
    for (const DrawFault fault : {DrawFault::float32_pixels, DrawFault::ties_by_index}) {
        const ParityDifference d = difference_of(winners, borders, fault);
        EXPECT_LT(d.winners_equal_share.value(), 1);
        EXPECT_GT(d.winners_equal_share.value(), 0.5);
        EXPECT_GT(d.different, 0U);
    }
}

TEST(BackendParity, CountsWhatDiffers) {
    const ParityScene scene = ring_at("");
    Implementation forgetful = parity_implementations({}).front();
    forgetful.make_drawer = [](const PreparedScene& s) { return std::make_unique<ForgetfulDrawer>(s); };
    const std::vector<Implementation> both{parity_implementations({}).front(), forgetful};

    const auto winners = run_parity(parity_stages()[0], scene, both, 2, {1});
    EXPECT_EQ(winners[1].difference.different, 4U);
    EXPECT_DOUBLE_EQ(winners[1].difference.winners_equal_share.value(),
                     1 - 4.0 / static_cast<double>(winners[0].difference.hits));
    EXPECT_EQ(winners[1].wall_s.size(), 2U);
    EXPECT_NE(winners[0].hash, winners[1].hash);
    EXPECT_EQ(winners[0].difference.different, 0U);

    const auto colors = run_parity(parity_stages()[1], scene, both, 0, {1});
    EXPECT_EQ(colors[1].difference.different, 1U);
    EXPECT_EQ(colors[1].difference.largest_sum_units, 3);
    EXPECT_EQ(colors[1].difference.largest_mean_units, 0.75);
}

TEST(BackendParity, EveryInstructionSetIsThereOnce) {
    std::set<std::pair<std::string, int>> names;
    const std::vector<Implementation> list = parity_implementations({Backend::cpu()});
    for (const Implementation& each : list) names.insert({each.name, each.threads});
    EXPECT_EQ(names.size(), list.size());
    EXPECT_GE(list.size(), 4U);
    EXPECT_EQ(list.front().name, "plain CPU");
    EXPECT_EQ(list.front().threads, 1);
}

TEST(BackendParity, AVolumeThatIsNotThereIsNamed) {
    const fs::path file = test_folder() / "gone.toml";
    put(file,
        "[image]\nresolution = [90, 60]\n[camera]\nposition = [0, 0, 3]\n[[surface]]\nname = \"skin\"\n"
        "isosurface = { volume = \"gone.nrrd\", isovalue = 1 }\n");
    std::string why_not;
    EXPECT_FALSE(sample_parity_scene(file, 90, 4, {1}, why_not));
    EXPECT_NE(why_not.find("skin"), std::string::npos);
    EXPECT_NE(why_not.find("gone.nrrd"), std::string::npos);
}

TEST(OpacityPatch, ADrawerThatDiffersIsNoticed) {
    const auto patch = make_opacity_patch({.ratio = 1e-2}, {0, 90});
    const PreparedScene scene = prepare(patch->scene);
    const auto samplers = make_samplers(scene);
    std::unique_ptr<ParticleDrawer> drawers[3];
    drawers[0] = make_fast_drawer(scene);
    drawers[1] = make_faulty_drawer(scene, DrawFault::none);
    drawers[2] = std::make_unique<ForgetfulDrawer>(scene);
    const auto draws =
        draw_patch(*patch, scene, samplers[0], drawers, {.count = 50, .repeats = 9, .seed = {1}});
    EXPECT_TRUE(draws[1].as_first);
    EXPECT_EQ(draws[1].rings[0].covered, draws[0].rings[0].covered);
    EXPECT_FALSE(draws[2].as_first);
    EXPECT_EQ(draws[2].rings[0].covered + 9, draws[0].rings[0].covered);
}

}  // namespace
}  // namespace pellucid
