// Isosurfaces of Catmull-Rom volumes: cells, roots along lines, particles.
//
// Oracles: a volume of samples of x² + y² + z² is that polynomial inside, so its isosurface is a sphere to
// rounding; a line's roots by the signs of the field at many places, evaluated without cells.
#include <numeric>

#include "field/catmull_rom.hpp"
#include "sample/line_sampler.hpp"
#include "sample/particle_sampler.hpp"
#include "scene_testing.hpp"
#include "simd_targets.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

constexpr double kRadius = 3.2;
const Vec3 kCenter(6.1, 5.9, 6.3);

double ball(const Vec3& x) {
    return dot(x - kCenter, x - kCenter) - kRadius * kRadius;
}

std::shared_ptr<const VolumeField> volume_of(const std::array<int, 3>& size, std::vector<float> values) {
    auto grid = std::make_shared<VoxelGrid>();
    grid->size = size;
    grid->values = std::move(values);
    return std::make_shared<VolumeField>(grid, Interpolation::catmull_rom);
}

/// Floats hold these samples to 1e-6 of them.
std::shared_ptr<const VolumeField> sphere_volume() {
    return volume_of({13, 13, 13}, sampled({13, 13, 13}, ball));
}

std::shared_ptr<const VolumeField> noise_volume(const std::array<int, 3>& size, unsigned seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> unit(-1, 1);
    return volume_of(size, sampled(size, [&](const Vec3&) { return unit(random); }));
}

/// 0 and 1 at random in blocks, closed: the border is 0.
std::shared_ptr<const VolumeField> label_volume(unsigned seed) {
    std::mt19937_64 random(seed);
    return volume_of({10, 9, 8}, sampled({10, 9, 8}, [&](const Vec3& x) {
                         const bool border = x.x < 2 || x.y < 2 || x.z < 2 || x.x > 7 || x.y > 6 || x.z > 5;
                         return border ? 0.0 : static_cast<double>(random() & 1U);
                     }));
}

/// A long line through the volume, and its crossings in all cells.
std::vector<FieldRoot> cross_all(const CatmullRomCells& cells, const Vec3& origin, const Vec3& direction,
                                 IsolationStats& stats, double t_lo = -100, double t_hi = 100) {
    std::vector<FieldRoot> roots;
    for (std::size_t i = 0; i < cells.count(); ++i)
        cells.cross(i, origin, direction, t_lo, t_hi, roots, stats);
    std::sort(roots.begin(), roots.end(), [](const FieldRoot& a, const FieldRoot& b) { return a.t < b.t; });
    return roots;
}

TEST(CatmullRomCells, CrossingsOfASphereAreThoseOfItsEquation) {
    const CatmullRomCells cells(sphere_volume(), 0);
    std::mt19937_64 random(1);
    std::normal_distribution<double> normal;
    IsolationStats stats;
    int hits = 0;
    for (int i = 0; i < 600; ++i) {
        const Vec3 direction = normalize(Vec3(normal(random), normal(random), normal(random)));
        const Vec3 aside = cross(direction, normalize(Vec3(normal(random), normal(random), normal(random))));
        const double miss = 1.3 * kRadius * std::abs(std::remainder(normal(random), 1.0)) * 2;
        const Vec3 origin = kCenter + miss * normalize(aside);
        const double half = kRadius * kRadius - dot(origin - kCenter, origin - kCenter) +
                            std::pow(dot(origin - kCenter, direction), 2);
        if (std::abs(half) < 1e-3) continue;
        const auto roots = cross_all(cells, origin, direction, stats);
        ASSERT_EQ(roots.size(), half > 0 ? 2U : 0U);
        for (const FieldRoot& root : roots) {
            const Vec3 out = origin + root.t * direction - kCenter;
            EXPECT_NEAR(length(out), kRadius, 2e-6);
            EXPECT_NEAR(dot(normalize(root.gradient), out) / length(out), 1, 1e-10);
            ++hits;
        }
    }
    EXPECT_GT(hits, 300);
    EXPECT_EQ(stats.undecided, 0U);
}

