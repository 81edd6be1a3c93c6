#include "sample/brownian_walk.hpp"

#include <algorithm>
#include <cmath>

#include "core/real.hpp"

namespace pellucid {
namespace {

/// Newton's method doubles the digits: from 1e-6 of the width, one step leaves 1e-12 of it times its curvature.
constexpr double kNear = 1e-6;
constexpr int kMostNewton = 12;
/// A Gaussian step is longer than this many of its scales once in 10^7: what needs a longer way back is lost.
constexpr double kReachOfSteps = 6;
constexpr int kBracketSteps = 12;  // a side
constexpr int kBisections = 60;
constexpr int kMostFolds = 4;
constexpr double kHair = 1e-9;  // of the width: surfaces touch their own bounds
constexpr std::uint32_t kMostRedraws = 64;

/// Two Gaussian numbers (Box and Muller 1958), the same bits on every machine.
[[nodiscard]] Vec2 gaussian_pair(std::uint32_t radius_bits, std::uint32_t turn_bits) {
    const double r = std::sqrt(-2 * log(Real(unit_interval(radius_bits))).value);
    const Real turn(6.283185307179586477 * unit_interval(turn_bits));
    return {r * cos(turn).value, r * sin(turn).value};
}

/// Completes a unit vector to an orthonormal basis (Duff et al. 2017, Building an orthonormal basis, revisited).
struct TangentBasis {
    Vec3 first, second;

