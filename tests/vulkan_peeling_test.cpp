// Depth peeling on Vulkan against the CPU: the same triangles in every pixel in the same order, at the same depths to the
// last bit, with validation on.
#include "vulkan/peeling.hpp"

#include <map>
#include <mutex>
#include <random>

#include "cpu/depth_peeling.hpp"
#include "render/method.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

class VulkanPeeling : public testing::Test {
protected:
    void SetUp() override {
        if (!Backend::has_vulkan()) GTEST_SKIP() << "skipped: no Vulkan device";
        device_ = std::make_unique<vulkan::Device>(vulkan::DeviceOptions{.validate = true});
        if (!device_->info().why_no_triangles.empty()) GTEST_SKIP() << "skipped: no Vulkan device that draws triangles";
    }
    void TearDown() override {
        if (device_) {
            EXPECT_TRUE(device_->validation_messages().empty());
        }
    }
    [[nodiscard]] const vulkan::Device& device() const { return *device_; }

private:
    std::unique_ptr<vulkan::Device> device_;
};

struct Fragment {
    std::uint32_t triangle;
    twin::Slab slab;
};
using Pixels = std::vector<std::vector<Fragment>>;

[[nodiscard]] std::size_t pixel_count(const PreparedScene& scene) {
    return static_cast<std::size_t>(scene.camera.width()) * static_cast<std::size_t>(scene.camera.height());
}

[[nodiscard]] Pixels by_cpu(const PreparedScene& scene, const SceneMeshes& meshes, std::span<const std::uint32_t> objects,
                            const PeelSettings& settings, PeelStats* stats = nullptr) {
    Pixels pixels(pixel_count(scene));
    const PeelStats found = peel(scene, meshes, objects, settings, [&](int x, int y, std::span<const SurfaceFragment> list) {
        auto& own = pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(scene.camera.width()) + static_cast<std::size_t>(x)];
        for (const SurfaceFragment& f : list) own.push_back({f.triangle, f.slab});
    });
    if (stats != nullptr) *stats = found;
    return pixels;
}

template <class T>
[[nodiscard]] std::vector<T> read(const vulkan::Device& device, const vulkan::Buffer& buffer) {
    std::vector<T> values(buffer.bytes() / sizeof(T));
    vulkan::download(device, buffer, std::as_writable_bytes(std::span(values)));
    return values;
}

[[nodiscard]] Pixels by_vulkan(const vulkan::Device& device, vulkan::Peeler& peeler, const PreparedScene& scene,
                               std::span<const std::uint32_t> objects, const PeelSettings& settings, PeelStats* stats = nullptr) {
    const std::size_t count = pixel_count(scene);
    Pixels pixels(count);
    const PeelStats found = peeler.peel(objects, settings, [&](const vulkan::PeeledTargets& targets) {
        const auto slabs = read<twin::Slab>(device, targets.slabs);
        const auto numbers = read<std::uint32_t>(device, targets.numbers);
        const auto counts = read<std::uint32_t>(device, targets.counts);
        for (std::size_t p = 0; p < count; ++p) {
            EXPECT_LE(counts[p], static_cast<std::uint32_t>(targets.targets));
            for (std::size_t k = 0; k < counts[p]; ++k) pixels[p].push_back({numbers[k * count + p], slabs[k * count + p]});
        }
    });
    if (stats != nullptr) *stats = found;
    return pixels;
}

struct Difference {
    std::size_t fragments = 0;
    std::size_t pixels = 0;      // whose triangles or depths are not the same
    double worst_color = 0;      // and of opacity
    double worst_thickness = 0;  // relative
    std::size_t other_bits = 0;  // fragments with any other bit
};
[[nodiscard]] Difference difference(const Pixels& a, const Pixels& b) {
    Difference d;
    for (std::size_t p = 0; p < a.size(); ++p) {
        bool same = a[p].size() == b[p].size();
        d.fragments += a[p].size();
        for (std::size_t k = 0; same && k < a[p].size(); ++k) {
            const twin::Slab& s = a[p][k].slab;
            const twin::Slab& t = b[p][k].slab;
            same = a[p][k].triangle == b[p][k].triangle && std::bit_cast<std::uint32_t>(s.z) == std::bit_cast<std::uint32_t>(t.z);
            for (const float off : {s.r - t.r, s.g - t.g, s.b - t.b, s.a - t.a})
                d.worst_color = std::max(d.worst_color, static_cast<double>(std::abs(off)));
            if (s.d != t.d) d.worst_thickness = std::max(d.worst_thickness, static_cast<double>(std::abs(s.d - t.d) / std::max(s.d, t.d)));
            d.other_bits += std::memcmp(&s, &t, sizeof(s)) != 0 ? 1 : 0;
        }
        d.pixels += same ? 0 : 1;
    }
    return d;
}

