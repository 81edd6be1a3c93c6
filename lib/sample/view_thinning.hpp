// From places uniform in world area to the particles of one view: trials that land on dA with probability
// w dA/(s(x)·V) (particle_source.hpp), V = A/least s, by keeping a place with probability w·(least s)/s(x).
#pragma once

#include <optional>

#include "sample/particle_source.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

class ViewThinning {
public:
    /// Object and camera must outlive it.
    ViewThinning(const Object& object, const Camera& camera);

    /// Least area that a pixel sees of the surface: of boxes that may hold a part of it. Empty where none is in view.
    [[nodiscard]] std::optional<double> least_pixel_area() const { return least_; }
    /// The particle, if it is in view, not cut away, and kept. `chance` in (0, 1).
    [[nodiscard]] std::optional<SourcePoint> keep(const Vec3& world, const Vec3& normal, double chance) const;

private:
    const Object* object_;
    const Camera* camera_;
    std::optional<double> least_;
    bool clipped_;
};

}  // namespace pellucid
