// Cells of formulas: nothing of the surface is lost, doubled or told wrong, and the work has a limit.
#include "field/field_cells.hpp"

#include <algorithm>
#include <cmath>

#include <boost/multiprecision/cpp_bin_float.hpp>

#include "core/real.hpp"
#include "field_scenes.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

constexpr FieldCellLimits kFew{.wanted = 1 << 9, .most = 1 << 13};

FieldCells cells_of(const FieldCase& c) {
    return {Expression(c.text), c.bounds, kFew};
}

/// The line origin + t·direction from lo to hi.
struct Segment {
    Vec3 origin, direction;
    double lo = 0, hi = 0;
};

/// The part of a line that is in the cells' outermost box; lo >= hi where there is none.
Segment within(const FieldCells& cells, const Vec3& origin, const Vec3& direction) {
    Segment s{origin, direction, -INFINITY, INFINITY};
    for (int axis = 0; axis < 3; ++axis) {
        const double first = cells.plane(axis, 0);
        const double last = cells.plane(axis, FieldCells::kPlanes);
        if (direction[axis] == 0) {
            if (!(origin[axis] >= first && origin[axis] < last)) s.hi = -INFINITY;
            continue;
        }
        const double a = (first - origin[axis]) / direction[axis];
        const double b = (last - origin[axis]) / direction[axis];
        s.lo = std::max(s.lo, std::min(a, b));
        s.hi = std::min(s.hi, std::max(a, b));
    }
    return s;
}

class Lines {
public:
    Lines(const FieldCells& cells, std::uint64_t seed) : cells_(cells), random_(seed) {}

    Vec3 place(double beyond = 0) {
        std::uniform_real_distribution<double> unit(-beyond, 1 + beyond);
        const Box& b = cells_.bounds();
        return b.lo + Vec3(unit(random_), unit(random_), unit(random_)) * b.size();
    }
    Segment any() {
        const Vec3 from = place(0.3);
        return within(cells_, from, place(0.3) - from);
    }
    /// Along an axis, through a plane of the octree, or through two corners of cells.
    Segment nasty() {
        const auto corner = [&] {
            Vec3 p;
            for (int axis = 0; axis < 3; ++axis)
                p[axis] = cells_.plane(axis, static_cast<std::uint32_t>(random_() % 17)
                                                 << (FieldCells::kDepth - 4));
            return p;
        };
        Vec3 from = place();
        switch (random_() % 4) {
            case 0: {
                Vec3 along(0.0);
                along[static_cast<int>(random_() % 3)] = random_() % 2 == 0 ? 1 : -1;
                return within(cells_, from, along);
            }
            case 1: {
                Vec3 to = place();
                const auto axis = static_cast<int>(random_() % 3);
                from[axis] = to[axis] = corner()[axis];
                return within(cells_, from, to - from);
            }
            case 2: {
                const Vec3 a = corner();
                return within(cells_, a, corner() - a);
            }
            default: {
                const Vec3 a = corner();
                return within(cells_, a, place() - a);
            }
        }
    }
    std::mt19937_64& random() { return random_; }

private:
    const FieldCells& cells_;
    std::mt19937_64 random_;
};

std::vector<double> crossed(const FieldCells& cells, const Segment& s) {
    std::vector<FieldRoot> roots;
    IsolationStats stats;
    for (const FieldCell& cell : cells.cells())
        cells.cross(cell, s.origin, s.direction, s.lo, s.hi, roots, stats);
    std::vector<double> t;
    for (const FieldRoot& root : roots) t.push_back(root.t);
    std::sort(t.begin(), t.end());
    return t;
}

bool positive_at(const FieldCells& cells, const Segment& s, double t) {
    return cells.field().at(s.origin + t * s.direction) >= 0;
}

std::string text(const Vec3& v) {
    return fmt::format("[{:.17g} {:.17g} {:.17g}]", v.x, v.y, v.z);
}

class EveryField : public testing::TestWithParam<FieldCase> {};

