#include "sample/poisson_number.hpp"

#include <random>

#include "core/error.hpp"

namespace pellucid {

std::uint32_t poisson_number(double mean, RandomStream& random) {
    if (!(mean > 0)) return 0;
    // The distribution does not end at means beyond its numbers.
    const std::uint64_t number = mean < 0x1p33 ? std::poisson_distribution<std::uint64_t>(mean)(random) : ~std::uint64_t{0};
    if (number > 0xffffffffU) throw run_error("more than 2^32 trials in one repeat: lower opacity or resolution");
    return static_cast<std::uint32_t>(number);
}

}  // namespace pellucid
