#include "reference/ray_scene.hpp"

#include <algorithm>
#include <atomic>
#include <cfenv>
#include <cmath>
#include <limits>

#include <embree3/rtcore.h>

#include "core/error.hpp"

namespace pellucid {
namespace {

/// What the callbacks of one packet need; Embree's context comes first, so that it can be cast back.
struct GatherContext {
    RTCIntersectContext embree;
    const PreparedScene* scene;
    const Ray* rays;
    double t_lo[kPacket];    // depth where Embree's ray starts …
    double t_span[kPacket];  // … and how far it reaches, which is its unit
    PacketHits* hits;
};

/// One object as Embree's user data.
struct ObjectRef {
    const Object* object;
    std::uint32_t index;
    Vec3 center;  // the frame in which Embree sees the scene
    double scale;
};

void keep_hit(GatherContext& context, std::uint32_t lane, const ObjectRef& ref, std::uint32_t patch, double t,
              const Vec3& normal) {
    const Ray& ray = context.rays[lane];
    if (!ref.object->keeps(ray.origin + t * ray.direction)) return;
    context.hits->rays[lane].push_back({t, ref.index, patch, normal});
}

/// Context filter for triangles: depth anew in double from the plane of the triangle, then on.
void collect_triangles(const RTCFilterFunctionNArguments* args) {
    auto& context = *reinterpret_cast<GatherContext*>(args->context);
    const auto& ref = *static_cast<const ObjectRef*>(args->geometryUserPtr);
    const unsigned n = args->N;
    for (unsigned i = 0; i < n; ++i) {
        if (args->valid[i] == 0) continue;
        args->valid[i] = 0;
        const unsigned lane = RTCRayN_id(args->ray, n, i);
        const unsigned patch = RTCHitN_primID(args->hit, n, i);
        const Ray& ray = context.rays[lane];
        const TriangleMesh& mesh = *ref.object->geometry->mesh();
        const auto& [a, b, c] = mesh.triangles[patch];
        const Vec3& corner = mesh.positions[a];
        const Vec3 normal = cross(mesh.positions[b] - corner, mesh.positions[c] - corner);
        const double float_t = context.t_lo[lane] + context.t_span[lane] * static_cast<double>(RTCRayN_tfar(args->ray, n, i));
        const double exact_t = dot(normal, corner - ray.origin) / dot(normal, ray.direction);
        // Seen edge-on the plane says nothing: there Embree's own depth stays.
        const bool agree = std::abs(exact_t - float_t) <= 1e-3 * context.t_span[lane];
        const double t = agree ? exact_t : float_t;
        keep_hit(context, lane, ref, patch, t, normal);
    }
}

/// Whether two triangles share a corner or two, but not all three.
[[nodiscard]] bool adjacent(const TriangleMesh& mesh, std::uint32_t a, std::uint32_t b) {
    int shared = 0;
    for (const std::uint32_t i : mesh.triangles[a])
        for (const std::uint32_t k : mesh.triangles[b]) shared += i == k || mesh.positions[i] == mesh.positions[k] ? 1 : 0;
    return shared > 0 && shared < 3;
}

/// Depths so close, in units of the scene's size, may be one place: Embree decides in float32, cells of formulas in
/// double.
constexpr double kOneEdge = 1e-5;
constexpr double kOneFace = 1e-13;

/// Whether `next` tells the crossing `last` again. Embree's edges overlap a little, and a ray through a corner of
/// cells may see rounding as changes of sign: then two hits at one place have the same side of the surface in
/// front, which two crossings of it cannot have.
[[nodiscard]] bool same_crossing(const PreparedScene& scene, const RayHit& last, const RayHit& next, const Ray& ray,
                                 double unit, double eye) {
    if (last.object != next.object || last.patch == next.patch) return false;
    if ((dot(last.normal, ray.direction) > 0) != (dot(next.normal, ray.direction) > 0)) return false;
    const SurfaceGeometry& shape = *scene.objects[next.object].geometry;
    if (shape.mesh() != nullptr)
        return next.t - last.t <= kOneEdge * unit && adjacent(*shape.mesh(), last.patch, next.patch);
    return shape.field() && next.t - last.t <= kOneFace * (unit + next.t + eye);
}

/// Embree builds with numbers below 1e-38 flushed to zero; samples of volumes may be such.
class PlainArithmetic {
public:
    PlainArithmetic() {
        std::fegetenv(&before_);
        std::fesetenv(FE_DFL_ENV);
    }
    ~PlainArithmetic() { std::fesetenv(&before_); }
    PlainArithmetic(const PlainArithmetic&) = delete;
    PlainArithmetic& operator=(const PlainArithmetic&) = delete;

private:
    std::fenv_t before_{};
};

void patch_bounds(const RTCBoundsFunctionArguments* args) {
    const PlainArithmetic plain;
    const auto& ref = *static_cast<const ObjectRef*>(args->geometryUserPtr);
    std::array<Vec3, 8> corners;
    const int count = ref.object->geometry->body(args->primID).vertices(corners);
    Box box;
    for (int i = 0; i < count; ++i) box.include((corners[static_cast<std::size_t>(i)] - ref.center) * ref.scale);
    // Room for float32: in this frame the scene has size 1.
    const float room = 1e-6F;
    RTCBounds& b = *args->bounds_o;
    b.lower_x = static_cast<float>(box.lo.x) - room;
    b.lower_y = static_cast<float>(box.lo.y) - room;
    b.lower_z = static_cast<float>(box.lo.z) - room;
    b.upper_x = static_cast<float>(box.hi.x) + room;
    b.upper_y = static_cast<float>(box.hi.y) + room;
    b.upper_z = static_cast<float>(box.hi.z) + room;
}

void cross_patch(const RTCIntersectFunctionNArguments* args) {
    auto& context = *reinterpret_cast<GatherContext*>(args->context);
    const auto& ref = *static_cast<const ObjectRef*>(args->geometryUserPtr);
    const unsigned n = args->N;
    for (unsigned i = 0; i < n; ++i) {
        if (args->valid[i] == 0) continue;
        const unsigned lane = RTCRayN_id(RTCRayHitN_RayN(args->rayhit, n), n, i);
        const Ray& ray = context.rays[lane];
        const double near = context.scene->camera.near();
        const double far = context.scene->camera.far();
        ref.object->geometry->crossings(args->primID, {ray.origin, ray.direction, near, far}, context.hits->patch);
        for (const Crossing& crossing : context.hits->patch.hits)
            keep_hit(context, lane, ref, args->primID, crossing.t, crossing.normal);
    }
}

}  // namespace

struct RayScene::Embree {
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;
    std::vector<std::unique_ptr<ObjectRef>> refs;
    Vec3 center{0.0};
    double radius = 0;  // of a sphere around all objects; 0 = nothing to hit
    std::atomic<std::int64_t> bytes{0};

