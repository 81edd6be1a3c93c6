// The volume stage on Vulkan beside the fast one of the CPU: its slabs, bit for bit where the device divides
// as the standard says; validation on.
#include <optional>
#include <random>

#include "cpu/fast_volume_caster.hpp"
#include "kernel/plain_cast_twin.h"
#include "render/method.hpp"
#include "scene_testing.hpp"
#include "vulkan/multi_volume_caster.hpp"
#include "vulkan/volume_caster.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;
using twin::Slab;

class VulkanVolumes : public testing::Test {
protected:
    void SetUp() override {
        if (!Backend::has_vulkan()) GTEST_SKIP() << "skipped: no Vulkan device";
    }
};

enum class Samples { bytes, words, floats, holes };
constexpr Samples kEverySample[] = {Samples::bytes, Samples::words, Samples::floats, Samples::holes};

/// Values of [0, 1] as a volume stores them.
struct Stored {
    double scale, offset;
    explicit Stored(Samples samples)
        : scale(samples == Samples::bytes   ? 255
                : samples == Samples::words ? 6000
                                            : 0.37),
          offset(samples == Samples::words ? -3000 : 0) {}
    [[nodiscard]] double of(double v) const { return offset + scale * v; }
};

struct Case {
    std::string name;
    Samples samples = Samples::bytes;
    std::array<int, 3> size{43, 38, 27};
    std::vector<std::array<double, 5>> transfer = {
        {0.1, 1, 0, 0, 0}, {0.4, 0, 1, 0, 0.2}, {0.6, 0, 0, 1, 0.05}, {0.9, 1, 1, 1, 0.6}};
    std::string shading = "\"flat\"";
    std::string place = "matrix = [0.9,0.2,0,-0.8, -0.3,1,0.1,-0.9, 0,0.2,-1,0.9, 0,0,0,1]\n";
    std::string camera = "position = [3, 2.5, 4]\ntarget = [0.2, 0.1, 0.2]\nfov_degrees = 28\n";
    std::string interpolation = "trilinear";
    double step = 0.7;
    int width = 30, height = 27;
};

const std::string kLit = "{ ambient = 0.3, diffuse = 0.7, specular = 0.4 }";

/// Smooth in one half, random in the other, empty at one end.
void put_samples(const fs::path& file, const Case& c) {
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    const Stored stored(c.samples);
    std::vector<float> values = sampled(c.size, [&](const Vec3& p) {
        const double noise = unit(random);
        const double v =
            p.x > 28   ? 0.05
            : p.y > 30 ? noise
                       : 0.5 + 0.4 * std::sin(0.5 * p.x) * std::cos(0.4 * p.y + 0.3 * p.z) + 0.05 * noise;
        const double value = stored.of(v);
        return c.samples == Samples::bytes || c.samples == Samples::words ? std::round(value) : value;
    });
    if (c.samples == Samples::holes)
        for (std::size_t i = 0; i < values.size(); ++i)
            if (i % 43 < 10 && i / 43 % 38 > 14) values[i] = std::numeric_limits<float>::quiet_NaN();
    put_volume(file, c.size, values, {0.05, 0.06, 0.08});
}

std::string volume_toml(const Case& c, const std::string& file) {
    const Stored stored(c.samples);
    std::string transfer;
    for (const auto& p : c.transfer)
        transfer += fmt::format("[{}, {}, {}, {}, {}], ", stored.of(p[0]), p[1], p[2], p[3], p[4]);
    return fmt::format(
        "[[volume]]\nfile = \"{}\"\nopacity_step = 0.2\ninterpolation = \"{}\"\ntransfer = [{}]\nshading = "
        "{}\n{}",
        file, c.interpolation, transfer, c.shading, c.place);
}

std::string head_toml(const Case& c) {
    return fmt::format(
        "image.resolution = [{}, {}]\n[camera]\n{}[[light]]\nheadlight = true\n[[light]]\ndirection = [1, 2, "
        "0]\n"
        "intensity = 0.5\n",
        c.width, c.height, c.camera);
}

