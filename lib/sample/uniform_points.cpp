#include "sample/uniform_points.hpp"

#include <cmath>
#include <numeric>

#include "core/parallel.hpp"
#include "sample/poisson_number.hpp"

namespace pellucid {
namespace {

/// An orthographic camera that sees all of a box, with as few pixels as a view can have.
[[nodiscard]] std::unique_ptr<Camera> camera_around(const Box& box) {
    const double size = length(box.size());
    CameraSettings settings;
    settings.projection = Projection::orthographic;
    settings.target = box.center();
    settings.position = box.center() + Vec3(0, 0, 2 * size);
    settings.view_height = 1.01 * size;
    ImageSettings image;
    image.width = image.height = 1;
    return std::make_unique<Camera>(settings, image, box);
}

}  // namespace

UniformPoints::UniformPoints(const Object& object, std::uint32_t object_id) : object_(object) {
    object_.surface.opacity_law = OpacityLaw::oblique;
    if (object_.geometry->patch_count() == 0) return;
    camera_ = camera_around(object_.geometry->bounds());
    lines_ = std::make_unique<LineSampler>(object_, *camera_, object_id);
    if (!(lines_->virtual_pixels() > 0)) return;

    // Each block's own share of hits, so that the sum has less variance than trials all over the surface; four times as
    // many trials until that is small.
    const double pixel = camera_->pixel_size() * camera_->pixel_size();
    const std::size_t blocks = lines_->block_count();
    for (std::uint32_t all = kAreaTrials / 16; all <= kAreaTrials; all *= 4) {
        std::vector<double> area(blocks), variance(blocks);
        parallel_for(blocks, 1, [&](std::size_t begin, std::size_t end) {
            std::vector<SourcePoint> points;
            for (std::size_t block = begin; block < end; ++block) {
                const double share = lines_->block_virtual_pixels(block) / lines_->virtual_pixels();
                const auto trials = static_cast<std::uint32_t>(64 + share * all);
                points.clear();
                lines_->trials_in_block(block, {0}, ~0U, 0, trials, points);
                const double n = trials;
                const double p = static_cast<double>(points.size()) / n;
                const double unit = lines_->block_virtual_pixels(block) * pixel;
                area[block] = unit * p;
                variance[block] = unit * unit * p * (1 - p) / n;
            }
        });
        area_ = std::accumulate(area.begin(), area.end(), 0.0);
        area_error_ = std::sqrt(std::accumulate(variance.begin(), variance.end(), 0.0));
        if (area_error_ <= kAreaError * area_) break;
    }
}

std::optional<Vec3> UniformPoints::point(Seed seed, std::uint32_t stream, std::uint64_t index) const {
    if (!lines_) return std::nullopt;
    const auto found = lines_->trial(seed, stream, index);
    return found ? std::optional(camera_->to_world(found->view)) : std::nullopt;
}

std::vector<Vec3> UniformPoints::poisson(Seed seed, std::uint32_t stream, double mean) const {
    std::vector<Vec3> places;
    if (!(area_ > 0)) return places;
    const double pixel = camera_->pixel_size() * camera_->pixel_size();
    RandomStream random(seed, {.object = static_cast<std::uint32_t>(Purpose::particle_count), .repeat = stream});
    std::vector<SourcePoint> points;
    for (std::size_t block = 0; block < lines_->block_count(); ++block) {
        const double trials = mean / area_ * pixel * lines_->block_virtual_pixels(block);
        points.clear();
        lines_->trials_in_block(block, seed, stream, 0, poisson_number(trials, random), points);
        for (const SourcePoint& point : points) places.push_back(camera_->to_world(point.view));
    }
    return places;
}

}  // namespace pellucid
