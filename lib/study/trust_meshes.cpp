#include "study/trust_meshes.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <numbers>
#include <utility>

#include <unistd.h>

#include "core/box_corners.hpp"
#include "core/error.hpp"

namespace pellucid {
namespace {

using Triangle = std::array<std::uint32_t, 3>;

std::uint32_t index(std::size_t i) {
    return static_cast<std::uint32_t>(i);
}

/// A quadrilateral, counter-clockwise, as two triangles.
void add_quad(TriangleMesh& mesh, std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
    mesh.triangles.push_back({a, b, c});
    mesh.triangles.push_back({a, c, d});
}

/// Box lo … hi.
void add_box(TriangleMesh& mesh, const Vec3& lo, const Vec3& hi) {
    const std::uint32_t first = index(mesh.positions.size());
    for (const Vec3& corner : corners_of({lo, hi})) mesh.positions.push_back(corner);
    const std::array<std::array<std::uint32_t, 4>, 6> faces{
        {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}}};
    for (const auto& f : faces) add_quad(mesh, first + f[0], first + f[1], first + f[2], first + f[3]);
}

}  // namespace

TriangleMesh icosphere(int levels) {
    TriangleMesh mesh;
    const double g = std::numbers::phi;
    for (const double a : {-1.0, 1.0})
        for (const double b : {-g, g}) {
            mesh.positions.emplace_back(a, b, 0);
            mesh.positions.emplace_back(0, a, b);
            mesh.positions.emplace_back(b, 0, a);
        }
    // Faces of the icosahedron: all triples of vertices at the least distance, 2, turned outwards.
    const auto near = [&](std::size_t i, std::size_t j) {
        return length(mesh.positions[i] - mesh.positions[j]) < 2.1;
    };
    for (std::size_t i = 0; i < 12; ++i)
        for (std::size_t j = i + 1; j < 12; ++j)
            for (std::size_t k = j + 1; k < 12; ++k) {
                if (!near(i, j) || !near(j, k) || !near(i, k)) continue;
                const auto& p = mesh.positions;
                const bool outwards = dot(cross(p[j] - p[i], p[k] - p[i]), p[i]) > 0;
                mesh.triangles.push_back(outwards ? Triangle{index(i), index(j), index(k)}
                                                  : Triangle{index(i), index(k), index(j)});
            }
    for (Vec3& p : mesh.positions) p = normalize(p);
    for (int level = 0; level < levels; ++level) {
        std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middle;
        const auto between = [&](std::uint32_t a, std::uint32_t b) {
            const auto [entry, is_new] = middle.try_emplace(std::minmax(a, b), index(mesh.positions.size()));
            if (is_new) {
                const Vec3 point = normalize(mesh.positions[a] + mesh.positions[b]);
                mesh.positions.push_back(point);
            }
            return entry->second;
        };
        std::vector<Triangle> finer;
        for (const auto& [a, b, c] : mesh.triangles) {
            const std::uint32_t ab = between(a, b);
            const std::uint32_t bc = between(b, c);
            const std::uint32_t ca = between(c, a);
            finer.insert(finer.end(), {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}});
        }
        mesh.triangles = std::move(finer);
    }
    return mesh;
}

