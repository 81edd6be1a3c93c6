#include <algorithm>
#include <atomic>
#include <limits>

#include <embree3/rtcore.h>

#include "bench/probes.hpp"
#include "core/parallel.hpp"

namespace pellucid::bench {
namespace {

constexpr unsigned kLanes = 16;
constexpr unsigned kMostHits = 64;

struct Hit {
    float t;
    unsigned object, triangle;
};

/// Embree's context comes first, so that it can be cast back.
struct Gather {
    RTCIntersectContext embree;
    unsigned count[kLanes];
    Hit hits[kLanes][kMostHits];
};

void collect(const RTCFilterFunctionNArguments* args) {
    auto& gather = *reinterpret_cast<Gather*>(args->context);
    const unsigned n = args->N;
    for (unsigned i = 0; i < n; ++i) {
        if (args->valid[i] == 0) continue;
        args->valid[i] = 0;
        const unsigned lane = RTCRayN_id(args->ray, n, i);
        if (gather.count[lane] == kMostHits) continue;
        gather.hits[lane][gather.count[lane]++] = {
            RTCRayN_tfar(args->ray, n, i), RTCHitN_geomID(args->hit, n, i), RTCHitN_primID(args->hit, n, i)};
    }
}

}  // namespace

struct EmbreeProbe::Embree {
    RTCDevice device = rtcNewDevice(nullptr);
    RTCScene scene = rtcNewScene(device);
    ~Embree() {
        rtcReleaseScene(scene);
        rtcReleaseDevice(device);
    }
};

EmbreeProbe::EmbreeProbe(const TriangleMesh& mesh, const View& view)
    : embree_(std::make_unique<Embree>()), view_(view) {
    const Embree& e = *embree_;
    RTCGeometry geometry = rtcNewGeometry(e.device, RTC_GEOMETRY_TYPE_TRIANGLE);
    const auto buffer = [&](RTCBufferType type, RTCFormat format, std::size_t count) {
        return rtcSetNewGeometryBuffer(geometry, type, 0, format, 3 * sizeof(float), count);
    };
    auto* vertex =
        static_cast<float*>(buffer(RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_FLOAT3, mesh.positions.size()));
    auto* index =
        static_cast<std::uint32_t*>(buffer(RTC_BUFFER_TYPE_INDEX, RTC_FORMAT_UINT3, mesh.triangles.size()));
    for (const Vec3& p : mesh.positions)
        for (int axis = 0; axis < 3; ++axis) *vertex++ = static_cast<float>(p[axis]);
    for (const auto& t : mesh.triangles) index = std::copy(t.begin(), t.end(), index);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(e.scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcSetSceneFlags(e.scene, RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION);
    rtcCommitScene(e.scene);
}

EmbreeProbe::~EmbreeProbe() = default;

std::uint64_t EmbreeProbe::run() const {
    std::atomic<std::uint64_t> total = 0;
    const auto blocks = static_cast<std::size_t>(view_.size / 4);
    parallel_for(blocks, 1, [&](std::size_t begin, std::size_t end) {
        Gather gather;
        rtcInitIntersectContext(&gather.embree);
        gather.embree.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        gather.embree.filter = collect;
        alignas(64) RTCRayHit16 packet;
        alignas(64) int valid[kLanes];
        std::fill_n(valid, kLanes, -1);
        std::uint64_t hits = 0;
        for (std::size_t block_y = begin; block_y < end; ++block_y)
            for (std::size_t block_x = 0; block_x < blocks; ++block_x) {
                for (unsigned i = 0; i < kLanes; ++i) {
                    const auto column = static_cast<float>(4 * block_x + (i & 3U)) + 0.5F;
                    const auto row = static_cast<float>(4 * block_y + (i >> 2U)) + 0.5F;
                    const auto pixel = static_cast<float>(view_.pixel_size);
                    const float half = 0.5F * static_cast<float>(view_.size);
                    packet.ray.org_x[i] = packet.ray.org_y[i] = 0;
                    packet.ray.org_z[i] = static_cast<float>(view_.distance);
                    packet.ray.dir_x[i] = (column - half) * pixel;
                    packet.ray.dir_y[i] = (half - row) * pixel;
                    packet.ray.dir_z[i] = -1;
                    packet.ray.tnear[i] = 0;
                    packet.ray.tfar[i] = std::numeric_limits<float>::infinity();
                    packet.ray.time[i] = 0;
                    packet.ray.mask[i] = ~0U;
                    packet.ray.id[i] = i;
                    packet.ray.flags[i] = 0;
                    packet.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
                    gather.count[i] = 0;
                }
                rtcIntersect16(valid, embree_->scene, &gather.embree, &packet);
                for (unsigned i = 0; i < kLanes; ++i) {
                    std::sort(gather.hits[i], gather.hits[i] + gather.count[i],
                              [](const Hit& a, const Hit& b) { return a.t < b.t; });
                    hits += gather.count[i];
                }
            }
        total += hits;
    });
    return total;
}

}  // namespace pellucid::bench
