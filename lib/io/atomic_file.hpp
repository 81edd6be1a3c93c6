// Files that appear whole or not at all.
#pragma once

#include <filesystem>
#include <functional>
#include <string_view>

namespace pellucid {

/// Has `write` make a temporary beside `target` (same disk, so that the rename is one step), then
/// renames it; what stood there before is kept until then. On failure the temporary is removed and
/// Error(run) names the target; `write` reports its own failures as exceptions.
void write_atomically(const std::filesystem::path& target,
                      const std::function<void(const std::filesystem::path& temporary)>& write);

/// `text` byte for byte, by write_atomically.
void write_text_file(const std::filesystem::path& target, std::string_view text);

}  // namespace pellucid
