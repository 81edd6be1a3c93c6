// Trilinear samples with no renderer around them: packets of 4 × 4 rays, uint8 in bricks of 8³ cells with an
// apron, both neighbours along x in one gather.
#define HWY_COMPILE_ONLY_STATIC
#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

#include "bench/probes.hpp"
#include "core/parallel.hpp"

namespace pellucid::bench {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using F = hn::ScalableTag<float>;
using I = hn::RebindToSigned<F>;
using U = hn::RebindToUnsigned<F>;
using V = hn::Vec<F>;

constexpr int kBlock = 8, kApron = kBlock + 1;
constexpr int kBrick = 736;

[[nodiscard]] std::size_t wide(int n) {
    return static_cast<std::size_t>(n);
}

}  // namespace

TrilinearProbe::TrilinearProbe(int samples, int pixels, std::uint8_t (*value)(int, int, int))
    : samples_(samples), pixels_(pixels), blocks_((samples - 1 + kBlock - 1) / kBlock) {
    data_.resize(wide(blocks_) * wide(blocks_) * wide(blocks_) * kBrick);
    parallel_for(wide(blocks_) * wide(blocks_) * wide(blocks_), 16, [&](std::size_t begin, std::size_t end) {
        for (std::size_t b = begin; b < end; ++b) {
            const int x = kBlock * static_cast<int>(b % wide(blocks_)),
                      y = kBlock * static_cast<int>(b / wide(blocks_) % wide(blocks_)),
                      z = kBlock * static_cast<int>(b / wide(blocks_) / wide(blocks_));
            std::uint8_t* to = data_.data() + b * kBrick;
            for (int k = 0; k < kApron; ++k)
                for (int j = 0; j < kApron; ++j)
                    for (int i = 0; i < kApron; ++i)
                        *to++ = value(std::min(x + i, samples - 1), std::min(y + j, samples - 1),
                                      std::min(z + k, samples - 1));
        }
    });
}

