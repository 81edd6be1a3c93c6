// Depth peeling on Vulkan (zSlab, section 5.2.2, after Everitt 2001): the surfaces of each pixel, nearest first, by the
// device's own rasteriser. cpu/depth_peeling.hpp is the specification: the same fragments, their depths to the last bit.
//
// Triangles are clipped and snapped to 1/256 pixel by the CPU's TriangleSetup; a rasteriser of 8 bits below the pixel then
// covers what the CPU's covers. Where it could not (it has fewer bits, or a triangle reaches out of the viewport and would
// be cut at places of the device's choice), the fragment shader judges the centres of pixels by the CPU's 64-bit edges.
//
// A pass draws all triangles once. Each pixel has M slots; a fragment behind those that were kept so far goes to its place
// among them by 64-bit atomics, so that a pass keeps the M nearest of the rest. Places are (depth or rank, number): a total
// order, so the order in which fragments arrive is of no account. Clip planes and bounds are asked in the fragment shader;
// each fragment that is kept is shaded once, in compute.
//
// Rectangles with an image, and slices: their images and volumes are not on the device. Such an object, which has at most
// one fragment in a pixel, is peeled and shaded by the CPU beforehand and looked up (32 bytes a pixel of its rectangle).
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "cpu/depth_peeling.hpp"
#include "kernel/peeling_twin.h"
#include "stage/particle_drawer.hpp"
#include "vulkan/device.hpp"

namespace pellucid::vulkan {

struct PeelerSettings {
    /// M: slots of a pixel, and targets that are filled between two intermixings; 1 to 64.
    int targets = 4;
    /// False: thickness 0, where nobody asks.
    bool thickness = true;
    /// Every triangle by the fragment shader's edges, as on a device with too coarse a rasteriser.
    bool judge_all = false;
    /// Of all corners, in 1/256 pixel. Anything but 0 is wrong: for tests that must see it.
    float shift = 0;
};

/// Targets that a pass has filled, on the device: of pixel p, `counts[p]` slabs at `slabs[k · pixels + p]`, nearest first,
/// and the numbers of their triangles (SceneMeshes) at the same places.
struct PeeledTargets {
    const Buffer& slabs;    // twin::Slab
    const Buffer& numbers;  // uint32
    const Buffer& counts;   // uint32
    int targets;            // at most so many a pixel
};

/// Rows begin <= y < end of the image.
struct PeelRows {
    int begin = 0, end = 0;
};

/// How fragments become one colour.
enum class PeelMix {
    by_depth,  // front to back, those at one depth by (4.4): composite_surfaces
    one_over_the_other,
};

class Peeler {
public:
    /// Sets the triangles up and brings them to the device. All must outlive it. Throws Error(device) where the device
    /// cannot draw triangles, Error(run) where the image is wider than its viewport.
    Peeler(const Device& device, const PreparedScene& scene, const SceneMeshes& meshes, const PeelerSettings& settings);
    Peeler(Peeler&&) noexcept;
    ~Peeler();

    /// intermix(targets) is told of each pass that kept anything.
    ///   objects   numbers in SceneMeshes::objects, ascending: the surfaces that are peeled together
    /// Throws Error(run) where the image is higher than the viewport.
    ///   settings  `thickness` is that of PeelerSettings
    PeelStats peel(std::span<const std::uint32_t> objects, const PeelSettings& settings,
                   const std::function<void(const PeeledTargets&)>& intermix);
    /// One colour a pixel of some rows, until the next call; `clear` is what shines through, all is 0 where nothing was drawn.
    std::span<const twin::PeelColor> compose(std::span<const std::uint32_t> objects, const PeelSettings& settings, PeelMix mix,
                                             const PeelRows& rows, PeelStats& stats);
    /// Rows of which compose() does not hold more than its share of the device's memory, nor than its rasteriser takes.
    [[nodiscard]] int most_rows() const;

    /// Device time of all that was done: peel, shade, read-back.
    [[nodiscard]] const std::vector<pellucid::StageTime>& device_times() const;

private:
    class State;
    std::unique_ptr<State> state_;
};

/// Bytes that compose() will hold on the device.
[[nodiscard]] std::int64_t planned_compose_bytes(const Device& device, const PreparedScene& scene, double triangles,
                                                 double vertices, int targets);

}  // namespace pellucid::vulkan
