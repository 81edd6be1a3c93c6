// The colour map "magma" (van der Walt & Smith 2015, public domain, CC0): dark to bright, even in lightness.
#pragma once

#include <array>
#include <cstdint>

namespace pellucid {

/// sRGB bytes, from 0 to 1.
extern const std::array<std::array<std::uint8_t, 3>, 256> kMagma;

}  // namespace pellucid
