#include "core/real.hpp"

#include <cmath>

#include "core/elementary-inl.h"

namespace pellucid {
namespace {

namespace el = HWY_NAMESPACE::elementary;
namespace hn = hwy::HWY_NAMESPACE;
constexpr hn::CappedTag<double, 1> kOne;

}  // namespace

Real abs(Real a) { return Real(std::abs(a.value)); }
Real sqrt(Real a) { return Real(std::sqrt(a.value)); }
Real exp(Real a) { return Real(hn::GetLane(el::exp(kOne, hn::Set(kOne, a.value)))); }
Real log(Real a) { return Real(hn::GetLane(el::log(kOne, hn::Set(kOne, a.value)))); }
Real sin(Real a) { return Real(hn::GetLane(el::sin_cos(kOne, hn::Set(kOne, a.value)).sin)); }
Real cos(Real a) { return Real(hn::GetLane(el::sin_cos(kOne, hn::Set(kOne, a.value)).cos)); }
Real tan(Real a) {
    const auto both = el::sin_cos(kOne, hn::Set(kOne, a.value));
    return Real(hn::GetLane(both.sin) / hn::GetLane(both.cos));
}

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
