#include "stage/z_thickness_buffer.hpp"

#include <gtest/gtest.h>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "slab_testing.hpp"
#include "stage/slab_merge.hpp"

namespace pellucid {
namespace {

using namespace testing_slabs;

constexpr SlabFormat kFormats[] = {SlabFormat::float32, SlabFormat::half, SlabFormat::byte};

[[nodiscard]] std::vector<Slab> read_back(const ZThicknessBuffer& buffer, std::size_t pixel) {
    std::vector<Slab> room(buffer.most_slabs());
    const auto slabs = buffer.read(pixel, room);
    return {slabs.begin(), slabs.end()};
}

/// Sorted, and not one of them so faint that 8 bits lose it.
[[nodiscard]] std::vector<Slab> strong_array(RandomSlabs& random, std::size_t most) {
    std::vector<Slab> slabs = random.array(most);
    for (Slab& s : slabs) {
        s.a = std::max(s.a, 0.01F);
        s.b = s.a;
    }
    return slabs;
}

TEST(ZThicknessBuffer, PlansWhatItHolds) {
    for (const SlabFormat format : kFormats)
        for (const int layers : {2, 8, 16}) {
            const ZThicknessSize size{.width = 67, .height = 31, .layers = layers, .format = format};
            const std::size_t pixels = 67 * 31;
            const std::size_t slab = format == SlabFormat::float32 ? 24 : 12;
            const std::size_t expected = pixels * static_cast<std::size_t>(layers) * slab + (pixels + 31) / 32 * 4;
            EXPECT_EQ(ZThicknessBuffer::planned_bytes(size), expected);
            EXPECT_EQ(ZThicknessBuffer(size).bytes(), expected);
        }
}

TEST(ZThicknessBuffer, TooManyBytesToCountAreRefused) {
    const ZThicknessSize size{.width = 1 << 30, .height = 1 << 30, .layers = 1 << 30};
    EXPECT_THROW(static_cast<void>(ZThicknessBuffer::planned_bytes(size)), Error);
}

TEST(ZThicknessBuffer, UntouchedPixelsHaveNothing) {
    ZThicknessBuffer buffer({.width = 33, .height = 3});
    const Slab slab{2, 1, 0.5F, 0, 0, 0.5F};
    buffer.write(40, std::span(&slab, 1));
    for (std::size_t pixel = 0; pixel < 99; ++pixel) {
        EXPECT_EQ(buffer.touched(pixel), pixel == 40);
        EXPECT_EQ(read_back(buffer, pixel).size(), pixel == 40 ? 1U : 0U);
        EXPECT_EQ(buffer.image(pixel), pixel == 40 ? slab : Slab{});
    }
    EXPECT_EQ(buffer.flags(0), 0U);
    EXPECT_EQ(buffer.flags(1), 1U << 8U);
    buffer.clear();
    EXPECT_FALSE(buffer.touched(40));
    EXPECT_TRUE(read_back(buffer, 40).empty());
    EXPECT_EQ(buffer.image(40), Slab{});
}

TEST(ZThicknessBuffer, Float32KeepsAllBits) {
    RandomSlabs random(1);
    ZThicknessBuffer buffer({.width = 5, .height = 5, .layers = 8});
    for (std::size_t i = 0; i < 2'000; ++i) {
        std::vector<Slab> slabs = random.array(7);
        std::erase_if(slabs, [](const Slab& s) { return s.a == 0; });
        buffer.write(i % 25, slabs);
        ASSERT_EQ(read_back(buffer, i % 25), slabs);
        ASSERT_EQ(buffer.image(i % 25), composite(slabs));
    }
}

TEST(ZThicknessBuffer, RoundedArraysStaySortedAndKeepTheirImage) {
    RandomSlabs random(2);
    for (const SlabFormat format : kFormats) {
        ZThicknessBuffer buffer({.width = 4, .height = 1, .layers = 8, .format = format});
        for (std::size_t i = 0; i < 20'000; ++i) {
            const std::vector<Slab> slabs = strong_array(random, 7);
            buffer.write(i % 4, slabs);
            const std::vector<Slab> seen = read_back(buffer, i % 4);
            ASSERT_TRUE(is_sorted_array(seen)) << testing::PrintToString(slabs) << testing::PrintToString(seen);
            ASSERT_EQ(seen.size(), slabs.size());
            const Slab exact = composite(slabs);
            const Slab image = buffer.image(i % 4);
            const float bound = format == SlabFormat::byte ? 1.0F / 510 + 1e-7F : 0x1p-12F;
            ASSERT_NEAR(image.r, exact.r, bound);
            ASSERT_NEAR(image.a, exact.a, bound);
        }
    }
}

TEST(ZThicknessBuffer, ByteRoundsChannelsByHalfAStepAndDepthNotAtAll) {
    ZThicknessBuffer buffer({.width = 1, .height = 1, .layers = 2, .format = SlabFormat::byte});
    for (int i = 0; i <= 100'000; ++i) {
        const float v = static_cast<float>(i) / 100'000;
        const Slab slab{1 + v * 1e-6F, v * 1e-9F, v, 1 - v, 2, 1};
        buffer.write(0, std::span(&slab, 1));
        const Slab seen = read_back(buffer, 0)[0];
        ASSERT_EQ(seen.z, slab.z);
        ASSERT_EQ(seen.d, slab.d);
        ASSERT_LE(std::abs(seen.r - slab.r), 1.0F / 510 + 1e-7F);
        ASSERT_LE(std::abs(seen.g - slab.g), 1.0F / 510 + 1e-7F);
        ASSERT_EQ(seen.b, 1);
        ASSERT_EQ(seen.a, 1);
    }
}

TEST(ZThicknessBuffer, HalfRoundsAsItStates) {
    RandomSlabs random(3);
    ZThicknessBuffer buffer({.width = 1, .height = 1, .layers = 2, .format = SlabFormat::half});
    for (int i = 0; i < 300'000; ++i) {
        const float z = std::exp2(60 * random.unit() - 30);
        const float d = z * std::exp2(-20 * random.unit());
        const float r = std::exp2(40 * random.unit() - 26);
        const Slab slab{z, d, r, 0, 1, i % 2 == 0 ? 1.0F : random.unit()};
        buffer.write(0, std::span(&slab, 1));
        const Slab seen = read_back(buffer, 0)[0];
        ASSERT_LE(std::abs(seen.z - z), z * 0x1p-17F);
        const float front_error = z * 0x1p-16F;
        ASSERT_LE(seen.d, d + front_error);
        ASSERT_GE(seen.d, (d - front_error) * (31.0F / 32) - front_error);
        const float largest = std::min(r, 65504.0F);
        ASSERT_LE(std::abs(seen.r - largest), std::max(largest * 0x1p-11F, 0x1p-25F));
        ASSERT_LE(std::abs(seen.a - slab.a), std::max(slab.a * 0x1p-11F, 0x1p-25F));
        ASSERT_EQ(seen.b, 1);
        if (slab.a == 1) {
            ASSERT_EQ(seen.a, 1);
        }
    }
}

TEST(ZThicknessBuffer, WhatRoundsToNothingIsLeftOut) {
    const std::vector<Slab> slabs{{1, 0.5F, 0, 0, 0, 0.5F}, {2, 0.5F, 1e-3F, 0, 0, 1e-3F}, {3, 0.5F, 0, 0, 0, 0.25F}};
    ZThicknessBuffer buffer({.width = 1, .height = 1, .format = SlabFormat::byte});
    buffer.write(0, slabs);
    const auto seen = read_back(buffer, 0);
    ASSERT_EQ(seen.size(), 2U);
    EXPECT_EQ(seen[1].z, 3);
}

TEST(ZThicknessBuffer, ThreadsWritePixelsOfOneWord) {
    ZThicknessBuffer buffer({.width = 64, .height = 64});
    parallel_for(64 * 64, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t pixel = begin; pixel < end; ++pixel) {
            const Slab slab{static_cast<float>(pixel) + 1, 0, 0, 0, 0, 0.5F};
            if (pixel % 3 != 0) buffer.write(pixel, std::span(&slab, 1));
        }
    });
    for (std::size_t pixel = 0; pixel < 64 * 64; ++pixel) {
        ASSERT_EQ(buffer.touched(pixel), pixel % 3 != 0);
        ASSERT_EQ(buffer.image(pixel).z, pixel % 3 != 0 ? static_cast<float>(pixel) + 1 : 0);
    }
}

}  // namespace
}  // namespace pellucid
