// A scene with its files read and its camera placed: what every method starts from.
#pragma once

#include <memory>
#include <vector>

#include "scene/camera.hpp"
#include "scene/geometry.hpp"
#include "scene/scene.hpp"
#include "scene/volume_object.hpp"

namespace pellucid {

struct Object {
    Surface surface;
    std::shared_ptr<const SurfaceGeometry> geometry;
    Affine to_object;  // inverse of surface.to_world

    /// Whether the surface's bounds are part of its geometry: to ask again would cut by rounding.
    [[nodiscard]] bool bounds_are_geometry() const {
        return std::holds_alternative<ImplicitShape>(surface.shape) ||
               std::holds_alternative<ExpressionShape>(surface.shape);
    }
    /// False where a clip plane or the surface's bounds cut the point away.
    [[nodiscard]] bool keeps(const Vec3& world) const;
    /// Opacity of one crossing under angle θ by the surface's law; `cos_theta` = |cosθ| in (0, 1].
    ///   share  of the surface's own opacity, at this place: SurfaceGeometry::opacity_at
    [[nodiscard]] double opacity(double cos_theta, double share = 1) const;
    /// −ln(1 − opacity(cos_theta)), with the straight-on opacity taken as at most `most_opacity` < 1.
    [[nodiscard]] double optical_depth(double cos_theta, double most_opacity, double share = 1) const;
};

struct PreparedScene {
    Scene settings;
    std::vector<Object> objects;        // surfaces, …
    std::vector<VolumeObject> volumes;  // … and objects.size() + i is the number of volume i among all
    Camera camera;

    [[nodiscard]] std::size_t object_count() const { return objects.size() + volumes.size(); }
    [[nodiscard]] std::size_t bytes() const;
};

/// Reads what the scene names. Throws Error(input) naming the object that cannot be drawn or read.
[[nodiscard]] PreparedScene prepare(const Scene& scene, std::optional<PixelRect> crop = std::nullopt);

}  // namespace pellucid
