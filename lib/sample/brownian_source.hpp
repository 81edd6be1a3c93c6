// Particles by Brownian motion on the surface: `particles.sampler = "brownian"`.
//
// Every repeat has walkers of its own, so repeats are independent; within a repeat a walker's positions follow each other
// and are not. Position i of a repeat: walker i mod W, after (i div W + 1)·thinning steps. Its law is uniform in area
// up to the step's own bias. It lands on dA with probability dA/A and is thinned for the view (view_thinning.hpp): V =
// A/least s. A comes from random lines (uniform_points.hpp); its standard error is one of τ = −ln(1 − α) in all repeats.
//
// *Clumps.* A walker comes back: i steps on it is in the pixel it was in with probability ~ c/i, c = (least s)/(2π·thinning·
// step²), the density of a planar Gaussian at 0 (a pixel that sees more area keeps fewer in proportion). With m positions a
// walker, a particle so shares its pixel with  e(m) = (2/m) Σ_i (m − i) min(1, c/i)  more of its own walker than by chance,
// and a pixel of opacity α is too transparent by about (1 − α) τ e/2 <= 0.18 e. By default there are as many walkers as keep
// e <= kMostClumping: at 1000 pixels across 256 may do, at 100 each particle has a walker of its own.
#pragma once

#include <atomic>

#include "sample/brownian_walk.hpp"
#include "sample/particle_source.hpp"
#include "sample/uniform_points.hpp"
#include "sample/view_thinning.hpp"

namespace pellucid {

struct WalkSettings {
    /// √(2Δt) as a share of the surface's width; absent: kWalkStep, or kWalkCellStep of a cell of volumes and points.
    std::optional<double> step{};
    std::optional<std::uint32_t> walkers{};  // W, of each repeat; absent: as many as do not clump, kLeastWalkers at least
    std::uint32_t thinning = 1;
    bool drift = true;            // dx^(S)
    enum class Start { uniform, single };
    /// uniform: each walker at an independent uniform place. single: all of a repeat's at one such place.
    Start start = Start::uniform;
    /// Wrong twins; its length and drift are not used.
    WalkStep twin{};
};
inline constexpr double kWalkStep = 0.03;  // on a torus of radii 1 and 0.4 the density's bias is not seen below
inline constexpr double kWalkCellStep = 0.3;
inline constexpr std::uint32_t kLeastWalkers = 256;
inline constexpr std::uint32_t kMostWalkers = 1U << 20U;

/// e(m) above, for m = `positions` >= 1 and c = `share`; c/i only while it exceeds `chance`, s/A.
[[nodiscard]] double clumping(double share, double chance, double positions);
inline constexpr double kMostClumping = 0.005;  // opacity is too low by 0.001 at most
inline constexpr double kClumpingWorthAWord = 0.05;

class BrownianSource final : public ParticleSource {
public:
    /// Throws Error(input) where the object has no field.
    BrownianSource(const Object& object, const Camera& camera, std::uint32_t object_id, const WalkSettings& settings);

    [[nodiscard]] std::uint32_t object_id() const override { return object_id_; }
    [[nodiscard]] std::string label() const override;
    [[nodiscard]] double optical_depth() const override;
    [[nodiscard]] double virtual_pixels() const override { return virtual_pixels_; }
    [[nodiscard]] std::size_t block_count() const override { return virtual_pixels_ > 0 ? 1 : 0; }
    [[nodiscard]] double block_virtual_pixels(std::size_t) const override { return virtual_pixels_; }
    /// Walks from the start of the repeat, whatever `first` is.
    void trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first, std::uint32_t count,
                         std::vector<Point>& out) const override;
    [[nodiscard]] std::optional<Point> trial(Seed, std::uint32_t, std::uint64_t) const override { return std::nullopt; }
    [[nodiscard]] bool has_single_trials() const override { return false; }
    [[nodiscard]] std::size_t piece_count() const override { return 1; }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this); }
    [[nodiscard]] std::string complaint() const override;

    /// Positions 0 … count − 1 of a repeat, world, kept or not.
    [[nodiscard]] std::vector<Vec3> positions(Seed seed, std::uint32_t repeat, std::uint32_t count) const;
    [[nodiscard]] double step_length() const { return step_.length; }
    [[nodiscard]] std::uint32_t walkers() const { return walkers_; }
    /// e(m) of its walkers: above.
    [[nodiscard]] double clumping() const;
    [[nodiscard]] double area() const { return places_.area(); }
    [[nodiscard]] double area_error() const { return places_.area_error(); }
    struct Stats {
        std::uint64_t steps = 0;
        std::uint64_t at_borders = 0;  // steps folded back at an edge, or not made there
        std::uint64_t lost = 0;        // steps not made that found no way back to the surface
        std::uint64_t restarts = 0;    // walkers put elsewhere after several of these in a row
    };
    [[nodiscard]] Stats stats() const;

private:
    struct Herd;
    [[nodiscard]] BrownianWalk::Walker start(Herd& herd, Seed seed, std::uint32_t repeat) const;
    void advance(Herd& herd, std::uint32_t i, Seed seed, std::uint32_t repeat, std::uint32_t step) const;
    /// Gives positions 0 … count − 1 to take(first index, herd, how many walkers, last step), round by round.
    [[nodiscard]] std::uint32_t enough_walkers() const;
    template <class Take>
    void walk(Seed seed, std::uint32_t repeat, std::uint32_t count, const Take& take) const;

    const Object* object_;
    const Camera* camera_;
    std::uint32_t object_id_;
    WalkSettings settings_;
    UniformPoints places_;
    ViewThinning thinning_;
    WalkStep step_;
    BrownianWalk walk_;
    LineView view_;  // of object space
    double virtual_pixels_ = 0;
    double share_ = 0;  // c
    std::uint32_t walkers_ = kLeastWalkers;
    mutable std::atomic<std::uint64_t> steps_ = 0, at_borders_ = 0, lost_ = 0, restarts_ = 0;
};

}  // namespace pellucid
