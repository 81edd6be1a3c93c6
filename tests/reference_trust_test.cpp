// What `reference_trust` measures, at toy size with known answers; and each of its tests rejects what is
// wrong.
#include <set>

#include "core/parallel.hpp"
#include "scene_testing.hpp"
#include "study/trust_closed_form.hpp"
#include "study/trust_images.hpp"
#include "study/trust_meshes.hpp"
#include "study/trust_parity.hpp"
#include "study/trust_restart.hpp"
#include "study/trust_roots.hpp"

namespace pellucid {
namespace {

using testing_scenes::test_folder;

TEST(TrustMeshes, AreClosedAndHaveTheirTriangles) {
    EXPECT_EQ(icosphere(2).triangles.size(), 320U);
    EXPECT_EQ(icosphere(2).positions.size(), 162U);  // Euler: 320·3/2 edges, V − E + F = 2
    for (const TriangleMesh& mesh : {icosphere(0), icosphere(2), torus_grid(7, 5), cube_mesh(),
                                     sliver_prism(5, 1e-3), thin_plates(3, 1e-5)})
        EXPECT_TRUE(is_closed(mesh));
    TriangleMesh open = cube_mesh();
    open.triangles.pop_back();
    EXPECT_FALSE(is_closed(open));
}

/// A cube seen by its own closed form: 0 or 2 crossings by the slabs.
TEST(TrustParity, ExactCrossingsOfACubeAreThoseOfItsSlabs) {
    const TriangleMesh cube = cube_mesh();
    int met = 0;
    for (std::uint64_t i = 0; i < 2000; ++i) {
        const auto [u, v, w] = random_numbers({1}, i);
        const Ray ray{{6 * u - 3, 6 * v - 3, 6 * w - 3}, random_direction({2}, i)};
        double lo = -kInfinity, hi = kInfinity;
        for (int k = 0; k < 3; ++k) {
            const double a = (-1 - ray.origin[k]) / ray.direction[k];
            const double b = (1 - ray.origin[k]) / ray.direction[k];
            lo = std::max(lo, std::min(a, b));
            hi = std::min(hi, std::max(a, b));
        }
        ASSERT_EQ(exact_crossings(cube, ray).size(), lo < hi ? 2U : 0U) << i;
        met += lo < hi ? 1 : 0;
    }
    EXPECT_GT(met, 300);
}

TEST(TrustParity, ExactCrossingsAreEvenThroughVerticesEdgesAndFaces) {
    // Of integers, so that rays hit exactly what they are aimed at: corners, edges, diagonals, along and in
    // faces.
    const TriangleMesh cube = cube_mesh();
    std::set<std::size_t> counts;
    for (int x = -2; x <= 2; ++x)
        for (int y = -2; y <= 2; ++y)
            for (int z = -2; z <= 2; ++z)
                for (int a = -2; a <= 2; ++a)
                    for (int b = -2; b <= 2; ++b)
                        for (int c = -2; c <= 2; ++c) {
                            if (a == 0 && b == 0 && c == 0) continue;
                            const auto found = exact_crossings(cube, {Vec3(x, y, z), Vec3(a, b, c)});
                            counts.insert(found.size());
                        }
    EXPECT_EQ(counts, (std::set<std::size_t>{0, 2}));
}

struct MeshSetUp {
    PreparedScene scene;
    LineShooter shooter;
    explicit MeshSetUp(const TriangleMesh& mesh, const Placement& placement = {})
        : scene((write_off(test_folder() / "mesh.off", mesh),
                 mesh_for_lines(test_folder_kept() / "mesh.off", placement))),
          shooter(scene) {}
    static std::filesystem::path test_folder_kept() {
        const auto* info = testing::UnitTest::GetInstance()->current_test_info();
        return std::filesystem::path(testing::TempDir()) /
               (std::string("pellucid_") + info->test_suite_name() + "_" + info->name());
    }
    [[nodiscard]] const TriangleMesh& mesh() const { return *scene.objects[0].geometry->mesh(); }
    [[nodiscard]] Gather truth() const {
        return [this](std::span<const Ray> rays, std::vector<std::vector<RayHit>>& hits) {
            shooter.gather(rays, hits);
        };
    }
};

TEST(TrustParity, TruthFindsTheHitsOfRandomLinesAtAnyScaleAndPlace) {
    for (const double scale : {1e-6, 1.0, 1e6})
        for (const double offset : {0.0, 1e4}) {
            const MeshSetUp s(icosphere(1), {scale, offset * Vec3(1, -2, 0.5)});
            const ParityCount count =
                count_parity(s.mesh(), s.shooter, s.truth(), {Aim::random, 2000, 2000, {3}});
            EXPECT_EQ(count.checked, 2000U);
            EXPECT_EQ(count.lost + count.doubled + count.odd, 0U) << scale << " " << offset;
            // A convex body of area S: a line through the sphere around its box meets it with chance
            // S/(4πR²).
            EXPECT_NEAR(static_cast<double>(count.hits) / 4000, 12.0 / (4 * M_PI * 3) * 0.97, 0.08);
        }
}

TEST(TrustParity, CountsAreTheSameOnAnyNumberOfThreads) {
    const MeshSetUp s(torus_grid(12, 8));
    const ParityPlan plan{Aim::vertex, 10000, 100, {5}};
    const ParityCount many = count_parity(s.mesh(), s.shooter, s.truth(), plan);
    set_thread_count(1);
    EXPECT_EQ(count_parity(s.mesh(), s.shooter, s.truth(), plan), many);
    set_thread_count(0);
}

TEST(TrustParity, LostAndDoubledHitsAreSeen) {
    const MeshSetUp s(torus_grid(12, 8));
    const Gather right = s.truth();
    const auto spoiled = [&](bool lose) {
        return Gather([right, lose](std::span<const Ray> rays, std::vector<std::vector<RayHit>>& hits) {
            right(rays, hits);
            for (auto& list : hits)
                if (!list.empty() && lose)
                    list.pop_back();
                else if (!list.empty())
                    list.push_back(list.back());
        });
    };
    const ParityPlan plan{Aim::random, 500, 500, {5}};
    const ParityCount lost = count_parity(s.mesh(), s.shooter, spoiled(true), plan);
    const ParityCount doubled = count_parity(s.mesh(), s.shooter, spoiled(false), plan);
    EXPECT_GT(lost.odd, 50U);
    EXPECT_EQ(lost.lost, lost.odd);
    EXPECT_EQ(lost.odd_short, lost.odd);
    EXPECT_EQ(lost.doubled, 0U);
    EXPECT_EQ(doubled.doubled, doubled.odd);
    EXPECT_EQ(doubled.odd_short, 0U);
}

TEST(TrustParity, BoundsOfACountAreGarwoods) {
    // His table: 0 seen → [0, 3.689]; 10 seen → [4.795, 18.39].
    EXPECT_EQ(poisson_bounds(0).lo, 0);
    EXPECT_NEAR(poisson_bounds(0).hi, 3.689, 1e-3);
    EXPECT_NEAR(poisson_bounds(10).lo, 4.795, 1e-3);
    EXPECT_NEAR(poisson_bounds(10).hi, 18.390, 1e-3);
}

TEST(TrustRestart, LosesHitsBetweenThinLayersAndTheTruthDoesNot) {
    const MeshSetUp s(thin_plates(4, 1e-5));
    const RestartScene twin(s.mesh());
    const ParityPlan plan{Aim::random, 500, 500, {7}};
    const ParityCount truth = count_parity(s.mesh(), s.shooter, s.truth(), plan);
    EXPECT_EQ(truth.lost + truth.doubled, 0U);
    for (const double epsilon : {1e-4, 1e-3}) {
        const ParityCount count = count_parity(
            s.mesh(), s.shooter, [&](auto rays, auto& hits) { twin.gather(rays, epsilon, hits); }, plan);
        EXPECT_GT(count.lost, 100U) << epsilon;
    }
}

TEST(TrustRestart, IsRightWhereLayersAreFarApart) {
    // The twin is wrong by its epsilon alone: else it would be no twin.
    const MeshSetUp s(icosphere(1));
    const RestartScene twin(s.mesh());
    const ParityCount count =
        count_parity(s.mesh(), s.shooter, [&](auto rays, auto& hits) { twin.gather(rays, 1e-5, hits); },
                     {Aim::random, 500, 500, {7}});
    EXPECT_LE(count.lost + count.doubled, 1U);
    EXPECT_GT(count.hits, 300U);
}

TEST(TrustClosedForm, DepthsAreWithinTheirConditioning) {
    for (const TrustShape shape : kTrustShapes)
        for (const double offset : {0.0, 1e6}) {
            const ClosedFormResult r = measure_closed_form({.shape = shape, .offset = offset}, 256, {3});
            EXPECT_EQ(r.wrong, 0U) << name_of(shape);
            EXPECT_GT(r.hits, 50U);
            EXPECT_LT(r.worst_units, kDepthUnits) << name_of(shape) << " " << offset;
        }
}

TEST(TrustClosedForm, AWrongDepthIsSeen) {
    // 256 roundings of the depth: 3e-14 of it.
    for (const TrustShape shape : kTrustShapes)
        EXPECT_GT(measure_closed_form({.shape = shape}, 64, {3}, 256 * kRoundoff).worst_units, kDepthUnits);
}

TEST(TrustGrazing, SidesAreToldDownToTheRoundingOfTheRay) {
    for (const double offset : {0.0, 1e4})
        for (const double side : {-1.0, 1.0})
            for (const double delta : {1e-1, 1e-6, 2 * grazing_resolution(offset)}) {
                const GrazingResult r = measure_grazing(side * delta, offset, 64, {3});
                EXPECT_EQ(r.wrong, 0U) << delta;
                EXPECT_EQ(r.intended, r.rays);
                EXPECT_EQ(r.found_two, side < 0 ? r.rays : 0U);
            }
}

TEST(TrustGrazing, BelowTheRoundingOfTheRayItsSideIsNotWhatWasMeant) {
    const GrazingResult r = measure_grazing(-1e-17, 0, 400, {3});
    EXPECT_LT(r.intended, r.rays);
    EXPECT_GT(r.intended, 0U);
}

const AlgebraicSurface& surface_called(std::string_view name) {
    for (const AlgebraicSurface& surface : algebraic_surfaces())
        if (surface.name == name) return surface;
    throw std::logic_error("no such surface");
}

TEST(TrustRoots, ExactCountsOfLinesKnownByHand) {
    // 4(y² + …) along x: 4x² − 1 = 0 at ±½. The tangle cube along the axis: x⁴ − 5x² + 11.8, discriminant <
    // 0; at y = z = √2.5 (its two pairs of sheets): x⁴ − 5x² − 0.7, two real roots, −0.7 = 11.8 − 2·6.25.
    const auto count = [](std::string_view name, const RootLine& line) {
        return exact_count(surface_called(name), line);
    };
    const Vec3 along(1, 0, 0);
    EXPECT_EQ(count("Cayley cubic", {Vec3(0.0), along, -1, 1}).roots, 2);
    EXPECT_FALSE(count("Cayley cubic", {Vec3(0.0), along, -1, 1}).signs_differ);
    EXPECT_EQ(count("Cayley cubic", {Vec3(0.0), along, 0, 1}).roots, 1);
    EXPECT_TRUE(count("Cayley cubic", {Vec3(0.0), along, 0, 1}).signs_differ);
    EXPECT_EQ(count("tangle cube", {Vec3(0.0), along, -9, 9}).roots, 0);
    EXPECT_EQ(count("tangle cube", {Vec3(0, std::sqrt(2.5), std::sqrt(2.5)), along, -9, 9}).roots, 2);
    EXPECT_EQ(count("tangle cube", {Vec3(0, std::sqrt(2.5), 0), along, -9, 9}).roots, 4);  // x⁴ − 5x² + 5.55
    // Along z the Barth sextic is b(1 − …): −4·a·…·0 − b(z² − 1)²: double roots at ±1, distinct roots 2.
    EXPECT_EQ(count("Barth sextic", {Vec3(0.0), {0, 0, 1}, -2, 2}).roots, 2);
    EXPECT_FALSE(count("Barth sextic", {Vec3(0.0), {0, 0, 1}, -2, 2}).signs_differ);
}

TEST(TrustRoots, FormulasAreTheSurfacesWrittenByHand) {
    // The signs of both at random points: a wrong coefficient would turn some.
    for (const AlgebraicSurface& surface : algebraic_surfaces()) {
        const Expression f(surface.formula, surface.parameters);
        EXPECT_EQ(f.degree(), surface.degree) << surface.name;
        int turned = 0;
        for (std::uint64_t i = 0; i < 100; ++i) {
            const RootLine line = root_line(surface, RootAim::random, {8}, i);
            const bool differ =
                (f.at(line.origin) >= 0) != (f.at(line.origin + line.hi * line.direction) >= 0);
            turned += differ ? 1 : 0;
            EXPECT_EQ(exact_count(surface, line).signs_differ, differ) << surface.name;
        }
        if (surface.degree == 3) {
            EXPECT_GT(turned, 0) << surface.name;
        }
        if (surface.name == "tangle cube") {  // closed: all of the sphere around it is outside
            EXPECT_EQ(turned, 0);
        }
    }
}

TEST(TrustRoots, CertifiedCountsAreSturmsAndSamplingIsCaught) {
    std::uint64_t missed = 0;
    for (const AlgebraicSurface& surface : algebraic_surfaces())
        for (const RootAim aim : {RootAim::random, RootAim::center}) {
            const RootCounts right = count_roots(surface, certified_roots(surface), aim, 200, 40, {9});
            EXPECT_EQ(right.lines, 200U);
            EXPECT_EQ(right.checked, 40U);
            EXPECT_EQ(count_roots(surface, traced_roots(surface), aim, 40, 40, {9}).mismatched, 0U)
                << surface.name;
            EXPECT_EQ(right.mismatched, 0U) << surface.name;
            EXPECT_EQ(right.wrong_parity, 0U) << surface.name;
            EXPECT_EQ(right.above_degree, 0U) << surface.name;
            EXPECT_EQ(right.asymmetric, 0U) << surface.name;
            missed += count_roots(surface, sampled_roots(surface, 16), aim, 40, 40, {9}).mismatched;
        }
    EXPECT_GT(missed, 0U);
}

TEST(TrustRoots, TwelveLinesLieOnTheClebschCubic) {
    const AlgebraicSurface& clebsch = surface_called("Clebsch cubic");
    std::set<std::array<double, 6>> different;
    const FindRoots find = certified_roots(clebsch);
    for (RootLine line : lines_on_clebsch()) {
        const Vec3 foot = line.origin - dot(line.origin, line.direction) /
                                            dot(line.direction, line.direction) * line.direction;
        different.insert({foot.x, foot.y, foot.z, line.direction.x, line.direction.y, line.direction.z});
        EXPECT_EQ(exact_count(clebsch, line).roots, -1);
        std::vector<Root> roots;
        IsolationStats stats;
        find(line, roots, stats);
        EXPECT_TRUE(roots.empty());
        // A hair beside it the count is Sturm's.
        line.origin += 1e-9 * Vec3(1, 2, 4);
        roots.clear();
        find(line, roots, stats);
        EXPECT_EQ(static_cast<int>(roots.size()), exact_count(clebsch, line).roots);
    }
    EXPECT_EQ(different.size(), 12U);
}

TEST(TrustRoots, SpoiledRootsAreSeen) {
    const AlgebraicSurface& barth = surface_called("Barth sextic");
    const FindRoots right = certified_roots(barth);
    const auto spoiled = [&](const std::function<void(std::vector<Root>&)>& spoil, RootAim aim) {
        return count_roots(barth,
                           [&](const RootLine& line, std::vector<Root>& roots, IsolationStats& stats) {
                               right(line, roots, stats);
                               if (!roots.empty()) spoil(roots);
                           },
                           aim, 100, 100, {9});
    };
    const RootCounts lost = spoiled([](auto& roots) { roots.pop_back(); }, RootAim::random);
    EXPECT_GT(lost.mismatched, 10U);
    EXPECT_EQ(lost.wrong_parity, lost.mismatched);
    EXPECT_GT(spoiled([](auto& roots) { roots.resize(7, roots[0]); }, RootAim::random).above_degree, 10U);
    EXPECT_GT(spoiled([](auto& roots) { roots[0].t *= 1 + 1e-9; }, RootAim::center).asymmetric, 10U);
}

TEST(TrustStatedError, IsTrueAndAFactorOfTwoIsSeen) {
    const auto scenes = error_scenes(6, test_folder());
    for (const PixelFilter filter : {PixelFilter::box, PixelFilter::particle}) {
        StatedErrorPlan plan{
            .truth = {.filter = filter, .max_error = 1, .max_samples = 64}, .seeds = 64, .seed = {4}};
        const StatedError right = measure_stated_error(scenes[0].scene, plan);
        EXPECT_LT(std::abs(right.ratio - 1), 4 * right.ratio_error);
        EXPECT_LT(right.ratio_error, 0.12);
        for (const double factor : {0.5, 2.0}) {
            plan.variance_factor = factor;
            const StatedError wrong = measure_stated_error(scenes[0].scene, plan);
            EXPECT_GT(std::abs(wrong.ratio - 1), 4 * wrong.ratio_error);
        }
    }
}

TEST(TrustParticles, FilterIsWhatParticlesConvergeToAndTwinsAreRejected) {
    const auto scenes = particle_scenes(24);
    ParticlePlan plan{.repeats = 400, .seed = {5}};
    plan.truth.max_samples = 1024;
    const double level = sidak_level(0.001, 4);
    const ParticleVerdict right = judge_particles(scenes[0].scene, plan);
    EXPECT_GT(right.pixels, 100U);
    EXPECT_GT(right.smallest_p, level);
    EXPECT_LT(right.worst_z, sidak_critical_value(0.001, static_cast<double>(right.pixels)));
    EXPECT_EQ(right.drawn_where_nothing_is, 0);
    ParticlePlan off = plan;
    off.optical_depth_error = 0.05;
    EXPECT_LT(judge_particles(scenes[0].scene, off).smallest_p, level);
    ParticlePlan box = plan;
    box.truth.filter = PixelFilter::box;
    EXPECT_LT(judge_particles(scenes[0].scene, box).smallest_p, level);
}

TEST(TrustCoincident, OrderOfTheFileDoesNotMatter) {
    for (const Coincidence kind : kCoincidences) {
        const CoincidentResult r = measure_coincident(kind, 3, 4, test_folder(), {6});
        EXPECT_EQ(r.orders, 6U);
        EXPECT_LE(r.worst_ulps, 1) << r.name;
        EXPECT_LE(r.worst_theory, 0x1p-23) << r.name;
    }
}

}  // namespace
}  // namespace pellucid
