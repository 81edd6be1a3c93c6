#include <limits>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "core/error.hpp"
#include "measure/comparison.hpp"
#include "measure/image_metrics.hpp"

namespace pellucid {
namespace {

Image grey(int width, int height, float value) {
    Image image(width, height);
    for (const char* name : {"R", "G", "B"}) image.add(name, value);
    return image;
}

Comparison compared(const Image& test, const Image& truth, const ComparisonSettings& settings) {
    return compare_images({"test.exr", test}, {"truth.exr", truth}, settings);
}

template <class F>
std::string refusal(F f) {
    try {
        f();
    } catch (const Error& error) {
        EXPECT_EQ(error.exit_code(), 2);
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
        return error.what();
    }
    return "";
}

TEST(Compare, LimitsAreParsed) {
    const Limit limit = parse_limit("flip=0.05", Bound::at_most);
    EXPECT_EQ(limit.metric, Metric::flip);
    EXPECT_EQ(limit.value, 0.05);
    EXPECT_EQ(parse_limit("psnr=+4e1", Bound::at_least).value, 40);
    EXPECT_EQ(parse_limit("psnr=-3", Bound::at_least).value, -3);
}

TEST(Compare, BadArgumentsAreNamed) {
    for (const char* text : {"", "flip", "flip=", "=1", "flop=1", "flip=nan", "flip=inf", "flip=1x", "flip=1=2", "flip= 1"})
        EXPECT_NE(refusal([&] { (void)parse_limit(text, Bound::at_most); }).find("--max"), std::string::npos) << text;
    for (const char* text : {"", "1", "1,2", "1,2,3,4", "1,2,x", ",,", "1,2,", "nan,0,0", "1e300,0,0"})
        EXPECT_NE(refusal([&] { (void)parse_background(text); }).find("--background"), std::string::npos) << text;
    EXPECT_NE(refusal([] { (void)parse_metrics("sim"); }).find("sim"), std::string::npos);
    EXPECT_EQ(parse_background("1,-0.5,2e-1"), Vec3(1, -0.5, 0.2));
    EXPECT_EQ(parse_metrics("all").size(), 5U);
    EXPECT_EQ(parse_metrics("ssim").size(), 1U);
}

TEST(Compare, ALimitAlsoAsksForItsMetric) {
    const ComparisonSettings settings{.metrics = {Metric::rmse},
                                      .limits = {{Metric::mae, Bound::at_most, 0.2}, {Metric::psnr, Bound::at_least, 21}}};
    const Comparison result = compared(grey(3, 3, 0.1F), grey(3, 3, 0), settings);
    EXPECT_EQ(result.values.size(), 3U);
    ASSERT_EQ(result.limits.size(), 2U);
    EXPECT_TRUE(result.limits[0].passed);
    EXPECT_FALSE(result.limits[1].passed);  // 20 dB
    EXPECT_FALSE(result.passed());
    EXPECT_EQ(describe(result.limits[1], result).substr(0, 5), "psnr ");
}

TEST(Compare, ALimitThatIsMetExactlyHolds) {
    const Image image = grey(3, 3, 0.25F);
    const Comparison result = compared(image, grey(3, 3, 0), {.metrics = {},
                                                              .limits = {{Metric::rmse, Bound::at_most, 0.25},
                                                                         {Metric::rmse, Bound::at_least, 0.25}}});
    EXPECT_TRUE(result.passed());
}

TEST(Compare, EqualImagesHaveNullPsnrThatSatisfiesAMinimumOnly) {
    const Image image = grey(12, 12, 0.5F);
    const Comparison result =
        compared(image, image, {.metrics = parse_metrics("all"),
                                .limits = {{Metric::psnr, Bound::at_least, 1000}, {Metric::psnr, Bound::at_most, 1000}}});
    const auto json = nlohmann::json::parse(comparison_json(result, "test.exr", "truth.exr"));
    EXPECT_TRUE(json["psnr"].is_null());
    EXPECT_EQ(json["rmse"], 0);
    EXPECT_EQ(json["mae"], 0);
    EXPECT_EQ(json["flip"], 0);
    EXPECT_NEAR(json["ssim"].get<double>(), 1, 1e-15);
    EXPECT_TRUE(json["limits"][0]["passed"]);
    EXPECT_FALSE(json["limits"][1]["passed"]);
    EXPECT_FALSE(json["passed"]);
    EXPECT_NE(comparison_text(result).find("psnr inf\n"), std::string::npos);
}

TEST(Compare, JsonSurvivesAnyFileName) {
    const Image image = grey(1, 1, 0);
    const std::string text = comparison_json(compared(image, image, {.metrics = {Metric::mae}}), "\xff\"\n", "b");
    EXPECT_EQ(nlohmann::json::parse(text)["truth"], "b");
}

TEST(Compare, SmallImagesHaveNoSsim) {
    const Image image = grey(5, 5, 0.5F);
    const Comparison result = compared(image, image, {.metrics = parse_metrics("all")});
    EXPECT_FALSE(result.values.at(Metric::ssim));
    EXPECT_TRUE(result.passed());
    EXPECT_NE(refusal([&] {
                  (void)compared(image, image, {.metrics = {}, .limits = {{Metric::ssim, Bound::at_least, 0}}});
              }).find("11x11"),
              std::string::npos);
}

TEST(Compare, RefusesWhatCannotBeCompared) {
    const Image image = grey(4, 4, 0);
    EXPECT_NE(refusal([&] { (void)compared(grey(4, 5, 0), image, {}); }).find("4x5"), std::string::npos);
    EXPECT_NE(refusal([&] { (void)compared(image, Image(4, 4), {}); }).find("truth.exr"), std::string::npos);
    Image bad = image;
    bad.plane("B")[3] = std::numeric_limits<float>::quiet_NaN();
    EXPECT_NE(refusal([&] { (void)compared(bad, image, {}); }).find("NaN"), std::string::npos);
    for (const double ppd : {0.0, -5.0, 1e9, std::numeric_limits<double>::quiet_NaN()})
        EXPECT_NE(refusal([&] { (void)compared(image, image, {.pixels_per_degree = ppd}); }).find("--ppd"),
                  std::string::npos);
}

TEST(Compare, TheBackgroundShowsThrough) {
    Image clear = grey(2, 2, 0);
    clear.add("A", 0.0F);
    const ComparisonSettings settings{.metrics = {Metric::mae}, .background = {1, 1, 1}};
    EXPECT_EQ(*compared(clear, grey(2, 2, 1), settings).values.at(Metric::mae), 0);
    EXPECT_EQ(*compared(clear, grey(2, 2, 0), settings).values.at(Metric::mae), 1);
}

TEST(Compare, TheMapIsFlipsWhereFlipIsComputed) {
    const Image a = grey(3, 2, 0.5F);
    const Image b = grey(3, 2, 0.25F);
    EXPECT_FALSE(compared(a, b, {.metrics = parse_metrics("all")}).map);
    const Comparison error = compared(a, b, {.metrics = {Metric::rmse}, .wants_map = true});
    EXPECT_EQ(error.map->plane("R")[5], 0.25F);
    const Comparison flip_map = compared(a, b, {.metrics = parse_metrics("all"), .wants_map = true});
    const FlipError flip_error =
        flip(over_background(a, Vec3{0.0}, "a"), over_background(b, Vec3{0.0}, "b"));
    const Image expected = magma_image(flip_error.map, 3, 2);
    for (const char* name : {"R", "G", "B"}) EXPECT_EQ(flip_map.map->plane(name)[5], expected.plane(name)[5]);
}

}  // namespace
}  // namespace pellucid
