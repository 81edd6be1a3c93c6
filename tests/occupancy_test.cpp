#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <vector>

#include <boost/multiprecision/cpp_dec_float.hpp>
#include <gtest/gtest.h>

#include "core/random.hpp"
#include "measure/occupancy.hpp"
#include "measure/statistics.hpp"

namespace pellucid {
namespace {

using Wide = boost::multiprecision::number<boost::multiprecision::cpp_dec_float<100>>;

/// [M q₁ + M(M−1) q₂ − M² q₁²]/M² as printed, 100 digits; `p` exactly as the double that was given.
Wide printed_variance(const PatchPixels& patch) {
    const Wide m(patch.pixels);
    const Wide q1 = pow(1 - 1 / Wide(patch.span), Wide(patch.particles));
    const Wide q2 = pow(1 - 2 / Wide(patch.span), Wide(patch.particles));
    return (m * q1 + m * (m - 1) * q2 - m * m * q1 * q1) / (m * m);
}

Wide printed_variance(double n, const std::vector<PixelClass>& classes) {
    Wide pixels = 0;
    Wide sum = 0;
    for (const auto& k : classes) {
        const Wide q = pow(1 - Wide(k.landing), Wide(n));
        pixels += Wide(k.pixels);
        sum += Wide(k.pixels) * q * (1 - q);
        for (const auto& l : classes) {
            const Wide pairs = Wide(k.pixels) * (Wide(l.pixels) - (&k == &l ? 1 : 0));
            if (pairs == 0) continue;
            const Wide ql = pow(1 - Wide(l.landing), Wide(n));
            sum += pairs * (pow(1 - Wide(k.landing) - Wide(l.landing), Wide(n)) - q * ql);
        }
    }
    return sum / (pixels * pixels);
}

double relative(double value, const Wide& expected) {
    return static_cast<double>(abs(Wide(value) - expected) / abs(expected));
}

TEST(Occupancy, VarianceKeepsItsDigits) {
    for (const double pixels : {1.0, 2.0, 10.0, 1e3, 1e6, 1e9})
        for (const double margin : {0.0, 0.37, 3.0, 1e4})
            for (const double hits : {1e-9, 1e-4, 0.1, 0.3, 1.0, 5.0, 20.0}) {
                const double span = pixels + margin;
                const double n = std::round(hits * span);
                if (n < 1 || span < 2) continue;
                if (n == 1 && margin == 0) continue;  // exactly 0: below
                const PatchPixels patch{n, pixels, span};
                EXPECT_LT(relative(covered_share(patch).variance, printed_variance(patch)), 1e-12 * (1 + hits))
                    << "n " << n << " M " << pixels << " span " << span;
            }
}

TEST(Occupancy, MeanAndItsComplementKeepTheirDigits) {
    for (const double span : {2.5, 1e4, 1e12})
        for (const double hits : {1e-6, 1.0, 40.0}) {
            const double n = std::ceil(hits * span);
            const Wide q = pow(1 - 1 / Wide(span), Wide(n));
            const CoveredShare share = covered_share({n, 2, span});
            EXPECT_LT(relative(share.mean, 1 - q), 1e-15 * (4 + hits));
            EXPECT_LT(relative(share.uncovered, q), 1e-15 * (4 + 2 * hits));
        }
}

TEST(Occupancy, VarianceOfUnequalPixelsKeepsItsDigits) {
    const std::vector<std::vector<PixelClass>> sets{
        {{1e-3, 600}, {2e-3, 200}},                        // a full patch: Σ p = 1
        {{1.0 / 1024, 512}, {1.0 / 2048, 512}},            // 0.75
        {{0.5, 1}, {0.125, 2}, {1.0 / 65536, 10000}},      // very unequal
        {{0x1p-20, 1 << 19}, {0x1p-21, 1 << 20}},          // Σ p = 1, a million pixels
        {{0.9, 1}, {1e-4, 100}},
    };
    for (const auto& classes : sets)
        for (const double n : {2.0, 3.0, 40.0, 1e4, 1e6}) {
            double smallest = 1;
            for (const auto& c : classes) smallest = std::min(smallest, std::exp(n * std::log1p(-c.landing)));
            const Wide expected = printed_variance(n, classes);
            if (expected < Wide("1e-280")) continue;  // everything covered
            EXPECT_LT(relative(covered_share(n, classes).variance, expected), 1e-10) << n << " of " << classes.size();
        }
}

TEST(Occupancy, OneClassIsTheEqualCase) {
    const std::vector<PixelClass> one{{0x1p-7, 100}};
    const CoveredShare a = covered_share(300, one);
    const CoveredShare b = covered_share({300, 100, 128});
    EXPECT_DOUBLE_EQ(a.mean, b.mean);
    EXPECT_NEAR(a.variance / b.variance, 1, 1e-13);
}

TEST(Occupancy, SureOutcomesDoNotVary) {
    EXPECT_EQ(covered_share({0, 5, 10}).variance, 0);
    EXPECT_EQ(covered_share({0, 5, 10}).mean, 0);
    EXPECT_EQ(covered_share({1, 1000, 1000}).variance, 0);  // one particle covers one pixel, always
    EXPECT_EQ(covered_share({7, 1, 1}).mean, 1);
    EXPECT_EQ(covered_share({7, 1, 1}).variance, 0);
    const std::vector<PixelClass> sure{{1.0, 1}, {0.0, 3}};
    EXPECT_EQ(covered_share(4, sure).mean, 0.25);
    EXPECT_EQ(covered_share(4, sure).variance, 0);
}

TEST(Occupancy, PoissonCountLeavesPixelsIndependent) {
    const std::vector<PixelClass> classes{{0.01, 50}, {0.02, 25}};
    const CoveredShare fixed = covered_share(100, classes);
    const CoveredShare poisson = covered_share_poisson(100, classes);
    const double a = std::exp(-1.0);
    const double b = std::exp(-2.0);
    EXPECT_NEAR(poisson.mean, 1 - (50 * a + 25 * b) / 75, 1e-15);
    EXPECT_NEAR(poisson.variance, (50 * a * (1 - a) + 25 * b * (1 - b)) / (75 * 75), 1e-17);
    EXPECT_LT(fixed.variance, poisson.variance);
}

TEST(Occupancy, ClassesKeepPixelsAndChance) {
    std::vector<double> few{0.1, 0.2, 0.1, 0.0};
    const auto exact = pixel_classes(few);
    ASSERT_EQ(exact.size(), 3U);
    EXPECT_EQ(exact[1].landing, 0.1);
    EXPECT_EQ(exact[1].pixels, 2);

    std::vector<double> many{0.0, 0.0};
    double sum = 0;
    for (int i = 0; i < 3000; ++i) {
        many.push_back(1e-5 * (1 + 9 * std::abs(std::sin(i * 0.7))));
        sum += many.back();
    }
    const auto grouped = pixel_classes(many);
    EXPECT_LE(grouped.size(), kMaxPixelClasses);
    EXPECT_GT(grouped.size(), 200U);
    double pixels = 0;
    double chance = 0;
    for (const auto& c : grouped) {
        pixels += c.pixels;
        chance += c.pixels * c.landing;
    }
    EXPECT_EQ(pixels, 3002);
    EXPECT_NEAR(chance, sum, 1e-13);

    // Grouping hardly moves the variance: compare with every pixel its own class.
    std::vector<PixelClass> each;
    for (const double p : many) each.push_back({p, 1});
    EXPECT_NEAR(covered_share(30000, grouped).variance / covered_share(30000, each).variance, 1, 1e-5);
    EXPECT_TRUE(pixel_classes({}).empty());
}

/// All ν^n ways to throw n particles on ν whole pixels, of which the first M count.
std::map<int, double> enumerated(int n, int pixels, int span) {
    std::map<int, double> law;
    const auto ways = static_cast<int>(std::lround(std::pow(span, n)));
    for (int way = 0; way < ways; ++way) {
        unsigned covered = 0;
        for (int i = 0, rest = way; i < n; ++i, rest /= span)
            if (rest % span < pixels) covered |= 1U << (rest % span);
        law[__builtin_popcount(covered)] += 1.0 / ways;
    }
    return law;
}

TEST(OccupancyLaw, EqualsEnumeration) {
    for (const auto& [n, pixels, span] : {std::array{5, 3, 5}, {4, 6, 6}, {1, 4, 4}, {6, 1, 3}, {0, 2, 4}}) {
        const auto law = covered_law({static_cast<double>(n), static_cast<double>(pixels), static_cast<double>(span)});
        ASSERT_TRUE(law);
        double total = 0;
        auto expected = enumerated(n, pixels, span);
        for (std::size_t i = 0; i < law->probability.size(); ++i) {
            EXPECT_NEAR(law->probability[i], expected[static_cast<int>(law->first) + static_cast<int>(i)], 1e-13);
            total += law->probability[i];
        }
        EXPECT_NEAR(total, 1, 1e-12);
    }
}

TEST(OccupancyLaw, HasTheMomentsOfTheClosedForm) {
    for (const PatchPixels& patch : {PatchPixels{3000, 1000, 1234.5}, {50000, 30, 1e6}, {40, 1e6, 1e6}, {2e9, 20, 1e9}}) {
        const auto law = covered_law(patch);
        ASSERT_TRUE(law);
        double total = 0;
        double mean = 0;
        for (std::size_t i = 0; i < law->probability.size(); ++i) {
            total += law->probability[i];
            mean += static_cast<double>(law->first + static_cast<std::int64_t>(i)) * law->probability[i];
        }
        double variance = 0;
        for (std::size_t i = 0; i < law->probability.size(); ++i) {
            const double off = static_cast<double>(law->first + static_cast<std::int64_t>(i)) - mean;
            variance += off * off * law->probability[i];
        }
        const CoveredShare share = covered_share(patch);
        EXPECT_NEAR(total, 1, 1e-9);
        EXPECT_NEAR(mean / (patch.pixels * share.mean), 1, 1e-9);
        EXPECT_NEAR(variance / (patch.pixels * patch.pixels * share.variance), 1, 1e-6);
    }
}

TEST(OccupancyLaw, StandsStillOnceAllIsCovered) {
    const auto law = covered_law({1e15, 20, 20});
    ASSERT_TRUE(law);
    EXPECT_EQ(law->first, 20);
    ASSERT_EQ(law->probability.size(), 1U);
    EXPECT_EQ(law->probability[0], 1);
    // Nearly always all, and the rest of the law is still there.
    const auto nearly = covered_law({4000, 20, 200});
    ASSERT_TRUE(nearly);
    const double missed = 20 * std::exp(4000 * std::log1p(-1.0 / 200));
    EXPECT_NEAR(nearly->probability[nearly->probability.size() - 2] / missed, 1, 1e-7);
}

TEST(OccupancyLaw, SumOfRepeatsIsTheirConvolution) {
    const CountLaw coin{0, {0.5, 0.5}};
    const auto sum = law_of_sum(coin, 37);
    ASSERT_TRUE(sum);
    for (std::size_t i = 0; i < sum->probability.size(); ++i)
        EXPECT_NEAR(sum->probability[i], binomial_pmf(static_cast<double>(i), {37, 0.5}), 1e-15);
    EXPECT_EQ(law_of_sum({4, {1.0}}, 1000)->first, 4000);
}

TEST(OccupancyLaw, IsEmptyWhereItWouldTakeTooLong) {
    EXPECT_FALSE(covered_law({1e12, 1e11, 1e12}));
    EXPECT_FALSE(law_of_sum({0, std::vector<double>(20000, 5e-5)}, 2));
}

/// Throws particles; the number of covered pixels of one repeat.
double thrown(const PatchPixels& patch, std::mt19937_64& random, double mean_count_poisson = 0) {
    std::vector<bool> hit(static_cast<std::size_t>(patch.pixels));
    std::uniform_real_distribution<double> place(0, patch.span);
    double n = patch.particles;
    if (mean_count_poisson > 0) n = std::poisson_distribution<int>(mean_count_poisson)(random);
    for (int i = 0; i < n; ++i) {
        const auto at = static_cast<std::size_t>(place(random));
        if (at < hit.size()) hit[at] = true;
    }
    return static_cast<double>(std::count(hit.begin(), hit.end(), true));
}

double ks_of_simulation(const PatchPixels& drawn, const PatchPixels& theory, int repeats, int runs) {
    std::mt19937_64 random(99);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::vector<double> p;
    for (int run = 0; run < runs; ++run) {
        double total = 0;
        for (int r = 0; r < repeats; ++r) total += thrown(drawn, random);
        p.push_back(normal_cdf(covered_z_score(total, repeats, theory, uniform(random))));
    }
    return ks_uniformity(p)->p_value;
}

TEST(OccupancyZ, IsStandardNormalInEachRegime) {
    EXPECT_GT(ks_of_simulation({3, 4, 5.5}, {3, 4, 5.5}, 2, 2000), 1e-3);          // exact, tiny
    EXPECT_GT(ks_of_simulation({200, 50, 50}, {200, 50, 50}, 3, 1000), 1e-3);      // exact, nearly full
    EXPECT_GT(ks_of_simulation({20, 3000, 3000}, {20, 3000, 3000}, 5, 1000), 1e-3);  // exact, nearly empty
    EXPECT_GT(ks_of_simulation({900, 1000, 1300}, {900, 1000, 1300}, 10, 600), 1e-3);  // normal
}

TEST(OccupancyZ, SeesAWrongCount) {
    EXPECT_LT(ks_of_simulation({4, 4, 5.5}, {3, 4, 5.5}, 2, 2000), 1e-3);
    EXPECT_LT(ks_of_simulation({210, 50, 50}, {200, 50, 50}, 3, 1000), 1e-3);
    EXPECT_LT(ks_of_simulation({910, 1000, 1300}, {900, 1000, 1300}, 10, 600), 1e-3);
}

TEST(OccupancyZ, SeesAPoissonCountTakenForAFixedOne) {
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> uniform(0, 1);
    const PatchPixels patch{60, 100, 100};
    const std::vector<PixelClass> one{{0.01, 100}};
    std::vector<double> as_fixed;
    std::vector<double> as_poisson;
    for (int run = 0; run < 1500; ++run) {
        const double total = thrown(patch, random, 60) + thrown(patch, random, 60);
        as_fixed.push_back(normal_cdf(covered_z_score(total, 2, patch, uniform(random))));
        as_poisson.push_back(normal_cdf(covered_z_score_poisson(total, 2, 60, one, uniform(random))));
    }
    EXPECT_LT(ks_uniformity(as_fixed)->p_value, 1e-6);
    EXPECT_GT(ks_uniformity(as_poisson)->p_value, 1e-3);
}

TEST(OccupancyZ, MatchedLawAgreesWithTheExactOneWhereBothFit) {
    // The version for classes takes the matched law where that for equal pixels takes the exact one.
    for (const PatchPixels& patch : {PatchPixels{20, 4096, 4096}, {40000, 4096, 4096}, {4096 * 6, 4096, 8192}}) {
        const std::vector<PixelClass> one{{1 / patch.span, patch.pixels}};
        const CoveredShare share = covered_share(patch);
        const double sigma = patch.pixels * std::sqrt(share.variance);
        for (const double off : {-2.0, -1.0, 0.0, 1.0, 2.0}) {
            const double total = std::round(patch.pixels * share.mean + off * sigma);
            if (total > std::min(patch.particles, patch.pixels)) continue;
            EXPECT_NEAR(normal_cdf(covered_z_score(total, 1, patch, 0.5)),
                        normal_cdf(covered_z_score(total, 1, patch.particles, one, 0.5)), 3e-3)
                << "n " << patch.particles << " total " << total;
        }
    }
}

TEST(OccupancyZ, IsFiniteForEveryInput) {
    const double biggest = 0x1p62;
    for (const double pixels : {1.0, 1000.0, 1e9, 1e15})
        for (const double margin : {0.0, 0.5, 1e12})
            for (const double n : {0.0, 1.0, 2.0, 1e5, 1e12, biggest})
                for (const double repeats : {1.0, 500.0})
                    for (const double share : {0.0, 0.3, 1.0}) {
                        const double total = std::round(share * pixels * repeats);
                        const std::vector<PixelClass> one{{1 / (pixels + margin), pixels}};
                        for (const double z : {covered_z_score(total, repeats, {n, pixels, pixels + margin}, 0.3),
                                               covered_z_score(total, repeats, n, one, 0.3),
                                               covered_z_score_poisson(total, repeats, n, one, 0.3)})
                            EXPECT_TRUE(std::isfinite(z)) << n << " " << pixels << " " << margin << " " << total;
                    }
    EXPECT_GT(covered_z_score(5, 1, {2, 10, 10}, 0.5), 37);  // two particles cannot cover five
    EXPECT_LT(covered_z_score(0, 1, {2, 10, 10}, 0.5), -37);
}

}  // namespace
}  // namespace pellucid
