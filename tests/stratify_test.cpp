// Stratified repeats: the mean of independent ones, a fraction of their variance, at the variance that is stated.
#include <set>

#include "core/parallel.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

/// 16 × 16 pixels of size 1, all of them covered by sheets that face the camera.
std::string sheets(const std::vector<double>& opacities, const std::string& more = "") {
    std::string toml =
        "image.resolution = [16, 16]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = 16\n";
    double z = 0;
    for (const double opacity : opacities) {
        toml += fmt::format("[[surface]]\nshading = \"flat\"\nrectangle = {{ center = [0, 0, {}], u = [9, 0, 0], v = [0, 9, 0] }}\n"
                            "opacity = {}\ncolor = [1, 1, 1]\n{}\n",
                            z, opacity, more);
        z -= 1;
    }
    return toml;
}

Image draw(const PreparedScene& scene, std::uint32_t repeats, std::uint64_t seed, SamplerKind kind = SamplerKind::stratified,
           std::optional<std::uint32_t> group = {}) {
    RenderStats stats;
    return render_particles(scene, {.repeats = repeats, .kind = kind, .sampler = {.seed = {seed}}, .group = group}, stats);
}

/// Moments of a channel of inner pixels over many seeds.
MeanVariance moments(const PreparedScene& scene, std::uint32_t repeats, int seeds, SamplerKind kind,
                     std::optional<std::uint32_t> group = {}) {
    MeanVariance result;
    for (int seed = 0; seed < seeds; ++seed) {
        const Image image = draw(scene, repeats, static_cast<std::uint64_t>(seed), kind, group);
        for (const float a : image.plane("A")) result.add(static_cast<double>(a));
    }
    return result;
}

TEST(Stratified, MeanIsTheOpacityForGroupsOfAnySize) {
    for (const double opacity : {0.02, 0.3, 0.9, 0.999})
        for (const std::uint32_t group : {1U, 2U, 7U, 64U}) {
            const PreparedScene scene = prepare(scene_from(sheets({opacity})));
            const MeanVariance a = moments(scene, 64, 12, SamplerKind::stratified, group);
            EXPECT_NEAR(a.mean(), opacity, sidak_critical_value(1e-3, 16) * a.standard_error()) << opacity << ' ' << group;
        }
}

TEST(Stratified, VarianceIsThatOfTheTheory) {
    for (const double opacity : {0.05, 0.1, 0.5, 0.8}) {
        constexpr std::uint32_t kGroup = 64;
        constexpr double kOversampling = 8;
        const PreparedScene scene = prepare(scene_from(sheets({opacity})));
        const MeanVariance a = moments(scene, kGroup, 40, SamplerKind::stratified, kGroup);
        // Candidates, a Poisson number M; rounding of c(M).
        const double depth = -std::log1p(-opacity);
        const double mean = kGroup * kOversampling * depth;
        const double q = 1 / (kGroup * kOversampling);
        double rounding = 0;
        for (int m = 0; m < 4 * mean + 100; ++m) {
            const double c = kGroup * -std::expm1(m * std::log1p(-q));
            const double share = c - std::floor(c);
            rounding += std::exp(m * std::log(mean) - mean - std::lgamma(m + 1.0)) * share * (1 - share);
        }
        const double expected =
            std::exp(-2 * depth) * std::expm1(depth * q) + rounding / (kGroup * kGroup);
        const double n = static_cast<double>(a.count());
        // Kurtosis of nearly normal numbers on a lattice: below 3.5.
        EXPECT_NEAR(a.variance() / expected, 1, 4 * std::sqrt(2.5 / n)) << opacity;
        const double independent = opacity * (1 - opacity) / kGroup;
        EXPECT_LT(a.variance(), 0.25 * independent) << opacity;
    }
}

