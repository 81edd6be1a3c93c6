// Volumes as functions of place, against formulas written another way and differences in long double.
#include <functional>
#include <random>

#include <gtest/gtest.h>

#include "field/iso_field.hpp"
#include "field/tricubic.hpp"
#include "field/volume_field.hpp"

namespace pellucid {
namespace {

template <class F>
std::shared_ptr<const VoxelGrid> grid_of(const std::array<int, 3>& size, const F& f) {
    auto grid = std::make_shared<VoxelGrid>();
    grid->size = size;
    for (int k = 0; k < size[2]; ++k)
        for (int j = 0; j < size[1]; ++j)
            for (int i = 0; i < size[0]; ++i) grid->values.push_back(static_cast<float>(f(Vec3(i, j, k))));
    return grid;
}

std::shared_ptr<const VoxelGrid> noise(const std::array<int, 3>& size, unsigned seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> unit(-1, 1);
    return grid_of(size, [&](const Vec3&) { return unit(random); });
}

/// Catmull and Rom's own construction (P. J. Barry, R. N. Goldman, A recursive evaluation algorithm for a
/// class of Catmull-Rom splines, 1988): three levels of straight lines between four points at −1, 0, 1, 2.
long double barry_goldman(const std::array<long double, 4>& p, long double t) {
    const auto line = [&](long double a, long double at, long double b, long double bt) {
        return ((bt - t) * a + (t - at) * b) / (bt - at);
    };
    const long double a1 = line(p[0], -1, p[1], 0), a2 = line(p[1], 0, p[2], 1), a3 = line(p[2], 1, p[3], 2);
    const long double b1 = line(a1, -1, a2, 1), b2 = line(a2, 0, a3, 2);
    return line(b1, 0, b2, 1);
}

/// The volume at any place, sample by sample, in long double.
long double oracle(const VoxelGrid& grid, const std::array<long double, 3>& x) {
    std::array<int, 3> base{};
    std::array<long double, 3> t{};
    for (std::size_t a = 0; a < 3; ++a) {
        base[a] = std::clamp(static_cast<int>(std::floor(x[a])), 0, std::max(0, grid.size[a] - 2));
        t[a] = x[a] - base[a];
    }
    const std::function<long double(std::size_t, std::array<int, 3>)> sample =
        [&](std::size_t a, std::array<int, 3> at) -> long double {
        if (a == 3) return grid.at(at[0], at[1], at[2]);
        const int last = grid.size[a] - 1;
        const auto put = [&](int n) {
            auto other = at;
            other[a] = n;
            return sample(a + 1, other);
        };
        if (last == 0) return put(0);
        if (at[a] < 0) return 2 * put(0) - put(1);
        if (at[a] > last) return 2 * put(last) - put(last - 1);
        return put(at[a]);
    };
    std::array<long double, 4> z{};
    for (int k = 0; k < 4; ++k) {
        std::array<long double, 4> y{};
        for (int j = 0; j < 4; ++j) {
            std::array<long double, 4> row{};
            for (int i = 0; i < 4; ++i)
                row[static_cast<std::size_t>(i)] =
                    sample(0, {base[0] + i - 1, base[1] + j - 1, base[2] + k - 1});
            y[static_cast<std::size_t>(j)] = barry_goldman(row, t[0]);
        }
        z[static_cast<std::size_t>(k)] = barry_goldman(y, t[1]);
    }
    return barry_goldman(z, t[2]);
}

Vec3 place_in(std::mt19937_64& random, const Box& box) {
    std::uniform_real_distribution<double> unit(0, 1);
    return box.lo + Vec3(unit(random), unit(random), unit(random)) * box.size();
}

TEST(VolumeField, CatmullRomIsBarryAndGoldmans) {
    // Continued samples are floats.
    for (const auto& [size, tolerance] :
         {std::pair(std::array<int, 3>{6, 7, 5}, 3e-6), {{2, 3, 4}, 3e-6}, {{5, 1, 4}, 3e-6}}) {
        const auto grid = noise(size, 1);
        const VolumeField field(grid, Interpolation::catmull_rom);
        std::mt19937_64 random(2);
        for (int i = 0; i < 2000; ++i) {
            const Vec3 x = place_in(random, field.hull());
            const auto cell = field.cell_of(x);
            const double expected = static_cast<double>(oracle(*grid, {x.x, x.y, x.z}));
            EXPECT_NEAR(field.value(x), expected, field.is_inside(cell) ? 1e-14 : tolerance);
            EXPECT_NEAR(field.jet(x).value, field.value(x), 1e-14);
            EXPECT_NEAR(field.value(x, 0.25), field.value(x) - 0.25, 1e-14);
        }
    }
}

TEST(VolumeField, DerivativesAreThoseOfDifferences) {
    const auto grid = noise({7, 7, 7}, 3);
    std::mt19937_64 random(4);
    for (int i = 0; i < 400; ++i) {
        // Inside, where all samples are the file's, and off the faces, at which second derivatives jump.
        Vec3 x = place_in(random, {Vec3(1), Vec3(5)});
        for (int axis = 0; axis < 3; ++axis)
            x[axis] = std::floor(x[axis]) + std::clamp(x[axis] - std::floor(x[axis]), 0.01, 0.99);
        const FieldJet jet = VolumeField(grid, Interpolation::catmull_rom).jet(x);
        const long double h = 1e-4L;
        const auto f = [&](int a, long double da, int b, long double db) {
            std::array<long double, 3> at{x.x, x.y, x.z};
            at[static_cast<std::size_t>(a)] += da;
            at[static_cast<std::size_t>(b)] += db;
            return oracle(*grid, at);
        };
        for (int a = 0; a < 3; ++a) {
            EXPECT_NEAR(jet.gradient[a], static_cast<double>((f(a, h, a, 0) - f(a, -h, a, 0)) / (2 * h)),
                        1e-6);
            for (int b = 0; b < 3; ++b) {
                const long double second =
                    a == b
                        ? (f(a, h, a, 0) - 2 * f(a, 0, a, 0) + f(a, -h, a, 0)) / (h * h)
                        : (f(a, h, b, h) - f(a, h, b, -h) - f(a, -h, b, h) + f(a, -h, b, -h)) / (4 * h * h);
                EXPECT_NEAR(jet.hessian_matrix()[a][b], static_cast<double>(second), 1e-5) << a << b;
            }
        }
    }
}

TEST(VolumeField, CatmullRomHasNoCreaseAtFacesAndTrilinearHas) {
    const auto grid = noise({6, 6, 6}, 5);
    std::mt19937_64 random(6);
    double trilinear_jump = 0;
    for (int i = 0; i < 300; ++i) {
        Vec3 x = place_in(random, {Vec3(1), Vec3(4)});
        const int axis = i % 3;
        x[axis] = std::round(x[axis]);
        Vec3 below = x;
        below[axis] = std::nextafter(x[axis], 0.0);
        const VolumeField smooth(grid, Interpolation::catmull_rom);
        EXPECT_NEAR(smooth.value(x), smooth.value(below), 1e-13);
        EXPECT_LT(length(smooth.jet(x).gradient - smooth.jet(below).gradient), 1e-13);
        const VolumeField flat(grid, Interpolation::trilinear);
        trilinear_jump = std::max(trilinear_jump, length(flat.jet(x).gradient - flat.jet(below).gradient));
    }
    EXPECT_GT(trilinear_jump, 0.1);
}

TEST(VolumeField, TrilinearIsTheSumOverCornersAndItsDerivatives) {
    const auto grid = noise({4, 5, 3}, 7);
    const VolumeField field(grid, Interpolation::trilinear);
    std::mt19937_64 random(8);
    for (int i = 0; i < 500; ++i) {
        const Vec3 x = place_in(random, field.hull());
        double sum = 0;
        for (int k = 0; k < 3; ++k)
            for (int j = 0; j < 5; ++j)
                for (int n = 0; n < 4; ++n) {
                    const auto hat = [](double d) { return std::max(0.0, 1 - std::abs(d)); };
                    sum +=
                        hat(x.x - n) * hat(x.y - j) * hat(x.z - k) * static_cast<double>(grid->at(n, j, k));
                }
        EXPECT_NEAR(field.value(x), sum, 1e-14);
        const FieldJet jet = field.jet(x);
        EXPECT_NEAR(jet.value, sum, 1e-14);
        for (int axis = 0; axis < 3; ++axis) {
            Vec3 ends[2] = {x, x};
            ends[0][axis] = std::floor(x[axis]);
            ends[1][axis] = ends[0][axis] + 1;
            EXPECT_NEAR(jet.gradient[axis], field.value(ends[1]) - field.value(ends[0]), 1e-13);
            EXPECT_EQ(jet.hessian[static_cast<std::size_t>(axis)], 0);
        }
    }
}

TEST(VolumeField, LinearVolumesAreExactToTheirBorder) {
    const auto f = [](const Vec3& x) { return 1 + 2 * x.x - 3 * x.y + 0.5 * x.z; };
    for (const std::array<int, 3>& size : {std::array<int, 3>{4, 5, 6}, {2, 2, 2}, {1, 3, 2}})
        for (const Interpolation kind : {Interpolation::trilinear, Interpolation::catmull_rom}) {
            const VolumeField field(grid_of(size, f), kind);
            std::mt19937_64 random(9);
            for (int i = 0; i < 300; ++i) {
                const Vec3 x = place_in(random, field.hull());
                EXPECT_NEAR(field.value(x), f(x), 1e-13);
                if (size[0] > 1) {
                    EXPECT_LT(length(field.jet(x).gradient - Vec3(2, -3, 0.5)), 1e-12);
                }
            }
            EXPECT_NEAR(field.value(field.hull().hi), f(field.hull().hi), 1e-13);
        }
}

TEST(VolumeField, QuadraticVolumesAreExactInsideForCatmullRom) {
    const auto f = [](const Vec3& x) { return x.x * x.x + 0.5 * x.y * x.y - x.z * x.z + x.x * x.y - 3; };
    const VolumeField field(grid_of({7, 7, 7}, f), Interpolation::catmull_rom);
    std::mt19937_64 random(10);
    for (int i = 0; i < 300; ++i) {
        const Vec3 x = place_in(random, {Vec3(1), Vec3(5)});
        EXPECT_NEAR(field.value(x), f(x), 1e-12);
        EXPECT_LT(length(field.jet(x).gradient - Vec3(2 * x.x + x.y, x.y + x.x, -2 * x.z)), 1e-12);
    }
}

TEST(VolumeField, NoValueOutsideNorBesideASampleThatIsNone) {
    auto grid = std::make_shared<VoxelGrid>(*noise({8, 8, 8}, 11));
    grid->values[grid->index(4, 4, 4)] = std::numeric_limits<float>::quiet_NaN();
    for (const auto& [kind, reach] :
         {std::pair(Interpolation::trilinear, 1.0), {Interpolation::catmull_rom, 2.0}}) {
        const VolumeField field(grid, kind);
        std::mt19937_64 random(12);
        for (int i = 0; i < 2000; ++i) {
            const Vec3 x = place_in(random, field.hull());
            const Vec3 off = glm::abs(x - Vec3(4.0));
            EXPECT_EQ(std::isnan(field.value(x)), std::max({off.x, off.y, off.z}) < reach);
            EXPECT_EQ(std::isnan(field.jet(x).value), std::isnan(field.value(x)));
        }
        for (const Vec3& x :
             {Vec3(-1e-9, 1, 1), Vec3(1, 7.0001, 1), Vec3(1, 1, kInfinity), Vec3(std::nan(""), 1, 1)})
            EXPECT_TRUE(std::isnan(field.value(x)));
    }
}

TEST(VolumeField, NearestIsTheSampleBeside) {
    const auto grid = noise({3, 4, 5}, 13);
    const VolumeField field(grid, Interpolation::nearest);
    EXPECT_EQ(field.value({0.49, 2.51, 4}), static_cast<double>(grid->at(0, 3, 4)));
    EXPECT_EQ(field.jet({1, 1, 1}).gradient, Vec3(0.0));
}

TEST(VolumeField, APlateauOfTheIsovalueIsExactlyZero) {
    const auto grid = grid_of({6, 6, 6}, [](const Vec3& x) { return x.x < 2.5 ? 0.1F : 0.7F; });
    std::mt19937_64 random(14);
    for (const Interpolation kind : {Interpolation::trilinear, Interpolation::catmull_rom}) {
        const VolumeField field(grid, kind);
        for (int i = 0; i < 300; ++i) {
            Vec3 x = place_in(random, field.hull());
            x.x = 2;
            EXPECT_EQ(field.value(x, static_cast<double>(0.1F)), 0);
        }
    }
}

// ---- control points

TEST(Tricubic, PartsAreTheSamePolynomialAndBoundsHoldIt) {
    std::mt19937_64 random(16);
    for (unsigned i = 0; i < 1000; ++i) {
        const VolumeField field(noise({4, 4, 4}, i), Interpolation::catmull_rom);
        const double isovalue = i % 2 == 0 ? 0.1 : 0.4;
        const Tricubic whole = Tricubic::in_cell(field.samples_around({1, 1, 1}), isovalue);
        Vec3 lo = place_in(random, {Vec3(0.0), Vec3(1.0)});
        Vec3 hi = place_in(random, {Vec3(0.0), Vec3(1.0)});
        for (int axis = 0; axis < 3; ++axis)
            if (lo[axis] > hi[axis]) std::swap(lo[axis], hi[axis]);
        const Tricubic part = whole.part(lo, hi);
        // The first and the last control point are values.
        EXPECT_NEAR(part.b[0], field.value(Vec3(1.0) + lo, isovalue), 1e-13);
        EXPECT_NEAR(part.b[63], field.value(Vec3(1.0) + hi, isovalue), 1e-13);
        const Box zeros = part.zeros();
        for (int n = 0; n < 50; ++n) {
            const Vec3 share = place_in(random, {Vec3(0.0), Vec3(1.0)});
            const FieldJet jet = field.jet(Vec3(1.0) + lo + share * (hi - lo), isovalue);
            EXPECT_GE(jet.value, part.range().lo);
            EXPECT_LE(jet.value, part.range().hi);
            for (int axis = 0; axis < 3; ++axis) {
                const double width = hi[axis] - lo[axis];
                EXPECT_GE(jet.gradient[axis] * width, part.slope(axis).lo);
                EXPECT_LE(jet.gradient[axis] * width, part.slope(axis).hi);
                const double bend = jet.hessian[static_cast<std::size_t>(axis)] * width * width;
                EXPECT_GE(bend, part.bend(axis).lo);
                EXPECT_LE(bend, part.bend(axis).hi);
            }
        }
        // Outside of the box of zeros, along any way that stays there, the sign is one.
        if (zeros.empty()) {
            EXPECT_EQ(part.b[0] >= 0, part.b[63] >= 0);
            continue;
        }
        for (int axis = 0; axis < 3; ++axis)
            for (const bool above : {false, true}) {
                const double from = above ? zeros.hi[axis] : 0;
                const double to = above ? 1 : zeros.lo[axis];
                int positive = 0;
                for (int n = 0; n < 50; ++n) {
                    Vec3 share = place_in(random, {Vec3(0.0), Vec3(1.0)});
                    share[axis] = from + share[axis] * (to - from);
                    positive += field.value(Vec3(1.0) + lo + share * (hi - lo), isovalue) >= 0 ? 1 : 0;
                }
                if (from < to) {
                    EXPECT_EQ(positive % 50, 0);
                }
            }
    }
}

// ---- isosurfaces as fields

TEST(IsoField, ExcludesNoBoxWithAZeroAndMostOthers) {
    for (const Interpolation kind : {Interpolation::trilinear, Interpolation::catmull_rom}) {
        const auto volume = std::make_shared<VolumeField>(
            grid_of({30, 21, 19},
                    [](const Vec3& x) { return length(x - Vec3(15, 10, 9)) + 0.3 * std::sin(2 * x.x); }),
            kind);
        const IsoField field(volume, 6.0);
        std::mt19937_64 random(17);
        std::uniform_real_distribution<double> unit(0, 1);
        int excluded = 0, empty = 0;
        for (int i = 0; i < 4000; ++i) {
            const Vec3 lo = place_in(random, {Vec3(-2), volume->hull().hi});
            const double width = 4 * unit(random) * unit(random) * unit(random);
            const Box box{lo, lo + width * Vec3(unit(random), unit(random), unit(random))};
            bool negative = false, positive = false;
            for (int n = 0; n < 60; ++n) {
                const double f = field.value(place_in(random, box));
                negative = negative || f < 0;
                positive = positive || f >= 0;
            }
            const bool sure = field.excludes(box);
            if (negative && positive) {
                EXPECT_FALSE(sure);
            }
            empty += negative && positive ? 0 : 1;
            excluded += sure ? 1 : 0;
        }
        EXPECT_GT(excluded, 0.9 * empty);
        EXPECT_FALSE(field.excludes(volume->hull()));
        EXPECT_TRUE(field.excludes({Vec3(-3), Vec3(-1)}));
        EXPECT_TRUE(IsoField(volume, 100).excludes(volume->hull()));
        EXPECT_EQ(field.value({15, 10, 9}), volume->value({15, 10, 9}, 6.0));
    }
}

TEST(IsoField, KnowsThatCatmullRomGoesBeyondItsSamples) {
    // Beside a step the cubic falls below both plateaus by some 7 %.
    const auto volume = std::make_shared<VolumeField>(
        grid_of({8, 4, 4}, [](const Vec3& x) { return x.x < 3.5 ? 0.0 : 1.0; }), Interpolation::catmull_rom);
    EXPECT_FALSE(IsoField(volume, -0.05).excludes(volume->hull()));
    EXPECT_TRUE(IsoField(volume, -0.17).excludes(volume->hull()));  // a sixth: the control points
    const auto flat = std::make_shared<VolumeField>(
        grid_of({8, 4, 4}, [](const Vec3& x) { return x.x < 3.5 ? 0.0 : 1.0; }), Interpolation::trilinear);
    EXPECT_TRUE(IsoField(flat, -0.05).excludes(flat->hull()));
}

}  // namespace
}  // namespace pellucid