PreparedScene scene_of(const Case& c) {
    const fs::path folder = test_folder();
    put_samples(folder / "v.nrrd", c);
    return prepare(scene_from(head_toml(c) + volume_toml(c, "v.nrrd"), folder));
}

vulkan::SlabLists slabs_on_cpu(const PreparedScene& scene, const CastSettings& settings, float opaque_at) {
    const FastVolumeCaster caster(scene, scene.volumes[0], settings);
    const int width = scene.camera.width(), height = scene.camera.height();
    vulkan::SlabLists lists(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
    FastVolumeCaster::PacketSlabs packet;
    for (int y = 0; y < height; y += 4)
        for (int x = 0; x < width; x += 4) {
            caster.cast(x, y, opaque_at, packet);
            for (int i = 0; i < 16; ++i)
                if (x + i % 4 < width && y + i / 4 < height)
                    lists[static_cast<std::size_t>((y + i / 4) * width + x + i % 4)] =
                        packet[static_cast<std::size_t>(i)];
        }
    return lists;
}

/// Steps between two floats; 0 for ±0.
std::uint32_t ulps(float a, float b) {
    if (a == b) return 0;
    const auto ordered = [](float v) {
        const auto bits = std::bit_cast<std::int32_t>(v);
        return static_cast<std::int64_t>(bits < 0 ? std::numeric_limits<std::int32_t>::min() - bits : bits);
    };
    return static_cast<std::uint32_t>(
        std::min<std::int64_t>(std::abs(ordered(a) - ordered(b)), 0xffffffffLL));
}

struct Agreement {
    std::size_t slabs = 0, other = 0, rays = 0, other_rays = 0;
    std::uint32_t worst = 0;  // ULP
};
Agreement compare(const vulkan::SlabLists& device, const vulkan::SlabLists& cpu) {
    Agreement a;
    EXPECT_EQ(device.size(), cpu.size());
    for (std::size_t i = 0; i < cpu.size(); ++i) {
        ++a.rays;
        a.slabs += cpu[i].size();
        if (device[i].size() != cpu[i].size()) {
            ++a.other_rays;
            continue;
        }
        for (std::size_t k = 0; k < cpu[i].size(); ++k) {
            const auto x = std::bit_cast<std::array<float, 6>>(device[i][k]);
            const auto y = std::bit_cast<std::array<float, 6>>(cpu[i][k]);
            std::uint32_t worst = 0;
            for (std::size_t f = 0; f < 6; ++f) worst = std::max(worst, ulps(x[f], y[f]));
            a.worst = std::max(a.worst, worst);
            if (worst > 0) ++a.other;
        }
    }
    return a;
}

/// Accumulated colour and opacity of each pixel.
std::vector<std::array<double, 4>> composited(const vulkan::SlabLists& lists) {
    std::vector<std::array<double, 4>> pixels;
    for (const auto& slabs : lists) {
        std::array<double, 4> sum{};
        for (const Slab& s : slabs) {
            const std::array<float, 4> rgba{s.r, s.g, s.b, s.a};
            const double clear = 1 - sum[3];
            for (std::size_t c = 0; c < 4; ++c) sum[c] += clear * static_cast<double>(rgba[c]);
        }
        pixels.push_back(sum);
    }
    return pixels;
}

/// Of each pixel the largest difference of a channel, sorted.
std::vector<double> differences(const vulkan::SlabLists& a, const vulkan::SlabLists& b) {
    const auto x = composited(a), y = composited(b);
    std::vector<double> off(x.size());
    for (std::size_t i = 0; i < x.size(); ++i)
        for (std::size_t c = 0; c < 4; ++c) off[i] = std::max(off[i], std::abs(x[i][c] - y[i][c]));
    std::ranges::sort(off);
    return off;
}
double quantile(const std::vector<double>& sorted, double share) {
    return sorted[static_cast<std::size_t>(share * static_cast<double>(sorted.size() - 1))];
}
/// What the backends owe each other.
void expect_parity(const vulkan::SlabLists& device, const vulkan::SlabLists& cpu) {
    const std::vector<double> off = differences(device, cpu);
    EXPECT_LE(quantile(off, 0.999), 1e-5);
    EXPECT_LE(quantile(off, 0.99), 1e-6);
}

/// In software the division rounds as on the CPU, and so nothing differs; a GPU is granted 2.5 ULP.
void expect_equal_bits(const vulkan::Device& device, const Agreement& a) {
    if (device.info().is_gpu) return;
    EXPECT_EQ(a.other_rays, 0U);
    EXPECT_EQ(a.other, 0U) << "slabs of " << a.slabs << ", by at most " << a.worst << " ULP";
}

void expect_same_bits(const vulkan::SlabLists& a, const vulkan::SlabLists& b) {
    const Agreement same = compare(a, b);
    EXPECT_EQ(same.other, 0U);
    EXPECT_EQ(same.other_rays, 0U);
}

std::vector<Case> volume_cases() {
    std::vector<Case> cases;
    for (const Samples samples : kEverySample)
        for (const std::string& shading : {std::string("\"flat\""), kLit})
            cases.push_back({.name = fmt::format("samples {} {}", static_cast<int>(samples), shading),
                             .samples = samples,
                             .shading = shading});
    const Case lit{.name = "", .shading = kLit};
    const auto add = [&](const char* name, const auto& change) {
        Case c = lit;
        c.name = name;
        change(c);
        cases.push_back(c);
    };
    add("jumps and opacity 1", [](Case& c) {
        c.transfer = {{0.1, 1, 0, 0, 0},   {0.4, 0, 1, 0, 0.2}, {0.4, 0, 1, 0, 0}, {0.7, 0, 0, 1, 0},
                      {0.7, 1, 1, 0, 0.8}, {0.72, 1, 1, 0, 1},  {0.72, 0, 0, 0, 0}};
    });
    add("forty pieces", [](Case& c) {
        c.transfer.clear();
        for (int i = 0; i < 40; ++i)
            c.transfer.push_back(
                {i / 40.0, i % 2 + 0.0, 0.5, 1.0 - i % 2, i < 10 ? 0.0 : 0.004 * (i % 7) * i});
    });
    add("one opacity", [](Case& c) { c.transfer = {{0.5, 0.2, 0.4, 0.8, 0.3}}; });
    add("two samples along an axis", [](Case& c) { c.size = {43, 38, 2}; });
    add("clip planes", [](Case& c) {
        c.place += "clip = [{ normal = [1, 0.2, 0], offset = 0.5 }, { normal = [0, -1, 1], offset = 0.7 }]\n";
    });
    add("anisotropic and mirrored",
        [](Case& c) { c.place = "matrix = [-2.5,0.2,0,1.2, 0.3,0.4,0.1,-0.5, 0,0.2,1,-0.9, 0,0,0,1]\n"; });
    add("orthographic", [](Case& c) {
        c.camera =
            "projection = \"orthographic\"\nposition = [3, 2.5, 4]\ntarget = [0.2, 0.1, 0.2]\nview_height = "
            "3\n";
    });
    add("along an axis", [](Case& c) {
        c.place = "";
        c.camera =
            "projection = \"orthographic\"\nposition = [1, 1, 9]\ntarget = [1, 1, 1]\nview_height = 2\n";
    });
    add("camera inside",
        [](Case& c) { c.camera = "position = [0.1, 0.1, 0.2]\ntarget = [1, 0.4, 0]\nfov_degrees = 70\n"; });
    add("a smaller part of a step", [](Case& c) { c.step = 0.13; });
    add("steps of four voxels", [](Case& c) { c.step = 4; });
    return cases;
}

TEST_F(VulkanVolumes, SlabsAreThoseOfTheCpu) {
    const vulkan::Device device({.validate = true});
    for (const Case& c : volume_cases()) {
        SCOPED_TRACE(c.name);
        const PreparedScene scene = scene_of(c);
        const CastSettings settings{.step = c.step * voxel_pitch(scene.volumes[0].to_world())};
        for (const float opaque_at : {1.0F, 0.9F}) {
            const auto cpu = slabs_on_cpu(scene, settings, opaque_at);
            const auto slabs = vulkan::cast_slabs(device, scene, scene.volumes[0], settings, opaque_at);
            const Agreement a = compare(slabs, cpu);
            EXPECT_GT(a.slabs, 500U);
            expect_parity(slabs, cpu);
            expect_equal_bits(device, a);
        }
    }
    EXPECT_TRUE(device.validation_messages().empty());
}

TEST_F(VulkanVolumes, OtherInterpolationsAreThoseOfThePlainVersion) {
    const vulkan::Device device({.validate = true});
    for (const char* interpolation : {"catmull-rom", "nearest"})
        for (Case c : volume_cases()) {
            if (c.step < 0.2 || c.shading != kLit) continue;
            c.interpolation = interpolation;
            c.width = 18;
            c.height = 15;
            c.name += std::string(" ") + interpolation;
            SCOPED_TRACE(c.name);
            const PreparedScene scene = scene_of(c);
            const CastSettings settings{.step = c.step * voxel_pitch(scene.volumes[0].to_world())};
            const auto cpu = slabs_on_cpu(scene, settings, 1);
            const auto slabs = vulkan::cast_slabs(device, scene, scene.volumes[0], settings, 1);
            const Agreement a = compare(slabs, cpu);
            EXPECT_GT(a.slabs, 150U);
            expect_parity(slabs, cpu);
            expect_equal_bits(device, a);
        }
    EXPECT_TRUE(device.validation_messages().empty());
}

TEST_F(VulkanVolumes, SkippingChangesNoBit) {
    const vulkan::Device device({.validate = true});
    for (const char* interpolation : {"trilinear", "catmull-rom", "nearest"})
        for (const Samples samples : {Samples::bytes, Samples::holes}) {
            const Case c{
                .name = interpolation, .samples = samples, .shading = kLit, .interpolation = interpolation};
            SCOPED_TRACE(c.name);
            const PreparedScene scene = scene_of(c);
            const double step = 0.7 * voxel_pitch(scene.volumes[0].to_world());
            expect_same_bits(
                vulkan::cast_slabs(device, scene, scene.volumes[0], {.step = step, .skip = true}, 1),
                vulkan::cast_slabs(device, scene, scene.volumes[0], {.step = step, .skip = false}, 1));
        }
}

/// Three volumes of one kind of samples that overlap, each placed in its own way.
PreparedScene three_volumes(const Case& c, const std::string& more = "") {
    const fs::path folder = test_folder();
    put_samples(folder / "v.nrrd", c);
    std::string toml = head_toml(c);
    for (const char* place : {"matrix = [0.9,0.2,0,-0.8, -0.3,1,0.1,-0.9, 0,0.2,-1,0.9, 0,0,0,1]\n"
                              "clip = [{ normal = [1, 0.2, 0], offset = 0.9 }]\n",
                              "translate = [0.3, 0.2, -0.3]\n", "rotate_degrees = [30, 10, 5]\n"}) {
        Case each = c;
        each.place = place;
        toml += volume_toml(each, "v.nrrd");
    }
    return prepare(scene_from(toml + more, folder));
}

// Large images are cast in bands of rows of packets; here there are two, and the last packets are cut.
TEST_F(VulkanVolumes, BandsOfALargeImageMeet) {
    const vulkan::Device device({.validate = true});
    const Case c{.name = "", .size = {20, 18, 14}, .step = 2, .width = 402, .height = 203};
    const PreparedScene scene = three_volumes(c,
                                              "[[surface]]\nisosurface = { volume = \"v.nrrd\", isovalue = "
                                              "150 }\nopacity = 0.3\ntranslate = [0.3, 0.2, -0.3]\n");
    const CastSettings settings{.step = 2 * voxel_pitch(scene.volumes[0].to_world())};
    const auto cpu = slabs_on_cpu(scene, settings, 1);
    const auto slabs = vulkan::cast_slabs(device, scene, scene.volumes[0], settings, 1);
    const Agreement a = compare(slabs, cpu);
    EXPECT_GT(a.slabs, 10000U);
    expect_parity(slabs, cpu);
    expect_equal_bits(device, a);
    MultiVolumeStats stats;
    const MultiVolumeSettings together{.step = 2};
    const Image image = vulkan::cast_volumes(device, scene, together, stats, [](double) {});
    const Image by_cpu = cast_volumes_fast(scene, together, stats, [](double) {});
    for (const char* plane : {"R", "G", "B", "A"})
        for (std::size_t i = 0; i < image.pixel_count(); ++i)
            ASSERT_NEAR(image.plane(plane)[i], by_cpu.plane(plane)[i], 1e-5F) << plane << i;
}

// Software devices end all loops of an invocation after 65535 rounds, without a word: the shaders have one.
TEST_F(VulkanVolumes, RaysThatSoftwareCutsShortAreAnError) {
    const vulkan::Device device;
    if (device.info().is_gpu) GTEST_SKIP() << "skipped: no Vulkan in software";
    for (const char* interpolation : {"trilinear", "nearest"}) {
        const Case c{.name = "",
                     .transfer = {{0.5, 1, 1, 1, 0}},
                     .interpolation = interpolation,
                     .width = 4,
                     .height = 4};
        const PreparedScene scene = scene_of(c);
        const VolumeObject& volume = scene.volumes[0];
        EXPECT_THROW((void)vulkan::cast_slabs(device, scene, volume, {.step = 1e-5, .skip = false}, 1), Error);
        EXPECT_NO_THROW((void)vulkan::cast_slabs(device, scene, volume, {.step = 1e-2, .skip = false}, 1));
    }
}

TEST_F(VulkanVolumes, WhatHasNoThicknessIsNotDrawn) {
    const vulkan::Device device({.validate = true});
    const PreparedScene scene = scene_of({.name = "", .size = {43, 1, 27}});
    for (const auto& slabs : vulkan::cast_slabs(device, scene, scene.volumes[0], {.step = 0.05}, 1))
        EXPECT_TRUE(slabs.empty());
}

// The test is tested: samples a hundredth of a step further on are another picture.
TEST_F(VulkanVolumes, AShiftOfAHundredthOfAStepIsSeen) {
    const vulkan::Device device({.validate = true});
    const PreparedScene scene = scene_of({.name = "", .shading = kLit});
    const double step = 0.7 * voxel_pitch(scene.volumes[0].to_world());
    const auto cpu = slabs_on_cpu(scene, {.step = step}, 1);
    PreparedScene moved = scene;
    CameraSettings camera = scene.settings.camera;
    const Vec3 shift = 0.01 * step * scene.camera.forward();
    camera.position += shift;
    camera.target += shift;
    camera.near = scene.camera.near();
    camera.far = scene.camera.far();
    moved.camera = Camera(camera, scene.settings.image, scene.volumes[0].bounds());
    const auto off = differences(vulkan::cast_slabs(device, moved, scene.volumes[0], {.step = step}, 1), cpu);
    EXPECT_GT(quantile(off, 0.99), 1e-5);
    EXPECT_GT(quantile(off, 0.5), 1e-6);
}

// ---- Isosurfaces

PreparedScene isosurface_scene(const Case& c, double isovalue, const std::string& more) {
    const fs::path folder = test_folder();
    put_samples(folder / "v.nrrd", c);
    return prepare(scene_from(
        head_toml(c) +
            fmt::format(
                "[[surface]]\nisosurface = {{ volume = \"v.nrrd\", isovalue = {}, interpolation = \"{}\" }}\n"
                "color = [0.9, 0.5, 0.2]\nopacity = 0.4\nshading = {}\n{}{}",
                Stored(c.samples).of(isovalue), c.interpolation, c.shading, c.place, more),
        folder));
}

vulkan::SlabLists isosurface_on_cpu(const PreparedScene& scene, double thickness,
                                    const CastSettings& settings) {
    const IsosurfaceCaster caster(scene, scene.objects[0], settings);
    vulkan::SlabLists lists;
    for (int y = 0; y < scene.camera.height(); ++y)
        for (int x = 0; x < scene.camera.width(); ++x) {
            SlabList list;
            caster.cast(scene.camera.ray(x + 0.5, y + 0.5), thickness, list);
            lists.push_back(list.slabs);
        }
    return lists;
}

TEST_F(VulkanVolumes, IsosurfacesAreThoseOfTheCpu) {
    const vulkan::Device device({.validate = true});
    for (const char* interpolation : {"trilinear", "catmull-rom"})
        for (const Samples samples : {Samples::bytes, Samples::holes})
            for (const char* more :
                 {"", "opacity_law = \"oblique\"\nclip = [{ normal = [1, 0.2, 0], offset = 0.5 }]\n"}) {
                const Case c{.name = fmt::format("{} {} {}", interpolation, static_cast<int>(samples), more),
                             .samples = samples,
                             .shading = more[0] == 0 ? kLit : "\"flat\"",
                             .interpolation = interpolation,
                             .width = 22,
                             .height = 19};
                SCOPED_TRACE(c.name);
                const PreparedScene scene = isosurface_scene(c, 0.5, more);
                const CastSettings settings{.step = 0.03};
                const auto cpu = isosurface_on_cpu(scene, 0.02, settings);
                const auto slabs = vulkan::cast_slabs(device, scene, scene.objects[0], 0.02, settings, 1);
                const Agreement a = compare(slabs, cpu);
                EXPECT_GT(a.slabs, 200U);
                expect_parity(slabs, cpu);
                expect_equal_bits(device, a);
                expect_same_bits(slabs, vulkan::cast_slabs(device, scene, scene.objects[0], 0.02,
                                                           {.step = 0.03, .skip = false}, 1));
            }
    EXPECT_TRUE(device.validation_messages().empty());
}

// ---- All volumes together

struct ImageAgreement {
    std::size_t other = 0;  // floats
    double p999 = 0, p99 = 0;
};
ImageAgreement compare(const Image& a, const Image& b) {
    ImageAgreement result;
    std::vector<double> off(a.pixel_count());
    for (const char* plane : {"R", "G", "B", "A", "Z"})
        for (std::size_t i = 0; i < off.size(); ++i) {
            const float x = a.plane(plane)[i], y = b.plane(plane)[i];
            if (std::bit_cast<std::uint32_t>(x) == std::bit_cast<std::uint32_t>(y)) continue;
            ++result.other;
            if (plane[0] != 'Z') off[i] = std::max(off[i], static_cast<double>(std::abs(x - y)));
        }
    std::ranges::sort(off);
    result.p999 = quantile(off, 0.999);
    result.p99 = quantile(off, 0.99);
    return result;
}

void expect_parity(const std::string& name, const Image& device, const Image& cpu, SlabMixing mixing,
                   bool on_gpu) {
    const ImageAgreement a = compare(device, cpu);
    SCOPED_TRACE(fmt::format("{}: {} of {} floats differ", name, a.other, 5 * cpu.pixel_count()));
    EXPECT_LE(a.p999, 1e-5);
    EXPECT_LE(a.p99, 1e-6);
    // By extinction: where one volume alone is seen, a packet of the CPU multiplies and divides by its
    // optical depth if another ray of it sees more of them.
    if (mixing != SlabMixing::extinction && !on_gpu) {
        EXPECT_EQ(a.other, 0U);
    }
    double sum = 0;
    for (const float v : cpu.plane("A")) sum += static_cast<double>(v);
    EXPECT_GT(sum, 0.05 * static_cast<double>(cpu.pixel_count()));
}

const auto kSilent = [](double) {};

TEST_F(VulkanVolumes, AllTogetherAreThoseOfTheCpu) {
    const vulkan::Device device({.validate = true});
    for (const Samples samples : {Samples::bytes, Samples::holes})
        for (const SlabMixing mixing :
             {SlabMixing::average, SlabMixing::normalised, SlabMixing::extinction}) {
            const int rays = samples == Samples::bytes ? 1 : 2;
            const Case c{.name = fmt::format("samples {}, mixing {}", static_cast<int>(samples),
                                             static_cast<int>(mixing)),
                         .samples = samples,
                         .shading = kLit,
                         .width = 22,
                         .height = 19};
            SCOPED_TRACE(c.name);
            const PreparedScene scene = three_volumes(c);
            MultiVolumeStats stats;
            const MultiVolumeSettings settings{.step = 0.8, .mixing = mixing, .rays = rays};
            const Image cpu = cast_volumes_fast(scene, settings, stats, kSilent);
            const Image image = vulkan::cast_volumes(device, scene, settings, stats, kSilent);
            expect_parity(c.name, image, cpu, mixing, device.info().is_gpu);
            MultiVolumeSettings all = settings;
            all.skip = false;
            expect_same_planes(image, vulkan::cast_volumes(device, scene, all, stats, kSilent));
        }
    EXPECT_TRUE(device.validation_messages().empty());
}

TEST_F(VulkanVolumes, OfOtherInterpolationsTooTogether) {
    const vulkan::Device device({.validate = true});
    for (const char* interpolation : {"catmull-rom", "nearest"})
        for (const SlabMixing mixing :
             {SlabMixing::average, SlabMixing::normalised, SlabMixing::extinction}) {
            const Case c{.name = fmt::format("{}, mixing {}", interpolation, static_cast<int>(mixing)),
                         .shading = kLit,
                         .interpolation = interpolation,
                         .width = 18,
                         .height = 15};
            SCOPED_TRACE(c.name);
            const PreparedScene scene = three_volumes(c);
            MultiVolumeStats stats;
            const MultiVolumeSettings settings{.step = 0.8, .mixing = mixing};
            expect_parity(c.name, vulkan::cast_volumes(device, scene, settings, stats, kSilent),
                          cast_volumes_fast(scene, settings, stats, kSilent), mixing, device.info().is_gpu);
        }
    EXPECT_TRUE(device.validation_messages().empty());
}

TEST_F(VulkanVolumes, SurfacesCutStepsAsOnTheCpu) {
    const vulkan::Device device({.validate = true});
    // Planes across the view, two of them at one depth and many in a row, in a chequerboard of rays.
    const auto planes = [](int y0, int y1) {
        SurfaceLayers layers;
        layers.first.push_back(0);
        for (int y = 2 * y0; y < 2 * y1; ++y)
            for (int x = 0; x < 2 * 18; ++x) {
                if ((x + y) % 2 == 0)
                    for (const Slab& s : {Slab{3.9F, 0, 0.1F, 0, 0, 0.1F}, Slab{5, 0, 0, 0.2F, 0, 0.2F},
                                          Slab{5, 0, 0.3F, 0, 0, 0.4F}})
                        layers.slabs.push_back(s);
                if (x % 16 == 3)
                    for (int k = 0; k < 20; ++k)
                        layers.slabs.push_back({5.5F + 0.01F * static_cast<float>(k), 0, 0, 0, 0.01F, 0.01F});
                layers.first.push_back(layers.slabs.size());
            }
        return layers;
    };
    for (const char* interpolation : {"trilinear", "catmull-rom"})
        for (const SlabMixing mixing :
             {SlabMixing::average, SlabMixing::normalised, SlabMixing::extinction}) {
            const Case c{.name = fmt::format("{}, mixing {}", interpolation, static_cast<int>(mixing)),
                         .interpolation = interpolation,
                         .width = 18,
                         .height = 15};
            SCOPED_TRACE(c.name);
            const PreparedScene scene = three_volumes(
                c, fmt::format(
                       "[[surface]]\nisosurface = {{ volume = \"v.nrrd\", isovalue = 150 }}\nopacity = 0.3\n"
                       "translate = [0.3, 0.2, -0.3]\n[[surface]]\nisosurface = {{ volume = \"v.nrrd\", "
                       "isovalue = "
                       "190, interpolation = \"catmull-rom\" }}\nopacity = 0.5\nshading = \"flat\"\n"));
            MultiVolumeStats stats;
            const MultiVolumeSettings settings{.step = 1.5, .mixing = mixing, .rays = 2, .opaque_at = 1};
            expect_parity(c.name, vulkan::cast_volumes(device, scene, settings, stats, kSilent, planes),
                          cast_volumes_fast(scene, settings, stats, kSilent, planes), mixing,
                          device.info().is_gpu);
        }
    EXPECT_TRUE(device.validation_messages().empty());
}

TEST_F(VulkanVolumes, IsosurfacesNeedNoVolume) {
    const vulkan::Device device({.validate = true});
    const PreparedScene scene = isosurface_scene({.name = "", .shading = kLit}, 0.5, "");
    MultiVolumeStats stats;
    expect_parity("isosurface alone", vulkan::cast_volumes(device, scene, {}, stats, kSilent),
                  cast_volumes_fast(scene, {}, stats, kSilent), SlabMixing::average, device.info().is_gpu);
    EXPECT_TRUE(device.validation_messages().empty());
}

// The scenes of zSlabs, with their polygons between the volumes.
TEST_F(VulkanVolumes, MdvrDrawsTheScenesOfSlabsAsTheCpuDoes) {
    const Backend device = Backend::open_vulkan({.validate = true});
    for (const char* name : {"dense_volume", "clipped", "cube_and_sphere"}) {
        SCOPED_TRACE(name);
        Scene settings =
            load_scene(fs::path(PELLUCID_SOURCE_DIR) / "scenes/slabs" / (std::string(name) + ".toml"));
        settings.image.width = settings.image.height = 48;
        const PreparedScene scene = prepare(settings);
        const Method& method = method_by_name("mdvr");
        const auto draw = [&](const Backend& backend) {
            const Config config = Config::parse("[mdvr]\nrays = 2\n", "test.toml", "/");
            RenderInput input{scene, config.root().table("mdvr"), {}, {}};
            input.backend = backend;
            RenderStats stats;
            return method.render(input, stats);
        };
        expect_parity(name, draw(device), draw(Backend::cpu()), SlabMixing::average, false);
    }
    device.check_validation();
}

// ---- Elementary functions of the shaders

TEST(PlainCastTwin, ElementaryFunctionsAreThoseOfTheStandardLibrary) {
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> exponent(-40, 0), sign(-1, 1);
    double worst_log = 0, worst_exp = 0;
    for (int i = 0; i < 200000; ++i) {
        const double size = std::exp2(exponent(random));
        const double x = (sign(random) < 0 ? -1 : 1) * size * (1 - 1e-9);
        worst_log = std::max(worst_log, std::abs(twin::log1p_d(x) / std::log1p(x) - 1));
        const double y = 60 * x;
        worst_exp = std::max(worst_exp, std::abs(twin::expm1_d(y) / std::expm1(y) - 1));
    }
    EXPECT_LT(worst_log, 1e-15);
    EXPECT_LT(worst_exp, 1e-15);
    EXPECT_EQ(twin::log1p_d(0), 0);
    EXPECT_EQ(twin::expm1_d(0), 0);
    EXPECT_EQ(twin::expm1_d(-1e300), -1);
}

}  // namespace
}  // namespace pellucid
