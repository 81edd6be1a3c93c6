// The shape in which one surface gives way to another across their crossing, as the virtual thickness of zSlabs
// spreads it. Ceres underneath, kept out of this header.
#pragma once

#include <span>

#include "measure/fit.hpp"

namespace pellucid {

/// Share of one of two surfaces in the colour of a pixel.
struct TransitionPoint {
    double x = 0;      // across the crossing, any unit
    double share = 0;  // 0 on one side, 1 on the other
};

/// share = ½ + ½ sign(u)·(1 − (1 − min(|u|, 1))^p) with u = (x − c)/w: parameters "center" c, "width" w (half of the
/// whole transition, unit of x) and "exponent" p. p = 1 is a ramp; two opaque slabs of one thickness have p = 2 under
/// the modified interpolation (front part u, mixture of what is shared by (4.4): u + (1 − u)(½ + u/2)), and w is
/// where they no longer overlap. No law, all points weigh alike: standard errors come from the scatter, p_value is 1.
/// Not converged where fewer than four points lie between 0 and 1: a step has neither width nor exponent.
[[nodiscard]] FitResult fit_transition(std::span<const TransitionPoint> points, double level = 0.95);

/// The model, for plots and tests.
[[nodiscard]] double transition_share(double x, double center, double width, double exponent);

}  // namespace pellucid
