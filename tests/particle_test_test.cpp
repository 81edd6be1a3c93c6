#include "measure/particle_test.hpp"

#include <array>
#include <cmath>

#include <gtest/gtest.h>

#include "io/config.hpp"
#include "reference/truth.hpp"
#include "render/particles.hpp"
#include "scene/scene_file.hpp"

namespace pellucid {
namespace {

constexpr double kLevel = 1e-4;

/// A picture as theory draws it: every repeat of every pixel a coin of its own.
struct CoinPicture {
    std::vector<float> drawn, truth, sharp;

    CoinPicture(std::size_t pixels, int repeats, double bias = 1) : drawn(pixels), truth(pixels), sharp(pixels) {
        RandomStream random({7}, {.object = static_cast<std::uint32_t>(Purpose::test)});
        for (std::size_t i = 0; i < pixels; ++i) {
            truth[i] = static_cast<float>(0.02 + 0.95 * static_cast<double>(i) / static_cast<double>(pixels));
            int hits = 0;
            for (int r = 0; r < repeats; ++r) hits += unit_interval(random()) < bias * truth[i] ? 1 : 0;
            drawn[i] = static_cast<float>(hits) / static_cast<float>(repeats);
        }
    }
};

PreparedScene scene_of(const std::string& surfaces) {
    return prepare(scene_from_config(Config::parse("[image]\nresolution = [40, 40]\n[camera]\nposition = [0, 0, 5]\n"
                                                   "target = [0, 0, 0]\nfov_degrees = 30\n" + surfaces, "test.toml")));
}

const char* const kTwoBalls = "[[surface]]\nname = \"ball\"\nimplicit = \"sphere\"\nparameters = { radius = 1 }\nopacity = 0.3\n"
                              "[[surface]]\nname = \"core\"\nimplicit = \"sphere\"\nparameters = { radius = 0.5 }\nopacity = 0.4\n"
                              "opacity_law = \"oblique\"\ncolor = [0.9, 0.2, 0.1]\n";

Image draw(const PreparedScene& scene, std::uint32_t repeats, const SamplerSettings& sampler) {
    ParticleSettings settings{.repeats = repeats, .sampler = sampler, .max_error = {}};
    RenderStats stats;
    return render_particles(scene, settings, stats);
}

Image trace(const PreparedScene& scene, PixelFilter filter) {
    TruthStats stats;
    return trace_truth(scene, {.filter = filter, .seed = {5}, .max_error = 0.001, .max_samples = 1024}, stats);
}

CoverageTest test(const Image& drawn, const Image& truth, double repeats) {
    return test_coverage(drawn.plane("A"), truth.plane("A"), truth.plane("variance.A"), {.repeats = repeats, .seed = {9}});
}

TEST(ParticleTest, FairCoinsPass) {
    const CoinPicture coins(20000, 100);
    const CoverageTest result = test_coverage(coins.drawn, coins.truth, coins.sharp, {.repeats = 100, .seed = {1}});
    EXPECT_EQ(result.pixels.size(), 20000U);
    EXPECT_GT(result.smallest_p(), kLevel);
    EXPECT_NEAR(static_cast<double>(result.outside), result.outside_expected, 5 * std::sqrt(result.outside_variance));
}

TEST(ParticleTest, CoinsOffByOnePercentFail) {
    const CoinPicture coins(20000, 400, 0.99);
    EXPECT_LT(test_coverage(coins.drawn, coins.truth, coins.sharp, {.repeats = 400, .seed = {1}}).smallest_p(), kLevel);
}

TEST(ParticleTest, TooManyOutliersFailThoughTheBulkIsRight) {
    CoinPicture coins(20000, 100);
    for (std::size_t i = 0; i < coins.drawn.size(); i += 200) coins.drawn[i] = coins.truth[i] > 0.5F ? 0.0F : 1.0F;
    EXPECT_LT(test_coverage(coins.drawn, coins.truth, coins.sharp, {.repeats = 100, .seed = {1}}).outside_test.p_value, kLevel);
}

TEST(ParticleTest, PixelsAreChosenByTheTruthAlone) {
    const std::vector<float> truth{0.0F, 0.5F, 0.5F, 1.0F, 0.5F};
    const std::vector<float> variance{0.0F, 0.0F, 1e-3F, 0.0F, 2e-5F};  // sigma² = 0.25/100, a hundredth of it 2.5e-5
    const std::vector<float> drawn{0.0F, 0.0F, 0.5F, 1.0F, 1.0F};
    const CoverageTest result = test_coverage(drawn, truth, variance, {.repeats = 100, .seed = {}});
    ASSERT_EQ(result.pixels.size(), 2U);
    EXPECT_EQ(result.pixels[0].pixel, 1U);
    EXPECT_EQ(result.pixels[1].pixel, 4U);
    EXPECT_EQ(result.left_out, 1);
    EXPECT_NEAR(result.worst_error_share, std::sqrt(2e-5 / 2.5e-3), 1e-6);
    EXPECT_TRUE(result.pixels[0].outside);
}

TEST(ParticleTest, NoPixelsIsNoVerdict) {
    const std::vector<float> nothing(4, 0.0F);
    const CoverageTest result = test_coverage(nothing, nothing, nothing, CoverageRule{});
    EXPECT_TRUE(result.pixels.empty());
    EXPECT_FALSE(result.ks.has_value());
    EXPECT_EQ(result.smallest_p(), 1);
}

TEST(ParticleTest, HistogramsHoldEveryPixelAndExpectAsMany) {
    const CoinPicture coins(5000, 50);
    const CoverageTest result = test_coverage(coins.drawn, coins.truth, coins.sharp, {.repeats = 50, .seed = {}});
    for (const Histogram& histogram : {p_value_histogram(result), z_histogram(result)}) {
        std::int64_t pixels = 0;
        double expected = 0;
        for (std::size_t i = 0; i < histogram.counts.size(); ++i) {
            pixels += histogram.counts[i];
            expected += histogram.expected[i];
        }
        EXPECT_EQ(pixels, 5000);
        EXPECT_NEAR(expected, 5000, 1e-6);
    }
}

TEST(ParticleTest, OpacityOffByDoublesTheOpticalDepth) {
    const std::vector<float> wrong = opacity_off_by(std::vector<float>{0.0F, 0.5F, 1.0F}, 1.0);
    EXPECT_EQ(wrong[0], 0.0F);
    EXPECT_FLOAT_EQ(wrong[1], 0.75F);  // 1 − ½²
    EXPECT_EQ(wrong[2], 1.0F);
}

TEST(ParticleTest, EmptyMeansEmptyAllAround) {
    std::vector<float> truth(25, 0.0F), drawn(25, 0.0F);
    truth[0] = 0.5F;                      // its three neighbours are the rim
    drawn[1] = drawn[24] = 0.01F;
    const EmptyPixels found = test_empty(drawn, truth, 5);
    EXPECT_EQ(found.pixels, 21);
    EXPECT_EQ(found.drawn, 1);
    EXPECT_EQ(found.rim, 3);
    EXPECT_EQ(found.rim_drawn, 1);
}

/// One layer of one colour: covered or not, c·coin.
struct ColorPicture {
    Image drawn{100, 100}, truth{100, 100};

