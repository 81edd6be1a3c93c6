#include <gtest/gtest.h>

#include "core/error.hpp"
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

TEST(OneLine, MakesControlCharactersBlanksAndEndsAtALetter) {
    EXPECT_EQ(one_line("a\nb\tc"), "a b c");
    EXPECT_EQ(one_line("\r\na\r\n\x7f b  c\n"), "a  b  c");
    EXPECT_EQ(one_line("\n"), "");
    EXPECT_EQ(one_line("abcdef", 6), "abcdef");
    EXPECT_EQ(one_line("abcdef", 3), "abc…");
    EXPECT_EQ(one_line("ab\u00e9f", 3), "ab…");  // é is two bytes
    EXPECT_EQ(one_line("ab\u00e9f", 4), "ab\u00e9…");
    EXPECT_EQ(one_line("\u00e9", 1), "…");
}

}  // namespace
}  // namespace pellucid
