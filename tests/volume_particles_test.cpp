// Volumes and slices as particles (PBVR), judged against the truth of the particles' own pixel filter.
#include <cstring>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "cpu/plain_particles.hpp"
#include "sample/poisson_number.hpp"
#include "sample/volume_source.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

const std::string kTransfer =
    "transfer = [[-1, 0.1, 0.3, 1, 0], [0, 0.2, 0.9, 0.4, 0.1], [0.4, 1, 0.5, 0.1, 0.2], [0.4, 1, 1, 0.5, "
    "0.5], [1.5, 1, 0.1, 0.1, 0.9]]\n";
const std::string kWaves =
    "expression = \"sin(3*x)*cos(2*y) + 0.5*z\"\nbounds = [[-1, -0.8, -1], [1, 0.9, 1]]\nresolution = [13, "
    "11, 12]\n" +
    kTransfer;
const std::string kCamera = "image.resolution = [20, 16]\ncamera.position = [1.5, 1.2, 4]\n";

std::string volume(const std::string& more) {
    return "[[volume]]\n" + kWaves + more + "\n";
}

struct Case {
    const char* name;
    std::string toml;
    std::uint32_t repeats = 200;
};
void PrintTo(const Case& c, std::ostream* out) {
    *out << c.name;
}

std::vector<Case> cases() {
    return {
        {"flat_perspective", kCamera + volume("opacity_step = 0.5")},
        {"lit_orthographic_sheared",
         "image.resolution = [20, 16]\n[camera]\nprojection = \"orthographic\"\nposition = [1, 0.7, "
         "4]\nview_height = 3\n[[light]]\ndirection = [1, 1, 0.3]\n" +
             volume("opacity_step = 0.7\nshading = { specular = 0.4 }\nmatrix = [-0.7,0.3,0,0, "
                    "0,0.9,0.2,0.1, 0.1,0,0.8,0, 0,0,0,1]")},
        {"catmull_rom_clipped", kCamera + volume("opacity_step = 0.3\ninterpolation = \"catmull-rom\"\nclip "
                                                 "= [{ normal = [1, 1, 0.2], offset = 0.3 }]")},
        {"nearest_labels",
         kCamera + volume("opacity_step = 0.4\ninterpolation = \"nearest\"\nrotate_degrees = [10, 20, 30]")},
        {"camera_inside",
         "image.resolution = [20, 16]\ncamera.position = [0.3, 0.2, 0.4]\ncamera.fov_degrees = 100\n" +
             volume("opacity_step = 2")},
        {"overlapping_with_surfaces",
         kCamera + volume("name = \"a\"\nopacity_step = 0.8") +
             volume(
                 "name = \"b\"\nopacity_step = 1\nrotate_degrees = [0, 50, 90]\ntranslate = [0.3, 0, 0.1]") +
             "[[surface]]\nname = \"ball\"\nimplicit = \"sphere\"\nscale = 0.6\nopacity = 0.4\ncolor = [1, "
             "1, 0.2]\n"
             "[[surface]]\nname = \"floor\"\nrectangle = { center = [0, -0.4, 0], u = [1.5, 0, 0], v = [0, "
             "0.2, 1.5] }\nopacity = 0.7\n"},
        {"thin_and_dense", kCamera + volume("opacity_step = 0.02\nscale = [1, 1, 0.02]")},
        {"opacity_one", kCamera + "[[volume]]\nexpression = \"x^2 + y^2 + z^2\"\nbounds = [[-1, -1, -1], [1, "
                                  "1, 1]]\nresolution = 16\n"
                                  "transfer = [[0.2, 1, 0, 0, 1], [0.2, 0, 1, 0, 0.1], [1, 0, 0, 1, 0]]\n"},
        {"slice", "SLICE"},
        {"slice_oblique_with_volume", "SLICE_OBLIQUE"},
    };
}

