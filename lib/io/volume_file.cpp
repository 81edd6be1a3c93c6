#include "io/volume_file.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "io/input_file.hpp"
#include "io/nifti_file.hpp"
#include "io/nrrd_file.hpp"

namespace pellucid {
namespace {

void check_placement(const std::filesystem::path& file, const Affine& place) {
    // Axes less than 1e-9 out of one plane: rounding decides on which side a sample is.
    constexpr double kFlattest = 1e-9;
    double edges = 1.0;
    for (int axis = 0; axis < 3; ++axis) {
        const Vec3 step = place.linear[axis];
        const double step_length = length(step);
        if (!std::isfinite(step_length) || !std::isfinite(place.offset[axis]))
            throw input_error("{}: placement has a NaN or infinite number", file.string());
        if (step_length == 0)
            throw input_error("{}: spacing of axis {} is 0, expected > 0", file.string(), axis);
        edges *= step_length;
    }
    if (!(std::abs(place.determinant()) > kFlattest * edges) || !std::isfinite(edges))
        throw input_error("{}: placement is singular: its three axes lie in one plane", file.string());
}

}  // namespace

VoxelGrid read_volume(const std::filesystem::path& file) {
    const std::string extension = lower_extension(file);
    const bool nrrd = extension == ".nrrd" || extension == ".nhdr";
    if (!nrrd && extension != ".nii" && extension != ".nii.gz")
        throw input_error("{}: unknown kind of volume \"{}\", expected .nrrd, .nhdr, .nii or .nii.gz",
                          file.string(), extension);
    const VoxelHeader header = nrrd ? read_nrrd_header(file) : read_nifti_header(file);
    check_placement(file, header.index_to_world);

    VoxelGrid grid;
    grid.index_to_world = header.index_to_world;
    const std::uint64_t count = voxel_count(file, header.size);
    std::transform(header.size.begin(), header.size.end(), grid.size.begin(),
                   [](std::uint64_t n) { return static_cast<int>(n); });
    grid.values = read_samples(header.samples, count);
    const auto bad =
        std::count_if(grid.values.begin(), grid.values.end(), [](float v) { return !std::isfinite(v); });
    if (bad > 0) warn("{}: {} of {} samples are NaN or infinite", file.string(), bad, count);
    return grid;
}

}  // namespace pellucid
