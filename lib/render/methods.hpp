// The makers of all methods: one function each, called by method.cpp.
#pragma once

#include "render/method.hpp"

namespace pellucid {

[[nodiscard]] Method mdvr_method();
[[nodiscard]] Method particles_method();
[[nodiscard]] Method reference_method();
[[nodiscard]] Method slabs_method();
[[nodiscard]] Method z_test_method();
[[nodiscard]] Method depth_peeling_method();
[[nodiscard]] Method alpha_blend_method();

/// The refusal shared by methods that draw every surface with a geometry, and volumes.
[[nodiscard]] std::optional<std::string> refusal_of_ray_and_particle_methods(const Scene& scene);

/// Warns where what methods with depths in float32 draw is so far away that they do not tell its parts apart.
void warn_of_rough_depths(const PreparedScene& scene);

/// The surfaces that it lets pass, by their keys in a scene: for summaries.
inline constexpr std::string_view kEveryShape = "implicit, expression, isosurface, mesh, points, rectangle, slice";

}  // namespace pellucid
