// Isosurfaces of trilinear volumes: a patch for every cell that the isovalue passes through.
#include <algorithm>
#include <cmath>

#include "field/iso_field.hpp"
#include "field/polynomial.hpp"
#include "io/volume_file.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

/// A trilinear function on the unit cube, by its corner values (x fastest).
struct TrilinearCell {
    std::array<double, 8> corner;

    [[nodiscard]] double operator()(double x, double y, double z) const {
        const auto lerp = [](double a, double b, double t) { return a + t * (b - a); };
        return lerp(lerp(lerp(corner[0], corner[1], x), lerp(corner[2], corner[3], x), y),
                    lerp(lerp(corner[4], corner[5], x), lerp(corner[6], corner[7], x), y), z);
    }
    [[nodiscard]] Vec3 gradient(const Vec3& p) const {
        return {(*this)(1, p.y, p.z) - (*this)(0, p.y, p.z), (*this)(p.x, 1, p.z) - (*this)(p.x, 0, p.z),
                (*this)(p.x, p.y, 1) - (*this)(p.x, p.y, 0)};
    }
    /// The cubic on the segment a → b. Its Bernstein coefficients are the blossom: one coordinate of
    /// each of three arguments, so all of them are values of the field inside the cell.
    [[nodiscard]] Bernstein along(const Vec3& a, const Vec3& b) const {
        const TrilinearCell& f = *this;
        Bernstein p;
        p.count = 4;
        p.b[0] = f(a.x, a.y, a.z);
        p.b[1] = (f(b.x, a.y, a.z) + f(a.x, b.y, a.z) + f(a.x, a.y, b.z)) / 3;
        p.b[2] = (f(b.x, b.y, a.z) + f(b.x, a.y, b.z) + f(a.x, b.y, b.z)) / 3;
        p.b[3] = f(b.x, b.y, b.z);
        return p;
    }
};

class IsosurfaceGeometry final : public SurfaceGeometry {
public:
    IsosurfaceGeometry(std::shared_ptr<const VoxelGrid> grid, double isovalue, const Affine& to_world)
        : field_(std::make_shared<VolumeField>(grid, Interpolation::trilinear), isovalue),
          grid_(field_.volume().grid()),
          isovalue_(isovalue),
          to_world_(compose(to_world, grid_.index_to_world)),
          to_index_(to_world_.inverse()) {
        find_cells();
    }

    [[nodiscard]] std::size_t patch_count() const override { return cells_.size(); }
    [[nodiscard]] int max_crossings() const override { return 3; }

    [[nodiscard]] Body body(std::size_t patch) const override {
        return {Body::Kind::parallelepiped,
                to_world_.point(Vec3(origin(patch))),
                {to_world_.linear[0], to_world_.linear[1], to_world_.linear[2]}};
    }

    int crossings(std::size_t patch, const Line& line, CrossingList& out) const override {
        out.hits.clear();
        const Vec3 base(origin(patch));
        const Vec3 from = to_index_.point(line.origin) - base;
        const Vec3 direction = to_index_.vector(line.direction);
        double lo = line.t_lo;
        double hi = line.t_hi;
        int entered = -1;  // through which pair of faces, -1: the line starts or ends inside
        int left = -1;
        for (int axis = 0; axis < 3; ++axis) {
            if (direction[axis] == 0) {
                if (from[axis] < 0 || from[axis] >= 1) return 0;  // half-open: one of two neighbours takes it
                continue;
            }
            const double a = -from[axis] / direction[axis];
            const double b = (1 - from[axis]) / direction[axis];
            if (std::min(a, b) > lo) {
                lo = std::min(a, b);
                entered = axis;
            }
            if (std::max(a, b) < hi) {
                hi = std::max(a, b);
                left = axis;
            }
        }
        if (!(lo < hi)) return 0;
        const TrilinearCell cell = values(patch);
        const auto inside = [](const Vec3& p) { return glm::clamp(p, Vec3(0.0), Vec3(1.0)); };
        // Exactly on the faces: where all of a face has the isovalue (label and other integer data), a
        // point beside it by rounding would have another sign, and the crossing be lost.
        Vec3 first = inside(from + lo * direction);
        Vec3 last = inside(from + hi * direction);
        if (entered >= 0) first[entered] = direction[entered] > 0 ? 0 : 1;
        if (left >= 0) last[left] = direction[left] > 0 ? 1 : 0;
        std::array<double, 3> root{};
        const int found = sign_changes(cell.along(first, last), root);
        for (int i = 0; i < found; ++i) {
            const double t = lo + root[static_cast<std::size_t>(i)] * (hi - lo);
            const Vec3 normal = to_world_.normal(cell.gradient(inside(from + t * direction)));
            out.hits.push_back({t, normal == Vec3(0.0) ? -line.direction : normal});
        }
        return found;
    }

