// Isosurfaces of Catmull-Rom volumes: a patch for every cell with a part of the surface.
#include "field/catmull_rom.hpp"
#include "scene/cell_crossings.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

class CatmullRomGeometry final : public SurfaceGeometry {
public:
    CatmullRomGeometry(std::shared_ptr<const VoxelGrid> grid, double isovalue, const Affine& to_world)
        : cells_(std::make_shared<VolumeField>(grid, Interpolation::catmull_rom), isovalue) {
        const Affine placed = compose(to_world, grid->index_to_world);
        placed_ = {&cells_, placed, placed.inverse(), cells_.field().volume().hull().center()};
        for (std::size_t i = 0; i < cells_.count(); ++i) {
            const CatmullRomCells::Place place = cells_.place(i);
            const Vec3 base(place.base[0], place.base[1], place.base[2]);
            std::array<Vec3, 8> corners;
            const int count = placed_.body({base + place.lo, base + place.hi}).vertices(corners);
            for (int k = 0; k < count; ++k) bounds_.include(corners[static_cast<std::size_t>(k)]);
        }
        if (cells_.lost() > 0)
            warn("isosurface: {} cells beside a NaN or infinite voxel are empty", cells_.lost());
    }

    [[nodiscard]] std::size_t patch_count() const override { return cells_.count(); }
    [[nodiscard]] int max_crossings() const override { return 9; }
    [[nodiscard]] Body body(std::size_t patch) const override {
        return placed_.body(cells_.cell(patch).tight);
    }
    int crossings(std::size_t patch, const Line& line, CrossingList& out) const override {
        return placed_.crossings(patch, line, out);
    }
    [[nodiscard]] std::optional<FieldPatches> field() const override {
        return FieldPatches{&cells_, placed_.to_world};
    }
    [[nodiscard]] std::optional<FieldSurface> field_surface() const override {
        return FieldSurface{&cells_.field(), cells_.field().volume().hull(), placed_.to_world, 1};
    }
    [[nodiscard]] Box bounds() const override { return bounds_; }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this) + cells_.bytes(); }

private:
    CatmullRomCells cells_;
    PlacedCells placed_{};
    Box bounds_;  // of what is there, world
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_catmull_rom(std::shared_ptr<const VoxelGrid> grid, double isovalue,
                                                  const Affine& to_world) {
    return std::make_unique<CatmullRomGeometry>(std::move(grid), isovalue, to_world);
}

}  // namespace pellucid
