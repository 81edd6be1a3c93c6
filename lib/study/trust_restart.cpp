#include "study/trust_restart.hpp"

#include <algorithm>
#include <cmath>

#include <embree3/rtcore.h>

#include "core/error.hpp"

namespace pellucid {
namespace {

/// A ray that finds the same triangle for ever is given up after this many.
constexpr std::size_t kMostHits = 200;

}  // namespace

struct RestartScene::Embree {
    RTCDevice device = rtcNewDevice(nullptr);
    RTCScene scene = nullptr;
    Vec3 center{0.0};
    double radius = 1;

    ~Embree() {
        if (scene != nullptr) rtcReleaseScene(scene);
        if (device != nullptr) rtcReleaseDevice(device);
    }
};

RestartScene::RestartScene(const TriangleMesh& mesh) : embree_(std::make_unique<Embree>()) {
    Embree& e = *embree_;
    if (e.device == nullptr) throw run_error("Embree gives no device");
    Box box;
    for (const Vec3& p : mesh.positions) box.include(p);
    e.center = box.center();
    e.radius = 0.5 * length(box.size());
    e.scene = rtcNewScene(e.device);
    rtcSetSceneBuildQuality(e.scene, RTC_BUILD_QUALITY_MEDIUM);
    rtcSetSceneFlags(e.scene, RTC_SCENE_FLAG_ROBUST);  // as the ray scene: the restarts alone are wrong
    RTCGeometry geometry = rtcNewGeometry(e.device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertex = static_cast<float*>(rtcSetNewGeometryBuffer(
        geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), mesh.positions.size()));
    auto* index = static_cast<std::uint32_t*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(std::uint32_t), mesh.triangles.size()));
    if (rtcGetDeviceError(e.device) != RTC_ERROR_NONE)
        throw run_error("triangle buffers: Embree has no memory");
    for (const Vec3& p : mesh.positions)
        for (int axis = 0; axis < 3; ++axis)
            *vertex++ = static_cast<float>((p[axis] - e.center[axis]) / e.radius);
    for (const auto& t : mesh.triangles) index = std::copy(t.begin(), t.end(), index);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(e.scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(e.scene);
}

RestartScene::~RestartScene() = default;

void RestartScene::gather(std::span<const Ray> rays, double epsilon,
                          std::vector<std::vector<RayHit>>& hits) const {
    const Embree& e = *embree_;
    hits.resize(rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) {
        hits[i].clear();
        // From two radii before the point nearest to the centre; one unit of the ray is a radius.
        const Vec3 along = normalize(rays[i].direction);
        const Vec3 from = (rays[i].origin - e.center) / e.radius;
        const Vec3 start = from - (dot(from, along) + 2) * along;
        double t = 0;
        while (hits[i].size() < kMostHits) {
            RTCRayHit query{};
            query.ray = {.org_x = static_cast<float>(start.x),
                         .org_y = static_cast<float>(start.y),
                         .org_z = static_cast<float>(start.z),
                         .tnear = static_cast<float>(t),
                         .dir_x = static_cast<float>(along.x),
                         .dir_y = static_cast<float>(along.y),
                         .dir_z = static_cast<float>(along.z),
                         .time = 0,
                         .tfar = 4,
                         .mask = ~0U,
                         .id = 0,
                         .flags = 0};
            query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
            RTCIntersectContext context;
            rtcInitIntersectContext(&context);
            rtcIntersect1(e.scene, &context, &query);
            if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) break;
            const double depth = static_cast<double>(query.ray.tfar);
            hits[i].push_back({depth, 0, query.hit.primID, Vec3(0.0)});
            t = depth + epsilon;
        }
    }
}

}  // namespace pellucid
