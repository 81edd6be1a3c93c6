#include "sample/triangle_throws.hpp"

#include <cmath>

namespace pellucid {
namespace {

using Triple = std::array<double, 3>;

constexpr double kNormalScale = 0x1p20 - 1;

[[nodiscard]] Triple in_doubles(const std::array<float, 3>& v) { return {v[0], v[1], v[2]}; }

[[nodiscard]] std::uint64_t packed(const Vec3& normal) {
    std::uint64_t bits = 0;
    for (int axis = 2; axis >= 0; --axis)
        bits = bits << 21U | static_cast<std::uint64_t>(std::llround(normal[axis] * kNormalScale) + (1 << 20));
    return bits;
}
[[nodiscard]] Triple unpacked(std::uint64_t bits) {
    Triple normal;
    for (double& each : normal) {
        each = static_cast<double>(static_cast<std::int64_t>(bits & 0x1fffffU) - (1 << 20));
        bits >>= 21U;
    }
    return normal;
}

}  // namespace

TriangleRecord::TriangleRecord(const LineView& view, const std::array<Vec3, 3>& corners,
                               const std::array<Vec3, 3>& normals, double the_bound)
    : bound(static_cast<float>(the_bound)) {
    const Vec3 near(0, 0, view.near);
    for (std::size_t k = 0; k < 3; ++k) {
        const auto axis = static_cast<int>(k);
        corner[k] = static_cast<float>(corners[0][axis] - near[axis]);
        for (std::size_t e = 0; e < 2; ++e) edge[e][k] = static_cast<float>(corners[e + 1][axis] - corners[0][axis]);
        normal[k] = packed(normals[k]);
    }
}

bool throw_triangle(const TriangleBlock& block, const std::array<std::uint32_t, 4>& bits, SourcePoint& out) {
    const LineView& view = *block.view;
    const std::uint32_t side = bits[0] << static_cast<unsigned>(32 - block.table->shift());
    const TriangleRecord& record = block.records[block.table->pick(bits[0], side)];
    double u = unit_interval(bits[1]);
    double v = unit_interval(bits[2]);
    if (u + v > 1) {
        u = 1 - u;
        v = 1 - v;
    }
    const Triple p = in_doubles(record.corner);
    const Triple e = in_doubles(record.edge[0]);
    const Triple f = in_doubles(record.edge[1]);
    Triple at;
    for (std::size_t k = 0; k < 3; ++k) at[k] = p[k] + u * e[k] + v * f[k];
    at[2] += view.near;
    const double depth = view.perspective ? at[2] : 1;
    if (!(at[2] >= view.near && at[2] <= view.far && at[0] >= view.x_lo * depth && at[0] < view.x_hi * depth &&
          at[1] >= view.y_lo * depth && at[1] < view.y_hi * depth))
        return false;
    if (view.perspective) {
        const double z = at[2] * view.depth_scale;
        const double paid = unit_interval(bits[3]) * (z * z * z);
        double most = static_cast<double>(record.bound);
        if (!view.constant_law)
            most = most * std::sqrt((at[0] * at[0] + at[1] * at[1] + at[2] * at[2]) * (view.depth_scale * view.depth_scale));
        if (!(paid < most)) return false;
    }
    const Triple n0 = unpacked(record.normal[0]);
    const Triple n1 = unpacked(record.normal[1]);
    const Triple n2 = unpacked(record.normal[2]);
    const double w = 1 - u - v;
    Triple n;
    for (std::size_t k = 0; k < 3; ++k) n[k] = w * n0[k] + u * n1[k] + v * n2[k];
    if (n[0] == 0 && n[1] == 0 && n[2] == 0)
        n = {e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]};
    out = {{at[0], at[1], at[2]}, {n[0], n[1], n[2]}};
    return true;
}

}  // namespace pellucid
