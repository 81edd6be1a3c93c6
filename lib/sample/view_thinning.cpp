#include "sample/view_thinning.hpp"

#include <algorithm>
#include <cmath>

#include "core/box_corners.hpp"

namespace pellucid {
namespace {

/// Boxes are cut until the area that a pixel sees varies less on them, or so often.
constexpr double kEvenEnough = 1.1;
constexpr int kMostCuts = 12;

/// Least s over the parts of a box that may hold a part of the surface in view.
void find_least(const FieldSurface& surface, const Box& box, const Camera& camera, int depth, double& least) {
    const auto range = camera.pixel_area_range(corners_of(surface.to_world, box).data(), 8);
    if (!range || range->least >= least || surface.field->excludes(box)) return;
    if (depth == kMostCuts || range->most <= kEvenEnough * range->least) {
        least = range->least;
        return;
    }
    // In two along the edge that is longest in the world.
    int axis = 0;
    double longest = 0;
    for (int k = 0; k < 3; ++k)
        if (const double size = box.size()[k] * length(surface.to_world.linear[k]); size > longest) {
            longest = size;
            axis = k;
        }
    Box parts[2] = {box, box};
    parts[0].hi[axis] = parts[1].lo[axis] = box.lo[axis] + 0.5 * box.size()[axis];
    for (const Box& part : parts) find_least(surface, part, camera, depth + 1, least);
}

}  // namespace

ViewThinning::ViewThinning(const Object& object, const Camera& camera)
    : object_(&object), camera_(&camera), clipped_(!object.surface.clip.empty() || object.surface.bounds) {
    if (object.geometry->patch_count() == 0) return;
    double least = kInfinity;
    if (const auto surface = object.geometry->field_surface()) {
        find_least(*surface, surface->bounds, camera, 0, least);
    } else {
        const auto corners = corners_of(object.geometry->bounds());
        if (const auto range = camera.pixel_area_range(corners.data(), 8)) least = range->least;
    }
    // A hair less: what lies in a face of its box is not beyond it by rounding.
    if (least < kInfinity) least_ = least * (1 - 1e-9);
}

std::optional<SourcePoint> ViewThinning::keep(const Vec3& world, const Vec3& normal, double chance) const {
    const Vec3 view = camera_->to_view(world);
    if (!least_ || !(view.z >= camera_->near() && view.z <= camera_->far())) return std::nullopt;
    const double paid = chance * camera_->pixel_area(view);
    if (object_->surface.opacity_law == OpacityLaw::constant) {
        const Vec3 ray = camera_->ray_direction(world);
        const double size = std::sqrt(dot(normal, normal) * dot(ray, ray));
        if (!(paid * size < *least_ * std::abs(dot(normal, ray)))) return std::nullopt;
    } else if (!(paid < *least_)) {
        return std::nullopt;
    }
    const Vec2 pixel = camera_->project(view);
    if (!(pixel.x >= 0 && pixel.x < camera_->width() && pixel.y >= 0 && pixel.y < camera_->height())) return std::nullopt;
    if (clipped_ && !object_->keeps(world)) return std::nullopt;
    return SourcePoint{view, camera_->view_vector(normal)};
}

}  // namespace pellucid
