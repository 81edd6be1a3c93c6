#include "sample/poisson_number.hpp"

#include <random>

#include "core/error.hpp"

namespace pellucid {

std::uint32_t poisson_number(double mean, RandomStream& random) {
    if (!(mean > 0)) return 0;
    const std::uint64_t number = std::poisson_distribution<std::uint64_t>(mean)(random);
    if (number > 0xffffffffU) throw run_error("more than 2^32 trials in one repeat: lower opacity or resolution");
    return static_cast<std::uint32_t>(number);
}

}  // namespace pellucid
