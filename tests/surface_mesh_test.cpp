// Triangles in place of f = 0: area, distance and normals against closed forms; particles of them; counting spheres.
#include "sample/surface_mesh.hpp"

#include <numeric>

#include "core/parallel.hpp"
#include "sample/make_sources.hpp"
#include "sample/mesh_sampler.hpp"
#include "scene_testing.hpp"
#include "study/sphere_counts.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

PreparedScene scene_of(const std::string& body) {
    return prepare(scene_from("image.resolution = [16, 16]\n[camera]\nprojection = \"orthographic\"\nposition = [7, 5, 6]\nview_height = 12\n"
                              "[[surface]]\nopacity_law = \"oblique\"\n" + body));
}

double area_of(const TriangleMesh& mesh) {
    double sum = 0;
    for (const auto& t : mesh.triangles)
        sum += 0.5 * length(cross(mesh.positions[t[1]] - mesh.positions[t[0]], mesh.positions[t[2]] - mesh.positions[t[0]]));
    return sum;
}

/// How often each edge belongs to a triangle, and whether both its triangles run it in opposite ways.
struct EdgeCount {
    std::size_t inner = 0, open = 0, bad = 0;
};
EdgeCount edges_of(const TriangleMesh& mesh) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, int> forward;
    for (const auto& t : mesh.triangles)
        for (std::size_t k = 0; k < 3; ++k) ++forward[{t[k], t[(k + 1) % 3]}];
    EdgeCount count;
    for (const auto& [edge, times] : forward) {
        if (times > 1) ++count.bad;
        ++(forward.contains({edge.second, edge.first}) ? count.inner : count.open);
    }
    return count;
}

TEST(SurfaceMesh, TorusHasItsAreaAndIsClosed) {
    const PreparedScene scene = scene_of("implicit = \"torus\"");
    const double area = 4 * M_PI * M_PI * 0.4;
    double last = 1;
    for (const int cells : {16, 32, 64}) {
        const SurfaceTriangles t = tessellate(scene.objects[0], cells);
        const double off = 1 - area_of(t.mesh) / area;
        EXPECT_GT(off, 0) << cells;  // chords are shorter
        EXPECT_LT(off, 0.35 * last) << cells;  // of second order
        last = off;
        const EdgeCount edges = edges_of(t.mesh);
        EXPECT_EQ(edges.open, 0U);
        EXPECT_EQ(edges.bad, 0U);
        for (std::size_t i = 0; i < t.mesh.positions.size(); ++i) {
            const Vec3& p = t.mesh.positions[i];
            ASSERT_NEAR(std::hypot(std::hypot(p.x, p.y) - 1, p.z), 0.4, 1e-9);
            const Vec3 ring = normalize(Vec3(p.x, p.y, 0));
            ASSERT_NEAR(dot(t.mesh.normals[i], normalize(p - ring)), 1, 1e-9);
        }
        // Sagitta of a chord as long as a tetrahedron's edge, at the tube's curvature.
        const double cell = 2.8 / cells;
        EXPECT_LT(t.error, 3 * cell * cell / (8 * 0.4));
        EXPECT_GT(t.error, 0.1 * cell * cell / (8 * 0.4));
    }
    EXPECT_LT(last, 1e-3);
}

/// Edges of one triangle only lie in the bounds' faces.
void expect_closed_inside(const SurfaceTriangles& t, const FieldSurface& surface, const std::string& what) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, int> balance;  // forward less backward
    for (const auto& triangle : t.mesh.triangles)
        for (std::size_t k = 0; k < 3; ++k) {
            const std::uint32_t a = triangle[k];
            const std::uint32_t b = triangle[(k + 1) % 3];
            balance[std::minmax(a, b)] += a < b ? 1 : -1;
        }
    const Affine back = surface.to_world.inverse();
    std::size_t open = 0;
    for (const auto& [edge, sum] : balance) {
        if (sum == 0) continue;
        ++open;
        const Vec3 p = back.point(t.mesh.positions[edge.first]);
        const Vec3 q = back.point(t.mesh.positions[edge.second]);
        const Vec3 hair = 1e-9 * surface.bounds.size();
        bool on_face = false;
        for (int axis = 0; axis < 3; ++axis)
            for (const double face : {surface.bounds.lo[axis], surface.bounds.hi[axis]})
                on_face = on_face || (std::abs(p[axis] - face) <= hair[axis] && std::abs(q[axis] - face) <= hair[axis]);
        ASSERT_TRUE(on_face) << what;
    }
    EXPECT_EQ(t.dropped, 0U) << what;
    EXPECT_GT(balance.size(), 2000U) << what << ' ' << open;
}

