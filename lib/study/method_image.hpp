// A picture by any method, as an experiment asks for it: by names and settings, as on the command line.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "core/image.hpp"
#include "render/method.hpp"

namespace pellucid {

struct MethodChoice {
    std::string method;                 // "slabs"
    std::vector<std::string> settings;  // "slabs.layers=8": as after --set
};

/// Draws it. Throws Error(input) for an unknown method or setting, and where the method refuses the scene.
[[nodiscard]] Image method_image(const PreparedScene& scene, const MethodChoice& choice, Seed seed, RenderStats& stats,
                                 const Backend& backend = Backend::cpu());

}  // namespace pellucid
