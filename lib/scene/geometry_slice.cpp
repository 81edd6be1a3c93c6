// Slices: a parallelogram that shows the values of a volume where it stands, through a transfer function.
#include <algorithm>
#include <cmath>

#include "scene/geometry_makers.hpp"
#include "scene/parallelogram.hpp"
#include "scene/volume_object.hpp"

namespace pellucid {
namespace {

/// In samples: a slice may lie in a face of the hull, and a volume of one sample has no other place for it.
constexpr double kHullRoom = 1e-6;

class SliceGeometry final : public SurfaceGeometry {
public:
    SliceGeometry(const Parallelogram& place, const SliceShape& shape, const Affine& to_world)
        : place_(place),
          grid_(std::make_shared<const VoxelGrid>(read_or_sample(shape.volume))),
          field_(grid_, Interpolation::trilinear),
          transfer_(shape.transfer),
          to_index_(compose(to_world, grid_->index_to_world).inverse()) {
        ValueRange range;
        for (const float v : grid_->values) {
            if (!std::isfinite(v)) continue;
            range.lo = std::min(range.lo, static_cast<double>(v));
            range.hi = std::max(range.hi, static_cast<double>(v));
        }
        most_opacity_ = transfer_.most_opacity(range.lo, range.hi);
    }

    [[nodiscard]] std::size_t patch_count() const override { return most_opacity_ > 0 ? 1 : 0; }
    [[nodiscard]] int max_crossings() const override { return 1; }
    [[nodiscard]] Body body(std::size_t) const override { return place_.body(); }
    int crossings(std::size_t, const Line& line, CrossingList& out) const override { return place_.crossings(line, out); }
    [[nodiscard]] Box bounds() const override { return place_.bounds(); }

    [[nodiscard]] bool painted() const override { return true; }
    [[nodiscard]] bool has_color() const override { return true; }
    [[nodiscard]] Vec3 color(const Vec3& point) const override { return transfer_.color(value(point)); }
    [[nodiscard]] Vec3 brightest() const override { return transfer_.brightest(); }
    [[nodiscard]] double opacity_at(const Vec3& point) const override { return transfer_.opacity(value(point)); }
    [[nodiscard]] double most_opacity() const override { return most_opacity_; }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this) + field_.bytes(); }

private:
    [[nodiscard]] double value(const Vec3& world) const {
        Vec3 p = to_index_.point(world);
        const Vec3 hi = field_.hull().hi;
        for (int axis = 0; axis < 3; ++axis) {
            if (p[axis] < 0 && p[axis] > -kHullRoom) p[axis] = 0;
            if (p[axis] > hi[axis] && p[axis] < hi[axis] + kHullRoom) p[axis] = hi[axis];
        }
        return field_.value(p);
    }

    Parallelogram place_;
    std::shared_ptr<const VoxelGrid> grid_;
    VolumeField field_;
    TransferFunction transfer_;
    Affine to_index_;
    double most_opacity_ = 0;
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_slice(const Surface& surface, const SliceShape& shape) {
    const Affine& place = surface.to_world;
    const Parallelogram placed{place.point(shape.center), place.vector(shape.u), place.vector(shape.v)};
    return std::make_unique<SliceGeometry>(placed, shape, place);
}

}  // namespace pellucid
