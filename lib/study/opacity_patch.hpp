// Test surfaces whose covered share is known: what `opacity_vs_n` throws particles at.
//
// A patch is one surface of one layer, n particles uniform on it (uniform in dA/s in perspective). In
// an image pixel k that the patch fills, a particle lands with chance q_k = c_k/V, where V = ∫dA/s is S/s
// and c_k the pixel's mean of 1/|cosθ|: PBSR (1) with its tilt, (1 − q_k)^n left clear, pixel by pixel.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "measure/fit.hpp"
#include "measure/occupancy.hpp"
#include "measure/statistics.hpp"
#include "sample/particle_sampler.hpp"
#include "scene/prepared_scene.hpp"
#include "stage/particle_drawer.hpp"

namespace pellucid {

enum class PatchShape {
    flat,    // a rectangle, tilted about the image's x axis
    sphere,  // its part that faces the camera
    torus,   // the half towards the camera, seen along its axis; minor = 0.4 major
};

struct PatchView {
    PatchShape shape = PatchShape::flat;
    Projection projection = Projection::orthographic;
    double ratio = 1e-4;   // s/S, that is 1/V
    double tilt_deg = 0;   // flat only, [0, 90)
};

/// The measured pixels between two angles θ (normal to ray): whole pixels of one layer, all of whose
/// rays lie between them.
struct Ring {
    double theta_lo_deg = 0;
    double theta_hi_deg = 0;
    double pixels = 0;                  // S cosθ/s: area of the ring in the image, in pixels
    std::vector<std::uint32_t> members = {}; // pixel numbers, ascending
    std::vector<double> landing = {};        // q_k, one a member
    std::vector<PixelClass> classes = {};    // the same, grouped
    bool equal = false;                 // all q_k are 1/pixels: the exact law is at hand
};

struct OpacityPatch {
    PatchView view;
    Scene scene;
    std::vector<Ring> rings;
};

/// Builds scene and rings. A flat patch is laid on the pixel grid, so that most of its pixels are whole.
/// Empty where s >= S cosθ: less than one pixel is outside the theory.
///   ring_edges_deg  ascending; used by curved shapes. Flat patches are one ring, whatever their angles.
[[nodiscard]] std::optional<OpacityPatch> make_opacity_patch(const PatchView& view,
                                                             const std::vector<double>& ring_edges_deg);

/// Theory of one repeat for a ring: mean and variance of the covered share of its pixels.
[[nodiscard]] CoveredShare ring_theory(const Ring& ring, double count);

/// What was drawn of a ring in a number of repeats.
struct RingDraw {
    std::int64_t covered = 0;   // pixels, over all repeats
    MeanVariance share;         // covered share, repeat by repeat
    double squares = 0;         // Σ_k (ᾱ_k − α_k)²/(α_k(1−α_k)), 0 < α_k < 1: mean over pixels is 1/repeats
    double squares_variance = 0;  // of that sum, by theory, pixels taken as independent
    std::size_t informative = 0;  // pixels in it
    [[nodiscard]] double alpha() const { return share.mean(); }
};

/// Wrong on purpose: what the tests must reject.
enum class DrawTwin { none, two_pixels_wide, shared_set };

/// What is thrown at a patch.
struct PatchThrow {
    std::uint64_t count = 0;     // particles a repeat
    std::uint32_t repeats = 1;
    Seed seed;
    DrawTwin twin = DrawTwin::none;
};

/// What one drawer drew of it.
struct PatchDraw {
    std::vector<RingDraw> rings;
    bool as_first = true;        // every particle won the same pixel as on the first drawer, or none on both
};

/// Throws the particles once and draws them by each of the drawers (those of `scene`); one result each.
[[nodiscard]] std::vector<PatchDraw> draw_patch(const OpacityPatch& patch, const PreparedScene& scene,
                                                const LineSampler& sampler,
                                                std::span<const std::unique_ptr<ParticleDrawer>> drawers,
                                                const PatchThrow& thrown);

/// The drawn total as a standard normal under the theory.
[[nodiscard]] double ring_z_score(const Ring& ring, const RingDraw& draw, double count, double repeats,
                                  Seed seed);

/// The ring as a point for the fits: classes become parts of one cosine each.
[[nodiscard]] OpacityPoint fit_point(const OpacityPatch& patch, const Ring& ring, const RingDraw& draw,
                                     double count, double repeats);

}  // namespace pellucid