TEST(Stratified, SheetsAndObjectsBehindEachOtherKeepTheirColours) {
    // A torus shows up to four sheets of one object; the sphere is another object.
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [24, 20]\ncamera.position = [0.3, 0.4, 4]\n"
        "[[surface]]\nname = \"a\"\nimplicit = \"torus\"\nopacity = 0.6\nrotate_degrees = [60, 20, 0]\ncolor = [1, 0.2, 0]\n"
        "[[surface]]\nname = \"b\"\nimplicit = \"sphere\"\nscale = 0.8\nopacity = 0.4\nopacity_law = \"oblique\"\ncolor = [0, 0.5, 1]\n"));
    TruthStats truth_stats;
    const Image truth = trace_truth(scene, {.filter = PixelFilter::particle, .max_error = 5e-4}, truth_stats);
    constexpr int kSeeds = 160;
    std::vector<std::array<MeanVariance, 4>> pixels(truth.pixel_count());
    const char* const names[] = {"R", "G", "B", "A"};
    for (int seed = 0; seed < kSeeds; ++seed) {
        const Image image = draw(scene, 32, static_cast<std::uint64_t>(seed) + 100);
        for (std::size_t c = 0; c < 4; ++c)
            for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i][c].add(static_cast<double>(image.plane(names[c])[i]));
    }
    double worst = 0;
    int tests = 0;
    for (std::size_t c = 0; c < 4; ++c)
        for (std::size_t i = 0; i < pixels.size(); ++i) {
            const double spread = std::sqrt(pixels[i][c].variance() / kSeeds +
                                            static_cast<double>(truth.plane(std::string("variance.") + names[c])[i]));
            if (truth.plane("A")[i] < 0.05F || spread == 0) continue;
            ++tests;
            worst = std::max(worst, std::abs(pixels[i][c].mean() - static_cast<double>(truth.plane(names[c])[i])) / spread);
        }
    EXPECT_GT(tests, 800);
    EXPECT_LT(worst, 1.1 * sidak_critical_value(1e-3, tests));  // 159 degrees of freedom: a little wider than normal
}

TEST(Stratified, NoTwoParticlesOfAnObjectShareAPixelOfOneRepeat) {
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [70, 70]\ncamera.position = [0, 0, 4]\n[[surface]]\nimplicit = \"torus\"\nopacity = 0.95\nrotate_degrees = [60, 20, 0]\n"));
    SamplerSettings settings{.seed = {3}};
    settings.stratify = StratifySettings{.group = 8};
    const ParticleSet set = sample_particles(scene, make_samplers(scene), settings, 0, 8);
    const twin::Projection projection = set.frame.projection(scene.camera);
    for (const RepeatParticles& repeat : set.repeats) {
        std::set<std::pair<int, int>> seen;
        for (const Particle& q : repeat.particles) {
            const twin::PixelDepth at = twin::project_particle(projection, q);
            EXPECT_TRUE(seen.insert({at.column, at.row}).second);
        }
        EXPECT_GT(seen.size(), 500U);
    }
}

TEST(Stratified, CountLawIsOpacityTimesPixels) {
    const PreparedScene scene = prepare(scene_from(sheets({0.7})));
    SamplerSettings settings{.seed = {3}};
    settings.stratify = StratifySettings{.group = 32};
    const ParticleSet set = sample_particles(scene, make_samplers(scene), settings, 0, 640);
    const double expected = 0.7 * 256 * 640;  // n = α S/s, and not −ln(1 − α) S/s
    EXPECT_NEAR(static_cast<double>(set.count()), expected, 4 * std::sqrt(0.25 * 0.21 * 256 * 640));
}

TEST(Stratified, RepeatsOfAGroupDependOnSeedAndPlaceOnly) {
    const PreparedScene scene = prepare(scene_from(sheets({0.3, 0.6})));
    const auto samplers = make_samplers(scene);
    SamplerSettings settings{.seed = {3}};
    settings.stratify = StratifySettings{.group = 8};
    const ParticleSet all = sample_particles(scene, samplers, settings, 0, 20);
    set_thread_count(1);
    const ParticleSet part = sample_particles(scene, samplers, settings, 5, 9);
    set_thread_count(0);
    ASSERT_EQ(part.repeats.size(), 9U);
    for (std::size_t i = 0; i < 9; ++i) {
        const auto& a = all.repeats[5 + i].particles;
        const auto& b = part.repeats[i].particles;
        ASSERT_EQ(a.size(), b.size());
        EXPECT_EQ(0, std::memcmp(a.data(), b.data(), a.size() * sizeof(Particle)));
    }
}