TEST_P(EveryField, NoSurfaceIsOutsideOfTheCells) {
    const FieldCells cells = cells_of(GetParam());
    const RootIsolator isolator(cells.field());
    Lines lines(cells, 1);
    IsolationStats stats;
    int asked = 0;
    for (int i = 0; i < 1500; ++i) {
        const Segment s = lines.any();
        if (!(s.lo < s.hi)) continue;
        std::vector<Root> roots;
        isolator.isolate(s.origin, s.direction, s.lo, s.hi, roots, stats);
        for (const Root& root : roots) {
            const Vec3 x = s.origin + root.t * s.direction;
            const double room = 1e-12 * (length(cells.bounds().size()) + length(x));
            const bool inside =
                std::any_of(cells.cells().begin(), cells.cells().end(), [&](const FieldCell& cell) {
                    return glm::all(glm::greaterThanEqual(x, cell.tight.lo - room)) &&
                           glm::all(glm::lessThanEqual(x, cell.tight.hi + room));
                });
            ASSERT_TRUE(inside) << x.x << ' ' << x.y << ' ' << x.z;
            ++asked;
        }
    }
    EXPECT_GT(asked, std::string(GetParam().name) == "speck" ? -1 : 100);
}

TEST_P(EveryField, LinesHaveTheSameRootsInTheCellsAsBefore) {
    const FieldCells cells = cells_of(GetParam());
    const RootIsolator isolator(cells.field());
    Lines lines(cells, 2);
    std::size_t met = 0;
    for (int i = 0; i < 400; ++i) {
        const Segment s = lines.any();
        if (!(s.lo < s.hi)) continue;
        std::vector<Root> roots;
        IsolationStats stats;
        isolator.isolate(s.origin, s.direction, s.lo, s.hi, roots, stats);
        const std::vector<double> found = crossed(cells, s);
        ASSERT_EQ(found.size(), roots.size()) << fmt::format(
            "line {}, undecided {}, roots at {} and {}, {} + t·{}", i, stats.undecided, fmt::join(found, " "),
            roots.empty() ? NAN : roots[0].t, text(s.origin), text(s.direction));
        for (std::size_t k = 0; k < roots.size(); ++k)
            ASSERT_NEAR(found[k], roots[k].t, roots[k].touching ? 1e-6 : 1e-9) << "line " << i;
        met += found.size();
    }
    EXPECT_GE(met, std::string(GetParam().name) == "speck" ? 0U : 50U);
}

TEST_P(EveryField, NastyLinesCrossAsOftenAsTheSignsAtTheirEndsSay) {
    if (!GetParam().continuous) return;  // signs change at poles and gaps, too;
    const FieldCells cells = cells_of(GetParam());
    Lines lines(cells, 3);
    for (int i = 0; i < 800; ++i) {
        const Segment s = i % 2 == 0 ? lines.nasty() : lines.any();
        if (!(s.lo < s.hi)) continue;
        std::vector<Root> touching;
        IsolationStats stats;
        // What only touches has no say in it: the cells give it beside what crosses.
        RootIsolator(cells.field()).isolate(s.origin, s.direction, s.lo, s.hi, touching, stats);
        if (std::any_of(touching.begin(), touching.end(), [](const Root& r) { return r.touching; })) continue;
        const bool changes = positive_at(cells, s, s.lo) != positive_at(cells, s, s.hi);
        const auto found = crossed(cells, s);
        ASSERT_EQ(found.size() % 2 == 1, changes)
            << "line " << i << ": " << text(s.origin) << " + t·" << text(s.direction) << ", " << found.size()
            << " crossings, " << touching.size() << " roots";
    }
}