TEST(SurfaceMesh, EveryEdgeInsideTheBoundsBelongsToTwoTriangles) {
    // Formulas of many genera, some cut by their bounds, none a multiple of the block's eight cells.
    const std::string wavy = "bounds = [[-1, -1.2, -1], [1, 1, 1.1]]";
    for (const std::string& body :
         {std::string("expression = \"sin(5*x)*cos(4*y)+sin(5*y)*cos(4*z)+sin(5*z)*cos(4*x)\"\n") + wavy,
          std::string("expression = \"(x^2+y^2+z^2-0.5)^2-0.05*x*y*z-0.01\"\n") + wavy + "\nscale = [2, -1, 3]",
          std::string("expression = \"x*y*z\"\n") + wavy,  // planes that cross, through nodes of the grid
          std::string("implicit = \"hyperboloid\""), std::string("implicit = \"torus\"")}) {
        const PreparedScene scene = scene_of(body);
        const FieldSurface surface = *scene.objects[0].geometry->field_surface();
        expect_closed_inside(tessellate(surface, 45), surface, body);
    }
}

TEST(SurfaceMesh, IsosurfacesAndPointsAreClosedInside) {
    const fs::path folder = test_folder();
    put_volume(folder / "ball.nrrd", {24, 24, 24}, sampled({24, 24, 24}, [](const Vec3& at) {
                   const Vec3 p = (at + 0.5) / 12.0 - 1.0;
                   return length(p) + 0.2 * std::sin(9 * p.x) * std::sin(8 * p.y) * std::sin(7 * p.z);
               }), {1, 1, 2});
    std::string points;
    for (int i = 0; i < 4000; ++i) {
        const double z = 1 - (2.0 * i + 1) / 4000;
        const double angle = 2.399963229728653 * i;  // Fibonacci's
        const double r = std::sqrt(1 - z * z);
        points += fmt::format("{0} {1} {2} {0} {1} {2}\n", r * std::cos(angle), r * std::sin(angle), z);
    }
    put(folder / "ball.xyz", points);
    const std::string volume = "volume = \"" + (folder / "ball.nrrd").string() + "\"";
    for (const std::string& body : {"isosurface = { " + volume + ", isovalue = 0.7 }",
                                   "isosurface = { " + volume + ", isovalue = 0.7, interpolation = \"catmull-rom\" }",
                                   "points = \"" + (folder / "ball.xyz").string() + "\""}) {
        const PreparedScene scene = scene_of(body);
        const FieldSurface surface = *scene.objects[0].geometry->field_surface();
        const SurfaceTriangles t = tessellate(surface, 50);
        expect_closed_inside(t, surface, body);
        const Affine back = surface.to_world.inverse();
        for (std::size_t i = 0; i < t.mesh.positions.size(); i += 7) {
            const Vec3 p = back.point(t.mesh.positions[i]);
            ASSERT_LT(std::abs(surface.field->value(p)), 1e-9 * length(surface.field->gradient(p)) * length(surface.bounds.size()));
            ASSERT_NEAR(length(t.mesh.normals[i]), 1, 1e-12);
        }
    }
}

TEST(SurfaceMesh, IsTheSameForAnyNumberOfThreads) {
    const PreparedScene scene = scene_of("expression = \"sin(5*x)*cos(4*y)+sin(5*y)*cos(4*z)+sin(5*z)*cos(4*x)\"\nbounds = [[-1, -1, -1], [1, 1, 1]]");
    const int before = thread_count();
    set_thread_count(1);
    const SurfaceTriangles one = tessellate(scene.objects[0], 70);
    set_thread_count(4);
    const SurfaceTriangles four = tessellate(scene.objects[0], 70);
    set_thread_count(before);
    EXPECT_EQ(one.mesh.positions, four.mesh.positions);
    EXPECT_EQ(one.mesh.normals, four.mesh.normals);
    EXPECT_EQ(one.mesh.triangles, four.mesh.triangles);
    EXPECT_EQ(one.error, four.error);
}