TEST(CatmullRomCells, RootsAreTheChangesOfSignOfTheField) {
    for (const bool labels : {false, true}) {
        const auto volume = labels ? label_volume(2) : noise_volume({8, 7, 6}, 2);
        const CatmullRomCells cells(volume, labels ? 0.3 : 0.1);
        std::mt19937_64 random(3);
        std::uniform_real_distribution<double> unit(0, 1);
        IsolationStats stats;
        std::size_t all = 0;
        for (int i = 0; i < 60; ++i) {
            const Vec3 hull = volume->hull().hi;
            const Vec3 a = hull * Vec3(unit(random), unit(random), unit(random));
            const Vec3 b = hull * Vec3(unit(random), unit(random), unit(random));
            const auto roots = cross_all(cells, a, b - a, stats, 0, 1);
            std::size_t changes = 0;
            constexpr int kSteps = 20000;
            bool before = cells.field().value(a) >= 0;
            for (int n = 1; n <= kSteps; ++n) {
                const bool now = cells.field().value(a + (b - a) * (static_cast<double>(n) / kSteps)) >= 0;
                if (now != before) {
                    ASSERT_LT(changes, roots.size());
                    EXPECT_NEAR(roots[changes].t, (n - 0.5) / kSteps, 1.0 / kSteps);
                    ++changes;
                }
                before = now;
            }
            // Two roots within a step are not seen there.
            EXPECT_EQ((roots.size() - changes) % 2, 0U);
            EXPECT_LE(roots.size() - changes, 2U);
            for (const FieldRoot& root : roots)
                EXPECT_NEAR(cells.field().value(a + root.t * (b - a)), 0, 1e-12);
            all += roots.size();
        }
        EXPECT_GT(all, 60U);
        EXPECT_EQ(stats.undecided, 0U);
    }
}

TEST(CatmullRomCells, NoCrossingIsLostOrDoubledAtFacesEdgesAndCorners) {
    // Closed surfaces: every line enters as often as it leaves, and enters and leaves in turns.
    struct Closed {
        std::shared_ptr<const VolumeField> volume;
        double isovalue;
    };
    for (const auto& [volume, isovalue] : {Closed{sphere_volume(), 0}, Closed{label_volume(4), 0.5},
                                           Closed{label_volume(5), 1.0}, Closed{label_volume(6), 0.3}}) {
        const CatmullRomCells cells(volume, isovalue);
        ASSERT_GT(cells.count(), 0U);
        std::mt19937_64 random(7);
        std::uniform_real_distribution<double> unit(-1, 1);
        const auto at_lattice = [&](const Vec3& x) { return glm::round(x * 4.0) / 4.0; };
        int lines = 0;
        for (int i = 0; i < 700; ++i) {
            const Vec3 hull = volume->hull().hi;
            const Vec3 middle = 0.5 * hull;
            Vec3 a = middle + 0.5 * hull * Vec3(unit(random), unit(random), unit(random));
            Vec3 b = middle + 0.5 * hull * Vec3(unit(random), unit(random), unit(random));
            switch (i % 7) {
                case 0:
                    break;  // anywhere
                case 1:
                    a = at_lattice(a), b = at_lattice(b);
                    break;  // corners to corners
                case 2:
                    a.x = b.x = at_lattice(a).x;
                    break;  // within a face
                case 3:
                    a.x = b.x = std::round(a.x), a.y = b.y = std::round(a.y);
                    break;  // along an edge
                case 4:
                    a.y = b.y, a.z = b.z;
                    break;  // along an axis
                case 5:
                    a = glm::round(a), b = a + Vec3(1, unit(random) > 0 ? 1 : -1, 1);
                    break;  // through diagonals
                default:
                    b = at_lattice(b);
                    break;  // a corner from anywhere
            }
            const Vec3 direction = b - a;
            if (!(length(direction) > 0.2)) continue;  // 100 of them leave the volume on both sides
            IsolationStats stats;
            const auto roots = cross_all(cells, a, direction, stats);
            EXPECT_EQ(roots.size() % 2, 0U) << i;
            double last = 0;
            for (const FieldRoot& root : roots) {
                // A sheet that is touched, or a plateau's edge, has no side.
                const double side = dot(root.gradient, direction) / length(direction);
                if (std::abs(side) < 1e-6) {
                    last = 0;
                    continue;
                }
                EXPECT_LE(side * last, 0) << i << ": twice in or out";
                last = side;
            }
            lines += roots.empty() ? 0 : 1;
        }
        EXPECT_GT(lines, 150);
    }
}

