// Brownian motion confined to a surface f = 0: Tanaka et al. 2012 (2), (3), one step of one walker.
//
//     dx = dx^(T) + dx^(S),   dx^(T) = P dw,   dx^(S) = −(dt/|∇f|²) ∇f Tr(HP),   ⟨dw_i dw_j⟩ = 2 δ_ij dt
// by Euler's method, then Newton's (else bisection along the gradient) back to the surface. The walk is uniform in
// *world* area: with x = M u + o the world's gradient is M⁻ᵀ ∇_u f and its Hessian M⁻ᵀ H_u M⁻¹. P = QQᵀ with an
// orthonormal basis Q of the tangent plane, and Qᵀ dw are two independent Gaussian numbers: P dw is drawn as Q times
// these, the same law for two thirds of the numbers.
//
// *Open surfaces.* Where bounds or clip planes end the surface, the step is folded back at its edge: mirrored in the
// tangent plane at the line in which the cutting plane meets it. Without an edge the kernel k(x, y) is symmetric but for
// terms of the step's own order. On a half-plane the folded kernel is k(x, y) + k(x, y*), y* the mirror image; since
// k(x, y*) = k(x*, y) = k(y, x*), it is symmetric as well, and ∫ k'(x, y) dA(x) = ∫ k'(y, x) dA(x) = 1: the uniform law
// stays. Curvature of the edge adds a term of the step's length over its radius in a seam as wide as a step. What is
// still outside (corners) does not move, which keeps every symmetric kernel symmetric.
//
// *Fields that end.* A volume has no f beyond its hull, so a step across it would find no way back to the surface and never
// reach its fold: there f is continued from the nearest place c of its bounds, f(c) + ∇f(c)·(x − c).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/random.hpp"
#include "field/scalar_field.hpp"
#include "sample/edge_lines.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct WalkStep {
    double length = 0;  // √(2Δt), world
    bool drift = true;  // dx^(S)
    // Wrong twins, for tests that must reject them.
    bool projected = true;  // P in front of dw
    bool corrected = true;  // back to the surface
    bool continued = true;  // f beyond its bounds, where it is not defined
    double noise = 1;       // times the variance of dw
    /// At the surface's edges. stay: a step that would leave is not made; the same law, but particles that come twice, so
    /// that fewer pixels are covered beside an edge. redraw: until a step ends inside, half the density at edges: wrong.
    enum class Edge { fold, stay, redraw } edge = Edge::fold;
};

/// The surface's width: the longest side of its bounds in the world.
[[nodiscard]] double surface_width(const FieldSurface& surface);

enum class WalkOutcome : std::uint8_t { moved, folded, stayed_inside, lost };

/// What many walkers at once need to know, object space: brownian_simd.cpp.
struct QuickWalk {
    struct Plane {
        std::array<double, 4> normal_offset{};
    };
    bool torus = false, drift = true;
    std::array<double, 3> square{}, linear{};  // a quadric Σ q x² + l x + c
    double constant = 0, major = 0, minor = 0;
    double step = 0, near = 0, reach = 0, hair = 0;
    std::vector<Plane> planes;
};

/// Walkers as a structure of arrays of one length, a multiple of kHerdLanes.
struct HerdArrays {
    std::array<double*, 3> at, gradient;
    double* chance;  // for the view's thinning, of the last step
};
inline constexpr std::size_t kHerdLanes = 16;

/// One step of walkers 0 … count − 1: that of BrownianWalk::advance with key.index + (walker << 32) but for rounding.
/// What is not plain (an edge, a long way back to the surface) is left where it is, its number appended to `left`.
void walk_herd(const QuickWalk& walk, Seed seed, const DrawKey& key, const HerdArrays& herd, std::size_t count,
               std::vector<std::uint32_t>& left);

/// The walkers first … first + count − 1 (at most kLineChunk) that a view keeps: ViewThinning::keep but for clipping.
///   view   of object space;  bound  (least s)/(side of a pixel at depth 1)²
void keep_herd(const LineView& view, double bound, const HerdArrays& herd, std::size_t first, std::size_t count, PointChunk& out);

class BrownianWalk {
public:
    /// Precondition: geometry->field_surface() has a value. The object must outlive the walk.
    BrownianWalk(const Object& object, const WalkStep& step);

    struct Walker {
        Vec3 at{0.0};        // object space
        Vec3 gradient{0.0};  // there, in the metric of `metric`
    };
    [[nodiscard]] Vec3 world(const Walker& walker) const { return to_world_.point(walker.at); }
    [[nodiscard]] Vec3 world_normal(const Walker& walker) const;
    /// A walker on the surface near a world place; false where none is found.
    [[nodiscard]] bool put(const Vec3& place, Walker& walker) const;
    /// One step by block 0 of the key (twins: 1 and more). Unless it is made the walker stays: `lost` found no way back to
    /// the surface, `stayed_inside` none back from an edge.
    [[nodiscard]] WalkOutcome advance(Walker& walker, Seed seed, const DrawKey& key) const;

    /// Whether walk_herd knows the surface: a quadric or a torus of the catalogue, turned, moved and scaled evenly.
    [[nodiscard]] bool has_herds() const { return quick_.has_value(); }
    [[nodiscard]] const QuickWalk& quick() const { return *quick_; }

private:
    /// Keeps normal·u <= offset, object space; |gradient of the plane in the metric| = 1.
    struct Plane {
        Vec3 normal, metric_normal;
        double offset;
    };
    [[nodiscard]] Vec3 metric(const Vec3& covector) const { return isometric_ ? covector : inverse_transposed_ * covector; }
    [[nodiscard]] Vec3 inner(const Vec3& v) const { return isometric_ ? v : inverse_ * v; }
    /// Of f, continued beyond its bounds where it is not defined; the gradient in the metric.
    [[nodiscard]] double value(const Vec3& at) const;
    [[nodiscard]] Vec3 gradient(const Vec3& at) const;
    [[nodiscard]] bool settle(Walker& walker) const;
    [[nodiscard]] bool settle_by_bisection(const Vec3& from, const Vec3& gradient, Walker& walker) const;
    [[nodiscard]] bool fold_back(Walker& walker) const;
    [[nodiscard]] double beyond(const Plane& plane, const Vec3& at) const { return dot(plane.normal, at) - plane.offset; }
    [[nodiscard]] bool inside(const Vec3& at) const;

    const ScalarField* field_;
    Box bounds_;  // of the field
    WalkStep step_;
    Affine to_world_, to_object_;
    Mat3 inverse_, inverse_transposed_;
    bool isometric_ = false;  // but for its scale
    double inner_step_ = 0;
    double near_ = 0;   // this far from the surface one step of Newton's more is enough
    double reach_ = 0;  // farthest way back to the surface
    double hair_ = 0;   // beyond an edge
    std::vector<Plane> planes_;
    std::optional<QuickWalk> quick_;
};

}  // namespace pellucid
