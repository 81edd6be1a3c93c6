// Fragments of each pixel in order: closed forms, by passes against by tiles, and against rays.
#include "cpu/depth_peeling.hpp"

#include <map>
#include <mutex>
#include <numeric>

#include "core/parallel.hpp"
#include "reference/ray_scene.hpp"
#include "scene_testing.hpp"
#include "stage/virtual_slab.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

const std::string kHead =
    "image.resolution = [40, 32]\ncamera = { projection = \"orthographic\", position = [0, 0, 4], view_height = 2 }\n";

[[nodiscard]] std::string card(const std::string& name, double z, double opacity, const std::string& more = "") {
    return fmt::format("[[surface]]\nname = \"{}\"\nrectangle = {{ center = [0, 0, {}], u = [2, 0, 0], v = [0, 2, 0] }}\n"
                       "opacity = {}\nshading = \"flat\"\n{}\n",
                       name, z, opacity, more);
}

using Pixels = std::map<std::pair<int, int>, std::vector<SurfaceFragment>>;

[[nodiscard]] Pixels peel_all(const PreparedScene& scene, const PeelSettings& settings = {}, PeelStats* stats = nullptr,
                              const TessellationSettings& tessellation = {}) {
    const SceneMeshes meshes(scene, tessellation);
    Pixels pixels;
    std::mutex mutex;
    const PeelStats found =
        peel(scene, meshes, all_objects(meshes), settings, [&](int x, int y, std::span<const SurfaceFragment> list) {
            const std::scoped_lock lock(mutex);
            EXPECT_TRUE(pixels.emplace(std::pair{x, y}, std::vector(list.begin(), list.end())).second) << "told twice";
        });
    if (stats != nullptr) *stats = found;
    return pixels;
}

void expect_same(const Pixels& a, const Pixels& b) {
    ASSERT_EQ(a.size(), b.size());
    for (auto i = a.begin(), j = b.begin(); i != a.end(); ++i, ++j) {
        ASSERT_EQ(i->first, j->first);
        ASSERT_EQ(i->second.size(), j->second.size()) << i->first.first << ' ' << i->first.second;
        ASSERT_EQ(0, std::memcmp(i->second.data(), j->second.data(), i->second.size() * sizeof(SurfaceFragment)))
            << i->first.first << ' ' << i->first.second;
    }
}

TEST(DepthPeeling, AStackOfCardsIsTheirProduct) {
    std::string toml = kHead;
    double clear = 1;
    double red = 0;
    for (int i = 0; i < 12; ++i) {
        const double alpha = 0.05 + 0.02 * i;
        // The file has them from back to front.
        toml = kHead + card(fmt::format("card {}", i), 1 - 0.1 * i, alpha, fmt::format("color = [{}, 0.5, 1]", 0.08 * i)) + toml.substr(kHead.size());
        red += clear * alpha * 0.08 * i;
        clear *= 1 - alpha;
    }
    const PreparedScene scene = prepare(scene_from(toml));
    PeelStats stats;
    const Pixels pixels = peel_all(scene, {}, &stats);
    EXPECT_EQ(stats.layers, 12U);
    EXPECT_EQ(stats.pixels, 40U * 32U);
    EXPECT_EQ(stats.fragments, 12U * 40U * 32U);
    ASSERT_EQ(pixels.size(), 40U * 32U);
    for (const auto& [place, list] : pixels) {
        const Composite c = composite_surfaces(list);
        EXPECT_NEAR(c.a, 1 - clear, 1e-6);
        EXPECT_NEAR(c.r, red, 1e-6);
        EXPECT_NEAR(c.g, 0.5 * (1 - clear), 1e-6);
        EXPECT_NEAR(c.b, 1 - clear, 1e-6);
        for (std::size_t i = 0; i < list.size(); ++i) EXPECT_FLOAT_EQ(list[i].slab.z, 3.0F + 0.1F * static_cast<float>(i));
    }
}

