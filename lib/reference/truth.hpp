// The ray-traced truth: every crossing of every ray, in order, composited front to back, and between crossings what
// volumes emit and absorb (volume_rays.hpp; its error is below 1/20 of max_error, and below 1e-3).
#pragma once

#include <cstdint>
#include <functional>
#include <optional>

#include "core/image.hpp"
#include "core/random.hpp"
#include "field/isolation_stats.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

enum class PixelFilter {
    /// Mean colour and opacity over the pixel's area.
    box,
    /// What particle rendering converges to: a particle covers its whole pixel wherever in it it lands, so
    /// optical depth is averaged over the pixel, not opacity. The hits of all sub-rays are pooled, sorted
    /// by depth, each given 1/n of its optical depth −ln(1−α), and composited (layer_pool.hpp).
    particle,
};

struct TruthSettings {
    PixelFilter filter = PixelFilter::box;
    Seed seed{};
    /// A pilot of 64 sub-rays tells how many a pixel needs for this standard error in every channel. What is
    /// reported is the error of the sub-rays that follow, which scatters up to twice as large …
    double max_error = 0.002;
    /// … as it does where a pixel would need more than this many; 64, 256, 1024, …
    int max_samples = 4096;
    /// Exactly so many sub-rays in every pixel, 16, 64, 256, …: no pilot, no second look, whatever the error.
    std::optional<int> samples = {};
};

struct TruthStats {
    std::uint64_t rays = 0;
    std::uint64_t hits = 0;
    std::uint64_t unresolved_pixels = 0;  // those that would have needed more than max_samples
    IsolationStats isolation;             // what fields could not decide, over all rays
    std::uint64_t cut_short = 0;          // rays through volumes that reached the bound of work for one ray
    double worst_error = 0;               // largest standard error of a channel
    double mean_square_error = 0;         // mean over pixels and R, G, B of the squared standard error
    double build_s = 0;
    double trace_s = 0;
    std::int64_t embree_bytes = 0;
};

/// R, G, B (associated), A, Z (nearest depth over all sub-rays, +inf where none) and variance.R/G/B/A, the
/// squared standard error of the pixel. With PixelFilter::particle also repeat_variance.R/G/B/A: the
/// variance of that pixel in one repeat of a particle rendering, Σ w_i c_i² − (Σ w_i c_i)².
///
/// In scenes with volumes, whose rays are dear, a pilot of 16 sub-rays comes first, and 16 will do where that says so and
/// all of it met the same.
///
/// A pixel whose sub-rays all met the same, beside one that met more, is traced with up to 1024 (max_samples
/// permitting): slivers slip between few rays, and agreement is then no measure of the error.
///
/// Four independent sets of jittered sub-rays (4×4 strata each, or 8×8, …) give a pixel's mean and the
/// standard error of it: from the four sub-rays of each stratum (box), or from the sets by jackknife (particle). They
/// share nothing with the pilot: an estimate that decides when to stop is too small.
///   progress  told the share that is done of the first look at all pixels; from one thread at a time
[[nodiscard]] Image trace_truth(const PreparedScene& scene, const TruthSettings& settings, TruthStats& stats,
                                const std::function<void(double)>& progress = [](double) {});

}  // namespace pellucid