TEST(Stratified, StatedVarianceIsThatOverSeeds) {
    const PreparedScene scene = prepare(scene_from(sheets({0.4})));
    MeanVariance a;
    double stated = 0;
    constexpr int kSeeds = 60;
    for (int seed = 0; seed < kSeeds; ++seed) {
        const Image image = draw(scene, 64, static_cast<std::uint64_t>(seed) + 7);
        for (const float value : image.plane("A")) a.add(static_cast<double>(value));
        for (const float value : image.plane("variance.A")) stated += static_cast<double>(value) / (256.0 * kSeeds);
    }
    // Seven degrees of freedom a pixel: relative error of their mean sqrt(2/(7 n)).
    const double n = 256.0 * kSeeds;
    EXPECT_NEAR(stated / a.variance(), 1, 4 * std::sqrt(2.5 / n + 2.5 / (7 * n)));
}

TEST(Stratified, StatedVarianceIsRightWithAPartOfAGroupAtTheEnd) {
    const PreparedScene scene = prepare(scene_from(sheets({0.5})));
    const struct {
        std::uint32_t group, repeats;
    } cases[] = {{16, 33}, {16, 47}, {16, 36}, {5, 16}};
    for (const auto& [group, repeats] : cases) {
        MeanVariance a, b;
        double stated = 0;
        double stated_b = 0;
        constexpr int kSeeds = 60;
        for (int seed = 0; seed < kSeeds; ++seed) {
            const Image image = draw(scene, repeats, static_cast<std::uint64_t>(seed) + 7, SamplerKind::stratified, group);
            for (const float value : image.plane("A")) a.add(static_cast<double>(value));
            for (const float value : image.plane("R")) b.add(static_cast<double>(value));
            for (const float value : image.plane("variance.A")) stated += static_cast<double>(value) / (256.0 * kSeeds);
            for (const float value : image.plane("variance.R")) stated_b += static_cast<double>(value) / (256.0 * kSeeds);
        }
        // A degree of freedom a pixel, at least.
        const double error = std::sqrt((2.5 + 2.5) / (256.0 * kSeeds));
        EXPECT_NEAR(stated / a.variance(), 1, 4 * error) << repeats << " of " << group;
        EXPECT_NEAR(stated_b / b.variance(), 1, 4 * error) << repeats << " of " << group;
    }
}

TEST(Stratified, OneCompleteGroupTellsNoVariance) {
    const PreparedScene scene = prepare(scene_from(sheets({0.5})));
    for (const std::uint32_t repeats : {16U, 17U, 31U, 32U}) {
        const Image image = draw(scene, repeats, 1, SamplerKind::stratified, 16);
        for (const float v : image.plane("variance.A")) ASSERT_EQ(std::isinf(v), repeats < 32) << repeats;
    }
}

TEST(Stratified, IndependentCandidatesDealtAtRandomAreTheWrongTwin) {
    // What would be drawn if candidates were dealt without regard to depth: law (1) of the count α S/s is not α.
    const PreparedScene scene = prepare(scene_from(sheets({0.6})));
    const double wrong = -std::expm1(-0.6);
    const MeanVariance a = moments(scene, 64, 6, SamplerKind::stratified, 16);
    EXPECT_GT(std::abs(a.mean() - wrong), 20 * a.standard_error());
}

TEST(Stratified, DefaultGroupsLeaveSevenDegreesOfFreedom) {
    const PreparedScene scene = prepare(scene_from(sheets({0.3})));
    const Sources sources = make_sources(scene);
    for (const std::uint32_t repeats : {8U, 20U, 100U, 500U, 512U, 1000U, 5000U}) {
        const std::uint32_t group = default_group(scene, sources, repeats, 8);
        const std::uint32_t groups = (repeats + group - 1) / group;
        EXPECT_GE(groups, repeats == 20 ? 7U : 8U) << repeats;
        EXPECT_LE(groups, 16U) << repeats;
        if (repeats >= 1000) {
            EXPECT_GE(group, 62U) << repeats;
        }
    }
}