PreparedScene scene_of(const Case& c) {
    const fs::path folder = test_folder();
    put_volume(folder / "s.nrrd", {8, 7, 6},
               sampled({8, 7, 6}, [](const Vec3& p) { return std::sin(p.x) + 0.2 * p.y * std::cos(p.z); }),
               Vec3(0.3));
    const std::string slice =
        "slice = { volume = \"s.nrrd\", center = [1, 1, 0.7], u = [1.3, 0, 0.2], v = [0, 1.2, 0.4], " +
        kTransfer.substr(0, kTransfer.size() - 1) + " }\n";
    std::string toml = c.toml;
    const std::string camera =
        "image.resolution = [20, 16]\ncamera.position = [1.5, 1.2, 5]\ncamera.target = [1, 1, 0]\n";
    if (toml == "SLICE") toml = camera + "[[surface]]\nopacity = 0.9\nshading = \"flat\"\n" + slice;
    if (toml == "SLICE_OBLIQUE")
        toml = camera +
               "[[surface]]\nopacity_law = \"oblique\"\nclip = [{ normal = [1, 0, 0], offset = 1.6 }]\n" +
               slice + volume("opacity_step = 1\ntranslate = [1, 1, 0.5]");
    return prepare(scene_from(toml, folder));
}

/// What a judgement of opacity and colour says.
struct Verdict {
    OpacityVerdict opacity;
    MeanVariance squares;  // of distances to the truth's colour, in units of the theory's variance

    [[nodiscard]] bool accepts(double level) const {
        const double sigma = std::sqrt(squares.variance() * 3 / static_cast<double>(squares.count()));
        return opacity.ks_p > level && std::abs(opacity.total_z) < normal_critical_value(level) &&
               opacity.worst_z <
                   normal_critical_value(sidak_level(level, static_cast<double>(opacity.pixels))) &&
               (squares.count() < 100 || std::abs(squares.mean() - 1) < normal_critical_value(level) * sigma);
    }
};

Verdict judge(const PreparedScene& scene, const Image& drawn, std::uint32_t repeats) {
    TruthStats stats;
    const Image truth = trace_truth(scene,
                                    {.filter = PixelFilter::particle,
                                     .seed = {3},
                                     .max_error = 0.5 / std::sqrt(repeats) / 20,
                                     .max_samples = 1024},
                                    stats);
    Verdict verdict{judge_opacity(drawn, truth, repeats), {}};
    for (std::size_t i = 0; i < drawn.pixel_count(); ++i)
        for (const char* channel : {"R", "G", "B"}) {
            const std::string name(channel);
            const double alpha = static_cast<double>(truth.plane("A")[i]);
            const double variance = static_cast<double>(truth.plane("repeat_variance." + name)[i]) / repeats +
                                    static_cast<double>(truth.plane("variance." + name)[i]);
            if (alpha * repeats < 20 || variance < 1e-7) continue;
            const double off = static_cast<double>(drawn.plane(name)[i] - truth.plane(name)[i]);
            verdict.squares.add(off * off / variance);
        }
    return verdict;
}

const double kLevel = sidak_level(0.001, 10 * 4);

class VolumeParticles : public testing::TestWithParam<Case> {};

TEST_P(VolumeParticles, OpacityAndColourFollowTheTruth) {
    const Case& c = GetParam();
    const PreparedScene scene = scene_of(c);
    RenderStats stats;
    const Image drawn = render_particles(scene, {.repeats = c.repeats, .sampler = {.seed = {7}}}, stats);
    const Verdict verdict = judge(scene, drawn, c.repeats);
    ASSERT_GT(verdict.opacity.pixels, 20U);
    EXPECT_TRUE(verdict.accepts(kLevel))
        << "KS " << verdict.opacity.ks_p << ", total z " << verdict.opacity.total_z << ", worst z "
        << verdict.opacity.worst_z << ", squares " << verdict.squares.mean() << " of "
        << verdict.squares.count();
}

INSTANTIATE_TEST_SUITE_P(Scenes, VolumeParticles, testing::ValuesIn(cases()),
                         [](const auto& instance) { return std::string(instance.param.name); });

/// Draws one source alone.
Image draw_source(const PreparedScene& scene, const ParticleSource& source, std::uint32_t repeats) {
    EnsembleSums sums = make_sums(scene);
    make_plain_drawer(scene)->draw(sample_particles(scene, SourceRefs(source), {.seed = {7}}, 0, repeats),
                                   sums);
    return ensemble_image(scene.camera, ParticleFrame(scene.camera), sums);
}

