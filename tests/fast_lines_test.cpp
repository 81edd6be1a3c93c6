// Fast mode: crossings of one line in different repeats of a group; every repeat alone is as in exact mode.
#include "sample/particle_sampler.hpp"

#include "core/error.hpp"
#include "cpu/fast_particles.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

// A torus from a generic direction: lines that cross it twice do so in different pixels.
const std::string kTorus =
    "image.resolution = [20, 20]\n[camera]\nposition = [1.5, 2, 4.5]\nfov_degrees = 40\n"
    "[[surface]]\nimplicit = \"torus\"\nopacity = 0.3\n";
// Edge-on, along the x axis: both crossings of a line lie in one pixel.
const std::string kEdgeOn =
    "image.resolution = [20, 20]\n[camera]\nprojection = \"orthographic\"\nposition = [9, 0, 0]\n"
    "up = [0, 0, 1]\nview_height = 3\n[[surface]]\nimplicit = \"torus\"\nopacity = 0.3\n";

bool same(const RepeatParticles& a, const RepeatParticles& b) {
    const auto equal_runs = [](const ParticleRun& p, const ParticleRun& q) {
        return p.begin == q.begin && p.bin == q.bin;
    };
    return std::ranges::equal(a.runs, b.runs, equal_runs) && a.particles.size() == b.particles.size() &&
           std::memcmp(a.particles.data(), b.particles.data(), sizeof(Particle) * a.particles.size()) == 0;
}

/// Repeats in which a pixel is hit, group after group of 16 repeats.
std::vector<std::vector<double>> covered_by_group(const PreparedScene& scene, const SamplerSettings& settings,
                                                  std::uint32_t groups) {
    ParticleSet all = sample_particles(scene, make_samplers(scene), settings, 0, groups * kLineGroup);
    std::vector<std::vector<double>> covered;
    for (std::uint32_t g = 0; g < groups; ++g) {
        const auto first = all.repeats.begin() + g * kLineGroup;
        const ParticleSet group{all.frame, all.objects, {first, first + kLineGroup}};
        EnsembleSums sums = make_sums(scene);
        make_fast_drawer(scene)->draw(group, sums);
        std::vector<double>& counts = covered.emplace_back();
        for (const auto& pixel : sums.pixels) counts.push_back(pixel.covered);
    }
    return covered;
}

struct Spread {
    double opacity = 0;   // mean over the pixels that are hit in 2 to 98 % of the repeats
    double variance = 0;  // of a group's count over that of a binomial, mean over these pixels
    double pixels = 0;
};

Spread spread(const std::vector<std::vector<double>>& covered) {
    Spread s;
    for (std::size_t pixel = 0; pixel < covered[0].size(); ++pixel) {
        MeanVariance counts;
        for (const auto& group : covered) counts.add(group[pixel]);
        const double share = counts.mean() / kLineGroup;
        if (share < 0.02 || share > 0.98) continue;
        s.opacity += share;
        s.variance += counts.variance() / (kLineGroup * share * (1 - share));
        ++s.pixels;
    }
    s.opacity /= s.pixels;
    s.variance /= s.pixels;
    return s;
}

TEST(FastLines, AnySplitOfRepeatsGivesTheSameParticles) {
    const PreparedScene scene = prepare(scene_from(
        kTorus + "[[surface]]\nimplicit = \"saddle\"\nclip = [{ normal = [1, 0, 0], offset = 0.3 }]\n"));
    const auto samplers = make_samplers(scene);
    const SamplerSettings settings{.seed = {4}, .lines = LineMode::fast};
    const ParticleSet all = sample_particles(scene, samplers, settings, 0, 50);
    EXPECT_GT(all.count(), 1000U);
    for (const auto& [first, count] : std::vector<std::pair<std::uint32_t, std::uint32_t>>{
             {0, 1}, {3, 2}, {14, 5}, {16, 16}, {7, 43}, {49, 1}}) {
        const ParticleSet part = sample_particles(scene, samplers, settings, first, count);
        for (std::uint32_t i = 0; i < count; ++i)
            EXPECT_TRUE(same(part.repeats[i], all.repeats[first + i])) << first << ' ' << i;
    }
}

TEST(FastLines, ChangeNothingWhereALineCrossesOnce) {
    const fs::path folder = test_folder();
    put_sphere_mesh(folder / "s.ply", 7);
    put_volume(folder / "v.nrrd", {5, 5, 5},
               sampled({5, 5, 5}, [](const Vec3& p) { return p.x + 0.3 * p.y * p.z; }), Vec3(0.2));
    for (const char* shape : {"mesh = \"s.ply\"", "isosurface = { volume = \"v.nrrd\", isovalue = 2.1 }",
                              "implicit = \"plane\"", "rectangle = { u = [1, 0, 0], v = [0, 1, 0] }"}) {
        const PreparedScene scene = prepare(scene_from(
            fmt::format("image.resolution = [20, 20]\ncamera.position = [0.3, 0.4, 4]\n[[surface]]\n{}\n",
                        shape),
            folder));
        const auto samplers = make_samplers(scene);
        const ParticleSet exact = sample_particles(scene, samplers, {.seed = {4}}, 3, 20);
        const ParticleSet fast =
            sample_particles(scene, samplers, {.seed = {4}, .lines = LineMode::fast}, 3, 20);
        EXPECT_GT(exact.count(), 0U);
        for (std::size_t i = 0; i < 20; ++i) EXPECT_TRUE(same(exact.repeats[i], fast.repeats[i])) << shape;
    }
}

