#include <atomic>
#include <cmath>
#include <vector>

#include "bench/probes.hpp"
#include "core/parallel.hpp"

namespace pellucid::bench {
namespace {

constexpr float kMajor = 1;
constexpr float kMinor = 0.4F;
constexpr float kRadius = kMajor + kMinor;
constexpr std::size_t kBatch = 256;  // lines handled at once, to stay in the first-level cache
constexpr int kSteps = 16;

/// A well-mixed function of 32 bits (Wellons' lowbias32): vectorises, which a generator with state does not.
[[nodiscard]] inline std::uint32_t mix(std::uint32_t x) {
    x ^= x >> 16U;
    x *= 0x7feb352dU;
    x ^= x >> 15U;
    x *= 0x846ca68bU;
    return x ^ (x >> 16U);
}

[[nodiscard]] inline float unit(std::uint32_t bits) {
    return static_cast<float>(static_cast<int>(bits >> 8U)) * 0x1p-24F;
}

/// sin(πx/2) for |x| <= 2, to 1e-4: enough for a probe, and without a call.
[[nodiscard]] inline float quarter_sine(float x) {
    const float folded = x > 1 ? 2 - x : x < -1 ? -2 - x : x;
    const float y = folded * folded;
    return folded * (1.5707903F + y * (-0.6458928F + y * (0.0794343F - y * 0.0043331F)));
}

struct Lines {  // p(s) = Σ c_k s^k on x = from + s·along, s in [0, 1]
    float from[3][kBatch], along[3][kBatch], c[5][kBatch];
};

/// Chords between two uniform points of a sphere are uniform random lines through it.
void draw_lines(std::uint32_t first, Lines& lines) {
    for (std::size_t i = 0; i < kBatch; ++i) {
        const std::uint32_t key = 4 * (first + static_cast<std::uint32_t>(i));
        float end[2][3];
        for (std::uint32_t k = 0; k < 2; ++k) {
            const float z = 2 * unit(mix(key + 2 * k)) - 1;
            const float turn = 4 * unit(mix(key + 2 * k + 1)) - 2;  // quarter turns in [−2, 2)
            const float side = kRadius * std::sqrt(1 - z * z);
            end[k][0] = side * quarter_sine(turn);
            end[k][1] = side * quarter_sine(turn < 1 ? turn + 1 : turn - 3);
            end[k][2] = kRadius * z;
        }
        for (int axis = 0; axis < 3; ++axis) {
            lines.from[axis][i] = end[0][axis];
            lines.along[axis][i] = end[1][axis] - end[0][axis];
        }
        // (|x|² + R² − r²)² − 4R²(x² + y²)
        const float* o = end[0];
        const float d[3] = {end[1][0] - o[0], end[1][1] - o[1], end[1][2] - o[2]};
        const float a = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        const float b = 2 * (o[0] * d[0] + o[1] * d[1] + o[2] * d[2]);
        const float c = o[0] * o[0] + o[1] * o[1] + o[2] * o[2] + kMajor * kMajor - kMinor * kMinor;
        constexpr float m = 4 * kMajor * kMajor;
        lines.c[4][i] = a * a;
        lines.c[3][i] = 2 * a * b;
        lines.c[2][i] = b * b + 2 * a * c - m * (d[0] * d[0] + d[1] * d[1]);
        lines.c[1][i] = 2 * b * c - 2 * m * (o[0] * d[0] + o[1] * d[1]);
        lines.c[0][i] = c * c - m * (o[0] * o[0] + o[1] * o[1]);
    }
}

[[nodiscard]] inline float value(const Lines& l, std::size_t i, float s) {
    return l.c[0][i] + s * (l.c[1][i] + s * (l.c[2][i] + s * (l.c[3][i] + s * l.c[4][i])));
}

struct Stored {
    float x, y, z;
    std::uint32_t payload;
};

/// Bit k of a line: its sign after step k.
void find_signs(const Lines& lines, std::uint32_t* signs) {
    for (std::size_t i = 0; i < kBatch; ++i) {
        std::uint32_t mask = 0;
        for (int step = 0; step <= kSteps; ++step) {
            const bool inside = value(lines, i, static_cast<float>(step) / kSteps) < 0;
            mask |= (inside ? 1U : 0U) << static_cast<unsigned>(step);
        }
        signs[i] = mask;
    }
}

/// The crossings of one batch; `out` has room for four a line.
std::size_t cross_batch(std::uint32_t first, Lines& lines, Stored* out) {
    alignas(64) std::uint32_t signs[kBatch];
    alignas(64) float root[4 * kBatch];
    alignas(64) std::uint32_t line[4 * kBatch];
    draw_lines(first, lines);
    find_signs(lines, signs);
    std::size_t found = 0;
    for (std::size_t i = 0; i < kBatch; ++i) {
        std::uint32_t changes = (signs[i] ^ (signs[i] >> 1U)) & ((1U << kSteps) - 1);
        for (; changes != 0 && found < 4 * kBatch; changes &= changes - 1) {
            line[found] = static_cast<std::uint32_t>(i);
            root[found++] = static_cast<float>(__builtin_ctz(changes)) / kSteps;
        }
    }
    for (std::size_t k = 0; k < found; ++k) {
        const std::size_t i = line[k];
        float lo = root[k];
        float hi = lo + 1.0F / kSteps;
        float s = 0.5F * (lo + hi);
        const bool rising = value(lines, i, lo) < 0;
        for (int step = 0; step < 3; ++step) {
            const float v = value(lines, i, s);
            const float slope =
                lines.c[1][i] + s * (2 * lines.c[2][i] + s * (3 * lines.c[3][i] + s * 4 * lines.c[4][i]));
            const bool before = (v < 0) == rising;
            lo = before ? s : lo;
            hi = before ? hi : s;
            const float newton = s - v / slope;
            s = newton > lo && newton < hi ? newton : 0.5F * (lo + hi);
        }
        out[k] = {lines.from[0][i] + s * lines.along[0][i], lines.from[1][i] + s * lines.along[1][i],
                  lines.from[2][i] + s * lines.along[2][i], first + static_cast<std::uint32_t>(i)};
    }
    return found;
}

}  // namespace

std::uint64_t TorusLinesProbe::run() {
    std::atomic<std::uint64_t> total = 0;
    parallel_for(lines_ / kBatch, 64, [&](std::size_t begin, std::size_t end) {
        Lines lines;
        std::vector<Stored> stored((end - begin) * kBatch * 4);
        std::size_t found = 0;
        for (std::size_t batch = begin; batch < end; ++batch)
            found += cross_batch(static_cast<std::uint32_t>(batch * kBatch), lines, &stored[found]);
        total += found;
    });
    return total;
}

}  // namespace pellucid::bench
