// Particles of a surface's triangles: uniform points, weighted by their area. Samplers `mesh` and `octree`.
#pragma once

#include <memory>
#include <string>

#include "sample/line_sampler.hpp"
#include "sample/surface_mesh.hpp"

namespace pellucid {

class MeshSampler final : public ParticleSource {
public:
    /// Triangles in place of an object's own surface. `object` is copied, its geometry left alone. `complaint`: see there.
    MeshSampler(const Object& object, TriangleMesh mesh, const Camera& camera, std::uint32_t object_id, std::string complaint = {});

    [[nodiscard]] std::uint32_t object_id() const override { return lines_->object_id(); }
    [[nodiscard]] std::string label() const override { return lines_->label(); }
    [[nodiscard]] double optical_depth() const override { return lines_->optical_depth(); }
    [[nodiscard]] double virtual_pixels() const override { return lines_->virtual_pixels(); }
    [[nodiscard]] std::size_t block_count() const override { return lines_->block_count(); }
    [[nodiscard]] double block_virtual_pixels(std::size_t block) const override {
        return lines_->block_virtual_pixels(block);
    }
    [[nodiscard]] std::optional<Box> block_bounds(std::size_t block) const override { return lines_->block_bounds(block); }
    void trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first, std::uint32_t count,
                         std::vector<Point>& out) const override {
        lines_->trials_in_block(block, seed, repeat, first, count, out);
    }
    [[nodiscard]] std::optional<Point> trial(Seed seed, std::uint32_t repeat, std::uint64_t index) const override {
        return lines_->trial(seed, repeat, index);
    }
    [[nodiscard]] std::size_t piece_count() const override { return lines_->piece_count(); }
    [[nodiscard]] std::size_t bytes() const override { return lines_->bytes() + object_->geometry->bytes(); }

    [[nodiscard]] std::string complaint() const override { return complaint_; }

    [[nodiscard]] const Object& object() const { return *object_; }

private:
    std::unique_ptr<Object> object_;
    std::unique_ptr<LineSampler> lines_;
    std::string complaint_;
};

/// The object with triangles for its geometry.
[[nodiscard]] Object with_triangles(const Object& object, TriangleMesh mesh);

}  // namespace pellucid
