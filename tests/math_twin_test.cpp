#include "kernel/math_twin.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <mutex>
#include <set>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "core/parallel.hpp"

#ifdef __x86_64__
#include <immintrin.h>
#endif

// Every float goes through every function of one variable; the exact value comes from double arithmetic and
// the C library. Slow builds take every 251st. What a comparison with a device must cover: twin_reciprocal,
// twin_sqrt, twin_rsqrt, twin_log1p, twin_expm1, twin_log2, twin_exp2 and twin_power.
namespace pellucid {
namespace {

constexpr std::size_t kBlock = 4096;    // floats of one sign and exponent taken at once
constexpr std::uint32_t kBlocks = 2048;  // of them make up all 2^23 mantissas
#if defined(NDEBUG) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
constexpr std::uint32_t kStride = 1;
#else
constexpr std::uint32_t kStride = 251;
#endif

using Floats = std::array<float, kBlock>;
using Doubles = std::array<double, kBlock>;
using Evaluate = void (*)(const Floats& x, Floats& result);

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr double kSmallestNormal = 0x1p-126;

std::uint32_t bits_of(float v) { return std::bit_cast<std::uint32_t>(v); }
float float_of(std::uint32_t bits) { return std::bit_cast<float>(bits); }

// A block's arguments: mantissas first, first + 2048, ... under one sign and exponent.
struct Block {
    std::uint32_t sign_and_exponent;  // 9 bits
    std::uint32_t first;
    const Doubles& log2_mantissa;
    [[nodiscard]] int exponent() const { return static_cast<int>(sign_and_exponent & 255u) - 127; }
    [[nodiscard]] bool negative() const { return sign_and_exponent > 255u; }
    [[nodiscard]] bool below_zero() const { return sign_and_exponent > 256u; }  // or NaN
};

using Exact = void (*)(const Block& block, const Doubles& x, Doubles& result);

struct Function {
    Evaluate plain;
    Evaluate avx2;
    Evaluate avx512;
    Exact exact;
    double allowed_ulp;  // what math_twin.h states
};

#ifdef __x86_64__
#define AS_AVX2 __attribute__((target("avx2,fma")))
#define AS_AVX512 __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,fma,prefer-vector-width=512")))
bool has_avx2() { return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"); }
bool has_avx512() {
    return has_avx2() && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
}
#else
#define AS_AVX2
#define AS_AVX512
bool has_avx2() { return false; }
bool has_avx512() { return false; }
#endif

#define EVALUATE(name)                                                              \
    void name##_plain(const Floats& x, Floats& result) {                            \
        for (std::size_t i = 0; i < kBlock; ++i) result[i] = twin::twin_##name(x[i]); \
    }                                                                               \
    AS_AVX2 void name##_avx2(const Floats& x, Floats& result) {                     \
        for (std::size_t i = 0; i < kBlock; ++i) result[i] = twin::twin_##name(x[i]); \
    }                                                                               \
    AS_AVX512 void name##_avx512(const Floats& x, Floats& result) {                 \
        for (std::size_t i = 0; i < kBlock; ++i) result[i] = twin::twin_##name(x[i]); \
    }
EVALUATE(reciprocal)
EVALUATE(sqrt)
EVALUATE(rsqrt)
EVALUATE(log1p)
EVALUATE(expm1)
EVALUATE(log2)
EVALUATE(exp2)

template <typename F>
void each(const Doubles& x, Doubles& result, F f) {
    for (std::size_t i = 0; i < kBlock; ++i) result[i] = f(x[i]);
}

void exact_reciprocal(const Block&, const Doubles& x, Doubles& result) {
    each(x, result, [](double v) { return 1 / v; });
}
void exact_sqrt(const Block& block, const Doubles& x, Doubles& result) {
    if (block.below_zero()) return result.fill(kNan);
    each(x, result, [](double v) { return std::sqrt(v); });
}
void exact_rsqrt(const Block& block, const Doubles& x, Doubles& result) {
    if (block.below_zero()) return result.fill(kNan);
    each(x, result, [](double v) { return 1 / std::sqrt(v); });
}

