#include "scene/shading.hpp"

#include <algorithm>

#include "kernel/shading_twin.h"

namespace pellucid {
namespace {

[[nodiscard]] twin::Vec3f narrow(const Vec3& v) {
    return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

}  // namespace

Vec3 shade(const PreparedScene& scene, const Object& object, const Vec3& world, const Vec3& normal) {
    const Vec3 color = object.geometry->has_color() ? object.geometry->color(world) : object.surface.color;
    return shade(scene.camera, scene.settings.lights, object.surface.shading, color, world, normal);
}

Vec3 shade(const Camera& camera, std::span<const Light> lights, const Shading& s, const Vec3& color, const Vec3& world,
           const Vec3& normal) {
    if (s.flat) return color;
    return shade(lights, s, color, -normalize(camera.ray_direction(world)), normal);
}

Vec3 shade(std::span<const Light> lights, const Shading& s, const Vec3& color, const Vec3& viewer, const Vec3& normal) {
    if (s.flat) return color;
    const twin::Vec3f to_viewer = narrow(viewer);
    const twin::Vec3f n = twin::turned_to(narrow(normalize(normal)), to_viewer);
    twin::LightSums sums{0, 0};
    for (const Light& light : lights) {
        const twin::Vec3f to_light = light.headlight ? to_viewer : narrow(light.direction);
        if (s.specular == 0)
            sums.diffuse = twin::add_diffuse(sums.diffuse, n, to_light, static_cast<float>(light.intensity));
        else
            sums = twin::add_light(sums, n, to_viewer, to_light, static_cast<float>(light.intensity),
                               static_cast<float>(s.shininess));
    }
    Vec3 shaded;
    for (int c = 0; c < 3; ++c)
        shaded[c] = static_cast<double>(twin::shaded_channel(
            static_cast<float>(color[c]), sums, static_cast<float>(s.ambient), static_cast<float>(s.diffuse),
            static_cast<float>(s.specular)));
    return shaded;
}

Vec3 shade(const PreparedScene& scene, const VolumeObject& volume, const Vec3& world, const Vec3& color,
           const Vec3& gradient) {
    if (volume.settings().shading.flat) return color;
    // Its direction alone counts, and its square must be a number.
    const Vec3 size = glm::abs(gradient);
    const double largest = std::max({size.x, size.y, size.z});
    if (!(largest > 0)) return color;
    const Vec3 normal = volume.to_world().normal(gradient / largest);
    return dot(normal, normal) > 0 ? shade(scene.camera, scene.settings.lights, volume.settings().shading, color, world, -normal)
                                   : color;
}

namespace {

[[nodiscard]] Vec3 brightest(std::span<const Light> lights, const Shading& s, const Vec3& color) {
    if (s.flat) return color;
    double light = 0;
    for (const Light& each : lights) light += each.intensity;
    return color * (s.ambient + s.diffuse * light) + Vec3(s.specular * light);
}

}  // namespace

Vec3 brightest_color(std::span<const Light> lights, const Object& object) {
    const SurfaceGeometry& geometry = *object.geometry;
    return brightest(lights, object.surface.shading, geometry.has_color() ? geometry.brightest() : object.surface.color);
}

Vec3 brightest_color(std::span<const Light> lights, const VolumeObject& volume) {
    // Unlit where there is no gradient.
    const Vec3 own = volume.transfer().brightest();
    return glm::max(own, brightest(lights, volume.settings().shading, own));
}

Vec3 share_of(const Vec3& color, const Vec3& brightest) {
    Vec3 share(0.0);
    for (int c = 0; c < 3; ++c)
        if (brightest[c] > 0) share[c] = color[c] / brightest[c];
    return share;
}

double brightest_color(const PreparedScene& scene) {
    Vec3 most(0.0);
    for (const Object& object : scene.objects) most = glm::max(most, brightest_color(scene.settings.lights, object));
    for (const VolumeObject& volume : scene.volumes) most = glm::max(most, brightest_color(scene.settings.lights, volume));
    return std::max({most.x, most.y, most.z});
}

}  // namespace pellucid
