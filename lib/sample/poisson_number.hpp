// Poisson numbers of trials.
#pragma once

#include <cstdint>

#include "core/random.hpp"

namespace pellucid {

/// Throws Error(run) beyond 2^32: trials are counted in 32 bits.
[[nodiscard]] std::uint32_t poisson_number(double mean, RandomStream& random);

}  // namespace pellucid