TEST(DepthPeeling, NothingIsToldBehindAnOpaqueCard) {
    const PreparedScene scene = prepare(scene_from(kHead + card("back", -1, 0.5) + card("wall", 0, 1) + card("glass", 1, 0.5)));
    PeelStats stats;
    for (const auto& [place, list] : peel_all(scene, {}, &stats)) {
        ASSERT_EQ(list.size(), 2U);
        EXPECT_EQ(list[0].object, 2U);
        EXPECT_EQ(list[1].object, 1U);
    }
    EXPECT_EQ(stats.layers, 2U);
}

TEST(DepthPeeling, AccumulatedOpacityEndsAPixel) {
    std::string toml = kHead;
    for (int i = 0; i < 10; ++i) toml += card(fmt::format("card {}", i), -0.1 * i, 0.5);
    const PreparedScene scene = prepare(scene_from(toml));
    for (const auto& [place, list] : peel_all(scene, {.opaque_at = 0.9})) EXPECT_EQ(list.size(), 4U);  // 1 − 2^-4 = 0.9375
    for (const auto& [place, list] : peel_all(scene, {.layers = 3})) EXPECT_EQ(list.size(), 3U);
}

TEST(DepthPeeling, CoincidentCardsMixTheSameInAnyOrder) {
    const std::vector<std::string> cards{card("red", 0, 0.3, "color = [1, 0, 0]"), card("green", 0, 0.5, "color = [0, 1, 0]"),
                                         card("blue", 0, 0.9, "color = [0, 0, 1]"), card("behind", -0.5, 0.5)};
    std::vector<std::size_t> order{0, 1, 2, 3};
    do {
        std::string toml = kHead;
        for (const std::size_t i : order) toml += cards[i];
        const Pixels pixels = peel_all(prepare(scene_from(toml)));
        ASSERT_EQ(pixels.size(), 40U * 32U);
        for (const auto& [place, list] : pixels) {
            ASSERT_EQ(list.size(), 4U);
            const Composite c = composite_surfaces(list);
            // ∫ Π (1 − u α_j) du of the other two, for each; 0.035 passes to the fourth.
            const auto share = [](double a, double b) { return 1 - (a + b) / 2 + a * b / 3; };
            const double last = 0.7 * 0.5 * 0.1 * 0.5 * 0.8;
            EXPECT_NEAR(c.r, 0.3 * share(0.5, 0.9) + last, 1e-6);
            EXPECT_NEAR(c.g, 0.5 * share(0.3, 0.9) + last, 1e-6);
            EXPECT_NEAR(c.b, 0.9 * share(0.3, 0.5) + last, 1e-6);
            EXPECT_NEAR(c.a, 1 - 0.7 * 0.5 * 0.1 * 0.5, 1e-6);
        }
    } while (std::next_permutation(order.begin(), order.end()));
}

TEST(DepthPeeling, TwoCoincidentCardsMixBy4_4) {
    const PreparedScene scene = prepare(scene_from(kHead + card("red", 0, 0.25, "color = [1, 0, 0]") + card("green", 0, 0.5, "color = [0, 1, 0]")));
    for (const auto& [place, list] : peel_all(scene)) {
        const Composite c = composite_surfaces(list);
        EXPECT_NEAR(c.r, 0.25 - 0.5 * 0.25 * 0.5, 1e-7);  // C1 − ½ C1 α2
        EXPECT_NEAR(c.g, 0.5 - 0.5 * 0.5 * 0.25, 1e-7);
    }
}

/// Everything at once: closed and open meshes, copies at the same place, opaque parts, clipping, bounds, laws.
[[nodiscard]] PreparedScene crowded(const fs::path& folder, double opaque = 1) {
    (void)put_sphere_mesh(folder / "ball.ply", 12);
    return prepare(scene_from(
        fmt::format("image.resolution = [90, 70]\ncamera.position = [1, 0.7, 3]\ncamera.fov_degrees = 40\n"
                    "[[surface]]\nname = \"ball\"\nmesh = \"ball.ply\"\nopacity = 0.4\nopacity_law = \"oblique\"\n"
                    "[[surface]]\nname = \"again\"\nmesh = \"ball.ply\"\nopacity = 0.2\ncolor = [1, 0, 0]\n"
                    "[[surface]]\nname = \"core\"\nmesh = \"ball.ply\"\nopacity = {}\nscale = 0.4\n"
                    "[[surface]]\nname = \"half\"\nmesh = \"ball.ply\"\nscale = 0.8\nopacity = 0.5\nthickness = 0.1\n"
                    "clip = [{{ normal = [1, 0.2, 0], offset = 0.1 }}]\nbounds = [[-2, -2, -0.5], [2, 2, 2]]\n"
                    "[[surface]]\nname = \"card\"\nrectangle = {{ u = [1, 0, 0.3], v = [0, 1, 0] }}\nopacity = 0.3\n",
                    opaque),
        folder));
}

