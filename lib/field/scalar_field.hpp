// A field f(x, y, z) whose zeros are a surface, as samplers see it: value, gradient, Hessian.
#pragma once

#include <array>

#include "core/vec.hpp"

namespace pellucid {

/// f with its first and second derivatives at one place.
struct FieldJet {
    double value = 0;
    Vec3 gradient{0.0};
    std::array<double, 6> hessian{};  // xx, yy, zz, xy, xz, yz

    [[nodiscard]] Mat3 hessian_matrix() const {
        const auto& h = hessian;
        return {h[0], h[3], h[4], h[3], h[1], h[5], h[4], h[5], h[2]};
    }
};

/// Safe from several threads.
class ScalarField {
public:
    virtual ~ScalarField() = default;
    [[nodiscard]] virtual double value(const Vec3& x) const = 0;
    [[nodiscard]] virtual Vec3 gradient(const Vec3& x) const { return jet(x).gradient; }
    /// Where f has a kink, the derivatives of one of its sides.
    [[nodiscard]] virtual FieldJet jet(const Vec3& x) const = 0;
    /// True where f surely has no zero in the box.
    [[nodiscard]] virtual bool excludes(const Box& box) const = 0;
};

/// f = 0 within bounds, object space.
struct FieldSurface {
    const ScalarField* field;
    Box bounds;
    Affine to_world;
    /// Width of a cell where f is pieced together from cells (volumes, points), object space; 0 elsewhere.
    double cell_width = 0;
};

}  // namespace pellucid
