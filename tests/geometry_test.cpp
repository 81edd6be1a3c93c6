// Every kind of patch against brute force: equations written here again, sampled densely along lines.
#include "scene/geometry.hpp"

#include <functional>

#include "core/error.hpp"
#include "field/catalogue.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

struct Implicit {
    const char* name;
    std::map<std::string, double> parameters;
    std::function<double(const Vec3&)> f;
};

double sq(double v) { return v * v; }

std::vector<Implicit> implicits() {
    return {
        {"sphere", {{"radius", 0.8}}, [](const Vec3& p) { return dot(p, p) - 0.64; }},
        {"ellipsoid", {{"a", 1.2}, {"b", 0.3}, {"c", 0.6}}, [](const Vec3& p) { return sq(p.x / 1.2) + sq(p.y / 0.3) + sq(p.z / 0.6) - 1; }},
        {"torus", {}, [](const Vec3& p) { return sq(std::hypot(p.x, p.y) - 1) + p.z * p.z - 0.16; }},
        {"torus", {{"major", 1}, {"minor", 0.02}}, [](const Vec3& p) { return sq(std::hypot(p.x, p.y) - 1) + p.z * p.z - 4e-4; }},
        {"torus", {{"major", 0.4}, {"minor", 0.7}}, [](const Vec3& p) { return sq(std::hypot(p.x, p.y) - 0.4) + p.z * p.z - 0.49; }},
        {"plane", {}, [](const Vec3& p) { return p.z; }},
        {"cylinder", {{"radius", 0.5}, {"height", 1.5}}, [](const Vec3& p) { return sq(p.x) + sq(p.y) - 0.25; }},
        {"cone", {{"radius", 0.7}, {"height", 1.2}}, [](const Vec3& p) { return sq(p.x) + sq(p.y) - sq(0.7 / 1.2 * p.z); }},
        {"paraboloid", {{"radius", 0.9}, {"height", 1.1}}, [](const Vec3& p) { return sq(p.x) + sq(p.y) - 0.81 / 1.1 * p.z; }},
        {"saddle", {{"a", 0.8}, {"b", 1.1}}, [](const Vec3& p) { return sq(p.x / 0.8) - sq(p.y / 1.1) - p.z; }},
        {"hyperboloid", {}, [](const Vec3& p) { return (sq(p.x) + sq(p.y)) / 0.25 - sq(p.z) / 0.25 - 1; }},
        {"hyperboloid_two_sheets", {}, [](const Vec3& p) { return (sq(p.x) + sq(p.y)) / 0.25 - sq(p.z) / 0.0625 + 1; }},
    };
}

Affine placement(int i) {
    Affine map;
    if (i == 1) map.linear = Mat3(Vec3(0.6, 0.8, 0), Vec3(-0.8, 0.6, 0), Vec3(0, 0, -1));             // turned, mirrored
    if (i == 2) map.linear = Mat3(Vec3(2, 0.3, 0), Vec3(0.5, 0.7, -0.2), Vec3(0.1, -0.4, 1.5));       // sheared
    if (i != 0) map.offset = {0.3, -2, 1};
    return map;
}

Surface implicit_surface(const Implicit& shape, const Affine& to_world) {
    Surface s;
    s.name = shape.name;
    s.shape = ImplicitShape{shape.name, shape.parameters};
    s.to_world = to_world;
    return s;
}

/// Sign changes of g on [0, 1] at 4000 places, each bisected.
std::vector<double> brute_crossings(const std::function<double(double)>& g) {
    constexpr int kSteps = 4000;
    std::vector<double> roots;
    double before = g(0);
    for (int i = 1; i <= kSteps; ++i) {
        const double now = g(static_cast<double>(i) / kSteps);
        if ((before >= 0) != (now >= 0)) {
            double lo = static_cast<double>(i - 1) / kSteps, hi = static_cast<double>(i) / kSteps;
            for (int k = 0; k < 60; ++k) {
                const double mid = 0.5 * (lo + hi);
                ((g(mid) >= 0) == (now >= 0) ? hi : lo) = mid;
            }
            roots.push_back(hi);
        }
        before = now;
    }
    return roots;
}

