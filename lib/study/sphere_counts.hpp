// Points of a surface inside spheres, and what geometry says of them.
#pragma once

#include <cstdint>
#include <vector>

#include "core/random.hpp"
#include "measure/statistics.hpp"
#include "sample/uniform_points.hpp"

namespace pellucid {

/// How many of `points` uniform points of the surface lie in each sphere.
[[nodiscard]] MeanVariance counts_in_spheres(const UniformPoints& surface, std::size_t points, const std::vector<Vec3>& centers,
                                             double radius, Seed seed);

/// What the mean of these counts is worth: one over its relative variance. A point in k spheres counts k times and the number
/// of points is fixed, so that is n E[k]²/(E[k²] − E[k]²). 1 where no point is in any sphere.
[[nodiscard]] double independent_points(const UniformPoints& surface, std::size_t points, const std::vector<Vec3>& centers,
                                        double radius);

/// Area of a cylinder of radius 1 inside a sphere of radius r < 2 around one of its points:
/// ∫ 2 √(r² − 2(1 − cos φ)) dφ over the φ where the root is real.
[[nodiscard]] double cylinder_in_sphere(double r);

}  // namespace pellucid
