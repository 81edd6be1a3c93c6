// Surfaces through points with normals: MPU implicits, the cells of whose octree are the patches.
#include "field/mpu_cells.hpp"
#include "io/points_file.hpp"
#include "scene/cell_crossings.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

class PointsGeometry final : public SurfaceGeometry {
public:
    PointsGeometry(std::vector<OrientedPoint> points, const Affine& to_world)
        : field_(std::move(points)),
          cells_(field_),
          placed_{&cells_, to_world, to_world.inverse(), field_.bounds().center()} {
        for (std::size_t i = 0; i < cells_.count(); ++i) {
            std::array<Vec3, 8> corners;
            const int count = placed_.body(cells_.cell(i).tight).vertices(corners);
            for (int k = 0; k < count; ++k) bounds_.include(corners[static_cast<std::size_t>(k)]);
        }
    }

    [[nodiscard]] std::size_t patch_count() const override { return cells_.count(); }
    [[nodiscard]] int max_crossings() const override { return SurfaceCells::kMostRoots; }
    [[nodiscard]] Body body(std::size_t patch) const override { return placed_.body(cells_.cell(patch).tight); }
    int crossings(std::size_t patch, const Line& line, CrossingList& out) const override {
        return placed_.crossings(patch, line, out);
    }
    [[nodiscard]] std::optional<FieldPatches> field() const override { return FieldPatches{&cells_, placed_.to_world}; }
    [[nodiscard]] std::optional<FieldSurface> field_surface() const override {
        return FieldSurface{&field_, field_.bounds(), placed_.to_world, cells_.typical_width()};
    }
    [[nodiscard]] Box bounds() const override { return bounds_; }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this) + field_.bytes() + cells_.bytes(); }

private:
    MpuField field_;
    MpuCells cells_;
    PlacedCells placed_;
    Box bounds_;  // of what is there, world
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_points(const Surface& surface, const PointsShape& shape) {
    try {
        return std::make_unique<PointsGeometry>(read_points(shape.file), surface.to_world);
    } catch (const Error& error) {
        // What the fit says does not name the file.
        const std::string file = shape.file.string();
        if (std::string_view(error.what()).find(file) != std::string_view::npos) throw;
        throw Error(error.kind(), fmt::format("{}: {}", file, error.what()));
    }
}

}  // namespace pellucid
