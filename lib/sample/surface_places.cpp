#include "sample/surface_places.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include "core/parallel.hpp"
#include "sample/line_sampler.hpp"

namespace pellucid {
namespace {

constexpr std::uint32_t kTriesAPlace = 4096;
constexpr Seed kAreaSeed{0x9b60'46d1'53ac'78e1ULL};
/// What is drawn besides the particles of an object has keys that no object's number reaches.
constexpr std::uint32_t kPlacesId = 0x00fffff0U;
constexpr double kFirstTrials = 0x1p20;
constexpr double kMostTrials = 0x1p26;
/// Of a block, so that a share near 0 or 1 is known.
constexpr double kLeastTrials = 64;

[[nodiscard]] Camera camera_of_all(const Box& bounds) {
    const double size = std::max(length(bounds.size()), 1e-300);
    CameraSettings settings;
    settings.projection = Projection::orthographic;
    settings.target = bounds.center();
    settings.position = bounds.center() + size * Vec3(0.6, 0.64, 0.48);
    settings.up = {0, 0, 1};
    settings.view_height = 1.01 * size;
    return {settings, {.width = 1024, .height = 1024}, bounds};
}

}  // namespace

UniformPlaces::UniformPlaces(const Object& object) : whole_(std::make_unique<Object>(object)) {
    whole_->surface.opacity_law = OpacityLaw::oblique;
    Box bounds{Vec3(0.0), Vec3(1.0)};
    if (whole_->geometry->patch_count() > 0) bounds = whole_->geometry->bounds();
    camera_ = std::make_unique<Camera>(camera_of_all(bounds));
    lines_ = std::make_unique<LineSampler>(*whole_, *camera_, kPlacesId);
    pixel_area_ = camera_->pixel_size() * camera_->pixel_size();
}
UniformPlaces::~UniformPlaces() = default;
UniformPlaces::UniformPlaces(UniformPlaces&&) noexcept = default;
UniformPlaces& UniformPlaces::operator=(UniformPlaces&&) noexcept = default;

UniformPlaces::Area UniformPlaces::area(double relative) const {
    const std::size_t blocks = lines_->block_count();
    if (!(lines_->virtual_pixels() > 0)) return {};
    struct Tally {
        double landed = 0, thrown = 0;
    };
    std::vector<Tally> tallies(blocks);
    for (std::uint32_t round = 0;; ++round) {
        const double trials = kFirstTrials * std::exp2(round);
        parallel_for(blocks, 1, [&](std::size_t begin, std::size_t end) {
            constexpr double kAtOnce = 4096;
            std::vector<SourcePoint> points;
            for (std::size_t b = begin; b < end; ++b) {
                const double share = lines_->block_virtual_pixels(b) / lines_->virtual_pixels();
                const double count = std::ceil(std::max(kLeastTrials, trials * share));
                for (double done = 0; done < count; done += kAtOnce) {
                    points.clear();
                    lines_->trials_in_block(b, kAreaSeed, round, static_cast<std::uint32_t>(done),
                                            static_cast<std::uint32_t>(std::min(kAtOnce, count - done)), points);
                    tallies[b].landed += static_cast<double>(points.size());
                }
                tallies[b].thrown += count;
            }
        });
        Area area;
        double variance = 0;
        for (std::size_t b = 0; b < blocks; ++b) {
            const double whole = lines_->block_virtual_pixels(b) * pixel_area_;
            area.value += whole * tallies[b].landed / tallies[b].thrown;
            // Laplace's estimate: a block in which all or none landed is not known to the last digit.
            const double p = (tallies[b].landed + 1) / (tallies[b].thrown + 2);
            const bool all = tallies[b].landed == tallies[b].thrown;  // flat pieces never waste a trial
            variance += all ? 0 : whole * whole * p * (1 - p) / tallies[b].thrown;
        }
        area.standard_error = std::sqrt(variance);
        if (area.standard_error <= relative * area.value || 2 * trials > kMostTrials) return area;
    }
}

std::optional<UniformPlaces::Place> UniformPlaces::place(Seed seed, std::uint32_t repeat, std::uint64_t index) const {
    if (!(lines_->virtual_pixels() > 0)) return std::nullopt;
    for (std::uint32_t i = 0; i < kTriesAPlace; ++i)
        if (const auto point = lines_->trial(seed, repeat, index * kTriesAPlace + i))
            return Place{camera_->to_world(point->view), camera_->world_vector(point->view_normal)};
    return std::nullopt;
}

std::vector<Vec3> UniformPlaces::poisson(Seed seed, std::uint32_t repeat, double mean_count, const Area& area) const {
    std::vector<Vec3> places;
    if (!(area.value > 0)) return places;
    std::vector<SourcePoint> points;
    RandomStream random(seed, {.object = static_cast<std::uint32_t>(Purpose::particle_count), .repeat = repeat});
    for (std::size_t b = 0; b < lines_->block_count(); ++b) {
        const double mean = mean_count / area.value * pixel_area_ * lines_->block_virtual_pixels(b);
        const auto count = std::poisson_distribution<std::uint32_t>(mean)(random);
        points.clear();
        lines_->trials_in_block(b, seed, repeat, 0, count, points);
        for (const SourcePoint& point : points) places.push_back(camera_->to_world(point.view));
    }
    return places;
}

std::size_t UniformPlaces::bytes() const { return lines_->bytes(); }

}  // namespace pellucid
