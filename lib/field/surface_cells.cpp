#include "field/surface_cells.hpp"

#include <limits>

namespace pellucid {

void SurfaceCells::cross_along(const AxisLines& lines, const AxisRoots& out) const {
    thread_local std::vector<FieldRoot> roots;
    IsolationStats stats;  // monotone: nothing to doubt
    const std::size_t a = lines.axis;
    Vec3 along(0.0);
    along[static_cast<int>(a)] = 1;
    for (std::size_t i = 0; i < lines.count; ++i) {
        Vec3 origin(0.0);
        for (std::size_t axis = 0; axis < 3; ++axis)
            if (axis != a) origin[static_cast<int>(axis)] = lines.at[axis][i];
        roots.clear();
        cross(lines.cell[i], origin, along, lines.lo[i], lines.hi[i], roots, stats);
        out.root[i] = roots.empty() ? std::numeric_limits<double>::quiet_NaN() : roots[0].t;
        for (std::size_t axis = 0; axis < 3; ++axis)
            out.gradient[axis][i] = roots.empty() ? 0 : roots[0].gradient[static_cast<int>(axis)];
    }
}

}  // namespace pellucid
