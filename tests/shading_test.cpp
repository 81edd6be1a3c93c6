// Shading against the contract's formula, written again in double.
#include "scene/shading.hpp"

#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

TEST(Shading, FollowsTheFormulaOfTheContract) {
    const PreparedScene scene = prepare(scene_from(R"(
image.resolution = [8, 8]
camera.position = [0.5, 1, 4]
[[light]]
direction = [1, 2, 3]
intensity = 0.7
[[light]]
direction = [-1, 0, -2]
intensity = 3
[[light]]
headlight = true
intensity = 0.4
[[surface]]
implicit = "sphere"
color = [0.2, 0.5, 0.9]
shading = { ambient = 0.15, diffuse = 0.6, specular = 0.8, shininess = 7 }
)"));
    std::mt19937_64 random(1);
    std::normal_distribution<double> gauss;
    const auto vector = [&] { return Vec3(gauss(random), gauss(random), gauss(random)); };
    for (int i = 0; i < 5000; ++i) {
        const Vec3 point = vector();
        const Vec3 normal = 5.0 * vector();
        const Vec3 viewer = normalize(Vec3(0.5, 1, 4) - point);
        Vec3 n = normalize(normal);
        if (std::abs(dot(n, viewer)) < 1e-4) continue;
        if (dot(n, viewer) < 0) n = -n;  // two-sided
        double diffuse = 0, specular = 0;
        const std::pair<Vec3, double> lights[] = {
            {normalize(Vec3(1, 2, 3)), 0.7}, {normalize(Vec3(-1, 0, -2)), 3.0}, {viewer, 0.4}};
        for (const auto& [l, intensity] : lights) {
            diffuse += intensity * std::max(0.0, dot(n, l));
            specular += intensity * std::pow(std::max(0.0, dot(n, normalize(l + viewer))), 7);
        }
        const Vec3 expected = Vec3(0.2, 0.5, 0.9) * (0.15 + 0.6 * diffuse) + 0.8 * specular;
        const Vec3 drawn = shade(scene, scene.objects[0], point, normal);
        EXPECT_LT(length(drawn - expected), 2e-5);
        EXPECT_LT(length(drawn - shade(scene, scene.objects[0], point, -normal)), 1e-12);
    }
}

TEST(Shading, FlatIsTheColourAndDefaultIsTheContracts) {
    const std::string head = "image.resolution = [8, 8]\ncamera.position = [0, 0, 4]\n[[surface]]\nimplicit = \"sphere\"\n";
    const PreparedScene flat = prepare(scene_from(head + "shading = \"flat\"\ncolor = [0.1, 0.2, 0.3]"));
    EXPECT_EQ(shade(flat, flat.objects[0], {0, 0, 1}, {1, 2, 3}), Vec3(0.1, 0.2, 0.3));
    // Headlight, straight on: 0.8·(0.2 + 0.8) ; at 60°: 0.8·(0.2 + 0.8/2).
    const PreparedScene lit = prepare(scene_from(head));
    EXPECT_NEAR(shade(lit, lit.objects[0], {0, 0, 1}, {0, 0, 1}).x, 0.8, 1e-6);
    EXPECT_NEAR(shade(lit, lit.objects[0], {0, 0, 1}, {std::sqrt(3), 0, 1}).x, 0.48, 1e-6);
}

TEST(Shading, OpacityLawsAreThoseOfTheTheory) {
    const std::string head = "image.resolution = [8, 8]\ncamera.position = [0, 0, 4]\n[[surface]]\nimplicit = \"sphere\"\nopacity = 0.3\n";
    const PreparedScene constant = prepare(scene_from(head));
    const PreparedScene oblique = prepare(scene_from(head + "opacity_law = \"oblique\""));
    for (const double cosine : {1.0, 0.5, 1e-3, 1e-12}) {
        EXPECT_EQ(constant.objects[0].opacity(cosine), 0.3);
        EXPECT_NEAR(oblique.objects[0].opacity(cosine), 1 - std::pow(0.7, 1 / cosine), 1e-14);
    }
}

}  // namespace
}  // namespace pellucid