/// All objects together.
Difference compare(const vulkan::Device& device, const PreparedScene& scene, const PeelSettings& settings = {},
                   const vulkan::PeelerSettings& how = {}, const TessellationSettings& tessellation = {}) {
    const SceneMeshes meshes(scene, tessellation);
    vulkan::Peeler peeler(device, scene, meshes, how);
    const auto objects = all_objects(meshes);
    PeelStats theirs, ours;
    const Pixels cpu = by_cpu(scene, meshes, objects, settings, &theirs);
    const Pixels gpu = by_vulkan(device, peeler, scene, objects, settings, &ours);
    if (how.shift == 0) {
        EXPECT_EQ(ours.fragments, theirs.fragments);
        EXPECT_EQ(ours.pixels, theirs.pixels);
        EXPECT_EQ(ours.layers, theirs.layers);
    }
    return difference(cpu, gpu);
}

void expect_same(const Difference& d, std::size_t least_fragments) {
    EXPECT_EQ(d.pixels, 0U);
    EXPECT_LE(d.worst_color, 1e-5);
    EXPECT_LE(d.worst_thickness, 1e-6);
    EXPECT_GE(d.fragments, least_fragments);
}

struct Mesh {
    std::string vertices, faces;
    int vertex_count = 0, face_count = 0;
    int vertex(const Vec3& p) {
        vertices += fmt::format("{:.9g} {:.9g} {:.9g}\n", p.x, p.y, p.z);
        return vertex_count++;
    }
    void face(int a, int b, int c) {
        faces += fmt::format("3 {} {} {}\n", a, b, c);
        ++face_count;
    }
    fs::path put(const fs::path& file) const {
        return testing_scenes::put(file, fmt::format("ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
                                                     "property float z\nelement face {}\nproperty list uchar int vertex_indices\n"
                                                     "end_header\n{}{}",
                                                     vertex_count, face_count, vertices, faces));
    }
};

[[nodiscard]] PreparedScene mesh_scene(const fs::path& folder, const std::string& head, const std::string& surface = "opacity = 0.3\n") {
    return prepare(scene_from(head + "[[surface]]\nname = \"mesh\"\nmesh = \"mesh.ply\"\n" + surface, folder));
}

const std::string kHead = "image.resolution = [150, 110]\ncamera = { position = [0, 0, 5], fov_degrees = 30 }\n";

// Corners on the grid of pixels' centres as often as anywhere: edges through centres are where rules matter.
TEST_F(VulkanPeeling, CoversWhatTheCpuCoversOnRandomTriangles) {
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> unit(-1, 1);
    const fs::path folder = test_folder();
    const double pixel = 2.0 / 64;
    for (int kind = 0; kind < 4; ++kind) {
        Mesh mesh;
        for (int i = 0; i < 1500; ++i) {
            std::array<int, 3> corner;
            const Vec3 middle(1.2 * unit(random), 1.2 * unit(random), unit(random));
            for (int& c : corner) {
                Vec3 p = middle + Vec3(unit(random), unit(random), unit(random)) * std::pow(10.0, -1.5 * std::abs(unit(random)));
                if (kind == 1) p = Vec3(pixel * (std::round(p.x / pixel) + 0.5), pixel * (std::round(p.y / pixel) + 0.5), p.z);
                if (kind == 2) p = Vec3(p.x, middle.y + 1e-3 * unit(random), p.z);                        // slivers
                if (kind == 3) p = Vec3(pixel / 4 * std::round(4 * p.x / pixel), pixel / 4 * std::round(4 * p.y / pixel), p.z);
                c = mesh.vertex(p);
            }
            mesh.face(corner[0], corner[1], corner[2]);
        }
        mesh.put(folder / "mesh.ply");
        const PreparedScene scene = mesh_scene(
            folder, "image.resolution = [64, 64]\ncamera = { projection = \"orthographic\", position = [0, 0, 5], view_height = 2 }\n",
            "opacity = 0.01\nopacity_law = \"oblique\"\n");
        for (const bool judge_all : {false, true}) {
            SCOPED_TRACE(fmt::format("kind {}, judged {}", kind, judge_all));
            expect_same(compare(device(), scene, {}, {.targets = 16, .judge_all = judge_all}), kind == 2 ? 100 : 25000);
        }
        // The wrong twin: corners a unit of 1/256 pixel to the right, as a grid without its half of a unit has them.
        if (kind != 2) {
            EXPECT_GT(compare(device(), scene, {}, {.targets = 16, .shift = 0.75F}).pixels, 0U) << kind;
        }
    }
}

