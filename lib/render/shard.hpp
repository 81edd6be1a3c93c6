// Rendering in shards: the repeats of one image drawn in parts, anywhere and in any order, which add up to
// the same bytes as one run. A repeat depends on the seed and its own number only, and the sums are integers.
//
// A shard's file is an OpenEXR image of its own repeats, for any viewer, and holds beside it
//   uint channels  shard.{R,G,B}[2].{low,high}, shard.covered, shard.depth: the exact sums (2: of squares)
//   attributes     those of the image, and shard.*: which part of what; a checksum of all that a merge uses
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <span>
#include <string>

#include "stage/ensemble.hpp"

namespace pellucid {

/// Repeats first, …, end − 1.
struct RepeatRange {
    std::uint32_t first;
    std::uint32_t end;
};

/// Part `index` (from 0) of `count`.
struct ShardPart {
    std::uint32_t index = 0;
    std::uint32_t count = 1;

    /// [floor(repeats·index/count), floor(repeats·(index + 1)/count)).
    /// Throws Error(input) where count > repeats.
    [[nodiscard]] RepeatRange repeats_of(std::uint32_t repeats) const;
    /// "index/count"
    [[nodiscard]] std::string text() const;
};

/// Reads "i/n" with 0 <= i < n; empty for anything else.
[[nodiscard]] std::optional<ShardPart> parse_shard_part(const std::string& text);

/// What one part of the repeats came to.
struct Shard {
    ShardPart part;
    std::uint32_t all_repeats = 0;  // of the whole image
    ParticleFrame frame{0, 0};
    EnsembleSums sums{0, 1};
};

/// A number for what is drawn: the scene file and the files it names, byte for byte, and the crop. The data
/// file beside a detached header (.nhdr) is left out.
[[nodiscard]] std::uint64_t digest_of_input(const Scene& scene, const std::filesystem::path& scene_file,
                                            const PixelRect& crop);

/// The shard's own image with its sums. Throws as write_exr does.
void write_shard(Image image, const Shard& shard, std::uint64_t input_digest,
                 const std::filesystem::path& file);

/// A shard's file without its pixels.
struct ShardHeader {
    std::filesystem::path file{};
    int width = 0;
    int height = 0;
    ShardPart part{};
    std::uint32_t all_repeats = 0;
    ParticleFrame frame{0, 0};
    double units = 0;
    std::uint64_t particles = 0;
    std::map<std::string, std::string> attributes{};
};

/// Throws Error(input), one line that names the file: where it is not the file of a shard.
[[nodiscard]] ShardHeader read_shard_header(const std::filesystem::path& file);

/// The sums of the shard that has this header.
/// Throws Error(input) where the file is damaged, or another one by now.
[[nodiscard]] EnsembleSums read_shard_sums(const ShardHeader& header);

/// The image that one run would have drawn, with its attributes; `device` is that of the shards, where they
/// differ joined by " + " in alphabetical order. Holds the sums of the image and of one shard at a time.
/// Throws Error(input) where the files, in any order, are not all the shards of one image, each once.
[[nodiscard]] Image merge_shards(std::span<const std::filesystem::path> files);

}  // namespace pellucid