TEST(CatmullRomCells, AWrongOwnerOfFacesWouldBeSeen) {
    // The parity above is no accident: without one cell, lines through it are odd.
    const CatmullRomCells cells(sphere_volume(), 0);
    const Box tight = cells.cell(cells.count() / 2).tight;
    IsolationStats stats;
    std::vector<FieldRoot> roots;
    const Vec3 direction = normalize(tight.center() - kCenter);
    for (std::size_t i = 0; i < cells.count(); ++i)
        if (i != cells.count() / 2) cells.cross(i, kCenter, direction, -100, 100, roots, stats);
    EXPECT_EQ(roots.size() % 2, 1U);
}

TEST(CatmullRomCells, WhatACellSaysOfItselfHolds) {
    const auto volume = noise_volume({7, 7, 7}, 8);
    const CatmullRomCells cells(volume, 0.05);
    std::mt19937_64 random(9);
    std::uniform_real_distribution<double> unit(0, 1);
    std::vector<FieldRoot> roots;
    std::size_t monotone = 0;
    for (std::size_t i = 0; i < cells.count(); ++i) {
        const SurfaceCell cell = cells.cell(i);
        ASSERT_TRUE(cell.continuous);
        const CatmullRomCells::Place place = cells.place(i);
        const Vec3 base(place.base[0], place.base[1], place.base[2]);
        for (int n = 0; n < 12; ++n) {
            const Vec3 share(unit(random), unit(random), unit(random));
            const Vec3 x = cell.tight.lo + share * cell.tight.size();
            const Vec3 g = cells.field().gradient(x);
            for (int axis = 0; axis < 3; ++axis) {
                const Interval& known = cell.gradient[static_cast<std::size_t>(axis)];
                EXPECT_GE(g[axis], known.lo - 1e-12);
                EXPECT_LE(g[axis], known.hi + 1e-12);
                Vec3 along(0.0);
                along[axis] = 1;
                // All of the place, not only its tight box.
                Vec3 from = base + place.lo + share * (place.hi - place.lo);
                roots.clear();
                IsolationStats stats;
                cells.cross(i, from, along, -10, 10, roots, stats);
                EXPECT_LE(static_cast<int>(roots.size()), cells.most_roots(i, axis));
                EXPECT_EQ(cells.most_roots(i, axis) == 1, cell.monotone(static_cast<std::size_t>(axis)));
                for (const FieldRoot& root : roots) {
                    from[axis] += root.t;
                    for (int k = 0; k < 3; ++k) {
                        EXPECT_GE(from[k], cell.tight.lo[k]);
                        EXPECT_LE(from[k], cell.tight.hi[k]);
                    }
                    from[axis] -= root.t;
                }
            }
        }
        monotone += cell.monotone(0) || cell.monotone(1) || cell.monotone(2) ? 1U : 0U;
    }
    EXPECT_GT(monotone, cells.count() / 2);
}

/// Lines along an axis through the cells that are monotone along it.
struct SomeLines {
    std::vector<std::uint32_t> cell;
    std::array<std::vector<double>, 3> at;
    std::vector<double> lo, hi;
    std::vector<double> root;
    std::array<std::vector<double>, 3> gradient;

    SomeLines(const CatmullRomCells& cells, std::size_t axis, std::size_t count) {
        std::mt19937_64 random(10);
        std::uniform_real_distribution<double> unit(0, 1);
        for (std::size_t tries = 0; cell.size() < count && tries < 100 * count; ++tries) {
            const auto i = static_cast<std::uint32_t>(random() % cells.count());
            const SurfaceCell one = cells.cell(i);
            if (!one.monotone(axis)) continue;
            cell.push_back(i);
            for (int k = 0; k < 3; ++k)
                at[static_cast<std::size_t>(k)].push_back(one.tight.lo[k] +
                                                          unit(random) * one.tight.size()[k]);
            lo.push_back(one.tight.lo[static_cast<int>(axis)]);
            hi.push_back(one.tight.hi[static_cast<int>(axis)]);
        }
        root.resize(cell.size());
        for (auto& g : gradient) g.resize(cell.size());
    }
    void find(const CatmullRomCells& cells, std::size_t axis, std::size_t first, std::size_t count) {
        cells.cross_along({axis,
                           count,
                           &cell[first],
                           {&at[0][first], &at[1][first], &at[2][first]},
                           &lo[first],
                           &hi[first]},
                          {&root[first], {&gradient[0][first], &gradient[1][first], &gradient[2][first]}});
    }
};