TEST_P(EveryField, GradientsAreWithinTheirBounds) {
    const FieldCells cells = cells_of(GetParam());
    Lines lines(cells, 4);
    std::uniform_real_distribution<double> unit(0, 1);
    for (const FieldCell& cell : cells.cells()) {
        if (!cell.continuous) continue;
        for (int k = 0; k < 3; ++k) {
            const Vec3 x =
                cell.tight.lo +
                Vec3(unit(lines.random()), unit(lines.random()), unit(lines.random())) * cell.tight.size();
            const Vec3 g = cells.field().gradient_at(x);
            for (int axis = 0; axis < 3; ++axis) {
                const Interval& bound = cell.gradient[static_cast<std::size_t>(axis)];
                if (!std::isfinite(g[axis])) {
                    EXPECT_FALSE(std::isfinite(bound.reach()));
                    continue;
                }
                // g itself is rounded: cancellation of terms as large as those of the polynomials above.
                const double room = 1e-11 * (1 + length(g));
                ASSERT_GE(g[axis], bound.lo - room);
                ASSERT_LE(g[axis], bound.hi + room);
            }
        }
    }
}

TEST_P(EveryField, NoLineAlongAnAxisHasMoreRootsThanSaid) {
    const FieldCells cells = cells_of(GetParam());
    const RootIsolator isolator(cells.field());
    Lines lines(cells, 5);
    std::uniform_real_distribution<double> unit(0, 1);
    const std::size_t step = std::max<std::size_t>(1, cells.cells().size() / 400);
    for (std::size_t i = 0; i < cells.cells().size(); i += step) {
        const FieldCell& cell = cells.cells()[i];
        for (int axis = 0; axis < 3; ++axis) {
            const int most = cells.most_roots(cell, axis);
            ASSERT_GE(most, 0);
            ASSERT_LE(most, FieldCells::kMostRoots);
            if (most == FieldCells::kMostRoots) continue;
            for (int k = 0; k < 4; ++k) {
                Vec3 x =
                    cell.tight.lo + Vec3(unit(lines.random()), unit(lines.random()), unit(lines.random())) *
                                        cell.tight.size();
                x[axis] = 0;
                Vec3 along(0.0);
                along[axis] = 1;
                std::vector<Root> roots;
                IsolationStats stats;
                isolator.isolate(x, along, cell.tight.lo[axis], cell.tight.hi[axis], roots, stats);
                ASSERT_LE(roots.size(), static_cast<std::size_t>(most)) << "cell " << i << " axis " << axis;
            }
        }
    }
}

TEST_P(EveryField, CellsTouchButDoNotOverlap) {
    const FieldCells cells = cells_of(GetParam());
    double volume = 0;
    for (const FieldCell& cell : cells.cells()) {
        double part = 1;
        for (const std::uint32_t extent : cell.extent) part *= static_cast<double>(extent) / FieldCells::kPlanes;
        volume += part;
        const Box whole = cells.box(cell);
        for (int axis = 0; axis < 3; ++axis) {
            const std::uint32_t base = cell.base[static_cast<std::size_t>(axis)];
            const std::uint32_t extent = cell.extent[static_cast<std::size_t>(axis)];
            ASSERT_EQ(base % extent, 0U);
            ASSERT_LE(base + extent, FieldCells::kPlanes);
            ASSERT_LE(whole.lo[axis], cell.tight.lo[axis]);
            ASSERT_LE(cell.tight.lo[axis], cell.tight.hi[axis]);
            ASSERT_LE(cell.tight.hi[axis], whole.hi[axis]);
        }
    }
    EXPECT_LE(volume, 1);
    EXPECT_LE(cells.cells().size(), 2 * kFew.most);  // few cells around points may come on top
}

INSTANTIATE_TEST_SUITE_P(FieldCells, EveryField, testing::ValuesIn(field_cases()), [](const auto& instance) {
    std::string name = instance.param.name;
    std::replace(name.begin(), name.end(), ' ', '_');
    return name;
});

