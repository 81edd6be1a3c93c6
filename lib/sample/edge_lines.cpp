#include "sample/edge_lines.hpp"

#include <algorithm>
#include <cmath>

namespace pellucid {
namespace {

using Triple = std::array<double, 3>;

[[nodiscard]] double lerp(double a, double b, double t) { return a + t * (b - a); }
[[nodiscard]] double dot3(const Triple& a, const Triple& b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

[[nodiscard]] bool in_view(const LineView& view, const Triple& at) {
    const double depth = view.perspective ? at[2] : 1;
    return at[2] >= view.near && at[2] <= view.far && at[0] >= view.x_lo * depth &&
           at[0] < view.x_hi * depth && at[1] >= view.y_lo * depth && at[1] < view.y_hi * depth;
}

/// The cube of the scaled depth, and the square of the scaled distance: 1 where all depths are alike.
[[nodiscard]] double depth_cubed(const LineView& view, const Triple& at) {
    const double z = at[2] * view.depth_scale;
    return view.perspective ? z * z * z : 1;
}
[[nodiscard]] double distance_squared(const LineView& view, const Triple& at) {
    return view.perspective ? dot3(at, at) * (view.depth_scale * view.depth_scale) : 1;
}

}  // namespace

bool keep_crossing(const LineView& view, const Triple& x, const Triple& g, const Triple& reach, double bound,
                   double chance, LinePoint& out) {
    for (std::size_t k = 0; k < 3; ++k) {
        const auto& m = view.to_view[k];
        out.view[k] = m[0] * x[0] + m[1] * x[1] + m[2] * x[2] + m[3];
        out.normal[k] = dot3(view.normal[k], g);
    }
    out.place = x;
    if (!in_view(view, out.view)) return false;
    const double sum = reach[0] * std::abs(g[0]) + reach[1] * std::abs(g[1]) + reach[2] * std::abs(g[2]);
    const double paid = chance * (depth_cubed(view, out.view) * sum);
    if (view.constant_law) {
        Triple rho = view.eye;
        if (view.perspective)
            for (std::size_t k = 0; k < 3; ++k) rho[k] = x[k] - view.eye[k];
        return paid < bound * std::abs(dot3(g, rho));
    }
    return paid < bound * std::sqrt(dot3(out.normal, out.normal) * distance_squared(view, out.view));
}

LineView::LineView(const Camera& camera, const Affine& to_world, bool constant)
    : perspective(camera.perspective()), constant_law(constant), near(camera.near()), far(camera.far()) {
    depth_scale = perspective ? 1 / far : 1;
    x_lo = -camera.center().x * camera.pixel_size();
    y_lo = -camera.center().y * camera.pixel_size();
    x_hi = (camera.width() - camera.center().x) * camera.pixel_size();
    y_hi = (camera.height() - camera.center().y) * camera.pixel_size();

    const auto& linear = to_world.linear;
    const double sign = to_world.determinant() < 0 ? -1 : 1;
    const Vec3 offset = camera.view_vector(to_world.offset - camera.eye());
    double largest = 0;
    for (int a = 0; a < 3; ++a) {
        const Vec3 column = camera.view_vector(linear[a]);
        const Vec3 cofactor = camera.view_vector(sign * cross(linear[(a + 1) % 3], linear[(a + 2) % 3]));
        largest = std::max(largest, length(cofactor));
        for (int k = 0; k < 3; ++k) {
            to_view[static_cast<std::size_t>(k)][static_cast<std::size_t>(a)] = column[k];
            normal[static_cast<std::size_t>(k)][static_cast<std::size_t>(a)] = cofactor[k];
            to_view[static_cast<std::size_t>(k)][3] = offset[k];
        }
    }
    for (auto& row : normal)
        for (double& value : row) value /= largest;
    const Affine to_object = to_world.inverse();
    const Vec3 from = perspective ? to_object.point(camera.eye()) : to_object.vector(camera.forward());
    for (std::size_t a = 0; a < 3; ++a) {
        camera_place[a] = camera.eye()[static_cast<int>(a)];
        eye[a] = from[static_cast<int>(a)];
        reach[a] = constant ? std::abs(eye[a])
                            : std::sqrt(normal[0][a] * normal[0][a] + normal[1][a] * normal[1][a] +
                                        normal[2][a] * normal[2][a]);
    }
}

bool cross_box(const LineView& view, const BoxLines& lines, int label, double u, double v, double chance,
               LinePoint& out) {
    const auto a = static_cast<std::size_t>(lines.axis);
    const std::size_t b = (a + 1) % 3;
    const std::size_t c = (a + 2) % 3;
    Triple x;
    x[b] = lines.lo[b] + u * lines.size[b];
    x[c] = lines.lo[c] + v * lines.size[c];

    double square = 0;  // of the root
    double rho = 0;     // of a torus: distance from its axis
    double beyond = 0;  // rho − major
    switch (lines.kind) {
        case BoxLines::Kind::plane:
        case BoxLines::Kind::quadric:
            square = ((lines.square[b] * x[b] + lines.linear[b]) * x[b] +
                      (lines.square[c] * x[c] + lines.linear[c]) * x[c] + lines.constant) *
                     lines.inverse;
            break;
        case BoxLines::Kind::torus_along:  // z² = r² − (ρ − R)²
            rho = std::sqrt(x[b] * x[b] + x[c] * x[c]);
            beyond = rho - lines.major;
            square = (lines.minor - beyond) * (lines.minor + beyond);
            break;
        case BoxLines::Kind::torus_across: {  // x² = (R ± √(r² − z²))² − y²
            const double z = a == 0 ? x[c] : x[b];
            const double y = a == 0 ? x[b] : x[c];
            const double ring = std::sqrt((lines.minor - z) * (lines.minor + z));
            const bool inner = lines.both_rings ? (lines.both_signs ? label >> 1 : label) != 0 : lines.inner;
            beyond = inner ? -ring : ring;
            rho = lines.major + beyond;
            if (!(rho >= 0)) return false;
            square = (rho - y) * (rho + y);
            break;
        }
    }
    double root = square;
    if (lines.kind != BoxLines::Kind::plane) {
        if (!(square > 0)) return false;
        const bool negative = lines.both_signs ? (label & 1) != 0 : lines.negative;
        root = std::sqrt(square);
        if (negative) root = -root;
    }
    if (!(root >= lines.root_lo && root < lines.root_hi)) return false;
    x[a] = root;

    Triple g;
    if (lines.kind == BoxLines::Kind::plane || lines.kind == BoxLines::Kind::quadric) {
        for (std::size_t k = 0; k < 3; ++k) g[k] = 2 * lines.square[k] * x[k] + lines.linear[k];
    } else {
        g = {x[0] * beyond, x[1] * beyond, x[2] * rho};  // the gradient times ρ/2
    }
    return keep_crossing(view, x, g, lines.reach, lines.bound, chance, out);
}

bool cross_cell(const LineView& view, const CellRecord& cell, double isovalue, int axis, double u, double v,
                double chance, LinePoint& out) {
    const auto a = static_cast<std::size_t>(axis);
    const std::size_t b = (a + 1) % 3;
    const std::size_t c = (a + 2) % 3;
    const auto f = [&](std::size_t corner) { return static_cast<double>(cell.corner[corner]) - isovalue; };
    const std::size_t eb = std::size_t{1} << b;
    const std::size_t ec = std::size_t{1} << c;
    const std::size_t ea = std::size_t{1} << a;
    const double l00 = f(0), l10 = f(eb), l01 = f(ec), l11 = f(eb | ec);
    const double h00 = f(ea), h10 = f(ea | eb), h01 = f(ea | ec), h11 = f(ea | eb | ec);
    const double f0 = lerp(lerp(l00, l10, u), lerp(l01, l11, u), v);
    const double f1 = lerp(lerp(h00, h10, u), lerp(h01, h11, u), v);
    if ((f0 >= 0) == (f1 >= 0)) return false;
    const double t = f0 / (f0 - f1);
    const double m00 = lerp(l00, h00, t), m10 = lerp(l10, h10, t), m01 = lerp(l01, h01, t),
                 m11 = lerp(l11, h11, t);
    Triple x, g;
    const Triple base{static_cast<double>(cell.base[0]), static_cast<double>(cell.base[1]),
                      static_cast<double>(cell.base[2])};
    x[a] = base[a] + t;
    x[b] = base[b] + u;
    x[c] = base[c] + v;
    g[a] = f1 - f0;
    g[b] = lerp(m10 - m00, m11 - m01, v);
    g[c] = lerp(m01 - m00, m11 - m10, u);
    Triple reach = view.reach;
    if (view.perspective && view.constant_law)
        for (std::size_t k = 0; k < 3; ++k)
            reach[k] = std::max(std::abs(base[k] - view.eye[k]), std::abs(base[k] + 1 - view.eye[k]));
    return keep_crossing(view, x, g, reach, cell.bound, chance, out);
}

bool throw_flat(const LineView& view, const FlatBlock& block, std::uint32_t piece, double u, double v,
                double chance, LinePoint& out) {
    if (block.fold && u + v > 1) {
        u = 1 - u;
        v = 1 - v;
    }
    const FlatPiece& flat = block.pieces[piece];
    const double* p[3];
    for (std::size_t i = 0; i < 3; ++i)
        p[i] = block.positions + std::size_t{3} * block.triangles[3 * flat.triangle + i];
    Triple x;
    for (std::size_t k = 0; k < 3; ++k)
        x[k] = p[0][k] + u * (p[1][k] - p[0][k]) + v * (p[2][k] - p[0][k]) - view.camera_place[k];
    for (std::size_t k = 0; k < 3; ++k)
        out.view[k] = dot3({view.to_view[k][0], view.to_view[k][1], view.to_view[k][2]}, x);
    out.place = {u, v, 0};
    if (!in_view(view, out.view)) return false;
    if (!view.perspective) return true;
    const double paid = chance * depth_cubed(view, out.view);
    return paid < (view.constant_law ? flat.bound : flat.bound * std::sqrt(distance_squared(view, out.view)));
}

}  // namespace pellucid