TEST_F(VulkanPeeling, AClosedMeshHasNoCracks) {
    const fs::path folder = test_folder();
    (void)put_sphere_mesh(folder / "mesh.ply", 90);
    for (const char* camera : {"camera = { position = [0, 0, 5], fov_degrees = 30 }\n",
                               "camera = { position = [0.2, -0.1, 0.3], target = [1, 0.4, 0], fov_degrees = 100 }\n",
                               "camera = { projection = \"orthographic\", position = [1, 2, 3], view_height = 2 }\n"}) {
        const PreparedScene scene = mesh_scene(folder, std::string("image.resolution = [200, 170]\n") + camera);
        expect_same(compare(device(), scene), 20000);
    }
}

// The eye among triangles: they cross the near plane, and reach far out of the image and the viewport.
TEST_F(VulkanPeeling, CutsTrianglesWhereTheCpuDoes) {
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(-1, 1);
    const fs::path folder = test_folder();
    Mesh mesh;
    for (int i = 0; i < 400; ++i) {
        const double size = std::pow(10.0, 3 * unit(random));
        std::array<int, 3> corner;
        for (int& c : corner) c = mesh.vertex(size * Vec3(unit(random), unit(random), unit(random)));
        mesh.face(corner[0], corner[1], corner[2]);
    }
    mesh.put(folder / "mesh.ply");
    for (const char* camera : {"position = [0, 0, 0.1], target = [0.3, 0.1, -1], fov_degrees = 120", "position = [0, 0, 1], fov_degrees = 5",
                               "projection = \"orthographic\", position = [0, 0, 2], view_height = 0.01, near = 1.5"}) {
        SCOPED_TRACE(camera);
        expect_same(compare(device(), mesh_scene(folder, fmt::format("image.resolution = [90, 120]\ncamera = {{ {} }}\n", camera),
                                                 "opacity = 0.05\n"), {}, {.targets = 8}), 40000);
    }
}

TEST_F(VulkanPeeling, TellsThousandsOfLayers) {
    const fs::path folder = test_folder();
    Mesh mesh;
    for (int i = 0; i < 3000; ++i) {
        const double z = 1 - 1e-3 * ((i * 1777) % 3000);  // any order
        const int first = mesh.vertex({-1, -1, z});
        (void)mesh.vertex({1, -1, z});
        (void)mesh.vertex({0, 1, z});
        mesh.face(first, first + 1, first + 2);
    }
    mesh.put(folder / "mesh.ply");
    const PreparedScene scene = mesh_scene(folder, "image.resolution = [16, 12]\ncamera.position = [0, 0, 5]\n", "opacity = 1e-4\n");
    expect_same(compare(device(), scene, {}, {.targets = 64}), 3000U * 30U);
}