TEST(CatmullRomCells, ManyLinesAtOnceAreEachAloneToTheLastBit) {
    const CatmullRomCells cells(noise_volume({9, 8, 7}, 11), 0.05);
    for (std::size_t axis = 0; axis < 3; ++axis) {
        SomeLines alone(cells, axis, 1000);
        ASSERT_GT(alone.cell.size(), 900U);
        for (std::size_t i = 0; i < alone.cell.size(); ++i) alone.find(cells, axis, i, 1);
        std::size_t hits = 0;
        for (std::size_t i = 0; i < alone.cell.size(); ++i) {
            // Against the roots of any line.
            std::vector<FieldRoot> roots;
            IsolationStats stats;
            Vec3 origin(alone.at[0][i], alone.at[1][i], alone.at[2][i]);
            origin[static_cast<int>(axis)] = 0;
            Vec3 along(0.0);
            along[static_cast<int>(axis)] = 1;
            cells.cross(alone.cell[i], origin, along, alone.lo[i], alone.hi[i], roots, stats);
            ASSERT_EQ(roots.size(), std::isnan(alone.root[i]) ? 0U : 1U);
            if (roots.empty()) continue;
            ++hits;
            EXPECT_NEAR(alone.root[i], roots[0].t, 1e-10);
            for (std::size_t k = 0; k < 3; ++k)
                EXPECT_NEAR(alone.gradient[k][i], roots[0].gradient[static_cast<int>(k)], 1e-8);
        }
        EXPECT_GT(hits, 300U);
        EXPECT_LT(hits, alone.cell.size());
        for (const std::int64_t target : simd_targets()) {
            const ChosenTarget chosen(target);
            SomeLines many(cells, axis, 1000);
            many.find(cells, axis, 0, 13);
            many.find(cells, axis, 13, many.cell.size() - 13);
            const auto same = [](const std::vector<double>& a, const std::vector<double>& b) {
                return std::memcmp(a.data(), b.data(), a.size() * sizeof(double)) == 0;
            };
            EXPECT_TRUE(same(many.root, alone.root)) << target;
            for (std::size_t k = 0; k < 3; ++k)
                EXPECT_TRUE(same(many.gradient[k], alone.gradient[k])) << target;
        }
    }
}

TEST(CatmullRomCells, CellsBesideASampleThatIsNoneAreEmptyAndCounted) {
    auto grid = std::make_shared<VoxelGrid>(sphere_volume()->grid());
    const auto whole = CatmullRomCells(std::make_shared<VolumeField>(grid, Interpolation::catmull_rom), 0);
    grid->values[grid->index(9, 6, 6)] = std::numeric_limits<float>::quiet_NaN();
    const CatmullRomCells cells(std::make_shared<VolumeField>(grid, Interpolation::catmull_rom), 0);
    EXPECT_EQ(cells.lost(), 64U);
    EXPECT_LT(cells.count(), whole.count());
    EXPECT_EQ(whole.lost(), 0U);
    for (std::size_t i = 0; i < cells.count(); ++i) {
        const auto base = cells.place(i).base;
        EXPECT_FALSE(std::abs(base[0] + 0.5 - 9) < 2 && std::abs(base[1] + 0.5 - 6) < 2 &&
                     std::abs(base[2] + 0.5 - 6) < 2);
    }
}

// At the border samples are continued beyond it: 2·3e38 − (−3e38) is more than a float holds.
TEST(CatmullRomCells, FiniteSamplesOfAnySizeLoseNoCell) {
    const std::array<int, 3> size{6, 6, 6};
    const auto steps = sampled(size, [](const Vec3& x) { return x.x < 0.5 || x.y > 4.5 ? -3e38 : 3e38; });
    const CatmullRomCells cells(volume_of(size, steps), 0);
    EXPECT_EQ(cells.lost(), 0U);
    IsolationStats stats;
    EXPECT_EQ(cross_all(cells, {-1, 2.3, 2.4}, {1, 0, 0}, stats).size(), 1U);
    EXPECT_EQ(cross_all(cells, {-1, 2.3, 0.4}, {1, 0, 0}, stats).size(), 1U);
}

