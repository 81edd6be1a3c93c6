#include "sample/counting_spheres.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "core/error.hpp"
#include "sample/view_thinning.hpp"

namespace pellucid {
namespace {

constexpr double kMostParticles = 0x1p28;
constexpr std::uint64_t kMostCenterTrials = std::uint64_t{1} << 24U;
/// Particles are made in lots, and the last lot is made again in parts: some 1 % of all at a time.
constexpr double kParticlesALot = 0x1p17;
constexpr std::uint64_t kSphereSeed = 0x5fe7'e5ULL;
constexpr std::uint64_t kParticleSeed = 0xc0'4275ULL;

/// Spheres by the cells of a grid as wide as a sphere.
class SphereGrid {
public:
    SphereGrid(std::vector<Vec3> centers, double radius) : centers_(std::move(centers)), radius_(radius) {
        for (std::uint32_t i = 0; i < centers_.size(); ++i) {
            const auto cell = cell_of(centers_[i]);
            for (int dz = -1; dz <= 1; ++dz)
                for (int dy = -1; dy <= 1; ++dy)
                    for (int dx = -1; dx <= 1; ++dx)
                        cells_[key({cell[0] + dx, cell[1] + dy, cell[2] + dz})].push_back(i);
        }
    }
    /// How many spheres hold the place.
    [[nodiscard]] std::uint32_t holding(const Vec3& place) const {
        const auto found = cells_.find(key(cell_of(place)));
        if (found == cells_.end()) return 0;
        std::uint32_t count = 0;
        for (const std::uint32_t i : found->second) {
            const Vec3 from = place - centers_[i];
            count += dot(from, from) <= radius_ * radius_ ? 1U : 0U;
        }
        return count;
    }

private:
    using Cell = std::array<std::int64_t, 3>;
    [[nodiscard]] Cell cell_of(const Vec3& p) const {
        const Vec3 at = glm::floor((p - centers_[0]) / (2 * radius_));
        return {static_cast<std::int64_t>(at.x), static_cast<std::int64_t>(at.y), static_cast<std::int64_t>(at.z)};
    }
    [[nodiscard]] static std::uint64_t key(const Cell& c) {
        constexpr std::uint64_t kMask = (1U << 21U) - 1;
        return (static_cast<std::uint64_t>(c[0]) & kMask) << 42U | (static_cast<std::uint64_t>(c[1]) & kMask) << 21U |
               (static_cast<std::uint64_t>(c[2]) & kMask);
    }

    std::vector<Vec3> centers_;
    double radius_;
    std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> cells_;
};

}  // namespace

OpacityControl control_by_counting(const UniformPoints& surface, double opacity, double pixel_area,
                                   const CountingSpheres& spheres, double size, Seed seed) {
    OpacityControl result;
    result.wished = opacity;
    result.pixel_area = pixel_area;
    result.radius = spheres.radius > 0 ? spheres.radius
                                       : std::max(kRadiusOfSize * size, kLeastRadiusPixels * std::sqrt(pixel_area));
    const double great_circle = M_PI * result.radius * result.radius;
    // (1) solved for n, on the great circle and on the whole surface.
    const double wished_in_sphere = std::log1p(-opacity) / std::log1p(-pixel_area / great_circle);
    result.exact_density = -std::log1p(-opacity) / pixel_area;
    result.exact_opacity = opacity;

    std::vector<Vec3> centers = spheres.centers;
    const std::size_t wanted = spheres.centers.empty() ? spheres.spheres : 0;
    for (std::uint64_t i = 0; surface.area() > 0 && centers.size() < wanted && i < kMostCenterTrials; ++i)
        if (const auto place = surface.point(derived_seed(seed, kSphereSeed), 0, i)) centers.push_back(*place);
    if (centers.empty()) {
        warn("counting spheres: no place for one was found on a surface of area {:.3g}: particles by area instead",
             surface.area());
        result.counted_density = result.exact_density;
        result.counted_opacity = opacity;
        return result;
    }
    const double wished_in_all = wished_in_sphere * static_cast<double>(centers.size());
    const double expected = wished_in_sphere * surface.area() / great_circle;
    const SphereGrid grid(std::move(centers), result.radius);
    std::uint64_t counted = 0;
    double made = 0;
    for (std::uint32_t lot = 0; static_cast<double>(counted) < wished_in_all && made < kMostParticles; ++lot) {
        // By lots of some hundredth of what is still missing, by the count so far or, without one, by a plane's.
        const double missing = counted > 0 ? made * (wished_in_all / static_cast<double>(counted) - 1) : expected;
        const double mean = std::clamp(counted > 0 ? missing : 0.25 * expected, std::min(16.0, expected), kParticlesALot);
        const std::vector<Vec3> places = surface.poisson(derived_seed(seed, kParticleSeed), lot, mean);
        const double before = static_cast<double>(counted);
        for (const Vec3& place : places) counted += grid.holding(place);
        made += static_cast<double>(places.size());
        if (static_cast<double>(counted) >= wished_in_all) {
            // The lot came in an order that is not random; it is taken to fill the spheres evenly.
            const double over = static_cast<double>(counted) - wished_in_all;
            made -= static_cast<double>(places.size()) * over / (static_cast<double>(counted) - before);
            break;
        }
    }
    if (static_cast<double>(counted) < wished_in_all)
        warn("counting spheres: {:.3g} of {:.3g} particles in the spheres after {:.3g}, the most that are made: opacity {} is not reached",
             static_cast<double>(counted), wished_in_all, made, opacity);
    result.particles = static_cast<std::uint64_t>(std::max(1.0, made));
    result.counted_density = std::max(1.0, made) / surface.area();
    result.counted_opacity = -std::expm1(-result.counted_density * pixel_area);
    result.mean_area_ratio = wished_in_sphere / (result.counted_density * great_circle);
    return result;
}

namespace {

/// Another source with another number of trials.
class CountedSource final : public ParticleSource {
public:
    CountedSource(std::unique_ptr<const ParticleSource> source, double optical_depth)
        : source_(std::move(source)), optical_depth_(optical_depth) {}