TEST(SurfaceMesh, ErrorThatIsToldIsThatOfPlacesAllOverTheTriangles) {
    const PreparedScene scene = scene_of("implicit = \"torus\"");
    const SurfaceTriangles t = tessellate_within(scene.objects[0], 2e-3);
    EXPECT_LE(t.error, 2e-3);
    double seen = 0;
    for (const auto& triangle : t.mesh.triangles) {
        const auto& p = t.mesh.positions;
        for (int i = 0; i <= 6; ++i)
            for (int j = 0; i + j <= 6; ++j) {
                const Vec3 at = (p[triangle[0]] * static_cast<double>(i) + p[triangle[1]] * static_cast<double>(j) +
                                 p[triangle[2]] * static_cast<double>(6 - i - j)) / 6.0;
                seen = std::max(seen, std::abs(std::hypot(std::hypot(at.x, at.y) - 1, at.z) - 0.4));
            }
    }
    EXPECT_LT(seen, 1.1 * t.error);
    EXPECT_GT(seen, 0.8 * t.error);
}

TEST(SurfaceMesh, FlatObjectsAreTheirOwnTriangles) {
    const PreparedScene scene = scene_of("rectangle = { u = [1, 0, 0], v = [0, 2, 0] }");
    const SurfaceTriangles t = tessellate_within(scene.objects[0], 1);
    EXPECT_EQ(t.mesh.triangles.size(), 2U);
    EXPECT_NEAR(area_of(t.mesh), 8, 1e-12);
    EXPECT_EQ(t.error, 0);
}

TEST(SurfaceMesh, EndsAtTheBoundsExactlyAndFollowsTheMap) {
    // A tilted plane and an open cylinder, stretched and turned.
    const PreparedScene plane = scene_of("expression = \"x+0.3*y-0.1\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nscale = [2, 1, 3]\nrotate_degrees = [10, 20, 30]");
    const double slant = std::sqrt(4 * 0.3 * 0.3 + 1);  // (0.1 − 0.3y, y) stretched by 2 along x
    EXPECT_NEAR(area_of(tessellate(plane.objects[0], 20).mesh), 2 * slant * 6, 1e-9 * 12);
    const PreparedScene open = scene_of("implicit = \"cylinder\"");
    const SurfaceTriangles t = tessellate(open.objects[0], 64);
    const Box bounds = open.objects[0].geometry->field_surface()->bounds;
    double lo = 9, hi = -9;
    for (const Vec3& p : t.mesh.positions) {
        lo = std::min(lo, p.z);
        hi = std::max(hi, p.z);
    }
    EXPECT_EQ(lo, bounds.lo.z);
    EXPECT_EQ(hi, bounds.hi.z);
    EXPECT_GT(edges_of(t.mesh).open, 100U);
    EXPECT_NEAR(area_of(t.mesh), 2 * M_PI * bounds.size().z, 2e-3 * 2 * M_PI * bounds.size().z);
}

TEST(SurfaceMesh, PolesAndJumpsAreNoSurface) {
    const PreparedScene scene = scene_of("expression = \"tan(2*x)+y-z\"\nbounds = [[-1, -1, -1], [1, 1, 1]]");
    const SurfaceTriangles t = tessellate(scene.objects[0], 40);
    EXPECT_GT(t.dropped, 100U);
    for (const auto& triangle : t.mesh.triangles)
        for (const std::uint32_t i : triangle) {
            const Vec3& p = t.mesh.positions[i];
            ASSERT_LT(std::abs(std::tan(2 * p.x) + p.y - p.z), 1e-6);
        }
    EXPECT_GT(t.mesh.triangles.size(), 100U);
}

TEST(SurfaceMesh, SpacingThatIsChosenKeepsItsError) {
    const PreparedScene scene = scene_of("implicit = \"torus\"");
    for (const double error : {1e-2, 5e-4}) {
        const int cells = cells_for_error(scene.objects[0], error);
        EXPECT_LT(tessellate(scene.objects[0], cells).error, 1.2 * error);
        const bool needed = cells == 32 || tessellate(scene.objects[0], cells / 2).error > error;
        EXPECT_TRUE(needed) << cells;
    }
}