TEST(VolumeParticlesWrongTwins, DensityWithoutLogarithmOrPixelAreaIsRejected) {
    // Near, so that the area that a pixel sees varies over the volume.
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [20, 16]\ncamera.position = [0.5, 0.4, 1.8]\ncamera.fov_degrees = 60\n" +
        volume("opacity_step = 0.5")));
    const auto accepted = [&](VolumeSource::Density density) {
        const VolumeSource source(scene, 0, density);
        return judge(scene, draw_source(scene, source, 200), 200).accepts(kLevel);
    };
    EXPECT_TRUE(accepted(VolumeSource::Density::extinction));
    EXPECT_FALSE(accepted(VolumeSource::Density::without_log));
    EXPECT_FALSE(accepted(VolumeSource::Density::without_area));
}

/// The particles of each object in a repeat.
std::vector<std::vector<Particle>> by_object(const PreparedScene& scene, std::uint32_t repeat) {
    const Sources sources = make_sources(scene);
    const ParticleSet set = sample_particles(scene, sources, {.seed = {5}}, repeat, 1);
    std::vector<std::vector<Particle>> found(set.objects);
    const RepeatParticles& all = set.repeats[0];
    for (std::uint32_t i = 0; i < all.particles.size(); ++i)
        found[all.bin_of(i) % set.objects].push_back(all.particles[i]);
    return found;
}

TEST(Fusion, MovingOneObjectLeavesTheParticlesOfTheOthers) {
    const auto scene = [](double x) {
        return prepare(scene_from(
            "image.resolution = [60, 50]\n[camera]\nposition = [1.5, 1.2, 4]\nnear = 1\nfar = 8\n" +
            volume("opacity_step = 0.5") +
            fmt::format("[[surface]]\nname = \"ball\"\nimplicit = \"sphere\"\nscale = 0.5\nopacity = "
                        "0.5\ntranslate = [{}, 0, 0]\n",
                        x) +
            "[[surface]]\nname = \"ring\"\nimplicit = \"torus\"\nopacity = 0.3\n"
            "[[surface]]\nname = \"sheet\"\nrectangle = { u = [3, 0, 0], v = [0, 0, 3] }\nopacity = 0.3\n"));
    };
    for (const std::uint32_t repeat : {0U, 3U}) {
        const auto a = by_object(scene(0), repeat);
        const auto b = by_object(scene(0.2), repeat);
        ASSERT_EQ(a.size(), 4U);  // ball, ring, sheet; the volume behind them
        for (const std::size_t object : {1U, 2U, 3U}) {
            ASSERT_GT(a[object].size(), 100U);
            ASSERT_EQ(a[object].size(), b[object].size());
            EXPECT_EQ(std::memcmp(a[object].data(), b[object].data(), a[object].size() * sizeof(Particle)), 0)
                << object;
        }
        EXPECT_TRUE(a[0].size() != b[0].size() ||
                    std::memcmp(a[0].data(), b[0].data(), a[0].size() * sizeof(Particle)) != 0);
    }
}

TEST(VolumeSource, BlocksAddUpAndHoldTheirPoints) {
    const PreparedScene scene =
        prepare(scene_from(kCamera +
                           "[[volume]]\nexpression = \"sin(9*x)*cos(8*y) + z\"\nbounds = [[-1, -1, -1], [1, "
                           "1, 1]]\nresolution = 70\n" +
                           kTransfer));
    const VolumeSource source(scene, 0);
    ASSERT_GT(source.block_count(), 1U);
    double sum = 0;
    for (std::size_t block = 0; block < source.block_count(); ++block) {
        sum += source.block_virtual_pixels(block);
        std::vector<SourcePoint> points;
        source.trials_in_block(block, {1}, 0, 0, 300, points);
        ASSERT_FALSE(points.empty());
        const Box box = *source.block_bounds(block);
        for (const SourcePoint& point : points) {
            const Vec3 world = scene.camera.to_world(point.view);
            for (int axis = 0; axis < 3; ++axis) {
                EXPECT_GE(world[axis], box.lo[axis] - 1e-9);
                EXPECT_LE(world[axis], box.hi[axis] + 1e-9);
                EXPECT_GE(point.view_normal[axis], 0);
                EXPECT_LE(point.view_normal[axis], 1 + 1e-12);
            }
        }
    }
    EXPECT_NEAR(sum, source.virtual_pixels(), 1e-9 * sum);
}

