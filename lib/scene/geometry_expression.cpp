// Surfaces of formulas: the cells of an octree are the patches.
#include <algorithm>
#include <cmath>

#include "core/real.hpp"
#include "field/field_cells.hpp"
#include "scene/cell_geometry.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

class FormulaField final : public ScalarField {
public:
    explicit FormulaField(std::shared_ptr<const FieldCells> cells) : cells_(std::move(cells)) {}
    [[nodiscard]] double value(const Vec3& x) const override { return cells_->field().at(x); }
    [[nodiscard]] Vec3 gradient(const Vec3& x) const override { return cells_->field().gradient_at(x); }
    [[nodiscard]] FieldJet jet(const Vec3& x) const override {
        const auto f = evaluate_at<Real, 10>(cells_->field().hessian(), {Real(x.x), Real(x.y), Real(x.z)});
        FieldJet jet{f[0].value, {f[1].value, f[2].value, f[3].value}, {}};
        for (std::size_t i = 0; i < 6; ++i) jet.hessian[i] = f[4 + i].value;
        return jet;
    }
    [[nodiscard]] bool excludes(const Box& box) const override { return cells_->excludes(box); }

private:
    std::shared_ptr<const FieldCells> cells_;
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
    const auto cells = std::make_shared<const FieldCells>(field.zeros(), bounds);
    return make_cell_geometry({.cells = cells,
                               .field = std::make_shared<const FormulaField>(cells),
                               .bounds = cells->bounds(),
                               .bytes = cells->bytes()},
                              surface.to_world);
}

std::unique_ptr<SurfaceGeometry> make_expression(const Surface& surface, const ExpressionShape& shape) {
    if (!surface.bounds) throw input_error("bounds are missing, an expression needs them");
    return make_field(surface, Expression(shape.text), *surface.bounds);
}

}  // namespace pellucid
