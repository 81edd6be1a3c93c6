// The ray-traced truth against closed forms.
#include "reference/truth.hpp"

#include <fstream>

#include "core/parallel.hpp"
#include "reference/ray_scene.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

Image trace(const std::string& toml, const TruthSettings& settings = {}, std::optional<PixelRect> crop = std::nullopt,
            const fs::path& folder = "/") {
    TruthStats stats;
    return trace_truth(prepare(scene_from(toml, folder), crop), settings, stats);
}

std::string head(int width, int height, double view) {
    return fmt::format("image.resolution = [{}, {}]\n[camera]\nprojection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = {}\n",
                       width, height, view);
}
double at(const Image& image, const char* plane, int x, int y) {
    return static_cast<double>(image.plane(plane)[static_cast<std::size_t>(y * image.width() + x)]);
}

TEST(Truth, SphereCrossingsCompositeInClosedForm) {
    for (const bool oblique : {false, true}) {
        const Image image = trace(head(9, 9, 0.09) + "[[surface]]\nimplicit = \"sphere\"\nopacity = 0.3\ntranslate = [0.6, 0, 0]\n" +
                                  (oblique ? "opacity_law = \"oblique\"" : ""), {.max_error = 1e-5});
        // The middle pixel looks at distance 0.6 from the centre: cosθ = 0.8 (± 0.5 % across the pixel).
        const double expected = 1 - std::pow(0.7, oblique ? 2 / 0.8 : 2);
        EXPECT_NEAR(at(image, "A", 4, 4), expected, oblique ? 1e-4 : 1e-6);
        EXPECT_NEAR(at(image, "Z", 4, 4), 4 - 0.8, 0.01);
    }
}

TEST(Truth, StackOfSheetsCompositesInOrderOfDepth) {
    std::string toml = head(3, 3, 1);
    double clear = 1;
    Vec3 expected(0.0);
    for (int i = 0; i < 6; ++i) {  // written back to front: order in the file must not matter
        const int layer = 5 - i;
        toml += fmt::format("[[surface]]\nrectangle = {{ center = [0, 0, {}] }}\nopacity = {}\ncolor = [{}, {}, 0.5]\nshading = \"flat\"\n",
                            -0.1 * layer, 0.1 + 0.1 * layer, layer / 6.0, 1 - layer / 6.0);
    }
    for (int layer = 0; layer < 6; ++layer) {
        const double alpha = 0.1 + 0.1 * layer;
        expected += clear * alpha * Vec3(layer / 6.0, 1 - layer / 6.0, 0.5);
        clear *= 1 - alpha;
    }
    for (const PixelFilter filter : {PixelFilter::box, PixelFilter::particle}) {
        const Image image = trace(toml, {.filter = filter});
        EXPECT_NEAR(at(image, "A", 1, 1), 1 - clear, 1e-6);
        EXPECT_NEAR(at(image, "R", 1, 1), expected.x, 1e-6);
        EXPECT_NEAR(at(image, "G", 1, 1), expected.y, 1e-6);
        EXPECT_NEAR(at(image, "Z", 1, 1), 4, 1e-6);
    }
}