TEST(DepthPeeling, TilesAndPassesTellTheSameFragments) {
    const PreparedScene scene = crowded(test_folder());
    const SceneMeshes meshes(scene, {});
    for (const PeelSettings& settings : {PeelSettings{}, PeelSettings{.layers = 1}, PeelSettings{.layers = 4}, PeelSettings{.opaque_at = 0.8}})
        for (const int targets : {1, 4}) {
            Pixels passes;
            std::size_t calls = 0;
            const PeelStats by_passes = peel_by_passes(
                scene, meshes, all_objects(meshes), settings, targets, [&](std::span<const PeelTarget> filled) {
                    ++calls;
                    EXPECT_LE(filled.size(), static_cast<std::size_t>(targets));
                    for (const PeelTarget& target : filled)
                        for (std::size_t i = 0; i < target.fragments.size(); ++i)
                            if (target.fragments[i].triangle != PeelTarget::kNoFragment)
                                passes[{static_cast<int>(i) % 90, static_cast<int>(i) / 90}].push_back(target.fragments[i]);
                });
            PeelStats stats;
            const Pixels tiles = peel_all(scene, settings, &stats);
            expect_same(passes, tiles);
            EXPECT_EQ(by_passes.fragments, stats.fragments);
            EXPECT_EQ(by_passes.layers, stats.layers);
            EXPECT_EQ(by_passes.pixels, stats.pixels);
            EXPECT_EQ(calls, (stats.layers + static_cast<std::size_t>(targets) - 1) / static_cast<std::size_t>(targets));
            EXPECT_EQ(by_passes.passes, stats.layers + 1);
            EXPECT_GT(stats.fragments, 2000U);
        }
}

TEST(DepthPeeling, ThreadsDoNotMatter) {
    const PreparedScene scene = crowded(test_folder());
    set_thread_count(1);
    const Pixels one = peel_all(scene);
    set_thread_count(7);
    const Pixels seven = peel_all(scene);
    set_thread_count(0);
    expect_same(one, seven);
}

/// The pixels' centres as rays.
[[nodiscard]] std::map<std::pair<int, int>, std::vector<RayHit>> trace_centers(const PreparedScene& scene) {
    const RayScene rays(scene);
    std::map<std::pair<int, int>, std::vector<RayHit>> all;
    PacketHits found;
    const Camera& camera = scene.camera;
    for (int y = 0; y < camera.height(); ++y)
        for (int x0 = 0; x0 < camera.width(); x0 += kPacket) {
            std::array<Ray, kPacket> packet;
            for (int i = 0; i < kPacket; ++i)
                packet[static_cast<std::size_t>(i)] = camera.ray(std::min(x0 + i, camera.width() - 1) + 0.5, y + 0.5);
            rays.gather(packet, found);
            for (int i = 0; i < kPacket && x0 + i < camera.width(); ++i) all[{x0 + i, y}] = found[static_cast<std::size_t>(i)];
        }
    return all;
}

