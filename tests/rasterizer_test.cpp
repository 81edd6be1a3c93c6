// Coverage, clipping and depth of the CPU rasteriser.
#include "cpu/rasterizer.hpp"

#include <map>
#include <random>

#include "core/parallel.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

constexpr int kSide = 48;

/// View space is the image, from its middle: one unit a pixel.
[[nodiscard]] Camera flat_camera(std::optional<PixelRect> crop = {}) {
    const CameraSettings settings{.projection = Projection::orthographic, .position = Vec3(0.0), .target = {0, 0, 1},
                                  .view_height = kSide, .near = 0.5, .far = 100};
    return {settings, {.width = kSide, .height = kSide}, Box{Vec3(-1e3), Vec3(1e3)}, crop};
}
[[nodiscard]] Vec3 at(double x, double y, double z = 1) { return {x - kSide / 2, y - kSide / 2, z}; }

/// How often each pixel of an image is covered.
class Counts {
public:
    explicit Counts(const Camera& camera) : camera_(camera), setup_(camera), count_(static_cast<std::size_t>(camera.width() * camera.height())) {}

    void draw(const Vec3& a, const Vec3& b, const Vec3& c) {
        std::vector<RasterTriangle> parts;
        setup_.add({a, b, c}, {setup_.snap(a), setup_.snap(b), setup_.snap(c)}, 0, parts);
        for (const RasterTriangle& part : parts)
            for_each_covered(part, {0, 0, camera_.width(), camera_.height()}, [&](int x, int y) { ++(*this)(x, y); });
    }
    int& operator()(int x, int y) { return count_[static_cast<std::size_t>(y * camera_.width() + x)]; }
    [[nodiscard]] std::map<int, int> histogram() const {
        std::map<int, int> h;
        for (const int n : count_) ++h[n];
        return h;
    }

private:
    const Camera& camera_;
    TriangleSetup setup_;
    std::vector<int> count_;
};

const std::map<int, int> kEachOnce{{1, kSide * kSide}};

TEST(Rasterizer, TrianglesThatTileTheImageCoverEveryCentreOnce) {
    const Camera camera = flat_camera();
    std::mt19937_64 random(1);
    // Corners on a lattice that holds pixel centres, edges and corners, so that centres on edges are common.
    for (const int lattice : {2, 4, 256, 1024}) {
        for (int trial = 0; trial < 60; ++trial) {
            constexpr int kCells = 7;
            std::vector<Vec3> p;
            std::uniform_int_distribution<int> jitter(-3 * lattice, 3 * lattice);  // may fold cells over: not more than 3 px
            for (int j = 0; j <= kCells; ++j)
                for (int i = 0; i <= kCells; ++i) {
                    const bool inner = i > 0 && j > 0 && i < kCells && j < kCells;
                    const double step = static_cast<double>(kSide) / kCells;
                    const auto place = [&](int k) {
                        return k == 0 ? 0.0 : k == kCells ? double{kSide} : std::round(k * step) + (inner ? jitter(random) / static_cast<double>(lattice) / 2 : 0);
                    };
                    p.push_back(at(place(i), place(j)));
                }
            Counts counts(camera);
            for (std::size_t j = 0; j < kCells; ++j)
                for (std::size_t i = 0; i < kCells; ++i) {
                    const std::size_t a = j * (kCells + 1) + i;
                    if ((random() & 1U) != 0) {
                        counts.draw(p[a], p[a + 1], p[a + kCells + 2]);
                        counts.draw(p[a], p[a + kCells + 2], p[a + kCells + 1]);
                    } else {
                        counts.draw(p[a], p[a + 1], p[a + kCells + 1]);
                        counts.draw(p[a + kCells + 1], p[a + 1], p[a + kCells + 2]);
                    }
                }
            // Quads that are not convex are folded, covering some centres three times and never twice.
            for (const auto& [n, pixels] : counts.histogram()) ASSERT_EQ(n % 2, 1) << n << " on " << pixels << " pixels, lattice " << lattice;
        }
    }
}

