// Pre-integration: what a part of a ray does along which the value of a volume goes linearly from one number
// to another. K. Engel, M. Kraus, T. Ertl, High-quality pre-integrated volume rendering using
// hardware-accelerated pixel shading, Graphics Hardware 2001.
//
// Not by tables: transfer functions are linear in pieces, and the mean of −ln(1 − α) over α that goes
// linearly has a closed form. So opacity is exact, jumps are cut where they are, and the range of values does
// not matter.
#pragma once

#include "scene/transfer.hpp"

namespace pellucid {

/// Colour is associated.
struct Look {
    double opacity = 0;
    Vec3 color{0.0};
};

/// Opacity to rounding. Colour with attenuation inside of the part, to 5e-4 of the brightest colour times
/// opacity (exact where one colour, or constant opacity, lies between two points).
///   from, to  at the front and at the back; where one is not a number the part is empty
///   steps     length of the part in units of the opacity step, >= 0
[[nodiscard]] Look preintegrate(const TransferFunction& transfer, double from, double to, double steps);

}  // namespace pellucid
