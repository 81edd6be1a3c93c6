#include "bench/workloads.hpp"

#include <cmath>
#include <fstream>
#include <string>

#include "core/error.hpp"
#include "io/temporary_folder.hpp"

namespace pellucid::bench {
namespace {

template <typename T>
void put(std::ofstream& out, const T& value) {
    out.write(reinterpret_cast<const char*>(&value), sizeof(T));
}

[[nodiscard]] Scene empty_scene(int size, const Vec3& position) {
    Scene scene;
    scene.source = "benchmark";
    scene.image = {.width = size, .height = size};
    scene.camera.position = position;
    scene.lights = {{.headlight = true}};
    return scene;
}

[[nodiscard]] Surface glossy(const char* name, Shape shape, const Vec3& offset = Vec3(0.0)) {
    Surface surface;
    surface.name = name;
    surface.shape = std::move(shape);
    surface.opacity = 0.005;  // thin, so that a repeat is a small piece of work
    surface.shading = {.ambient = 0.2, .diffuse = 0.6, .specular = 0.3, .shininess = 32};
    surface.to_world.offset = offset;
    return surface;
}

/// A cube of n × n squares a side, blown up to a sphere whose radius goes up and down.
void add_wavy_sphere(double radius, int n, TriangleMesh& mesh) {
    for (int face = 0; face < 6; ++face) {
        const auto first = static_cast<std::uint32_t>(mesh.positions.size());
        const double side = (face & 1) != 0 ? 1 : -1;
        for (int j = 0; j <= n; ++j)
            for (int i = 0; i <= n; ++i) {
                Vec3 p;
                p[face / 2] = side;
                p[(face / 2 + 1) % 3] = 2.0 * i / n - 1;
                p[(face / 2 + 2) % 3] = side * (2.0 * j / n - 1);  // turned over: outside stays outside
                p = normalize(p);
                const double wave = std::sin(9 * p.x) * std::sin(8 * p.y) * std::sin(7 * p.z);
                mesh.positions.push_back(radius * (1 + 0.05 * wave) * p);
            }
        const auto row = static_cast<std::uint32_t>(n + 1);
        for (std::uint32_t j = 0; j < row - 1; ++j)
            for (std::uint32_t i = 0; i < row - 1; ++i) {
                const std::uint32_t a = first + j * row + i;
                mesh.triangles.push_back({a, a + 1, a + row + 1});
                mesh.triangles.push_back({a, a + row + 1, a + row});
            }
    }
}

void write_ply(const std::filesystem::path& file, const TriangleMesh& mesh) {
    std::ofstream out(file, std::ios::binary);
    out << "ply\nformat binary_little_endian 1.0\nelement vertex " << mesh.positions.size()
        << "\nproperty float x\nproperty float y\nproperty float z\nelement face " << mesh.triangles.size()
        << "\nproperty list uchar uint vertex_indices\nend_header\n";
    for (const Vec3& p : mesh.positions)
        for (int axis = 0; axis < 3; ++axis) put(out, static_cast<float>(p[axis]));
    for (const auto& t : mesh.triangles) {
        put(out, std::uint8_t{3});
        put(out, t);
    }
    if (!out.flush()) throw run_error("{}: cannot be written", file.string());
}

void write_wavy_volume(const std::filesystem::path& file, int n) {
    std::ofstream out(file, std::ios::binary);
    out << "NRRD0004\ntype: float\ndimension: 3\nsizes: " << n << ' ' << n << ' ' << n
        << "\nencoding: raw\nendian: little\nspacings: 1 1 1\n\n";
    for (int k = 0; k < n; ++k)
        for (int j = 0; j < n; ++j)
            for (int i = 0; i < n; ++i) {
                const Vec3 p = (Vec3(i, j, k) + 0.5) * (2.0 / n) - 1.0;
                const double wave = std::sin(9 * p.x) * std::sin(8 * p.y) * std::sin(7 * p.z);
                put(out, static_cast<float>(length(p) + 0.1 * wave));
            }
    if (!out.flush()) throw run_error("{}: cannot be written", file.string());
}

}  // namespace

PreparedScene overlapping_surfaces() {
    Scene scene = empty_scene(kImageSize, {1.5, 2, 4.5});
    scene.surfaces.push_back(glossy("torus", ImplicitShape{"torus", {}}));
    scene.surfaces.push_back(glossy("sphere", ImplicitShape{"sphere", {{"radius", 0.7}}}, {0.4, 0, 0.2}));
    scene.surfaces.push_back(glossy("ellipsoid", ImplicitShape{"ellipsoid", {}}, {-0.3, 0.2, 0}));
    const ImplicitShape cylinder{"cylinder", {{"radius", 0.5}, {"height", 1.6}}};
    scene.surfaces.push_back(glossy("cylinder", cylinder));
    return prepare(scene);
}

PreparedScene crossing_cards() {
    Scene scene = empty_scene(kImageSize, {0, 0, 4.5});
    for (const double tilt : {-0.6, -0.2, 0.2, 0.6}) {
        const RectangleShape card{.center = Vec3(0.0), .u = {1, 0, tilt}, .v = {0, 1, tilt}, .image = {}};
        scene.surfaces.push_back(glossy("card", card));
    }
    return prepare(scene);
}

PreparedScene torus() {
    Scene scene = empty_scene(kImageSize, {1.5, 2, 4.5});
    scene.surfaces.push_back(glossy("torus", ImplicitShape{"torus", {}}));
    return prepare(scene);
}

PreparedScene barth_sextic(int size) {
    Scene scene = empty_scene(size, {3, 2.2, 5});
    const std::string golden = "1.618033988749895";
    const std::string golden2 = "2.618033988749895";
    scene.surfaces.push_back(glossy("sextic", ExpressionShape{"4*(" + golden2 + "*x^2-y^2)*(" + golden2 + "*y^2-z^2)*(" +
                                                              golden2 + "*z^2-x^2)-(1+2*" + golden +
                                                              ")*(x^2+y^2+z^2-1)^2"}));
    scene.surfaces[0].bounds = Box{Vec3(-1.65), Vec3(1.65)};
    return prepare(scene);
}

PreparedScene nested_spheres(int size, double opacity) {
    const TemporaryFolder scratch;
    TriangleMesh mesh;
    for (int shell = 0; shell < 8; ++shell) add_wavy_sphere(0.3 + 0.1 * shell, 104, mesh);
    write_ply(scratch.path() / "spheres.ply", mesh);
    Scene scene = empty_scene(size, {0, 0, 4});
    scene.surfaces.push_back(glossy("nested spheres", MeshShape{scratch.path() / "spheres.ply"}));
    scene.surfaces[0].opacity = opacity;
    return prepare(scene);
}

PreparedScene eight_spheres(int size) {
    const TemporaryFolder scratch;
    TriangleMesh mesh;
    add_wavy_sphere(0.55, 91, mesh);
    write_ply(scratch.path() / "sphere.ply", mesh);
    Scene scene = empty_scene(size, {0, 0, 4});
    for (int i = 0; i < 8; ++i) {
        // Along a spiral.
        const double turn = 2.4 * i;
        const double radius = 0.15 * std::sqrt(i + 0.5);
        scene.surfaces.push_back(glossy("sphere", MeshShape{scratch.path() / "sphere.ply"},
                                        {radius * std::cos(turn), radius * std::sin(turn), 0.1 * (i % 3) - 0.1}));
        scene.surfaces.back().opacity = 0.3;
    }
    return prepare(scene);
}

PreparedScene real_head(Interpolation interpolation) {
    Scene scene = empty_scene(kImageSize, {260, 300, 90});
    scene.camera.target = {0, -18, 10};
    scene.camera.up = {0, 0, 1};
    scene.surfaces.push_back(glossy("skin", IsosurfaceShape{kHeadFile, 40, interpolation}));
    return prepare(scene);
}

PreparedScene wavy_isosurface(Interpolation interpolation) {
    const TemporaryFolder scratch;
    write_wavy_volume(scratch.path() / "ball.nrrd", 128);
    Scene scene = empty_scene(kImageSize, {64, 64, 320});
    scene.camera.target = {64, 64, 64};
    scene.surfaces.push_back(glossy("isosurface", IsosurfaceShape{scratch.path() / "ball.nrrd", 0.6, interpolation}));
    return prepare(scene);
}

std::uint8_t cube_value(int i, int j, int k) {
    return static_cast<std::uint8_t>(128 + 60 * std::sin(0.1 * i) * std::cos(0.07 * j + 0.05 * k) +
                                     40 * std::sin(0.031 * k + 0.02 * i));
}

PreparedScene transparent_cube(const CubeSettings& settings) {
    const TemporaryFolder scratch;
    constexpr int n = kCubeSamples;
    {
        std::ofstream out(scratch.path() / "cube.nrrd", std::ios::binary);
        out << "NRRD0004\ntype: uint8\ndimension: 3\nsizes: " << n << ' ' << n << ' ' << n << "\nencoding: raw\n\n";
        const auto filled = [&](int i, int j, int k) {
            std::uint32_t h = static_cast<std::uint32_t>(i / 32 + 8 * (j / 32 + 8 * (k / 32))) * 0x9e3779b1U;
            h = (h ^ (h >> 15U)) * 0x2c1b3c6dU;
            return ((h ^ (h >> 13U)) & 0xffffU) < 65536 * settings.share;
        };
        std::string row(n, ' ');
        for (int k = 0; k < n; ++k)
            for (int j = 0; j < n; ++j) {
                for (int i = 0; i < n; ++i)
                    row[static_cast<std::size_t>(i)] = static_cast<char>(filled(i, j, k) ? cube_value(i, j, k) : 0);
                out << row;
            }
    }
    Scene scene = empty_scene(kCubePixels, {484.5, 357, 535.5});
    scene.camera.target = Vec3(0.5 * (n - 1));
    scene.camera.fov_degrees = 34;
    for (int i = 0; i < settings.copies; ++i) {
        Volume volume;
        volume.name = "cube";
        volume.source = scratch.path() / "cube.nrrd";
        volume.transfer = {{0, 1, 0, 0, 0}, {1, 1, 0, 0, 0.001}, {90, 1, 0.8, 0.6, 0.004}, {255, 1, 1, 1, 0.01}};
        volume.shading = settings.shading;
        volume.to_world.offset = Vec3(20 * i, -10 * i, 5 * i);
        scene.volumes.push_back(volume);
    }
    return prepare(scene);
}

std::vector<OrientedPoint> points_on_wavy_ball(int count) {
    const auto radius = [](const Vec3& p) { return 1 + 0.05 * std::sin(9 * p.x) * std::sin(8 * p.y) * std::sin(7 * p.z); };
    const auto field = [&](const Vec3& p) { return length(p) - radius(normalize(p)); };
    std::vector<OrientedPoint> points;
    for (int i = 0; i < count; ++i) {
        const double z = 1 - (2.0 * i + 1) / count;
        const double angle = 2.399963229728653 * i;  // Fibonacci's
        const Vec3 way(std::sqrt(1 - z * z) * std::cos(angle), std::sqrt(1 - z * z) * std::sin(angle), z);
        const Vec3 p = radius(way) * way;
        Vec3 normal;
        for (int axis = 0; axis < 3; ++axis) {
            Vec3 step(0.0);
            step[axis] = 1e-5;
            normal[axis] = field(p + step) - field(p - step);
        }
        normal = normalize(normal);
        points.push_back({p, {static_cast<float>(normal.x), static_cast<float>(normal.y), static_cast<float>(normal.z)}});
    }
    return points;
}

PreparedScene wavy_points() {
    const TemporaryFolder scratch;
    {
        std::ofstream out(scratch.path() / "ball.xyz");
        out.precision(9);
        for (const auto& [p, n] : points_on_wavy_ball(120'000))
            out << p.x << ' ' << p.y << ' ' << p.z << ' ' << n[0] << ' ' << n[1] << ' ' << n[2] << '\n';
    }
    Scene scene = empty_scene(kImageSize, {1.5, 2, 4.5});
    scene.surfaces.push_back(glossy("points", PointsShape{scratch.path() / "ball.xyz"}));
    return prepare(scene);
}

}  // namespace pellucid::bench