/// Everything at once: copies at one place, opaque parts, clipping, bounds, laws, images and slices.
[[nodiscard]] PreparedScene crowded(const fs::path& folder, double opaque = 1) {
    (void)put_sphere_mesh(folder / "ball.ply", 24);
    (void)put_volume(folder / "v.nrrd", {9, 9, 9}, sampled({9, 9, 9}, [](const Vec3& p) { return p.x + p.y * p.z; }), Vec3(0.25));
    return prepare(scene_from(
        fmt::format("image.resolution = [190, 170]\ncamera.position = [1, 0.7, 3]\ncamera.fov_degrees = 40\n"
                    "[[light]]\ndirection = [1, 1, 1]\n[[light]]\nheadlight = true\nintensity = 0.4\n"
                    "[[surface]]\nname = \"ball\"\nmesh = \"ball.ply\"\nopacity = 0.4\nopacity_law = \"oblique\"\n"
                    "[[surface]]\nname = \"again\"\nmesh = \"ball.ply\"\nopacity = 0.2\ncolor = [1, 0, 0]\nshading = {{ specular = 0.5 }}\n"
                    "[[surface]]\nname = \"core\"\nmesh = \"ball.ply\"\nopacity = {}\nscale = 0.4\nshading = \"flat\"\n"
                    "[[surface]]\nname = \"none\"\nmesh = \"ball.ply\"\nopacity = 0\nscale = 1.1\n"
                    "[[surface]]\nname = \"half\"\nmesh = \"ball.ply\"\nscale = 0.8\nopacity = 0.5\nthickness = 0.1\n"
                    "clip = [{{ normal = [1, 0.2, 0], offset = 0.1 }}]\nbounds = [[-2, -2, -0.5], [2, 2, 2]]\n"
                    "[[surface]]\nname = \"round\"\nimplicit = \"torus\"\nopacity = 0.3\nopacity_law = \"oblique\"\n"
                    "[[surface]]\nname = \"slice\"\nslice = {{ volume = \"v.nrrd\", center = [1, 1, 1], u = [0.9, 0.1, 0.3], v = [0, 0.8, 0.1], "
                    "transfer = [[0, 0, 0, 1, 0], [2, 0, 0, 1, 0], [9, 1, 1, 0, 0.8], [30, 1, 0, 0, 1]] }}\nopacity = 0.7\n"
                    "[[surface]]\nname = \"card\"\nrectangle = {{ u = [1, 0, 0.3], v = [0, 1, 0] }}\nopacity = 0.3\n",
                    opaque),
        folder));
}

TEST_F(VulkanPeeling, ShadesEveryKindOfSurface) {
    const PreparedScene scene = crowded(test_folder(), 0.9);
    expect_same(compare(device(), scene), 50000);
    expect_same(compare(device(), scene, {.thickness = false}, {.thickness = false}), 50000);
}

// Software devices end all loops of an invocation after 65535 rounds, without a word.
TEST_F(VulkanPeeling, ShadesUnderManyLights) {
    const fs::path folder = test_folder();
    (void)put_sphere_mesh(folder / "mesh.ply", 24);
    std::string head = "image.resolution = [90, 80]\ncamera.position = [0, 0, 4]\n";
    for (int i = 0; i < 500; ++i)
        head += fmt::format("[[light]]\ndirection = [{}, {}, 1]\nintensity = 0.002\n", std::sin(i), std::cos(2 * i));
    const PreparedScene scene = mesh_scene(folder, head, "opacity = 0.3\nshading = { specular = 0.2 }\n");
    for (const int targets : {8, 64}) expect_same(compare(device(), scene, {}, {.targets = targets}), 4000);
}

TEST_F(VulkanPeeling, EndsAPixelWhereTheCpuDoes) {
    const PreparedScene scene = crowded(test_folder());
    for (const PeelSettings& settings : {PeelSettings{}, PeelSettings{.layers = 1}, PeelSettings{.layers = 3}, PeelSettings{.opaque_at = 0.8}})
        for (const int targets : {1, 2, 5}) {
            SCOPED_TRACE(fmt::format("L = {}, M = {}, opaque at {}", settings.layers, targets, settings.opaque_at));
            expect_same(compare(device(), scene, settings, {.targets = targets}), 10000);
        }
}

TEST_F(VulkanPeeling, NeedsNoMemoryThatTheHostSees) {
    const vulkan::Device apart({.validate = true, .stage_all = true});
    expect_same(compare(apart, crowded(test_folder())), 50000);
    EXPECT_TRUE(apart.validation_messages().empty());
}

