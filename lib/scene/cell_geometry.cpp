#include "scene/cell_geometry.hpp"

#include <algorithm>
#include <cmath>

#include "core/box_corners.hpp"

namespace pellucid {
namespace {

class CellGeometry final : public SurfaceGeometry {
public:
    CellGeometry(CellSurface surface, const Affine& to_world)
        : surface_(std::move(surface)),
          to_world_(to_world),
          to_object_(to_world.inverse()),
          center_(surface_.bounds.center()) {
        for (std::size_t i = 0; i < patch_count(); ++i) bounds_.include(bounds_of(to_world, surface_.cells->box(i)));
    }

    [[nodiscard]] std::size_t patch_count() const override { return surface_.cells->count(); }
    [[nodiscard]] int max_crossings() const override { return surface_.max_crossings; }
    [[nodiscard]] Body body(std::size_t patch) const override {
        return body_of(surface_.cells->cell(patch).tight, to_world_);
    }
    int crossings(std::size_t patch, const Line& line, CrossingList& out) const override {
        out.hits.clear();
        // Affine maps keep t. From the place nearest to the middle, which one rounding finds: however far away
        // the line starts, the numbers below are as small as the surface.
        const Vec3 origin = to_object_.point(line.origin);
        const Vec3 direction = to_object_.vector(line.direction);
        const double middle = dot(center_ - origin, direction) / dot(direction, direction);
        Vec3 near;
        for (int axis = 0; axis < 3; ++axis) near[axis] = std::fma(middle, direction[axis], origin[axis]);
        thread_local std::vector<FieldRoot> roots;
        roots.clear();
        surface_.cells->cross(patch, near, direction, line.t_lo - middle, line.t_hi - middle, roots, out.stats);
        for (const FieldRoot& root : roots) {
            // Only its direction counts, and its square must be a number.
            const Vec3 size = glm::abs(root.gradient);
            const double largest = std::max({size.x, size.y, size.z});
            const Vec3 normal = to_world_.normal(largest > 0 ? root.gradient / largest : root.gradient);
            const bool usable = dot(normal, normal) > 0 && dot(normal, normal) < kInfinity;
            out.hits.push_back({middle + root.t, usable ? normal : -line.direction});
        }
        return static_cast<int>(out.hits.size());
    }

    [[nodiscard]] std::optional<FieldPatches> field() const override {
        return FieldPatches{surface_.cells.get(), to_world_};
    }
    [[nodiscard]] std::optional<FieldSurface> field_surface() const override {
        return FieldSurface{surface_.field.get(), surface_.bounds, to_world_, surface_.cell_width};
    }
    [[nodiscard]] Box bounds() const override { return bounds_; }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this) + surface_.bytes; }

private:
    CellSurface surface_;
    Affine to_world_, to_object_;
    Vec3 center_;  // of the surface, about; object space
    Box bounds_;   // of what is there, world
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_cell_geometry(CellSurface surface, const Affine& to_world) {
    return std::make_unique<CellGeometry>(std::move(surface), to_world);
}

}  // namespace pellucid
