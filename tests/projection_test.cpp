// The projection twin against exact arithmetic: 113-bit floats hold every intermediate of it.
#include "kernel/projection_twin.h"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <ostream>
#include <random>

#include <boost/multiprecision/cpp_bin_float.hpp>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "sample/particle_set.hpp"

namespace pellucid {
namespace {

using Quad = boost::multiprecision::cpp_bin_float_quad;

struct Setting {
    Projection projection = Projection::perspective;
    int width = 512, height = 512;
    double fov = 30;          // or the view's height in units of the scene
    double scale = 1;         // size of the scene
    double distance = 4;      // of the camera from it, in scene sizes
    std::optional<double> near = std::nullopt;  // in scene sizes
};

void PrintTo(const Setting& s, std::ostream* out) {
    *out << (s.projection == Projection::perspective ? "perspective" : "orthographic") << ' ' << s.width
         << 'x' << s.height << " fov " << s.fov << " scale " << s.scale << " distance " << s.distance;
    if (s.near) *out << " near " << *s.near;
}

struct Difference {
    int other = 0;            // particles in another pixel than the exact one …
    int inside = 0;
    double farthest = 0;      // … and how far inside that pixel they are, in pixels
    double rounding = 0;      // largest distance of a stored particle from the point it came from, in pixels
};

Camera camera_of(const Setting& s) {
    CameraSettings settings;
    settings.projection = s.projection;
    settings.position = {0, 0, s.scale * s.distance};
    settings.target = {0, 0, -s.scale};
    settings.fov_degrees = s.fov;
    settings.view_height = s.fov * s.scale;
    if (s.near) settings.near = *s.near * s.scale;
    return {settings, {.width = s.width, .height = s.height}, Box{Vec3(-s.scale), Vec3(s.scale)}};
}

Difference compare(const Setting& s, int count) {
    const Camera camera = camera_of(s);
    const ParticleFrame frame(camera);
    const twin::Projection projection = frame.projection(camera);
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> unit(0, 1);
    Difference d;
    for (int i = 0; i < count; ++i) {
        // Half of them anywhere, half close to a pixel's border; depths uniform, and in logarithm.
        Vec2 at(camera.width() * unit(random), camera.height() * unit(random));
        if (i % 2 == 0) at.x = std::floor(at.x) + (unit(random) - 0.5) * 1e-4;
        double z = camera.near() + (camera.far() - camera.near()) * unit(random);
        if (i % 4 < 2) z = camera.near() * std::pow(camera.far() / camera.near(), unit(random));
        z = std::clamp(z, camera.near(), camera.far());
        const Vec2 side = (at - camera.center()) * camera.pixel_size() * (camera.perspective() ? z : 1);
        const Particle particle = frame.pack({side.x, side.y, z}, {0, 0, -1});
        const twin::PixelDepth drawn = twin::project_particle(projection, particle);

        const Quad unit_length = ldexp(Quad(1), frame.exponent);
        const Quad depth = Quad(frame.near) + unit_length * Quad(particle.above_near);
        const Quad pixel = Quad(camera.pixel_size()) * (camera.perspective() ? depth : Quad(1));
        const Quad x = Quad(camera.center().x) + unit_length * Quad(particle.x) / pixel;
        const Quad y = Quad(camera.center().y) + unit_length * Quad(particle.y) / pixel;
        d.rounding = std::max({d.rounding, std::abs(static_cast<double>(x - Quad(at.x))),
                               std::abs(static_cast<double>(y - Quad(at.y)))});
        if (!(x >= 0 && y >= 0 && x < camera.width() && y < camera.height())) {
            if (drawn.column < 0) continue;
        } else {
            ++d.inside;
            if (drawn.column == static_cast<int>(floor(x)) && drawn.row == static_cast<int>(floor(y)))
                continue;
        }
        ++d.other;
        const auto off = [](const Quad& v) { return static_cast<double>(abs(v - round(v))); };
        // The coordinate that fell on the other side of a border: the one nearer to one.
        d.farthest = std::max(d.farthest, std::min(off(x), off(y)));
    }
    return d;
}

/// A pixel border is decided to this, in pixels: the twin's fixed point, see particle_set.cpp: 29 bits for
/// what spans half of the image, `fraction_bits` for the centre.
double resolution(const Setting& s) {
    const Camera camera = camera_of(s);
    const twin::Projection p = ParticleFrame(camera).projection(camera);
    // A near plane below the smallest exponent of the fixed point has lost these bits.
    const double lost = p.perspective != 0 ? std::max(1.0, 0x1p61 / static_cast<double>(p.near_fixed)) : 1;
    return 4.0 * lost * std::max(s.width, s.height) * 0x1p-29 + std::ldexp(1.0, -p.fraction_bits);
}

class ProjectionTwin : public testing::TestWithParam<Setting> {};

TEST_P(ProjectionTwin, DecidesAsExactArithmeticDoes) {
    const Setting& s = GetParam();
    const Difference d = compare(s, 20000);
    EXPECT_GT(d.inside, 9000);
    EXPECT_LE(d.farthest, resolution(s));
    EXPECT_LT(resolution(s), 1.0 / 256);
    // Of particles within 1e-4 pixel/2 of a border a share resolution/1e-4 may go astray; others never.
    EXPECT_LE(d.other, 20000 * std::min(1.0, 0.01 + 2e4 * resolution(s)));
    // float32 holds 24 bits of half of the image.
    EXPECT_LE(d.rounding, std::max(s.width, s.height) * 0x1p-24 + 1e-9);
}

INSTANTIATE_TEST_SUITE_P(
    Settings, ProjectionTwin,
    testing::Values(
        Setting{}, Setting{.width = 1, .height = 1}, Setting{.width = 65536, .height = 65536},
        Setting{.width = 65536, .height = 1}, Setting{.width = 3, .height = 65536}, Setting{.fov = 0.001},
        Setting{.fov = 170}, Setting{.scale = 1e-6}, Setting{.scale = 1e6}, Setting{.scale = 1e-30},
        Setting{.scale = 1e30}, Setting{.fov = 0.0001, .distance = 1e6}, Setting{.distance = 0.5},
        Setting{.distance = 0, .near = 1e-6}, Setting{.distance = 0, .near = 1e-12},
        Setting{.width = 65536, .height = 65536, .fov = 170, .distance = 0.5},
        Setting{.distance = 0, .near = 1e-30}, Setting{.projection = Projection::orthographic, .fov = 2},
        Setting{.projection = Projection::orthographic, .width = 65536, .height = 65536, .fov = 2},
        Setting{.projection = Projection::orthographic, .width = 1, .height = 7, .fov = 2},
        Setting{.projection = Projection::orthographic, .fov = 1e-6},
        Setting{.projection = Projection::orthographic, .fov = 1e6},
        Setting{.projection = Projection::orthographic, .fov = 2, .scale = 1e-30},
        Setting{.projection = Projection::orthographic, .fov = 2, .scale = 1e30},
        Setting{.projection = Projection::orthographic, .fov = 2, .distance = 1e6}));

// Wherever a particle lies, borders of pixels and of the image included.
TEST_P(ProjectionTwin, QuickProjectionIsTheSame) {
    const Setting& s = GetParam();
    const Camera camera = camera_of(s);
    const ParticleFrame frame(camera);
    const twin::Projection projection = frame.projection(camera);
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    const double closeness[] = {1, 1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9, 0};
    int undecided = 0;
    constexpr int kCount = 200000;
    for (int i = 0; i < kCount; ++i) {
        Vec2 at(camera.width() * (1.1 * unit(random) - 0.05), camera.height() * (1.1 * unit(random) - 0.05));
        const double close = closeness[i % 8];
        at.x = std::round(at.x) + (unit(random) - 0.5) * close;
        if (i % 3 == 0) at.y = std::round(at.y) + (unit(random) - 0.5) * close;
        double z = camera.near() + (camera.far() - camera.near()) * unit(random);
        if (i % 4 < 2) z = camera.near() * std::pow(camera.far() / camera.near(), unit(random));
        if (i % 64 == 0) z = camera.near();
        const Vec2 side = (at - camera.center()) * camera.pixel_size() * (camera.perspective() ? z : 1);
        Particle particle = frame.pack({side.x, side.y, z}, {0, 0, -1});
        if (i % 97 == 0) particle.x *= 1.5F;  // out of view, by no more than the integers hold
        const twin::PixelDepth exact = twin::project_particle(projection, particle);
        const twin::PixelDepth quick = twin::project_quickly(projection, particle);
        ASSERT_EQ(quick.column, exact.column) << i;
        ASSERT_EQ(quick.row, exact.row) << i;
        ASSERT_EQ(quick.depth, exact.depth) << i;
        if (exact.column >= 0 && projection.doubt < 1) {
            const twin::PixelDepth in_view = twin::project_in_view(projection, particle);
            ASSERT_EQ(in_view.column, exact.column) << i;
            ASSERT_EQ(in_view.row, exact.row) << i;
        }
        undecided += projection.doubt < 1 ? 0 : 1;
    }
    // An ordinary camera is decided by float32.
    if (s.width <= 512 && s.scale == 1 && s.distance == 4 && !s.near && s.fov >= 1) {
        EXPECT_EQ(undecided, 0);
    }
}

// Any camera: images of up to 2e5 pixels a side, crops in their corners, far from the axis, near planes down to 1e-12
// of the far plane, and particles a hair beside borders of pixels.
TEST(ProjectionTwin, InViewNeedsNoDivisionInAnyCropOfAnyCamera) {
    std::mt19937_64 random(6);
    std::uniform_real_distribution<double> unit(0, 1);
    const auto power = [&](double lo, double hi) { return std::pow(10, lo + (hi - lo) * unit(random)); };
    int decided = 0;
    int mended = 0;  // float32 alone would have gone astray
    for (int trial = 0; trial < 3000; ++trial) {
        CameraSettings settings{.target = {0, 0, 1}, .fov_degrees = trial % 2 == 0 ? power(-6, 1.5) : 1 + 178 * unit(random)};
        if (trial % 5 == 0) settings = {.projection = Projection::orthographic, .target = {0, 0, 1}, .view_height = power(-12, 12)};
        const double far = power(-8, 8);
        settings.near = far * power(-12, -1e-9);
        settings.far = far;
        const ImageSettings image{.width = 1 + static_cast<int>(power(0, 5.3)), .height = 1 + static_cast<int>(power(0, 5.3))};
        const int width = std::min(image.width, 1 + static_cast<int>(power(0, 3)));
        const int height = std::min(image.height, 1 + static_cast<int>(power(0, 3)));
        const int x0 = trial % 3 == 0 ? image.width - width : 0;
        const int y0 = trial % 4 < 2 ? image.height - height : 0;
        const Camera camera(settings, image, Box{Vec3(0.0), Vec3(far * power(-12, 0))}, PixelRect{x0, y0, x0 + width, y0 + height});
        const ParticleFrame frame(camera);
        const twin::Projection projection = frame.projection(camera);
        if (!(projection.doubt < 1)) continue;
        for (int i = 0; i < 200; ++i) {
            Vec2 at(width * unit(random), height * unit(random));
            if (i % 2 == 0) at.x = std::round(at.x) + (unit(random) - 0.5) * power(-8, -1);
            if (i % 3 == 0) at.y = std::round(at.y) + (unit(random) - 0.5) * power(-8, -1);
            const double z = camera.near() + (camera.far() - camera.near()) * (i % 5 == 0 ? unit(random) : power(-12, 0));
            const Vec2 side = (at - camera.center()) * camera.pixel_size() * (camera.perspective() ? z : 1);
            const Particle particle = frame.pack({side.x, side.y, z}, {0, 0, -1});
            const twin::PixelDepth exact = twin::project_particle(projection, particle);
            if (exact.column < 0) continue;
            const twin::PixelDepth in_view = twin::project_in_view(projection, particle);
            ASSERT_EQ(in_view.column, exact.column) << trial << ' ' << i;
            ASSERT_EQ(in_view.row, exact.row) << trial << ' ' << i;
            const float w = camera.perspective() ? projection.quick_near + particle.above_near : 1.0F;
            const float column = particle.x * projection.quick_focal / w + projection.quick_center_x;
            mended += static_cast<int>(std::floor(column)) != exact.column ? 1 : 0;
            ++decided;
        }
    }
    EXPECT_GT(decided, 300000);
    EXPECT_GT(mended, 1000);
}

TEST(ProjectionTwin, DepthBitsAreOrderedLikeDepths) {
    std::mt19937_64 random(4);
    std::uniform_real_distribution<double> exponent(-30, 0);
    const Camera camera = camera_of({});
    const ParticleFrame frame(camera);
    const twin::Projection projection = frame.projection(camera);
    for (int i = 0; i < 10000; ++i) {
        const double a = std::pow(2, exponent(random));
        const double b = a * (1 + 3e-7);
        const auto depth = [&](double above) {
            return twin::project_particle(projection, frame.pack({0, 0, camera.near() + above}, {0, 0, 1}))
                .depth;
        };
        // Told apart where the sum with near still is: near has 53 bits.
        if (camera.near() + a == camera.near() + b || a < 1e-8) continue;
        EXPECT_LE(depth(a), depth(b));
        if (a > 1e-6) {
            EXPECT_LT(depth(a), depth(b));
        }
    }
}

TEST(ProjectionTwin, FloorDivideIsFloor) {
    for (std::int64_t a = -50; a <= 50; ++a)
        for (std::int64_t b = 1; b < 9; ++b)
            EXPECT_EQ(twin::floor_divide(a, b),
                      static_cast<std::int64_t>(std::floor(static_cast<double>(a) / static_cast<double>(b))));
}

TEST(TwinHeaders, CompileAsGlsl) {
    if (std::system("glslc --version > /dev/null 2>&1") != 0) GTEST_SKIP() << "skipped: no glslc";
    const auto shader = std::filesystem::path(testing::TempDir()) / "pellucid_twins.comp";
    std::ofstream(shader) << R"(#version 450
#extension GL_GOOGLE_include_directive : require
#include "kernel/twin.h"
#include "kernel/normal_twin.h"
#include "kernel/projection_twin.h"
#include "kernel/shading_twin.h"
layout(local_size_x = 64) in;
layout(std430, binding = 0) buffer Words { uint words[]; };
void main() {
    uint i = gl_GlobalInvocationID.x;
    Vec3f n = unpack_normal(pack_normal(Vec3f(1.0, 2.0, uintBitsToFloat(words[i]))));
    LightSums sums = add_light(LightSums(0.0, 0.0), n, n, turned_to(n, n), 1.0, 8.0);
    Projection p;
    p.near_fixed = int64_t(words[i]); p.focal_fixed = int64_t(1);
    p.center_x = int64_t(1); p.center_y = int64_t(1);
    p.near_bits = 1; p.near_exponent = 1; p.lateral_shift = 1; p.fraction_bits = 1;
    p.perspective = 1; p.width = 4; p.height = 4;
    Particle q = Particle(1.0, 2.0, 3.0, words[i]);
    PixelDepth at = project_particle(p, q);
    words[i] = uint(at.column) + floatBitsToUint(shaded_channel(1.0, sums, 0.1, 0.2, 0.3));
}
)";
    const std::string command =
        fmt::format("glslc --target-env=vulkan1.3 -fshader-stage=compute -Werror -I {}/lib {} -o {}.spv",
                    PELLUCID_SOURCE_DIR, shader.string(), shader.string());
    EXPECT_EQ(std::system(command.c_str()), 0) << command;
}

}  // namespace
}  // namespace pellucid
