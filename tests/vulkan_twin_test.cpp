// Twin headers on the device against the same headers as C++: equal bits, whatever the function.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "kernel/intermix_twin.h"
#include "kernel/math_twin.h"
#include "kernel/normal_twin.h"
#include "kernel/projection_twin.h"
#include "sample/particle_set.hpp"
#include "render/backend.hpp"
#include "slab_testing.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kTwinProbe[] = {
#include "shaders/twin_probe.comp.inc"
};

// The shader's scalar layout is that of C++.
static_assert(sizeof(twin::Particle) == 16 && sizeof(twin::PixelDepth) == 12 && sizeof(twin::Vec3f) == 12);
static_assert(sizeof(twin::MergeStep) == 80 && offsetof(twin::MergeStep, a_used) == 72);
static_assert(offsetof(twin::Projection, near_bits) == 32 && offsetof(twin::Projection, height) == 56);

/// Push constants of twin_probe.comp.glsl.
struct ProbePush {
    std::uint64_t view, inputs, results;
    std::uint32_t count, unused;
};
enum Operation : std::uint32_t { project, pack, unpack, quickly, in_view, first_of_maths, first_of_merges = 17 };

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
        if (!Backend::has_vulkan()) GTEST_SKIP() << "skipped: no Vulkan device";
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
        const auto quick = on_device<twin::PixelDepth>(device(), quickly, particles, projection);
        const auto mended = on_device<twin::PixelDepth>(device(), in_view, particles, projection);
        int inside = 0;
        int different = 0;
        for (std::size_t i = 0; i < particles.size(); ++i) {
            const twin::PixelDepth expected = twin::project_particle(projection, particles[i]);
            inside += expected.column >= 0 ? 1 : 0;
            const auto equal = [&](const twin::PixelDepth& at) {
                return at.column == expected.column && at.row == expected.row && at.depth == expected.depth;
            };
            different += equal(drawn[i]) && equal(quick[i]) ? 0 : 1;
            if (expected.column >= 0 && projection.doubt < 1) different += equal(mended[i]) ? 0 : 1;
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

TEST_F(TwinsOnVulkan, NormalsHaveEqualBits) {
    const std::vector<twin::Vec3f> normals = many_normals();
    const auto packed = on_device<std::uint32_t>(device(), pack, normals);
    int different = 0;
    for (std::size_t i = 0; i < normals.size(); ++i) different += packed[i] != twin::pack_normal(normals[i]) ? 1 : 0;
    EXPECT_EQ(different, 0) << "packed";

    std::mt19937 random(9);
    std::vector<std::uint32_t> words;
    const std::uint32_t coordinates[] = {1, 2, 32767, 32768, 32769, 65534, 65535};
    for (const std::uint32_t u : coordinates)
        for (const std::uint32_t v : coordinates) words.push_back(u | v << 16);
    while (words.size() < 1U << 20) words.push_back(static_cast<std::uint32_t>(random()));
    const auto unpacked = on_device<twin::Vec3f>(device(), unpack, words);
    different = 0;
    for (std::size_t i = 0; i < words.size(); ++i) {
        const twin::Vec3f expected = twin::unpack_normal(words[i]);
        different += std::memcmp(&unpacked[i], &expected, sizeof(expected)) != 0 ? 1 : 0;
    }
    EXPECT_EQ(different, 0) << "unpacked";
}

// Random bits: numbers of all sizes and signs, subnormal ones and infinite ones too where they are promised.
TEST_F(TwinsOnVulkan, MathsHaveEqualBits) {
    struct Function {
        const char* name;
        float (*of)(float);
        bool any;             // any number: else normal, >= 0 and at most 1 (quick_exp2: its negative)
        float scale = 1;
    };
    const Function functions[] = {
        {"twin_reciprocal", twin::twin_reciprocal, true}, {"twin_sqrt", twin::twin_sqrt, true},
        {"twin_rsqrt", twin::twin_rsqrt, true},           {"twin_log1p", twin::twin_log1p, true},
        {"twin_expm1", twin::twin_expm1, true},           {"twin_log2", twin::twin_log2, true},
        {"twin_exp2", twin::twin_exp2, true},
        {"twin_power", [](float x) { return twin::twin_power(x, 37.3F); }, true},
        {"quick_rsqrt", twin::quick_rsqrt, false},        {"quick_log2", twin::quick_log2, false},
        {"quick_exp2", twin::quick_exp2, false, -149},
        {"quick_power", [](float x) { return twin::quick_power(x, 37.3F); }, false},
    };
    std::mt19937 random(10);
    std::uniform_real_distribution<float> exponent(-125, 0);
    std::uint32_t operation = first_of_maths;
    for (const Function& f : functions) {
        std::vector<std::uint32_t> words{0, 0x80000000U, 0x3f800000U, 0x7f800000U, 0xff800000U, 0x7f7fffffU, 1, 0x007fffffU};
        if (!f.any) words = {0x3f800000U};
        while (words.size() < 1U << 20) {
            const float number = f.scale * (words.size() % 2 == 0 ? std::exp2(exponent(random)) : std::ldexp(static_cast<float>(random() >> 8U), -24));
            words.push_back(f.any ? static_cast<std::uint32_t>(random()) : twin::floatBitsToUint(std::isnormal(number) ? number : f.scale));
        }
        const auto results = on_device<std::uint32_t>(device(), static_cast<Operation>(operation++), words);
        int different = 0;
        for (std::size_t i = 0; i < words.size(); ++i)
            different += results[i] != twin::floatBitsToUint(f.of(twin::uintBitsToFloat(words[i]))) ? 1 : 0;
        EXPECT_EQ(different, 0) << f.name;
    }
}

struct SlabPair {
    twin::Slab a, b;
};
/// Random and awkward ones; a device may flush subnormal numbers, so no opacity is so small that its parts are.
[[nodiscard]] std::vector<SlabPair> many_slab_pairs() {
    testing_slabs::RandomSlabs random(11);
    std::vector<SlabPair> pairs;
    while (pairs.size() < 1U << 16U) {
        SlabPair pair{random.slab(), random.slab()};
        if (pairs.size() % 7 == 0) pair.a.d = random.one_of(testing_slabs::kThicknesses);
        if (pairs.size() % 5 == 0) pair.b.d = random.one_of(testing_slabs::kThicknesses);
        for (twin::Slab* s : {&pair.a, &pair.b})
            if (s->a < 1e-20F) s->a = s->r = s->g = s->b = 0;
        pairs.push_back(pair);
    }
    return pairs;
}

/// Subnormal numbers as zero.
[[nodiscard]] twin::MergeStep flushed(twin::MergeStep step) {
    for (twin::Slab* s : {&step.out_slab, &step.a, &step.b})
        for (float* v : {&s->z, &s->d, &s->r, &s->g, &s->b, &s->a})
            if (std::fpclassify(*v) == FP_SUBNORMAL) *v = 0;
    return step;
}

TEST_F(TwinsOnVulkan, SlabsMergeToEqualBits) {
    const std::vector<SlabPair> pairs = many_slab_pairs();
    for (std::uint32_t interpolation = 0; interpolation < 3; ++interpolation)
        for (std::uint32_t mixing = 0; mixing < 3; ++mixing) {
            const auto operation = static_cast<Operation>(first_of_merges + 3 * interpolation + mixing);
            const auto results = on_device<twin::MergeStep>(device(), operation, pairs);
            int different = 0;
            int overlapping = 0;
            for (std::size_t i = 0; i < pairs.size(); ++i) {
                const twin::MergeStep expected =
                    flushed(twin::merge_step(pairs[i].a, pairs[i].b, interpolation, mixing));
                const twin::MergeStep seen = flushed(results[i]);
                if (std::memcmp(&seen, &expected, sizeof(seen)) != 0 && different++ < 3)
                    ADD_FAILURE() << pairs[i].a << pairs[i].b << "\n" << seen.out_slab << seen.a << "\n"
                                  << expected.out_slab << expected.a;
                overlapping += expected.out_slab.a != pairs[i].a.a && expected.out_slab.a != pairs[i].b.a ? 1 : 0;
            }
            EXPECT_EQ(different, 0) << interpolation << " " << mixing;
            EXPECT_GT(overlapping, 1 << 14);
        }
}

}  // namespace
}  // namespace pellucid::vulkan
