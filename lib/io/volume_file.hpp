// Sampled volumes from .nrrd, .nhdr (teem) and .nii, .nii.gz (libnifti).
#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <vector>

#include "core/vec.hpp"

namespace pellucid {

/// Samples at the points of a regular grid, x fastest. The volume fills the hull of its sample
/// points; nothing is extrapolated.
struct VoxelGrid {
    std::array<int, 3> size{};  // samples along each axis, >= 1
    std::vector<float> values;  // size[0]·size[1]·size[2], after scl_slope/scl_inter
    Affine index_to_world;      // sample (i, j, k) stands at index_to_world.point({i, j, k})

    [[nodiscard]] float at(int i, int j, int k) const { return values[index(i, j, k)]; }
    /// Where that sample stands in `values`.
    [[nodiscard]] std::size_t index(int i, int j, int k) const {
        const auto wide = [](int n) { return static_cast<std::size_t>(n); };
        return wide(i) + wide(size[0]) * (wide(j) + wide(size[1]) * wide(k));
    }
};

/// Reads a volume and its placement: world = RAS millimetres where the file says so (NIfTI sform
/// if its code > 0, else qform; NRRD left-posterior-superior is flipped to right-anterior), else
/// spacing with the first sample at the origin.
/// Throws Error(input), one line that names the file, where it is not there, cut short, damaged,
/// of an unknown type, not three-dimensional, larger than memory, or its placement is singular,
/// zero, NaN or infinite. NaN and infinite samples are kept and counted in a warning.
[[nodiscard]] VoxelGrid read_volume(const std::filesystem::path& file);

}  // namespace pellucid
