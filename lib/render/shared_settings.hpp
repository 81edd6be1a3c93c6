// Settings that several methods read alike.
#pragma once

#include "render/method.hpp"
#include "stage/scene_meshes.hpp"
#include "stage/slab_settings.hpp"

namespace pellucid {

/// tessellate.error_px
[[nodiscard]] TessellationSettings read_tessellation(const RenderInput& input);
/// mixing, of slabs in one place.
[[nodiscard]] SlabMixing read_mixing(const ConfigTable& table, SlabMixing otherwise);

}  // namespace pellucid