// A plane that rounding puts an ulp beside one of the octree's: every line across it meets it once.
TEST(FieldCells, PlanesBesideThoseOfTheOctreeHaveNoHoles) {
    std::mt19937_64 random(6);
    std::uniform_real_distribution<double> unit(-1, 1);
    for (int i = 0; i < 60; ++i) {
        const double lo = std::round(50 * unit(random)) / 10 - 6;
        const double hi = lo + std::round(20 + 10 * unit(random)) / 10;
        const double middle = lo + (hi - lo) * (i % 3 == 0 ? 0.5 : i % 3 == 1 ? 0.25 : 0.375);
        for (const double at : {std::nextafter(middle, lo), middle, std::nextafter(middle, hi)}) {
            const FieldCells cells(Expression(fmt::format("x-({:.17g})", at)), {{lo, -1, -1}, {hi, 1, 1}},
                                   {.wanted = 64, .most = 512});
            for (int k = 0; k < 60; ++k) {
                const Vec3 from(lo - 1.0 - unit(random), unit(random), unit(random));
                const Vec3 to(hi, unit(random), unit(random));
                const Segment s = within(cells, from, to - from);
                if (!(s.lo < s.hi) || s.origin.x + s.lo * s.direction.x > at ||
                    s.origin.x + s.hi * s.direction.x < at)
                    continue;
                ASSERT_EQ(crossed(cells, s).size(), 1U) << at << " in " << lo << " … " << hi;
            }
        }
    }
}

// √x at x = 0, a plane of the octree: places that rounding puts at x < 0 are no change of sign.
TEST(FieldCells, EdgesOfTheDomainAreNoSurface) {
    for (const char* text : {"sqrt(x)+1+0*y", "sqrt(x)-y", "log(1+sqrt(x))+y"}) {
        const FieldCells cells(Expression(text), cube(1), kFew);
        const RootIsolator isolator(cells.field());
        Lines lines(cells, 9);
        for (int i = 0; i < 4000; ++i) {
            const Segment s = lines.any();
            if (!(s.lo < s.hi)) continue;
            std::vector<Root> roots;
            IsolationStats stats;
            isolator.isolate(s.origin, s.direction, s.lo, s.hi, roots, stats);
            ASSERT_EQ(crossed(cells, s).size(), roots.size()) << text << " line " << i;
        }
    }
}

// ---- from far away, through the geometry

TEST(FieldGeometry, LinesFromAMillionSizesAwayMeetTheSphereTwice) {
    Surface surface;
    surface.name = "s";
    surface.shape = ExpressionShape{"x^2+y^2+z^2-1"};
    surface.bounds = cube(1.1);
    const auto geometry = make_geometry(surface);
    std::mt19937_64 random(7);
    std::normal_distribution<double> normal;
    int met = 0;
    for (int i = 0; i < 150; ++i) {
        const Vec3 away = normalize(Vec3(normal(random), normal(random), normal(random)));
        const Vec3 target = 0.6 * Vec3(normal(random), normal(random), normal(random));
        const Line line{1e6 * away, target - 1e6 * away, 0, 2};
        CrossingList hits;
        std::vector<double> t;
        for (std::size_t p = 0; p < geometry->patch_count(); ++p) {
            (void)geometry->crossings(p, line, hits);
            for (const Crossing& hit : hits.hits) t.push_back(hit.t);
        }
        std::sort(t.begin(), t.end());
        // |o + t d|² = 1
        using Wide = boost::multiprecision::cpp_bin_float_50;
        const auto inner = [](const Vec3& u, const Vec3& v) {
            return Wide(Wide(u.x) * v.x + Wide(u.y) * v.y + Wide(u.z) * v.z);
        };
        const Wide a = inner(line.direction, line.direction);
        const Wide b = inner(line.origin, line.direction) / a;
        const Wide under = b * b - (inner(line.origin, line.origin) - 1) / a;
        if (abs(under) * a < 1e-5) continue;  // grazing
        ASSERT_EQ(t.size(), under > 0 ? 2U : 0U) << i;
        if (t.empty()) continue;
        ++met;
        EXPECT_NEAR(t[0], static_cast<double>(-b - sqrt(under)), 1e-14);
        EXPECT_NEAR(t[1], static_cast<double>(-b + sqrt(under)), 1e-14);
    }
    EXPECT_GT(met, 40);
}