TEST(DepthPeeling, MeshesHaveTheCrossingsOfRays) {
    // Nothing opaque: rays know of no end.
    const PreparedScene scene = crowded(test_folder(), 0.9);
    const Pixels pixels = peel_all(scene);
    std::size_t compared = 0, other = 0;
    for (const auto& [place, hits] : trace_centers(scene)) {
        const auto found = pixels.find(place);
        const auto list = found == pixels.end() ? std::vector<SurfaceFragment>() : found->second;
        // Outlines are snapped to 1/256 pixel: a centre in a few hundred is on the other side of some edge.
        if (list.size() != hits.size()) {
            ++other;
            continue;
        }
        ++compared;
        std::vector<std::uint32_t> theirs, ours;
        for (std::size_t i = 0; i < list.size(); ++i) {
            EXPECT_NEAR(static_cast<double>(list[i].slab.z), hits[i].t, 2e-4);  // beyond an edge its neighbour's plane goes on
            theirs.push_back(hits[i].object);
            ours.push_back(list[i].object);
            const Object& object = scene.objects[list[i].object];
            if (object.surface.opacity_law == OpacityLaw::constant) {
                EXPECT_FLOAT_EQ(list[i].slab.a, static_cast<float>(object.surface.opacity));
            }
        }
        std::sort(theirs.begin(), theirs.end());
        std::sort(ours.begin(), ours.end());
        EXPECT_EQ(ours, theirs);
    }
    EXPECT_GT(compared, 6000U);
    EXPECT_LE(other, 60U);
}

TEST(DepthPeeling, TheEyeInsideABallSeesItOnceInEveryPixel) {
    const fs::path folder = test_folder();
    (void)put_sphere_mesh(folder / "ball.ply", 8);
    for (const std::string kind : {"mesh = \"ball.ply\"", "implicit = \"sphere\""}) {
        const PreparedScene scene =
            prepare(scene_from("image.resolution = [64, 48]\ncamera = { position = [0.2, -0.1, 0.3], target = [1, 0.4, 0], "
                               "fov_degrees = 100 }\n[[surface]]\nname = \"ball\"\nopacity = 0.5\n" + kind + "\n",
                               folder));
        const Pixels pixels = peel_all(scene);
        EXPECT_EQ(pixels.size(), 64U * 48U) << kind;
        for (const auto& [place, list] : pixels) EXPECT_EQ(list.size(), 1U);
    }
}

TEST(DepthPeeling, ATessellatedSphereIsTheSphere) {
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [128, 128]\ncamera = { projection = \"orthographic\", position = [0, 0, 4], view_height = 2.2 }\n"
        "[[surface]]\nname = \"ball\"\nimplicit = \"sphere\"\nopacity = 0.3\nopacity_law = \"oblique\"\nshading = \"flat\"\n"));
    const SceneMeshes meshes(scene, {});
    EXPECT_LE(meshes.error_px(), 0.25);
    EXPECT_GT(meshes.error_px(), 0.01);
    const Pixels pixels = peel_all(scene);
    const double pixel = 2.2 / 128;
    for (int y = 0; y < 128; ++y)
        for (int x = 0; x < 128; ++x) {
            const double r2 = std::pow((x + 0.5 - 64) * pixel, 2) + std::pow((y + 0.5 - 64) * pixel, 2);
            const auto found = pixels.find({x, y});
            if (r2 > std::pow(1 + 0.25 * pixel, 2)) {
                EXPECT_EQ(found, pixels.end());
            } else if (r2 < std::pow(1 - 0.5 * pixel, 2)) {
                ASSERT_NE(found, pixels.end()) << x << ' ' << y;
                ASSERT_EQ(found->second.size(), 2U) << x << ' ' << y;
            }
            if (r2 > 0.95) continue;
            const double cosine = std::sqrt(1 - r2);
            for (const int side : {0, 1}) {
                const twin::Slab& slab = found->second[static_cast<std::size_t>(side)].slab;
                EXPECT_NEAR(static_cast<double>(slab.z), 4 + (side == 0 ? -cosine : cosine), 0.25 * pixel / cosine);
                // A quarter of a pixel beside the sphere, cosθ is off by about as much as the depth.
                const double off = 0.25 * pixel / cosine;
                EXPECT_LE(static_cast<double>(slab.a), 1 - std::pow(0.7, 1 / (cosine - off)));
                EXPECT_GE(static_cast<double>(slab.a), 1 - std::pow(0.7, 1 / (cosine + off)));
            }
        }
}

