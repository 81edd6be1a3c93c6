#include "scene/cell_crossings.hpp"

#include <algorithm>
#include <cmath>

namespace pellucid {

Body PlacedCells::body(const Box& box) const {
    const Vec3 size = box.size();
    return {Body::Kind::parallelepiped,
            to_world.point(box.lo),
            {size.x * to_world.linear[0], size.y * to_world.linear[1], size.z * to_world.linear[2]}};
}

int PlacedCells::crossings(std::size_t cell, const Line& line, CrossingList& out) const {
    out.hits.clear();
    // Affine maps keep t. From the place nearest to the middle, which one rounding finds: however far away
    // the line starts, the numbers below are as small as the surface.
    const Vec3 origin = to_object.point(line.origin);
    const Vec3 direction = to_object.vector(line.direction);
    const double middle = dot(center - origin, direction) / dot(direction, direction);
    Vec3 near;
    for (int axis = 0; axis < 3; ++axis) near[axis] = std::fma(middle, direction[axis], origin[axis]);
    thread_local std::vector<FieldRoot> roots;
    roots.clear();
    cells->cross(cell, near, direction, line.t_lo - middle, line.t_hi - middle, roots, out.stats);
    for (const FieldRoot& root : roots) {
        // Only its direction counts, and its square must be a number.
        const Vec3 size = glm::abs(root.gradient);
        const double largest = std::max({size.x, size.y, size.z});
        const Vec3 normal = to_world.normal(largest > 0 ? root.gradient / largest : root.gradient);
        const bool usable = dot(normal, normal) > 0 && dot(normal, normal) < kInfinity;
        out.hits.push_back({middle + root.t, usable ? normal : -line.direction});
    }
    return static_cast<int>(out.hits.size());
}

}  // namespace pellucid