    [[nodiscard]] std::optional<TrilinearPatches> trilinear() const override {
        return TrilinearPatches{isovalue_, to_world_};
    }
    [[nodiscard]] std::optional<FieldSurface> field_surface() const override {
        return FieldSurface{&field_, field_.volume().hull(), to_world_, 1};
    }
    [[nodiscard]] TrilinearCorners cell(std::size_t patch) const override {
        const glm::ivec3 first = origin(patch);
        TrilinearCorners cell{{first.x, first.y, first.z}, {}};
        for (int corner = 0; corner < 8; ++corner)
            cell.value[static_cast<std::size_t>(corner)] = grid_.values[cells_[patch] + step(corner)];
        return cell;
    }

    [[nodiscard]] bool excludes(std::size_t patch, const Body& part) const override {
        // A trilinear field lies between its values at the corners of a box with the cell's edges. Values
        // within rounding of the isovalue exclude nothing.
        std::array<Vec3, 8> corners;
        const auto count = static_cast<std::size_t>(part.vertices(corners));
        const TrilinearCell cell = values(patch);
        double largest = 0;
        for (const double value : cell.corner) largest = std::max(largest, std::abs(value));
        double least = kInfinity;
        double most = -kInfinity;
        for (std::size_t i = 0; i < count; ++i) {
            const Vec3 p = to_index_.point(corners[i]) - Vec3(origin(patch));
            const double value = cell(p.x, p.y, p.z);
            least = std::min(least, value);
            most = std::max(most, value);
        }
        return least > 1e-9 * largest || most < -1e-9 * largest;
    }

    [[nodiscard]] Box bounds() const override {
        Box box;
        for (std::size_t patch = 0; patch < cells_.size(); ++patch) box.include(body(patch).bounds());
        return box;
    }
    [[nodiscard]] std::size_t bytes() const override {
        return field_.volume().bytes() + field_.bytes() + sizeof(std::uint64_t) * cells_.size();
    }

private:
    /// Cells with corners on both sides. A cell with a corner that is not a number has no surface.
    void find_cells() {
        const auto [nx, ny, nz] = grid_.size;
        std::size_t lost = 0;
        for (int k = 0; k + 1 < nz; ++k)
            for (int j = 0; j + 1 < ny; ++j)
                for (int i = 0; i + 1 < nx; ++i) {
                    const std::size_t first = grid_.index(i, j, k);
                    int above = 0;
                    bool finite = true;
                    for (int corner = 0; corner < 8; ++corner) {
                        const float value = grid_.values[first + step(corner)];
                        above += value >= isovalue_ ? 1 : 0;
                        finite = finite && std::isfinite(value);
                    }
                    if (!finite) {
                        ++lost;
                    } else if (above > 0 && above < 8) {
                        cells_.push_back(first);
                    }
                }
        if (lost > 0) warn("isosurface: {} cells with a NaN or infinite voxel are empty", lost);
    }

    [[nodiscard]] std::size_t step(int corner) const {
        return grid_.index(corner & 1, (corner >> 1) & 1, corner >> 2);
    }

    [[nodiscard]] glm::ivec3 origin(std::size_t patch) const {
        const auto nx = static_cast<std::uint64_t>(grid_.size[0]);
        const auto ny = static_cast<std::uint64_t>(grid_.size[1]);
        const std::uint64_t first = cells_[patch];
        return {static_cast<int>(first % nx), static_cast<int>(first / nx % ny),
                static_cast<int>(first / nx / ny)};
    }
    [[nodiscard]] TrilinearCell values(std::size_t patch) const {
        TrilinearCell cell{};
        for (int corner = 0; corner < 8; ++corner)
            cell.corner[static_cast<std::size_t>(corner)] =
                static_cast<double>(grid_.values[cells_[patch] + step(corner)]) - isovalue_;
        return cell;
    }

    IsoField field_;
    const VoxelGrid& grid_;
    double isovalue_;
    Affine to_world_;
    Affine to_index_;
    std::vector<std::uint64_t> cells_;  // their first sample
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_isosurface(const Surface& surface, const IsosurfaceShape& shape) {
    if (shape.interpolation == Interpolation::nearest)
        throw input_error("interpolation = \"nearest\" has no isosurface, expected \"trilinear\" or \"catmull-rom\"");
    const auto grid = std::make_shared<const VoxelGrid>(read_volume(shape.volume));
    const bool has_cells = std::ranges::all_of(grid->size, [](int n) { return n > 1; });
    std::unique_ptr<SurfaceGeometry> geometry;
    if (shape.interpolation == Interpolation::catmull_rom)
        geometry = make_catmull_rom(grid, shape.isovalue, surface.to_world);
    else
        geometry = std::make_unique<IsosurfaceGeometry>(grid, shape.isovalue, surface.to_world);
    if (!has_cells)
        warn("{} has one sample along an axis, so no cell", shape.volume.string());
    else if (geometry->patch_count() == 0)
        warn("{} never crosses isovalue {}", shape.volume.string(), shape.isovalue);
    return geometry;
}

}  // namespace pellucid
