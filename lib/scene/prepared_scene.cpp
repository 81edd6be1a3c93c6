#include "scene/prepared_scene.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"

namespace pellucid {

bool Object::keeps(const Vec3& world) const {
    for (const ClipPlane& plane : surface.clip)
        if (dot(plane.normal, world) > plane.offset) return false;
    if (surface.bounds && !bounds_are_geometry()) {
        const Vec3 p = to_object.point(world);
        for (int axis = 0; axis < 3; ++axis)
            if (p[axis] < surface.bounds->lo[axis] || p[axis] > surface.bounds->hi[axis]) return false;
    }
    return true;
}

double Object::opacity(double cos_theta) const {
    if (surface.opacity_law == OpacityLaw::constant || surface.opacity == 1) return surface.opacity;
    return -std::expm1(std::log1p(-surface.opacity) / cos_theta);
}

double Object::optical_depth(double cos_theta, double most_opacity) const {
    const double straight_on = -std::log1p(-std::min(surface.opacity, most_opacity));
    return surface.opacity_law == OpacityLaw::oblique ? straight_on / cos_theta : straight_on;
}

std::size_t PreparedScene::bytes() const {
    std::size_t sum = 0;
    for (const Object& object : objects) sum += object.geometry->bytes();
    return sum;
}

namespace {

/// Warns of what is in front of the eye, and yet before the least near plane that the scene's size allows.
void warn_of_cut_objects(const Scene& scene, const std::vector<Object>& objects, const Camera& camera) {
    for (const Object& object : objects) {
        if (object.geometry->patch_count() == 0) continue;
        const Box box = object.geometry->bounds();
        double nearest = kInfinity;
        for (int i = 0; i < 8; ++i) {
            const Vec3 corner((i & 1) != 0 ? box.hi.x : box.lo.x, (i & 2) != 0 ? box.hi.y : box.lo.y,
                              (i & 4) != 0 ? box.hi.z : box.lo.z);
            nearest = std::min(nearest, camera.to_view(corner).z);
        }
        if (nearest > std::max(0.0, scene.camera.near.value_or(0)) && nearest < camera.near())
            warn("surface \"{}\": cut off nearer than {:.3g}: 1e-9 of the scene's size is the least near",
                 object.surface.name, camera.near());
    }
}

}  // namespace

PreparedScene prepare(const Scene& scene, std::optional<PixelRect> crop) {
    std::vector<Object> objects;
    Box visible;
    for (const Surface& surface : scene.surfaces) {
        objects.push_back({surface, make_geometry(surface), surface.to_world.inverse()});
        if (objects.back().geometry->patch_count() > 0) visible.include(objects.back().geometry->bounds());
        // Squares of lengths must stay within doubles.
        const Box& box = visible;
        const double reach = box.empty() ? 1 : std::max(length(box.size()), length(box.center()));
        if (!(reach < 1e100 && (box.empty() || length(box.size()) > 1e-100)))
            throw input_error("{}: surface \"{}\" makes the scene {:.3g} large, expected 1e-100 to 1e100", scene.source,
                              surface.name, length(box.size()));
    }
    const Camera camera(scene.camera, scene.image, visible, crop);
    warn_of_cut_objects(scene, objects, camera);
    return {scene, std::move(objects), camera};
}

}  // namespace pellucid
