#include <cmath>
#include <fstream>
#include <limits>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.hpp"
#include "measure/statistics.hpp"

namespace pellucid {
namespace {

std::vector<double> numbers(std::istream& line, int count) {
    std::vector<double> values(static_cast<std::size_t>(count));
    for (double& v : values) line >> v;
    return values;
}

double uniform(std::uint64_t i, std::uint32_t stream) {
    return unit_interval(random_bits({2024}, {static_cast<std::uint32_t>(Purpose::test), stream, i, 0})[0]);
}

TEST(Statistics, AgreesWithSciPy) {
    std::ifstream file(PELLUCID_SOURCE_DIR "/tests/data/statistics.txt");  // tests/oracles/statistics_oracle.py
    std::string text;
    std::getline(file, text);
    int lines = 0;
    while (std::getline(file, text)) {
        SCOPED_TRACE(text.substr(0, 60));
        std::istringstream line(text);
        std::string kind;
        line >> kind;
        const auto near = [](double value, double expected, double relative) {
            EXPECT_NEAR(value, expected, relative * std::abs(expected));
        };
        ++lines;
        if (kind == "normal_quantile") {
            const auto v = numbers(line, 2);
            near(normal_quantile(v[0]), v[1], 1e-13);
        } else if (kind.starts_with("binomial")) {
            const auto v = numbers(line, 4);
            const BinomialLaw law{v[1], v[2]};
            const double value = kind == "binomial_pmf"        ? binomial_pmf(v[0], law)
                                 : kind == "binomial_cdf"      ? binomial_cdf(v[0], law)
                                 : kind == "binomial_survival" ? binomial_survival(v[0], law)
                                                               : binomial_two_sided_p(v[0], law);
            near(value, v[3], 1e-9);
        } else if (kind == "share_outside") {
            const auto v = numbers(line, 3);
            near(binomial_share_outside({v[0], v[1]}), v[2], 1e-9);
        } else if (kind == "chi2_survival") {
            const auto v = numbers(line, 3);
            near(chi2_survival(v[0], v[1]), v[2], 1e-10);
        } else if (kind == "ks") {
            int n = 0;
            line >> n;
            const auto values = numbers(line, n);
            const auto v = numbers(line, 2);
            const auto result = ks_uniformity(values);
            EXPECT_NEAR(result->statistic, v[0], 1e-12);
            EXPECT_NEAR(result->p_value, v[1], 1e-3);  // exact law there, corrected asymptotic one here
        } else if (kind == "moments") {
            int n = 0;
            line >> n;
            const auto values = numbers(line, n);
            const auto v = numbers(line, 4);
            MeanVariance moments;
            for (const double x : values) moments.add(x);
            EXPECT_NEAR(moments.mean(), v[0], 1e-14);
            EXPECT_NEAR(moments.variance(), v[1], 1e-14);
            EXPECT_NEAR(*median(values), v[2], 1e-15);
            EXPECT_NEAR(*quantile(values, 0.9), v[3], 1e-14);
        } else {
            ADD_FAILURE() << "unknown line";
        }
        EXPECT_TRUE(line);
    }
    EXPECT_EQ(lines, 60);
}

TEST(Statistics, SidakFamilyOfIndependentTestsHasTheAskedLevel) {
    for (const double tests : {1.0, 7.0, 1e6, 1e12}) {
        const double each = sidak_level(0.01, tests);
        EXPECT_NEAR(-std::expm1(tests * std::log1p(-each)), 0.01, 1e-15);
        EXPECT_NEAR(normal_two_sided_p(sidak_critical_value(0.01, tests)) / each, 1, 1e-11);
    }
    EXPECT_NEAR(sidak_critical_value(0.05, 1), 1.959963984540054, 1e-12);
}

TEST(Statistics, QuantileOfTheNormalLawIsFiniteForEveryP) {
    for (const double p : {-1.0, 0.0, 5e-324, 1.0, 2.0}) EXPECT_TRUE(std::isfinite(normal_quantile(p)));
    EXPECT_NEAR(z_from_tails(1, 1e-200), -normal_quantile(1e-200), 0);
    EXPECT_NEAR(normal_cdf(normal_quantile(1e-5)), 1e-5, 1e-18);
}

TEST(Statistics, SureOutcomesNeverLieOutside) {
    EXPECT_EQ(binomial_share_outside({500, 0}), 0);
    EXPECT_EQ(binomial_share_outside({500, 1}), 0);
    // The known corner: three sigmas hold less than a normal law's 99.73 % for rare events.
    EXPECT_GT(binomial_share_outside({500, 0.001}), 0.0027);
}

TEST(Statistics, RandomizedZIsStandardNormalForAFewTrials) {
    const BinomialLaw law{3, 0.2};
    std::vector<double> p;
    for (std::uint64_t i = 0; i < 4000; ++i) {
        double k = 0;
        for (std::uint32_t t = 0; t < 3; ++t) k += uniform(i, t) < 0.2 ? 1 : 0;
        p.push_back(normal_cdf(binomial_randomized_z(k, law, uniform(i, 9))));
    }
    EXPECT_GT(ks_uniformity(p)->p_value, 1e-3);
    // The same draws under a law that is off by a tenth are found out.
    for (std::uint64_t i = 0; i < 4000; ++i) {
        double k = 0;
        for (std::uint32_t t = 0; t < 3; ++t) k += uniform(i, t) < 0.22 ? 1 : 0;
        p[i] = normal_cdf(binomial_randomized_z(k, law, uniform(i, 9)));
    }
    EXPECT_LT(ks_uniformity(p)->p_value, 1e-3);
}

TEST(Statistics, RandomizedZIsFiniteForImpossibleOutcomes) {
    EXPECT_LT(binomial_randomized_z(1, {10, 0}, 0.5) * -1, -37);
    EXPECT_LT(binomial_randomized_z(9, {10, 1}, 0.5), -37);
    EXPECT_TRUE(std::isfinite(binomial_randomized_z(-5, {10, 0.5}, 0.5)));
    EXPECT_TRUE(std::isfinite(binomial_randomized_z(15, {10, 0.5}, 0.5)));
    EXPECT_NEAR(binomial_randomized_z(0, {0, 0.5}, 0.5), 0, 1e-14);
}

/// How often a test of level 5 % rejects 400 true hypotheses, itself judged by an exact binomial test.
template <class Test>
void expect_level(Test rejects) {
    double rejected = 0;
    for (std::uint32_t run = 0; run < 400; ++run) rejected += rejects(run) ? 1 : 0;
    EXPECT_GT(binomial_two_sided_p(rejected, {400, 0.05}), 1e-3) << rejected << " of 400";
}

TEST(Statistics, KolmogorovSmirnovHasItsLevel) {
    expect_level([](std::uint32_t run) {
        std::vector<double> values;
        for (std::uint64_t i = 0; i < 50; ++i) values.push_back(uniform(i, run));
        return ks_uniformity(values)->p_value < 0.05;
    });
}

TEST(Statistics, Chi2UniformityHasItsLevel) {
    expect_level([](std::uint32_t run) {
        std::vector<std::int64_t> counts(10);
        for (std::uint64_t i = 0; i < 500; ++i) ++counts[static_cast<std::size_t>(10 * uniform(i, run))];
        return chi2_uniformity(counts)->p_value < 0.05;
    });
}

TEST(Statistics, UniformityTestsRejectAWrongLaw) {
    std::vector<double> values;
    std::vector<std::int64_t> counts(10);
    for (std::uint64_t i = 0; i < 2000; ++i) {
        values.push_back(std::pow(uniform(i, 1), 1.2));
        ++counts[static_cast<std::size_t>(10 * values.back())];
    }
    EXPECT_LT(ks_uniformity(values)->p_value, 1e-4);
    EXPECT_LT(chi2_uniformity(counts)->p_value, 1e-4);
    const std::vector<double> thirds{0.2, 0.3, 0.5};
    const std::vector<std::int64_t> fair{20, 30, 50};
    EXPECT_EQ(chi2_test(fair, thirds)->statistic, 0);
    EXPECT_EQ(chi2_test(fair, thirds)->p_value, 1);
}

TEST(Statistics, NothingToTestIsEmpty) {
    EXPECT_FALSE(ks_uniformity({}));
    EXPECT_FALSE(ks_uniformity(std::vector<double>{std::numeric_limits<double>::quiet_NaN()}));
    EXPECT_FALSE(chi2_uniformity({}));
    EXPECT_FALSE(chi2_uniformity(std::vector<std::int64_t>{3}));
    EXPECT_FALSE(chi2_uniformity(std::vector<std::int64_t>{0, 0}));
    EXPECT_FALSE(chi2_test(std::vector<std::int64_t>{1, 2}, std::vector<double>{1.0}));
    EXPECT_FALSE(median({}));
    EXPECT_EQ(*median(std::vector<double>{4}), 4);
    EXPECT_EQ(*median(std::vector<double>{4, 1}), 2.5);
}

TEST(MeanVariance, MergedPartsEqualTheWhole) {
    MeanVariance whole;
    MeanVariance parts[3];
    for (std::uint64_t i = 0; i < 100; ++i) {
        const double x = 1e9 + uniform(i, 2);  // a large mean, on which Σx² − (Σx)²/n has no digits left
        whole.add(x);
        parts[i < 10 ? 0 : i < 11 ? 1 : 2].add(x);
    }
    MeanVariance merged;
    for (const MeanVariance& part : parts) merged.merge(part);
    merged.merge(MeanVariance{});
    EXPECT_EQ(merged.count(), whole.count());
    EXPECT_NEAR(merged.mean(), whole.mean(), 1e-6);
    EXPECT_NEAR(merged.variance(), whole.variance(), 1e-6);
    EXPECT_NEAR(whole.variance(), 1.0 / 12, 0.03);
    EXPECT_EQ(MeanVariance{}.variance(), 0);
    EXPECT_EQ(MeanVariance{}.standard_error(), 0);
}

TEST(RankCorrelation, SeesOrderAloneAndSharesRanksOfTies) {
    const std::vector<double> a{1, 2, 3, 4, 5};
    EXPECT_DOUBLE_EQ(*rank_correlation(a, std::vector<double>{1, 10, 100, 1000, 1e9}), 1);
    EXPECT_DOUBLE_EQ(*rank_correlation(a, std::vector<double>{5, 4, 3, 2, -1e9}), -1);
    // scipy.stats.spearmanr([1, 2, 3, 4, 5], [2, 1, 4, 4, 3]): 0.5642880936468347
    EXPECT_NEAR(*rank_correlation(a, std::vector<double>{2, 1, 4, 4, 3}), 0.5642880936468347, 1e-12);
    EXPECT_FALSE(rank_correlation(a, std::vector<double>{7, 7, 7, 7, 7}));
    EXPECT_FALSE(rank_correlation(std::vector<double>{1.0}, std::vector<double>{1.0}));
}

}  // namespace
}  // namespace pellucid
