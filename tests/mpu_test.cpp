#include "field/mpu.hpp"

#include <cmath>
#include <functional>
#include <numbers>

#include <gtest/gtest.h>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "field/mpu_cells.hpp"
#include "field/mpu_gradients.hpp"
#include "field/mpu_lines.hpp"
#include "simd_targets.hpp"

namespace pellucid {
namespace {

/// Fibonacci's points on the unit sphere, each mapped to a place and a normal.
std::vector<OrientedPoint> points_on(std::size_t count, const std::function<std::pair<Vec3, Vec3>(const Vec3&)>& map) {
    std::vector<OrientedPoint> points;
    for (std::size_t i = 0; i < count; ++i) {
        const double z = 1 - 2 * (static_cast<double>(i) + 0.5) / static_cast<double>(count);
        const double angle = static_cast<double>(i) * 2.399963229728653;
        const double r = std::sqrt(1 - z * z);
        const auto [place, normal] = map({r * std::cos(angle), r * std::sin(angle), z});
        const Vec3 n = normalize(normal);
        points.push_back({place, {static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)}});
    }
    return points;
}

std::vector<OrientedPoint> sphere(std::size_t count) {
    return points_on(count, [](const Vec3& p) { return std::pair(p, p); });
}
std::vector<OrientedPoint> ellipsoid(std::size_t count) {
    return points_on(count, [](const Vec3& p) { return std::pair(p * Vec3(1, 0.7, 0.5), p / Vec3(1, 0.7, 0.5)); });
}
/// The faces of [−1, 1]³, n × n points each, none on an edge.
std::vector<OrientedPoint> cube(int n) {
    std::vector<OrientedPoint> points;
    for (int face = 0; face < 6; ++face)
        for (int j = 0; j < n; ++j)
            for (int i = 0; i < n; ++i) {
                Vec3 p;
                OrientedPoint point;
                const double side = (face & 1) != 0 ? 1 : -1;
                p[face / 2] = side;
                p[(face / 2 + 1) % 3] = (2 * i + 1.0) / n - 1;
                p[(face / 2 + 2) % 3] = (2 * j + 1.0) / n - 1;
                point.position = p;
                point.normal[static_cast<std::size_t>(face / 2)] = static_cast<float>(side);
                points.push_back(point);
            }
    return points;
}

TEST(Mpu, FitsASphereWithItsNormals) {
    const MpuField field(sphere(20000));
    for (const OrientedPoint& p : sphere(777)) {  // not the points of the fit
        EXPECT_NEAR(field.value(p.position), 0, 1e-3);
        EXPECT_GT(dot(normalize(field.gradient(p.position)), p.position), 0.999);
        EXPECT_LT(field.value(0.95 * p.position), 0);
        EXPECT_GT(field.value(1.03 * p.position), 0);
    }
}

TEST(Mpu, DerivativesAreThoseOfDifferences) {
    const MpuField field(ellipsoid(5000), {.sharp = false});
    for (const OrientedPoint& p : ellipsoid(101)) {
        const Vec3 x = p.position + Vec3(0.013, -0.007, 0.011);
        const FieldJet jet = field.jet(x);
        EXPECT_NEAR(jet.value, field.value(x), 1e-13);
        const double h = 1e-6;
        for (int a = 0; a < 3; ++a) {
            Vec3 step(0.0);
            step[a] = h;
            EXPECT_NEAR(jet.gradient[a], (field.value(x + step) - field.value(x - step)) / (2 * h), 1e-6);
            const Vec3 second = (field.gradient(x + step) - field.gradient(x - step)) / (2 * h);
            for (int b = 0; b < 3; ++b)
                EXPECT_NEAR(jet.hessian_matrix()[a][b], second[b], 1e-3 * (1 + std::abs(second[b])));
        }
    }
}

TEST(Mpu, RangesHoldWhatIsInTheBox) {
    const MpuField field(ellipsoid(3000));
    std::vector<std::uint32_t> leaves;
    for (const OrientedPoint& p : ellipsoid(60)) {
        for (const double half : {0.1, 0.01, 0.001}) {
            const Vec3 c = field.to_unit(p.position);
            const Box box{c - half, c + half};
            field.leaves_at(box, leaves);
            const MpuRange range = field.range(leaves, box);
            for (const OrientedPoint& q : sphere(50)) {
                const Vec3 x = field.bounds().lo + field.size() * (c + half * q.position);
                const FieldJet jet = field.jet(x);
                EXPECT_GE(jet.value / field.size(), range.value.lo);
                EXPECT_LE(jet.value / field.size(), range.value.hi);
                for (int a = 0; a < 3; ++a) {
                    EXPECT_GE(jet.gradient[a], range.gradient[static_cast<std::size_t>(a)].lo);
                    EXPECT_LE(jet.gradient[a], range.gradient[static_cast<std::size_t>(a)].hi);
                }
            }
        }
    }
}

TEST(Mpu, SharpFitsKeepTheEdgesOfACube) {
    const MpuField sharp(cube(24), {});
    const MpuField smooth(cube(24), {.sharp = false});
    double sharp_off = 0;
    double smooth_off = 0;
    for (int i = 0; i < 40; ++i) {
        const Vec3 edge(1, 1, -0.8 + 0.04 * i);
        sharp_off += std::abs(sharp.value(edge));
        smooth_off += std::abs(smooth.value(edge));
    }
    EXPECT_LT(sharp_off, 0.2 * smooth_off);
}

TEST(Mpu, TheSameForAnyNumberOfThreads) {
    set_thread_count(1);
    const MpuField one(ellipsoid(4000));
    const MpuCells one_cells(one);
    set_thread_count(0);
    const MpuField many(ellipsoid(4000));
    const MpuCells many_cells(many);
    ASSERT_EQ(one_cells.count(), many_cells.count());
    for (std::size_t i = 0; i < one_cells.count(); ++i)
        EXPECT_EQ(one_cells.cell(i).tight.lo, many_cells.cell(i).tight.lo);
    for (const OrientedPoint& p : ellipsoid(50)) EXPECT_EQ(one.value(1.01 * p.position), many.value(1.01 * p.position));
}

TEST(Mpu, TooFewDifferentPointsAreRefused) {
    auto points = sphere(14);
    for (const std::vector<OrientedPoint>& few : {std::vector<OrientedPoint>(), sphere(3), points}) {
        try {
            (void)MpuField(few);
            ADD_FAILURE() << few.size();
        } catch (const Error& e) {
            EXPECT_EQ(e.kind(), Failure::input);
            EXPECT_NE(std::string(e.what()).find("at least 15"), std::string::npos);
        }
    }
    for (int i = 0; i < 50; ++i) points.push_back(points[0]);
    EXPECT_THROW((void)MpuField(points), Error);
}

TEST(Mpu, TurnedOverPointsHaveTheSameSurface) {
    auto points = ellipsoid(3000);
    const MpuField field(points);
    for (OrientedPoint& p : points)
        for (float& n : p.normal) n = -n;
    const MpuField turned(points);
    for (const OrientedPoint& p : ellipsoid(40)) EXPECT_NEAR(turned.value(p.position), -field.value(p.position), 1e-6);
}

std::string refusal_of(const std::vector<OrientedPoint>& points) {
    try {
        (void)MpuField(points);
    } catch (const Error& e) {
        EXPECT_EQ(e.kind(), Failure::input);
        return e.what();
    }
    return "";
}

// A tolerance by the box of all points would be as large as the sphere itself.
TEST(Mpu, AnOutlierDoesNotTakeTheToleranceWithIt) {
    auto points = sphere(5000);
    points.push_back({{1000, 0, 0}, {1, 0, 0}});
    testing::internal::CaptureStderr();
    const MpuField field(points);
    const std::string said = testing::internal::GetCapturedStderr();
    EXPECT_NE(said.find("points: 1 of 5001 lie farther than 2 widths from the others"), std::string::npos) << said;
    for (const OrientedPoint& p : sphere(333)) {
        EXPECT_NEAR(field.value(p.position), 0, 3e-3);
        EXPECT_GT(dot(normalize(field.gradient(p.position)), p.position), 0.99);
    }
    testing::internal::CaptureStderr();
    (void)MpuField(ellipsoid(500));
    (void)MpuField(cube(8));
    EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

TEST(Mpu, NormalsInThePlaneOfThePointsAreRefused) {
    std::vector<OrientedPoint> points;
    for (int j = 0; j < 20; ++j)
        for (int i = 0; i < 20; ++i) points.push_back({{0.1 * i, 0.1 * j, 0}, {0.6F, 0.8F, 0}});
    EXPECT_NE(refusal_of(points).find("normals lie in the surface"), std::string::npos);
    for (OrientedPoint& p : points) p.normal = {0, 0, 1};
    EXPECT_EQ(refusal_of(points), "");
    // Meridians of a sphere.
    auto ball = sphere(2000);
    for (OrientedPoint& p : ball) {
        const Vec3 east = normalize(Vec3(-p.position.y, p.position.x, 0));
        p.normal = {static_cast<float>(east.x), static_cast<float>(east.y), 0};
    }
    EXPECT_NE(refusal_of(ball).find("normals lie in the surface"), std::string::npos);
}

TEST(Mpu, PointsOfALineAreRefused) {
    std::vector<OrientedPoint> points;
    for (int i = 0; i < 500; ++i) points.push_back({{0.1 * i, 0.02 * i + 1, -0.3 * i}, {0, 0, 1}});
    EXPECT_NE(refusal_of(points).find("along a line"), std::string::npos);
}

TEST(MpuCells, LinesCrossAClosedSurfaceInPairsWhereItIs) {
    const MpuField field(ellipsoid(3000));
    const MpuCells cells(field);
    IsolationStats stats;
    std::size_t crossed = 0;
    for (const OrientedPoint& p : sphere(60)) {
        const Vec3 through(0.1 * p.position.y, -0.2 * p.position.z, 0.1 * p.position.x);
        std::vector<FieldRoot> roots;
        for (std::size_t i = 0; i < cells.count(); ++i) cells.cross(i, through, p.position, -3, 3, roots, stats);
        ASSERT_EQ(roots.size(), 2U);
        for (const FieldRoot& root : roots) {
            const Vec3 x = through + root.t * p.position;
            const Vec3 unit = x / Vec3(1, 0.7, 0.5);
            EXPECT_NEAR(length(unit), 1, 0.01);
            EXPECT_NEAR(field.value(x), 0, 1e-12);
            EXPECT_LT(length(field.gradient(x) - root.gradient), 1e-6);
        }
        crossed += roots.size();
    }
    EXPECT_EQ(crossed, 120U);
}

TEST(MpuCells, GradientsOfManyPlacesEqualThoseOfOneOnEveryInstructionSet) {
    const MpuField field(ellipsoid(3000));
    const MpuCells cells(field);
    std::size_t compared = 0;
    for (std::size_t i = 0; i < cells.count(); i += 1 + cells.count() / 50) {
        const MpuCell& cell = cells.cells()[i];
        if (cell.sharp) continue;
        const SurfaceCell box = cells.cell(i);
        std::array<Vec3, kMpuPlaces> at;
        MpuPlaces places;
        for (std::size_t lane = 0; lane < kMpuPlaces; ++lane) {
            // Some beyond the cell, where fewer leaves of its list reach.
            const double share = -1 + 0.4 * static_cast<double>(lane);
            at[lane] = box.tight.lo + share * box.tight.size();
            const Vec3 x = field.to_unit(at[lane]);
            for (std::size_t k = 0; k < 3; ++k) places[k][lane] = x[static_cast<int>(k)];
        }
        for (const std::int64_t target : simd_targets()) {
            const ChosenTarget chosen(target);
            const MpuPlaces got = mpu_gradients(field.leaves().data(), cells.leaves_of(cell), places);
            for (std::size_t lane = 0; lane < kMpuPlaces; ++lane) {
                const Vec3 expected = mpu_gradient(field, cells.leaves_of(cell), at[lane]);
                for (std::size_t k = 0; k < 3; ++k) {
                    ASSERT_EQ(got[k][lane], expected[static_cast<int>(k)]) << hwy::TargetName(target);
                    ++compared;
                }
            }
        }
    }
    EXPECT_GT(compared, 1000U);
}

TEST(MpuCells, LinesHaveTheSameRootsForAnyNeighboursOnEveryInstructionSet) {
    const MpuField field(ellipsoid(3000));
    const MpuCells cells(field);
    constexpr std::size_t kLines = 301;
    for (std::size_t axis = 0; axis < 3; ++axis) {
        std::vector<std::uint32_t> cell;
        std::array<std::vector<double>, 3> at;
        std::vector<double> lo, hi;
        for (std::size_t i = 0; cell.size() < kLines; i = (i + 7) % cells.count()) {
            if (!cells.cells()[i].monotone(axis)) continue;
            const SurfaceCell box = cells.cell(i);
            const double share = static_cast<double>(cell.size()) / kLines;
            cell.push_back(static_cast<std::uint32_t>(i));
            for (std::size_t k = 0; k < 3; ++k) {
                const auto a = static_cast<int>(k);
                at[k].push_back(box.tight.lo[a] + (k == 0 ? share : 1 - share) * box.tight.size()[a]);
            }
            lo.push_back(box.tight.lo[static_cast<int>(axis)]);
            hi.push_back(box.tight.hi[static_cast<int>(axis)]);
        }
        struct Found {
            std::vector<double> root = std::vector<double>(kLines, 0);
            std::array<std::vector<double>, 3> gradient{std::vector<double>(kLines, 0), std::vector<double>(kLines, 0),
                                                        std::vector<double>(kLines, 0)};
        };
        const auto cross = [&](std::size_t begin, std::size_t end, Found& out) {
            AxisLines lines{axis, end - begin, cell.data() + begin, {}, lo.data() + begin, hi.data() + begin};
            AxisRoots roots{out.root.data() + begin, {}};
            for (std::size_t k = 0; k < 3; ++k) {
                lines.at[k] = at[k].data() + begin;
                roots.gradient[k] = out.gradient[k].data() + begin;
            }
            cells.cross_along(lines, roots);
        };
        Found single;
        for (std::size_t i = 0; i < kLines; ++i) cross(i, i + 1, single);
        std::size_t met = 0;
        for (const std::int64_t target : simd_targets()) {
            const ChosenTarget chosen(target);
            Found batch;
            cross(0, 5, batch);
            cross(5, kLines, batch);
            for (std::size_t i = 0; i < kLines; ++i) {
                ASSERT_EQ(std::isnan(single.root[i]), std::isnan(batch.root[i])) << hwy::TargetName(target);
                if (std::isnan(single.root[i])) continue;
                ++met;
                ASSERT_EQ(single.root[i], batch.root[i]) << hwy::TargetName(target);
                for (std::size_t k = 0; k < 3; ++k) ASSERT_EQ(single.gradient[k][i], batch.gradient[k][i]);
                Vec3 place(at[0][i], at[1][i], at[2][i]);
                place[static_cast<int>(axis)] = single.root[i];
                EXPECT_NEAR(field.value(place), 0, 1e-10);
            }
        }
        EXPECT_GT(met, 100U);
    }
}

TEST(MpuCells, WhereThereAreNoPointsThereIsNoSurface) {
    auto points = sphere(4000);
    std::erase_if(points, [](const OrientedPoint& p) { return p.position.z > 0.5; });
    const MpuField field(points);
    const MpuCells cells(field);
    ASSERT_GT(cells.count(), 0U);
    const double spacing = std::sqrt(4 * std::numbers::pi / 4000);
    for (std::size_t i = 0; i < cells.count(); ++i) EXPECT_LT(cells.cell(i).tight.lo.z, 0.5 + 6 * spacing);
}

}  // namespace
}  // namespace pellucid
