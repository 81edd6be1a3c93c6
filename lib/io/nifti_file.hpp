// Headers of NIfTI-1 volumes in one file (.nii, .nii.gz), by libnifti.
#pragma once

#include <filesystem>

#include "io/voxel_stream.hpp"

namespace pellucid {

/// Placement: sform if its code > 0, else qform if its code > 0, else pixdim with the first sample
/// at the origin. Metres and microns, where xyzt_units names them, become millimetres; all else is
/// taken as it stands. A scl_slope of 0 (or NaN, as some writers have it) means no scaling.
/// Throws Error(input), one line that names the file.
[[nodiscard]] VoxelHeader read_nifti_header(const std::filesystem::path& file);

}  // namespace pellucid
