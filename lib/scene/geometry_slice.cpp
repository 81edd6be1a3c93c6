// Slices: a parallelogram that shows the values of a volume where it stands, through a transfer function.
#include <algorithm>
#include <cmath>

#include "core/error.hpp"
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
        if (!meets_volume()) {
            warn("slice: its parallelogram lies wholly outside of {}, so nothing of it is seen", shape.volume.string());
            most_opacity_ = 0;
        }
    }

    [[nodiscard]] std::size_t patch_count() const override { return most_opacity_ > 0 ? 1 : 0; }
    [[nodiscard]] int max_crossings() const override { return 1; }
    [[nodiscard]] Body body(std::size_t) const override { return place_.body(); }
    int crossings(std::size_t, const Line& line, CrossingList& out) const override {
        return place_.crossings(line, out);
    }
    [[nodiscard]] Box bounds() const override { return place_.bounds(); }

    [[nodiscard]] bool painted() const override { return true; }
    [[nodiscard]] bool has_color() const override { return true; }
    [[nodiscard]] Vec3 color(const Vec3& point) const override { return transfer_.color(value(point)); }
    [[nodiscard]] Vec3 brightest() const override { return transfer_.brightest(); }
    [[nodiscard]] double opacity_at(const Vec3& point) const override {
        return transfer_.opacity(value(point));
    }
    [[nodiscard]] double most_opacity() const override { return most_opacity_; }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this) + field_.bytes(); }

private:
    /// The parallelogram, in samples, clipped by the six faces of the hull one after the other (Sutherland and Hodgman 1974).
    [[nodiscard]] bool meets_volume() const {
        const Vec3 center = to_index_.point(place_.center);
        const Vec3 u = to_index_.vector(place_.u);
        const Vec3 v = to_index_.vector(place_.v);
        std::vector<Vec3> polygon{center - u - v, center + u - v, center + u + v, center - u + v};
        const Vec3 last = field_.hull().hi;
        for (int face = 0; face < 6; ++face) {
            const int axis = face / 2;
            const auto inside = [&](const Vec3& p) {
                return face % 2 == 0 ? p[axis] + kHullRoom : last[axis] + kHullRoom - p[axis];
            };
            std::vector<Vec3> kept;
            for (std::size_t i = 0; i < polygon.size(); ++i) {
                const Vec3& a = polygon[i];
                const Vec3& b = polygon[(i + 1) % polygon.size()];
                const double at_a = inside(a);
                const double at_b = inside(b);
                if (at_a >= 0) kept.push_back(a);
                if ((at_a >= 0) != (at_b >= 0)) kept.push_back(a + (at_a / (at_a - at_b)) * (b - a));
            }
            polygon = std::move(kept);
        }
        return !polygon.empty();
    }
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