TEST(Truth, CoincidentSurfacesMixWhateverTheirOrder) {
    // zSlab (4.4): C1 + C2 − ½(C1 α2 + C2 α1).
    const std::string red = "[[surface]]\nrectangle = {}\nopacity = 0.6\ncolor = [1, 0, 0]\nshading = \"flat\"\n";
    const std::string green = "[[surface]]\nrectangle = { u = [0.9, 0, 0] }\nopacity = 0.5\ncolor = [0, 1, 0]\nshading = \"flat\"\n";
    const std::string blue = "[[surface]]\nimplicit = \"plane\"\nopacity = 0.3\ncolor = [0, 0, 1]\nshading = \"flat\"\n";
    for (const std::string& camera : {head(3, 3, 1), std::string("image.resolution = [3, 3]\ncamera.position = [0.3, 1, 4]\n")}) {
        const Image a = trace(camera + red + green);
        const Image b = trace(camera + green + red);
        EXPECT_NEAR(at(a, "A", 1, 1), 0.8, 1e-6);
        EXPECT_NEAR(at(a, "R", 1, 1), 0.6 - 0.5 * 0.6 * 0.5, 1e-6);
        EXPECT_NEAR(at(a, "G", 1, 1), 0.5 - 0.5 * 0.5 * 0.6, 1e-6);
        EXPECT_NEAR(at(b, "R", 1, 1), at(a, "R", 1, 1), 1e-6);
        // Three: the mean over their six orders.
        const Image c = trace(camera + blue + red + green);
        EXPECT_NEAR(at(c, "A", 1, 1), 1 - 0.4 * 0.5 * 0.7, 1e-6);
        const double kept = (2.0 + 0.5 + 0.7 + 2 * 0.5 * 0.7) / 6;  // red first twice, after green, after blue, last twice
        EXPECT_NEAR(at(c, "R", 1, 1), 0.6 * kept, 1e-6);
    }
}

TEST(Truth, EdgesOfBothFiltersHaveTheirClosedForm) {
    // The rectangle covers the left 0.3 of the middle column.
    const std::string toml = head(3, 3, 3) + "[[surface]]\nrectangle = { center = [-5.2, 0, 0], u = [5, 0, 0], v = [0, 9, 0] }\nopacity = 0.8\n";
    const Image box = trace(toml, {.max_error = 1e-4, .max_samples = 16384});
    const Image particle = trace(toml, {.filter = PixelFilter::particle, .max_error = 1e-4, .max_samples = 16384});
    EXPECT_NEAR(at(box, "A", 0, 1), 0.8, 1e-6);
    EXPECT_NEAR(at(particle, "A", 0, 1), 0.8, 1e-6);
    EXPECT_NEAR(at(box, "A", 1, 1), 0.3 * 0.8, 2e-3);
    EXPECT_NEAR(at(particle, "A", 1, 1), 1 - std::pow(0.2, 0.3), 2e-3);
    EXPECT_EQ(at(box, "A", 2, 1), 0);
}

TEST(Truth, DiscHasItsArea) {
    // An opaque sphere of radius 1 in a view of 2.4: π/2.4² of 24² pixels.
    TruthStats stats;
    const Image image = trace_truth(prepare(scene_from(head(24, 24, 2.4) + "[[surface]]\nimplicit = \"sphere\"\n")), {.max_samples = 65536}, stats);
    double sum = 0, variance = 0;
    for (std::size_t i = 0; i < image.pixel_count(); ++i) {
        sum += static_cast<double>(image.plane("A")[i]);
        variance += static_cast<double>(image.plane("variance.A")[i]);
    }
    EXPECT_NEAR(sum, M_PI * 100, 4 * std::sqrt(variance));
    EXPECT_LT(std::sqrt(variance), 0.02);
    EXPECT_EQ(stats.unresolved_pixels, 0U);
    EXPECT_LE(stats.worst_error, 2 * 0.002);
}

TEST(Truth, StatedStandardErrorIsHonest) {
    // z of a pixel's mean against its long-run mean: mean square 1 if the error is as stated. Fixed number
    // of samples; with three degrees of freedom the ratio of means is judged, not the mean of ratios.
    const std::string toml = head(4, 4, 1.6) + "[[surface]]\nimplicit = \"sphere\"\nscale = 0.7\nopacity = 0.6\n[[surface]]\nrectangle = { u = [0.3, 0.1, 0], v = [0, 0.5, 0.2] }\nopacity = 0.5\n";
    const PreparedScene scene = prepare(scene_from(toml));
    for (const PixelFilter filter : {PixelFilter::box, PixelFilter::particle}) {
        std::vector<MeanVariance> runs(16);
        MeanVariance stated[16];
        for (std::uint64_t seed = 0; seed < 200; ++seed) {
            TruthStats stats;
            const Image image = trace_truth(scene, {.filter = filter, .seed = {seed}, .max_error = 1e-9, .max_samples = 64}, stats);
            for (std::size_t i = 0; i < 16; ++i) {
                runs[i].add(static_cast<double>(image.plane("A")[i]));
                stated[i].add(static_cast<double>(image.plane("variance.A")[i]));
            }
        }
        double seen = 0, said = 0;
        for (std::size_t i = 0; i < 16; ++i) {
            seen += runs[i].variance();
            said += stated[i].mean();
        }
        // About 10 pixels with an edge × 200 runs: the ratio has a standard error of 4 %.
        EXPECT_NEAR(said / seen, 1, 0.2);
    }
}

