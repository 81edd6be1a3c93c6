#include <atomic>
#include <cmath>
#include <vector>

#include "bench/probes.hpp"
#include "core/parallel.hpp"

namespace pellucid::bench {
namespace {

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

template <int degree>
struct Lines {  // p(s) = Σ c_k s^k on x = from + s·along, s in [0, 1]
    static constexpr std::size_t kCoefficients = degree + 1;
    float from[3][kBatch], along[3][kBatch], c[kCoefficients][kBatch];
};

/// (|x|² + R² − r²)² − 4R²(x² + y²)
struct Torus {
    static constexpr int kDegree = 4;
    static constexpr float kMajor = 1;
    static constexpr float kMinor = 0.4F;
    static constexpr float kRadius = kMajor + kMinor;

    static inline void coefficients(const float* o, const float* d, Lines<4>& lines, std::size_t i) {
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
};

/// 4(τ²x² − y²)(τ²y² − z²)(τ²z² − x²) − (1 + 2τ)(|x|² − 1)²
struct BarthSextic {
    static constexpr int kDegree = 6;
    static constexpr float kRadius = 1.65F;

    static inline void coefficients(const float* o, const float* d, Lines<6>& lines, std::size_t i) {
        constexpr float kGolden = 1.618033989F;
        // Squares of coordinates, and their differences, as quadratics in s.
        float square[3][3];
        for (int k = 0; k < 3; ++k) {
            square[k][0] = o[k] * o[k];
            square[k][1] = 2 * o[k] * d[k];
            square[k][2] = d[k] * d[k];
        }
        float q[3][3];
        for (int k = 0; k < 3; ++k)
            for (int j = 0; j < 3; ++j)
                q[k][j] = kGolden * kGolden * square[k][j] - square[(k + 1) % 3][j];
        float quartic[5] = {};
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k) quartic[j + k] += q[0][j] * q[1][k];
        float sextic[7] = {};
        for (int j = 0; j < 5; ++j)
            for (int k = 0; k < 3; ++k) sextic[j + k] += 4 * quartic[j] * q[2][k];
        float ball[3];
        for (int j = 0; j < 3; ++j) ball[j] = square[0][j] + square[1][j] + square[2][j] - (j == 0 ? 1.0F : 0.0F);
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k) sextic[j + k] -= (1 + 2 * kGolden) * ball[j] * ball[k];
        for (int j = 0; j < 7; ++j) lines.c[j][i] = sextic[j];
    }
};

/// Chords between two uniform points of a sphere are uniform random lines through it.
template <class Surface>
void draw_lines(std::uint32_t first, Lines<Surface::kDegree>& lines) {
    for (std::size_t i = 0; i < kBatch; ++i) {
        const std::uint32_t key = 4 * (first + static_cast<std::uint32_t>(i));
        float end[2][3];
        for (std::uint32_t k = 0; k < 2; ++k) {
            const float z = 2 * unit(mix(key + 2 * k)) - 1;
            const float turn = 4 * unit(mix(key + 2 * k + 1)) - 2;  // quarter turns in [−2, 2)
            const float side = Surface::kRadius * std::sqrt(1 - z * z);
            end[k][0] = side * quarter_sine(turn);
            end[k][1] = side * quarter_sine(turn < 1 ? turn + 1 : turn - 3);
            end[k][2] = Surface::kRadius * z;
        }
        for (int axis = 0; axis < 3; ++axis) {
            lines.from[axis][i] = end[0][axis];
            lines.along[axis][i] = end[1][axis] - end[0][axis];
        }
        const float* o = end[0];
        const float d[3] = {end[1][0] - o[0], end[1][1] - o[1], end[1][2] - o[2]};
        Surface::coefficients(o, d, lines, i);
    }
}

template <int degree>
[[nodiscard]] inline float value(const Lines<degree>& l, std::size_t i, float s) {
    float sum = l.c[degree][i];
    for (int k = degree - 1; k >= 0; --k) sum = l.c[k][i] + s * sum;
    return sum;
}

template <int degree>
[[nodiscard]] inline float slope(const Lines<degree>& l, std::size_t i, float s) {
    float sum = degree * l.c[degree][i];
    for (int k = degree - 1; k >= 1; --k) sum = static_cast<float>(k) * l.c[k][i] + s * sum;
    return sum;
}

struct Stored {
    float x, y, z;
    std::uint32_t payload;
};

/// Bit k of a line: its sign after step k.
template <int degree>
void find_signs(const Lines<degree>& lines, std::uint32_t* signs) {
    for (std::size_t i = 0; i < kBatch; ++i) {
        std::uint32_t mask = 0;
        for (int step = 0; step <= kSteps; ++step) {
            const bool inside = value(lines, i, static_cast<float>(step) / kSteps) < 0;
            mask |= (inside ? 1U : 0U) << static_cast<unsigned>(step);
        }
        signs[i] = mask;
    }
}

/// The crossings of one batch; `out` has room for as many a line as its degree.
template <class Surface>
std::size_t cross_batch(std::uint32_t first, Lines<Surface::kDegree>& lines, Stored* out) {
    constexpr std::size_t kMost = Surface::kDegree * kBatch;
    alignas(64) std::uint32_t signs[kBatch];
    alignas(64) float root[kMost];
    alignas(64) std::uint32_t line[kMost];
    draw_lines<Surface>(first, lines);
    find_signs(lines, signs);
    std::size_t found = 0;
    for (std::size_t i = 0; i < kBatch; ++i) {
        std::uint32_t changes = (signs[i] ^ (signs[i] >> 1U)) & ((1U << kSteps) - 1);
        for (; changes != 0 && found < kMost; changes &= changes - 1) {
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
            const bool before = (v < 0) == rising;
            lo = before ? s : lo;
            hi = before ? hi : s;
            const float newton = s - v / slope(lines, i, s);
            s = newton > lo && newton < hi ? newton : 0.5F * (lo + hi);
        }
        out[k] = {lines.from[0][i] + s * lines.along[0][i], lines.from[1][i] + s * lines.along[1][i],
                  lines.from[2][i] + s * lines.along[2][i], first + static_cast<std::uint32_t>(i)};
    }
    return found;
}

template <class Surface>
std::uint64_t cross_all(std::uint64_t lines) {
    std::atomic<std::uint64_t> total = 0;
    parallel_for(lines / kBatch, 64, [&](std::size_t begin, std::size_t end) {
        Lines<Surface::kDegree> batch_lines;
        std::vector<Stored> stored((end - begin) * kBatch * Surface::kDegree);
        std::size_t found = 0;
        for (std::size_t batch = begin; batch < end; ++batch)
            found += cross_batch<Surface>(static_cast<std::uint32_t>(batch * kBatch), batch_lines, &stored[found]);
        total += found;
    });
    return total;
}

}  // namespace

std::uint64_t TorusLinesProbe::run() { return cross_all<Torus>(lines_); }
std::uint64_t SexticLinesProbe::run() { return cross_all<BarthSextic>(lines_); }

}  // namespace pellucid::bench
