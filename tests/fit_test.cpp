#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "measure/fit.hpp"
#include "measure/statistics.hpp"

namespace pellucid {
namespace {

struct Truth {
    double area = 1;
    double exponent = 1;
    bool poisson = false;
};

double opacity(const OpacityPoint& point, const Truth& truth) {
    std::vector<RingPart> parts = point.ring;
    if (parts.empty()) parts.push_back({1, point.cos_tilt});
    double alpha = 0;
    for (const RingPart& part : parts) {
        const double p = truth.area * point.ratio / std::pow(part.cos_tilt, truth.exponent);
        alpha += part.weight * (truth.poisson ? 1 - std::exp(-point.count * p) : 1 - std::pow(1 - p, point.count));
    }
    return alpha;
}

/// Six opacities at seven tilts, drawn over 500 repeats of 4 pixels with Gaussian noise of theory's variance.
std::vector<OpacityPoint> drawn_points(std::mt19937_64& random, const Truth& truth, double ratio = 1e-3,
                                       double samples = 2000) {
    std::vector<OpacityPoint> points;
    for (const double alpha : {0.05, 0.1, 0.3, 0.5, 0.8, 0.95})
        for (const double tilt_deg : {0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 80.0}) {
            OpacityPoint point{.count = std::ceil(std::log(1 - alpha) / std::log(1 - ratio)),
                               .ratio = ratio,
                               .cos_tilt = std::cos(tilt_deg * 0.017453292519943295)};
            const double expected = opacity(point, {});
            point.alpha_variance = expected * (1 - expected) / samples;
            point.alpha_drawn =
                opacity(point, truth) + std::normal_distribution<double>(0, std::sqrt(point.alpha_variance))(random);
            points.push_back(point);
        }
    return points;
}

const FitParameter& parameter(const FitResult& result, const std::string& name) {
    return *std::find_if(result.parameters.begin(), result.parameters.end(),
                         [&](const FitParameter& p) { return p.name == name; });
}

/// Share of 200 synthetic sets whose 90 % interval holds the truth, judged by an exact binomial test.
void expect_coverage(OpacityModel model, const Truth& truth) {
    std::mt19937_64 random(17);
    double holds_a = 0;
    double holds_p = 0;
    std::vector<double> p_values;
    for (int set = 0; set < 200; ++set) {
        const FitResult fit = fit_opacity(drawn_points(random, truth), model, 0.9);
        ASSERT_TRUE(fit.converged);
        ASSERT_EQ(fit.used, 42U);
        p_values.push_back(fit.p_value);
        const auto holds = [&](const char* name, double value) {
            const FitParameter& p = parameter(fit, name);
            return p.low <= value && value <= p.high ? 1.0 : 0.0;
        };
        if (model != OpacityModel::tilt_exponent) holds_a += holds("a", truth.area);
        if (model != OpacityModel::effective_area) holds_p += holds("p", truth.exponent);
    }
    if (model != OpacityModel::tilt_exponent) {
        EXPECT_GT(binomial_two_sided_p(holds_a, {200, 0.9}), 1e-3) << holds_a;
    }
    if (model != OpacityModel::effective_area) {
        EXPECT_GT(binomial_two_sided_p(holds_p, {200, 0.9}), 1e-3) << holds_p;
    }
    // χ² has its own law too.
    EXPECT_GT(ks_uniformity(p_values)->p_value, 1e-3);
}

TEST(Fit, IntervalsOfTheAreaHoldTheTruthAsOftenAsTheySay) {
    expect_coverage(OpacityModel::effective_area, {.area = 1});
    expect_coverage(OpacityModel::effective_area, {.area = 1.1});
}
TEST(Fit, IntervalsOfTheExponentHoldTheTruthAsOftenAsTheySay) {
    expect_coverage(OpacityModel::tilt_exponent, {.exponent = 1});
    expect_coverage(OpacityModel::tilt_exponent, {.exponent = 0.9});
}
TEST(Fit, IntervalsOfBothHoldTheTruthAsOftenAsTheySay) {
    expect_coverage(OpacityModel::both, {.area = 1.05, .exponent = 0.95});
}

TEST(Fit, ExactDataGiveTheParametersBack) {
    std::mt19937_64 random(1);
    std::vector<OpacityPoint> points = drawn_points(random, {});
    for (OpacityPoint& point : points) point.alpha_drawn = opacity(point, {.area = 1.3, .exponent = 0.8});
    const FitResult fit = fit_opacity(points, OpacityModel::both);
    ASSERT_TRUE(fit.converged);
    EXPECT_NEAR(parameter(fit, "a").value, 1.3, 1e-9);
    EXPECT_NEAR(parameter(fit, "p").value, 0.8, 1e-9);
    EXPECT_LT(fit.chi2, 1e-12);
    EXPECT_EQ(fit.dof, 40);
    ASSERT_EQ(fit.covariance.size(), 4U);
    EXPECT_EQ(fit.covariance[1], fit.covariance[2]);
    EXPECT_NEAR(std::sqrt(fit.covariance[3]), parameter(fit, "p").standard_error, 1e-15);
}

TEST(Fit, KeepsDigitsAtTinyRatios) {
    // Ratio 1e-12: evaluated as printed, (1 − p)^n would be off by 1e-4 of the opacity.
    OpacityPoint point{.count = 7e11, .ratio = 1e-12, .cos_tilt = 1, .alpha_variance = 1e-20};
    point.alpha_drawn = -std::expm1(-0.7 * 1.001);
    const FitResult fit = fit_opacity({&point, 1}, OpacityModel::effective_area);
    ASSERT_TRUE(fit.converged);
    EXPECT_NEAR(parameter(fit, "a").value, 1.001, 1e-9);
}

TEST(Fit, BiasedDataAreRejected) {
    std::mt19937_64 random(3);
    const auto points = drawn_points(random, {.area = 1.05});
    EXPECT_LT(test_opacity(points).p_value, 1e-6);
    const FitResult area = fit_opacity(points, OpacityModel::effective_area);
    EXPECT_GT(parameter(area, "a").low, 1);
    EXPECT_GT(area.p_value, 1e-3);  // and the right cause explains them
    // A wrong cause does not: an exponent cannot make up for an area.
    EXPECT_LT(fit_opacity(points, OpacityModel::tilt_exponent).p_value, 1e-3);
    EXPECT_GT(test_opacity(drawn_points(random, {})).p_value, 1e-3);
}

TEST(Fit, RingsOfTiltsAreMixed) {
    std::mt19937_64 random(4);
    std::vector<OpacityPoint> points = drawn_points(random, {});
    for (OpacityPoint& point : points) {
        point.ring = {{0.25, point.cos_tilt}, {0.5, 0.5 * (1 + point.cos_tilt)}, {0.25, 1.0}};
        point.alpha_drawn = opacity(point, {.area = 1.2, .exponent = 1.1});
        point.cos_tilt = std::numeric_limits<double>::quiet_NaN();  // not used
    }
    const FitResult fit = fit_opacity(points, OpacityModel::both);
    ASSERT_TRUE(fit.converged);
    EXPECT_NEAR(parameter(fit, "a").value, 1.2, 1e-8);
    EXPECT_NEAR(parameter(fit, "p").value, 1.1, 1e-8);
}

TEST(Fit, PointsWithoutInformationAreSkippedAndCounted) {
    std::mt19937_64 random(5);
    std::vector<OpacityPoint> points = drawn_points(random, {});
    const std::size_t good = points.size();
    const OpacityPoint base = points.front();
    const auto spoilt = [&](auto change) {
        OpacityPoint point = base;
        change(point);
        points.push_back(point);
    };
    spoilt([](OpacityPoint& p) { p.alpha_variance = 0; });
    spoilt([](OpacityPoint& p) { p.alpha_drawn = std::numeric_limits<double>::quiet_NaN(); });
    spoilt([](OpacityPoint& p) { p.ratio = 0.5, p.cos_tilt = 0.4; });
    spoilt([](OpacityPoint& p) { p.count = 1e9; });  // saturated
    spoilt([](OpacityPoint& p) { p.count = 0; });
    spoilt([](OpacityPoint& p) { p.cos_tilt = 0; });
    spoilt([](OpacityPoint& p) { p.ring = {{0, 1}}; });
    const FitResult fit = fit_opacity(points, OpacityModel::both);
    EXPECT_TRUE(fit.converged);
    EXPECT_EQ(fit.used, good);
    EXPECT_EQ(fit.skipped, 7U);
    EXPECT_EQ(test_opacity(points).skipped, 7U);
}

TEST(Fit, DoesNotConvergeOnWhatCannotBeKnown) {
    EXPECT_FALSE(fit_opacity({}, OpacityModel::effective_area).converged);
    std::mt19937_64 random(6);
    std::vector<OpacityPoint> straight = drawn_points(random, {});
    for (OpacityPoint& point : straight) point.cos_tilt = 1;
    EXPECT_FALSE(fit_opacity(straight, OpacityModel::tilt_exponent).converged);
    EXPECT_FALSE(fit_opacity(straight, OpacityModel::both).converged);
    EXPECT_FALSE(fit_opacity(std::span(straight).first(1), OpacityModel::both).converged);
    EXPECT_FALSE(test_opacity({}).converged);
    EXPECT_FALSE(compare_count_laws({}));
}

TEST(CountLaws, TheRightOneWins) {
    // ratio 0.05: 1 − (1 − p)^n and 1 − exp(−np) are 0.01 apart, many sigmas of 1e5 samples.
    std::mt19937_64 random(7);
    const auto fixed = compare_count_laws(drawn_points(random, {}, 0.05, 1e5));
    ASSERT_TRUE(fixed);
    EXPECT_GT(fixed->delta_chi2_theory, 50);
    EXPECT_GT(fixed->log10_bayes_factor, 10);
    EXPECT_GT(fixed->akaike_weight_binomial, 0.999);
    EXPECT_NEAR(fixed->binomial.log_likelihood_theory - fixed->poisson.log_likelihood_theory,
                0.5 * fixed->delta_chi2_theory, 1e-6 * fixed->delta_chi2_theory);

    const auto poisson = compare_count_laws(drawn_points(random, {.poisson = true}, 0.05, 1e5));
    ASSERT_TRUE(poisson);
    EXPECT_LT(poisson->log10_bayes_factor, -10);
    EXPECT_LT(poisson->akaike_weight_binomial, 0.001);
    EXPECT_GT(poisson->poisson.free_area.p_value, 1e-3);
}

TEST(CountLaws, CannotBeToldApartWhereTheyAgree) {
    std::mt19937_64 random(8);
    const auto both = compare_count_laws(drawn_points(random, {}, 1e-7));
    ASSERT_TRUE(both);
    EXPECT_NEAR(both->log10_bayes_factor, 0, 0.01);
    EXPECT_NEAR(both->akaike_weight_binomial, 0.5, 0.01);
}

TEST(PowerLaw, SlopeIntervalsHoldTheTruthAsOftenAsTheySay) {
    std::mt19937_64 random(9);
    double holds_known = 0;
    double holds_unknown = 0;
    for (int set = 0; set < 200; ++set) {
        std::vector<ErrorPoint> points;
        for (const double repeats : {1.0, 4.0, 16.0, 64.0, 256.0, 1024.0}) {
            const double noise = std::normal_distribution<double>(0, 0.02)(random);
            points.push_back({repeats, 0.3 * std::pow(repeats, -0.5) * std::exp(noise), 0.02});
        }
        const auto holds = [](const FitResult& fit) {
            return fit.converged && fit.parameters[0].low <= -0.5 && -0.5 <= fit.parameters[0].high ? 1.0 : 0.0;
        };
        holds_known += holds(fit_power_law(points, 0.9));
        for (ErrorPoint& point : points) point.relative_error = 0;
        holds_unknown += holds(fit_power_law(points, 0.9));
    }
    EXPECT_GT(binomial_two_sided_p(holds_known, {200, 0.9}), 1e-3) << holds_known;
    EXPECT_GT(binomial_two_sided_p(holds_unknown, {200, 0.9}), 1e-3) << holds_unknown;
}

TEST(PowerLaw, ExactLineAndSkippedPoints) {
    const std::vector<ErrorPoint> points{{1, 2, 0.1}, {100, 0.2, 0.1}, {0, 1, 0.1}, {4, 0, 0.1}, {9, 1, 0}};
    const FitResult fit = fit_power_law(points);
    ASSERT_TRUE(fit.converged);
    EXPECT_EQ(fit.skipped, 3U);
    EXPECT_NEAR(fit.parameters[0].value, -0.5, 1e-12);
    EXPECT_NEAR(fit.parameters[1].value, std::log(2), 1e-12);
    EXPECT_FALSE(fit_power_law(std::span(points).first(1)).converged);
    const std::vector<ErrorPoint> two{{1, 2, 0}, {100, 0.2, 0}};
    EXPECT_FALSE(fit_power_law(two).converged);  // no scatter to judge by
    const std::vector<ErrorPoint> same{{4, 2, 0.1}, {4, 0.2, 0.1}, {4, 1, 0.1}};
    EXPECT_FALSE(fit_power_law(same).converged);
}

}  // namespace
}  // namespace pellucid