    explicit ColorPicture(int repeats, float bias = 0) {
        RandomStream random({8}, {.object = static_cast<std::uint32_t>(Purpose::test)});
        for (const char* const c : {"R", "G", "B", "A"}) {
            drawn.add(c);
            truth.add(c);
            truth.add(std::string("variance.") + c);
            truth.add(std::string("repeat_variance.") + c);
        }
        for (std::size_t i = 0; i < drawn.pixel_count(); ++i) {
            int hits = 0;
            for (int r = 0; r < repeats; ++r) hits += unit_interval(random()) < 0.3 ? 1 : 0;
            for (const char* const c : {"R", "G", "B", "A"}) {
                const float value = *c == 'A' ? 1.0F : 0.8F;
                truth.plane(c)[i] = 0.3F * value;
                truth.plane(std::string("repeat_variance.") + c)[i] = 0.21F * value * value;
                drawn.plane(c)[i] = value * static_cast<float>(hits) / static_cast<float>(repeats) + bias;
            }
        }
    }
};

TEST(ColorTest, FairNoiseIsTheNoiseFloor) {
    const ColorPicture picture(50);
    const ColorTest result = test_colors(picture.drawn, picture.truth, 50);
    EXPECT_NEAR(result.floor, 0.8 * std::sqrt(0.21 / 50), 1e-6);
    EXPECT_GT(result.p_value, kLevel);
    // 10⁴ pixels whose channels are one: Var(x̄²) = 2σ⁴ and a little for the coin's kurtosis.
    EXPECT_NEAR(result.ratio_error, std::sqrt(2.0 / 1e4) / 2, 1e-4);
}

TEST(ColorTest, AShiftOfAThirdOfTheNoiseIsSeen) {
    const double sigma = 0.8 * std::sqrt(0.21 / 50);
    const ColorPicture picture(50, static_cast<float>(sigma / 3));
    EXPECT_LT(test_colors(picture.drawn, picture.truth, 50).p_value, kLevel);
}

TEST(ColorTest, TheTruthsOwnErrorIsExpected) {
    ColorPicture picture(50);
    for (const char* const c : {"variance.R", "variance.G", "variance.B"})
        for (float& v : picture.truth.plane(c)) v = static_cast<float>(0.64 * 0.21 / 50);  // as large as the noise
    EXPECT_NEAR(test_colors(picture.drawn, picture.truth, 50).ratio, std::sqrt(0.5), 0.02);
}

TEST(EdgeBias, IsTheSignedDifferenceAndCountsWhatNoiseCannotHide) {
    ColorPicture picture(50);
    Image box = picture.truth;
    box.plane("G")[3] -= 0.5F;
    const EdgeBias bias = edge_bias(picture.truth, box, 50);
    EXPECT_FLOAT_EQ(bias.map.plane("G")[3], 0.5F);
    EXPECT_EQ(bias.map.plane("R")[3], 0.0F);
    EXPECT_NEAR(bias.rmse, std::sqrt(0.25 / 3e4), 1e-8);
    EXPECT_DOUBLE_EQ(bias.share_above_noise, 1e-4);
}

TEST(SurfaceClasses, TellObjectsAndEdgesApart) {
    const std::vector<SurfaceClass> classes = surface_classes(scene_of(kTwoBalls));
    const auto at = [&](std::size_t x, std::size_t y) { return classes[y * 40 + x]; };
    EXPECT_EQ(at(0, 0).objects, 0U);
    EXPECT_EQ(at(20, 20).objects, 3U);
    EXPECT_FALSE(at(20, 20).edge);
    EXPECT_EQ(at(20, 9).objects, 1U);  // 0.75 off the axis: between the two radii
    EXPECT_FALSE(at(20, 9).edge);
    std::size_t edges = 0;
    for (const SurfaceClass& each : classes) edges += each.edge ? 1 : 0;
    EXPECT_GT(edges, 100U);  // two circles of radius 7 and 15 pixels
    EXPECT_LT(edges, 300U);
}

TEST(SurfaceClasses, PartitionTheTestedPixels) {
    const PreparedScene scene = scene_of(kTwoBalls);
    const Image truth = trace(scene, PixelFilter::particle);
    const CoverageTest result = test(draw(scene, 50, {.seed = {3}, .exact_count = {}}), truth, 50);
    std::int64_t pixels = 0, outside = 0;
    for (const ClassOutcome& each : outside_by_class(result, surface_classes(scene))) {
        pixels += each.pixels;
        outside += each.outside;
    }
    EXPECT_EQ(pixels, static_cast<std::int64_t>(result.pixels.size()));
    EXPECT_EQ(outside, result.outside);
}

TEST(ParticlePicture, TwoBallsEqualTheirTruth) {
    const PreparedScene scene = scene_of(kTwoBalls);
    const Image truth = trace(scene, PixelFilter::particle);
    const Image drawn = draw(scene, 200, {.seed = {3}, .exact_count = {}});
    EXPECT_GT(test(drawn, truth, 200).pixels.size(), 500U);
    EXPECT_GT(test(drawn, truth, 200).smallest_p(), kLevel);
    EXPECT_GT(test_colors(drawn, truth, 200).p_value, kLevel);
    EXPECT_EQ(test_empty(drawn.plane("A"), truth.plane("A"), 40).drawn, 0);
}

TEST(ParticlePicture, WrongTwinOneSetForAllRepeatsIsRejected) {
    const PreparedScene scene = scene_of(kTwoBalls);
    const Image truth = trace(scene, PixelFilter::particle);
    SamplerSettings one_set{.seed = {3}, .exact_count = {}};
    one_set.same_set_in_all_repeats = true;
    const Image drawn = draw(scene, 20, one_set);
    EXPECT_LT(test(drawn, truth, 20).smallest_p(), kLevel);
    EXPECT_LT(test_colors(drawn, truth, 20).p_value, kLevel);
}

TEST(ParticlePicture, WrongTwinBoxFilteredTruthIsRejected) {
    const PreparedScene scene = scene_of(kTwoBalls);
    Image box = trace(scene, PixelFilter::box);
    const Image drawn = draw(scene, 1000, {.seed = {3}, .exact_count = {}});
    // A lenient rule, so that edges, where the filters differ, take part.
    const CoverageRule rule{.repeats = 1000, .largest_error_share = 1, .seed = {9}};
    EXPECT_LT(test_coverage(drawn.plane("A"), box.plane("A"), box.plane("variance.A"), rule).smallest_p(), kLevel);
}

// Two sheets a tenth of a pixel apart: lines that cross one cross the other in the same pixel.
TEST(ParticlePicture, WrongTwinAllCrossingsOfALineIsRejected) {
    const PreparedScene scene = scene_of("[[surface]]\nname = \"lens\"\nimplicit = \"ellipsoid\"\n"
                                         "parameters = { a = 1, b = 1, c = 0.003 }\nopacity = 0.3\n");
    const Image truth = trace(scene, PixelFilter::particle);
    SamplerSettings sampler{.seed = {3}, .exact_count = {}};
    EXPECT_GT(test(draw(scene, 100, sampler), truth, 100).smallest_p(), kLevel);
    sampler.keep_all_crossings = true;
    EXPECT_LT(test(draw(scene, 100, sampler), truth, 100).smallest_p(), kLevel);
}

}  // namespace
}  // namespace pellucid
