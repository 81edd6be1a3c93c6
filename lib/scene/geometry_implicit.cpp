// Catalogue surfaces. Closed forms: one patch, their bounds. Formulas: as any other formula.
#include <algorithm>

#include "field/catalogue.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

/// Of the diagonal: far above rounding, far below what it costs in trials.
constexpr double kRoom = 1e-6;

class ImplicitGeometry final : public SurfaceGeometry {
public:
    ImplicitGeometry(CatalogueSurface field, const Box& bounds, const Affine& to_world)
        : field_(std::move(field)), bounds_(bounds), to_world_(to_world), to_object_(to_world.inverse()) {}

    [[nodiscard]] std::size_t patch_count() const override { return bounds_.empty() ? 0 : 1; }
    [[nodiscard]] int max_crossings() const override { return field_.max_crossings(); }

    /// The bounds and a hair around them: a surface that lies in a face of its bounds (a plane may) is
    /// then inside the body, and not lost where rounding puts the body's face before it.
    [[nodiscard]] Body body(std::size_t) const override {
        const Vec3 room(kRoom * length(bounds_.size()));
        return body_of({bounds_.lo - room, bounds_.hi + room}, to_world_);
    }

    int crossings(std::size_t, const Line& line, CrossingList& out) const override {
        out.hits.clear();
        // Affine maps keep t. Clip to the bounds, where coordinates are no larger than the surface.
        const Vec3 origin = to_object_.point(line.origin);
        const Vec3 direction = to_object_.vector(line.direction);
        double lo = line.t_lo;
        double hi = line.t_hi;
        for (int axis = 0; axis < 3; ++axis) {
            if (direction[axis] == 0) {
                if (origin[axis] < bounds_.lo[axis] || origin[axis] > bounds_.hi[axis]) return 0;
                continue;
            }
            const double a = (bounds_.lo[axis] - origin[axis]) / direction[axis];
            const double b = (bounds_.hi[axis] - origin[axis]) / direction[axis];
            lo = std::max(lo, std::min(a, b));
            hi = std::min(hi, std::max(a, b));
        }
        if (!(lo <= hi)) return 0;
        // A hair beyond the box: a surface may touch it (a sphere does at six points, a plane that is
        // as thin as its box does everywhere). Never beyond what the caller asked for.
        const double hair = 1e-9 * (hi - lo) + 1e-12 * std::max(std::abs(lo), std::abs(hi));
        std::array<double, kMaxCatalogueCrossings> t{};
        const int found = field_.crossings(origin, direction, std::max(line.t_lo, lo - hair),
                                           std::min(line.t_hi, hi + hair), t);
        for (int i = 0; i < found; ++i) {
            const double root = t[static_cast<std::size_t>(i)];
            out.hits.push_back({root, world_normal(origin + root * direction, direction)});
        }
        return found;
    }

    [[nodiscard]] std::optional<ImplicitPatch> implicit() const override {
        return ImplicitPatch{&field_, bounds_, to_world_};
    }

    [[nodiscard]] std::optional<FieldSurface> field_surface() const override {
        return FieldSurface{&field_, bounds_, to_world_};
    }

    [[nodiscard]] bool excludes(std::size_t, const Body& part) const override {
        std::array<Vec3, 8> corners;
        const int count = part.vertices(corners);
        Box box;
        for (int i = 0; i < count; ++i) box.include(to_object_.point(corners[static_cast<std::size_t>(i)]));
        return field_.excludes(box);
    }

    [[nodiscard]] Box bounds() const override { return body(0).bounds(); }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this); }

private:
    /// At a singular point (a cone's tip) there is no normal: the line's own direction stands in.
    [[nodiscard]] Vec3 world_normal(const Vec3& x, const Vec3& direction) const {
        const Vec3 normal = to_world_.normal(field_.gradient(x));
        return normal == Vec3(0.0) ? -to_world_.vector(direction) : normal;
    }

    CatalogueSurface field_;
    Box bounds_;
    Affine to_world_;
    Affine to_object_;
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_implicit(const Surface& surface, const ImplicitShape& shape) {
    const CatalogueEntry& entry = catalogue_entry(shape.name);
    if (entry.is_formula()) {
        const CatalogueFormula formula = catalogue_formula(entry, shape.parameters);
        return make_field(surface, formula.field, surface.bounds.value_or(formula.bounds));
    }
    CatalogueSurface field(shape.name, shape.parameters);
    Box bounds = field.bounds();
    if (surface.bounds) {
        // Where the equation goes on for ever the scene's bounds replace the catalogue's, unless a
        // height was asked for; everywhere else they cut.
        const bool replace = !field.bounded() && !shape.parameters.contains("height");
        bounds = replace
                     ? *surface.bounds
                     : Box{glm::max(bounds.lo, surface.bounds->lo), glm::min(bounds.hi, surface.bounds->hi)};
    }
    if (!bounds.empty() && field.excludes(bounds)) bounds = {};  // nothing of it is inside
    return std::make_unique<ImplicitGeometry>(std::move(field), bounds, surface.to_world);
}

}  // namespace pellucid
