#include "scene/camera.hpp"

#include <array>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace pellucid {
namespace {

const Box kUnit{Vec3(-1), Vec3(1)};

Camera make(Projection projection, const Vec3& position, const Vec3& target, int width = 40, int height = 30,
            double fov = 50, std::optional<PixelRect> crop = std::nullopt, const Vec3& up = {0, 1, 0}) {
    CameraSettings settings;
    settings.projection = projection;
    settings.position = position;
    settings.target = target;
    settings.up = up;
    settings.fov_degrees = fov;
    return {settings, {.width = width, .height = height}, kUnit, crop};
}

TEST(Camera, RightIsViewTimesUpAndRowZeroIsOnTop) {
    for (const Projection projection : {Projection::perspective, Projection::orthographic}) {
        const Camera camera = make(projection, {0, 0, 4}, Vec3(0));
        EXPECT_GT(camera.project(camera.to_view({0.1, 0, 0})).x, camera.center().x);
        EXPECT_LT(camera.project(camera.to_view({0, 0.1, 0})).y, camera.center().y);
        EXPECT_NEAR(camera.to_view({0, 0, 1}).z, 3, 1e-12);
        // From +x the right hand points to −z.
        const Camera side = make(projection, {4, 0, 0}, Vec3(0));
        EXPECT_GT(side.project(side.to_view({0, 0, -0.1})).x, side.center().x);
    }
}

TEST(Camera, ProjectUndoesRay) {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> u(-1, 1);
    for (int i = 0; i < 2000; ++i) {
        const auto projection = i % 2 == 0 ? Projection::perspective : Projection::orthographic;
        const std::optional<PixelRect> crop = i % 3 == 0 ? std::optional(PixelRect{5, 7, 30, 20}) : std::nullopt;
        const Camera camera = make(projection, {4 * u(random), 3 + u(random), 5 + u(random)},
                                   {u(random), u(random), u(random)}, 40, 30, 80 + 79 * u(random), crop,
                                   {u(random), 2, u(random)});
        const Vec2 pixel(camera.width() * (0.5 + u(random)), camera.height() * (0.5 + u(random)));
        const Ray ray = camera.ray(pixel.x, pixel.y);
        EXPECT_NEAR(dot(ray.direction, camera.forward()), 1, 1e-12);
        const double t = 3 + u(random);
        const Vec3 world = ray.origin + t * ray.direction;
        const Vec3 view = camera.to_view(world);
        EXPECT_NEAR(view.z, t, 1e-11);
        EXPECT_LT(length(camera.project(view) - pixel), 1e-9);
        EXPECT_LT(length(camera.to_world(view) - world), 1e-12);
        EXPECT_LT(length(cross(normalize(camera.ray_direction(world)), normalize(ray.direction))), 1e-12);
    }
}

/// Solid angle of the triangle of three directions (Van Oosterom & Strackee 1983).
double solid_angle(const Vec3& a, const Vec3& b, const Vec3& c) {
    const double la = length(a), lb = length(b), lc = length(c);
    return 2 * std::atan2(std::abs(dot(a, cross(b, c))),
                          la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb);
}

TEST(Camera, PixelAreaIsTheSolidAngleTimesDistanceSquared) {
    // One pixel of 400 rows at 90°: the area varies within a pixel by (5e-3)², so 1e-4 is generous.
    const int side = 400;
    const Camera camera = make(Projection::perspective, {0.2, 0.3, 4}, {0.1, 0, 0}, side, side, 90);
    for (const Vec2 at : {Vec2(200, 200), Vec2(0, 0), Vec2(399, 17), Vec2(120, 380)}) {
        const auto corner = [&](double dx, double dy) { return camera.ray(at.x + dx, at.y + dy).direction; };
        const double angle = solid_angle(corner(0, 0), corner(1, 0), corner(1, 1)) +
                             solid_angle(corner(0, 0), corner(1, 1), corner(0, 1));
        const Ray ray = camera.ray(at.x + 0.5, at.y + 0.5);
        const Vec3 point = ray.origin + 2.7 * ray.direction;
        const double r = length(point - camera.eye());
        EXPECT_NEAR(camera.pixel_area(camera.to_view(point)) / (angle * r * r), 1, 1e-4);
    }
    const Camera flat = make(Projection::orthographic, {0, 0, 4}, Vec3(0), 40, 50);
    EXPECT_DOUBLE_EQ(flat.pixel_area({0.7, 0.2, 3}), (2.0 / 50) * (2.0 / 50));
    EXPECT_DOUBLE_EQ(flat.pixel_area({0.7, 0.2, 300}), (2.0 / 50) * (2.0 / 50));
}

TEST(Camera, AreaRangeBoundsEveryVisiblePointOfABody) {
    std::mt19937_64 random(2);
    std::uniform_real_distribution<double> u(-1, 1);
    int seen = 0, refused = 0;
    for (int i = 0; i < 20000; ++i) {
        const auto projection = i % 4 != 0 ? Projection::perspective : Projection::orthographic;
        const Camera camera = make(projection, {0, 0, 1.5}, {0.3 * u(random), 0, 0}, 40, 30, 90 + 80 * u(random),
                                   i % 3 == 0 ? std::optional(PixelRect{25, 2, 40, 9}) : std::nullopt);
        const Vec3 corner(2 * u(random), 2 * u(random), 2 * u(random));
        Vec3 edge[3];
        const double size = std::pow(10, -1 + 1.5 * u(random));
        for (Vec3& e : edge) e = size * Vec3(u(random), u(random), u(random));
        std::array<Vec3, 8> points;
        for (std::size_t k = 0; k < 8; ++k)
            points[k] = corner + ((k & 1U) != 0 ? edge[0] : Vec3(0)) + ((k & 2U) != 0 ? edge[1] : Vec3(0)) +
                        ((k & 4U) != 0 ? edge[2] : Vec3(0));
        const auto range = camera.pixel_area_range(points.data(), 8);
        const bool whole = camera.wholly_in_view(points.data(), 8);
        EXPECT_FALSE(whole && !range);
        for (int k = 0; k < 30; ++k) {
            const Vec3 p = corner + 0.5 * (1 + u(random)) * edge[0] + 0.5 * (1 + u(random)) * edge[1] +
                           0.5 * (1 + u(random)) * edge[2];
            const Vec3 view = camera.to_view(p);
            bool visible = view.z >= camera.near() && view.z <= camera.far();
            if (visible) {
                const Vec2 at = camera.project(view);
                visible = at.x >= 0 && at.x < camera.width() && at.y >= 0 && at.y < camera.height();
            }
            EXPECT_FALSE(whole && !visible);
            if (!visible) continue;
            ASSERT_TRUE(range.has_value());
            ++seen;
            EXPECT_GE(camera.pixel_area(view), range->least * (1 - 1e-12));
            EXPECT_LE(camera.pixel_area(view), range->most * (1 + 1e-12));
        }
        refused += range ? 0 : 1;
    }
    EXPECT_GT(seen, 10000);
    EXPECT_GT(refused, 1000);
}

TEST(Camera, NearAndFarComeFromTheSceneOrTheFile) {
    const Camera outside = make(Projection::perspective, {0, 0, 4}, Vec3(0));
    EXPECT_NEAR(outside.near(), 3, 1e-7);
    EXPECT_NEAR(outside.far(), 5, 1e-7);
    EXPECT_LE(outside.near(), 3);
    EXPECT_GE(outside.far(), 5);
    const Camera inside = make(Projection::orthographic, Vec3(0), {0, 0, -1});
    EXPECT_GT(inside.near(), 0);
    EXPECT_LT(inside.near(), 1e-6);
    CameraSettings settings;
    settings.position = {0, 0, 4};
    settings.near = 3.5;
    settings.far = 3.75;
    const Camera given(settings, {.width = 4, .height = 4}, kUnit);
    EXPECT_EQ(given.near(), 3.5);
    EXPECT_EQ(given.far(), 3.75);
    settings.far = 1e38;
    EXPECT_NEAR(Camera(settings, {.width = 4, .height = 4}, kUnit).far(), 5, 1e-7) << "where the scene ends";
    settings.near = settings.far = std::nullopt;
    const Camera empty(settings, {.width = 4, .height = 4}, Box{});
    EXPECT_TRUE(std::isfinite(empty.near()) && std::isfinite(empty.far()));
}

TEST(Camera, CropSeesTheSameRaysAsTheWhole) {
    const PixelRect crop{3, 5, 11, 9};
    for (const Projection projection : {Projection::perspective, Projection::orthographic}) {
        const Camera whole = make(projection, {1, 2, 4}, Vec3(0));
        const Camera part = make(projection, {1, 2, 4}, Vec3(0), 40, 30, 50, crop);
        EXPECT_EQ(part.width(), 8);
        EXPECT_EQ(part.height(), 4);
        for (const Vec2 at : {Vec2(0.5, 0.5), Vec2(7.25, 3.125)}) {
            const Ray a = whole.ray(at.x + 3, at.y + 5);
            const Ray b = part.ray(at.x, at.y);
            EXPECT_EQ(a.origin, b.origin);
            EXPECT_EQ(a.direction, b.direction);
        }
    }
}

}  // namespace
}  // namespace pellucid