TEST(Rasterizer, FansAroundAPixelCentreCoverItOnce) {
    const Camera camera = flat_camera();
    std::mt19937_64 random(2);
    std::uniform_real_distribution<double> unit(0, 1);
    for (int trial = 0; trial < 500; ++trial) {
        // Sorted directions from a pixel's centre to the border of a square that holds the image.
        const Vec3 middle = at(static_cast<int>(random() % kSide) + 0.5, static_cast<int>(random() % kSide) + 0.5);
        std::vector<double> turn{0, 0.25, 0.5, 0.75};
        const int more = static_cast<int>(random() % 20);
        for (int i = 0; i < more; ++i) turn.push_back(trial % 2 == 0 ? unit(random) : static_cast<double>(random() % 16) / 16);
        std::sort(turn.begin(), turn.end());
        Counts counts(camera);
        for (std::size_t i = 0; i < turn.size(); ++i) {
            const auto rim = [&](double t) {
                const double a = 2 * M_PI * t;
                return middle + Vec3(std::round(200 * std::cos(a)), std::round(200 * std::sin(a)), 0);
            };
            counts.draw(middle, rim(turn[i]), rim(turn[(i + 1) % turn.size()]));
        }
        ASSERT_EQ(counts.histogram(), kEachOnce) << trial;
    }
}

TEST(Rasterizer, TopAndLeftEdgesHoldTheirCentresOthersDoNot) {
    const Camera camera = flat_camera();
    Counts counts(camera);
    // A square whose four sides run through centres.
    counts.draw(at(2.5, 2.5), at(6.5, 2.5), at(6.5, 6.5));
    counts.draw(at(2.5, 2.5), at(6.5, 6.5), at(2.5, 6.5));
    for (int y = 0; y < 10; ++y)
        for (int x = 0; x < 10; ++x) EXPECT_EQ(counts(x, y), x >= 2 && x < 6 && y >= 2 && y < 6 ? 1 : 0) << x << ' ' << y;
}

TEST(Rasterizer, TrianglesWithoutAreaCoverNothing) {
    const Camera camera = flat_camera();
    Counts counts(camera);
    counts.draw(at(3, 3), at(3, 3), at(20, 9));
    counts.draw(at(3.5, 3.5), at(10.5, 10.5), at(20.5, 20.5));
    counts.draw(at(3.5, 3.5), at(3.5, 3.5), at(3.5, 3.5));
    counts.draw(at(3.5, 3.5), at(3.5001, 3.5), at(3.5, 3.5001));  // smaller than the grid
    EXPECT_EQ(counts.histogram(), (std::map<int, int>{{0, kSide * kSide}}));
}

TEST(Rasterizer, EitherSideIsDrawn) {
    const Camera camera = flat_camera();
    Counts one(camera), other(camera);
    one.draw(at(3, 2), at(40, 11), at(9, 37));
    other.draw(at(3, 2), at(9, 37), at(40, 11));
    EXPECT_GT(one.histogram()[1], 500);
    for (int y = 0; y < kSide; ++y)
        for (int x = 0; x < kSide; ++x) EXPECT_EQ(one(x, y), other(x, y));
}

