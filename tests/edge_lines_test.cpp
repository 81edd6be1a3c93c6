// Lines along edges: scalar, SIMD and every instruction set agree to the last bit.
#include "sample/edge_lines.hpp"

#include <numeric>

#include "sample/particle_sampler.hpp"
#include "scene_testing.hpp"
#include "simd_targets.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

struct View {
    const char* name;
    std::string toml;
};

std::vector<View> views() {
    return {
        {"orthographic",
         "image.resolution = [90, 70]\n[camera]\nprojection = \"orthographic\"\nposition = [2, 3, 5]\nview_height = 2.2\n"},
        {"perspective",
         "image.resolution = [90, 70]\n[camera]\nposition = [1.2, 1.5, 2.0]\nfov_degrees = 40\n"},
        {"from inside",
         "image.resolution = [90, 70]\n[camera]\nposition = [0.2, 0.1, 0.3]\ntarget = [1, 1, 0.2]\nfov_degrees = 70\n"}};
}

std::vector<std::string> surfaces(const fs::path& folder) {
    put_volume(folder / "v.nrrd", {9, 8, 7}, sampled({9, 8, 7}, [](const Vec3& p) {
                   return std::sin(p.x) + std::cos(1.3 * p.y) * std::sin(0.7 * p.z);
               }), Vec3(0.25));
    put_sphere_mesh(folder / "s.ply", 9);
    std::vector<std::string> all;
    for (const char* shape : {"sphere", "ellipsoid", "torus", "plane", "cylinder", "cone", "paraboloid",
                              "saddle", "hyperboloid", "hyperboloid_two_sheets"})
        all.push_back(fmt::format("implicit = \"{}\"\nrotate_degrees = [20, 30, 40]\n", shape));
    all.emplace_back("implicit = \"torus\"\nparameters = { major = 0.4, minor = 0.7 }\n");
    all.emplace_back("implicit = \"torus\"\nbounds = [[-1, -1.4, -0.3], [1.2, 0.5, 0.4]]\nscale = 0.8\n");
    all.emplace_back("isosurface = { volume = \"v.nrrd\", isovalue = 0.3 }\ntranslate = [-1, -0.8, -0.8]\n");
    all.emplace_back("mesh = \"s.ply\"\nscale = 0.9\n");
    all.emplace_back("rectangle = { u = [2, 0, 1], v = [0, 1, 0] }\n");
    const std::size_t plain = all.size();
    for (std::size_t i = 0; i < plain; i += 4)
        all.push_back(all[i] + "clip = [{ normal = [1, 0, 0.2], offset = 0.3 }]\n");
    return all;
}

bool same(const LineSampler::Point& a, const LineSampler::Point& b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
}

TEST(EdgeLines, BatchesEqualSingleTrialsOnEveryInstructionSet) {
    const fs::path folder = test_folder();
    const auto all_targets = simd_targets();
    std::uint64_t compared = 0;
    for (const View& view : views())
        for (const std::string& surface : surfaces(folder))
            for (const char* law : {"constant", "oblique"}) {
                const std::string what = fmt::format("{}, {}, {}", view.name, law, surface);
                const PreparedScene scene = prepare(
                    scene_from(view.toml + "[[surface]]\nopacity_law = \"" + law + "\"\n" + surface, folder));
                const LineSampler sampler(scene.objects[0], scene.camera, 3);
                const std::size_t step = std::max<std::size_t>(1, sampler.block_count() / 25);
                for (std::size_t block = 0; block < sampler.block_count(); block += step) {
                    const Seed seed{block + 17};
                    std::vector<LineSampler::Point> single;
                    for (std::uint32_t i = 0; i < 601; ++i)
                        if (const auto point = sampler.trial_in_block(block, seed, 5, i))
                            single.push_back(*point);
                    for (const std::int64_t target : all_targets) {
                        const ChosenTarget chosen(target);
                        std::vector<LineSampler::Point> batch;
                        sampler.trials_in_block(block, seed, 5, 0, 13, batch);  // any split gives the same
                        sampler.trials_in_block(block, seed, 5, 13, 588, batch);
                        ASSERT_EQ(single.size(), batch.size()) << what << hwy::TargetName(target);
                        for (std::size_t i = 0; i < single.size(); ++i)
                            ASSERT_TRUE(same(single[i], batch[i]))
                                << what << hwy::TargetName(target) << " point " << i;
                    }
                    compared += single.size();
                }
            }
    EXPECT_GT(compared, 50000U);
    EXPECT_GT(all_targets.size(), 1U);
}

TEST(EdgeLines, DealtLinesEqualOnEveryInstructionSet) {
    const fs::path folder = test_folder();
    for (const View& view : views())
        for (const std::string& surface : surfaces(folder)) {
            const PreparedScene scene = prepare(scene_from(view.toml + "[[surface]]\n" + surface, folder));
            const LineSampler sampler(scene.objects[0], scene.camera, 0);
            for (std::size_t block = 0; block < sampler.block_count(); ++block) {
                if (sampler.block_crossings(block) == 1) continue;
                std::vector<std::array<std::vector<LineSampler::Point>, kLineGroup>> found;
                for (const std::int64_t target : simd_targets()) {
                    const ChosenTarget chosen(target);
                    sampler.lines_in_block(block, {1}, 2, 700, LineSampler::Deal::apart,
                                           found.emplace_back());
                    for (std::size_t r = 0; r < kLineGroup; ++r) {
                        ASSERT_EQ(found[0][r].size(), found.back()[r].size()) << surface;
                        for (std::size_t i = 0; i < found[0][r].size(); ++i)
                            ASSERT_TRUE(same(found[0][r][i], found.back()[r][i])) << surface;
                    }
                }
            }
        }
}

TEST(AliasTable, PicksWithItsWeights) {
    for (const std::size_t n : {1U, 2U, 3U, 7U, 100U, 4096U}) {
        std::vector<double> weights(n);
        for (std::size_t i = 0; i < n; ++i)
            weights[i] = i % 5 == 3 ? 0 : 1 + std::sin(static_cast<double>(i));
        if (n > 3) weights[0] = static_cast<double>(n);
        const double sum = std::accumulate(weights.begin(), weights.end(), 0.0);
        const AliasTable table(weights);
        std::vector<double> share(table.columns().size(), 0);
        for (std::size_t i = 0; i < table.columns().size(); ++i) {
            const double own = table.columns()[i].own * 0x1p-32;
            share[i] += own;
            share.at(table.columns()[i].other) += 1 - own;
        }
        for (std::size_t i = 0; i < share.size(); ++i)
            ASSERT_NEAR(share[i] / static_cast<double>(share.size()), i < n ? weights[i] / sum : 0, 1e-9)
                << n << ' ' << i;
    }
}

}  // namespace
}  // namespace pellucid
