// A parallelogram in the world: what rectangles and slices are.
#pragma once

#include <cmath>

#include "scene/geometry.hpp"

namespace pellucid {

/// center + a u + b v, |a|, |b| <= 1.
struct Parallelogram {
    Vec3 center, u, v;

    [[nodiscard]] Vec3 normal() const { return cross(u, v); }
    [[nodiscard]] Body body() const {
        return {Body::Kind::parallelogram, center - u - v, {2.0 * u, 2.0 * v, Vec3(0.0)}};
    }
    [[nodiscard]] Box bounds() const {
        Box box;
        for (const double a : {-1.0, 1.0})
            for (const double b : {-1.0, 1.0}) box.include(center + a * u + b * v);
        return box;
    }
    /// (a, b) of a point of the plane.
    [[nodiscard]] Vec2 coordinates(const Vec3& point) const {
        const Vec3 from = point - center;
        const Vec3 n = normal();
        const double area2 = dot(n, n);
        return {dot(cross(from, v), n) / area2, dot(cross(u, from), n) / area2};
    }
    /// SurfaceGeometry::crossings of the one patch.
    int crossings(const Line& line, CrossingList& out) const {
        out.hits.clear();
        const Vec3 n = normal();
        const double against = dot(n, line.direction);
        if (against == 0) return 0;
        const double t = dot(n, center - line.origin) / against;
        if (!(t >= line.t_lo && t <= line.t_hi)) return 0;
        const Vec2 place = coordinates(line.origin + t * line.direction);
        if (std::abs(place.x) > 1 || std::abs(place.y) > 1) return 0;
        out.hits.push_back({t, n});
        return 1;
    }
};

}  // namespace pellucid
