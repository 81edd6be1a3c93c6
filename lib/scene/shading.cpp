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
    const Shading& s = object.surface.shading;
    if (s.flat) return color;

    const twin::Vec3f to_viewer = narrow(-normalize(scene.camera.ray_direction(world)));
    const twin::Vec3f n = twin::turned_to(narrow(normalize(normal)), to_viewer);
    twin::LightSums sums{0, 0};
    for (const Light& light : scene.settings.lights) {
        const twin::Vec3f to_light = light.headlight ? to_viewer : narrow(light.direction);
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

double brightest_color(const PreparedScene& scene) {
    double light = 0;
    for (const Light& each : scene.settings.lights) light += each.intensity;
    double most = 0;
    for (const Object& object : scene.objects) {
        const Shading& s = object.surface.shading;
        const Vec3& c = object.surface.color;
        const double color = object.geometry->has_color() ? 1 : std::max({c.x, c.y, c.z});
        most = std::max(most, s.flat ? color : color * (s.ambient + s.diffuse * light) + s.specular * light);
    }
    return most;
}

}  // namespace pellucid