std::uint64_t TrilinearProbe::run() const {
    const int tiles = pixels_ / 4;
    const std::size_t lanes = hn::Lanes(F());
    std::atomic<std::uint64_t> taken{0};
    std::atomic<float> kept{0};
    parallel_for(wide(tiles), 1, [&](std::size_t begin, std::size_t end) {
        const F f;
        const I s;
        const U u;
        const auto integer = [&](int n) { return hn::Set(s, n); };
        const auto last = hn::Set(f, static_cast<float>(samples_ - 1));
        const auto last_cell = integer(samples_ - 2);
        V sum = hn::Zero(f);
        std::uint64_t count = 0;
        for (std::size_t tile = begin; tile < end; ++tile)
            for (int column = 0; column < tiles; ++column)
                for (std::size_t first = 0; first < 16; first += lanes) {
                    // An oblique pinhole view from twice the cube's size away that it fills.
                    alignas(64) std::array<float, 16> px, py, pz, dx, dy, dz, steps;
                    int most = 0;
                    const double n = samples_ - 1;
                    for (std::size_t r = 0; r < lanes; ++r) {
                        const std::size_t ray = first + r;
                        const double a = (4.0 * column + static_cast<double>(ray % 4) + 0.5) / pixels_ - 0.5;
                        const double b =
                            (4.0 * static_cast<double>(tile) + static_cast<double>(ray / 4) + 0.5) / pixels_ -
                            0.5;
                        const std::array<double, 3> eye{1.9 * n, 1.4 * n, 2.1 * n};
                        const std::array<double, 3> forward{-0.584, -0.375, -0.667 * 1.08},
                            right{0.773, 0, -0.634}, up{0.24, 0.921, 0.29};
                        std::array<double, 3> d{};
                        double size = 0;
                        for (std::size_t c = 0; c < 3; ++c) {
                            d[c] = forward[c] + 0.62 * (a * right[c] - b * up[c]);
                            size += d[c] * d[c];
                        }
                        double lo = 0, hi = 1e9;
                        for (std::size_t c = 0; c < 3; ++c) {
                            d[c] /= std::sqrt(size);
                            const double t0 = -eye[c] / d[c], t1 = (n - eye[c]) / d[c];
                            lo = std::max(lo, std::min(t0, t1));
                            hi = std::min(hi, std::max(t0, t1));
                        }
                        px[r] = static_cast<float>(eye[0] + lo * d[0]);
                        py[r] = static_cast<float>(eye[1] + lo * d[1]);
                        pz[r] = static_cast<float>(eye[2] + lo * d[2]);
                        dx[r] = static_cast<float>(d[0]);
                        dy[r] = static_cast<float>(d[1]);
                        dz[r] = static_cast<float>(d[2]);
                        const int inside = hi > lo ? static_cast<int>(hi - lo) + 1 : 0;
                        steps[r] = static_cast<float>(inside);
                        most = std::max(most, inside);
                        count += static_cast<std::uint64_t>(inside);
                    }
                    const V x0 = hn::Load(f, px.data()), y0 = hn::Load(f, py.data()),
                            z0 = hn::Load(f, pz.data());
                    const V xd = hn::Load(f, dx.data()), yd = hn::Load(f, dy.data()),
                            zd = hn::Load(f, dz.data());
                    const V left = hn::Load(f, steps.data());
                    for (int i = 0; i < most; ++i) {
                        const V t = hn::Set(f, static_cast<float>(i));
                        const auto clamped = [&](V p) { return hn::Min(hn::Max(p, hn::Zero(f)), last); };
                        const V x = clamped(hn::MulAdd(xd, t, x0)), y = clamped(hn::MulAdd(yd, t, y0)),
                                z = clamped(hn::MulAdd(zd, t, z0));
                        const auto ix = hn::Min(hn::ConvertTo(s, x), last_cell),
                                   iy = hn::Min(hn::ConvertTo(s, y), last_cell),
                                   iz = hn::Min(hn::ConvertTo(s, z), last_cell);
                        const V fx = hn::Sub(x, hn::ConvertTo(f, ix)), fy = hn::Sub(y, hn::ConvertTo(f, iy)),
                                fz = hn::Sub(z, hn::ConvertTo(f, iz));
                        const auto brick =
                            hn::Add(hn::ShiftRight<3>(ix),
                                    hn::Mul(integer(blocks_),
                                            hn::Add(hn::ShiftRight<3>(iy),
                                                    hn::Mul(integer(blocks_), hn::ShiftRight<3>(iz)))));
                        const auto seven = integer(7);
                        auto at = hn::Add(
                            hn::And(ix, seven),
                            hn::Mul(integer(9),
                                    hn::Add(hn::And(iy, seven), hn::Mul(integer(9), hn::And(iz, seven)))));
                        at = hn::Add(at, hn::Mul(brick, integer(kBrick)));
                        const auto row = [&](int more) {
                            const auto both =
                                hn::GatherOffset(u, reinterpret_cast<const std::uint32_t*>(data_.data()),
                                                 hn::Add(at, integer(more)));
                            const auto byte = hn::Set(u, 255U);
                            const V lo = hn::ConvertTo(f, hn::BitCast(s, hn::And(both, byte)));
                            const V hi =
                                hn::ConvertTo(f, hn::BitCast(s, hn::And(hn::ShiftRight<8>(both), byte)));
                            return hn::MulAdd(fx, hn::Sub(hi, lo), lo);
                        };
                        const V a = row(0), b = row(kApron), c = row(kApron * kApron),
                                d = row(kApron * kApron + kApron);
                        const V e = hn::MulAdd(fy, hn::Sub(b, a), a), g = hn::MulAdd(fy, hn::Sub(d, c), c);
                        const V value = hn::MulAdd(fz, hn::Sub(g, e), e);
                        sum = hn::Add(sum, hn::IfThenElseZero(hn::Lt(t, left), value));
                    }
                }
        taken += count;
        kept = kept + hn::GetLane(hn::SumOfLanes(F(), sum));
    });
    return std::isfinite(kept.load()) ? taken.load() : 0;  // the sum keeps the work from being left out
}

}  // namespace pellucid::bench