TEST(FastLines, AFixedNumberOfTrialsIsRefused) {
    const PreparedScene scene = prepare(scene_from(kTorus));
    const auto samplers = make_samplers(scene);
    EXPECT_THROW((void)sample_particles(scene, samplers,
                                        {.trials = TrialLaw::binomial, .lines = LineMode::fast}, 0, 1),
                 Error);
    EXPECT_THROW((void)sample_particles(scene, samplers, {.lines = LineMode::fast, .exact_count = 5}, 0, 1),
                 Error);
}

// One repeat of every group: these are independent, and each must have Poisson numbers of particles.
TEST(FastLines, EveryRepeatAloneIsPoissonAndCrossingsDealtToOneRepeatAreNot) {
    const PreparedScene scene = prepare(scene_from(kEdgeOn));
    const auto samplers = make_samplers(scene);
    constexpr std::uint32_t kGroups = 1500;
    const auto dispersion = [&](const SamplerSettings& settings) {
        const ParticleSet set = sample_particles(scene, samplers, settings, 0, kGroups * kLineGroup);
        MeanVariance counts;
        for (std::size_t i = 0; i < kGroups; ++i)
            counts.add(static_cast<double>(set.repeats[kLineGroup * i + i % kLineGroup].particles.size()));
        return std::pair(counts.mean(), counts.variance() / counts.mean());
    };
    const auto [mean, ratio] = dispersion({.seed = {4}, .lines = LineMode::fast});
    EXPECT_NEAR(mean, dispersion({.seed = {5}}).first, 4.5 * std::sqrt(2 * mean / kGroups));
    const double sigma = std::sqrt(2.0 / kGroups);  // 3.7 %
    EXPECT_NEAR(ratio, 1, 4 * sigma);
    EXPECT_GT(dispersion({.seed = {4}, .lines = LineMode::fast, .deal_to_one_repeat = true}).second,
              1 + 6 * sigma);
}

TEST(FastLines, MeanOpacityIsThatOfExactModeAndCrossingsDealtToOneRepeatAreRejected) {
    const PreparedScene scene = prepare(scene_from(kEdgeOn));
    constexpr std::uint32_t kGroups = 100;
    const Spread exact = spread(covered_by_group(scene, {.seed = {4}}, kGroups));
    const Spread fast = spread(covered_by_group(scene, {.seed = {5}, .lines = LineMode::fast}, kGroups));
    const Spread twin = spread(
        covered_by_group(scene, {.seed = {5}, .lines = LineMode::fast, .deal_to_one_repeat = true}, kGroups));
    // At most four times the binomial variance, as a line has four crossings at most.
    const double sigma = std::sqrt((1 + 4) * 0.25 / (kGroups * kLineGroup * exact.pixels));
    EXPECT_NEAR(fast.opacity, exact.opacity, 4 * sigma);
    EXPECT_LT(twin.opacity, exact.opacity - 20 * sigma);
}

// What is left between repeats: nothing that a picture from a generic direction shows; and where the view runs
// along the lines, which have four crossings in one pixel here, up to four times a pixel's variance.
TEST(FastLines, VarianceOfAPixelIsBinomialUnlessTheViewRunsAlongTheLines) {
    constexpr std::uint32_t kGroups = 250;
    for (const bool edge_on : {false, true}) {
        const PreparedScene scene = prepare(scene_from(edge_on ? kEdgeOn : kTorus));
        const Spread exact = spread(covered_by_group(scene, {.seed = {6}}, kGroups));
        const Spread fast = spread(covered_by_group(scene, {.seed = {7}, .lines = LineMode::fast}, kGroups));
        // Variance of a sample variance: 2/(n − 1) of its square and a hair for the binomial's fourth moment.
        const double sigma = std::sqrt(2.5 / (kGroups * exact.pixels));
        EXPECT_NEAR(exact.variance, 1, 4 * sigma);
        RecordProperty(edge_on ? "variance_edge_on" : "variance_generic",
                       fmt::format("{:.4f} +- {:.4f}", fast.variance, sigma));
        if (!edge_on) {
            EXPECT_NEAR(fast.variance, 1, 4 * sigma);
        } else {
            EXPECT_GT(fast.variance, 1 + 6 * sigma);
            EXPECT_LT(fast.variance, 4);
        }
    }
}

}  // namespace
}  // namespace pellucid