TEST(VirtualSlab, AVolumeGivesItsPitchAndAHandGoesBefore) {
    const fs::path folder = test_folder();
    (void)put_volume(folder / "v.nrrd", {4, 4, 4}, sampled({4, 4, 4}, [](const Vec3& p) { return p.x; }), {1, 0.25, 2});
    const std::string iso = "[[surface]]\nname = \"iso\"\nisosurface = { volume = \"v.nrrd\", isovalue = 1.5 }\nscale = 3\n";
    const std::string volume = "[[volume]]\nname = \"v\"\nfile = \"v.nrrd\"\ntransfer = [[0, 0, 0, 0, 0], [3, 1, 1, 1, 1]]\nscale = 2\n";
    const auto thickness = [&](const std::string& toml) {
        const PreparedScene scene = prepare(scene_from(kHead + toml, folder));
        return fixed_thickness(scene, scene.objects.front());
    };
    EXPECT_EQ(thickness(card("a", 0, 1)), std::nullopt);
    EXPECT_DOUBLE_EQ(*thickness(card("a", 0, 1) + volume), 0.5);
    EXPECT_DOUBLE_EQ(*thickness(card("a", 0, 1) + iso), 0.75);
    EXPECT_DOUBLE_EQ(*thickness(card("a", 0, 1) + iso + volume), 0.5);
    EXPECT_DOUBLE_EQ(*thickness(card("a", 0, 1, "thickness = 7") + volume), 7);
}

TEST(VirtualSlab, ThePixelsThicknessIsHalfOfThePixelOnTheSurface) {
    std::mt19937_64 random(1);
    std::normal_distribution<double> normal;
    for (const auto projection : {Projection::perspective, Projection::orthographic}) {
        const Camera camera({.projection = projection, .position = {0, 0, 5}, .target = {0, 0, 0}}, {.width = 100, .height = 80},
                            Box{Vec3(-2), Vec3(2)});
        int within = 0;
        for (int trial = 0; trial < 500; ++trial) {
            const Vec3 n(normal(random), normal(random), normal(random));
            const double x = 50 + 10 * normal(random), y = 40 + 10 * normal(random);
            const Ray ray = camera.ray(x, y);
            const Vec3 place = ray.origin + 5.0 * ray.direction;
            // The longest way on the surface that a step across the ray of one pixel's size takes: stepped along the
            // steepest direction.
            const Vec3 r = ray.direction / length(ray.direction);
            const Vec3 across = n - dot(n, r) * r;
            const double stretch = length(across) > 0 ? length(across / length(across) - dot(n, across / length(across)) / dot(n, r) * r) : 1;
            const double side = camera.pixel_size() * (projection == Projection::perspective ? 5 : 1);
            const double d = pixel_thickness(camera, camera.to_view(place), camera.view_vector(n));
            EXPECT_NEAR(d, 0.5 * side * std::min(stretch, kMostStretch), 1e-9 * side);
            within += stretch < kMostStretch ? 1 : 0;
        }
        EXPECT_GT(within, 300);
        // Face on, edge on.
        const Vec3 view(0, 0, 5);
        const double side = camera.pixel_size() * (projection == Projection::perspective ? 5 : 1);
        EXPECT_DOUBLE_EQ(pixel_thickness(camera, view, {0, 0, 1}), 0.5 * side);
        EXPECT_DOUBLE_EQ(pixel_thickness(camera, view, {1, 0, 0}), 0.5 * kMostStretch * side);
    }
}

TEST(VirtualSlab, SlabsOfFragmentsAreThatThick) {
    const PreparedScene scene = prepare(scene_from(kHead + card("flat", 0, 0.5) +
        "[[surface]]\nname = \"tilted\"\nrectangle = { center = [0, 0, -5], u = [2, 0, 2], v = [0, 2, 0] }\nopacity = 0.5\n"));
    for (const auto& [place, list] : peel_all(scene)) {
        ASSERT_EQ(list.size(), 2U);
        EXPECT_FLOAT_EQ(list[0].slab.d, 0.5F * 2.0F / 32);
        EXPECT_FLOAT_EQ(list[1].slab.d, 0.5F * std::sqrt(2.0F) * 2.0F / 32);
    }
    for (const auto& [place, list] : peel_all(scene, {.thickness = false})) EXPECT_EQ(list[1].slab.d, 0);
}

}  // namespace
}  // namespace pellucid