// One logarithm a mantissa serves all exponents, but for -1, where the sum with it cancels.
void exact_log2(const Block& block, const Doubles& x, Doubles& result) {
    const int exponent = block.exponent();
    if (block.below_zero()) return result.fill(kNan);
    if (exponent == -127 || exponent == -1 || exponent == 128)
        return each(x, result, [](double v) { return std::log2(v); });
    for (std::size_t i = 0; i < kBlock; ++i) result[i] = block.log2_mantissa[i] + exponent;
}
// From 2^60 on 1 + x is x to 2^-60; below 2^-30 the series has two terms.
void exact_log1p(const Block& block, const Doubles& x, Doubles& result) {
    const int exponent = block.exponent();
    if (exponent < -30) return each(x, result, [](double v) { return v * (1 - v / 2); });
    if (block.below_zero() && exponent > 0) return result.fill(kNan);
    if (exponent == 128 || exponent < 60) return each(x, result, [](double v) { return std::log1p(v); });
    for (std::size_t i = 0; i < kBlock; ++i) result[i] = (block.log2_mantissa[i] + exponent) * M_LN2;
}
// From 128 on the result is -1 or out of range.
void exact_expm1(const Block& block, const Doubles& x, Doubles& result) {
    const int exponent = block.exponent();
    if (exponent < -30) return each(x, result, [](double v) { return v * (1 + v / 2); });
    if (exponent < 7 || exponent == 128) return each(x, result, [](double v) { return std::expm1(v); });
    result.fill(block.negative() ? -1 : kInfinity);
}
void exact_exp2(const Block& block, const Doubles& x, Doubles& result) {
    const int exponent = block.exponent();
    if (exponent < -30) return each(x, result, [](double v) { return 1 + v * M_LN2; });
    if (exponent < 8 || exponent == 128) return each(x, result, [](double v) { return std::exp2(v); });
    result.fill(block.negative() ? 0 : kInfinity);
}

#define FUNCTION(name, allowed) Function{name##_plain, name##_avx2, name##_avx512, exact_##name, allowed}

/// Difference in units in the last place of the exact result, as if exponents had no end; infinite where
/// zero, infinity, NaN or the sign is wrong. Below the smallest normal number zero is right; a value within
/// half a unit of an end of the range may go to either side.
double ulp_error(float got, double exact) {
    constexpr double kWrong = std::numeric_limits<double>::infinity();
    constexpr double kLargest = std::numeric_limits<float>::max();
    if (std::isnan(exact) || std::isnan(got)) return std::isnan(exact) && std::isnan(got) ? 0 : kWrong;
    if (std::signbit(got) != std::signbit(exact)) return kWrong;
    const double size = std::abs(exact);
    if (got == 0) return size < kSmallestNormal ? 0 : kWrong;
    if (std::isinf(got)) return size > kLargest ? 0 : kWrong;
    if (size < kSmallestNormal * (1 - 0x1p-24) || size >= kLargest + 0x1p103) return kWrong;
    return std::abs(got - exact) / std::ldexp(1, std::ilogb(exact) - 23);
}

/// Largest ulp_error of a block; a loop that vectorises sees whether all is ordinary or equal: integers, as
/// g++ does not vectorise the maximum of floating-point numbers.
double worst_error(const Floats& got, const Doubles& exact) {
    std::int32_t worst_bits = 0;
    int odd = 0;
    for (std::size_t i = 0; i < kBlock; ++i) {
        const std::uint64_t exponent = std::bit_cast<std::uint64_t>(exact[i]) & 0x7ff0000000000000u;
        const double per_ulp = std::bit_cast<double>((std::uint64_t{2 * 1023 + 23} << 52) - exponent);
        const auto error = static_cast<float>(std::abs(got[i] - exact[i]) * per_ulp);
        const double size = std::abs(exact[i]);
        const int ordinary = int{size >= kSmallestNormal} & int{size < 0x1p127} & int{error < 4};  // no NaN
        const int equal = int{bits_of(static_cast<float>(exact[i])) == bits_of(got[i])};
        const int subnormal = int{std::abs(got[i]) > 0} & int{std::abs(got[i]) < 0x1p-126f};
        odd += 1 - (ordinary | (equal & (1 - subnormal)));
        worst_bits = std::max(worst_bits, std::bit_cast<std::int32_t>(error) * ordinary);
    }
    double worst = std::bit_cast<float>(worst_bits);
    if (odd > 0)
        for (std::size_t i = 0; i < kBlock; ++i) worst = std::max(worst, ulp_error(got[i], exact[i]));
    return worst;
}

/// The function as a device computes it that flushes subnormals, arguments and results.
void evaluate_flushed(Evaluate evaluate, const Floats& x, Floats& result) {
#ifdef __x86_64__
    const unsigned before = _mm_getcsr();
    _mm_setcsr(before | 0x8040u);
    evaluate(x, result);
    _mm_setcsr(before);
#else
    evaluate(x, result);
#endif
}