TEST(CatmullRomCells, NoCellsWhereNothingCrosses) {
    EXPECT_EQ(CatmullRomCells(sphere_volume(), 1e6).count(), 0U);
    EXPECT_EQ(CatmullRomCells(volume_of({5, 5, 1}, sampled({5, 5, 1}, ball)), 0).count(), 0U);
    EXPECT_EQ(CatmullRomCells(volume_of({6, 6, 6}, std::vector<float>(216, 1.5F)), 1.5).count(), 0U);
}

TEST(CatmullRomCells, CrossingsOfARealHeadAgreeWithTheSignsAtTheEnds) {
    const fs::path file = "/usr/share/mricron/templates/ch2.nii.gz";  // Debian's mricron-data
    if (!fs::exists(file)) GTEST_SKIP() << "skipped: no " << file;
    const auto volume = std::make_shared<VolumeField>(std::make_shared<VoxelGrid>(read_volume(file)),
                                                      Interpolation::catmull_rom);
    const CatmullRomCells cells(volume, 40);
    EXPECT_LT(cells.bytes(), volume->bytes() + 24 * cells.count());
    std::mt19937_64 random(13);
    std::uniform_real_distribution<double> unit(0, 1);
    const Vec3 hull = volume->hull().hi;
    IsolationStats stats;
    std::size_t all = 0;
    for (int i = 0; i < 40; ++i) {
        Vec3 a = hull * Vec3(unit(random), unit(random), unit(random));
        Vec3 b = hull * Vec3(unit(random), unit(random), unit(random));
        if (i % 2 == 0) a = glm::round(a), b = glm::round(b);  // through corners of cells
        const auto roots = cross_all(cells, a, b - a, stats, 0, 1);
        all += roots.size();
        EXPECT_EQ(roots.size() % 2 != 0, (cells.field().value(a) >= 0) != (cells.field().value(b) >= 0)) << i;
        for (std::size_t n = 0; n < roots.size(); ++n) {
            // The field has the signs between them that they say.
            const double after = n + 1 < roots.size() ? roots[n + 1].t : 1;
            const bool up = dot(roots[n].gradient, b - a) > 0;
            EXPECT_EQ(cells.field().value(a + 0.5 * (roots[n].t + after) * (b - a)) >= 0, up) << i;
        }
    }
    EXPECT_GT(all, 100U);
    EXPECT_EQ(stats.undecided, 0U);
}

// ---- scenes

fs::path sphere_file(const fs::path& folder) {
    return put_volume(folder / "ball.nrrd", {13, 13, 13}, sampled({13, 13, 13}, ball));
}

std::string iso(const fs::path& file, double isovalue) {
    return fmt::format(
        "[[surface]]\nisosurface = {{ volume = \"{}\", isovalue = {}, interpolation = \"catmull-rom\" }}\n",
        file.string(), isovalue);
}

const std::string kAll =  // sees all of the volume
    "image.resolution = [64, 64]\n[camera]\nprojection = \"orthographic\"\nposition = [27, 21, 24]\ntarget = "
    "[6, 6, 6]\n"
    "view_height = 26\n";

TEST(CatmullRomParticles, AreUniformOnTheSphereAndAsManyAsItsAreaSays) {
    const fs::path file = sphere_file(test_folder());
    for (const bool oblique : {true, false}) {
        const PreparedScene scene =
            prepare(scene_from(kAll + iso(file, 0) + "opacity = 0.3\nopacity_law = \"" +
                               (oblique ? "oblique" : "constant") + "\"\n"));
        const LineSampler sampler(scene.objects[0], scene.camera, 0);
        const double measure = (oblique ? 4 : 2) * M_PI * kRadius * kRadius;
        const double share = measure / (scene.camera.pixel_area(Vec3(0, 0, 1)) * sampler.virtual_pixels());
        ASSERT_LT(share, 1);
        EXPECT_GT(share, 0.3);
        constexpr std::uint64_t kTrials = 100000;
        std::vector<std::int64_t> counts(192, 0);
        std::uint64_t landed = 0;
        const auto bin = [](double u, std::size_t n) {
            return std::min(n - 1, static_cast<std::size_t>(std::max(0.0, u) * static_cast<double>(n)));
        };
        for (std::uint64_t i = 0; i < kTrials; ++i) {
            const auto p = sampler.trial({1}, 0, i);
            if (!p) continue;
            ++landed;
            const Vec3 x = (scene.camera.to_world(p->view) - kCenter) / kRadius;
            ASSERT_NEAR(length(x), 1, 1e-6);
            ++counts[16 * bin(0.5 + 0.5 * x.z, 12) + bin(0.5 + std::atan2(x.y, x.x) / (2 * M_PI), 16)];
        }
        EXPECT_NEAR(static_cast<double>(landed) / kTrials, share,
                    normal_critical_value(0.001 / 4) * std::sqrt(share * (1 - share) / kTrials));
        // The constant law gives each place the chance |cosθ|: half of the bins would differ.
        if (oblique) {
            EXPECT_GT(chi2_uniformity(counts)->p_value, 0.001 / 4);
        } else {
            EXPECT_LT(chi2_uniformity(counts)->p_value, 1e-6);
        }
    }
}