TEST(ImplicitGeometry, CrossingsAndNormalsAreThoseOfTheEquation) {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> u(-1, 1);
    for (const Implicit& shape : implicits())
        for (int place = 0; place < 3; ++place) {
            SCOPED_TRACE(fmt::format("{} placement {}", shape.name, place));
            const Affine to_world = placement(place);
            const Affine to_object = to_world.inverse();
            const auto geometry = make_geometry(implicit_surface(shape, to_world));
            const Box box = CatalogueSurface(shape.name, shape.parameters).bounds();
            const Box world_box = geometry->bounds();
            int found = 0;
            for (int i = 0; i < 150; ++i) {
                // Between two points around the box, in object space.
                const auto around = [&] { return box.center() + 0.9 * box.size() * Vec3(u(random), u(random), u(random)); };
                const Vec3 a = around();
                const Vec3 b = around();
                const Line line{to_world.point(a), to_world.vector(b - a), 0, 1};
                CrossingList hits;
                const int count = geometry->crossings(0, line, hits);
                ASSERT_LE(count, geometry->max_crossings());
                std::vector<double> expected;
                bool doubtful = false;
                for (const double t : brute_crossings([&](double at) { return shape.f(a + at * (b - a)); })) {
                    const Vec3 p = a + t * (b - a);
                    const Vec3 from = glm::max(box.lo - p, p - box.hi);  // > 0: outside
                    const double outside = std::max({from.x, from.y, from.z});
                    const bool bounded = std::string(shape.name) == "sphere" || shape.name == std::string("ellipsoid") ||
                                         shape.name == std::string("torus");
                    if (bounded || outside < -1e-7) {
                        expected.push_back(t);
                    } else if (outside < 1e-7) {
                        doubtful = true;
                    }
                }
                if (doubtful) continue;
                // Brute force cannot see a pair closer than its step; it never sees more than there are.
                ASSERT_GE(count, static_cast<int>(expected.size()));
                if (count != static_cast<int>(expected.size())) {
                    EXPECT_EQ((count - static_cast<int>(expected.size())) % 2, 0);
                    bool close_pair = false;
                    for (int k = 0; k + 1 < count; ++k)
                        close_pair = close_pair || hits[static_cast<std::size_t>(k) + 1].t - hits[static_cast<std::size_t>(k)].t < 5e-4;
                    EXPECT_TRUE(close_pair) << count << " for " << expected.size();
                    continue;
                }
                for (std::size_t k = 0; k < expected.size(); ++k) {
                    ++found;
                    EXPECT_NEAR(hits[k].t, expected[k], 1e-8);
                    const Vec3 world = line.origin + hits[k].t * line.direction;
                    for (int axis = 0; axis < 3; ++axis) {
                        EXPECT_GE(world[axis], world_box.lo[axis] - 1e-8);
                        EXPECT_LE(world[axis], world_box.hi[axis] + 1e-8);
                    }
                    // Outward: towards growing f, in world space.
                    Vec3 gradient;
                    for (int axis = 0; axis < 3; ++axis) {
                        Vec3 step(0.0);
                        step[axis] = 1e-6;
                        gradient[axis] = shape.f(to_object.point(world + step)) - shape.f(to_object.point(world - step));
                    }
                    EXPECT_LT(length(normalize(gradient) - normalize(hits[k].normal)), 2e-5);
                }
            }
            EXPECT_GT(found, 30);
        }
}

TEST(ImplicitGeometry, ExcludesOnlyPartsWithoutSurface) {
    std::mt19937_64 random(2);
    std::uniform_real_distribution<double> unit(0, 1);
    for (const Implicit& shape : implicits()) {
        SCOPED_TRACE(shape.name);
        const Affine to_world = placement(1);
        const Affine to_object = to_world.inverse();
        const auto geometry = make_geometry(implicit_surface(shape, to_world));
        const Body whole = geometry->body(0);
        int excluded = 0;
        for (int i = 0; i < 2000; ++i) {
            Body part = whole;
            for (int axis = 0; axis < 3; ++axis) {
                const double size = std::pow(unit(random), 2);
                part.corner += (1 - size) * unit(random) * whole.edge[axis];
                part.edge[axis] *= size;
            }
            if (!geometry->excludes(0, part)) continue;
            ++excluded;
            int above = 0;
            for (int k = 0; k < 64; ++k) {
                const Vec3 p = part.corner + (k & 1 ? unit(random) : k >> 5 & 1) * part.edge[0] +
                               (k & 2 ? unit(random) : k >> 4 & 1) * part.edge[1] + (k & 4 ? unit(random) : k >> 3 & 1) * part.edge[2];
                above += shape.f(to_object.point(p)) > 0 ? 1 : 0;
            }
            EXPECT_TRUE(above == 0 || above == 64) << above;
        }
        EXPECT_GT(excluded, 100);
    }
}