TEST_F(VulkanPeeling, PeelsSomeOfTheObjects) {
    const PreparedScene scene = crowded(test_folder());
    const SceneMeshes meshes(scene, {});
    vulkan::Peeler peeler(device(), scene, meshes, {});
    for (const std::vector<std::uint32_t>& objects : {std::vector<std::uint32_t>{0}, {1, 2}, {0, 3, 5}, {3}, {6}, {}}) {
        const Pixels cpu = by_cpu(scene, meshes, objects, {});
        expect_same(difference(cpu, by_vulkan(device(), peeler, scene, objects, {})), objects.size() > 1 ? 10000 : 0);
    }
}

TEST_F(VulkanPeeling, RanksComeBeforeDepths) {
    const PreparedScene scene = crowded(test_folder(), 0.9);
    const SceneMeshes meshes(scene, {});
    std::vector<std::uint32_t> order(meshes.triangle_count());
    std::iota(order.rbegin(), order.rend(), 0U);
    expect_same(compare(device(), scene, {.order = order}), 50000);
}

TEST_F(VulkanPeeling, DrawsTheScenesOfTheRepository) {
    const fs::path folder = fs::path(PELLUCID_SOURCE_DIR) / "scenes";
    for (const char* name : {"slabs/clipped", "slabs/crossing", "slabs/cube_and_sphere", "slabs/dense_volume", "cards", "ring", "readme",
                             "step_fused", "volume_slice"}) {
        SCOPED_TRACE(name);
        const std::vector<std::string> smaller{"image.resolution=[160,120]"};
        const Scene scene = load_scene(folder / (std::string(name) + ".toml"), smaller);
        expect_same(compare(device(), prepare(scene)), 2000);
    }
}

// ---- One colour a pixel

void expect_composed(const vulkan::Device& device, const PreparedScene& scene, const PeelSettings& settings, vulkan::PeelMix mix,
                     int targets, int rows = 0, double bound = 1e-6) {
    const SceneMeshes meshes(scene, {});
    vulkan::Peeler peeler(device, scene, meshes, {.targets = targets, .thickness = false});
    const auto objects = all_objects(meshes);
    PeelStats stats, theirs;
    // In bands of rows, all rows if none are asked for.
    std::vector<twin::PeelColor> colors;
    const int height = scene.camera.height();
    for (int row = 0; row < height; row += rows > 0 ? rows : height) {
        PeelStats own;
        const auto band = peeler.compose(objects, settings, mix, {row, rows > 0 ? std::min(row + rows, height) : height}, own);
        colors.insert(colors.end(), band.begin(), band.end());
        stats.fragments += own.fragments;
        stats.pixels += own.pixels;
        stats.layers = std::max(stats.layers, own.layers);
    }
    ASSERT_EQ(colors.size(), pixel_count(scene));
    std::vector<Composite> expected(colors.size());
    std::vector<std::uint32_t> counts(colors.size(), 0);
    std::mutex mutex;
    theirs = peel(scene, meshes, objects, settings, [&](int x, int y, std::span<const SurfaceFragment> list) {
        const auto at = static_cast<std::size_t>(y * scene.camera.width() + x);
        counts[at] = static_cast<std::uint32_t>(list.size());
        if (mix == vulkan::PeelMix::by_depth) {
            expected[at] = composite_surfaces(list);
            return;
        }
        double clear = 1;
        for (const SurfaceFragment& f : list) {
            expected[at].r += clear * static_cast<double>(f.slab.r);
            clear *= 1 - static_cast<double>(f.slab.a);
        }
        expected[at].a = 1 - clear;
    });
    EXPECT_EQ(stats.fragments, theirs.fragments);
    EXPECT_EQ(stats.layers, theirs.layers);
    EXPECT_EQ(stats.pixels, theirs.pixels);
    double worst = 0;
    for (std::size_t p = 0; p < colors.size(); ++p) {
        EXPECT_EQ(colors[p].count, counts[p]) << p;
        worst = std::max({worst, std::abs(colors[p].r - expected[p].r),
                          std::abs((counts[p] > 0 ? 1 - colors[p].clear : 0) - expected[p].a)});
    }
    EXPECT_LE(worst, bound);
}