TEST(SurfaceMesh, OctreePiecesHaveTheSurfacesAreaToSecondOrder) {
    const struct {
        const char* body;
        double area;
        double fine;  // (κh)² is 1/80 on the torus, 1/1000 on the sphere
    } cases[] = {{"implicit = \"torus\"", 4 * M_PI * M_PI * 0.4, 0.006},
                 {"implicit = \"sphere\"\nscale = 2.0", 16 * M_PI, 0.001},
                 {"expression = \"x+0.3*y-0.1\"\nbounds = [[-1, -1, -1], [1, 1, 1]]", 4 * std::sqrt(1.09), 1e-9}};
    for (const auto& c : cases) {
        const PreparedScene scene = scene_of(c.body);
        const double coarse = std::abs(area_of(octree_triangles(scene.objects[0], 16).mesh) / c.area - 1);
        const double fine = std::abs(area_of(octree_triangles(scene.objects[0], 64).mesh) / c.area - 1);
        EXPECT_LT(coarse, 0.12) << c.body;  // 5 leaves across the tube
        EXPECT_LT(fine, c.fine) << c.body;
    }
}

TEST(SurfaceMesh, OctreeLosesNoLeafOfAThinTorus) {
    // Four leaves across the tube: Newton's method leads away from many a leaf's middle, and the box touches the torus.
    const PreparedScene scene = scene_of("implicit = \"torus\"\nparameters = { major = 0.75, minor = 0.25 }");
    const SurfaceTriangles t = octree_triangles(scene.objects[0], 16);
    EXPECT_EQ(t.dropped, 0U);
    EXPECT_NEAR(area_of(t.mesh) / (4 * M_PI * M_PI * 0.75 * 0.25), 1, 0.03);
}

TEST(SurfaceMesh, OctreeTakesNoPoleForLostSurface) {
    // 1/x changes its sign and has no surface to lose.
    const SurfaceTriangles pole =
        octree_triangles(scene_of("expression = \"1/(x-0.1)\"\nbounds = [[-1, -1, -1], [1, 1, 1]]").objects[0], 8);
    EXPECT_EQ(pole.dropped, 0U);
    EXPECT_EQ(pole.mesh.triangles.size(), 0U);
}

std::size_t bin(double u, std::size_t n) {
    return std::min(n - 1, static_cast<std::size_t>(std::max(0.0, u) * static_cast<double>(n)));
}

TEST(SurfaceMesh, ParticlesOfTrianglesAreUniform) {
    const PreparedScene scene = scene_of("implicit = \"torus\"");
    for (const SamplerKind kind : {SamplerKind::mesh, SamplerKind::octree}) {
        const Sources sources = make_sources(scene, kind);
        std::vector<std::int64_t> counts(48, 0);
        for (std::uint64_t i = 0; i < 100000; ++i)
            if (const auto point = sources[0]->trial({1}, 0, i)) {
                const Vec3 p = scene.camera.to_world(point->view);
                const double tube = std::atan2(p.z, std::hypot(p.x, p.y) - 1);
                ++counts[6 * bin(0.5 + (tube + 0.4 * std::sin(tube)) / (2 * M_PI), 8) +
                         bin(0.5 + std::atan2(p.y, p.x) / (2 * M_PI), 6)];
                ASSERT_NEAR(std::hypot(std::hypot(p.x, p.y) - 1, p.z), 0.4, 1e-3);
            }
        EXPECT_GT(chi2_uniformity(counts)->p_value, 1e-4);
        // The same V as random lines find, but for the wasted ones: area over pixel area.
        const double pixel = scene.camera.pixel_size() * scene.camera.pixel_size();
        EXPECT_NEAR(sources[0]->virtual_pixels() * pixel, 4 * M_PI * M_PI * 0.4, 5e-3 * 4 * M_PI * M_PI * 0.4);
    }
}

// ---- Counting spheres

constexpr double kPixelArea = 1e-4;

OpacityControl control(const UniformPoints& places, double opacity, double radius, std::uint32_t spheres) {
    return control_by_counting(places, opacity, kPixelArea, {.spheres = spheres, .radius = radius}, 2, {11});
}

TEST(CountingSpheres, AreRightOnASphereOfAnyRadius) {
    const PreparedScene scene = scene_of("implicit = \"sphere\"");
    const UniformPoints places(scene.objects[0], 0);
    for (const double radius : {0.05, 0.2, 0.6})
        for (const double opacity : {0.01, 0.5, 0.99}) {
            const OpacityControl c = control(places, opacity, radius, 400);
            // n·spheres particles were counted.
            const double n = -std::log1p(-opacity) * M_PI * radius * radius / kPixelArea * 400;
            EXPECT_NEAR(c.counted_density / c.exact_density, 1, 5 / std::sqrt(n) + 0.002) << radius << ' ' << opacity;
            EXPECT_EQ(c.exact_opacity, opacity);
        }
}

