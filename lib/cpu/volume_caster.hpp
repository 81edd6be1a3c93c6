// Volume stage of zSlabs: the ray of a pixel through one volume, or to one isosurface, as slabs from front to
// back. zSlab dissertation, sections 5.2.4 and 6.1. The plain version, in double: the specification of the
// fast one (cpu/fast_volume_caster.hpp).
//
// All rays are sampled on a fixed grid: at depths t = k·dt, k whole, where dt along the view axis is one step
// along the ray. So volumes with equal steps are sampled at the same places, and what is skipped moves no
// sample. Where a ray enters and leaves (hull, clip planes, near and far) its steps are cut: the first and
// the last are shorter.
#pragma once

#include <concepts>
#include <cstdint>
#include <vector>

#include "cpu/empty_space.hpp"
#include "kernel/slab_twin.h"
#include "scene/prepared_scene.hpp"
#include "stage/slab_settings.hpp"

namespace pellucid {

/// Takes slabs from front to back; false when nothing behind is seen any more.
template <class T>
concept SlabSink = requires(T& sink, const twin::Slab& slab) {
    { sink.push(slab) } -> std::convertible_to<bool>;
};

/// The plainest sink: all of them, until the accumulated opacity passes a threshold.
struct SlabList {
    std::vector<twin::Slab> slabs;
    float opaque_at = 1;  // as SlabSettings::opaque_at
    float clear = 1;

    bool push(const twin::Slab& slab) {
        slabs.push_back(slab);
        clear *= 1 - slab.a;
        return clear > 1 - opaque_at;
    }
};

/// Smallest distance of neighbouring samples, world: what "voxel" means.
[[nodiscard]] double voxel_pitch(const Affine& index_to_world);

/// Steps across the box of what is cast, at most: more would take for ever, and float32 would not tell them apart.
/// 512³ voxels have 887 thousand of a thousandth of a voxel. Casters throw Error(input) where there are more.
inline constexpr double kMostSteps = 1 << 20;

/// A volume as rays see it; safe from several threads.
class VolumeCaster {
public:
    /// Scene and volume must outlive it.
    VolumeCaster(const PreparedScene& scene, const VolumeObject& volume, const CastSettings& settings);

    /// Where a ray is. Depths along the view axis.
    struct Progress {
        Ray ray;
        double dt, t_in, t_out;  // nothing of the volume is met outside of t_in … t_out
        double t;                // how far it is looked at
        double value;            // there
        double ray_length;       // for a depth of 1
        Vec3 from, along;        // in samples: from + t·along
        std::int64_t k;          // of the grid: the next sample is at (k + 1)·dt
        [[nodiscard]] bool done() const { return !(t < t_out); }
    };
    [[nodiscard]] Progress start(const Ray& ray) const;
    /// The same without looking at the value where the ray comes in: advance() needs that.
    [[nodiscard]] Progress enter(const Ray& ray) const;
    /// What lies between the last place and t. Precondition: t_in <= progress.t < t <= t_out.
    [[nodiscard]] twin::Slab advance(Progress& progress, double t) const;
    /// Goes over whole steps that surely show nothing; at the end where nothing comes any more. Leaves
    /// `progress` at a sample. Nothing happens with skip = false.
    void skip(Progress& progress) const;
    /// One step: to the next sample, or to the end.
    [[nodiscard]] twin::Slab step(Progress& progress) const;

    /// The slabs with opacity > 0 on a ray.
    template <SlabSink Sink>
    void cast(const Ray& ray, Sink& sink) const {
        for (Progress p = start(ray); !p.done();) {
            skip(p);
            if (p.done()) return;
            const twin::Slab slab = step(p);
            if (slab.a > 0 && !sink.push(slab)) return;
        }
    }

    [[nodiscard]] const VolumeObject& volume() const { return *volume_; }
    [[nodiscard]] const CastSettings& settings() const { return settings_; }
    [[nodiscard]] const EmptySpace& empty_space() const { return space_; }
    /// Beyond what the volume itself holds.
    [[nodiscard]] std::size_t bytes() const { return space_.bytes(); }

private:
    [[nodiscard]] double value_at(const Progress& progress, double t) const;
    [[nodiscard]] Vec3 index_at(const Progress& progress, double t) const;

    const PreparedScene* scene_;
    const VolumeObject* volume_;
    CastSettings settings_;
    Vec3 last_;  // of the hull, in samples
    EmptySpace space_;
};

/// Crossings of an isosurface (trilinear or Catmull-Rom): where samples on the fixed grid change sides,
/// refined by ten bisections. Two crossings within a step are not seen.
class IsosurfaceCaster {
public:
    /// Scene and object must outlive it. Precondition: casts(object).
    IsosurfaceCaster(const PreparedScene& scene, const Object& object, const CastSettings& settings);
    /// Whether the object is one of these.
    [[nodiscard]] static bool casts(const Object& object);

    struct Crossing {
        double t;
        Vec3 normal;  // geometric, world, any length
        double opacity;
        Vec3 color;  // straight, lit
    };
    /// Appends all crossings of a ray from front to back, at most until one has opacity 1.
    void crossings(const Ray& ray, std::vector<Crossing>& out) const;

    /// Virtual slabs (zSlab, section 5.4) with depth `thickness` towards the viewer, less where the eye is nearer: by
    /// back depth, and those of crossings that are close overlap.
    template <SlabSink Sink>
    void cast(const Ray& ray, double thickness, Sink& sink) const {
        std::vector<Crossing> found;
        crossings(ray, found);
        for (const Crossing& crossing : found) {
            const twin::Slab slab = virtual_slab(crossing, thickness);
            if (slab.a > 0 && !sink.push(slab)) return;
        }
    }
    [[nodiscard]] static twin::Slab virtual_slab(const Crossing& crossing, double thickness);

    /// Of its samples, world.
    [[nodiscard]] double pitch() const;
    [[nodiscard]] const EmptySpace& empty_space() const { return space_; }
    [[nodiscard]] std::size_t bytes() const { return space_.bytes(); }
    /// The same beforehand, where empty space is skipped.
    [[nodiscard]] static std::int64_t planned_bytes(const Object& object);

private:
    const PreparedScene* scene_;
    const Object* object_;
    const VolumeField* field_;
    double isovalue_;
    CastSettings settings_;
    Affine to_world_, to_index_;
    EmptySpace space_;
};

}  // namespace pellucid
