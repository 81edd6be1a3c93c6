// Brownian motion on f = 0: one step of it, equations (2) and (3) of Tanaka et al. 2012.
//
//   dx = P dw − (dt/|∇f|²) ∇f Tr(H P),   P = 1 − ∇f ∇fᵀ/|∇f|²,   ⟨dw_i dw_j⟩ = 2 δ_ij dt,   √(2 dt) = step
// by Euler, then Newton's method along the gradient back to the surface, else bisection. A step that would leave the domain
// (bounds, clip planes, the hull of a volume), or that finds no way back to the surface, is not made: the walker
// stays. Proposals are symmetric to the order of the step, so staying keeps the uniform law, at borders as inside
// (Metropolis et al. 1953 with a constant density).
#pragma once

#include <array>
#include <cstdint>

#include "core/random.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct WalkStep {
    double length = 0;          // √(2 dt), world
    bool drift = true;          // dx^(S)
    // Wrong twins, for tests that must reject them.
    bool projected = true;      // P in front of dw
    bool corrected = true;      // back to the surface
    double noise = 1;           // times the variance of dw
};

/// The field of an object in the world.
class WorldField {
public:
    /// Precondition: object.geometry->field_surface().
    explicit WorldField(const Object& object);

    [[nodiscard]] FieldJet jet(const Vec3& world) const;
    /// Value and gradient.
    [[nodiscard]] FieldJet slope(const Vec3& world) const;
    /// Whether the place is within the field's bounds, and not clipped.
    [[nodiscard]] bool contains(const Vec3& world) const;
    [[nodiscard]] const FieldSurface& surface() const { return surface_; }
    /// Largest side of the bounds in the world: the surface's width.
    [[nodiscard]] double width() const { return width_; }

private:
    const Object* object_;
    FieldSurface surface_;
    Affine to_object_;
    Mat3 to_object_transposed_;
    double width_;
};

enum class WalkOutcome : std::uint8_t { moved, stayed_inside, lost };

/// Three independent normal numbers of a counter: Box-Muller, with the same bits on every machine.
[[nodiscard]] std::array<double, 3> normal_numbers(Seed seed, const DrawKey& key);

/// Moves x by one step of noise dw/step; `x` stays where it cannot go.
[[nodiscard]] WalkOutcome walk_one_step(const WorldField& field, const WalkStep& step, const std::array<double, 3>& noise,
                                        Vec3& x);

}  // namespace pellucid
