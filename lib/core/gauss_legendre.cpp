#include "core/gauss_legendre.hpp"

#include <cmath>
#include <numbers>

namespace pellucid {

std::vector<QuadratureNode> gauss_legendre(std::size_t n) {
    std::vector<QuadratureNode> nodes(n);
    const auto order = static_cast<double>(n);
    for (std::size_t i = 0; i < n; ++i) {
        double x = std::cos(std::numbers::pi * (static_cast<double>(i) + 0.75) / (order + 0.5));
        double slope = 1;
        for (int step = 0; step < 8; ++step) {
            double last = 1;
            double value = x;
            for (std::size_t k = 2; k <= n; ++k) {
                const auto degree = static_cast<double>(k);
                const double next = ((2 * degree - 1) * x * value - (degree - 1) * last) / degree;
                last = value;
                value = next;
            }
            slope = order * (x * value - last) / (x * x - 1);
            x -= value / slope;
        }
        nodes[i] = {0.5 * (1 - x), 1 / ((1 - x * x) * slope * slope)};
    }
    return nodes;
}

}  // namespace pellucid
