// What the scenes of fused_scenes need beside the volumes of Debian's mricron-data: points, a dose, a needle.
#pragma once

#include <filesystem>
#include <string>

namespace pellucid {

/// Writes the inputs of scenes/fused/NAME.toml into `folder`. `templates`: mricron's, with ch2, ch2bet and aal.
/// Throws Error(input) where a volume is not there, Error(run) where a file cannot be written.
void write_fused_inputs(const std::string& name, const std::filesystem::path& templates, const std::filesystem::path& folder);

}  // namespace pellucid
