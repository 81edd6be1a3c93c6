// The camera as both renderers use it: pixels to rays, points to pixels, and the area a pixel sees.
//
// View space: x right, y *down* (rows grow downwards), z along the view axis; right-handed. A ray's
// parameter t is the distance along the view axis, for both projections.
#pragma once

#include <optional>

#include "core/vec.hpp"
#include "scene/scene.hpp"

namespace pellucid {

struct Ray {
    Vec3 origin;
    Vec3 direction;  // dot(direction, forward) = 1
};

/// Pixels x0 <= x < x1, y0 <= y < y1 of an image.
struct PixelRect {
    int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
};

class Camera {
public:
    /// `visible` bounds all objects in world coordinates; near and far come from it when the
    /// settings give none: near = its nearest depth, but at least 1e-9 of the length of its diagonal
    /// in a perspective view, whatever the settings give; far = at most its farthest depth.
    /// With `crop` the camera sees that part of the image only: its pixel (0, 0) is (x0, y0) there.
    Camera(const CameraSettings& settings, const ImageSettings& image, const Box& visible,
           std::optional<PixelRect> crop = std::nullopt);

    [[nodiscard]] bool perspective() const { return perspective_; }
    [[nodiscard]] int width() const { return width_; }
    [[nodiscard]] int height() const { return height_; }
    [[nodiscard]] const PixelRect& crop() const { return crop_; }
    /// Image position of the view axis, in pixels of the crop.
    [[nodiscard]] const Vec2& center() const { return center_; }
    [[nodiscard]] double near() const { return near_; }
    [[nodiscard]] double far() const { return far_; }
    [[nodiscard]] const Vec3& eye() const { return eye_; }
    [[nodiscard]] const Vec3& forward() const { return axes_[2]; }
    /// Side of a pixel: in scene units (orthographic), or at distance 1 along the axis (perspective).
    [[nodiscard]] double pixel_size() const { return pixel_size_; }

    [[nodiscard]] Vec3 to_view(const Vec3& world) const { return view_vector(world - eye_); }
    [[nodiscard]] Vec3 view_vector(const Vec3& v) const { return {dot(axes_[0], v), dot(axes_[1], v), dot(axes_[2], v)}; }
    [[nodiscard]] Vec3 to_world(const Vec3& view) const { return eye_ + world_vector(view); }
    [[nodiscard]] Vec3 world_vector(const Vec3& v) const { return v.x * axes_[0] + v.y * axes_[1] + v.z * axes_[2]; }
    /// Ray through image position (x, y), in pixels from the top left corner; centres at ½.
    [[nodiscard]] Ray ray(double x, double y) const;
    /// Image position of a point in view space. Precondition: view.z > 0 for perspective.
    [[nodiscard]] Vec2 project(const Vec3& view) const;
    /// The ray of the camera through a world point; not normalised.
    [[nodiscard]] Vec3 ray_direction(const Vec3& world) const { return perspective_ ? world - eye_ : axes_[2]; }

    /// s: area across the ray that one pixel sees at a point in view space:
    /// orthographic (h/res_y)²; perspective (2 z tan(fov/2)/res_y)²·cosβ, β between ray and axis.
    [[nodiscard]] double pixel_area(const Vec3& view) const;

    /// Bounds of pixel_area over the part of a convex body that is in view.
    struct AreaRange {
        double least;
        double most;
    };
    /// Empty where the convex hull of the points (world) is surely out of view.
    [[nodiscard]] std::optional<AreaRange> pixel_area_range(const Vec3* points, int count) const;
    /// True where all points are in view.
    [[nodiscard]] bool wholly_in_view(const Vec3* points, int count) const;

private:
    [[nodiscard]] int outside_mask(const Vec3& view) const;

    bool perspective_;
    int width_, height_;
    PixelRect crop_;
    Vec2 center_;
    Vec3 eye_;
    Vec3 axes_[3];
    double pixel_size_;
    double corner_cos_;  // cosβ at the corner farthest from the axis
    double near_, far_;
};

}  // namespace pellucid