struct Verdict {
    double worst = 0;
    float at = 0;                    // an argument of the worst block
    std::uint64_t unequal = 0;       // blocks that differ between SIMD widths
    std::uint64_t flush_unequal = 0;  // blocks that differ where subnormals are flushed
    std::uint64_t count = 0;         // floats seen
};

Verdict all_floats(const Function& function) {
    std::vector<std::uint32_t> firsts;
    for (std::uint32_t first = 0; first < kBlocks; first += kStride) firsts.push_back(first);
    if (firsts.back() != kBlocks - 1) firsts.push_back(kBlocks - 1);  // the largest mantissa is in it
    const Evaluate fastest = has_avx512() ? function.avx512 : has_avx2() ? function.avx2 : function.plain;
    std::mutex mutex;
    Verdict verdict;
    parallel_for(firsts.size(), 1, [&](std::size_t begin, std::size_t end) {
        Floats x, got, again;
        Doubles x_read, exact, log2_mantissa;
        for (std::size_t f = begin; f < end; ++f) {
            Verdict mine;
            for (std::size_t i = 0; i < kBlock; ++i)
                log2_mantissa[i] = std::log2(1 + (firsts[f] + static_cast<double>(i) * kBlocks) * 0x1p-23);
            for (std::uint32_t high = 0; high < 512; ++high) {
                const Block block{high, firsts[f], log2_mantissa};
                for (std::uint32_t i = 0; i < kBlock; ++i)
                    x[i] = float_of(high << 23 | (i * kBlocks + firsts[f]));
                // Subnormal arguments are read as zeros.
                for (std::size_t i = 0; i < kBlock; ++i) x_read[i] = block.exponent() == -127 ? 0 : x[i];
                if (high == 256) x_read.fill(-0.0);
                function.exact(block, x_read, exact);
                fastest(x, got);
                const double worst = worst_error(got, exact);
                if (!(worst <= mine.worst)) {
                    mine.worst = worst;
                    mine.at = x[0];
                }
                mine.count += kBlock;
                if ((firsts[f] + high) % 16 != 0) continue;
                function.plain(x, again);
                mine.unequal += std::memcmp(&again, &got, sizeof got) != 0;
                if (has_avx2()) {
                    function.avx2(x, again);
                    mine.unequal += std::memcmp(&again, &got, sizeof got) != 0;
                }
                evaluate_flushed(fastest, x, again);
                mine.flush_unequal += std::memcmp(&again, &got, sizeof got) != 0;
            }
            const std::lock_guard lock(mutex);
            if (!(mine.worst <= verdict.worst)) {
                verdict.worst = mine.worst;
                verdict.at = mine.at;
            }
            verdict.unequal += mine.unequal;
            verdict.flush_unequal += mine.flush_unequal;
            verdict.count += mine.count;
        }
    });
    return verdict;
}

void expect_good_everywhere(const Function& function) {
    const Verdict verdict = all_floats(function);
    EXPECT_LE(verdict.worst, function.allowed_ulp) << fmt::format("near {:a}", verdict.at);
    EXPECT_LE(function.allowed_ulp, 2);
    EXPECT_EQ(verdict.unequal, 0u);
    EXPECT_EQ(verdict.flush_unequal, 0u);
    if (kStride == 1) {
        EXPECT_EQ(verdict.count, std::uint64_t{1} << 32);
    }
    testing::Test::RecordProperty("worst_ulp", fmt::format("{:.4f}", verdict.worst));
}

TEST(MathTwin, ReciprocalOfEveryFloat) { expect_good_everywhere(FUNCTION(reciprocal, 0.502)); }
TEST(MathTwin, SqrtOfEveryFloat) { expect_good_everywhere(FUNCTION(sqrt, 0.59)); }
TEST(MathTwin, RsqrtOfEveryFloat) { expect_good_everywhere(FUNCTION(rsqrt, 0.501)); }
TEST(MathTwin, Log1pOfEveryFloat) { expect_good_everywhere(FUNCTION(log1p, 0.92)); }
TEST(MathTwin, Expm1OfEveryFloat) { expect_good_everywhere(FUNCTION(expm1, 1.11)); }
TEST(MathTwin, Log2OfEveryFloat) { expect_good_everywhere(FUNCTION(log2, 0.502)); }
TEST(MathTwin, Exp2OfEveryFloat) { expect_good_everywhere(FUNCTION(exp2, 1.08)); }

