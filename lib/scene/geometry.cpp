#include "scene/geometry.hpp"

#include "scene/geometry_makers.hpp"

namespace pellucid {

int Body::vertices(std::span<Vec3, 8> out) const {
    switch (kind) {
        case Kind::triangle:
            out[0] = corner;
            out[1] = corner + edge[0];
            out[2] = corner + edge[1];
            return 3;
        case Kind::parallelogram:
            for (std::size_t i = 0; i < 4; ++i)
                out[i] =
                    corner + ((i & 1U) != 0 ? edge[0] : Vec3(0.0)) + ((i & 2U) != 0 ? edge[1] : Vec3(0.0));
            return 4;
        case Kind::parallelepiped: break;
    }
    for (std::size_t i = 0; i < 8; ++i)
        out[i] = corner + ((i & 1U) != 0 ? edge[0] : Vec3(0.0)) + ((i & 2U) != 0 ? edge[1] : Vec3(0.0)) +
                 ((i & 4U) != 0 ? edge[2] : Vec3(0.0));
    return 8;
}

Box Body::bounds() const {
    std::array<Vec3, 8> corners;
    const int count = vertices(corners);
    Box box;
    for (int i = 0; i < count; ++i) box.include(corners[static_cast<std::size_t>(i)]);
    return box;
}

Body body_of(const Box& box, const Affine& to_world) {
    const Vec3 size = box.size();
    return {Body::Kind::parallelepiped,
            to_world.point(box.lo),
            {size.x * to_world.linear[0], size.y * to_world.linear[1], size.z * to_world.linear[2]}};
}

double Body::crofton_area() const {
    const double first = length(cross(edge[0], edge[1]));
    if (kind == Kind::triangle) return 0.5 * first;
    if (kind == Kind::parallelogram) return first;
    return first + length(cross(edge[1], edge[2])) + length(cross(edge[2], edge[0]));
}

bool SurfaceGeometry::excludes(std::size_t, const Body&) const { return false; }

TrilinearCorners SurfaceGeometry::cell(std::size_t) const { return {}; }

Vec3 SurfaceGeometry::shading_normal(std::size_t, const Vec3&, const Vec3& geometric) const {
    return geometric;
}

Vec3 SurfaceGeometry::color(const Vec3&) const { return Vec3(0.0); }

bool has_geometry(const Shape& shape) {
    if (const auto* iso = std::get_if<IsosurfaceShape>(&shape))
        return iso->interpolation != Interpolation::nearest;
    return true;
}

std::unique_ptr<SurfaceGeometry> make_geometry(const Surface& surface) {
    const auto make = [&]() -> std::unique_ptr<SurfaceGeometry> {
        if (!has_geometry(surface.shape)) throw input_error("shapes of this kind have no geometry yet");
        if (const auto* shape = std::get_if<ImplicitShape>(&surface.shape))
            return make_implicit(surface, *shape);
        if (const auto* shape = std::get_if<ExpressionShape>(&surface.shape))
            return make_expression(surface, *shape);
        if (const auto* shape = std::get_if<MeshShape>(&surface.shape)) return make_mesh(surface, *shape);
        if (const auto* shape = std::get_if<RectangleShape>(&surface.shape))
            return make_rectangle(surface, *shape);
        if (const auto* shape = std::get_if<IsosurfaceShape>(&surface.shape))
            return make_isosurface(surface, *shape);
        if (const auto* shape = std::get_if<PointsShape>(&surface.shape)) return make_points(surface, *shape);
        if (const auto* shape = std::get_if<SliceShape>(&surface.shape)) return make_slice(surface, *shape);
        return nullptr;  // not reached
    };
    try {
        auto geometry = make();
        if (geometry->patch_count() == 0) warn("surface \"{}\": nothing of it is left to draw", surface.name);
        return geometry;
    } catch (const Error& error) {
        throw Error(error.kind(), fmt::format("surface \"{}\": {}", surface.name, error.what()));
    }
}

}  // namespace pellucid
