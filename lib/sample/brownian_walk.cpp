#include "sample/brownian_walk.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/real.hpp"

namespace pellucid {
namespace {

constexpr int kNewtonSteps = 8;
constexpr int kBisections = 48;
/// Of the surface's width: what a step of Newton's may still move when it is the last.
constexpr double kOnSurface = 1e-9;
/// Newton may take a walker this many times the step away from where it was; farther is another sheet.
constexpr double kMostCorrection = 3;

/// Back to f = 0 from `x`; false where no way is found.
[[nodiscard]] bool correct(const WorldField& field, double step, Vec3& x) {
    const Vec3 start = x;
    const double small = kOnSurface * field.width();
    for (int k = 0; k < kNewtonSteps; ++k) {
        const FieldJet f = field.slope(x);
        const double square = dot(f.gradient, f.gradient);
        if (!(square > 0) || !std::isfinite(f.value)) break;
        const Vec3 move = (f.value / square) * f.gradient;
        x -= move;
        const double moved = length(move);
        if (!(length(x - start) < kMostCorrection * step + small)) break;
        if (moved <= small) return true;
    }
    // Bisection along the gradient at the start, first near, then as far as a step.
    const FieldJet first = field.slope(start);
    const double size = length(first.gradient);
    if (!(size > 0) || !std::isfinite(first.value)) return false;
    const Vec3 along = (first.value > 0 ? -1.0 : 1.0) / size * first.gradient;
    for (const double reach : {0.25, 1.0, kMostCorrection}) {
        double lo = 0;
        double hi = reach * step;
        const double end = field.slope(start + hi * along).value;
        if (!std::isfinite(end) || (end > 0) == (first.value > 0)) continue;
        for (int k = 0; k < kBisections && hi - lo > small; ++k) {
            const double middle = 0.5 * (lo + hi);
            const double value = field.slope(start + middle * along).value;
            if (!std::isfinite(value)) return false;
            ((value > 0) == (first.value > 0) ? lo : hi) = middle;
        }
        x = start + 0.5 * (lo + hi) * along;
        return true;
    }
    return false;
}

}  // namespace

WorldField::WorldField(const Object& object)
    : object_(&object),
      surface_(*object.geometry->field_surface()),
      to_object_(surface_.to_world.inverse()),
      to_object_transposed_(glm::transpose(to_object_.linear)) {
    Box world;
    for (int i = 0; i < 8; ++i)
        world.include(surface_.to_world.point({(i & 1) != 0 ? surface_.bounds.hi.x : surface_.bounds.lo.x,
                                               (i & 2) != 0 ? surface_.bounds.hi.y : surface_.bounds.lo.y,
                                               (i & 4) != 0 ? surface_.bounds.hi.z : surface_.bounds.lo.z}));
    const Vec3 size = world.size();
    width_ = std::max({size.x, size.y, size.z});
}

FieldJet WorldField::jet(const Vec3& world) const {
    FieldJet f = surface_.field->jet(to_object_.point(world));
    f.gradient = to_object_transposed_ * f.gradient;
    const Mat3 h = to_object_transposed_ * f.hessian_matrix() * to_object_.linear;
    f.hessian = {h[0][0], h[1][1], h[2][2], h[1][0], h[2][0], h[2][1]};
    return f;
}

FieldJet WorldField::slope(const Vec3& world) const {
    const Vec3 x = to_object_.point(world);
    return {surface_.field->value(x), to_object_transposed_ * surface_.field->gradient(x), {}};
}

bool WorldField::contains(const Vec3& world) const {
    const Vec3 x = to_object_.point(world);
    const Vec3 room = 1e-9 * surface_.bounds.size();  // a surface touches its own box
    for (int axis = 0; axis < 3; ++axis)
        if (!(x[axis] >= surface_.bounds.lo[axis] - room[axis] && x[axis] <= surface_.bounds.hi[axis] + room[axis])) return false;
    return object_->keeps(world);
}

std::array<double, 3> normal_numbers(Seed seed, const DrawKey& key) {
    const auto bits = random_bits(seed, key);
    const auto radius = [](std::uint32_t word) { return sqrt(Real(-2) * log(Real(unit_interval(word)))); };
    const Real turn(2 * std::numbers::pi);
    const Real first = turn * Real(unit_interval(bits[1]));
    const Real second = turn * Real(unit_interval(bits[3]));
    const Real r = radius(bits[0]);
    return {(r * cos(first)).value, (r * sin(first)).value, (radius(bits[2]) * cos(second)).value};
}

WalkOutcome walk_one_step(const WorldField& field, const WalkStep& step, const std::array<double, 3>& noise, Vec3& x) {
    const double scale = step.length * std::sqrt(step.noise);
    const Vec3 dw = scale * Vec3(noise[0], noise[1], noise[2]);
    const FieldJet f = step.drift ? field.jet(x) : field.slope(x);
    const double square = dot(f.gradient, f.gradient);
    Vec3 moved = x;
    if (!(square > 0)) {
        moved += dw;  // a singular point: no tangent plane, and the correction finds a sheet
    } else {
        moved += step.projected ? dw - (dot(f.gradient, dw) / square) * f.gradient : dw;
        if (step.drift) {
            // Tr(H P) = Tr H − ∇fᵀ H ∇f/|∇f|².
            const auto& h = f.hessian;
            const Vec3& g = f.gradient;
            const double bend = h[0] * g.x * g.x + h[1] * g.y * g.y + h[2] * g.z * g.z +
                                2 * (h[3] * g.x * g.y + h[4] * g.x * g.z + h[5] * g.y * g.z);
            const double trace = h[0] + h[1] + h[2] - bend / square;
            const double dt = 0.5 * step.length * step.length;
            moved -= (dt * trace / square) * g;
        }
    }
    if (step.corrected && !correct(field, step.length, moved)) return WalkOutcome::lost;
    if (!field.contains(moved)) return WalkOutcome::stayed_inside;
    x = moved;
    return WalkOutcome::moved;
}

}  // namespace pellucid
