#include <cmath>

#include <gtest/gtest.h>

#include "cpu/fast_particles.hpp"
#include "measure/opacity_theory.hpp"
#include "study/opacity_patch.hpp"

namespace pellucid {
namespace {

const std::vector<double> kEdges{0, 15, 30, 45, 60, 75, 85};

TEST(OpacityPatch, OutsideTheTheoryThereIsNone) {
    // s/S = 0.5 at 60° is exactly one pixel, on which rounding must not decide.
    EXPECT_FALSE(make_opacity_patch({.ratio = 0.5, .tilt_deg = 60}, kEdges));
    EXPECT_FALSE(make_opacity_patch({.ratio = 0.9, .tilt_deg = 30}, kEdges));
    EXPECT_TRUE(make_opacity_patch({.ratio = 0.5, .tilt_deg = 0}, kEdges));
}

TEST(OpacityPatch, FlatOrthographicTheoryIsThatOfThePaper) {
    for (const double tilt : {0.0, 33.0, 85.0})
        for (const double ratio : {1e-4, 0.01, 0.3}) {
            const auto patch = make_opacity_patch({.ratio = ratio, .tilt_deg = tilt}, kEdges);
            const double cos_tilt = std::cos(tilt * 3.14159265358979323846 / 180);
            const auto alpha = opacity_from_count(17, {.ratio = ratio, .cos_tilt = cos_tilt});
            ASSERT_EQ(patch.has_value(), alpha.has_value());
            if (!patch || patch->rings[0].members.empty()) continue;
            EXPECT_NEAR(ring_theory(patch->rings[0], 17).mean, *alpha, 1e-13);
            EXPECT_NEAR(patch->rings[0].pixels, cos_tilt / ratio, 1e-9 / ratio);
        }
}

TEST(OpacityPatch, RingsOfASphereHaveTheAreaOfTheirAngles) {
    // S = 2πr²: the ring between two angles has πr²(sin²θ₁ − sin²θ₀) pixels, up to the pixels at its borders.
    const double ratio = 1e-4;
    const auto patch = make_opacity_patch({.shape = PatchShape::sphere, .ratio = ratio}, kEdges);
    ASSERT_TRUE(patch);
    for (const Ring& ring : patch->rings) {
        const auto sine2 = [](double deg) {
            return std::pow(std::sin(deg * 3.14159265358979323846 / 180), 2);
        };
        const double area = 0.5 / ratio * (sine2(ring.theta_hi_deg) - sine2(ring.theta_lo_deg));
        EXPECT_NEAR(ring.pixels, area, 0.02 * area + 1) << ring.theta_lo_deg;
    }
}

TEST(OpacityPatch, LandingChancesOfPerspectiveAddUpToTheWholeSurface) {
    // Every particle lands somewhere: whole pixels take all but those at the border.
    for (const PatchShape shape : {PatchShape::flat, PatchShape::sphere}) {
        const auto patch = make_opacity_patch(
            {.shape = shape, .projection = Projection::perspective, .ratio = 1e-5, .tilt_deg = 20},
            {0, 89.99});
        ASSERT_TRUE(patch);
        double sum = 0;
        for (const double q : patch->rings[0].landing) sum += q;
        EXPECT_LT(sum, 1);
        EXPECT_GT(sum, shape == PatchShape::flat ? 0.97 : 0.9);
    }
}

TEST(OpacityPatch, TheTiltOfPerspectiveIsSeenByTheTest) {
    // A renderer that forgot cosβ in s(z) would draw the surface's own density, uniform in area. Its landing
    // chances differ from the theory by more than the test's resolution: mean 1/|cosθ|
    // alone does not hide it.
    const auto patch = make_opacity_patch({.projection = Projection::perspective, .ratio = 1e-4}, kEdges);
    ASSERT_TRUE(patch);
    const auto [least, most] =
        std::minmax_element(patch->rings[0].landing.begin(), patch->rings[0].landing.end());
    EXPECT_GT(*most / *least, 1.05);
}

TEST(OpacityPatch, FitsRejectParticlesTwoPixelsWide) {
    const auto patch = make_opacity_patch({.ratio = 1e-4}, kEdges);
    const PreparedScene scene = prepare(patch->scene);
    const auto samplers = make_samplers(scene);
    const std::unique_ptr<ParticleDrawer> drawer[] = {make_fast_drawer(scene)};
    for (const DrawTwin twin : {DrawTwin::none, DrawTwin::two_pixels_wide}) {
        std::vector<OpacityPoint> points;
        for (const std::uint64_t count : {2000U, 7000U}) {
            const RingDraw draw =
                draw_patch(*patch, scene, samplers[0], drawer, {count, 20, {count}, twin})[0].rings[0];
            points.push_back(fit_point(*patch, patch->rings[0], draw, static_cast<double>(count), 20));
        }
        const FitResult fit = fit_opacity(points, OpacityModel::effective_area, 0.999);
        ASSERT_TRUE(fit.converged);
        const bool holds_one = fit.parameters[0].low <= 1 && 1 <= fit.parameters[0].high;
        EXPECT_EQ(holds_one, twin == DrawTwin::none) << fit.parameters[0].value;
    }
}

TEST(OpacityPatch, ErrorOverRepeatsRejectsASharedSet) {
    // The mean square error of a pixel falls as 1/repeats; with one set for all repeats it does not fall.
    const auto patch = make_opacity_patch({.ratio = 1e-4}, kEdges);
    const PreparedScene scene = prepare(patch->scene);
    const auto samplers = make_samplers(scene);
    const std::unique_ptr<ParticleDrawer> drawer[] = {make_fast_drawer(scene)};
    for (const DrawTwin twin : {DrawTwin::none, DrawTwin::shared_set}) {
        std::vector<ErrorPoint> points;
        for (const std::uint32_t repeats : {2U, 8U, 32U}) {
            const RingDraw draw =
                draw_patch(*patch, scene, samplers[0], drawer, {7000, repeats, {repeats}, twin})[0].rings[0];
            const auto pixels = static_cast<double>(draw.informative);
            points.push_back({static_cast<double>(repeats), std::sqrt(draw.squares / pixels),
                              0.5 * std::sqrt(draw.squares_variance) * repeats / pixels});
        }
        const FitResult fit = fit_power_law(points, 0.999);
        ASSERT_TRUE(fit.converged);
        const bool holds_half = fit.parameters[0].low <= -0.5 && -0.5 <= fit.parameters[0].high;
        EXPECT_EQ(holds_half, twin == DrawTwin::none) << fit.parameters[0].value;
    }
}

}  // namespace
}  // namespace pellucid
