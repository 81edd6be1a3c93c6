// Places uniform in the world area of a whole surface, in view or not, and how large that area is.
//
// Random lines (line_sampler.hpp) seen by a camera that sees everything: in an orthographic view one pixel sees the
// same area everywhere, and by the oblique law nothing is thinned, so that a trial lands on dA with probability
// dA/(s·V). The share of trials that land times s·V is the area (Cauchy-Crofton).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/random.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

class LineSampler;

class UniformPlaces {
public:
    /// Clip planes and bounds of the object cut. The object need not live longer than this call.
    explicit UniformPlaces(const Object& object);
    ~UniformPlaces();
    UniformPlaces(UniformPlaces&&) noexcept;
    UniformPlaces& operator=(UniformPlaces&&) noexcept;

    struct Area {
        double value = 0;  // square scene units
        double standard_error = 0;
    };
    /// The same number at every call: trials with random numbers of their own, stratified over the surface's pieces, until
    /// the standard error is `relative` of the area, or 2^26 of them.
    [[nodiscard]] Area area(double relative = 5e-4) const;

    struct Place {
        Vec3 at{0.0};      // world
        Vec3 normal{0.0};  // as for shading; not normalised
    };
    /// The first of 4096 trials that lands; index < 2^40. Empty where nothing is there, or next to nothing.
    [[nodiscard]] std::optional<Place> place(Seed seed, std::uint32_t repeat, std::uint64_t index) const;
    /// A Poisson number of places, many times as fast, in an order that is not random.
    [[nodiscard]] std::vector<Vec3> poisson(Seed seed, std::uint32_t repeat, double mean_count, const Area& area) const;
    [[nodiscard]] std::size_t bytes() const;

private:
    std::unique_ptr<Object> whole_;
    std::unique_ptr<Camera> camera_;
    std::unique_ptr<LineSampler> lines_;
    double pixel_area_ = 1;
};

}  // namespace pellucid