    ~Embree() {
        if (scene != nullptr) rtcReleaseScene(scene);
        if (device != nullptr) rtcReleaseDevice(device);
    }

    /// Embree reports a failure at the call that follows it.
    void check(const char* what) const {
        const RTCError error = rtcGetDeviceError(device);
        if (error == RTC_ERROR_OUT_OF_MEMORY) throw run_error("{}: out of memory", what);
        if (error != RTC_ERROR_NONE) throw run_error("{}: Embree error {}", what, static_cast<int>(error));
    }

    RTCGeometry make_triangles(const TriangleMesh& mesh) const {
        RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        auto* vertex = static_cast<float*>(rtcSetNewGeometryBuffer(
            geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), mesh.positions.size()));
        auto* index = static_cast<std::uint32_t*>(rtcSetNewGeometryBuffer(
            geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(std::uint32_t), mesh.triangles.size()));
        check("triangle buffers");
        for (const Vec3& p : mesh.positions)
            for (int axis = 0; axis < 3; ++axis) *vertex++ = static_cast<float>((p[axis] - center[axis]) / radius);
        for (const auto& t : mesh.triangles) index = std::copy(t.begin(), t.end(), index);
        return geometry;
    }

    RTCGeometry make_patches(std::size_t count) const {
        RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
        rtcSetGeometryUserPrimitiveCount(geometry, static_cast<unsigned>(count));
        rtcSetGeometryBoundsFunction(geometry, patch_bounds, nullptr);
        rtcSetGeometryIntersectFunction(geometry, cross_patch);
        return geometry;
    }
};

RayScene::RayScene(const PreparedScene& scene) : scene_(&scene), embree_(std::make_unique<Embree>()) {
    Embree& e = *embree_;
    Box box;
    for (const Object& object : scene.objects)
        if (object.geometry->patch_count() > 0) box.include(object.geometry->bounds());
    if (box.empty()) return;
    e.center = box.center();
    e.radius = std::max(0.5 * length(box.size()), std::numeric_limits<double>::min());

    e.device = rtcNewDevice(nullptr);
    if (e.device == nullptr) throw run_error("Embree gives no device");
    rtcSetDeviceMemoryMonitorFunction(
        e.device,
        [](void* sum, std::ptrdiff_t bytes, bool) {
            *static_cast<std::atomic<std::int64_t>*>(sum) += bytes;
            return true;
        },
        &e.bytes);
    e.scene = rtcNewScene(e.device);
    // Medium quality: no spatial splits, which would offer one triangle to the filter twice.
    rtcSetSceneBuildQuality(e.scene, RTC_BUILD_QUALITY_MEDIUM);
    rtcSetSceneFlags(e.scene, static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION));
    for (std::size_t i = 0; i < scene.objects.size(); ++i) {
        const SurfaceGeometry& shape = *scene.objects[i].geometry;
        if (shape.patch_count() == 0) continue;
        RTCGeometry geometry = shape.mesh() != nullptr ? e.make_triangles(*shape.mesh()) : e.make_patches(shape.patch_count());
        e.refs.push_back(std::make_unique<ObjectRef>(
            ObjectRef{&scene.objects[i], static_cast<std::uint32_t>(i), e.center, 1 / e.radius}));
        rtcSetGeometryUserData(geometry, e.refs.back().get());
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(e.scene, geometry);
        rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(e.scene);
    e.check("building the ray scene");
}