TEST(MathTwin, TheMeasureSeesWrongResults) {
    EXPECT_EQ(ulp_error(1.0f, 1.0), 0);
    EXPECT_EQ(ulp_error(1.0f + 0x1p-23f, 1.0), 1);
    EXPECT_EQ(ulp_error(1.0f - 0x1p-24f, 1.0 - 0x1p-25), 1 - 0.5);
    EXPECT_EQ(ulp_error(0.0f, 0x1p-127), 0);
    const std::pair<float, double> wrong_results[] = {
        {0.0f, -0.0},   {-0.0f, 0x1p-130}, {0.0f, 0x1p-126},     {1.0f, -1.0},
        {kNan, 1.0},    {1.0f, kNan},      {kInfinity, 1e38},    {1.0f, kInfinity},
        {1e38f, 1e39},  {kInfinity, -1e39}, {0x1p-127f, 0x1p-127}};
    for (const auto& [got, exact] : wrong_results)
        EXPECT_EQ(ulp_error(got, exact), double{kInfinity}) << got << " for " << exact;
    // One wrong number in a block, ordinary or not.
    Floats got;
    Doubles exact;
    got.fill(3.0f);
    exact.fill(3.0);
    EXPECT_EQ(worst_error(got, exact), 0);
    got[77] = 3.0f + 0x1p-21f;
    EXPECT_EQ(worst_error(got, exact), 2);
    for (const float wrong : {kNan, kInfinity, -3.0f, 0.0f}) {
        got[77] = wrong;
        EXPECT_GT(worst_error(got, exact), 1e6) << wrong;
    }
    got[77] = 0x1p-127f;
    exact[77] = 0x1p-127;
    EXPECT_EQ(worst_error(got, exact), double{kInfinity});
}

TEST(MathTwin, SpecialValues) {
    using namespace twin;
    struct Case {
        float got, expected;
    };
    const Case cases[] = {
        {twin_reciprocal(0.0f), kInfinity},       {twin_reciprocal(-0.0f), -kInfinity},
        {twin_reciprocal(kInfinity), 0.0f},       {twin_reciprocal(-kInfinity), -0.0f},
        {twin_reciprocal(-1e-40f), -kInfinity},   {twin_reciprocal(-0x1.8p126f), -0.0f},
        {twin_reciprocal(0x1p126f), 0x1p-126f},   {twin_sqrt(-0.0f), -0.0f},
        {twin_sqrt(kInfinity), kInfinity},        {twin_sqrt(1e-40f), 0.0f},
        {twin_rsqrt(0.0f), kInfinity},            {twin_rsqrt(-0.0f), -kInfinity},
        {twin_rsqrt(kInfinity), 0.0f},            {twin_log1p(-1.0f), -kInfinity},
        {twin_log1p(-0.0f), -0.0f},               {twin_log1p(kInfinity), kInfinity},
        {twin_log1p(-1e-40f), -0.0f},             {twin_expm1(-kInfinity), -1.0f},
        {twin_expm1(-0.0f), -0.0f},               {twin_expm1(89.0f), kInfinity},
        {twin_log2(0.0f), -kInfinity},            {twin_log2(-0.0f), -kInfinity},
        {twin_log2(1.0f), 0.0f},                  {twin_exp2(128.0f), kInfinity},
        {twin_exp2(-126.0f), 0x1p-126f},          {twin_exp2(-126.5f), 0.0f},
        {twin_exp2(-kInfinity), 0.0f},            {twin_exp2(1e-40f), 1.0f},
    };
    for (const Case& c : cases)
        EXPECT_EQ(bits_of(c.got), bits_of(c.expected)) << "case " << &c - cases << ": " << c.got;
    for (const float bad : {kNan, -kNan, -1.5f, -kInfinity})
        for (const float got : {twin_sqrt(bad), twin_rsqrt(bad), twin_log2(bad), twin_log1p(bad),
                                twin_power(bad, 2.0f), twin_power(0.5f, bad)})
            EXPECT_EQ(bits_of(got), kNanBits) << bad;
    for (const float bad : {kNan, -kNan})
        for (const float got : {twin_reciprocal(bad), twin_expm1(bad), twin_exp2(bad)})
            EXPECT_EQ(bits_of(got), kNanBits) << bad;
}

