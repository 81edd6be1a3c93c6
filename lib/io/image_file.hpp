// Images to and from OpenEXR (float32, linear) and PNG (8 bit, sRGB).
#pragma once

#include <filesystem>

#include "core/image.hpp"
#include "core/vec.hpp"

namespace pellucid {

/// All planes as float32 channels, all attributes as strings of the header. The file appears whole
/// or not at all (written aside, then renamed). Throws Error(run) where it cannot be written.
void write_exr(const Image& image, const std::filesystem::path& file);

/// All channels (half and uint become float) and all string attributes. Multi-part and tiled files
/// are read where they hold one flat image; sub-sampled channels are refused. Data window = image.
/// Throws Error(input), one line that names the file.
[[nodiscard]] Image read_exr(const std::filesystem::path& file);

/// R, G, B (associated) + (1 − A)·background, clamped to [0, 1], sRGB encoded, 8 bit.
/// Precondition: planes R, G, B; A is taken as 1 where there is none.
void write_png(const Image& image, const Vec3& background, const std::filesystem::path& file);

/// Planes R, G, B, A of a grey, palette or RGB(A) PNG of any depth: colours decoded to linear,
/// straight (not associated); A = 1 where the file has none. Throws Error(input).
[[nodiscard]] Image read_png(const std::filesystem::path& file);

}  // namespace pellucid
