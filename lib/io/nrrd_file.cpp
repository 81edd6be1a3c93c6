#include "io/nrrd_file.hpp"

#include <bit>
#include <cctype>
#include <cmath>
#include <memory>
#include <mutex>
#include <optional>

#include <teem/biff.h>
#include <teem/nrrd.h>

#include "core/error.hpp"
#include "io/input_file.hpp"

namespace pellucid {
namespace {

struct FreeNrrd {
    void operator()(Nrrd* nrrd) const { nrrdNuke(nrrd); }
    void operator()(NrrdIoState* io) const { nrrdIoStateNix(io); }
};

// teem stacks its messages, the innermost last, each led by "[nrrd] function: ".
std::string last_complaint() {
    const std::unique_ptr<char, decltype(&std::free)> all(biffGetDone(NRRD), &std::free);
    std::string text = all ? all.get() : "";
    while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back())) != 0) text.pop_back();
    text.erase(0, text.rfind('\n') + 1);
    const std::size_t lead = text.find("] ");
    const std::size_t name_end = text.find(": ", lead == std::string::npos ? 0 : lead);
    return one_line(name_end == std::string::npos ? text : text.substr(name_end + 2));
}

// The lines up to the first empty one; where that ends is where attached data begin.
struct HeaderText {
    std::uint64_t bytes = 0;
    std::optional<std::filesystem::path> data_file;
};

HeaderText scan_header(const std::filesystem::path& file) {
    constexpr std::uint64_t kLongestHeader = std::uint64_t{1} << 24;
    const std::string text = read_input_file(file, kLongestHeader);
    if (!text.starts_with("NRRD0"))
        throw input_error("{}: not a NRRD file: does not begin with \"NRRD0\"", file.string());
    HeaderText header;
    for (std::size_t begin = 0; begin < text.size();) {
        const std::size_t end = std::min(text.find('\n', begin), text.size());
        std::string_view line = std::string_view(text).substr(begin, end - begin);
        begin = end + 1;
        header.bytes = std::min(begin, text.size());
        if (line.ends_with('\r')) line.remove_suffix(1);
        if (line.empty()) return header;
        for (const std::string_view key : {"data file:", "datafile:"}) {
            if (!line.starts_with(key)) continue;
            line.remove_prefix(key.size());
            while (line.starts_with(' ') || line.starts_with('\t')) line.remove_prefix(1);
            while (line.ends_with(' ') || line.ends_with('\t')) line.remove_suffix(1);
            header.data_file = line;
        }
    }
    if (!header.data_file)
        throw input_error("{}: is cut short: the header has no end and no data file", file.string());
    return header;
}

SampleType sample_type(const std::filesystem::path& file, int type) {
    switch (type) {
        case nrrdTypeChar:
            return SampleType::int8;
        case nrrdTypeUChar:
            return SampleType::uint8;
        case nrrdTypeShort:
            return SampleType::int16;
        case nrrdTypeUShort:
            return SampleType::uint16;
        case nrrdTypeInt:
            return SampleType::int32;
        case nrrdTypeUInt:
            return SampleType::uint32;
        case nrrdTypeLLong:
            return SampleType::int64;
        case nrrdTypeULLong:
            return SampleType::uint64;
        case nrrdTypeFloat:
            return SampleType::float32;
        case nrrdTypeDouble:
            return SampleType::float64;
        default:
            throw input_error("{}: type {}, expected an integer or floating type", file.string(),
                              airEnumStr(nrrdType, type));
    }
}

std::array<std::uint64_t, 3> grid_size(const std::filesystem::path& file, const Nrrd& nrrd) {
    bool three = nrrd.dim >= 3;
    for (unsigned axis = 3; axis < nrrd.dim; ++axis) three = three && nrrd.axis[axis].size == 1;
    if (!three) throw input_error("{}: is not three-dimensional: {} axes", file.string(), nrrd.dim);
    std::array<std::uint64_t, 3> size{};
    for (unsigned axis = 0; axis < 3; ++axis) {
        const int kind = nrrd.axis[axis].kind;
        if (kind != nrrdKindUnknown && kind != nrrdKindDomain && kind != nrrdKindSpace)
            throw input_error("{}: is not three-dimensional: axis {} is of kind {}, expected domain or space",
                              file.string(), axis, airEnumStr(nrrdKind, kind));
        size[axis] = nrrd.axis[axis].size;
        if (size[axis] == 0)
            throw input_error("{}: axis {} has 0 samples, expected >= 1", file.string(), axis);
    }
    return size;
}