TEST(MathTwin, PowersOfTwoAreExact) {
    for (int k = -126; k < 128; ++k) {
        const float x = std::ldexp(1.0f, k);
        EXPECT_EQ(twin::twin_log2(x), static_cast<float>(k));
        EXPECT_EQ(twin::twin_exp2(static_cast<float>(k)), x);
        EXPECT_EQ(twin::twin_reciprocal(x), k == 127 ? 0.0f : 1 / x);
        if (k % 2 == 0) {
            EXPECT_EQ(twin::twin_sqrt(x) * twin::twin_rsqrt(x), 1.0f) << k;
        }
    }
}

TEST(MathTwin, PowerAtItsEnds) {
    using twin::twin_power;
    for (const float x : {0.0f, -0.0f, 1e-40f, 1e-30f, 0.5f, 1.0f, 2.0f, kInfinity})
        for (const float y : {0.0f, -0.0f, 1e-40f}) EXPECT_EQ(twin_power(x, y), 1.0f) << x << " " << y;
    for (const float y : {1e-37f, 1.0f, 64.0f, 1e30f, kInfinity}) {
        EXPECT_EQ(bits_of(twin_power(0.0f, y)), 0u);
        EXPECT_EQ(bits_of(twin_power(-1e-40f, y)), 0u);
        EXPECT_EQ(twin_power(1.0f, y), 1.0f);
        EXPECT_EQ(twin_power(kInfinity, y), kInfinity);
    }
    const float below = std::nextafter(1.0f, 0.0f), above = std::nextafter(1.0f, 2.0f);
    for (const float y : {5e9f, 1e20f, kInfinity}) {
        EXPECT_EQ(bits_of(twin_power(below, y)), 0u);
        EXPECT_EQ(twin_power(above, y), kInfinity);
    }
    EXPECT_EQ(twin_power(0.5f, 126.0f), 0x1p-126f);
    EXPECT_EQ(twin_power(0.5f, 127.0f), 0.0f);
    EXPECT_EQ(twin_power(2.0f, 128.0f), kInfinity);
}

/// Arguments in (0, 1]: even ones, and ones that crowd towards 1 as x^y needs for large y.
std::vector<float> power_bases() {
    std::vector<float> bases;
    constexpr int kCount = kStride == 1 ? 20000 : 500;
    for (int i = 1; i <= kCount; ++i) bases.push_back(static_cast<float>(i) / kCount);
    for (int i = 1; i <= kCount; ++i) bases.push_back(static_cast<float>(1 - std::exp2(-24.0 * i / kCount)));
    for (int i = 1; i <= kCount; ++i) bases.push_back(static_cast<float>(std::exp2(-126.0 * i / kCount)));
    return bases;
}

TEST(MathTwin, PowerWithinItsBound) {
    const std::vector<float> bases = power_bases();
    double worst = 0;
    float worst_x = 0, worst_y = 0;
    for (double y_log = -4; y_log <= 13.3; y_log += 0.17) {  // to 1e4
        const auto fractional = static_cast<float>(std::exp2(y_log));
        for (const float y : {fractional, std::round(fractional)}) {
            for (const float x : bases) {
                const double error = ulp_error(twin::twin_power(x, y), std::pow(double{x}, double{y}));
                if (error <= worst) continue;
                worst = error;
                worst_x = x;
                worst_y = y;
            }
        }
    }
    EXPECT_LE(worst, 1.2) << fmt::format("{:a} ^ {:a}", worst_x, worst_y);
    RecordProperty("worst_ulp", fmt::format("{:.4f}", worst));
}

TEST(MathTwin, HighlightsRiseToOne) {
    for (const float y : {1.0f, 5.0f, 32.0f, 1000.0f, 10000.0f}) {
        float before = 0;
        for (int i = 0; i <= 4000; ++i) {
            const float value = twin::twin_power(static_cast<float>(i) / 4000, y);
            EXPECT_GE(value, before);
            EXPECT_LE(value, 1.0f);
            before = value;
        }
        EXPECT_EQ(before, 1.0f);
    }
}