    explicit TangentBasis(const Vec3& n) {
        const double sign = std::copysign(1.0, n.z);
        const double a = -1 / (sign + n.z);
        const double b = n.x * n.y * a;
        first = {1 + sign * n.x * n.x * a, sign * b, -sign * n.x};
        second = {b, sign + n.y * n.y * a, -n.y};
    }
};

[[nodiscard]] bool usable(const Vec3& gradient) {
    const double square = dot(gradient, gradient);
    return square > 0 && square < kInfinity;
}

}  // namespace

double surface_width(const FieldSurface& surface) {
    double width = 0;
    for (int axis = 0; axis < 3; ++axis)
        width = std::max(width, surface.bounds.size()[axis] * length(surface.to_world.linear[axis]));
    return width;
}

BrownianWalk::BrownianWalk(const Object& object, const WalkStep& step) : step_(step) {
    const FieldSurface surface = *object.geometry->field_surface();
    field_ = surface.field;
    to_world_ = surface.to_world;
    to_object_ = to_world_.inverse();
    inverse_ = to_object_.linear;
    inverse_transposed_ = glm::transpose(inverse_);

    const Mat3& m = to_world_.linear;
    const double scale = length(m[0]);
    const Mat3 square = glm::transpose(m) * m;
    isometric_ = true;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            if (!(std::abs(square[i][j] - (i == j ? scale * scale : 0)) <= 1e-12 * scale * scale)) isometric_ = false;
    const double to_inner = isometric_ ? 1 / scale : 1;

    const double width = surface_width(surface);
    bounds_ = surface.bounds;
    inner_step_ = step.length * to_inner;
    near_ = kNear * width * to_inner;
    reach_ = kReachOfSteps * inner_step_;
    hair_ = kHair * width * to_inner;

    const auto add_plane = [&](const Vec3& normal, double offset) {
        const double norm = length(metric(normal));
        if (norm > 0) planes_.push_back({normal / norm, metric(normal) / norm, offset / norm});
    };
    const auto add_box = [&](const Box& box) {
        for (int axis = 0; axis < 3; ++axis) {
            Vec3 normal(0.0);
            normal[axis] = 1;
            add_plane(normal, box.hi[axis]);
            add_plane(-normal, -box.lo[axis]);
        }
    };
    add_box(surface.bounds);
    if (object.surface.bounds && !object.bounds_are_geometry()) {
        // These bounds are of the surface's own object space, the field's may be another (samples of a volume).
        for (int axis = 0; axis < 3; ++axis) {
            Vec3 normal(0.0);
            normal[axis] = 1;
            const Affine to_bounds = compose(object.to_object, to_world_);
            const Vec3 row = glm::transpose(to_bounds.linear) * normal;
            add_plane(row, object.surface.bounds->hi[axis] - to_bounds.offset[axis]);
            add_plane(-row, to_bounds.offset[axis] - object.surface.bounds->lo[axis]);
        }
    }
    for (const ClipPlane& plane : object.surface.clip)
        add_plane(glm::transpose(m) * plane.normal, plane.offset - dot(plane.normal, to_world_.offset));
    // Planes that do not cut: what they keep out is no part of the surface, or only touches it.
    const auto* catalogue = dynamic_cast<const CatalogueSurface*>(field_);
    const bool bounded = catalogue != nullptr && catalogue->bounded();
    const Box& all = bounded ? catalogue->bounds() : surface.bounds;
    std::erase_if(planes_, [&](const Plane& plane) {
        Vec3 farthest;
        for (int axis = 0; axis < 3; ++axis) farthest[axis] = plane.normal[axis] > 0 ? all.hi[axis] : all.lo[axis];
        return beyond(plane, farthest) <= (bounded ? hair_ : -hair_);
    });

    const bool plain = step.projected && step.corrected && step.noise == 1;
    if (catalogue == nullptr || !isometric_ || !plain) return;
    QuickWalk quick;
    quick.torus = catalogue->torus();
    quick.drift = step.drift;
    quick.square = {catalogue->square().x, catalogue->square().y, catalogue->square().z};
    quick.linear = {catalogue->linear().x, catalogue->linear().y, catalogue->linear().z};
    quick.constant = catalogue->constant();
    quick.major = catalogue->major();
    quick.minor = catalogue->minor();
    quick.step = inner_step_;
    quick.near = near_;
    quick.reach = reach_;
    quick.hair = hair_;
    for (const Plane& plane : planes_)
        quick.planes.push_back({{plane.normal.x, plane.normal.y, plane.normal.z, plane.offset}});
    quick_ = std::move(quick);
}

Vec3 BrownianWalk::world_normal(const Walker& walker) const {
    return isometric_ ? to_world_.normal(walker.gradient) : walker.gradient;
}

bool BrownianWalk::inside(const Vec3& at) const {
    return std::ranges::all_of(planes_, [&](const Plane& plane) { return beyond(plane, at) <= hair_; });
}

bool BrownianWalk::put(const Vec3& place, Walker& walker) const {
    walker.at = to_object_.point(place);
    return settle(walker);
}

double BrownianWalk::value(const Vec3& at) const {
    const double own = field_->value(at);
    if (std::isfinite(own) || !step_.continued) return own;
    const Vec3 border = glm::clamp(at, bounds_.lo, bounds_.hi);
    if (border == at) return own;
    const FieldJet jet = field_->jet(border);
    return jet.value + dot(jet.gradient, at - border);
}

Vec3 BrownianWalk::gradient(const Vec3& at) const {
    const Vec3 own = field_->gradient(at);
    if (usable(own) || !step_.continued) return metric(own);
    const Vec3 border = glm::clamp(at, bounds_.lo, bounds_.hi);
    if (border == at) return metric(own);
    // Along the border the slope across it varies.
    const FieldJet jet = field_->jet(border);
    Vec3 turned = jet.hessian_matrix() * (at - border);
    for (int axis = 0; axis < 3; ++axis)
        if (at[axis] != border[axis]) turned[axis] = 0;
    return metric(jet.gradient + turned);
}

/// Newton's method along the gradient, else bisection along it.
bool BrownianWalk::settle(Walker& walker) const {
    const Vec3 from = walker.at;
    Vec3 first(0.0);
    double last = kInfinity;
    for (int i = 0; i < kMostNewton; ++i) {
        const double value = this->value(walker.at);
        const Vec3 gradient = this->gradient(walker.at);
        if (!usable(gradient) || !std::isfinite(value)) break;
        if (i == 0) first = gradient;
        const double square = dot(gradient, gradient);
        const double distance = std::abs(value) / std::sqrt(square);
        if (distance > reach_ || distance > 2 * last) break;
        walker.at -= inner((value / square) * gradient);
        walker.gradient = gradient;
        if (distance <= near_) return true;
        last = distance;
    }
    return usable(first) && settle_by_bisection(from, first, walker);
}

bool BrownianWalk::settle_by_bisection(const Vec3& from, const Vec3& gradient, Walker& walker) const {
    const Vec3 along = inner(normalize(gradient));
    const double value = this->value(from);
    // Downhill first.
    const double towards = value > 0 ? -1 : 1;
    for (const double side : {towards, -towards}) {
        double lo = 0;
        for (int i = 1; i <= kBracketSteps; ++i) {
            double hi = side * reach_ * i / kBracketSteps;
            const double there = this->value(from + hi * along);
            if (!std::isfinite(there)) break;
            if ((there > 0) == (value > 0)) {
                lo = hi;
                continue;
            }
            for (int k = 0; k < kBisections; ++k) {
                const double middle = 0.5 * (lo + hi);
                if (middle == lo || middle == hi) break;
                ((this->value(from + middle * along) > 0) == (value > 0) ? lo : hi) = middle;
            }
            const Vec3 at = from + 0.5 * (lo + hi) * along;
            const Vec3 there_gradient = this->gradient(at);
            if (!usable(there_gradient)) return false;
            walker = {at, there_gradient};
            return true;
        }
    }
    return false;
}

/// Mirrors what is beyond an edge in the tangent plane, edge by edge.
bool BrownianWalk::fold_back(Walker& walker) const {
    for (int i = 0; i < kMostFolds; ++i) {
        const Plane* crossed = nullptr;
        double most = hair_;
        for (const Plane& plane : planes_)
            if (const double by = beyond(plane, walker.at); by > most) {
                most = by;
                crossed = &plane;
            }
        if (crossed == nullptr) return true;
        const Vec3 n = normalize(walker.gradient);
        const Vec3 across = crossed->metric_normal - dot(crossed->metric_normal, n) * n;
        const double square = dot(across, across);
        // From y to 2(y + d) − y, d the way to the edge: n_b·d = −most.
        if (!(square > 1e-12)) return false;  // the surface lies along its edge
        const Vec3 back = (-2 * most / square) * across;
        if (!(dot(back, back) <= 4 * reach_ * reach_)) return false;
        walker.at += inner(back);
        if (step_.corrected && !settle(walker)) return false;
    }
    return inside(walker.at);
}

WalkOutcome BrownianWalk::advance(Walker& walker, Seed seed, const DrawKey& key) const {
    const auto bits = random_bits(seed, key);
    const double square = dot(walker.gradient, walker.gradient);
    const Vec3 n = walker.gradient / std::sqrt(square);
    const double scale = inner_step_ * std::sqrt(step_.noise);
    const TangentBasis basis(n);
    Vec2 noise = gaussian_pair(bits[0], bits[1]);

    Vec3 fixed(0.0);
    if (!step_.projected) {
        const auto more = random_bits(seed, {key.object, key.repeat, key.index, 1});
        fixed += (scale * gaussian_pair(more[0], more[1]).x) * n;
    }
    if (step_.drift) {
        // Tr(HP) = Tr H − n·Hn, H in the metric: H_ij contracted with M⁻¹M⁻ᵀ − (M⁻¹n)(M⁻¹n)ᵀ.
        // A hair beyond the border f may have none.
        const Mat3 h = field_->jet(glm::clamp(walker.at, bounds_.lo, bounds_.hi)).hessian_matrix();
        const Vec3 in = inner(n);
        double trace = -dot(in, h * in);
        if (isometric_) {
            trace += h[0][0] + h[1][1] + h[2][2];
        } else {
            const Mat3 product = inverse_ * inverse_transposed_;
            for (int i = 0; i < 3; ++i) trace += dot(h[i], product[i]);
        }
        const double dt = 0.5 * inner_step_ * inner_step_;  // ⟨dw²⟩ = 2dt
        const Vec3 drift = (-(dt * trace) / square) * walker.gradient;
        // Beside a node |∇f| vanishes and the term is no correction any more.
        if (dot(drift, drift) <= reach_ * reach_) fixed += drift;
    }
    for (std::uint32_t redraw = 0;; ++redraw) {
        Walker moved = walker;
        moved.at += inner(scale * (noise.x * basis.first + noise.y * basis.second) + fixed);
        if (step_.corrected) {
            if (!settle(moved)) return WalkOutcome::lost;
        } else {
            moved.gradient = gradient(moved.at);
            if (!usable(moved.gradient)) return WalkOutcome::lost;
        }
        const bool stays_inside = inside(moved.at);
        if (stays_inside || (step_.edge == WalkStep::Edge::fold && fold_back(moved))) {
            walker = moved;
            return stays_inside ? WalkOutcome::moved : WalkOutcome::folded;
        }
        if (step_.edge != WalkStep::Edge::redraw || redraw == kMostRedraws) return WalkOutcome::stayed_inside;
        const auto more = random_bits(seed, {key.object, key.repeat, key.index, 2 + redraw});
        noise = gaussian_pair(more[0], more[1]);
    }
}

}  // namespace pellucid