TEST(Truth, ParticleFilterIsUnbiasedAtFewSamples) {
    // Pooling is not linear; the jackknife takes the leading bias away. 64 sub-rays against 16384.
    const std::string toml = head(4, 4, 1.6) + "[[surface]]\nimplicit = \"sphere\"\nscale = 0.7\nopacity = 0.99\n";
    const PreparedScene scene = prepare(scene_from(toml));
    TruthStats stats;
    const Image fine = trace_truth(scene, {.filter = PixelFilter::particle, .seed = {9}, .max_error = 1e-9, .max_samples = 16384}, stats);
    std::vector<MeanVariance> runs(16);
    for (std::uint64_t seed = 0; seed < 200; ++seed) {
        const Image image = trace_truth(scene, {.filter = PixelFilter::particle, .seed = {seed}, .max_error = 1e-9, .max_samples = 64}, stats);
        for (std::size_t i = 0; i < 16; ++i) runs[i].add(static_cast<double>(image.plane("A")[i]));
    }
    for (std::size_t i = 0; i < 16; ++i)
        EXPECT_NEAR(runs[i].mean(), static_cast<double>(fine.plane("A")[i]), 5 * runs[i].standard_error() + 1e-3) << i;
}

TEST(Truth, ClosedMeshHasNoOddNumberOfHits) {
    // One lost or doubled hit of opacity 0.5 moves a pixel of 64 sub-rays by more than 1e-3; inside the ball's
    // outline every ray has two.
    const fs::path folder = test_folder();
    put_sphere_mesh(folder / "m.ply", 24);
    TruthStats stats;
    const Image image = trace_truth(prepare(scene_from(head(40, 40, 1.2) + "[[surface]]\nmesh = \"m.ply\"\nopacity = 0.5\nrotate_degrees = [13, 29, 31]\n", folder)), {}, stats);
    int odd = 0;
    for (const float a : image.plane("A")) odd += std::abs(a - 0.75F) > 1e-4F ? 1 : 0;
    EXPECT_EQ(odd, 0);
    EXPECT_EQ(stats.hits, 2 * stats.rays);
}

/// Hits of one ray, given sixteen times.
std::size_t hits_of(const PreparedScene& scene, const Vec3& origin, const Vec3& direction) {
    const RayScene rays(scene);
    std::array<Ray, kPacket> packet;
    packet.fill({origin, direction});
    PacketHits hits;
    rays.gather(packet, hits);
    return hits[3].size();
}

