#include <cmath>

#include <gtest/gtest.h>

#include "core/random.hpp"
#include "field/catalogue.hpp"
#include "field/polynomial.hpp"

namespace pellucid {
namespace {

TEST(SignChanges, FindsEveryRootOfRandomProducts) {
    // Quartics built from four known roots, some inside [0, 1], some outside.
    for (std::uint32_t trial = 0; trial < 20000; ++trial) {
        const auto bits = random_bits({1}, {.index = trial});
        std::array<double, 4> root{};
        for (std::size_t i = 0; i < 4; ++i) root[i] = 2 * unit_interval(bits[i]) - 0.5;
        std::sort(root.begin(), root.end());
        bool close = false;
        std::vector<double> inside;
        for (std::size_t i = 0; i < 4; ++i) {
            if (i > 0 && root[i] - root[i - 1] < 1e-4) close = true;
            if (root[i] > 0 && root[i] < 1) inside.push_back(root[i]);
        }
        if (close) continue;
        std::vector<double> c{1};
        for (const double r : root) {
            c.insert(c.begin(), 0);
            for (std::size_t i = 0; i + 1 < c.size(); ++i) c[i] -= r * c[i + 1];
        }
        std::array<double, 4> found{};
        const int count = sign_changes(bernstein_from_powers(c), found);
        ASSERT_EQ(static_cast<std::size_t>(count), inside.size()) << "trial " << trial;
        for (std::size_t i = 0; i < inside.size(); ++i) EXPECT_NEAR(found[i], inside[i], 1e-9);
    }
}

TEST(SignChanges, TouchingZeroIsNoCrossing) {
    std::array<double, 4> roots{};
    const std::array<double, 3> touching{0.25, -1, 1};  // (t − ½)²
    EXPECT_EQ(sign_changes(bernstein_from_powers(touching), roots), 0);
    const std::array<double, 3> zero{0, 0, 0};
    EXPECT_EQ(sign_changes(bernstein_from_powers(zero), roots), 0);
}

TEST(Bernstein, EvaluatesLikePowers) {
    const std::array<double, 5> c{0.3, -1.2, 2.5, 0.7, -3.1};
    const Bernstein p = bernstein_from_powers(c);
    for (double t = 0; t <= 1; t += 0.125)
        EXPECT_NEAR(p(t), c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4]))), 1e-14);
}

TEST(Catalogue, CrossingsAreZerosAndAlternateInDirection) {
    for (const CatalogueEntry& entry : catalogue()) {
        if (entry.is_formula()) continue;
        const CatalogueSurface surface(std::string(entry.name), {});
        const Vec3 size = surface.bounds().size();
        std::size_t total = 0;
        for (std::uint32_t trial = 0; trial < 2000; ++trial) {
            const auto a = random_bits({2}, {.index = trial});
            const auto b = random_bits({2}, {.index = trial, .block = 1});
            Vec3 from, to;
            for (int i = 0; i < 3; ++i) {
                from[i] = surface.bounds().lo[i] + size[i] * unit_interval(a[static_cast<std::size_t>(i)]);
                to[i] = surface.bounds().lo[i] + size[i] * unit_interval(b[static_cast<std::size_t>(i)]);
            }
            const Vec3 direction = to - from;
            std::array<double, kMaxCatalogueCrossings> t{};
            const int count = surface.crossings(from, direction, -1, 2, t);
            ASSERT_LE(count, surface.max_crossings());
            // Parity: the number of crossings says whether the ends lie on different sides.
            const bool differs = (surface.value(from - direction) >= 0) != (surface.value(from + 2.0 * direction) >= 0);
            EXPECT_EQ(count % 2 == 1, differs) << entry.name << " trial " << trial;
            double before = -1;
            for (int i = 0; i < count; ++i) {
                const double root = t[static_cast<std::size_t>(i)];
                EXPECT_GE(root, before);
                before = root;
                const Vec3 x = from + root * direction;
                EXPECT_NEAR(surface.value(x), 0, 1e-9 * (1 + length(surface.gradient(x))));
                EXPECT_FALSE(surface.excludes({x - Vec3(1e-9), x + Vec3(1e-9)}));
            }
            total += static_cast<std::size_t>(count);
        }
        EXPECT_GT(total, 500U) << entry.name;
    }
}

TEST(Catalogue, ExcludesNothingThatHoldsAPoint) {
    const CatalogueSurface torus("torus", {});
    EXPECT_TRUE(torus.excludes({{-0.1, -0.1, -0.1}, {0.1, 0.1, 0.1}}));   // the hole
    EXPECT_TRUE(torus.excludes({{0.9, -0.1, -0.1}, {1.1, 0.1, 0.1}}));    // inside the tube
    EXPECT_FALSE(torus.excludes({{1.3, -0.1, -0.1}, {1.5, 0.1, 0.1}}));
}

}  // namespace
}  // namespace pellucid
