// The sRGB transfer functions (IEC 61966-2-1), both ways.
#pragma once

#include <cmath>

namespace pellucid {

/// Linear to sRGB, [0, 1] onto [0, 1]; the straight piece goes on below 0. In pieces as the
/// standard has them, not a power of 2.2.
[[nodiscard]] inline double srgb_encode(double linear) {
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1.0 / 2.4) - 0.055;
}

/// sRGB to linear, [0, 1] onto [0, 1].
[[nodiscard]] inline double srgb_decode(double encoded) {
    return encoded <= 0.04045 ? encoded / 12.92 : std::pow((encoded + 0.055) / 1.055, 2.4);
}

}  // namespace pellucid
