// Depth peeling (zSlab, section 5.2.2, after Everitt 2001): the surfaces of each pixel, nearest first.
//
// A fragment is a triangle in one pixel, where it covers the centre. Fragments are in total order: by depth (float32), then
// by the triangle's number, so that triangles at the same depth are neither lost nor told twice. What a clip plane or the
// bounds cut away, and what has no opacity, is no fragment.
//
// Two ways, the same fragments to the last bit: by passes, each of which draws everything and keeps in each pixel the
// nearest fragment behind the last one kept (the specification); and by tiles, which collect all fragments of their pixels,
// sort them, and shade from front to back until nothing shines through (a fraction of the time).
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "cpu/rasterizer.hpp"
#include "kernel/slab_twin.h"
#include "scene/prepared_scene.hpp"
#include "stage/scene_meshes.hpp"

namespace pellucid {

/// A surface as a virtual slab: its back is where the surface is, its thickness towards the camera that of
/// stage/virtual_slab.hpp, shaded, and as opaque as the surface's law says for its geometric normal.
struct SurfaceFragment {
    twin::Slab slab;
    std::uint32_t object;    // in PreparedScene::objects
    std::uint32_t triangle;  // SceneMeshes
};

struct PeelSettings {
    /// L: most surfaces of a pixel, the nearest; 0: all.
    int layers = 0;
    /// Accumulated opacity at which a pixel is finished; what stands at the depth of its last fragment is still told.
    double opaque_at = 1;
    /// False: thickness 0, where nobody asks.
    bool thickness = true;
    /// Rank of every triangle, the foremost 0, in place of its depth: painters' orders. Empty: by depth.
    std::span<const std::uint32_t> order = {};
};

struct PeelStats {
    std::uint64_t fragments = 0;
    std::uint64_t pixels = 0;   // that have any
    std::uint64_t layers = 0;   // most of a pixel
    std::uint64_t passes = 0;   // over all triangles
    std::size_t bytes = 0;      // held at most, meshes aside
};

/// Fragments of one pixel in order. Called once a pixel that has any, from several threads at once.
using TakePixel = std::function<void(int x, int y, std::span<const SurfaceFragment> fragments)>;

/// By tiles.
///   objects  numbers in PreparedScene::objects, ascending: the surfaces that are peeled together
PeelStats peel(const PreparedScene& scene, const SceneMeshes& meshes, std::span<const std::uint32_t> objects,
               const PeelSettings& settings, const TakePixel& take);

/// One render target: a fragment for each pixel, or none: a triangle's number of kNoFragment.
struct PeelTarget {
    static constexpr std::uint32_t kNoFragment = ~0U;
    std::vector<SurfaceFragment> fragments;
};
/// By passes, M targets at a time: intermix(targets) is told of every M passes, and of those that are left.
///   settings.order must be empty
PeelStats peel_by_passes(const PreparedScene& scene, const SceneMeshes& meshes, std::span<const std::uint32_t> objects,
                         const PeelSettings& settings, int targets,
                         const std::function<void(std::span<const PeelTarget>)>& intermix);

/// Bytes that peel() will hold beside the meshes.
[[nodiscard]] std::int64_t planned_peel_bytes(double triangles, double vertices);

/// All surfaces of a scene that have triangles.
[[nodiscard]] std::vector<std::uint32_t> all_objects(const SceneMeshes& meshes);

struct Composite {
    double r = 0, g = 0, b = 0, a = 0;  // associated
};
/// Front to back (1.3 to 1.5); fragments at one depth are mixed by (4.4), whatever their order.
[[nodiscard]] Composite composite_surfaces(std::span<const SurfaceFragment> fragments);

}  // namespace pellucid
