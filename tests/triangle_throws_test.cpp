// Points thrown on triangles of a mesh: every triangle by its area, uniform within it; places and normals against the mesh.
// That single trials, batches and all instruction sets agree to the last bit: edge_lines_test.
#include "sample/triangle_throws.hpp"

#include <random>

#include "sample/mesh_sampler.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

/// A plane z = 0.25·x in uneven columns and rows, two triangles a rectangle: areas differ by a factor of some hundreds.
struct Plane {
    static constexpr int kColumns = 90;
    static constexpr int kRows = 40;
    static constexpr double kSlope = 0.25;
    std::vector<double> x, y;

    Plane() {
        for (int i = 0; i <= kColumns; ++i) x.push_back(std::pow(i / double{kColumns}, 2.5) * 2 - 1);
        for (int i = 0; i <= kRows; ++i) y.push_back(std::pow(i / double{kRows}, 1.5) * 2 - 1);
    }
    [[nodiscard]] std::string ply() const {
        std::string out = fmt::format("ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
                                      "property float z\nproperty float nx\nproperty float ny\nproperty float nz\n"
                                      "element face {}\nproperty list uchar int vertex_indices\nend_header\n",
                                      x.size() * y.size(), 2 * kColumns * kRows);
        for (const double b : y)
            for (const double a : x) out += fmt::format("{} {} {} {} {} 1\n", a, b, kSlope * a, 0.5 * a, 0.5 * b);
        for (int j = 0; j < kRows; ++j)
            for (int i = 0; i < kColumns; ++i) {
                const int v = j * (kColumns + 1) + i;
                out += fmt::format("3 {} {} {}\n3 {} {} {}\n", v, v + 1, v + kColumns + 2, v, v + kColumns + 2, v + kColumns + 1);
            }
        return out;
    }
};

/// Counts over triangles, and over the four equal parts of each into which the middles of its sides cut it.
struct Judge {
    const Plane& plane;
    std::vector<std::int64_t> triangles = std::vector<std::int64_t>(2 * Plane::kColumns * Plane::kRows, 0);
    std::vector<std::int64_t> parts = std::vector<std::int64_t>(8, 0);

    void add(double x, double y) {
        const auto cell = [](const std::vector<double>& edges, double at) {
            const auto after = std::upper_bound(edges.begin() + 1, edges.end() - 1, at);
            return static_cast<std::size_t>(after - edges.begin()) - 1;
        };
        const std::size_t i = cell(plane.x, x);
        const std::size_t j = cell(plane.y, y);
        const double u = (x - plane.x[i]) / (plane.x[i + 1] - plane.x[i]);
        const double v = (y - plane.y[j]) / (plane.y[j + 1] - plane.y[j]);
        const bool upper = v > u;
        ++triangles[2 * (j * Plane::kColumns + i) + (upper ? 1U : 0U)];
        // Barycentric coordinates: 1 − larger, smaller, and the rest.
        const double b[3] = {1 - std::max(u, v), std::min(u, v), std::abs(u - v)};
        std::size_t part = 3;
        for (std::size_t k = 0; k < 3; ++k)
            if (b[k] > 0.5) part = k;
        ++parts[(upper ? 4U : 0U) + part];
    }
    [[nodiscard]] double p_of_triangles() const {
        // Neighbours in a row together until some twenty are expected.
        std::vector<double> shares;
        std::vector<std::int64_t> counts;
        std::int64_t total = 0;
        for (const std::int64_t c : triangles) total += c;
        double share = 0;
        std::int64_t count = 0;
        for (std::size_t t = 0; t < triangles.size(); ++t) {
            const std::size_t i = t / 2 % Plane::kColumns;
            const std::size_t j = t / 2 / Plane::kColumns;
            share += (plane.x[i + 1] - plane.x[i]) * (plane.y[j + 1] - plane.y[j]) / 8;
            count += triangles[t];
            if (share * static_cast<double>(total) < 20 && t + 1 < triangles.size()) continue;
            shares.push_back(share);
            counts.push_back(count);
            share = 0;
            count = 0;
        }
        return chi2_test(counts, shares)->p_value;
    }
    [[nodiscard]] double p_of_parts() const { return chi2_uniformity(parts)->p_value; }
};

class TriangleThrows : public testing::Test {
protected:
    [[nodiscard]] PreparedScene scene(const std::string& camera) const {
        return prepare(scene_from("image.resolution = [64, 64]\n[camera]\n" + camera +
                                  "[[surface]]\nopacity_law = \"oblique\"\nmesh = \"plane.ply\"\n", folder_));
    }
    Plane plane_;
    fs::path folder_ = [this] {
        const fs::path folder = test_folder();
        put(folder / "plane.ply", plane_.ply());
        return folder;
    }();
    static constexpr const char* kOrthographic = "projection = \"orthographic\"\nposition = [1, -2, 6]\nview_height = 4\n";
};