TEST(ImplicitGeometry, ThinTorusKeepsItsCrossings) {
    for (const double minor : {1e-2, 1e-3, 1e-4, 1e-5}) {
        const Implicit shape{"torus", {{"major", 1}, {"minor", minor}}, nullptr};
        const auto geometry = make_geometry(implicit_surface(shape, Affine{}));
        CrossingList hits;
        int right = 0;
        for (int i = 0; i < 200; ++i) {
            const double phi = 0.1 + 0.03 * i;
            const Vec3 dir(std::cos(phi), std::sin(phi), 0);
            const Line through{2.0 * dir + Vec3(0, 0, 0.3 * minor), -dir, 0, 4};
            const int count = geometry->crossings(0, through, hits);
            right += count == 4 && std::abs(hits[0].t - (1 - minor * std::sqrt(1 - 0.09))) < 1e-3 * minor ? 1 : 0;
        }
        EXPECT_EQ(right, 200) << "minor = " << minor;
    }
}

// ---- isosurfaces

struct Volume3 {
    std::array<int, 3> size;
    std::vector<float> values;
    [[nodiscard]] double operator()(const Vec3& p) const {
        const glm::ivec3 n(size[0], size[1], size[2]);
        const glm::ivec3 base = glm::clamp(glm::ivec3(glm::floor(p)), glm::ivec3(0), n - 2);
        double sum = 0;
        for (int c = 0; c < 8; ++c) {
            const glm::ivec3 at = base + glm::ivec3(c & 1, c >> 1 & 1, c >> 2);
            double weight = 1;
            for (int axis = 0; axis < 3; ++axis) {
                const double f = p[axis] - base[axis];
                weight *= at[axis] > base[axis] ? f : 1 - f;
            }
            sum += weight * static_cast<double>(values[static_cast<std::size_t>(at.x + n.x * (at.y + n.y * at.z))]);
        }
        return sum;
    }
};

std::unique_ptr<SurfaceGeometry> isosurface(const fs::path& folder, const Volume3& volume, double isovalue,
                                            const Affine& to_world = {}) {
    Surface s;
    s.name = "iso";
    s.shape = IsosurfaceShape{put_volume(folder / "v.nrrd", volume.size, volume.values), isovalue};
    s.to_world = to_world;
    return make_geometry(s);
}

std::vector<double> all_crossings(const SurfaceGeometry& geometry, const Line& line) {
    std::vector<double> t;
    CrossingList hits;
    for (std::size_t patch = 0; patch < geometry.patch_count(); ++patch) {
        const int count = geometry.crossings(patch, line, hits);
        for (int i = 0; i < count; ++i) t.push_back(hits[static_cast<std::size_t>(i)].t);
    }
    std::sort(t.begin(), t.end());
    return t;
}

TEST(IsosurfaceGeometry, CrossingsAreThoseOfTheTrilinearField) {
    const fs::path folder = test_folder();
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> unit(0, 1);
    const Volume3 volume{{4, 5, 3}, sampled({4, 5, 3}, [&](const Vec3&) { return unit(random); })};
    for (int place = 0; place < 3; ++place) {
        const Affine to_world = placement(place);
        const auto geometry = isosurface(folder, volume, 0.5, to_world);
        for (int i = 0; i < 200; ++i) {
            const Vec3 hull(3, 4, 2);
            const Vec3 a = hull * Vec3(unit(random), unit(random), unit(random));
            const Vec3 b = hull * Vec3(unit(random), unit(random), unit(random));
            const auto g = [&](double t) { return volume(a + t * (b - a)) - 0.5; };
            const std::vector<double> expected = brute_crossings(g);
            const std::vector<double> found = all_crossings(*geometry, {to_world.point(a), to_world.vector(b - a), 0, 1});
            if (found.size() != expected.size()) {  // a pair closer than brute force can see
                EXPECT_GT(found.size(), expected.size());
                EXPECT_EQ((found.size() - expected.size()) % 2, 0U);
                continue;
            }
            for (std::size_t k = 0; k < found.size(); ++k) EXPECT_NEAR(found[k], expected[k], 1e-9);
        }
        CrossingList hits;
        const Affine to_object = to_world.inverse();
        for (std::size_t patch = 0; patch < geometry->patch_count(); ++patch) {
            std::array<Vec3, 8> corners;
            geometry->body(patch).vertices(corners);
            const Line diagonal{corners[0], corners[7] - corners[0], 0, 1};
            const int count = geometry->crossings(patch, diagonal, hits);
            for (std::size_t k = 0; k < static_cast<std::size_t>(count); ++k) {
                Vec3 gradient;
                for (int axis = 0; axis < 3; ++axis) {
                    Vec3 step(0.0);
                    step[axis] = 1e-6;
                    const Vec3 p = diagonal.origin + hits[k].t * diagonal.direction;
                    gradient[axis] = volume(to_object.point(p + step)) - volume(to_object.point(p - step));
                }
                EXPECT_LT(length(normalize(gradient) - normalize(hits[k].normal)), 1e-4);
            }
        }
    }
}

