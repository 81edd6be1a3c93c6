// The layers that all sub-rays of a pixel met, as one medium: what particle rendering converges to there. Each layer
// has 1/n of its optical depth, and emission and absorption are those of all together, by depth.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/vec.hpp"

namespace pellucid {

/// Independent sets of sub-rays a pixel: their spread is the error.
inline constexpr int kPoolSets = 4;

struct PooledLayer {
    double begin, end;     // depth; equal for a crossing
    double optical_depth;  // evenly between them
    Vec3 color;            // straight
    int set;               // 0 … kPoolSets − 1
};

/// R, G, B (associated) and A.
struct PooledColors {
    std::array<double, 4> all{};
    std::array<double, 4> square{};  // the same of the squares of colours, and A
    std::array<std::array<double, 4>, kPoolSets> without{};  // one of the sets each
};

/// By depth, one after the other: crossings. Layers are put at `begin`; at one depth they keep their order.
///   rays_per_set  sub-rays
///   opaque        behind this transmittance nothing is seen
[[nodiscard]] PooledColors composite_sorted(std::vector<PooledLayer>& layers, int rays_per_set, double opaque);

/// Room that composite_spread uses again.
struct LayerTree {
    std::vector<std::uint32_t> indices;
};
/// With depth: layers overlap. Depth is cut where order matters: until two halves of a part, T·½·τ₀τ₁ (c₀ − c₁) apart
/// from one layer of both (T: transmittance in front), say that they themselves err by a share of `error`, and where
/// colours differ by Δ never thicker than √T·Δ·τ = 0.05.
[[nodiscard]] PooledColors composite_spread(const std::vector<PooledLayer>& layers, int rays_per_set, double opaque,
                                            double error, LayerTree& tree);

}  // namespace pellucid
