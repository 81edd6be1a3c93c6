#include "kernel/normal_twin.h"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "core/vec.hpp"

namespace pellucid {
namespace {

double error(const Vec3& n) {
    const twin::Vec3f back = twin::unpack_normal(
        twin::pack_normal({static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)}));
    const Vec3 restored(back.x, back.y, back.z);
    EXPECT_NEAR(length(restored), 1, 3e-7);
    return std::atan2(length(cross(normalize(n), restored)), dot(normalize(n), restored));
}

TEST(NormalTwin, ErrorIsAtMostThatOfTheHeader) {
    double worst = 0;
    std::mt19937_64 random(1);
    std::normal_distribution<double> gauss;
    for (int i = 0; i < 1000000; ++i) worst = std::max(worst, error({gauss(random), gauss(random), gauss(random)}));
    // A dense patch at every place of special shape: axes, folds of the octahedron, centres of its faces.
    for (int x = -1; x <= 1; ++x)
        for (int y = -1; y <= 1; ++y)
            for (int z = -1; z <= 1; ++z) {
                if (x == 0 && y == 0 && z == 0) continue;
                for (int i = 0; i < 4000; ++i)
                    worst = std::max(worst, error(normalize(Vec3(x, y, z)) +
                                                  1e-4 * Vec3(gauss(random), gauss(random), gauss(random))));
            }
    EXPECT_LE(worst, 6.5e-5);
    EXPECT_GT(worst, 6e-5);  // half a step, √2/65534, times 3 at a face's middle: the worst has been met
}

TEST(NormalTwin, AxesAreExactAndLengthDoesNotMatter) {
    for (const Vec3 axis : {Vec3(1, 0, 0), Vec3(-1, 0, 0), Vec3(0, 1, 0), Vec3(0, -1, 0), Vec3(0, 0, 1), Vec3(0, 0, -1)}) {
        EXPECT_EQ(error(axis), 0);
        EXPECT_EQ(error(1e-6 * axis), 0);
    }
    EXPECT_EQ(twin::pack_normal({1, 2, 3}), twin::pack_normal({256, 512, 768}));
}

}  // namespace
}  // namespace pellucid
