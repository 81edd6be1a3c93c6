// The volume stage on Vulkan beside the fast one of the CPU: its slabs, bit for bit where the device divides as the
// standard says; validation on.
#include <optional>
#include <random>

#include "cpu/fast_volume_caster.hpp"
#include "scene_testing.hpp"
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
        : scale(samples == Samples::bytes ? 255 : samples == Samples::words ? 6000 : 0.37),
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
        const double v = p.x > 28  ? 0.05
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
    return fmt::format("[[volume]]\nfile = \"{}\"\nopacity_step = 0.2\ninterpolation = \"{}\"\ntransfer = [{}]\nshading = {}\n{}",
                       file, c.interpolation, transfer, c.shading, c.place);
}

std::string head_toml(const Case& c) {
    return fmt::format("image.resolution = [{}, {}]\n[camera]\n{}[[light]]\nheadlight = true\n[[light]]\ndirection = [1, 2, 0]\n"
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
                    lists[static_cast<std::size_t>((y + i / 4) * width + x + i % 4)] = packet[static_cast<std::size_t>(i)];
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
    return static_cast<std::uint32_t>(std::min<std::int64_t>(std::abs(ordered(a) - ordered(b)), 0xffffffffLL));
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

std::vector<Case> volume_cases() {
    std::vector<Case> cases;
    for (const Samples samples : kEverySample)
        for (const std::string& shading : {std::string("\"flat\""), kLit})
            cases.push_back({.name = fmt::format("samples {} {}", static_cast<int>(samples), shading),
                             .samples = samples,
                             .shading = shading});
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
            const Agreement a = compare(vulkan::cast_slabs(device, scene, scene.volumes[0], settings, opaque_at), cpu);
            fmt::print("{}: {} slabs of {} rays, {} slabs and {} rays differ, at most {} ULP\n", c.name, a.slabs, a.rays,
                       a.other, a.other_rays, a.worst);
            EXPECT_GT(a.slabs, 500U);
            EXPECT_EQ(a.other, 0U);
            EXPECT_EQ(a.other_rays, 0U);
        }
    }
    for (const auto& m : device.validation_messages()) fmt::print("{}\n", m);
    EXPECT_TRUE(device.validation_messages().empty());
}

}  // namespace
}  // namespace pellucid
