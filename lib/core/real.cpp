#include "core/real.hpp"

#include <cmath>

namespace pellucid {

Real abs(Real a) { return Real(std::abs(a.value)); }
Real sqrt(Real a) { return Real(std::sqrt(a.value)); }
Real exp(Real a) { return Real(std::exp(a.value)); }
Real log(Real a) { return Real(std::log(a.value)); }
Real sin(Real a) { return Real(std::sin(a.value)); }
Real cos(Real a) { return Real(std::cos(a.value)); }
Real tan(Real a) { return Real(std::tan(a.value)); }

Real power(Real a, int exponent) {
    unsigned n = exponent < 0 ? 0U - static_cast<unsigned>(exponent) : static_cast<unsigned>(exponent);
    Real result(1.0);
    for (Real square_of_a = a; n != 0; n >>= 1U) {
        if ((n & 1U) != 0) result = result * square_of_a;
        if (n > 1) square_of_a = square_of_a * square_of_a;
    }
    return exponent < 0 ? Real(1.0) / result : result;
}

}  // namespace pellucid
