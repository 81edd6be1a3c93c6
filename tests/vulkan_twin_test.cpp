// Twin headers on the device against the same headers as C++.
//   project_particle   integers, and floats scaled by powers of two: equal bits
//   pack_normal        quotients that a device may round otherwise: at most one step a coordinate
//   unpack_normal      a quotient by 32767, which glslc turns into a product, then more quotients and a root:
//                      at most 2^-20, far below the 2^-14 of the packing itself
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <optional>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "kernel/normal_twin.h"
#include "kernel/projection_twin.h"
#include "sample/particle_set.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kTwinProbe[] = {
#include "shaders/twin_probe.comp.inc"
};

// The shader's scalar layout is that of C++.
static_assert(sizeof(twin::Particle) == 16 && sizeof(twin::PixelDepth) == 12 && sizeof(twin::Vec3f) == 12);
static_assert(offsetof(twin::Projection, near_bits) == 32 && offsetof(twin::Projection, height) == 56);

/// Push constants of twin_probe.comp.glsl.
struct ProbePush {
    std::uint64_t view, inputs, results;
    std::uint32_t count, unused;
};
enum Operation : std::uint32_t { project, pack, unpack };

template <class Result, class Input>
[[nodiscard]] std::vector<Result> on_device(const Device& device, Operation operation,
                                            const std::vector<Input>& inputs,
                                            const twin::Projection& projection = {}) {
    const std::uint32_t constants[] = {operation};
    const Kernel kernel(device, kTwinProbe, {.push_bytes = sizeof(ProbePush), .constants = constants});
    const Buffer view(device, sizeof(projection));
    const Buffer from(device, inputs.size() * sizeof(Input));
    const Buffer to(device, inputs.size() * sizeof(Result));
    upload(device, view, std::as_bytes(std::span(&projection, 1)));
    upload(device, from, std::as_bytes(std::span(inputs)));
    const auto count = static_cast<std::uint32_t>(inputs.size());
    Commands commands(device);
    commands.dispatch(kernel, ProbePush{view.address(), from.address(), to.address(), count, 0},
                      {(count + 63) / 64, 1, 1});
    commands.submit_and_wait();
    std::vector<Result> results(inputs.size());
    download(device, to, std::as_writable_bytes(std::span(results)));
    return results;
}

class TwinsOnVulkan : public testing::Test {
protected:
    void SetUp() override {
        const std::vector<DeviceInfo> devices = list_devices();
        if (std::none_of(devices.begin(), devices.end(), [](const DeviceInfo& d) { return d.usable; }))
            GTEST_SKIP() << "skipped: no Vulkan device";
        device_.emplace(DeviceOptions{.validate = true});
    }
    void TearDown() override {
        if (device_) {
            EXPECT_EQ(device_->validation_messages(), std::vector<std::string>{});
        }
    }
    const Device& device() const { return *device_; }

    std::optional<Device> device_;
};

struct View {
    const char* name;
    Projection projection = Projection::perspective;
    int width = 512, height = 512;
    double fov = 30;  // or the view's height in units of the scene
    double scale = 1;
    double distance = 4;
    std::optional<double> near = std::nullopt;  // in scene sizes
};

[[nodiscard]] Camera camera_of(const View& v) {
    CameraSettings settings;
    settings.projection = v.projection;
    settings.position = {0, 0, v.scale * v.distance};
    settings.target = {0, 0, -v.scale};
    settings.fov_degrees = v.fov;
    settings.view_height = v.fov * v.scale;
    if (v.near) settings.near = *v.near * v.scale;
    return {settings, {.width = v.width, .height = v.height}, Box{Vec3(-v.scale), Vec3(v.scale)}};
}

/// In the view and around it; a third of them at a pixel's border or on the near plane.
[[nodiscard]] std::vector<Particle> particles_around(const Camera& camera, int count) {
    const ParticleFrame frame(camera);
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> unit(0, 1);
    std::vector<Particle> particles;
    for (int i = 0; i < count; ++i) {
        Vec2 at(camera.width() * (1.2 * unit(random) - 0.1), camera.height() * (1.2 * unit(random) - 0.1));
        if (i % 3 == 0) at = glm::floor(at);
        double z = camera.near() + (camera.far() - camera.near()) * unit(random);
        if (i % 4 == 0) z = camera.near() * std::pow(camera.far() / camera.near(), unit(random));
        if (i % 16 == 1) z = camera.near();
        const Vec2 side = (at - camera.center()) * camera.pixel_size() * (camera.perspective() ? z : 1);
        particles.push_back(frame.pack({side.x, side.y, z}, {0, 0, -1}));
        if (i % 64 == 2) particles.back().x = i % 128 == 2 ? 0.0f : -0.0f;
        if (i % 64 == 3) particles.back().y = i % 128 == 3 ? 0.0f : -0.0f;
    }
    return particles;
}

