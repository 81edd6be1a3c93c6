#include <gtest/gtest.h>

#include "core/random.hpp"

namespace pellucid {
namespace {

TEST(Random, SameKeySameBitsOtherKeyOtherBits) {
    const DrawKey key{.object = 1, .repeat = 2, .index = 3, .block = 4};
    EXPECT_EQ(random_bits({5}, key), random_bits({5}, key));
    EXPECT_NE(random_bits({5}, key), random_bits({6}, key));
    for (const DrawKey other : {DrawKey{2, 2, 3, 4}, DrawKey{1, 3, 3, 4}, DrawKey{1, 2, 4, 4}, DrawKey{1, 2, 3, 5},
                                DrawKey{1, 2, 3ULL << 33, 4}})
        EXPECT_NE(random_bits({5}, key), random_bits({5}, other));
}

}  // namespace
}  // namespace pellucid
