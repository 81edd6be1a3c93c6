// Judging uniformity: what noise is taken off a density.
#include "study/uniformity.hpp"

#include "scene_testing.hpp"
#include "study/trust_rays.hpp"

namespace pellucid {
namespace {

/// Uniform places in sets, each place so many times: what a walk that does not move leaves. Denser by `slope` x from the middle.
PointSets clusters(const AreaCells& cells, std::size_t sets, std::size_t places, int copies, double slope = 0) {
    PointSets result(sets);
    std::size_t next = 0;
    for (auto& points : result)
        for (std::size_t i = 0; i < places; ++next) {
            const Vec3& p = cells.sample()[next % cells.sample().size()];
            const double kept = (1 + slope * p.x) / (1 + std::abs(slope));
            if (random_numbers({91}, next, 5)[0] >= kept) continue;
            points.insert(points.end(), static_cast<std::size_t>(copies), p);
            ++i;
        }
    return result;
}

TEST(Uniformity, NoiseThatIsTakenOffIsThatOfPointsThatDependOnEachOther) {
    const PreparedScene scene = prepare(uniformity_scene("implicit = \"sphere\""));
    const AreaCells cells(scene, 1'000'000, 6, {5});
    const auto report = [&](int copies, double slope) {
        return judge_uniformity(cells, clusters(cells, 100, 400, copies, slope), 10, {1, 1});
    };
    for (const int copies : {1, 4, 16}) {
        const UniformityReport even = report(copies, 0);
        EXPECT_NEAR(even.dispersion / copies, 1, 0.1);
        // The noise of 40 000 places, however often each is counted, and that of the reference.
        EXPECT_NEAR(even.density_noise / std::sqrt(64 / 40000.0 + 64 / cells.total()), 1, 0.06) << copies;
        EXPECT_LT(even.density_deviation, even.density_noise) << copies;
        // x² is a third on average.
        const UniformityReport tilted = report(copies, 0.3);
        EXPECT_NEAR(tilted.density_deviation, 0.3 * std::sqrt(1.0 / 3), 0.015) << copies;
    }
}

}  // namespace
}  // namespace pellucid
