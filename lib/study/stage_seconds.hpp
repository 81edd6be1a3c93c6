// What a stage of a render took, by its name.
#pragma once

#include <string_view>

#include "render/method.hpp"

namespace pellucid {

/// Wall seconds of all stages of that name. Throws Error(run) where there is none: a name was changed.
[[nodiscard]] double stage_seconds(const RenderStats& stats, std::string_view name);

}  // namespace pellucid
