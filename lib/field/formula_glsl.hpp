// Programs as GLSL, in float.
#pragma once

#include <string>
#include <string_view>

#include "field/program.hpp"

namespace pellucid {

/// A function of `vec3 p` that needs nothing else: one output makes a float, four a vec4, in that order.
[[nodiscard]] std::string glsl_function(const Program& program, std::string_view name);

}  // namespace pellucid
