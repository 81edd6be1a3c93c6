// Oriented points to a file.
#pragma once

#include <filesystem>
#include <span>

#include "io/points_file.hpp"

namespace pellucid {

/// Binary .ply, float32 x y z nx ny nz, whole or not at all. Throws Error(run) where it cannot be written.
void write_points(std::span<const OrientedPoint> points, const std::filesystem::path& file);

}  // namespace pellucid
