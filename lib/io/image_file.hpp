// Images to and from OpenEXR (float32, linear) and PNG (8 bit, sRGB).
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <span>
#include <string>

#include "core/image.hpp"
#include "core/vec.hpp"

namespace pellucid {

/// A plane of 32-bit words, row by row, somewhere in memory: `first` is the first pixel's, the others follow
/// `stride` bytes apart.
template <class Word>
struct WordPlaneOf {
    std::string name;
    Word* first;
    std::size_t stride;
};
using WordPlane = WordPlaneOf<const std::uint32_t>;
using WordTarget = WordPlaneOf<std::uint32_t>;

/// All planes as float32 channels, `words` as uint ones, all attributes as strings of the header. The file
/// appears whole or not at all (written aside, then renamed). Throws Error(run) where it cannot be written.
void write_exr(const Image& image, const std::filesystem::path& file, std::span<const WordPlane> words = {});

/// All channels (half and uint become float) and all string attributes. Multi-part and tiled files
/// are read where they hold one flat image; sub-sampled channels are refused. Data window = image.
/// Throws Error(input), one line that names the file.
[[nodiscard]] Image read_exr(const std::filesystem::path& file);

struct ExrHeader {
    int width = 0;
    int height = 0;
    std::map<std::string, std::string> attributes;  // those that are strings
};
/// What read_exr would return, without the planes; refuses what it would refuse but for damaged pixels.
[[nodiscard]] ExrHeader read_exr_header(const std::filesystem::path& file);

/// The uint channels that the targets name. Throws Error(input) where the file is not width × height, or has
/// no such channel, or of another type.
void read_exr_words(const std::filesystem::path& file, int width, int height,
                    std::span<const WordTarget> targets);

/// R, G, B (associated) + (1 − A)·background, clamped to [0, 1], sRGB encoded, 8 bit.
/// Precondition: planes R, G, B; A is taken as 1 where there is none.
void write_png(const Image& image, const Vec3& background, const std::filesystem::path& file);

/// Planes R, G, B, A of a grey, palette or RGB(A) PNG of any depth: colours decoded to linear,
/// straight (not associated); A = 1 where the file has none. Throws Error(input).
[[nodiscard]] Image read_png(const std::filesystem::path& file);

}  // namespace pellucid