TriangleMesh torus_grid(int around, int across) {
    TriangleMesh mesh;
    for (int i = 0; i < around; ++i)
        for (int j = 0; j < across; ++j) {
            const double u = 2 * std::numbers::pi * i / around;
            const double v = 2 * std::numbers::pi * j / across;
            const double r = 1 + 0.4 * std::cos(v);
            mesh.positions.emplace_back(r * std::cos(u), r * std::sin(u), 0.4 * std::sin(v));
        }
    const auto at = [&](int i, int j) {
        return static_cast<std::uint32_t>(i % around * across + j % across);
    };
    for (int i = 0; i < around; ++i)
        for (int j = 0; j < across; ++j)
            add_quad(mesh, at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
    return mesh;
}

TriangleMesh cube_mesh() {
    TriangleMesh mesh;
    add_box(mesh, Vec3(-1.0), Vec3(1.0));
    return mesh;
}

TriangleMesh sliver_prism(int sides, double width) {
    TriangleMesh mesh;
    const double radius = 0.5 * width / std::sin(std::numbers::pi / sides);
    for (const double z : {-1.0, 1.0})
        for (int i = 0; i < sides; ++i) {
            const double u = 2 * std::numbers::pi * i / sides;
            mesh.positions.emplace_back(radius * std::cos(u), radius * std::sin(u), z);
        }
    const auto at = [&](int i, int top) { return static_cast<std::uint32_t>(i % sides + top * sides); };
    for (int i = 0; i < sides; ++i) add_quad(mesh, at(i, 0), at(i + 1, 0), at(i + 1, 1), at(i, 1));
    for (int i = 1; i + 1 < sides; ++i) {
        mesh.triangles.push_back({at(0, 0), at(i + 1, 0), at(i, 0)});
        mesh.triangles.push_back({at(0, 1), at(i, 1), at(i + 1, 1)});
    }
    return mesh;
}

TriangleMesh thin_plates(int count, double gap) {
    TriangleMesh mesh;
    for (int i = 0; i < count; ++i) {
        const double z = (2 * i - count + 0.5) * gap;
        add_box(mesh, Vec3(-1, -1, z), Vec3(1, 1, z + gap));
    }
    return mesh;
}

bool is_closed(const TriangleMesh& mesh) {
    std::map<std::array<double, 3>, std::uint32_t> places;
    std::vector<std::uint32_t> place;
    for (const Vec3& p : mesh.positions)
        place.push_back(places.try_emplace({p.x, p.y, p.z}, index(places.size())).first->second);
    std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
    for (const Triangle& t : mesh.triangles)
        for (std::size_t i = 0; i < 3; ++i) {
            const std::uint32_t a = place[t[i]];
            const std::uint32_t b = place[t[(i + 1) % 3]];
            ++edges[{std::min(a, b), std::max(a, b)}];
        }
    return std::ranges::all_of(edges, [](const auto& edge) { return edge.second % 2 == 0; });
}

void write_off(const std::filesystem::path& file, const TriangleMesh& mesh) {
    std::ofstream out(file);
    out << fmt::format("OFF\n{} {} 0\n", mesh.positions.size(), mesh.triangles.size());
    for (const Vec3& p : mesh.positions) out << fmt::format("{:.9g} {:.9g} {:.9g}\n", p.x, p.y, p.z);
    for (const Triangle& t : mesh.triangles) out << fmt::format("3 {} {} {}\n", t[0], t[1], t[2]);
    out.close();
    if (!out) throw run_error("{}: cannot be written", file.string());
}

PreparedScene scene_for_lines(std::vector<Surface> surfaces) {
    Scene scene;
    scene.source = "lines";
    scene.image = {1, 1, Vec3(0.0)};
    scene.camera.projection = Projection::orthographic;
    scene.camera.target = {0, 0, 0};
    scene.camera.position = {0, 0, 1};
    scene.lights.push_back({.headlight = true});
    scene.surfaces = std::move(surfaces);
    // Prepared once to know where it is: the camera looks along the box's longest side.
    Box box;
    for (const Object& object : prepare(scene).objects) box.include(object.geometry->bounds());
    const Vec3 size = box.size();
    const int longest = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    Vec3 axis(0.0);
    axis[longest] = 1;
    scene.camera.target = box.center();
    scene.camera.position = box.center() + 2 * length(size) * axis;
    scene.camera.up = Vec3(0.0);
    scene.camera.up[(longest + 1) % 3] = 1;
    scene.camera.view_height = length(size);
    return prepare(scene);
}

PreparedScene mesh_for_lines(const std::filesystem::path& file, const Placement& placement) {
    Surface surface;
    surface.name = file.stem().string();
    surface.shape = MeshShape{file};
    surface.to_world = placement.affine();
    return scene_for_lines({surface});
}

}  // namespace pellucid
