#include "vulkan/surface_drawer.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <optional>

#include "core/parallel.hpp"
#include "vulkan/peeling.hpp"

namespace pellucid::vulkan {
namespace {

/// Of a pixel. A pass over all triangles is dear, a slot is an atomic for each fragment that comes before those it keeps:
/// with 14 layers of small triangles 8 take half of the time of 4, and 12 as much as 8 (Mesa in software).
constexpr int kSlots = 8;

class VulkanSurfaces final : public SurfaceDrawer {
public:
    VulkanSurfaces(const Device& device, const PreparedScene& scene, const SceneMeshes& meshes)
        : device_(device), scene_(scene), meshes_(meshes) {}

    [[nodiscard]] Image draw(const SurfaceDrawSettings& settings, SurfaceDrawStats& stats) override {
        const int slots = settings.layers > 0 && settings.layers < kSlots ? settings.layers : kSlots;
        if (!peeler_ || slots_ != slots) {
            peeler_.emplace(device_, scene_, meshes_, PeelerSettings{.targets = slots, .thickness = false});
            slots_ = slots;
        }
        const bool nearest = settings.mixing == SurfaceMixing::nearest;
        const PeelMix mix = settings.mixing == SurfaceMixing::blended ? PeelMix::one_over_the_other : PeelMix::by_depth;

        Image image = empty_surface_image(scene_.camera);
        const std::array<std::span<float>, 5> planes{image.plane("R"), image.plane("G"), image.plane("B"), image.plane("A"),
                                                     image.plane("Z")};
        stats = {};
        const int step = peeler_->most_rows();
        for (int row = 0; row < image.height(); row += step) {
            PeelStats peeled;
            const std::span<const twin::PeelColor> colors =
                peeler_->compose(all_objects(meshes_), {.layers = settings.layers, .thickness = false, .order = settings.order}, mix,
                                 {row, std::min(row + step, image.height())}, peeled);
            stats.fragments += peeled.fragments;
            stats.layers = std::max(stats.layers, peeled.layers);
            stats.passes += peeled.passes;
            stats.bytes = std::max(stats.bytes, static_cast<std::int64_t>(peeled.bytes));
            const std::size_t first = static_cast<std::size_t>(row) * static_cast<std::size_t>(image.width());
            parallel_for(colors.size(), 16384, [&](std::size_t begin, std::size_t end) {
                for (std::size_t i = begin; i < end; ++i) {
                    const twin::PeelColor& c = colors[i];
                    if (c.count == 0) continue;
                    const double scale = nearest ? 1 / (1 - c.clear) : 1;
                    planes[0][first + i] = static_cast<float>(scale * c.r);
                    planes[1][first + i] = static_cast<float>(scale * c.g);
                    planes[2][first + i] = static_cast<float>(scale * c.b);
                    planes[3][first + i] = nearest ? 1 : static_cast<float>(1 - c.clear);
                    planes[4][first + i] = c.z;
                }
            });
        }
        return image;
    }
    [[nodiscard]] std::vector<pellucid::StageTime> device_times() const override {
        return peeler_ ? peeler_->device_times() : std::vector<pellucid::StageTime>();
    }

private:
    const Device& device_;
    const PreparedScene& scene_;
    const SceneMeshes& meshes_;
    std::optional<Peeler> peeler_;
    int slots_ = 0;
};

}  // namespace

std::unique_ptr<SurfaceDrawer> make_surface_drawer(const Device& device, const PreparedScene& scene, const SceneMeshes& meshes) {
    return std::make_unique<VulkanSurfaces>(device, scene, meshes);
}

std::int64_t planned_surface_bytes(const Device& device, const PreparedScene& scene, double triangles, double vertices) {
    return planned_compose_bytes(device, scene, triangles, vertices, kSlots);
}

}  // namespace pellucid::vulkan