TEST_F(TriangleThrows, AreUniformOverTrianglesAndWithinThem) {
    const PreparedScene scene = this->scene(kOrthographic);
    const LineSampler sampler(scene.objects[0], scene.camera, 0);
    EXPECT_GT(sampler.block_count(), 1U);
    // Poisson numbers of trials in blocks, and single trials.
    Judge blocks{plane_};
    Judge single{plane_};
    std::uint64_t kept = 0;
    for (std::uint32_t repeat = 0; repeat < 20; ++repeat)
        for (std::size_t b = 0; b < sampler.block_count(); ++b) {
            std::vector<SourcePoint> points;
            const double mean = 20000 * sampler.block_virtual_pixels(b) / sampler.virtual_pixels();
            sampler.trials_in_block(b, {3}, repeat, 0, static_cast<std::uint32_t>(mean + 0.5), points);
            for (const SourcePoint& point : points) {
                const Vec3 p = scene.camera.to_world(point.view);
                ASSERT_NEAR(p.z, Plane::kSlope * p.x, 1e-6);
                blocks.add(p.x, p.y);
            }
            kept += points.size();
        }
    EXPECT_NEAR(static_cast<double>(kept), 400000, 30);  // all are in view
    for (std::uint64_t i = 0; i < 200000; ++i) {
        const Vec3 p = scene.camera.to_world(sampler.trial({4}, 0, i)->view);
        single.add(p.x, p.y);
    }
    EXPECT_GT(blocks.p_of_triangles(), 1e-4);
    EXPECT_GT(blocks.p_of_parts(), 1e-4);
    EXPECT_GT(single.p_of_triangles(), 1e-4);
    EXPECT_GT(single.p_of_parts(), 1e-4);
}

TEST_F(TriangleThrows, WrongTwinsAreRejectedByTheSameCounts) {
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    const auto inside = [&](const std::vector<double>& edges, std::size_t i, double share) {
        return edges[i] + share * (edges[i + 1] - edges[i]);
    };
    // Areas that are wrong by 30 % in every second column, right within triangles; and the other way round: barycentric
    // coordinates that are three uniform numbers over their sum.
    Judge areas{plane_};
    Judge middles{plane_};
    for (int n = 0; n < 400000; ++n) {
        const double x = 2 * unit(random) - 1;
        const double y = 2 * unit(random) - 1;
        const auto i = static_cast<std::size_t>(std::upper_bound(plane_.x.begin() + 1, plane_.x.end() - 1, x) - plane_.x.begin()) - 1;
        const auto j = static_cast<std::size_t>(std::upper_bound(plane_.y.begin() + 1, plane_.y.end() - 1, y) - plane_.y.begin()) - 1;
        if (i % 2 == 0 || unit(random) < 0.7) areas.add(x, y);
        double b[3] = {unit(random), unit(random), unit(random)};
        const double sum = b[0] + b[1] + b[2];
        for (double& each : b) each /= sum;
        middles.add(inside(plane_.x, i, b[1] + b[2]), inside(plane_.y, j, b[1]));
    }
    EXPECT_LT(areas.p_of_triangles(), 1e-6);
    EXPECT_LT(middles.p_of_parts(), 1e-6);
}

TEST_F(TriangleThrows, NormalsAreThoseOfTheCornersInterpolated) {
    const PreparedScene scene = this->scene("position = [0.3, -0.4, 3]\nfov_degrees = 60\n");
    const LineSampler sampler(scene.objects[0], scene.camera, 0);
    std::size_t seen = 0;
    for (std::uint64_t i = 0; i < 2000; ++i)
        if (const auto point = sampler.trial({4}, 0, i)) {
            const Vec3 p = scene.camera.to_world(point->view);
            ASSERT_NEAR(p.z, Plane::kSlope * p.x, 2e-6);
            // Corners' normals have length one, so blending is not linear in theirs: cells are small.
            const Vec3 expected = normalize(Vec3(0.5 * p.x, 0.5 * p.y, 1));
            ASSERT_GT(dot(normalize(scene.camera.world_vector(point->view_normal)), expected), 1 - 2e-4);
            ++seen;
        }
    EXPECT_GT(seen, 500U);
}

TEST_F(TriangleThrows, NormalsThatCancelGiveWayToTheTriangle) {
    const PreparedScene scene = this->scene(kOrthographic);
    TriangleMesh mesh;
    mesh.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    mesh.normals.assign(3, Vec3(0.0));
    mesh.triangles = {{0, 1, 2}};
    const MeshSampler sampler(scene.objects[0], mesh, scene.camera, 0);
    std::vector<SourcePoint> points;
    sampler.trials_in_block(0, {4}, 0, 0, 100, points);
    EXPECT_GT(points.size(), 50U);
    for (const SourcePoint& point : points)
        ASSERT_NEAR(std::abs(normalize(scene.camera.world_vector(point.view_normal)).z), 1, 1e-6);
}

}  // namespace
}  // namespace pellucid
