#include "core/order_weights.hpp"

#include <algorithm>
#include <array>

#include "core/gauss_legendre.hpp"

namespace pellucid {
namespace {

/// A rule of n nodes integrates polynomials of degree 2n − 1.
constexpr std::size_t kMostNodes = 16;

[[nodiscard]] const std::vector<QuadratureNode>& rule_of(std::size_t nodes) {
    static const std::array<std::vector<QuadratureNode>, kMostNodes + 1> rules = [] {
        std::array<std::vector<QuadratureNode>, kMostNodes + 1> all;
        for (std::size_t n = 1; n <= kMostNodes; ++n) all[n] = gauss_legendre(n);
        return all;
    }();
    return rules[nodes];
}

void add_panel(std::span<const double> opacities, double lo, double hi, std::size_t nodes, std::vector<double>& weights) {
    for (const QuadratureNode& node : rule_of(nodes)) {
        const double u = lo + (hi - lo) * node.at;
        double product = (hi - lo) * node.weight;
        for (const double a : opacities) product *= 1 - u * a;
        for (std::size_t i = 0; i < opacities.size(); ++i) weights[i] += product / (1 - u * opacities[i]);
    }
}

}  // namespace

void weigh_all_orders(std::span<const double> opacities, std::vector<double>& weights) {
    weights.assign(opacities.size(), 0);
    const std::size_t nodes = (opacities.size() + 1) / 2;
    if (nodes <= kMostNodes) return add_panel(opacities, 0, 1, std::max<std::size_t>(nodes, 1), weights);
    // The product falls like e^(−uΣα): panels from there on twice as long each.
    double sum = 0;
    for (const double a : opacities) sum += a;
    double lo = 0;
    for (double hi = std::min(1.0, 1 / std::max(sum, 1.0)); lo < 1; hi = std::min(1.0, 2 * hi)) {
        add_panel(opacities, lo, hi, kMostNodes, weights);
        lo = hi;
    }
}

}  // namespace pellucid
