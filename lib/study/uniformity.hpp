// Are the particles of a surface uniform, independent, Poisson? Points of a sampler judged against random lines traced
// by the truth, which share nothing with any sampler.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "measure/statistics.hpp"
#include "render/particles.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

/// One surface as an orthographic camera sees it under the oblique law: every particle counts, none is hidden from the
/// sampler, and what lands on an area element is in proportion to its area alone.
///   body        keys of a [[surface]]; `folder` is where its files are looked up
///   resolution  pixels a side
[[nodiscard]] Scene uniformity_scene(const std::string& body, const std::filesystem::path& folder = ".", int resolution = 64);

/// Cells of equal area, from points uniform on the surface: cut in two at the median along their longest extent.
class AreaCells {
public:
    /// 2^depth cells from random lines through the scene that the truth traces, one crossing in K of each.
    ///   points  wanted, at least
    AreaCells(const PreparedScene& scene, std::size_t points, int depth, Seed seed);

    [[nodiscard]] std::size_t count() const { return counts_.size(); }
    [[nodiscard]] std::size_t cell_of(const Vec3& point) const;
    /// Points of the reference, in the order in which they were found: independent, uniform in area.
    [[nodiscard]] std::span<const Vec3> sample() const { return sample_; }
    static constexpr std::size_t kMostSample = 2'000'000;
    /// Points of the reference in each cell, and in all of them.
    [[nodiscard]] std::span<const std::int64_t> counts() const { return counts_; }
    [[nodiscard]] double total() const { return total_; }
    /// The surface's area by Cauchy-Crofton, from the number of crossings, and its standard error.
    [[nodiscard]] double area() const { return area_; }
    [[nodiscard]] double area_error() const { return area_error_; }

private:
    struct Cut {
        int axis;
        double at;
    };
    std::vector<Vec3> sample_;  // at most kMostSample
    std::vector<Cut> cuts_;  // a complete binary tree, its root first
    std::vector<std::int64_t> counts_;
    double total_ = 0, area_ = 0, area_error_ = 0;
};

/// Particles in the world, repeat by repeat.
using PointSets = std::vector<std::vector<Vec3>>;
[[nodiscard]] PointSets world_points(const PreparedScene& scene, const ParticleSet& set);

struct UniformityReport {
    double points = 0;            // in all repeats
    double chi2 = 0, dof = 0;     // of all points over the cells, the reference's own noise included
    double p_value = 1;
    /// Root mean square deviation of the cells' densities, as a share of their mean, and its noise: the dispersion below over the
    /// number of points, and the reference's. Noise is taken off (not below 0); what is left is known to within noise² √(2/cells),
    /// squared: less is not seen.
    double density_deviation = 0;
    double density_noise = 0;
    /// Variance over mean of a cell's number of points in a repeat, mean over cells; 1 for a Poisson process. Its inverse
    /// is the number of independent points that one is worth.
    double dispersion = 0;
    /// χ² of the whole repeats' numbers about their mean over their degrees of freedom (1 for Poisson), and its p-value.
    double count_dispersion = 0;
    double count_p = 1;           // two-sided
    /// Mean of π ρ d², d the distance to the nearest neighbour within a repeat: 1 for a Poisson process on a plane. z of its
    /// difference from `neighbour_expected`.
    double neighbour = 0;
    double neighbour_expected = 0;
    double neighbour_z = 0;
};
/// The neighbours of the reference's own points, in sets as large as those of a sampler: what curvature, edges and other
/// sheets make of a Poisson process there.
struct NeighbourBaseline {
    double mean = 0, error = 0;
};
[[nodiscard]] NeighbourBaseline neighbour_baseline(const AreaCells& cells, double points_a_set, std::size_t queries);

/// `queries`: points of each repeat whose neighbours are looked for.
[[nodiscard]] UniformityReport judge_uniformity(const AreaCells& cells, const PointSets& sets, std::size_t queries,
                                                const NeighbourBaseline& baseline);

}  // namespace pellucid