    [[nodiscard]] std::uint32_t object_id() const override { return source_->object_id(); }
    [[nodiscard]] std::string label() const override { return source_->label(); }
    [[nodiscard]] bool painted() const override { return source_->painted(); }
    [[nodiscard]] double optical_depth() const override { return optical_depth_; }
    [[nodiscard]] double virtual_pixels() const override { return source_->virtual_pixels(); }
    [[nodiscard]] std::size_t block_count() const override { return source_->block_count(); }
    [[nodiscard]] double block_virtual_pixels(std::size_t block) const override {
        return source_->block_virtual_pixels(block);
    }
    [[nodiscard]] std::optional<Box> block_bounds(std::size_t block) const override { return source_->block_bounds(block); }
    void trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first, std::uint32_t count,
                         std::vector<Point>& out) const override {
        source_->trials_in_block(block, seed, repeat, first, count, out);
    }
    [[nodiscard]] std::optional<Point> trial(Seed seed, std::uint32_t repeat, std::uint64_t index) const override {
        return source_->trial(seed, repeat, index);
    }
    [[nodiscard]] bool has_single_trials() const override { return source_->has_single_trials(); }
    [[nodiscard]] int block_crossings(std::size_t block) const override { return source_->block_crossings(block); }
    void lines_in_block(std::size_t block, Seed seed, std::uint32_t group, std::uint32_t count, Deal deal,
                        std::span<std::vector<Point>, kLineGroup> out) const override {
        source_->lines_in_block(block, seed, group, count, deal, out);
    }
    [[nodiscard]] std::size_t piece_count() const override { return source_->piece_count(); }
    [[nodiscard]] std::size_t bytes() const override { return source_->bytes(); }
    [[nodiscard]] std::string complaint() const override { return source_->complaint(); }
    [[nodiscard]] IsolationStats isolation() const override { return source_->isolation(); }

private:
    std::unique_ptr<const ParticleSource> source_;
    double optical_depth_;
};

}  // namespace

std::unique_ptr<const ParticleSource> counted_source(std::unique_ptr<const ParticleSource> source, const Object& object,
                                                     const Camera& camera, const CountingSpheres& spheres, Seed seed) {
    const ViewThinning view(object, camera);
    if (!(source->virtual_pixels() > 0) || !view.least_pixel_area() || !(object.surface.opacity > 0)) return source;
    const UniformPoints places(object, source->object_id());
    const double size = length(object.geometry->bounds().size());
    const double opacity = std::min(object.surface.opacity, kMostParticleOpacity);
    const double s = *view.least_pixel_area();
    if (spheres.radius > 0 && !(M_PI * spheres.radius * spheres.radius > s))
        throw input_error("particles.counting.radius = {}: a sphere's great circle is less than one pixel of {}, expected "
                          "more than {:.3g}",
                          spheres.radius, source->label(), std::sqrt(s / M_PI));
    const OpacityControl control =
        control_by_counting(places, opacity, s, spheres, size, derived_seed(seed, source->object_id()));
    // Of all particles as of those where the surface is nearest: thinning by the view is not the spheres' affair.
    const double factor = control.counted_density / control.exact_density;
    const double optical_depth = factor * source->optical_depth();
    return std::make_unique<CountedSource>(std::move(source), optical_depth);
}

}  // namespace pellucid