TEST_F(TwinsOnVulkan, ProjectionsHaveEqualBits) {
    const View views[] = {
        {.name = "perspective"},
        {.name = "wide and close", .width = 65536, .height = 65536, .fov = 170, .distance = 0.5},
        {.name = "tiny scene", .scale = 1e-30},
        {.name = "huge scene", .scale = 1e30},
        {.name = "near plane at 1e-12", .distance = 0, .near = 1e-12},
        {.name = "telescope", .fov = 0.0001, .distance = 1e6},
        {.name = "orthographic", .projection = Projection::orthographic, .fov = 2},
        {.name = "orthographic, large", .projection = Projection::orthographic, .width = 65536, .height = 3,
         .fov = 1e6},
    };
    for (const View& view : views) {
        const Camera camera = camera_of(view);
        const twin::Projection projection = ParticleFrame(camera).projection(camera);
        const std::vector<Particle> particles = particles_around(camera, 1 << 17);
        const auto drawn = on_device<twin::PixelDepth>(device(), project, particles, projection);
        int inside = 0;
        int different = 0;
        for (std::size_t i = 0; i < particles.size(); ++i) {
            const twin::PixelDepth expected = twin::project_particle(projection, particles[i]);
            inside += expected.column >= 0 ? 1 : 0;
            const bool equal = drawn[i].column == expected.column && drawn[i].row == expected.row &&
                               drawn[i].depth == expected.depth;
            different += equal ? 0 : 1;
        }
        EXPECT_EQ(different, 0) << view.name;
        EXPECT_GT(inside, static_cast<int>(particles.size() / 3)) << view.name;
        EXPECT_LT(inside, static_cast<int>(particles.size())) << view.name;
    }
}

/// Directions of all kinds: random, of all lengths, and at the axes and folds of the octahedron.
[[nodiscard]] std::vector<twin::Vec3f> many_normals() {
    std::mt19937_64 random(8);
    std::normal_distribution<float> gauss;
    std::uniform_int_distribution<int> exponent(-30, 30);
    std::vector<twin::Vec3f> normals;
    for (const float x : {-1.0f, -0.0f, 0.0f, 1.0f})
        for (const float y : {-1.0f, -0.0f, 0.0f, 1.0f})
            for (const float z : {-1.0f, -0.0f, 0.0f, 1.0f})
                if (x != 0 || y != 0 || z != 0) normals.push_back({x, y, z});
    while (normals.size() < 1U << 20) {
        const float size = std::ldexp(1.0f, exponent(random));
        normals.push_back({size * gauss(random), size * gauss(random), size * gauss(random)});
    }
    return normals;
}

TEST_F(TwinsOnVulkan, PackedNormalsDifferByAtMostOneStep) {
    const std::vector<twin::Vec3f> normals = many_normals();
    const auto packed = on_device<std::uint32_t>(device(), pack, normals);
    int different = 0;
    int farther = 0;
    for (std::size_t i = 0; i < normals.size(); ++i) {
        const std::uint32_t expected = twin::pack_normal(normals[i]);
        const auto steps = [&](int shift) {
            const auto of = [&](std::uint32_t word) { return static_cast<int>(word >> shift & 0xffffU); };
            return std::abs(of(packed[i]) - of(expected));
        };
        different += packed[i] != expected ? 1 : 0;
        farther += std::max(steps(0), steps(16)) > 1 ? 1 : 0;
    }
    RecordProperty("different", different);
    EXPECT_EQ(farther, 0);
    EXPECT_LE(different, static_cast<int>(normals.size() / 100));
}

TEST_F(TwinsOnVulkan, UnpackedNormalsAreCloseToThoseOfTheHost) {
    std::mt19937 random(9);
    std::vector<std::uint32_t> words;
    const std::uint32_t coordinates[] = {1, 2, 32767, 32768, 32769, 65534, 65535};
    for (const std::uint32_t u : coordinates)
        for (const std::uint32_t v : coordinates) words.push_back(u | v << 16);
    while (words.size() < 1U << 20) words.push_back(static_cast<std::uint32_t>(random()));
    const auto normals = on_device<twin::Vec3f>(device(), unpack, words);
    int different = 0;
    float farthest = 0;
    for (std::size_t i = 0; i < words.size(); ++i) {
        const twin::Vec3f expected = twin::unpack_normal(words[i]);
        const float off[] = {std::abs(normals[i].x - expected.x), std::abs(normals[i].y - expected.y),
                             std::abs(normals[i].z - expected.z)};
        for (const float o : off) farthest = std::max(farthest, std::isnan(o) ? 1.0f : o);
        different += off[0] != 0 || off[1] != 0 || off[2] != 0 ? 1 : 0;
    }
    RecordProperty("different", different);
    EXPECT_LE(farthest, 0x1p-20f) << different << " different";
}

}  // namespace
}  // namespace pellucid::vulkan
