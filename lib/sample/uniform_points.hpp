// Points uniform in area on a surface in the world, and that area: by random lines, for whoever needs a place to start.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "sample/line_sampler.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

class UniformPoints {
public:
    /// The whole surface but for what its clip planes and bounds cut away.
    UniformPoints(const Object& object, std::uint32_t object_id);
    UniformPoints(const UniformPoints&) = delete;
    UniformPoints& operator=(const UniformPoints&) = delete;

    /// Number `index` of a stream; empty where the trial gave nothing.
    [[nodiscard]] std::optional<Vec3> point(Seed seed, std::uint32_t stream, std::uint64_t index) const;
    /// A Poisson number of points, many times as fast, in an order that is not random.
    [[nodiscard]] std::vector<Vec3> poisson(Seed seed, std::uint32_t stream, double mean) const;
    /// World area and its standard error, from kAreaTrials trials at most. 0 where there is no surface.
    [[nodiscard]] double area() const { return area_; }
    [[nodiscard]] double area_error() const { return area_error_; }

    static constexpr std::uint32_t kAreaTrials = 1U << 22U;
    /// A share of the area that its standard error may be: what opacities near 0 are off by, as a share.
    static constexpr double kAreaError = 7e-4;

private:
    Object object_;  // under the oblique law, seen from far away: density in proportion to area
    std::unique_ptr<Camera> camera_;
    std::unique_ptr<LineSampler> lines_;
    double area_ = 0, area_error_ = 0;
};

}  // namespace pellucid
