// Surfaces of formulas: the cells of an octree are the patches.
#include <algorithm>
#include <cmath>

#include "core/real.hpp"
#include "field/field_cells.hpp"
#include "scene/cell_crossings.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

class FormulaField final : public ScalarField {
public:
    explicit FormulaField(const FieldCells& cells) : cells_(cells) {}
    [[nodiscard]] double value(const Vec3& x) const override { return cells_.field().at(x); }
    [[nodiscard]] Vec3 gradient(const Vec3& x) const override { return cells_.field().gradient_at(x); }
    [[nodiscard]] FieldJet jet(const Vec3& x) const override {
        const auto f = evaluate_at<Real, 10>(cells_.field().hessian(), {Real(x.x), Real(x.y), Real(x.z)});
        FieldJet jet{f[0].value, {f[1].value, f[2].value, f[3].value}, {}};
        for (std::size_t i = 0; i < 6; ++i) jet.hessian[i] = f[4 + i].value;
        return jet;
    }
    [[nodiscard]] bool excludes(const Box& box) const override { return cells_.excludes(box); }

private:
    const FieldCells& cells_;
};

class FieldGeometry final : public SurfaceGeometry {
public:
    FieldGeometry(const Expression& field, const Box& bounds, const Affine& to_world)
        : cells_(field, bounds), placed_{&cells_, to_world, to_world.inverse(), bounds.center()} {
        for (const FieldCell& cell : cells_.cells()) {
            std::array<Vec3, 8> corners;
            const int count = placed_.body(cell.tight).vertices(corners);
            for (int i = 0; i < count; ++i) bounds_.include(corners[static_cast<std::size_t>(i)]);
        }
    }

    [[nodiscard]] std::size_t patch_count() const override { return cells_.cells().size(); }
    [[nodiscard]] int max_crossings() const override { return FieldCells::kMostRoots; }
    [[nodiscard]] Body body(std::size_t patch) const override {
        return placed_.body(cells_.cells()[patch].tight);
    }

    int crossings(std::size_t patch, const Line& line, CrossingList& out) const override {
        return placed_.crossings(patch, line, out);
    }

    [[nodiscard]] std::optional<FieldPatches> field() const override { return FieldPatches{&cells_, placed_.to_world}; }
    [[nodiscard]] std::optional<FieldSurface> field_surface() const override {
        return FieldSurface{&formula_, cells_.bounds(), placed_.to_world};
    }
    [[nodiscard]] Box bounds() const override { return bounds_; }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this) + cells_.bytes(); }

private:
    FieldCells cells_;
    FormulaField formula_{cells_};
    PlacedCells placed_;
    Box bounds_;  // of what is there, world
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_field(const Surface& surface, const Expression& field, const Box& bounds) {
    const Vec3 size = bounds.size();
    if (!(size.x > 0 && size.y > 0 && size.z > 0))
        throw input_error("bounds have no volume: {} × {} × {}", size.x, size.y, size.z);
    constexpr double kLargest = 1e150;  // squares of places are numbers
    if (!(std::max({size.x, size.y, size.z}) <= kLargest))
        throw input_error("bounds are {} × {} × {} large, expected at most 1e150", size.x, size.y, size.z);
    if (field.touches())
        warn("surface \"{}\": the formula touches zero without a change of sign; what is drawn is where it is zero",
             surface.name);
    return std::make_unique<FieldGeometry>(field.zeros(), bounds, surface.to_world);
}

std::unique_ptr<SurfaceGeometry> make_expression(const Surface& surface, const ExpressionShape& shape) {
    if (!surface.bounds) throw input_error("bounds are missing, an expression needs them");
    return make_field(surface, Expression(shape.text), *surface.bounds);
}

}  // namespace pellucid
