// The stages of the zSlab pipeline on the CPU (zSlab dissertation, section 5.2): each object of a scene becomes a
// sorted array of slabs in every pixel that it covers, and arrays are intermixed in a z-thickness buffer.
//
// A pixel's array is read before it is written and no stage looks at another pixel, so one buffer does where a device
// needs two in turn.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "cpu/depth_peeling.hpp"
#include "cpu/volume_caster.hpp"
#include "stage/scene_meshes.hpp"
#include "stage/slab_pipeline.hpp"

namespace pellucid {

/// What is drawn so far: arrays, and how near the nearest thing is.
class SlabFrame {
public:
    SlabFrame(const ZThicknessSize& size, const SlabSettings& settings);
    ~SlabFrame();

    [[nodiscard]] const SlabSettings& settings() const { return settings_; }
    [[nodiscard]] const ZThicknessBuffer& buffer() const { return buffer_; }
    /// Depth along the view axis of the nearest thing drawn, +inf where none.
    [[nodiscard]] std::span<const float> nearest() const { return nearest_; }
    [[nodiscard]] std::size_t bytes() const { return buffer_.bytes() + nearest_.size() * sizeof(float); }

    /// Merges a sorted array of any length with the pixel's, and compresses what comes out. Safe beside other pixels.
    ///   nearest  depth of what the array shows first
    void intermix(std::size_t pixel, std::span<const twin::Slab> array, float nearest);
    /// The same for one that is compressed first: image-level intermixing.
    void intermix_compressed(std::size_t pixel, std::span<const twin::Slab> array, float nearest);
    /// Slabs (virtual ones of surfaces) that may overlap, by back depth.
    void intermix_overlapping(std::size_t pixel, std::span<const twin::Slab> slabs, float nearest);

private:
    struct Scratch;
    [[nodiscard]] Scratch& scratch();

    SlabSettings settings_;
    ZThicknessBuffer buffer_;
    std::vector<float> nearest_;
    struct PerThread;
    std::unique_ptr<PerThread> threads_;
};

/// The pipeline on the CPU; the scene must outlive it.
[[nodiscard]] std::unique_ptr<SlabPipeline> make_slab_pipeline(const PreparedScene& scene, const ZThicknessSize& size,
                                                               const SlabSettings& settings);

/// Bytes that it will hold for so many objects: z-thickness buffers, and what threads need for the order-free merge.
[[nodiscard]] std::int64_t planned_slab_bytes(const ZThicknessSize& size, const SlabSettings& settings, std::size_t objects);

/// Polygon stage: one object, peeled. `surfaces`: L, most surfaces a pixel, the nearest; 0: all.
void peel_into(SlabFrame& frame, const PreparedScene& scene, const SceneMeshes& meshes, std::uint32_t object,
               int surfaces, SlabStageStats& stats);
/// Volume stage: an isosurface, as virtual slabs. Precondition: IsosurfaceCaster::casts(object).
void cast_into(SlabFrame& frame, const PreparedScene& scene, const Object& object, const CastSettings& settings,
               SlabStageStats& stats);
/// Volume stage: a volume. `on_the_fly`: its slabs meet what is there one by one, before any compression.
void cast_into(SlabFrame& frame, const PreparedScene& scene, const VolumeObject& volume, const CastSettings& settings,
               float opaque_at, bool on_the_fly, SlabStageStats& stats);

/// All of a frame as planes R, G, B, A, Z.
[[nodiscard]] Image frame_image(const SlabFrame& frame);
/// All objects at once over shared intervals, a frame an object: no order of theirs matters.
[[nodiscard]] Image order_free_image(std::span<const SlabFrame* const> frames, const SlabSettings& settings);

}  // namespace pellucid