/// The SPIR-V assembly of a shader that calls every function.
std::string shader_assembly(const std::string& options) {
    const auto shader = std::filesystem::path(testing::TempDir()) / "pellucid_math_twin.comp";
    std::ofstream(shader) << R"(#version 450
#extension GL_GOOGLE_include_directive : require
#include "kernel/math_twin.h"
layout(local_size_x = 64) in;
layout(std430, binding = 0) buffer Arguments { float x[]; };
layout(std430, binding = 1) buffer Results { float y[]; };
void main() {
    uint i = gl_GlobalInvocationID.x;
    y[8 * i] = twin_reciprocal(x[i]);
    y[8 * i + 1] = twin_sqrt(x[i]);
    y[8 * i + 2] = twin_rsqrt(x[i]);
    y[8 * i + 3] = twin_log1p(x[i]);
    y[8 * i + 4] = twin_expm1(x[i]);
    y[8 * i + 5] = twin_log2(x[i]);
    y[8 * i + 6] = twin_exp2(x[i]);
    y[8 * i + 7] = twin_power(x[i], x[i + 1]);
}
)";
    const std::string words = shader.string() + ".spvasm";
    const std::string command =
        fmt::format("glslc --target-env=vulkan1.3 -fshader-stage=compute -Werror {} -S -I {}/lib {} -o {}",
                    options, PELLUCID_SOURCE_DIR, shader.string(), words);
    EXPECT_EQ(std::system(command.c_str()), 0) << command;
    std::stringstream text;
    text << std::ifstream(words).rdbuf();
    return text.str();
}

// Each sum and product is barred from becoming a fused multiply-add, and there is nothing inexact else.
TEST(MathTwin, InGlslOnlyUncontractedSumsAndProducts) {
    if (std::system("glslc --version > /dev/null 2>&1") != 0) GTEST_SKIP() << "skipped: no glslc";
    for (const std::string options : {"-O0", "-O"}) {
        std::istringstream lines(shader_assembly(options));
        const std::set<std::string> sums{"OpFAdd", "OpFSub", "OpFMul"};
        const std::set<std::string> inexact{"OpFDiv", "OpFRem", "OpFMod", "OpDot", "OpVectorTimesScalar"};
        std::set<std::string> uncontracted;
        int count = 0;
        for (std::string line; std::getline(lines, line);) {
            // OpDecorate %id NoContraction, or %id = operation %type ...; for OpExtInst then %set and name.
            std::istringstream words(line);
            std::string first, second, operation, type, set, name;
            words >> first >> second >> operation >> type >> set >> name;
            if (first == "OpDecorate" && operation == "NoContraction") uncontracted.insert(second);
            if (second != "=") continue;
            if (sums.contains(operation)) {
                ++count;
                EXPECT_TRUE(uncontracted.contains(first)) << options << ": " << line;
            }
            EXPECT_FALSE(inexact.contains(operation)) << options << ": " << line;
            EXPECT_TRUE(operation != "OpExtInst" || name == "SMin") << options << ": " << line;
        }
        EXPECT_GT(count, 150) << options;
    }
}

// The quick functions of shading, to the bounds that the header states: all mantissas over two octaves, and a
// spread of exponents.
TEST(MathTwin, QuickFunctionsKeepTheirBounds) {
    double worst_root = 0;
    for (std::uint32_t bits = 0x3f800000U; bits < 0x40800000U; bits += 7)
        for (const int exponent : {-120, -40, 0, 40, 118}) {
            const float x = std::ldexp(twin::uintBitsToFloat(bits), exponent);
            const double exact = 1 / std::sqrt(static_cast<double>(x));
            worst_root = std::max(worst_root, std::abs(static_cast<double>(twin::quick_rsqrt(x)) / exact - 1));
        }
    EXPECT_LT(worst_root, 3e-7);
    EXPECT_GT(worst_root, 1e-8);  // it is measured

    double worst_power = 0;  // of its bound
    std::mt19937 random(11);
    std::uniform_real_distribution<double> unit(0, 1);
    for (int i = 0; i < 4'000'000; ++i) {
        const auto x = static_cast<float>(i % 2 == 0 ? unit(random) : std::pow(2, -30 * unit(random)));
        const auto y = static_cast<float>(std::pow(10, 8 * unit(random) - 3));
        const double exact = std::pow(static_cast<double>(x), static_cast<double>(y));
        if (!(exact > 1e-37)) continue;
        const double bound = 2e-7 * (1 + std::abs(std::log2(exact)));
        worst_power = std::max(worst_power, std::abs(static_cast<double>(twin::quick_power(x, y)) / exact - 1) / bound);
    }
    EXPECT_LT(worst_power, 1);
    EXPECT_GT(worst_power, 0.1);
    EXPECT_EQ(twin::quick_power(0, 0), 1);
    EXPECT_EQ(twin::quick_power(0, 3), 0);
    EXPECT_EQ(twin::quick_power(1, 1e5F), 1);
    EXPECT_EQ(twin::quick_power(0.5F, 1000), 0);  // below the smallest normal number
}

}  // namespace
}  // namespace pellucid
