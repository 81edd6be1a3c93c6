// The polygon stage on the CPU: peeled by tiles, a pixel composed as soon as its fragments are told.
#pragma once

#include "stage/surface_drawer.hpp"

namespace pellucid {

/// Scene and meshes must outlive it.
[[nodiscard]] std::unique_ptr<SurfaceDrawer> make_surface_drawer(const PreparedScene& scene, const SceneMeshes& meshes);

}  // namespace pellucid
