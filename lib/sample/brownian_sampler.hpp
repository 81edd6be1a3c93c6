// Particles of a surface by Brownian motion on it: Tanaka et al. 2012, section 4.
//
// Every repeat has walkers of its own, so that repeats are independent. Within a repeat the positions of one walker
// follow each other: a trial is one position of one walker, all walkers' first positions before all second ones.
// Positions are uniform in world area but for the bias of the step; thinning by w·(least s)/s(x) makes them the
// particles of a view (view_thinning.hpp), V = A/least s. A is measured by random lines: its standard error, 5e-4 of
// it at most, is one of τ = −ln(1 − α), the same for all repeats.
#pragma once

#include <atomic>
#include <memory>

#include "sample/brownian_walk.hpp"
#include "sample/particle_source.hpp"
#include "sample/surface_places.hpp"
#include "sample/view_thinning.hpp"

namespace pellucid {

class BrownianSampler final : public ParticleSource {
public:
    /// Throws Error(input) naming an object that has no field. The object must outlive the sampler.
    BrownianSampler(const Object& object, const Camera& camera, std::uint32_t object_id, const WalkSettings& settings);

    [[nodiscard]] std::uint32_t object_id() const override { return object_id_; }
    [[nodiscard]] std::string label() const override;
    [[nodiscard]] double optical_depth() const override;
    [[nodiscard]] double virtual_pixels() const override { return virtual_pixels_; }
    [[nodiscard]] std::size_t block_count() const override { return virtual_pixels_ > 0 ? 1 : 0; }
    [[nodiscard]] double block_virtual_pixels(std::size_t) const override { return virtual_pixels_; }
    void trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first, std::uint32_t count,
                         std::vector<Point>& out) const override;
    [[nodiscard]] std::optional<Point> trial(Seed, std::uint32_t, std::uint64_t) const override { return std::nullopt; }
    [[nodiscard]] bool has_single_trials() const override { return false; }
    [[nodiscard]] std::size_t piece_count() const override { return settings_.walkers; }
    [[nodiscard]] std::size_t bytes() const override { return places_.bytes(); }
    /// Steps without a way back to the surface, and walkers that were put elsewhere after several in a row.
    [[nodiscard]] std::string remark() const override;

    [[nodiscard]] const UniformPlaces::Area& area() const { return area_; }
    [[nodiscard]] const BrownianWalk& walk() const { return walk_; }
    struct Tally {
        std::uint64_t steps = 0, lost = 0, restarts = 0;
    };
    [[nodiscard]] Tally tally() const { return {tally_->steps, tally_->lost, tally_->restarts}; }

    /// A position of a walker in the world, before any view.
    struct Position {
        Vec3 at, normal;
        double chance;  // for the thinning
    };
    /// Positions of the walkers of a repeat, round by round: appends `count` of them.
    void positions(Seed seed, std::uint32_t repeat, std::uint64_t count, std::vector<Position>& out) const;

private:
    struct Walkers;
    struct Counts {
        std::atomic<std::uint64_t> steps = 0, lost = 0, restarts = 0;
    };
    template <class Take>
    void walk(Seed seed, std::uint32_t repeat, std::uint64_t count, const Take& take) const;
    void start(Walkers& walkers, std::size_t index, Seed seed, std::uint32_t repeat) const;

    const Object* object_;
    std::uint32_t object_id_;
    WalkSettings settings_;
    BrownianWalk walk_;
    ViewThinning thinning_;
    UniformPlaces places_;
    UniformPlaces::Area area_;
    double virtual_pixels_ = 0;
    std::unique_ptr<Counts> tally_ = std::make_unique<Counts>();
};

}  // namespace pellucid
