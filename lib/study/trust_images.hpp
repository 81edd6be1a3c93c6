// Whole pictures of the truth: whether its stated error is true, what its particle filter converges to, and
// surfaces at one place in every order.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "core/image.hpp"
#include "core/random.hpp"
#include "measure/particle_test.hpp"
#include "reference/truth.hpp"

namespace pellucid {

struct TrustScene {
    std::string name;
    PreparedScene scene;
    bool heavy_tailed = false;  // optical depth has no finite variance in some pixels: oblique rims
};

/// Small pictures of what makes a truth's work hard: edges, thin layers, a silhouette, detail in colour, many
/// layers.
///   pixels  width and height
///   folder  where the textured scene may write its image
[[nodiscard]] std::vector<TrustScene> error_scenes(int pixels, const std::filesystem::path& folder);

/// The spread of many tracings with different seeds beside what each of them said of itself. Means are over
/// seeds, pixels and channels R, G, B, A.
///
/// Where all sub-rays of a pixel met the same, beside one that met more, the truth states Laplace's rule
/// instead of their agreement: a floor that errs on the safe side. It is told apart here, for what remains
/// should be exact.
struct StatedError {
    std::size_t seeds = 0;
    double stated_variance = 0;   // without floors
    double floor_variance = 0;    // the floors alone
    double true_variance = 0;     // of a tracing about the mean of all, unbiased
    double ratio = 0;             // stated (without floors) over true; 0 where nothing varies
    double ratio_error = 0;       // its standard error, from the scatter of both sums over the seeds
    double allowed_variance = 0;  // mean of max(stated with floors, asked²): what a user may rely on
    double rms = 0;               // root of true_variance
    double worst_rms = 0;         // largest true standard error of a channel of a pixel
    double rays_per_pixel = 0;
};

struct StatedErrorPlan {
    TruthSettings truth;  // its seed is replaced
    std::size_t seeds = 64;
    Seed seed;
    double variance_factor = 1;  // wrong twin: what is stated is taken times this
};
[[nodiscard]] StatedError measure_stated_error(const PreparedScene& scene, const StatedErrorPlan& plan);

/// A particle picture of brute force (many repeats) against the truth with the particle filter, pixel by
/// pixel, by the exact binomial.
struct ParticleVerdict {
    std::size_t pixels = 0;  // tested
    std::int64_t left_out = 0;
    double worst_z = 0;      // largest |z| of a pixel
    double smallest_p = 1;   // of KS, χ² and the share outside 3σ
    double color_ratio = 0;  // RMSE of colour over what theory says it must be
    double color_p = 1;
    double drawn_where_nothing_is = 0;
    double smallest_error_seen = 0;  // of optical depth, as a share
};
struct ParticlePlan {
    std::uint32_t repeats = 1000;
    TruthSettings truth{.filter = PixelFilter::particle};  // `filter` = box: a wrong twin
    Seed seed;
    double optical_depth_error = 0;  // wrong twin: densities of the truth off by this share
};
[[nodiscard]] ParticleVerdict judge_particles(const PreparedScene& scene, const ParticlePlan& plan);

/// Scenes with edges under both laws of opacity.
[[nodiscard]] std::vector<TrustScene> particle_scenes(int pixels);

/// Surfaces at one place, the scene file in every order.
struct CoincidentResult {
    std::string name;
    int layers = 0;
    std::size_t orders = 0;
    double worst_ulps = 0;    // between any order and the first, in units of the last place of a float at 1
    double worst_theory = 0;  // largest |A or colour − mean over all orders in depth|, pixels wholly covered
    std::size_t pixels = 0;   // of them
};
/// What is laid on what.
enum class Coincidence { rectangles, spheres, mesh_on_plane };
[[nodiscard]] CoincidentResult measure_coincident(Coincidence kind, int layers, int pixels,
                                                  const std::filesystem::path& folder, Seed seed);
inline constexpr Coincidence kCoincidences[] = {Coincidence::rectangles, Coincidence::spheres,
                                                Coincidence::mesh_on_plane};

}  // namespace pellucid
