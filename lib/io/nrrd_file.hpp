// Headers of NRRD volumes, attached (.nrrd) or detached (.nhdr), by teem.
#pragma once

#include <filesystem>

#include "io/voxel_stream.hpp"

namespace pellucid {

/// Raw, gzip and ascii encodings, every scalar type, one data file. Placement in RAS: the named
/// spaces left-posterior-superior and left-anterior-superior are flipped, any other keeps its axes;
/// an axis without direction takes its spacing, 1 where there is none. Lengths are not converted.
/// Throws Error(input), one line that names the file.
[[nodiscard]] VoxelHeader read_nrrd_header(const std::filesystem::path& file);

}  // namespace pellucid
