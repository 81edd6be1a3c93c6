// What is left of each of several colours at one depth, in the mean over all orders in which they may lie.
#pragma once

#include <span>
#include <vector>

namespace pellucid {

/// Of opacities α: ∫₀¹ Π_{j≠i}(1 − uα_j) du for each i, in a random order the share of what comes from i that the others let
/// through: i has each other one in front of it with the chance u that is its own place. Of two it is 1 − α_j/2, zSlab
/// (4.4). Σ α_i w_i = 1 − Π(1 − α_i). Every factor of the quadrature lies in (0, 1], so no digits are lost for any number:
/// exact up to 32, else to 1e-14.
void weigh_all_orders(std::span<const double> opacities, std::vector<double>& weights);

}  // namespace pellucid
