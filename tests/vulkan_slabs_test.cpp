// Method slabs on Vulkan beside the CPU: all modes, formats, compressions and numbers of layers, on scenes of polygons,
// isosurfaces and volumes.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "io/config.hpp"
#include "render/backend.hpp"
#include "scene/scene_file.hpp"
#include "scene_testing.hpp"
#include "study/method_image.hpp"

namespace pellucid {
namespace {

namespace fs = std::filesystem;

class VulkanSlabs : public testing::Test {
protected:
    void SetUp() override {
        if (!Backend::has_vulkan()) GTEST_SKIP() << "skipped: no Vulkan device";
        static const Backend opened = Backend::open_vulkan({.validate = true});
        backend_ = &opened;
    }
    void TearDown() override {
        if (backend_ != nullptr) {
            EXPECT_NO_THROW(backend_->check_validation());
        }
    }
    [[nodiscard]] const Backend& device() const { return *backend_; }
    /// Mesa's has the same bits as the CPU; a real GPU may differ where it rounds divisions in another way.
    [[nodiscard]] bool in_software() const { return backend_->device_name().find("llvmpipe") != std::string::npos; }

    [[nodiscard]] static Image draw(const PreparedScene& scene, const std::vector<std::string>& settings, const Backend& backend) {
        RenderStats stats;
        return method_image(scene, {"slabs", settings}, Seed{1}, stats, backend);
    }
    /// Share of pixels that differ in a colour or the opacity by more than `limit`, and the 99th percentile of the differences.
    struct Difference {
        double share = 0, percentile = 0;
        std::size_t other_bits = 0;  // planes Z included
    };
    [[nodiscard]] static Difference between(const Image& a, const Image& b, float limit) {
        Difference d;
        std::vector<float> worst(a.pixel_count());
        for (const char* plane : {"R", "G", "B", "A", "Z"}) {
            const auto pa = a.plane(plane), pb = b.plane(plane);
            for (std::size_t i = 0; i < worst.size(); ++i) {
                d.other_bits += pa[i] != pb[i] ? 1U : 0U;
                if (plane[0] != 'Z') worst[i] = std::max(worst[i], std::abs(pa[i] - pb[i]));
            }
        }
        d.share = static_cast<double>(std::ranges::count_if(worst, [&](float w) { return !(w <= limit); })) /
                  static_cast<double>(worst.size());
        std::ranges::sort(worst);
        d.percentile = static_cast<double>(worst[worst.size() * 99 / 100]);
        return d;
    }
    void expect_same(const PreparedScene& scene, const std::vector<std::string>& settings) const {
        std::string all;
        for (const std::string& setting : settings) all += setting + " ";
        SCOPED_TRACE(all);
        const Difference d = between(draw(scene, settings, device()), draw(scene, settings, Backend::cpu()), 1e-5F);
        EXPECT_LE(d.share, 0.001);
        EXPECT_LE(d.percentile, 1e-6);
        if (in_software()) {
            EXPECT_EQ(d.other_bits, 0U);
        }
    }

private:
    const Backend* backend_ = nullptr;
};

[[nodiscard]] PreparedScene scene_file(const std::string& name, int width, int height) {
    Config config = Config::read(fs::path(PELLUCID_SOURCE_DIR) / "scenes/slabs" / (name + ".toml"));
    Scene scene = scene_from_config(config);
    config.finish();
    scene.image.width = width;
    scene.image.height = height;
    return prepare(scene);
}

/// Three media, an isosurface, a mesh in a clip plane and spheres that cross each other. Its sides are no whole packets, nor
/// whole words of flags.
[[nodiscard]] PreparedScene mixed_scene() {
    const fs::path folder = fs::path(testing::TempDir()) / "vulkan_slabs" / testing::UnitTest::GetInstance()->current_test_info()->name();
    fs::create_directories(folder);
    const fs::path grid = folder / "grid.nrrd";
    {
        std::ofstream out(grid, std::ios::binary);
        out << "NRRD0004\ntype: float\ndimension: 3\nsizes: 12 11 13\nspacings: 0.17 0.17 0.17\nencoding: raw\nendian: little\n\n";
        for (int i = 0; i < 12 * 11 * 13; ++i) {
            const auto v = static_cast<float>(std::sin(0.9 * (i % 12)) + std::cos(0.7 * (i / 12 % 11)) + std::sin(0.5 * (i / 132)));
            out.write(reinterpret_cast<const char*>(&v), sizeof v);
        }
    }
    return prepare(testing_scenes::scene_from(fmt::format(R"toml(
[image]
resolution = [45, 37]
[camera]
position = [1.1, 0.8, 4]
fov_degrees = 34
[[volume]]
name = "waves"
expression = "sin(5*x)*cos(4*y) + sin(3*z)"
bounds = [[-1, -1, -1], [1, 1, 1]]
resolution = [21, 17, 25]
transfer = [[-0.5, 1, 0.2, 0.1, 0], [0.2, 0.9, 0.7, 0.1, 0.08], [0.2, 0.1, 0.4, 1, 0.3], [1.5, 0.2, 1, 0.4, 0.6]]
shading = {{ ambient = 0.4, diffuse = 0.6, specular = 0.2, shininess = 12 }}
rotate_degrees = [10, 20, 30]
[[volume]]
name = "smooth"
file = "{0}"
interpolation = "catmull-rom"
transfer = [[0, 0.2, 0.9, 0.3, 0], [1, 0.1, 0.7, 0.9, 0.1], [2, 0.1, 0.7, 0.9, 0.4]]
translate = [-1.2, -0.9, -0.6]
[[volume]]
name = "labels"
file = "{0}"
interpolation = "nearest"
transfer = [[0.5, 0.9, 0.9, 0.3, 0], [0.5, 0.9, 0.9, 0.3, 0.2], [3, 0.9, 0.5, 0.9, 0.3]]
translate = [-0.7, -0.9, -0.9]
clip = [{{ normal = [1, 0.2, 0], offset = 0.4 }}]
[[surface]]
name = "iso"
isosurface = {{ volume = "{0}", isovalue = 0.4 }}
opacity = 0.35
color = [0.8, 0.3, 0.3]
translate = [-0.9, -0.9, -1.1]
[[surface]]
name = "ball"
implicit = "sphere"
parameters = {{ radius = 0.7 }}
translate = [0.3, 0, 0.2]
opacity = 0.4
thickness = 0.3
[[surface]]
name = "other ball"
implicit = "sphere"
parameters = {{ radius = 0.6 }}
translate = [-0.2, 0.2, 0.3]
opacity = 0.6
color = [0.2, 0.4, 0.9]
[[surface]]
name = "wall"
rectangle = {{ center = [0, 0, -0.5], u = [1.2, 0, 0.3], v = [0, 1.1, 0] }}
opacity = 1
clip = [{{ normal = [0, 1, 0], offset = 0.6 }}]
)toml",
                                                          grid.string())));
}

TEST_F(VulkanSlabs, EveryModeOfIntermixingDrawsTheCpusPictures) {
    const PreparedScene scene = mixed_scene();
    for (const char* way : {"image average", "image normalised", "hybrid extinction", "order-free average", "order-free extinction"}) {
        const std::string text = way;
        const std::size_t gap = text.find(' ');
        expect_same(scene, {fmt::format("slabs.intermix=\"{}\"", text.substr(0, gap)),
                            fmt::format("slabs.mixing=\"{}\"", text.substr(gap + 1))});
    }
}

TEST_F(VulkanSlabs, EveryInterpolationCompressionAndFormatDrawsTheCpusPictures) {
    const PreparedScene scene = mixed_scene();
    for (const char* interpolation : {"original", "original-textbook"})
        expect_same(scene, {fmt::format("slabs.interpolation=\"{}\"", interpolation)});
    for (const char* compression : {"slope", "tail"}) expect_same(scene, {fmt::format("slabs.compression=\"{}\"", compression)});
    for (const char* format : {"half", "byte"})
        expect_same(scene, {fmt::format("slabs.format=\"{}\"", format), "slabs.intermix=\"hybrid\""});
}

TEST_F(VulkanSlabs, AnyNumberOfLayersAndSurfacesDrawsTheCpusPictures) {
    const PreparedScene scene = mixed_scene();
    for (const int layers : {2, 3, 5, 16, 64, 1024}) expect_same(scene, {fmt::format("slabs.layers={}", layers)});
    expect_same(scene, {"slabs.layers=1024", "slabs.intermix=\"order-free\""});  // bands of rays get narrow
    for (const int targets : {1, 7, 64}) expect_same(scene, {fmt::format("slabs.targets={}", targets)});
    expect_same(scene, {"slabs.surfaces=1"});
    expect_same(scene, {"slabs.step=0.37", "slabs.skip=false"});
    expect_same(scene, {"slabs.opaque_at=1"});
}

TEST_F(VulkanSlabs, ScenesOfTheExperimentsAreTheCpus) {
    for (const char* name : {"crossing", "cube_and_sphere", "clipped", "dense_volume", "layers_scientific"}) {
        SCOPED_TRACE(name);
        expect_same(scene_file(name, 50, 41), {});
    }
}

TEST_F(VulkanSlabs, NothingToDrawIsAnEmptyPicture) {
    const PreparedScene scene = prepare(testing_scenes::scene_from("[image]\nresolution = [9, 7]\n[camera]\nposition = [0, 0, 4]\n"
                                                                   "[[surface]]\nname = \"far\"\nimplicit = \"sphere\"\n"
                                                                   "translate = [50, 0, 0]\n"));
    expect_same(scene, {});
    expect_same(scene, {"slabs.intermix=\"order-free\""});
}

TEST_F(VulkanSlabs, AWrongTwinIsSeen) {
    const PreparedScene scene = mixed_scene();
    const Image cpu = draw(scene, {}, Backend::cpu());
    for (const char* wrong : {"slabs.compression=\"tail\"", "slabs.interpolation=\"original\"", "slabs.layers=7", "slabs.step=1.01"}) {
        const Difference d = between(draw(scene, {wrong}, device()), cpu, 1e-5F);
        EXPECT_TRUE(d.share > 0.001 || d.percentile > 1e-6) << wrong;
    }
}

TEST_F(VulkanSlabs, StagesTellTheDevicesTime) {
    RenderStats stats;
    (void)method_image(mixed_scene(), {"slabs", {}}, Seed{1}, stats, device());
    for (const char* name : {"peel", "cast", "kernel", "read-back"}) {
        const auto found = std::ranges::find(stats.stages, name, &Stage::name);
        ASSERT_NE(found, stats.stages.end()) << name;
        ASSERT_TRUE(found->device_s) << name;
        EXPECT_GT(*found->device_s, 0) << name;
    }
}

}  // namespace
}  // namespace pellucid
