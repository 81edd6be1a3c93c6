#include "scene/camera.hpp"

#include <algorithm>
#include <cmath>

#include "core/box_corners.hpp"
#include "core/error.hpp"

namespace pellucid {

Camera::Camera(const CameraSettings& settings, const ImageSettings& image, const Box& visible,
               std::optional<PixelRect> crop)
    : perspective_(settings.projection == Projection::perspective),
      crop_(crop.value_or(PixelRect{0, 0, image.width, image.height})),
      eye_(settings.position) {
    width_ = crop_.x1 - crop_.x0;
    height_ = crop_.y1 - crop_.y0;
    center_ = 0.5 * Vec2(image.width, image.height) - Vec2(crop_.x0, crop_.y0);
    axes_[2] = normalize(settings.target - settings.position);
    axes_[0] = normalize(cross(axes_[2], settings.up));
    axes_[1] = cross(axes_[2], axes_[0]);  // down

    constexpr double kHalfDegree = 3.14159265358979323846 / 360;
    const double image_height =
        perspective_ ? 2 * std::tan(settings.fov_degrees * kHalfDegree) : settings.view_height;
    pixel_size_ = image_height / image.height;
    const Vec2 corner = pixel_size_ * glm::max(glm::abs(center_), glm::abs(Vec2(width_, height_) - center_));
    corner_cos_ = perspective_ ? 1 / std::sqrt(1 + dot(corner, corner)) : 1;

    double nearest = kInfinity;
    double farthest = -kInfinity;
    if (!visible.empty()) {
        for (const Vec3& p : corners_of(visible)) {
            nearest = std::min(nearest, to_view(p).z);
            farthest = std::max(farthest, to_view(p).z);
        }
        // A hair of room, so that a plane that is its own bounding box is not cut by rounding.
        const double room = 1e-9 * (length(visible.size()) + std::abs(nearest) + std::abs(farthest));
        nearest = std::max(nearest - room, 1e-9 * length(visible.size()));
        farthest += room;
    } else {
        nearest = 0;
        farthest = 1;
    }
    // At near = 0 a pixel of a perspective view would see no area, and a particle density no bound.
    const double least_near = perspective_ && !visible.empty() ? 1e-9 * length(visible.size()) : 0;
    near_ = std::max(settings.near.value_or(nearest), least_near);
    // Beyond the scene is nothing to see, but float32 in units of a far of 1e38 loses what is near.
    far_ = std::max(std::min(settings.far.value_or(farthest), farthest), near_);
}

Ray Camera::ray(double x, double y) const {
    const double u = (x - center_.x) * pixel_size_;
    const double v = (y - center_.y) * pixel_size_;
    const Vec3 aside = u * axes_[0] + v * axes_[1];
    if (perspective_) return {eye_, axes_[2] + aside};
    return {eye_ + aside, axes_[2]};
}

Vec2 Camera::project(const Vec3& view) const {
    const double scale = 1 / (perspective_ ? pixel_size_ * view.z : pixel_size_);
    return center_ + scale * Vec2(view);
}

double Camera::pixel_area(const Vec3& view) const {
    if (!perspective_) return pixel_size_ * pixel_size_;
    const double side = pixel_size_ * view.z;
    return side * side * (view.z / length(view));
}

int Camera::outside_mask(const Vec3& view) const {
    const double depth = perspective_ ? view.z : 1;
    const Vec2 lo = -center_ * pixel_size_ * depth;
    const Vec2 hi = (Vec2(width_, height_) - center_) * pixel_size_ * depth;
    return (view.x < lo.x ? 1 : 0) | (view.x > hi.x ? 2 : 0) | (view.y < lo.y ? 4 : 0) | (view.y > hi.y ? 8 : 0) |
           (view.z < near_ ? 16 : 0) | (view.z > far_ ? 32 : 0);
}

std::optional<Camera::AreaRange> Camera::pixel_area_range(const Vec3* points, int count) const {
    int outside = ~0;
    double z_least = kInfinity;
    double z_most = -kInfinity;
    double cos_least = 1;
    for (int i = 0; i < count; ++i) {
        const Vec3 view = to_view(points[i]);
        outside &= outside_mask(view);
        z_least = std::min(z_least, view.z);
        z_most = std::max(z_most, view.z);
        cos_least = std::min(cos_least, view.z / length(view));
    }
    // A point behind the eye flips its side tests, but then it is outside of near as well; a body
    // on both sides of near is judged by the planes that pass through the eye, which stay valid.
    if (outside != 0) return std::nullopt;
    if (!perspective_) return AreaRange{pixel_size_ * pixel_size_, pixel_size_ * pixel_size_};
    z_least = std::max(z_least, near_);
    z_most = std::min(z_most, far_);
    // cosβ = z/|x| is quasi-concave in front of the eye: its least value is at a corner of the body.
    const double least_side = pixel_size_ * z_least;
    const double most_side = pixel_size_ * z_most;
    return AreaRange{least_side * least_side * std::max(cos_least, corner_cos_), most_side * most_side};
}

bool Camera::wholly_in_view(const Vec3* points, int count) const {
    for (int i = 0; i < count; ++i)
        if (outside_mask(to_view(points[i])) != 0) return false;
    return true;
}

}  // namespace pellucid