TEST(VolumeSource, NothingToSeeHasNoParticles) {
    for (const char* transfer :
         {"transfer = [[0, 1, 1, 1, 0]]", "transfer = [[5, 1, 1, 1, 0], [6, 1, 1, 1, 1]]"}) {
        const PreparedScene scene = prepare(scene_from(
            kCamera + "[[volume]]\nexpression = \"x\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nresolution = 5\n" +
            transfer));
        EXPECT_EQ(VolumeSource(scene, 0).virtual_pixels(), 0);
    }
}

// An opacity of 0.3 over 1e-30: infinitely many particles for a picture that is opaque anyway.
TEST(VolumeSource, TooDenseVolumesHaveParticlesThatCanBeCountedAndLookOpaque) {
    const std::string body = "[[volume]]\nname = \"lead\"\nexpression = \"x + 0.4*y\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nresolution = 5\n"
                             "transfer = [[-2, 1, 0, 0, 0.3], [2, 0, 0.2, 1, 0.3]]\n";
    for (const char* camera : {"position = [1.5, 1.2, 4]", "position = [0.1, 0.2, 0.3]\nnear = 0.05"}) {
        const auto with = [&](const char* step) {
            return prepare(scene_from(fmt::format("image.resolution = [12, 12]\n[camera]\n{}\n{}{}\n", camera, body, step)));
        };
        const PreparedScene scene = with("opacity_step = 1e-30");
        const VolumeSource source(scene, 0);
        // Pixels of a hundredth and more of what is seen: some 14 particles each, 4 deep, in 144 pixels, a few trials each.
        EXPECT_GT(source.virtual_pixels(), 144);
        EXPECT_LT(source.virtual_pixels(), 1e7);
        EXPECT_NE(source.complaint().find("volume \"lead\": opacity_step = 1e-30"), std::string::npos) << source.complaint();
        // As dense as can be drawn at once, and nothing is said of it.
        const PreparedScene opaque = with("opacity_step = 0.01");
        const VolumeSource plain(opaque, 0);
        EXPECT_EQ(plain.complaint(), "");
        RenderStats stats;
        const Image dense = render_particles(scene, {.repeats = 20, .sampler = {.seed = {1}}}, stats);
        const Image other = render_particles(opaque, {.repeats = 20, .sampler = {.seed = {2}}}, stats);
        std::size_t covered = 0;
        for (std::size_t i = 0; i < dense.pixel_count(); ++i) {
            if (other.plane("A")[i] < 1) continue;  // beside the volume, or at its outline
            ++covered;
            EXPECT_EQ(dense.plane("A")[i], 1) << i;
            for (const char* channel : {"R", "G", "B"}) EXPECT_NEAR(dense.plane(channel)[i], other.plane(channel)[i], 0.06) << i;
        }
        EXPECT_GT(covered, 20U);
    }
}

TEST(PoissonNumber, OfAMeanBeyondAllNumbersIsRefused) {
    RandomStream random(Seed{1}, {});
    for (const double mean : {0x1p33, 1e30, kInfinity}) EXPECT_THROW((void)poisson_number(mean, random), Error) << mean;
    EXPECT_NEAR(poisson_number(0x1p31, random), 0x1p31, 6 * std::sqrt(0x1p31));
}

TEST(VolumeParticlesDeterminism, ThreadsDoNotMatter) {
    const PreparedScene scene =
        prepare(scene_from(kCamera + volume("opacity_step = 0.5\nshading = { specular = 0.2 }")));
    const auto draw = [&](int threads) {
        set_thread_count(threads);
        RenderStats stats;
        Image image = render_particles(scene, {.repeats = 12}, stats);
        set_thread_count(0);
        return image;
    };
    expect_same_planes(draw(1), draw(3));
}

}  // namespace
}  // namespace pellucid
