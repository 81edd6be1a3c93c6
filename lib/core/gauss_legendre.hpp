// Gauss-Legendre quadrature on [0, 1].
#pragma once

#include <cstddef>
#include <vector>

namespace pellucid {

struct QuadratureNode {
    double at;
    double weight;
};

/// With n nodes, >= 1: exact to degree 2n − 1. Newton's method on P_n from the Chebyshev nodes, as in any textbook
/// (Press et al., Numerical Recipes, section 4.5).
[[nodiscard]] std::vector<QuadratureNode> gauss_legendre(std::size_t n);

}  // namespace pellucid