TEST(IsosurfaceGeometry, EveryLineCrossesAsOftenAsItsEndsDiffer) {
    // A crossing lost or doubled between neighbouring cells breaks the parity. Integer data puts a third of
    // the samples on the isovalue exactly.
    const fs::path folder = test_folder();
    for (const bool integers : {false, true}) {
        std::mt19937_64 random(4);
        std::uniform_real_distribution<double> unit(0, 1);
        const Volume3 volume{{4, 4, 4}, sampled({4, 4, 4}, [&](const Vec3&) { return integers ? std::floor(3 * unit(random)) : 2 * unit(random); })};
        const auto geometry = isosurface(folder, volume, 1);
        int odd = 0, wrong = 0;
        CrossingList hits;
        for (int i = 0; i < 500000; ++i) {
            const Vec3 a = 3.0 * Vec3(unit(random), unit(random), unit(random));
            Vec3 b = 3.0 * Vec3(unit(random), unit(random), unit(random));
            if (i % 5 == 0) b[i / 5 % 3] = a[i / 5 % 3];  // within a plane of samples' direction
            const double at_a = volume(a) - 1;
            const double at_b = volume(b) - 1;
            if (std::min(std::abs(at_a), std::abs(at_b)) < 1e-9) continue;
            int crossings = 0;
            for (std::size_t patch = 0; patch < geometry->patch_count(); ++patch)
                crossings += geometry->crossings(patch, {a, b - a, 0, 1}, hits);
            const bool differ = (at_a > 0) != (at_b > 0);
            odd += differ ? 1 : 0;
            wrong += (crossings % 2 == 1) != differ ? 1 : 0;
        }
        EXPECT_EQ(wrong, 0) << (integers ? "integers" : "reals");
        EXPECT_GT(odd, 50000);
    }
}

TEST(IsosurfaceGeometry, PlateausOnFacesAreCrossedOnce) {
    const fs::path folder = test_folder();
    const Volume3 step{{5, 4, 4}, sampled({5, 4, 4}, [](const Vec3& p) { return p.x >= 2 ? 1 : 0; })};
    const auto geometry = isosurface(folder, step, 1);
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    for (int i = 0; i < 20000; ++i) {
        const Vec3 a(1.9 * unit(random), 3 * unit(random), 3 * unit(random));
        const Vec3 b(2.1 + 1.9 * unit(random), 3 * unit(random), 3 * unit(random));
        const auto t = all_crossings(*geometry, {a, b - a, 0, 1});
        ASSERT_EQ(t.size(), 1U);
        ASSERT_NEAR((a + t[0] * (b - a)).x, 2, 1e-9);
    }
}

TEST(IsosurfaceGeometry, CellsWithNaNAreEmptyAndOthersStay) {
    const fs::path folder = test_folder();
    Volume3 ramp{{5, 5, 5}, sampled({5, 5, 5}, [](const Vec3& p) { return p.z; })};
    ramp.values[static_cast<std::size_t>(2 + 5 * (2 + 5 * 1))] = std::nanf("");
    testing::internal::CaptureStderr();
    const auto geometry = isosurface(folder, ramp, 1.5);
    EXPECT_NE(testing::internal::GetCapturedStderr().find("8 cells"), std::string::npos);
    EXPECT_EQ(geometry->patch_count(), 12U);  // 16 in the layer, less the four around the voxel
    EXPECT_EQ(all_crossings(*geometry, {{0.5, 0.5, -1}, {0, 0, 10}, 0, 1}).size(), 1U);
    EXPECT_EQ(all_crossings(*geometry, {{2.5, 2.5, -1}, {0, 0, 10}, 0, 1}).size(), 0U);
}

TEST(IsosurfaceGeometry, OneSliceHasNoSurfaceAndIsWarnedOf) {
    const fs::path folder = test_folder();
    testing::internal::CaptureStderr();
    const auto geometry = isosurface(folder, {{4, 4, 1}, sampled({4, 4, 1}, [](const Vec3& p) { return p.x; })}, 1.5);
    EXPECT_NE(testing::internal::GetCapturedStderr().find("no cell"), std::string::npos);
    EXPECT_EQ(geometry->patch_count(), 0U);
}