TEST(Rasterizer, CoordinatesFarOutsideAreClippedWithoutACrack) {
    const CameraSettings settings{.position = Vec3(0.0), .target = {0, 0, 1}, .fov_degrees = 60, .near = 1e-9};
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> unit(-1, 1);
    for (int trial = 0; trial < 300; ++trial) {
        // A tetrahedron around the eye, as large as 10^0 … 10^8: one triangle is in front of it in each direction.
        const double size = std::pow(10.0, trial % 9);
        const Camera camera(settings, {.width = kSide, .height = kSide}, Box{Vec3(-size), Vec3(size)});
        Vec3 p[4];
        double least = 0;
        do {
            for (Vec3& each : p) each = size * Vec3(unit(random), unit(random), unit(random));
            least = kInfinity;
            for (int i = 0; i < 4; ++i) {
                const Vec3 n = cross(p[(i + 2) % 4] - p[(i + 1) % 4], p[(i + 3) % 4] - p[(i + 1) % 4]);
                const double own = dot(n, p[i] - p[(i + 1) % 4]);
                const double eye = dot(n, -p[(i + 1) % 4]);
                least = std::min(least, own > 0 ? eye / length(n) : own < 0 ? -eye / length(n) : -1);
            }
        } while (!(least > 0.02 * size));
        Counts counts(camera);
        for (int i = 0; i < 4; ++i) counts.draw(p[(i + 1) % 4], p[(i + 2) % 4], p[(i + 3) % 4]);
        ASSERT_EQ(counts.histogram(), kEachOnce) << trial;
    }
}

TEST(Rasterizer, WhatIsBehindNearIsNotDrawn) {
    const CameraSettings settings{.position = Vec3(0.0), .target = {0, 0, 1}, .fov_degrees = 60, .near = 2};
    const Camera camera(settings, {.width = kSide, .height = kSide}, Box{Vec3(-100), Vec3(100)});
    Counts counts(camera);
    counts.draw({-50, -50, -1}, {50, -50, 1.9}, {0, 80, 1.9});
    EXPECT_EQ(counts.histogram(), (std::map<int, int>{{0, kSide * kSide}}));
    // A floor from behind the eye to the distance is cut at z = near: rows below that are empty.
    const double height = 0.5;  // y is down
    counts.draw({-90, height, -20}, {90, height, -20}, {90, height, 90});
    counts.draw({-90, height, -20}, {90, height, 90}, {-90, height, 90});
    for (int y = 0; y < kSide; ++y) {
        const double slope = (y + 0.5 - kSide / 2.0) * camera.pixel_size();
        const double depth = height / slope;
        if (std::abs(depth - 2) < 0.02) continue;
        EXPECT_EQ(counts(kSide / 2, y), slope > 0 && depth > 2 && depth < 90 ? 1 : 0) << y;
    }
}

TEST(Rasterizer, DepthIsThatOfThePlaneOnThePixelsRay) {
    std::mt19937_64 random(4);
    std::uniform_real_distribution<double> unit(-1, 1);
    for (const auto projection : {Projection::perspective, Projection::orthographic}) {
        const CameraSettings settings{.projection = projection, .position = {3, 1, 2}, .target = {0, 0.2, 0}, .view_height = 3};
        const Camera camera(settings, {.width = 64, .height = 40}, Box{Vec3(-2), Vec3(2)});
        for (int trial = 0; trial < 2000; ++trial) {
            Vec3 world[3];
            for (Vec3& p : world) p = Vec3(unit(random), unit(random), unit(random));
            const Vec3 n = cross(world[1] - world[0], world[2] - world[0]);
            const double x = 32 + 32 * unit(random);
            const double y = 20 + 20 * unit(random);
            const Ray ray = camera.ray(x, y);
            const double against = dot(n, ray.direction);
            const double t = dot(n, world[0] - ray.origin) / against;
            const Vec3 v[3] = {camera.to_view(world[0]), camera.to_view(world[1]), camera.to_view(world[2])};
            const DepthPlane plane = depth_plane(camera, v[0], v[1], v[2]);
            const double z = plane.at(x - camera.center().x, y - camera.center().y);
            const double lo = std::min({v[0].z, v[1].z, v[2].z});
            const double hi = std::max({v[0].z, v[1].z, v[2].z});
            const double room = 1e-14 * length(n) * length(ray.direction) / std::abs(against);
            EXPECT_NEAR(z, std::clamp(t, lo, hi), 10 * room);
        }
    }
}