RayScene::~RayScene() = default;

std::int64_t RayScene::bytes() const { return embree_->bytes; }

void RayScene::gather(std::span<const Ray, kPacket> rays, PacketHits& hits) const {
    for (auto& list : hits.rays) list.clear();
    const Embree& e = *embree_;
    if (e.scene == nullptr) return;

    GatherContext context{};
    rtcInitIntersectContext(&context.embree);
    context.embree.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    context.embree.filter = collect_triangles;
    context.scene = scene_;
    context.rays = rays.data();
    context.hits = &hits;

    alignas(64) RTCRayHit16 packet;
    alignas(64) int valid[kPacket];
    for (std::uint32_t i = 0; i < kPacket; ++i) {
        // From where the ray enters the sphere around the scene to where it leaves it, between near and
        // far: Embree's numbers stay near 1 however far away the camera is.
        const Ray& ray = rays[i];
        const Vec3 from = (ray.origin - e.center) / e.radius;
        const Vec3 along = ray.direction / e.radius;
        const double a = dot(along, along);
        const double b = dot(from, along);
        const Vec3 nearest = from - (b / a) * along;
        const double reach = std::sqrt(std::max(0.0, (1.0001 - dot(nearest, nearest)) / a));
        // With a hair of room at both ends: whether a hit lies between near and far is judged in double below.
        const double hair = 1e-5 / std::sqrt(a);
        const double lo = std::max(scene_->camera.near(), -b / a - reach) - hair;
        const double hi = std::min(scene_->camera.far(), -b / a + reach) + hair;
        valid[i] = reach > 0 && lo <= hi ? -1 : 0;
        const double span = hi - lo;
        context.t_lo[i] = lo;
        context.t_span[i] = span;
        const Vec3 origin = from + lo * along;
        const Vec3 direction = span * along;
        packet.ray.org_x[i] = static_cast<float>(origin.x);
        packet.ray.org_y[i] = static_cast<float>(origin.y);
        packet.ray.org_z[i] = static_cast<float>(origin.z);
        packet.ray.dir_x[i] = static_cast<float>(direction.x);
        packet.ray.dir_y[i] = static_cast<float>(direction.y);
        packet.ray.dir_z[i] = static_cast<float>(direction.z);
        packet.ray.tnear[i] = 0;
        packet.ray.tfar[i] = 1;
        packet.ray.time[i] = 0;
        packet.ray.mask[i] = ~0U;
        packet.ray.id[i] = i;
        packet.ray.flags[i] = 0;
        packet.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
    }
    rtcIntersect16(valid, e.scene, &context.embree, &packet);

    const double near = scene_->camera.near();
    const double far = scene_->camera.far();
    for (auto& list : hits.rays) {
        std::erase_if(list, [&](const RayHit& hit) { return !(hit.t >= near && hit.t <= far); });
        if (list.size() > 1)
            std::sort(list.begin(), list.end(), [](const RayHit& x, const RayHit& y) {
                if (x.t != y.t) return x.t < y.t;
                return x.object != y.object ? x.object < y.object : x.patch < y.patch;
            });
    }
    for (std::size_t i = 0; i < kPacket; ++i) drop_repeated(rays[i], hits.rays[i]);
}

void RayScene::drop_repeated(const Ray& ray, std::vector<RayHit>& list) const {
    if (list.size() < 2) return;
    const double unit = embree_->radius / length(ray.direction);
    const double eye = std::max({std::abs(ray.origin.x), std::abs(ray.origin.y), std::abs(ray.origin.z)}) /
                       length(ray.direction);
    std::size_t kept = 1;
    for (std::size_t i = 1; i < list.size(); ++i) {
        // Beside the last hit of the same object: others may lie at the same depth.
        std::size_t last = kept;
        while (last > 0 && list[last - 1].object != list[i].object && list[i].t - list[last - 1].t <= kOneEdge * unit)
            --last;
        if (last == 0 || !same_crossing(*scene_, list[last - 1], list[i], ray, unit, eye)) list[kept++] = list[i];
    }
    list.resize(kept);
}

}  // namespace pellucid