// A pixel needs no more candidates than tell its opacity: opaque objects are not oversampled.
TEST(Stratified, OversamplingFallsWithOpacity) {
    const auto plan = [](const std::vector<double>& opacities) {
        const PreparedScene scene = prepare(scene_from(sheets(opacities)));
        return plan_candidates(scene, LineSampler(scene.objects[0], scene.camera, 0), 8);
    };
    const CandidatePlan faint = plan({0.3});
    EXPECT_DOUBLE_EQ(faint.oversampling, 8);
    EXPECT_NEAR(faint.particles / (256 * -std::log(0.7)), 1, 0.05);
    const CandidatePlan opaque = plan({1});
    const double depth = 20 * std::log(2.0);
    EXPECT_NEAR(opaque.particles / (256 * depth), 1, 0.05);
    EXPECT_NEAR(opaque.oversampling, 8 * kDenseDepth / depth, 0.1);
}

TEST(Stratified, OpaqueVolumeHasItsColoursAndNoMoreCandidatesThanParticles) {
    // 16 cells deep, an optical depth of 13.9 in each: 222 particles a pixel of which one is seen.
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [24, 24]\ncamera.position = [0.4, 0.3, 5]\n[[volume]]\nexpression = \"x + 0.3*y\"\n"
        "bounds = [[-1, -1, -1], [1, 1, 1]]\nresolution = 17\ntransfer = [[-2, 1, 0, 0, 1], [0, 0, 1, 0.5, 1], [2, 0, 0.2, 1, 1]]\n"));
    const Sources sources = make_sources(scene);
    EXPECT_DOUBLE_EQ(plan_candidates(scene, *sources[0], 8).oversampling, 1);
    constexpr int kSeeds = 24;
    const char* const names[] = {"R", "G", "B", "A"};
    for (const char* name : names) {
        MeanVariance both[2];  // means over the image
        for (int seed = 0; seed < kSeeds; ++seed)
            for (const bool stratified : {false, true}) {
                const Image image = draw(scene, 16, static_cast<std::uint64_t>(seed),
                                         stratified ? SamplerKind::stratified : SamplerKind::lines);
                double sum = 0;
                for (const float value : image.plane(name)) sum += static_cast<double>(value);
                both[stratified ? 1 : 0].add(sum / static_cast<double>(image.pixel_count()));
            }
        const double spread = std::hypot(both[0].standard_error(), both[1].standard_error());
        EXPECT_NEAR(both[0].mean(), both[1].mean(), 4.5 * spread + 1e-7) << name;
    }
}

// ---- adaptive repeats

TEST(AdaptiveTiles, StopOneByOneAndKeepTheirPromise) {
    // The left half is translucent, the right half empty but for a faint sheet.
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [192, 64]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = 64\n"
        "[[surface]]\nshading = \"flat\"\nrectangle = { center = [-64, 0, 0], u = [32, 0, 0], v = [0, 32, 0] }\nopacity = 0.5\ncolor = [1, 1, 1]\n"
        "[[surface]]\nname = \"faint\"\nshading = \"flat\"\nrectangle = { center = [64, 0, 0], u = [32, 0, 0], v = [0, 32, 0] }\nopacity = 0.02\n"
        "color = [0.1, 0.1, 0.1]\n"));
    for (const SamplerKind kind : {SamplerKind::lines, SamplerKind::stratified}) {
        RenderStats stats;
        const Image image =
            render_particles(scene, {.repeats = 4096, .kind = kind, .sampler = {.seed = {1}}, .group = 16, .max_error = 0.02}, stats);
        const auto repeats = image.plane("repeats");
        const auto at = [&](int x) { return repeats[static_cast<std::size_t>(32 * 192 + x)]; };
        EXPECT_GT(at(20), at(90));
        EXPECT_GE(at(20), kind == SamplerKind::lines ? 512 : 64);
        for (std::size_t i = 0; i < image.pixel_count(); ++i) EXPECT_LE(std::sqrt(image.plane("variance.R")[i]), kind == SamplerKind::lines ? 0.0201 : 0.06);
        MeanVariance left;
        for (int y = 0; y < 64; ++y)
            for (int x = 0; x < 64; ++x) left.add(static_cast<double>(image.plane("A")[static_cast<std::size_t>(y * 192 + x)]));
        EXPECT_NEAR(left.mean(), 0.5, 4 * left.standard_error());
        EXPECT_LE(std::sqrt(left.variance()), 0.0202);
    }
}