// ---- flat patches

/// Solves a + t d = corner + u e0 + v e1 by Cramer's rule.
Vec3 solve(const Line& line, const Vec3& corner, const Vec3& e0, const Vec3& e1) {
    return glm::inverse(Mat3(e0, e1, -line.direction)) * (line.origin - corner);
}

TEST(MeshGeometry, CrossingsAreThoseOfThePlaneWithinTheTriangle) {
    const fs::path folder = test_folder();
    Surface s;
    s.name = "m";
    s.shape = MeshShape{put_sphere_mesh(folder / "m.ply", 4)};
    s.to_world = placement(2);
    const auto geometry = make_geometry(s);
    std::mt19937_64 random(6);
    std::uniform_real_distribution<double> u(-1, 1);
    int found = 0;
    for (int i = 0; i < 3000; ++i) {
        const auto around = [&] { return s.to_world.point(2.0 * Vec3(u(random), u(random), u(random))); };
        const Vec3 a = around();
        const Line line{a, around() - a, 0, 1};
        for (std::size_t patch = 0; patch < geometry->patch_count(); ++patch) {
            const Body body = geometry->body(patch);
            const Vec3 at = solve(line, body.corner, body.edge[0], body.edge[1]);
            const double margin = std::min({at.x, at.y, 1 - at.x - at.y, at.z, 1 - at.z});
            if (std::abs(margin) < 1e-9) continue;
            CrossingList hits;
            const int count = geometry->crossings(patch, line, hits);
            ASSERT_EQ(count, margin > 0 ? 1 : 0);
            if (count == 0) continue;
            ++found;
            EXPECT_NEAR(hits[0].t, at.z, 1e-9);
            EXPECT_LT(length(cross(normalize(hits[0].normal), normalize(cross(body.edge[0], body.edge[1])))), 1e-9);
        }
        // The ball is convex and closed.
        EXPECT_LE(all_crossings(*geometry, line).size(), 2U);
    }
    EXPECT_GT(found, 500);
}

TEST(RectangleGeometry, CrossingsAreThoseOfThePlaneWithinTheEdges) {
    Surface s;
    s.shape = RectangleShape{{0.1, 0.2, 0.3}, {1, 0.2, 0}, {-0.3, 0.8, 0.4}, std::nullopt};
    s.to_world = placement(2);
    const auto geometry = make_geometry(s);
    const Body body = geometry->body(0);
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> u(-1, 1);
    int found = 0;
    for (int i = 0; i < 20000; ++i) {
        const auto around = [&] { return s.to_world.point(2.0 * Vec3(u(random), u(random), u(random))); };
        const Vec3 a = around();
        const Line line{a, around() - a, 0, 1};
        const Vec3 at = solve(line, body.corner, body.edge[0], body.edge[1]);
        const double margin = std::min({at.x, at.y, 1 - at.x, 1 - at.y, at.z, 1 - at.z});
        if (std::abs(margin) < 1e-9) continue;
        CrossingList hits;
        ASSERT_EQ(geometry->crossings(0, line, hits), margin > 0 ? 1 : 0);
        found += margin > 0 ? 1 : 0;
    }
    EXPECT_GT(found, 1000);
}

TEST(Geometry, ParallelLinesAndMissedIntervalsCrossNothing) {
    Surface s;
    s.shape = RectangleShape{};
    const auto rectangle = make_geometry(s);
    CrossingList hits;
    EXPECT_EQ(rectangle->crossings(0, {{-2, 0, 0}, {1, 0, 0}, 0, 9}, hits), 0);
    EXPECT_EQ(rectangle->crossings(0, {{0, 0, 1}, {0, 0, -1}, 0, 0.5}, hits), 0);
    EXPECT_EQ(rectangle->crossings(0, {{0, 0, 1}, {0, 0, -1}, 1.5, 9}, hits), 0);
    s.shape = ImplicitShape{"sphere", {}};
    const auto sphere = make_geometry(s);
    EXPECT_EQ(sphere->crossings(0, {{0, 0, 3}, {0, 0, -1}, 0, 9}, hits), 2);
    EXPECT_EQ(sphere->crossings(0, {{0, 0, 3}, {0, 0, -1}, 3, 9}, hits), 1);
    EXPECT_EQ(sphere->crossings(0, {{0, 0, 3}, {0, 0, -1}, 5, 9}, hits), 0);
    EXPECT_EQ(sphere->crossings(0, {{0, 2, 3}, {0, 0, -1}, 0, 9}, hits), 0);
}

}  // namespace
}  // namespace pellucid