TEST(Rasterizer, APlaneAcrossTheViewHasOneDepthToTheLastBit) {
    const Camera camera = flat_camera();
    const DepthPlane plane = depth_plane(camera, at(1.1, 2.7, 3.3), at(40.3, 3.1, 3.3), at(17.7, 30, 3.3));
    for (int i = 0; i < 40; ++i) EXPECT_EQ(plane.at(i * 0.7 - 11, 3 - i * 0.3), 3.3);
}

TEST(Rasterizer, TrianglesSeenEdgeOnStayWithinTheirDepths) {
    const Camera camera = flat_camera();
    const DepthPlane plane = depth_plane(camera, at(1, 2, 3), at(1, 2, 7), at(30, 2, 5));
    for (int i = 0; i < 20; ++i) {
        const double z = plane.at(i - 10.0, 0.25 * i - 24);
        EXPECT_GE(z, 3);
        EXPECT_LE(z, 7);
    }
}

TEST(Rasterizer, ACropCoversTheSamePixels) {
    const PixelRect crop{7, 13, 40, 31};
    const Camera whole = flat_camera();
    const Camera part = flat_camera(crop);
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(-0.2, 1.2);
    for (int trial = 0; trial < 300; ++trial) {
        Vec3 p[3];
        for (Vec3& each : p) each = at(kSide * unit(random), kSide * unit(random));
        Counts a(whole), b(part);
        a.draw(p[0], p[1], p[2]);
        b.draw(p[0], p[1], p[2]);
        for (int y = crop.y0; y < crop.y1; ++y)
            for (int x = crop.x0; x < crop.x1; ++x) ASSERT_EQ(a(x, y), b(x - crop.x0, y - crop.y0));
    }
}

TEST(Rasterizer, TilesHoldEveryTriangleThatCoversThem) {
    const fs::path folder = test_folder();
    (void)put_sphere_mesh(folder / "ball.ply", 20);
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [150, 101]\ncamera.position = [0.3, 0.2, 3]\n[[surface]]\nname = \"ball\"\nmesh = \"ball.ply\"\n", folder));
    const SceneMeshes meshes(scene, {});
    const std::vector<std::uint32_t> objects{0};
    const BinnedTriangles bins(scene.camera, meshes, objects);
    // By tiles, and without them.
    std::map<std::pair<int, int>, std::vector<std::uint32_t>> binned, plain;
    for (std::size_t tile = 0; tile < bins.tile_count(); ++tile)
        for (std::size_t i = 0; i < bins.count(tile); ++i) {
            if (i > 0) {
                EXPECT_LE(bins.triangle(tile, i - 1).number, bins.triangle(tile, i).number);
            }
            for_each_covered(bins.triangle(tile, i), bins.tile(tile),
                             [&](int x, int y) { binned[{x, y}].push_back(bins.triangle(tile, i).number); });
        }
    const TriangleSetup setup(scene.camera);
    std::vector<RasterTriangle> parts;
    const ObjectMesh& mesh = meshes.objects()[0];
    for (std::uint32_t i = 0; i < mesh.mesh->triangles.size(); ++i) {
        std::array<Vec3, 3> v;
        for (std::size_t k = 0; k < 3; ++k) v[k] = mesh.view[mesh.mesh->triangles[i][k]];
        setup.add(v, {setup.snap(v[0]), setup.snap(v[1]), setup.snap(v[2])}, i, parts);
    }
    for (const RasterTriangle& part : parts)
        for_each_covered(part, {0, 0, 150, 101}, [&](int x, int y) { plain[{x, y}].push_back(part.number); });
    EXPECT_EQ(binned, plain);
    // A closed surface is crossed twice.
    for (const auto& [pixel, list] : plain) EXPECT_EQ(list.size() % 2, 0U) << pixel.first << ' ' << pixel.second;
    EXPECT_GT(plain.size(), 2000U);
}

}  // namespace
}  // namespace pellucid
