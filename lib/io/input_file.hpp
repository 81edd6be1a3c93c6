// What every reader asks of a file before it trusts a byte of it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace pellucid {

/// deflate cannot do better than this (zlib's technical notes: 1032 : 1), so what a header claims
/// can be held against the size of the file before anything is allocated.
inline constexpr std::uint64_t kMostInflation = 1032;

/// Bytes of a regular file. Throws Error(input) where there is none: a directory, pipe or device
/// would hang or never end.
[[nodiscard]] std::uint64_t input_file_size(const std::filesystem::path& file);

/// The first `most_bytes` of a file, or all of it. Throws Error(input).
[[nodiscard]] std::string read_input_file(const std::filesystem::path& file,
                                          std::uint64_t most_bytes = UINT64_MAX);

/// Bytes that can be had without swapping; a header that asks for more is refused.
[[nodiscard]] std::uint64_t available_memory();

/// ".nii.gz", ".ply", … in lower case; empty where the name has none.
[[nodiscard]] std::string lower_extension(const std::filesystem::path& file);

}  // namespace pellucid
