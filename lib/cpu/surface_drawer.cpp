#include "cpu/surface_drawer.hpp"

#include <algorithm>
#include <array>

#include "cpu/depth_peeling.hpp"

namespace pellucid {
namespace {

// ---- From the fragments of a pixel to its colour

[[nodiscard]] Composite nearest_as_opaque(std::span<const SurfaceFragment> fragments) {
    const twin::Slab& slab = fragments.front().slab;
    const auto straight = [&](float c) { return static_cast<double>(c) / static_cast<double>(slab.a); };
    return {straight(slab.r), straight(slab.g), straight(slab.b), 1};
}

[[nodiscard]] Composite blend(std::span<const SurfaceFragment> fragments) {
    Composite sum;
    double clear = 1;
    for (const SurfaceFragment& f : fragments) {
        sum.r += clear * static_cast<double>(f.slab.r);
        sum.g += clear * static_cast<double>(f.slab.g);
        sum.b += clear * static_cast<double>(f.slab.b);
        clear *= 1 - static_cast<double>(f.slab.a);
    }
    sum.a = 1 - clear;
    return sum;
}

using Resolve = Composite (*)(std::span<const SurfaceFragment>);
[[nodiscard]] Resolve resolve_of(SurfaceMixing mixing) {
    switch (mixing) {
        case SurfaceMixing::nearest: return nearest_as_opaque;
        case SurfaceMixing::blended: return blend;
        case SurfaceMixing::by_depth: break;
    }
    return composite_surfaces;
}

class CpuDrawer final : public SurfaceDrawer {
public:
    CpuDrawer(const PreparedScene& scene, const SceneMeshes& meshes) : scene_(scene), meshes_(meshes) {}

    [[nodiscard]] Image draw(const SurfaceDrawSettings& settings, SurfaceDrawStats& stats) override {
        Image image = empty_surface_image(scene_.camera);
        const std::array<std::span<float>, 5> planes{image.plane("R"), image.plane("G"), image.plane("B"), image.plane("A"),
                                                     image.plane("Z")};
        const auto width = static_cast<std::size_t>(image.width());
        const Resolve resolve = resolve_of(settings.mixing);
        const PeelStats peeled =
            peel(scene_, meshes_, all_objects(meshes_), {.layers = settings.layers, .thickness = false, .order = settings.order},
                 [&](int x, int y, std::span<const SurfaceFragment> fragments) {
                     const std::size_t at = static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
                     const Composite color = resolve(fragments);
                     planes[0][at] = static_cast<float>(color.r);
                     planes[1][at] = static_cast<float>(color.g);
                     planes[2][at] = static_cast<float>(color.b);
                     planes[3][at] = static_cast<float>(color.a);
                     for (const SurfaceFragment& f : fragments) planes[4][at] = std::min(planes[4][at], f.slab.z);
                 });
        stats = {peeled.fragments, peeled.layers, peeled.passes, static_cast<std::int64_t>(peeled.bytes)};
        return image;
    }

private:
    const PreparedScene& scene_;
    const SceneMeshes& meshes_;
};

}  // namespace

std::unique_ptr<SurfaceDrawer> make_surface_drawer(const PreparedScene& scene, const SceneMeshes& meshes) {
    return std::make_unique<CpuDrawer>(scene, meshes);
}

}  // namespace pellucid