TEST_F(VulkanPeeling, ComposesAsTheCpuDoes) {
    const PreparedScene scene = crowded(test_folder(), 0.9);
    for (const int targets : {1, 2, 3, 8}) expect_composed(device(), scene, {}, vulkan::PeelMix::by_depth, targets);
    expect_composed(device(), scene, {.layers = 3}, vulkan::PeelMix::by_depth, 4);
    for (const int rows : {40, 169}) expect_composed(device(), scene, {}, vulkan::PeelMix::by_depth, 8, rows);
    const SceneMeshes meshes(scene, {});
    std::vector<std::uint32_t> order(meshes.triangle_count());
    std::iota(order.rbegin(), order.rend(), 0U);
    expect_composed(device(), scene, {.order = order}, vulkan::PeelMix::one_over_the_other, 3);
}

// More at one depth than there are slots, and than nodes of the quadrature are exact for.
TEST_F(VulkanPeeling, MixesAnyNumberAtOneDepth) {
    const fs::path folder = test_folder();
    for (const auto& [count, slots] : std::vector<std::pair<int, int>>{{2, 1}, {9, 4}, {16, 16}, {40, 32}}) {
        std::string toml = "image.resolution = [9, 7]\ncamera = { projection = \"orthographic\", position = [0, 0, 4], view_height = 2 }\n";
        for (int i = 0; i < count; ++i)
            toml += fmt::format("[[surface]]\nname = \"card {}\"\nrectangle = {{ u = [2, 0, 0], v = [0, 2, 0] }}\nopacity = {}\n"
                                "shading = \"flat\"\ncolor = [{}, 0.5, 1]\n",
                                i, 0.2 + 0.78 * i / count, 1.0 * i / count);
        const PreparedScene scene = prepare(scene_from(toml));
        expect_composed(device(), scene, {}, vulkan::PeelMix::by_depth, slots, 0, count <= 16 ? 1e-6 : 1e-3);
    }
}

// ---- The methods as users meet them

[[nodiscard]] Image draw(const PreparedScene& scene, const Backend& backend, const char* method, const std::string& settings,
                         RenderStats& stats) {
    const Config config = Config::parse(settings, "--set");
    const RenderInput input{.scene = scene, .settings = config.root().table(method), .seed = {}, .max_error = {},
                            .backend = backend, .tessellate = config.root().table("tessellate")};
    const Method& m = method_by_name(method);
    m.check_settings(input);
    config.finish();
    EXPECT_TRUE(m.on_vulkan);
    return m.render(input, stats);
}

TEST_F(VulkanPeeling, MethodsDrawTheImageOfTheCpu) {
    const Backend vulkan = Backend::open_vulkan({.validate = true});
    const PreparedScene scene = crowded(test_folder());
    for (const auto& [method, settings] :
         std::vector<std::pair<const char*, std::string>>{{"z-test", ""}, {"depth-peeling", ""}, {"depth-peeling", "depth-peeling.layers = 2"},
                                                          {"alpha-blend", ""}, {"alpha-blend", "alpha-blend.sort = \"object\""},
                                                          {"alpha-blend", "alpha-blend.sort = \"triangle\""}}) {
        SCOPED_TRACE(fmt::format("{} {}", method, settings));
        RenderStats ours, theirs;
        const Image drawn = draw(scene, vulkan, method, settings, ours);
        const Image expected = draw(scene, Backend::cpu(), method, settings, theirs);
        EXPECT_EQ(ours.hits, theirs.hits);
        EXPECT_EQ(ours.layers, theirs.layers);
        ASSERT_EQ(drawn.names(), expected.names());
        for (const std::string& name : drawn.names()) {
            float worst = 0;
            for (std::size_t i = 0; i < drawn.pixel_count(); ++i)
                if (drawn.plane(name)[i] != expected.plane(name)[i])
                    worst = std::max(worst, std::abs(drawn.plane(name)[i] - expected.plane(name)[i]));
            EXPECT_LE(worst, name == "Z" ? 0 : 1e-5F) << name;
        }
        // Stages by the device's own clock.
        double device_s = 0;
        for (const Stage& stage : ours.stages) device_s += stage.device_s.value_or(0);
        EXPECT_GT(device_s, 0);
        for (const char* name : {"peel", "shade", "read-back"})
            EXPECT_TRUE(std::ranges::any_of(ours.stages, [&](const Stage& s) { return s.name == name && s.device_s; })) << name;
    }
    vulkan.check_validation();
}

}  // namespace
}  // namespace pellucid