TEST(Truth, AnEdgeOrCornerInsideTheOutlineIsMetOnce) {
    const fs::path folder = test_folder();
    std::ofstream(folder / "octahedron.obj") << "v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n"
                                                "f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n";
    const PreparedScene mesh =
        prepare(scene_from(head(8, 8, 4) + "[[surface]]\nmesh = \"octahedron.obj\"\nopacity = 0.5\n", folder));
    for (const Vec3& through : {Vec3(0, 0, 0), Vec3(0.25, 0, 0), Vec3(0, -0.5, 0), Vec3(0.2, 0.3, 0), Vec3(1e-9, 1e-9, 0)})
        EXPECT_EQ(hits_of(mesh, through + Vec3(0, 0, 4), Vec3(0, 0, -1)), 2U) << through.x << " " << through.y;

    // Sheets that are thinner than an edge is wide stay two: their sides differ, or they are no neighbours.
    std::ofstream(folder / "thin.obj") << "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv -1 -1 1e-7\nv 1 -1 1e-7\nv 1 1 1e-7\nv -1 1 1e-7\n"
                                          "f 1 2 3\nf 1 3 4\nf 5 6 7\nf 5 7 8\n";
    const PreparedScene thin =
        prepare(scene_from(head(8, 8, 4) + "[[surface]]\nmesh = \"thin.obj\"\nopacity = 0.5\n", folder));
    for (const double at : {0.0, 0.3, -0.7}) EXPECT_EQ(hits_of(thin, {at, at, 4}, {0, 0, -1}), 2U) << at;

    // Three planes of an octree's cells meet where this line does.
    const PreparedScene cubic = prepare(scene_from(
        head(8, 8, 4) + "[[surface]]\nexpression = \"x^3+y^3+z^3+2*x+y\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nopacity = 0.5\n"));
    for (int i = 0; i < 200; ++i) {
        const Vec3 along = normalize(Vec3(std::sin(i), std::cos(1.7 * i), 0.3 + std::sin(0.9 * i)));
        if (std::abs(2 * along.x + along.y) < 0.05) continue;
        EXPECT_EQ(hits_of(cubic, -4.0 * along, along) % 2, 1U) << i;
        EXPECT_LE(hits_of(cubic, -4.0 * along, along), 3U) << i;
    }
}

TEST(Truth, CropAndThreadsGiveTheSamePixels) {
    const std::string toml = "image.resolution = [20, 16]\ncamera.position = [0.5, 1, 4]\n[[surface]]\nimplicit = \"torus\"\nopacity = 0.5\n";
    for (const PixelFilter filter : {PixelFilter::box, PixelFilter::particle}) {
        const Image whole = trace(toml, {.filter = filter});
        const Image part = trace(toml, {.filter = filter}, PixelRect{3, 2, 15, 11});
        for (const std::string& name : whole.names())
            // Not at the crop's border: what lies beside a pixel may ask for a closer look at it.
            for (int y = 1; y < 8; ++y)
                for (int x = 1; x < 11; ++x) ASSERT_EQ(at(part, name.c_str(), x, y), at(whole, name.c_str(), x + 3, y + 2)) << name;
        set_thread_count(1);
        expect_same_planes(whole, trace(toml, {.filter = filter}));
        set_thread_count(0);
    }
}

TEST(Truth, ScaleOfTheSceneDoesNotMatter) {
    const auto scene = [](double s) {
        return fmt::format("image.resolution = [12, 12]\ncamera.position = [0, 0, {}]\n[[surface]]\nimplicit = \"torus\"\nopacity = 0.5\nscale = {}\nrotate_degrees = [40, 10, 0]\n", 5 * s, s);
    };
    const Image unit = trace(scene(1), {.max_error = 0.01});
    for (const double s : {1e-6, 1e6, 1e-30, 1e30}) {
        const Image image = trace(scene(s), {.max_error = 0.01});
        for (std::size_t i = 0; i < unit.pixel_count(); ++i)
            EXPECT_NEAR(static_cast<double>(image.plane("A")[i]), static_cast<double>(unit.plane("A")[i]), 0.02) << s;
    }
}

TEST(Truth, DepthIsAlongTheViewAxis) {
    // A sheet across the axis has one depth in all pixels of a perspective view, not one distance.
    const Image image = trace("image.resolution = [9, 9]\ncamera.position = [0, 0, 3]\ncamera.fov_degrees = 90\n[[surface]]\nrectangle = { u = [9, 0, 0], v = [0, 9, 0] }\n");
    for (const float z : image.plane("Z")) EXPECT_NEAR(static_cast<double>(z), 3, 1e-5);
}

}  // namespace
}  // namespace pellucid
