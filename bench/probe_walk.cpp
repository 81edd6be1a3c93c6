#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <vector>

#include "bench/probes.hpp"
#include "core/parallel.hpp"

namespace pellucid::bench {
namespace {

constexpr double kMajor = 1, kMinor = 0.4;
constexpr double kStep = 0.028;  // 1e-2 of the torus' width
constexpr std::size_t kWalkers = 1024;
/// Corrections: from half a step squared over the tube's radius to 1e-12 of the width.
constexpr int kNewton = 2;

[[nodiscard]] inline std::uint32_t mix(std::uint32_t x) {
    x ^= x >> 16U;
    x *= 0x7feb352dU;
    x ^= x >> 15U;
    x *= 0x846ca68bU;
    return x ^ (x >> 16U);
}

/// ln x for x in (0, 1), to 1e-7: enough for a probe, and without a call.
[[nodiscard]] inline double quick_log(double x) {
    const auto bits = std::bit_cast<std::int64_t>(x) - 0x3fe6a09e667f3bcdLL;
    const double exponent = static_cast<double>(static_cast<int>(bits >> 52));
    const double m = std::bit_cast<double>((bits & 0x000fffffffffffffLL) + 0x3fe6a09e667f3bcdLL);
    const double s = (m - 1) / (m + 1);
    const double z = s * s;
    return exponent * 0.693147180559945 + 2 * s * (1 + z * (1.0 / 3 + z * (0.2 + z * (1.0 / 7 + z / 9))));
}
/// sin(πx/2) for x in [−1, 1], to 1e-8.
[[nodiscard]] inline double quarter_sine(double x) {
    const double y = x * x;
    return x * (1.570796327 + y * (-0.645964098 + y * (0.079692626 + y * (-0.004681754 + y * 0.000160441))));
}

struct Herd {
    alignas(64) double x[kWalkers], y[kWalkers], z[kWalkers];
};

void walk(Herd& herd, std::uint32_t step) {
    for (std::size_t i = 0; i < kWalkers; ++i) {
        const std::uint32_t key = 2 * (step * static_cast<std::uint32_t>(kWalkers) + static_cast<std::uint32_t>(i));
        const double u = (static_cast<int>(mix(key) >> 1U) + 0.5) * 0x1p-31;
        const double v = static_cast<int>(mix(key + 1) >> 1U) * 0x1p-31;
        const double radius = kStep * std::sqrt(-2 * quick_log(u));
        // cos and sin of 2πv: from [−1, 1] quarter turns, and the two signs of half turns.
        const double turn = 4 * v - 2;  // [−2, 2)
        const double folded = turn > 1 ? 2 - turn : turn < -1 ? -2 - turn : turn;
        const double sine = quarter_sine(folded);
        const double cosine = (turn > 1 || turn < -1 ? -1.0 : 1.0) * quarter_sine(1 - std::abs(folded));
        const double first = radius * cosine, second = radius * sine;

        double x = herd.x[i], y = herd.y[i], z = herd.z[i];
        const double rho = std::sqrt(x * x + y * y);
        const double inward = 1 - kMajor / rho;
        // |n| = tube's radius: the gradient is 2·(that).
        const double nx = inward * x / kMinor, ny = inward * y / kMinor, nz = z / kMinor;
        const double sign = nz < 0 ? -1.0 : 1.0;
        const double a = -1 / (sign + nz);
        const double b = nx * ny * a;
        const double drift = -0.125 * kStep * kStep * (4 - 2 * kMajor / rho) * 2 / kMinor;
        x += first * (1 + sign * nx * nx * a) + second * b + drift * nx;
        y += first * sign * b + second * (sign + ny * ny * a) + drift * ny;
        z += -first * sign * nx - second * ny + drift * nz;
        for (int k = 0; k < kNewton; ++k) {
            const double r = std::sqrt(x * x + y * y);
            const double ring = r - kMajor;
            const double in = ring / r;
            const double square = 4 * (ring * ring + z * z);
            const double by = 2 * (ring * ring + z * z - kMinor * kMinor) / square;
            x -= by * in * x;
            y -= by * in * y;
            z -= by * z;
        }
        herd.x[i] = x;
        herd.y[i] = y;
        herd.z[i] = z;
    }
}

}  // namespace

std::uint64_t TorusWalkProbe::run() {
    constexpr std::size_t kHerds = 16;
    const std::uint64_t steps = steps_ / (kHerds * kWalkers);
    double sum = 0;
    std::vector<double> ends(kHerds);
    parallel_for(kHerds, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t h = begin; h < end; ++h) {
            auto herd = std::make_unique<Herd>();
            for (std::size_t i = 0; i < kWalkers; ++i) {
                herd->x[i] = kMajor + kMinor;
                herd->y[i] = herd->z[i] = 0;
            }
            for (std::uint64_t step = 0; step < steps; ++step)
                walk(*herd, static_cast<std::uint32_t>(h * steps + step));
            for (std::size_t i = 0; i < kWalkers; ++i) ends[h] += herd->x[i];
        }
    });
    for (const double e : ends) sum += e;
    return std::isfinite(sum) ? steps * kHerds * kWalkers : 0;  // the sum keeps the work from being left out
}

CopyProbe::CopyProbe(std::uint64_t bytes) : from_(bytes, 1), to_(bytes, 2) {}

std::uint64_t CopyProbe::run() {
    constexpr std::size_t kPiece = std::size_t{1} << 22U;
    parallel_for(from_.size() / kPiece, 1, [&](std::size_t begin, std::size_t end) {
        std::memcpy(to_.data() + begin * kPiece, from_.data() + begin * kPiece, (end - begin) * kPiece);
    });
    return from_.size() / kPiece * kPiece;
}

}  // namespace pellucid::bench