TEST(FieldGeometry, NormalsAreUsableHoweverSmallOrLargeTheFormulaIs) {
    for (const char* text : {"1e-200*(x^2+y^2+z^2-1)", "1e200*(x^2+y^2+z^2-1)", "x^2+y^2+z^2-1"}) {
        Surface surface;
        surface.name = "s";
        surface.shape = ExpressionShape{text};
        surface.bounds = cube(1.1);
        const auto geometry = make_geometry(surface);
        CrossingList hits;
        int met = 0;
        for (std::size_t p = 0; p < geometry->patch_count(); ++p) {
            (void)geometry->crossings(p, {{0.1, 0.2, 3}, {0.1, 0.05, -1}, 0, 10}, hits);
            for (const Crossing& hit : hits.hits) {
                const Vec3 x = Vec3(0.1, 0.2, 3) + hit.t * Vec3(0.1, 0.05, -1);
                EXPECT_GT(std::abs(dot(normalize(hit.normal), x)), 1 - 1e-9) << text;
                ++met;
            }
        }
        EXPECT_EQ(met, 2) << text;
    }
}

// ---- limits

TEST(FieldCells, ConstantAndUndefinedFieldsHaveNoSurface) {
    for (const char* text : {"1", "-1", "log(-1-x^2)", "sqrt(-1-y^2)", "0*x+2", "x-x+1", "1/0.5+abs(z)"})
        EXPECT_TRUE(FieldCells(Expression(text), cube(1)).cells().empty()) << text;
    // Nowhere is f = 0 a surface: no line has a crossing.
    for (const char* text : {"0", "x-x", "x*0"}) {
        const FieldCells cells(Expression(text), cube(1), kFew);
        EXPECT_LE(cells.cells().size(), kFew.most + 8) << text;
        Lines lines(cells, 8);
        for (int i = 0; i < 20; ++i) EXPECT_TRUE(crossed(cells, lines.any()).empty()) << text;
    }
}

TEST(FieldCells, WorkIsBounded) {
    std::string sum = "x";
    for (int i = 0; i < 3000; ++i)
        sum += fmt::format("+{}*sin({}*x*y+{}*z)", 1.0 / (1 + i % 97), 1 + i % 13, i);
    for (const std::string& text :
         {sum, std::string("sin(1000*x)*sin(1000*y)*sin(1000*z)"), std::string("sin(1e9*x)+sin(1e9*y*z)"),
          std::string("tan(1000*x)*tan(1000*y)+log(z)")}) {
        const FieldCells cells(Expression(text), cube(1), {.wanted = 1 << 12, .most = 1 << 15});
        EXPECT_FALSE(cells.cells().empty());
        EXPECT_LE(cells.cells().size(), std::size_t{1} << 17);
    }
}

TEST(FieldCells, BoundsOfAnySize) {
    for (const double size : {1e-30, 1e-100, 1e30, 1e100}) {
        const FieldCells cells(Expression(fmt::format("(x/{0})^2+(y/{0})^2+(z/{0})^2-1", size)),
                               cube(1.1 * size), kFew);
        EXPECT_GT(cells.cells().size(), 100U) << size;
        for (int i = 0; i < 50; ++i) {
            const double y = size * (i - 25) / 30.0;
            const Segment s = within(cells, {0.1 * size, y, 0}, {0, 0.1 * size, size});
            EXPECT_EQ(crossed(cells, s).size(), 2U) << size;
        }
    }
    // Much too small a sphere, or much too large, for its bounds.
    EXPECT_LE(FieldCells(Expression("x^2+y^2+z^2-1"), cube(1e150), kFew).cells().size(), kFew.most + 8);
    EXPECT_TRUE(FieldCells(Expression("x^2+y^2+z^2-1"), cube(1e-150), kFew).cells().empty());
}

}  // namespace
}  // namespace pellucid
