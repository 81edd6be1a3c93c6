#include "stage/virtual_slab.hpp"

#include <algorithm>
#include <cmath>

namespace pellucid {
namespace {

/// Axes of one sample have no neighbours.
void take_least(const Affine& index_to_world, const Vec3& hull, double& least) {
    for (int axis = 0; axis < 3; ++axis)
        if (hull[axis] > 0) least = std::min(least, length(index_to_world.linear[axis]));
}

}  // namespace

std::optional<double> smallest_voxel_pitch(const PreparedScene& scene) {
    double least = kInfinity;
    for (const VolumeObject& volume : scene.volumes) take_least(volume.to_world(), volume.field().hull().hi, least);
    for (const Object& object : scene.objects) {
        if (!std::holds_alternative<IsosurfaceShape>(object.surface.shape)) continue;
        if (const auto surface = object.geometry->field_surface())
            take_least(surface->to_world, surface->bounds.hi, least);
    }
    return least < kInfinity ? std::optional(least) : std::nullopt;
}

std::optional<double> fixed_thickness(const PreparedScene& scene, const Object& object) {
    return object.surface.thickness ? object.surface.thickness : smallest_voxel_pitch(scene);
}

double pixel_thickness(const Camera& camera, const Vec3& view, const Vec3& normal) {
    const double side = camera.pixel_size() * (camera.perspective() ? view.z : 1);
    const Vec3 ray = camera.perspective() ? view : Vec3(0, 0, 1);
    const double stretch = length(normal) * length(ray) / std::abs(dot(normal, ray));
    return 0.5 * side * (stretch < kMostStretch ? stretch : kMostStretch);
}

}  // namespace pellucid