TEST(CatmullRomParticles, TrialsOfABlockAreThoseOneByOne) {
    const fs::path folder = test_folder();
    std::mt19937_64 random(12);
    std::uniform_real_distribution<double> unit(-1, 1);
    const fs::path file = put_volume(folder / "noise.nrrd", {9, 8, 7},
                                     sampled({9, 8, 7}, [&](const Vec3&) { return unit(random); }));
    const PreparedScene scene = prepare(scene_from(kAll + iso(file, 0.05) + "opacity = 0.3\n"));
    const LineSampler sampler(scene.objects[0], scene.camera, 0);
    ASSERT_GT(sampler.block_count(), 0U);
    std::size_t points = 0;
    for (std::size_t block = 0; block < sampler.block_count(); ++block) {
        std::vector<LineSampler::Point> many;
        sampler.trials_in_block(block, {3}, 1, 0, 500, many);
        std::vector<LineSampler::Point> each;
        for (std::uint32_t i = 0; i < 500; ++i)
            if (const auto p = sampler.trial_in_block(block, {3}, 1, i)) each.push_back(*p);
        ASSERT_EQ(many.size(), each.size()) << block;
        for (std::size_t i = 0; i < many.size(); ++i) {
            EXPECT_EQ(many[i].view, each[i].view);
            EXPECT_EQ(many[i].view_normal, each[i].view_normal);
        }
        points += many.size();
    }
    EXPECT_GT(points, 200U);
}

TEST(CatmullRomParticles, ImagesFollowTheTruth) {
    const fs::path folder = test_folder();
    const fs::path waves =
        put_volume(folder / "waves.nrrd", {12, 11, 10}, sampled({12, 11, 10}, [](const Vec3& x) {
                       return std::sin(1.1 * x.x) + std::sin(0.9 * x.y + 1) * std::cos(x.z);
                   }));
    const std::string head =
        "image.resolution = [24, 20]\n[camera]\nposition = [24, 17, 20]\ntarget = [6, 5, 5]\n"
        "fov_degrees = 32\n";
    const double level = sidak_level(0.001, 6);
    for (const std::string& toml :
         {head + iso(sphere_file(folder), 0) + "opacity = 0.4\n",
          head + iso(waves, 0.1) + "opacity = 0.2\nclip = [{ normal = [1, 0.3, 0], offset = 4 }]\n",
          head + iso(waves, -0.4) + "opacity = 0.2\nopacity_law = \"oblique\"\nscale = [1, 0.8, 1.1]\n"}) {
        const PreparedScene scene = prepare(scene_from(toml));
        TruthStats truth_stats;
        const Image truth = trace_truth(
            scene, {.filter = PixelFilter::particle, .seed = {3}, .max_error = 0.003, .max_samples = 1024},
            truth_stats);
        RenderStats stats;
        constexpr std::uint32_t kRepeats = 160;
        const Image drawn = render_particles(scene, {.repeats = kRepeats, .sampler = {.seed = {7}}}, stats);
        const OpacityVerdict verdict = judge_opacity(drawn, truth, kRepeats);
        ASSERT_GT(verdict.pixels, 60U);
        EXPECT_GT(verdict.ks_p, level);
        EXPECT_LT(verdict.worst_z,
                  normal_critical_value(sidak_level(level, static_cast<double>(verdict.pixels))));
        EXPECT_LT(std::abs(verdict.total_z), normal_critical_value(level));
    }
}

