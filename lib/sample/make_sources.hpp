// The particle source of every object of a scene, by the sampler that is asked for.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "sample/brownian_source.hpp"
#include "sample/counting_spheres.hpp"
#include "sample/line_sampler.hpp"
#include "sample/particle_source.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

/// How surfaces are sampled: `particles.sampler`. Volumes have one sampler.
enum class SamplerKind {
    lines,       // random lines: line_sampler.hpp
    stratified,  // the same, thinned pixel by pixel: stratify.hpp
    brownian,    // Brownian motion on f = 0: brownian_source.hpp
    mesh,        // area-weighted triangles of a tessellation: mesh_sampler.hpp, surface_mesh.hpp
    octree,      // area-weighted pieces of tangent planes in the leaves of an octree: the same
};

/// What only some samplers read.
struct SourceSettings {
    WalkSettings walk{};
    int mesh_cells = 128;      // along the longest edge of the bounds
    double mesh_error_px = 0;  // in place of mesh_cells, largest distance from the surface in pixels; 0: mesh_cells
    int octree_cells = 128;
    bool counting_spheres = false;  // opacity control as in the paper; else exact
    CountingSpheres counting{};
    Seed seed{};  // of the counting spheres
};

using Sources = std::vector<std::unique_ptr<const ParticleSource>>;

/// Sources by reference, whoever owns them.
class SourceRefs {
public:
    SourceRefs(const Sources& sources);                      // NOLINT: meant to be implicit
    SourceRefs(const std::vector<LineSampler>& samplers);    // NOLINT
    explicit SourceRefs(const ParticleSource& source) : refs_{&source} {}

    [[nodiscard]] std::size_t size() const { return refs_.size(); }
    [[nodiscard]] const ParticleSource& operator[](std::size_t i) const { return *refs_[i]; }
    [[nodiscard]] std::span<const ParticleSource* const> all() const { return refs_; }

private:
    std::vector<const ParticleSource*> refs_;
};

/// One source an object, in the order of the scene. Throws Error(input) naming an object that the sampler cannot serve.
[[nodiscard]] Sources make_sources(const PreparedScene& scene, SamplerKind kind = SamplerKind::lines,
                                   const SourceSettings& settings = {});

/// Random lines on every surface.
[[nodiscard]] std::vector<LineSampler> make_samplers(const PreparedScene& scene);

}  // namespace pellucid
