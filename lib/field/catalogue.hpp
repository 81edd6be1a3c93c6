// Surfaces by name: quadrics and the torus with every crossing of a line in closed form, and famous formulas.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/vec.hpp"
#include "field/expression.hpp"
#include "field/scalar_field.hpp"

namespace pellucid {

/// Most crossings of a line with a catalogue surface.
inline constexpr int kMaxCatalogueCrossings = 4;

/// One row of `render --list-implicit`.
struct CatalogueEntry {
    struct Parameter {
        std::string_view name;
        double value;       // default
        double above = 0;   // legal in between, ends excluded
        double below = kInfinity;
    };
    std::string_view name;
    std::string_view equation;  // in object space, negative inside; the axis is z
    std::vector<Parameter> parameters;
    std::string_view bounds;    // object-space box when the scene gives none
    /// The same box as formulas of the parameters, low and high corner; empty where the surface is a CatalogueSurface.
    std::array<std::string_view, 6> box = {};
    /// What is evaluated where `equation` tells in words what would be too long to read; else empty.
    std::string_view long_equation = {};

    /// Whether `equation` itself is the surface; otherwise it is a CatalogueSurface.
    [[nodiscard]] bool is_formula() const { return !box[0].empty(); }
};
[[nodiscard]] std::span<const CatalogueEntry> catalogue();
/// Legal values of a parameter, for people: "> 0".
[[nodiscard]] std::string range_of(const CatalogueEntry::Parameter& parameter);

/// Throws Error(input) where there is no such name: all names.
[[nodiscard]] const CatalogueEntry& catalogue_entry(const std::string& name);
/// All parameters of an entry: those given, and the defaults of the others. Throws Error(input) where one is not the
/// entry's, or not in its range.
[[nodiscard]] std::map<std::string, double> catalogue_parameters(const CatalogueEntry& entry,
                                                                 const std::map<std::string, double>& given);

/// f = 0 in its box.
struct CatalogueFormula {
    Expression field;
    Box bounds;
};
/// Precondition: is_formula(). Throws Error(input) as catalogue_parameters does.
[[nodiscard]] CatalogueFormula catalogue_formula(const CatalogueEntry& entry,
                                                 const std::map<std::string, double>& parameters);

/// f(x) = 0 with f = Σ q_i x_i² + l·x + c (a quadric in principal axes), or the torus
/// (|(x, y)| − major)² + z² = minor².
class CatalogueSurface final : public ScalarField {
public:
    /// Throws Error(input) where the name or a parameter is not in the catalogue or not in its range. Precondition: the
    /// entry of that name is no formula.
    CatalogueSurface(const std::string& name, const std::map<std::string, double>& parameters);

    /// The surface's own box: tight where it is bounded, else the catalogue's.
    [[nodiscard]] const Box& bounds() const { return bounds_; }
    /// Whether f = 0 itself is bounded, and not only its box.
    [[nodiscard]] bool bounded() const { return torus_ || (square_.x > 0 && square_.y > 0 && square_.z > 0); }
    [[nodiscard]] bool torus() const { return torus_; }
    /// Quadric: q, l and c of the equation above.
    [[nodiscard]] const Vec3& square() const { return square_; }
    [[nodiscard]] const Vec3& linear() const { return linear_; }
    [[nodiscard]] double constant() const { return constant_; }
    /// Torus: radius of the ring and of the tube.
    [[nodiscard]] double major() const { return major_; }
    [[nodiscard]] double minor() const { return minor_; }
    /// Most crossings of one line: 1, 2 or 4.
    [[nodiscard]] int max_crossings() const;
    [[nodiscard]] double value(const Vec3& x) const override;
    [[nodiscard]] Vec3 gradient(const Vec3& x) const override;
    [[nodiscard]] FieldJet jet(const Vec3& x) const override;
    /// True where f has no zero in the box; exact for single boxes, so subdivision converges.
    [[nodiscard]] bool excludes(const Box& box) const override;
    /// All t in [t_lo, t_hi] with f(origin + t·direction) = 0 and a change of sign, ascending.
    /// Returns how many, at most max_crossings().
    int crossings(const Vec3& origin, const Vec3& direction, double t_lo, double t_hi,
                  std::span<double, kMaxCatalogueCrossings> t) const;

private:
    bool torus_ = false;
    Vec3 square_{0.0};    // quadric: q
    Vec3 linear_{0.0};    // quadric: l
    double constant_ = 0; // quadric: c
    double major_ = 0, minor_ = 0;
    Box bounds_;
};

}  // namespace pellucid