TEST(CatmullRomGeometry, SphereOfTheTruthIsTheClosedForm) {
    // Opacity 0.3, constant law: 0.51 where a ray meets two sheets.
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [9, 9]\n[camera]\nprojection = \"orthographic\"\nposition = [6.1, 5.9, 30]\n"
        "target = [6.1, 5.9, 6.3]\nview_height = 8\n" +
        iso(sphere_file(test_folder()), 0) + "opacity = 0.3\n"));
    TruthStats stats;
    const Image truth = trace_truth(scene, {.seed = {1}, .samples = 16}, stats);
    EXPECT_NEAR(static_cast<double>(truth.plane("A")[9 * 4 + 4]), 0.51, 1e-6);
    EXPECT_EQ(truth.plane("A")[0], 0);
}

TEST(CatmullRomGeometry, GivesItsFieldAndSoDoesTrilinear) {
    const fs::path file = sphere_file(test_folder());
    for (const char* kind : {"catmull-rom", "trilinear"}) {
        std::string surface = iso(file, 0);
        surface.replace(surface.find("catmull-rom"), 11, kind);
        const PreparedScene scene = prepare(scene_from(kAll + surface + "translate = [1, 2, 3]\n"));
        const auto field = scene.objects[0].geometry->field_surface();
        ASSERT_TRUE(field);
        EXPECT_EQ(field->cell_width, 1);
        EXPECT_EQ(field->bounds.hi, Vec3(12.0));
        EXPECT_EQ(field->to_world.point(Vec3(0.0)), Vec3(1, 2, 3));
        EXPECT_NEAR(field->field->value({5, 5, 5}), ball({5, 5, 5}), 1e-5);
        const FieldJet jet = field->field->jet({5.3, 5.4, 5.2});
        EXPECT_LT(length(jet.gradient - field->field->gradient({5.3, 5.4, 5.2})), 1e-12);
        EXPECT_FALSE(field->field->excludes(field->bounds));
        EXPECT_TRUE(field->field->excludes({kCenter - Vec3(0.2), kCenter + Vec3(0.2)}));
    }
}

TEST(SliceGeometry, OutsideOfItsVolumeSaysSo) {
    const fs::path folder = test_folder();
    const fs::path volume = sphere_file(folder);
    for (const auto& [center, outside] : {std::pair("[6, 6, 6]", false), std::pair("[60, 6, 6]", true)}) {
        testing::internal::CaptureStderr();
        const PreparedScene scene = prepare(scene_from(
            kAll + fmt::format("[[surface]]\nshading = \"flat\"\nslice = {{ volume = \"{}\", center = {}, u = [2, 0, 0], "
                               "v = [0, 2, 0], transfer = [[-1000, 1, 1, 1, 1], [1000, 1, 1, 1, 1]] }}\n",
                               volume.string(), center)));
        const std::string said = testing::internal::GetCapturedStderr();
        EXPECT_EQ(said.find("wholly outside of") != std::string::npos, outside) << said;
        EXPECT_EQ(scene.objects[0].geometry->patch_count(), outside ? 0U : 1U);
    }
}

TEST(CatmullRomGeometry, ASliceOrAnIsovalueOutOfRangeDrawsNothingAndSaysWhy) {
    const fs::path folder = test_folder();
    const fs::path slice = put_volume(folder / "slice.nrrd", {6, 6, 1}, sampled({6, 6, 1}, ball));
    for (const auto& [surface, word] : {std::pair(iso(slice, 0), "one sample along an axis"),
                                        std::pair(iso(sphere_file(folder), 1e6), "never crosses isovalue")}) {
        testing::internal::CaptureStderr();
        const PreparedScene scene = prepare(scene_from(kAll + surface));
        const std::string said = testing::internal::GetCapturedStderr();
        EXPECT_EQ(scene.objects[0].geometry->patch_count(), 0U);
        EXPECT_NE(said.find(word), std::string::npos) << said;
        EXPECT_EQ(LineSampler(scene.objects[0], scene.camera, 0).virtual_pixels(), 0);
    }
}

}  // namespace
}  // namespace pellucid
