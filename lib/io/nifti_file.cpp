#include "io/nifti_file.hpp"

#include <cmath>
#include <cstring>
#include <string_view>

#include <nifti1_io.h>

#include "core/error.hpp"
#include "io/input_file.hpp"

namespace pellucid {
namespace {

// The header is checked here, field by field, and libnifti does what needs no trust (byte order,
// quaternions): its own reader mends bad sizes and spacings silently, and prints.
nifti_1_header read_header(const std::filesystem::path& file, bool& swapped) {
    const std::string bytes = read_decompressed(file, sizeof(nifti_1_header));
    nifti_1_header header{};
    if (bytes.size() < sizeof header)
        throw input_error("{}: is cut short: {} of the {} bytes of a NIfTI header are there", file.string(),
                          bytes.size(), sizeof header);
    std::memcpy(&header, bytes.data(), sizeof header);
    int header_size = header.sizeof_hdr;
    nifti_swap_4bytes(1, &header_size);
    swapped = header.sizeof_hdr != sizeof header && header_size == sizeof header;
    constexpr int kNifti2Size = 540;
    if (header.sizeof_hdr == kNifti2Size || header_size == kNifti2Size)
        throw input_error("{}: is NIfTI-2, expected NIfTI-1", file.string());
    if (header.sizeof_hdr != sizeof header && !swapped)
        throw input_error("{}: not a NIfTI file: its first number is {}, expected {}", file.string(),
                          header.sizeof_hdr, sizeof header);
    if (std::string_view(header.magic, 3) == "ni1")
        throw input_error("{}: header of a .hdr/.img pair, expected one file (.nii)", file.string());
    if (std::string_view(header.magic, 4) != std::string_view("n+1\0", 4))
        throw input_error("{}: not a NIfTI-1 file: magic is not \"n+1\"", file.string());
    if (swapped) swap_nifti_header(&header, 1);
    return header;
}

std::array<std::uint64_t, 3> grid_size(const std::filesystem::path& file, const nifti_1_header& header) {
    const int axes = header.dim[0];
    bool three = axes >= 3 && axes <= 7;
    for (int axis = 4; three && axis <= axes; ++axis) three = header.dim[axis] == 1;
    if (!three) throw input_error("{}: is not three-dimensional: {} axes", file.string(), axes);
    std::array<std::uint64_t, 3> size{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const int n = header.dim[axis + 1];
        if (n < 1) throw input_error("{}: dim[{}] = {}, expected >= 1", file.string(), axis + 1, n);
        size[axis] = static_cast<std::uint64_t>(n);
    }
    return size;
}

SampleType sample_type(const std::filesystem::path& file, int type) {
    switch (type) {
        case NIFTI_TYPE_INT8:
            return SampleType::int8;
        case NIFTI_TYPE_UINT8:
            return SampleType::uint8;
        case NIFTI_TYPE_INT16:
            return SampleType::int16;
        case NIFTI_TYPE_UINT16:
            return SampleType::uint16;
        case NIFTI_TYPE_INT32:
            return SampleType::int32;
        case NIFTI_TYPE_UINT32:
            return SampleType::uint32;
        case NIFTI_TYPE_INT64:
            return SampleType::int64;
        case NIFTI_TYPE_UINT64:
            return SampleType::uint64;
        case NIFTI_TYPE_FLOAT32:
            return SampleType::float32;
        case NIFTI_TYPE_FLOAT64:
            return SampleType::float64;
        default:
            throw input_error("{}: datatype {} ({}), expected an integer or a float of up to 8 bytes",
                              file.string(), type, nifti_datatype_string(type));
    }
}

double millimetres(const nifti_1_header& header) {
    switch (XYZT_TO_SPACE(header.xyzt_units)) {
        case NIFTI_UNITS_METER:
            return 1000.0;
        case NIFTI_UNITS_MICRON:
            return 0.001;
        default:
            return 1.0;
    }
}

bool spacing_is_sane(const nifti_1_header& header, int axis) {
    return header.pixdim[axis] > 0 && std::isfinite(header.pixdim[axis]);
}

Affine sform(const std::filesystem::path& file, const nifti_1_header& header) {
    // pixdim is not used then, but a writer that got it wrong may have got more wrong
    for (int axis = 1; axis <= 3; ++axis)
        if (!spacing_is_sane(header, axis))
            warn("{}: pixdim[{}] = {}, expected > 0; the sform is used", file.string(), axis,
                 header.pixdim[axis]);
    Affine place;
    const float* rows[3] = {header.srow_x, header.srow_y, header.srow_z};
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column)
            place.linear[column][row] = static_cast<double>(rows[row][column]);
        place.offset[row] = static_cast<double>(rows[row][3]);
    }
    return place;
}

Affine placement(const std::filesystem::path& file, const nifti_1_header& header) {
    Affine place;
    if (header.sform_code > 0) {
        place = sform(file, header);
    } else {
        for (int axis = 1; axis <= 3; ++axis)
            if (!spacing_is_sane(header, axis))
                throw input_error("{}: spacing pixdim[{}] = {}, expected > 0", file.string(), axis,
                                  header.pixdim[axis]);
        if (header.qform_code > 0) {
            const float handedness = header.pixdim[0] < 0 ? -1.0F : 1.0F;
            const mat44 m = nifti_quatern_to_mat44(
                header.quatern_b, header.quatern_c, header.quatern_d, header.qoffset_x, header.qoffset_y,
                header.qoffset_z, header.pixdim[1], header.pixdim[2], header.pixdim[3], handedness);
            for (int row = 0; row < 3; ++row) {
                for (int column = 0; column < 3; ++column)
                    place.linear[column][row] = static_cast<double>(m.m[row][column]);
                place.offset[row] = static_cast<double>(m.m[row][3]);
            }
        } else {
            for (int axis = 0; axis < 3; ++axis)
                place.linear[axis][axis] = static_cast<double>(header.pixdim[axis + 1]);
        }
    }
    const double scale = millimetres(header);
    place.linear *= scale;
    place.offset *= scale;
    return place;
}

}  // namespace

VoxelHeader read_nifti_header(const std::filesystem::path& file) {
    VoxelHeader result;
    const nifti_1_header header = read_header(file, result.samples.swapped);
    result.size = grid_size(file, header);
    result.index_to_world = placement(file, header);

    SampleSource& samples = result.samples;
    samples.file = file;
    samples.type = sample_type(file, header.datatype);
    // 2^62 is more than any file has, and below the end of the integers
    if (!(header.vox_offset >= 0) || header.vox_offset > 0x1p62F)
        throw input_error("{}: vox_offset = {}, expected >= {}", file.string(), header.vox_offset,
                          sizeof header);
    const std::uint64_t offset =
        std::max<std::uint64_t>(static_cast<std::uint64_t>(header.vox_offset), sizeof header);
    samples.encoding = is_gzip(file) ? SampleEncoding::gzip : SampleEncoding::raw;
    (samples.encoding == SampleEncoding::gzip ? samples.skip : samples.begin) = offset;

    const bool scaled = header.scl_slope != 0 && std::isfinite(header.scl_slope);
    if (scaled && !std::isfinite(header.scl_inter))
        throw input_error("{}: scl_inter = {}, expected a finite number", file.string(), header.scl_inter);
    if (scaled) samples.slope = static_cast<double>(header.scl_slope);
    if (scaled) samples.intercept = static_cast<double>(header.scl_inter);
    return result;
}

}  // namespace pellucid