TEST(CountingSpheres, MissWhereCurvaturesDifferAtEdgesAndBesideASecondSheet) {
    // A cylinder of radius 1 and r: a/πr² = 1 + r²/32; far from its ends for r << 1.
    const PreparedScene tall = scene_of("implicit = \"cylinder\"\nparameters = { height = 40.0 }");
    const double ratio = control({tall.objects[0], 0}, 0.9, 0.8, 2000).mean_area_ratio;
    const double ends = 1 - 0.8 * 0.8 * (2.0 / 3.0) * 2 / (M_PI * 0.8 * 40);  // mean part of a disc beyond an end, twice
    EXPECT_NEAR(ratio, (1 + 0.64 / 32) * ends, 0.008);

    // A square of side 2: within r of an edge a sphere holds less. ∫ of the disc's part inside, over the square.
    const PreparedScene card = scene_of("rectangle = { u = [1, 0, 0], v = [0, 1, 0] }");
    constexpr double r = 0.3;
    // Exactly: mean a = πr² − (perimeter/area)·(2/3)r³ + (corners/area)·r⁴/2·…: by pairs of points at most r apart.
    const double pairs = M_PI * r * r - 4.0 / 4 * 2 * (2.0 / 3) * r * r * r + r * r * r * r / 2 / 4;
    EXPECT_NEAR(control({card.objects[0], 0}, 0.9, r, 3000).mean_area_ratio, pairs / (M_PI * r * r), 0.01);

    // Two sheets a tenth of a radius apart.
    const PreparedScene sheets = scene_of("expression = \"z^2-0.0001\"\nbounds = [[-1, -1, -1], [1, 1, 1]]");
    const OpacityControl c = control({sheets.objects[0], 0}, 0.5, 0.2, 500);
    EXPECT_GT(c.mean_area_ratio, 1.75);
    EXPECT_NEAR(c.counted_opacity, -std::expm1(std::log(0.5) / c.mean_area_ratio), 1e-3);  // (1) and its limit
}

TEST(CountingSpheres, MeanCountIsWorthWhatItIsSaidToBe) {
    // Two sheets a quarter of a radius apart: nearly every point lies in as many spheres, so a fixed number of points tells more
    // than n independent counts would.
    const PreparedScene scene = scene_of("expression = \"z*(z - 0.1)\"\nbounds = [[-1, -1, -0.3], [1, 1, 0.3]]");
    const UniformPoints surface(scene.objects[0], 0);
    std::vector<Vec3> centers;
    for (int i = 0; i < 12; ++i)
        for (int k = 0; k < 12; ++k) centers.emplace_back(0.14 * (i - 5.5), 0.14 * (k - 5.5), 0);
    constexpr std::size_t kPoints = 2000;
    constexpr double kRadius = 0.4;
    MeanVariance means;
    constexpr int kSeeds = 300;
    for (std::uint64_t seed = 0; seed < kSeeds; ++seed) means.add(counts_in_spheres(surface, kPoints, centers, kRadius, {1000 + seed}).mean());
    const double worth = means.mean() * means.mean() / means.variance();
    EXPECT_NEAR(worth / independent_points(surface, kPoints, centers, kRadius), 1, 4 * std::sqrt(2.0 / kSeeds));
    EXPECT_GT(worth, 1.5 * kPoints);
}

TEST(CountingSpheres, ChangeTheNumberOfParticlesByTheirRatio) {
    const PreparedScene scene = scene_of("expression = \"z^2-0.0001\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nopacity = 0.3");
    const Sources exact = make_sources(scene, SamplerKind::lines);
    const Sources counted = make_sources(scene, SamplerKind::lines, {.counting_spheres = true, .counting = {.radius = 0.6}});
    const double ratio = mean_trials(*counted[0], TrialLaw::poisson) / mean_trials(*exact[0], TrialLaw::poisson);
    EXPECT_GT(ratio, 0.45);
    EXPECT_LT(ratio, 0.85);
    EXPECT_EQ(counted[0]->virtual_pixels(), exact[0]->virtual_pixels());
}

}  // namespace
}  // namespace pellucid
