// Scattered points with normals out of volumes: what a scanner would give of a surface in them.
#pragma once

#include <vector>

#include "io/points_file.hpp"
#include "io/volume_file.hpp"

namespace pellucid {

/// A point on every edge of the grid whose ends lie on both sides of the isovalue, where the values along the edge are
/// linear; normals towards smaller values, by central differences. World. None beside samples that are not numbers.
[[nodiscard]] std::vector<OrientedPoint> isosurface_points(const VoxelGrid& grid, double isovalue);

/// By a Gaussian; what lies beyond the border is 0.
///   sigma  in samples, >= 0
[[nodiscard]] VoxelGrid blurred(VoxelGrid grid, double sigma);

/// 1 where the sample is `label`, else 0, blurred: its isosurface at ½ is the label's smooth border.
///   sigma  in samples, >= 0
[[nodiscard]] VoxelGrid label_mask(const VoxelGrid& labels, float label, double sigma);

}  // namespace pellucid
