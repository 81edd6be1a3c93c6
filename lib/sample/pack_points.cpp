// Plain loops, compiled once for every instruction set: the twin header stays the only place that knows how
// a normal is packed.
#include "sample/pack_points.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "kernel/normal_twin.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sample/pack_points.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

constexpr std::size_t kChunk = 64;

void pack(const ParticleFrame& frame, const SourcePoint* points, Particle* out, std::size_t count) {
    alignas(64) float x[kChunk], y[kChunk], z[kChunk];
    alignas(64) std::uint32_t bits[kChunk];
    const double shrink = frame.shrink;
    const double near = frame.near;
    for (std::size_t i = 0; i < count; ++i) {
        const Vec3& n = points[i].view_normal;
        const double nx = n.x, ny = n.y, nz = n.z;
        const double xy = std::max(std::abs(nx), std::abs(ny));
        const double largest = std::max(xy, std::abs(nz));
        const double scale = std::bit_cast<double>(
            (std::uint64_t{2045} - (std::bit_cast<std::uint64_t>(largest) >> 52U)) << 52U);
        x[i] = static_cast<float>(scale * nx);
        y[i] = static_cast<float>(scale * ny);
        z[i] = static_cast<float>(scale * nz);
    }
    for (std::size_t i = 0; i < count; ++i) bits[i] = twin::pack_normal({x[i], y[i], z[i]});
    for (std::size_t i = 0; i < count; ++i) {
        const Vec3& view = points[i].view;
        out[i] = {static_cast<float>(view.x * shrink), static_cast<float>(view.y * shrink),
                  static_cast<float>(std::max(0.0, view.z - near) * shrink), bits[i]};
    }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {

HWY_EXPORT(pack);

void pack_points(const ParticleFrame& frame, std::span<const SourcePoint> points, bool painted,
                 std::span<Particle> out) {
    if (painted) {
        for (std::size_t i = 0; i < points.size(); ++i) out[i] = frame.pack_painted(points[i].view, points[i].view_normal);
        return;
    }
    constexpr std::size_t kAtOnce = 64;
    for (std::size_t done = 0; done < points.size(); done += kAtOnce)
        HWY_DYNAMIC_DISPATCH(pack)
        (frame, points.data() + done, out.data() + done, std::min(kAtOnce, points.size() - done));
}

}  // namespace pellucid
#endif
