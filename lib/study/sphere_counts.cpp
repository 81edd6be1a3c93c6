#include "study/sphere_counts.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <unordered_map>

namespace pellucid {
namespace {

/// Centres by the cells of a grid as wide as a radius.
class CenterGrid {
public:
    CenterGrid(const std::vector<Vec3>& centers, double radius) : centers_(centers), radius_(radius) {
        for (std::size_t i = 0; i < centers.size(); ++i) cells_[key(cell(centers[i]))].push_back(static_cast<std::uint32_t>(i));
    }
    template <class Take>
    void each_around(const Vec3& point, const Take& take) const {
        const auto at = cell(point);
        for (int dz = -1; dz <= 1; ++dz)
            for (int dy = -1; dy <= 1; ++dy)
                for (int dx = -1; dx <= 1; ++dx) {
                    const auto found = cells_.find(key({at[0] + dx, at[1] + dy, at[2] + dz}));
                    if (found == cells_.end()) continue;
                    for (const std::uint32_t i : found->second) {
                        const Vec3 off = centers_[i] - point;
                        if (dot(off, off) <= radius_ * radius_) take(i);
                    }
                }
    }

private:
    using Cell = std::array<std::int64_t, 3>;
    [[nodiscard]] Cell cell(const Vec3& p) const {
        return {static_cast<std::int64_t>(std::floor(p.x / radius_)), static_cast<std::int64_t>(std::floor(p.y / radius_)),
                static_cast<std::int64_t>(std::floor(p.z / radius_))};
    }
    [[nodiscard]] static std::uint64_t key(const Cell& c) {
        const auto part = [](std::int64_t n) { return static_cast<std::uint64_t>(n + (1 << 20)) & 0x1fffffU; };
        return part(c[0]) | part(c[1]) << 21U | part(c[2]) << 42U;
    }
    const std::vector<Vec3>& centers_;
    double radius_;
    std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> cells_;
};

/// Uniform points in batches, in the order of their trials.
template <class Take>
void each_point(const UniformPoints& surface, std::size_t points, Seed seed, const Take& take) {
    std::size_t found = 0;
    for (std::uint64_t trial = 0; found < points; ++trial)
        if (const auto point = surface.point(seed, 0, trial)) {
            take(*point);
            ++found;
        }
}

}  // namespace

MeanVariance counts_in_spheres(const UniformPoints& surface, std::size_t points, const std::vector<Vec3>& centers, double radius,
                               Seed seed) {
    const CenterGrid grid(centers, radius);
    std::vector<std::uint32_t> counts(centers.size(), 0);
    each_point(surface, points, seed, [&](const Vec3& p) { grid.each_around(p, [&](std::uint32_t i) { ++counts[i]; }); });
    MeanVariance result;
    for (const std::uint32_t n : counts) result.add(n);
    return result;
}

double independent_points(const UniformPoints& surface, std::size_t points, const std::vector<Vec3>& centers, double radius) {
    // The mean count is Σ over points of k, the spheres around it. The number of points is fixed and they are independent: the
    // sum's variance is n Var k = n (E[k²] − E[k]²), and one over its relative variance n E[k]²/(E[k²] − E[k]²). (A Poisson
    // number of points would have E[k²] in place of Var k.) From a sample of points of its own.
    constexpr std::size_t kSample = 200'000;
    const CenterGrid grid(centers, radius);
    double sum = 0;
    double squares = 0;
    const std::size_t sample = std::min(points, kSample);
    each_point(surface, sample, {77}, [&](const Vec3& p) {
        double k = 0;
        grid.each_around(p, [&](std::uint32_t) { ++k; });
        sum += k;
        squares += k * k;
    });
    const auto n = static_cast<double>(sample);
    const double variance = squares - sum * (sum / n);
    if (!(sum > 0)) return 1;
    return variance > 0 ? sum * (sum / n) / variance * static_cast<double>(points) : kInfinity;
}

double cylinder_in_sphere(double r) {
    // φ = 2 asin(r/2 · sin t) makes the integrand smooth: Simpson's rule over t.
    constexpr int kPanels = 2000;
    double sum = 0;
    for (int i = 0; i <= kPanels; ++i) {
        const double t = std::numbers::pi * (static_cast<double>(i) / kPanels - 0.5);
        const double s = 0.5 * r * std::sin(t);
        // 2(1 − cos φ) = 4 sin²(φ/2) = r² sin² t; dφ = r cos t/√(1 − s²) dt.
        const double value = 2 * r * std::cos(t) * r * std::cos(t) / std::sqrt(1 - s * s);
        sum += value * (i == 0 || i == kPanels ? 1 : i % 2 == 1 ? 4 : 2);
    }
    return sum * std::numbers::pi / kPanels / 3;
}

}  // namespace pellucid