TEST(AdaptiveTiles, LooksComeAfterWholeGroups) {
    // An error that is never reached: looks must not change what is drawn.
    const PreparedScene scene = prepare(scene_from(sheets({0.5})));
    for (const std::uint32_t group : {1U, 3U, 5U, 7U, 12U, 40U}) {
        ParticleSettings settings{.repeats = 80, .kind = SamplerKind::stratified, .sampler = {.seed = {5}}, .group = group};
        RenderStats stats;
        const Image full = render_particles(scene, settings, stats);
        settings.max_error = 1e-9;
        const Image looked = render_particles(scene, settings, stats);
        for (const char* plane : {"A", "variance.A", "R"})
            EXPECT_TRUE(std::ranges::equal(full.plane(plane), looked.plane(plane))) << group << ' ' << plane;
    }
}

TEST(AdaptiveTiles, PixelsThatStandAloneKeepTheirPromise) {
    // Cards of one pixel each, 16 pixels apart, four of them in a tile.
    std::string toml = "image.resolution = [128, 128]\n[camera]\nprojection = \"orthographic\"\nposition = [64, 64, 10]\n"
                       "target = [64, 64, 0]\nup = [0, 1, 0]\nview_height = 128\n";
    std::vector<std::size_t> cards;
    for (int y = 8; y < 128; y += 16)
        for (int x = 8; x < 128; x += 16) {
            toml += fmt::format("[[surface]]\nrectangle = {{ center = [{}, {}, 0], u = [0.5, 0, 0], v = [0, 0.5, 0] }}\n"
                                "opacity = 0.5\nshading = \"flat\"\ncolor = [1, 1, 1]\n", x + 0.5, y + 0.5);
            cards.push_back(static_cast<std::size_t>((127 - y) * 128 + x));
        }
    const PreparedScene scene = prepare(scene_from(toml));
    constexpr double kAsked = 0.02;
    MeanVariance error;
    double repeats = 0;
    constexpr int kSeeds = 6;
    for (int seed = 0; seed < kSeeds; ++seed) {
        RenderStats stats;
        const Image image = render_particles(scene,
                                             {.repeats = 4096, .kind = SamplerKind::stratified,
                                              .sampler = {.seed = {static_cast<std::uint64_t>(seed)}}, .group = 8, .max_error = kAsked},
                                             stats);
        for (const std::size_t i : cards) {
            ASSERT_GT(image.plane("A")[i], 0);
            error.add(static_cast<double>(image.plane("A")[i]) - 0.5);
            repeats += static_cast<double>(image.plane("repeats")[i]) / (kSeeds * 64.0);
        }
    }
    const double rms = std::sqrt(error.variance() + error.mean() * error.mean());
    EXPECT_LT(rms, kAsked * (1 + 3 / std::sqrt(2 * 64.0 * kSeeds)));
    EXPECT_LT(repeats, 0.25 / (kAsked * kAsked));  // what independent ones need
}

TEST(AdaptiveTiles, TheirParticlesAreThoseOfAFullRun) {
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [192, 128]\ncamera.position = [0, 0, 4]\n[[surface]]\nimplicit = \"torus\"\nopacity = 0.5\nrotate_degrees = [60, 20, 0]\n"));
    for (const bool stratified : {false, true}) {
        SamplerSettings settings{.seed = {3}};
        if (stratified) settings.stratify = StratifySettings{.group = 4};
        const auto samplers = make_samplers(scene);
        const ParticleSet all = sample_particles(scene, samplers, settings, 0, 4);
        TileMask mask(192, 128);
        mask.active = {1, 0, 1, 0, 0, 1};
        settings.tiles = std::make_shared<TileMask>(mask);
        const ParticleSet some = sample_particles(scene, samplers, settings, 0, 4);
        const twin::Projection projection = all.frame.projection(scene.camera);
        for (std::size_t r = 0; r < 4; ++r) {
            std::vector<Particle> expected = all.repeats[r].particles;
            std::vector<std::uint32_t> ends{static_cast<std::uint32_t>(expected.size())};
            mask.drop_others(expected, ends, projection);
            ASSERT_EQ(expected.size(), some.repeats[r].particles.size());
            EXPECT_EQ(0, std::memcmp(expected.data(), some.repeats[r].particles.data(), expected.size() * sizeof(Particle)));
            EXPECT_LT(expected.size(), all.repeats[r].particles.size());
        }
    }
}

}  // namespace
}  // namespace pellucid
