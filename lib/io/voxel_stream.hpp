// Samples from raw, gzip or text data to float. The libraries of the formats read headers here and
// not samples: where a file is cut short or damaged they fill with zeros or only warn.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "core/vec.hpp"

namespace pellucid {

enum class SampleType { int8, uint8, int16, uint16, int32, uint32, int64, uint64, float32, float64 };
enum class SampleEncoding { raw, gzip, text };

/// Where samples are and how they are written.
struct SampleSource {
    std::filesystem::path file;
    SampleEncoding encoding = SampleEncoding::raw;
    std::uint64_t begin = 0;  // bytes of the file before the (compressed) data
    std::uint64_t skip = 0;   // bytes of the decompressed data before the first sample
    SampleType type = SampleType::uint8;
    bool swapped = false;  // bytes of a sample in the other order than this machine's
    double slope = 1.0;    // value = slope·stored + intercept
    double intercept = 0.0;
};

/// What the header of a volume says, with every claim about size still to be checked.
struct VoxelHeader {
    std::array<std::uint64_t, 3> size{};  // >= 1
    Affine index_to_world;
    SampleSource samples;
};

[[nodiscard]] std::uint64_t bytes_of(SampleType type);

/// The product of three sizes, each >= 1. Throws Error(input) where it is beyond 2^62.
[[nodiscard]] std::uint64_t voxel_count(const std::filesystem::path& file,
                                        std::span<const std::uint64_t, 3> size);

/// Exactly `count` samples. Throws Error(input) where the file cannot hold as many, which is found
/// from its size before anything is allocated; where they do not fit in memory; where the data end
/// early, are damaged (gzip: up to the checksum), or are no numbers. Bytes that are left over are
/// told in a warning.
[[nodiscard]] std::vector<float> read_samples(const SampleSource& source, std::uint64_t count);

/// The first bytes of a file that may be compressed with gzip, `most_bytes` or fewer.
[[nodiscard]] std::string read_decompressed(const std::filesystem::path& file, std::uint64_t most_bytes);

/// Whether the file begins as gzip data do.
[[nodiscard]] bool is_gzip(const std::filesystem::path& file);

}  // namespace pellucid
