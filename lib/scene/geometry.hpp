// Surfaces as geometry: every shape is a set of *patches*, and a patch is what a line can cross.
//
// Sampler and truth share this one view of a surface. A patch sits inside a convex body (a flat
// triangle or parallelogram, or a parallelepiped) and meets a line at most `max_crossings` times:
//   mesh       a triangle a patch          flat body    1 crossing
//   rectangle  one patch                   flat body    1
//   slice      one patch                   flat body    1
//   implicit   one patch, its bounds       box          1, 2 or 4
//   isosurface a cell of the grid a patch  cell         3 (a trilinear field is a cubic on a line)
//   … Catmull-Rom, a cell or part of one   box          9, most 1 along an axis
//   expression a cell of an octree a patch cell         1 in most, any number in few
//   points     a cell of an octree a patch cell         1 in most, any number in few
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/image.hpp"
#include "core/vec.hpp"
#include "field/catalogue.hpp"
#include "field/isolation_stats.hpp"
#include "field/scalar_field.hpp"
#include "io/mesh_file.hpp"
#include "scene/scene.hpp"

namespace pellucid {

class SurfaceCells;

/// A convex body in world space, spanned by edges from one corner.
struct Body {
    enum class Kind : std::uint8_t { triangle, parallelogram, parallelepiped };
    Kind kind = Kind::parallelepiped;
    Vec3 corner{0.0};
    Vec3 edge[3]{Vec3(0.0), Vec3(0.0), Vec3(0.0)};  // the third is unused where the body is flat

    [[nodiscard]] bool flat() const { return kind != Kind::parallelepiped; }
    /// Writes the 3, 4 or 8 vertices and returns how many.
    int vertices(std::span<Vec3, 8> out) const;
    [[nodiscard]] Box bounds() const;
    /// Flat: its area. Else half of its surface. Half the expected crossings of the body by the lines
    /// that meet it times this is the area of whatever lies inside (Cauchy-Crofton).
    [[nodiscard]] double crofton_area() const;
};

/// A box of a space that a map carries into the world.
[[nodiscard]] Body body_of(const Box& box, const Affine& to_world);

/// Where a line crosses a surface.
struct Crossing {
    double t = 0;          // along the line
    Vec3 normal{0.0};      // geometric, world; not normalised, never zero
};

/// What a line met. Lists are meant to be used again, so that nothing is allocated.
struct CrossingList {
    std::vector<Crossing> hits;  // of the last call
    IsolationStats stats;        // of all calls: what fields could not decide

    [[nodiscard]] const Crossing& operator[](std::size_t i) const { return hits[i]; }
};

/// f = 0 inside the bounds, in object space: one patch.
struct ImplicitPatch {
    const CatalogueSurface* field;
    Box bounds;
    Affine to_world;
};

/// f = 0 of a formula, a volume or points, in cells: a cell a patch. Object space.
struct FieldPatches {
    const SurfaceCells* cells;
    Affine to_world;
};

/// f = isovalue in cells of a grid, trilinear in each: a cell a patch. Object space counts samples.
struct TrilinearPatches {
    double isovalue;
    Affine to_world;
};
struct TrilinearCorners {
    std::array<std::int32_t, 3> base;  // its first sample
    std::array<float, 8> value;        // x fastest
};

/// origin + t·direction for t in [t_lo, t_hi], in world space.
struct Line {
    Vec3 origin;
    Vec3 direction;
    double t_lo;
    double t_hi;
};

/// An image on a parallelogram: columns run along u, the top row is at center + v.
struct SurfaceTexture {
    const Image* image;
    Vec3 center, u, v;  // world; half-edges
};

class SurfaceGeometry {
public:
    virtual ~SurfaceGeometry() = default;

    [[nodiscard]] virtual std::size_t patch_count() const = 0;
    [[nodiscard]] virtual Body body(std::size_t patch) const = 0;
    [[nodiscard]] virtual int max_crossings() const = 0;
    /// Every crossing of a line with the part of the surface in the patch's body, ascending in t: how many.
    virtual int crossings(std::size_t patch, const Line& line, CrossingList& out) const = 0;
    /// What the surface is where its lines along edges have closed-form crossings; both are empty elsewhere.
    [[nodiscard]] virtual std::optional<ImplicitPatch> implicit() const { return std::nullopt; }
    [[nodiscard]] virtual std::optional<TrilinearPatches> trilinear() const { return std::nullopt; }
    /// The cells of a formula's or a Catmull-Rom volume's surface; empty elsewhere.
    [[nodiscard]] virtual std::optional<FieldPatches> field() const { return std::nullopt; }
    /// f = 0 as a function, where the surface is one: implicit surfaces, formulas, isosurfaces, points.
    [[nodiscard]] virtual std::optional<FieldSurface> field_surface() const { return std::nullopt; }
    /// Precondition: trilinear() has a value.
    [[nodiscard]] virtual TrilinearCorners cell(std::size_t patch) const;
    /// True where the part of the patch inside `part` (a parallelepiped within its body) is surely empty.
    [[nodiscard]] virtual bool excludes(std::size_t patch, const Body& part) const;
    /// Normal for shading at a point of the patch, world, not normalised.
    [[nodiscard]] virtual Vec3 shading_normal(std::size_t patch, const Vec3& point,
                                              const Vec3& geometric) const;
    [[nodiscard]] virtual Box bounds() const = 0;
    /// Colour that replaces the surface's own, linear: rectangles with an image, slices.
    [[nodiscard]] virtual bool has_color() const { return false; }
    /// Largest of each channel of it.
    [[nodiscard]] virtual Vec3 brightest() const { return Vec3(1.0); }
    /// Share of the surface's opacity that counts at a point, [0, 1]: of slices; and the largest of all.
    [[nodiscard]] virtual double opacity_at(const Vec3&) const { return 1; }
    [[nodiscard]] virtual double most_opacity() const { return 1; }
    /// True where particles must carry their colour, and opacity_at is not 1 all over.
    [[nodiscard]] virtual bool painted() const { return false; }
    [[nodiscard]] virtual std::optional<SurfaceTexture> texture() const { return std::nullopt; }
    [[nodiscard]] virtual Vec3 color(const Vec3& point) const;
    /// The triangles in world space, where the patches are triangles.
    [[nodiscard]] virtual const TriangleMesh* mesh() const { return nullptr; }
    /// Bytes held.
    [[nodiscard]] virtual std::size_t bytes() const = 0;
};

/// True where this program can turn the shape into geometry (all but isosurfaces of "nearest").
[[nodiscard]] bool has_geometry(const Shape& shape);

/// Reads files and builds the geometry of one surface. Throws Error(input) naming surface and file.
/// A surface without any patch (an isovalue that is never crossed) is legal and warned of.
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_geometry(const Surface& surface);

/// Triangles that were made, not read, in world space; normals of unit length or zero, or none.
[[nodiscard]] std::unique_ptr<SurfaceGeometry> make_mesh_geometry(TriangleMesh world);

}  // namespace pellucid