Affine placement(const std::filesystem::path& file, const Nrrd& nrrd, const NrrdIoState& io) {
    const bool in_space = nrrd.spaceDim > 0;
    if (in_space && nrrd.spaceDim != 3)
        throw input_error("{}: space has {} dimensions, expected 3", file.string(), nrrd.spaceDim);
    Affine place;
    for (unsigned axis = 0; axis < 3; ++axis) {
        const NrrdAxisInfo& info = nrrd.axis[axis];
        const int column = static_cast<int>(axis);
        if (io.seen[nrrdField_space_directions] != 0) {
            for (int i = 0; i < 3; ++i) place.linear[column][i] = info.spaceDirection[i];
        } else if (io.seen[nrrdField_spacings] != 0) {
            if (!(info.spacing > 0) || !std::isfinite(info.spacing))
                throw input_error("{}: spacing of axis {} is {}, expected > 0", file.string(), axis,
                                  info.spacing);
            place.linear[column][column] = info.spacing;
        }
    }
    if (!in_space) return place;
    if (io.seen[nrrdField_space_origin] != 0)
        for (int i = 0; i < 3; ++i) place.offset[i] = nrrd.spaceOrigin[i];
    const bool left =
        nrrd.space == nrrdSpaceLeftPosteriorSuperior || nrrd.space == nrrdSpaceLeftAnteriorSuperior;
    const bool posterior = nrrd.space == nrrdSpaceLeftPosteriorSuperior;
    Affine to_ras;
    to_ras.linear[0][0] = left ? -1.0 : 1.0;
    to_ras.linear[1][1] = posterior ? -1.0 : 1.0;
    return compose(to_ras, place);
}

// Bytes of the file up to the end of the first `lines` lines after `begin`.
std::uint64_t after_lines(const std::filesystem::path& file, std::uint64_t begin, unsigned lines) {
    if (lines == 0) return begin;
    const std::string bytes = read_input_file(file);
    for (unsigned i = 0; i < lines; ++i) {
        begin = bytes.find('\n', begin);
        if (begin == std::string::npos)
            throw input_error("{}: is cut short: line skip: {}, and the file has fewer lines", file.string(),
                              lines);
        ++begin;
    }
    return begin;
}

SampleSource sample_source(const std::filesystem::path& file, const HeaderText& header, const Nrrd& nrrd,
                           const NrrdIoState& io, std::uint64_t count) {
    SampleSource source;
    source.file = header.data_file ? *header.data_file : file;
    source.type = sample_type(file, nrrd.type);
    if (io.encoding == nrrdEncodingRaw)
        source.encoding = SampleEncoding::raw;
    else if (io.encoding == nrrdEncodingGzip)
        source.encoding = SampleEncoding::gzip;
    else if (io.encoding == nrrdEncodingAscii)
        source.encoding = SampleEncoding::text;
    else
        throw input_error("{}: encoding {}, expected raw, gzip or ascii", file.string(), io.encoding->name);
    if (source.encoding != SampleEncoding::text && bytes_of(source.type) > 1) {
        if (io.endian != airEndianLittle && io.endian != airEndianBig)
            throw input_error("{}: has no endian, expected little or big", file.string());
        source.swapped = (io.endian == airEndianLittle) != (std::endian::native == std::endian::little);
    }

    source.begin = after_lines(source.file, header.data_file ? 0 : header.bytes, io.lineSkip);
    if (io.byteSkip >= 0) {
        // of the decompressed data, so for raw data of the file itself
        (source.encoding == SampleEncoding::raw ? source.begin : source.skip) +=
            static_cast<std::uint64_t>(io.byteSkip);
    } else {
        // −1: the samples are the last bytes of the file
        const std::uint64_t there = input_file_size(source.file) - source.begin;
        if (io.byteSkip != -1 || source.encoding != SampleEncoding::raw)
            throw input_error("{}: byte skip = {}, expected >= 0, or -1 and raw data", file.string(),
                              io.byteSkip);
        if (count <= there / bytes_of(source.type)) source.begin += there - count * bytes_of(source.type);
    }
    return source;
}

}  // namespace

VoxelHeader read_nrrd_header(const std::filesystem::path& file) {
    HeaderText header = scan_header(file);
    if (header.data_file) {
        if (header.data_file->is_relative()) header.data_file = file.parent_path() / *header.data_file;
        std::error_code ignored;
        if (!std::filesystem::exists(*header.data_file, ignored))
            throw input_error("{}: no data file {} (lists of several files are not read)", file.string(),
                              one_line(header.data_file->string()));
        (void)input_file_size(*header.data_file);  // teem would open a pipe and wait
    }

    static std::mutex one_at_a_time;  // teem keeps its messages in one global list
    const std::lock_guard lock(one_at_a_time);
    nrrdStateVerboseIO = 0;
    const std::unique_ptr<Nrrd, FreeNrrd> nrrd(nrrdNew());
    const std::unique_ptr<NrrdIoState, FreeNrrd> io(nrrdIoStateNew());
    if (!nrrd || !io) throw run_error("{}: teem has no memory", file.string());
    io->skipData = 1;
    if (nrrdLoad(nrrd.get(), file.c_str(), io.get()) != 0)
        throw input_error("{}: not a readable NRRD header: {}", file.string(), last_complaint());
    if (header.data_file && (io->dataFNFormat != nullptr || io->dataFNArr->len != 1))
        throw input_error("{}: samples in several files, expected one data file", file.string());

    VoxelHeader result;
    result.size = grid_size(file, *nrrd);
    result.index_to_world = placement(file, *nrrd, *io);
    result.samples = sample_source(file, header, *nrrd, *io, voxel_count(file, result.size));
    return result;
}

}  // namespace pellucid
