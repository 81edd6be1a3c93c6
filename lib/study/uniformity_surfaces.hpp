// The surfaces of sampling_uniformity by name.
#pragma once

#include <filesystem>
#include <string>

namespace pellucid {

/// Keys of a [[surface]]. "catmull_rom": an isosurface of a volume of 24³ samples, a sum of waves without symmetry, which is
/// written into `folder`. Any other name is one of the catalogue. Throws as the writing of files does.
[[nodiscard]] std::string uniformity_surface(const std::string& name, const std::filesystem::path& folder);

}  // namespace pellucid
