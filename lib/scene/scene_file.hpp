// Scene files (TOML) to scenes: every key, default and refusal of the format.
//
// Lengths in scene units, angles in degrees, colours linear 0…1. What can be judged without opening
// another file is judged here; data files, expressions and the names of implicit surfaces are judged
// by their readers.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "io/config.hpp"
#include "scene/scene.hpp"

namespace pellucid {

/// Reads a scene file, `overrides` ("camera.position=[0,0,3]") laid over it. Throws Error(input):
/// one line that names file and line (or the override), object, key, value and expectation.
[[nodiscard]] Scene load_scene(const std::filesystem::path& file,
                               std::span<const std::string> overrides = {});

/// The scene of an open document. Keys beside image, camera, light, surface and volume are left to
/// the caller, who must call `config.finish()` when all is read.
[[nodiscard]] Scene scene_from_config(const Config& config);

/// True where a `--set key.path=value` is about the scene: its first part is image, camera, light,
/// surface or volume.
[[nodiscard]] bool is_scene_override(std::string_view assignment);

}  // namespace pellucid
