// Multi-level partition of unity implicits: f through scattered points with normals, pieced together from local fits.
// Y. Ohtake, A. Belyaev, M. Alexa, G. Turk, H.-P. Seidel, Multi-level partition of unity implicits, SIGGRAPH 2003.
//
// An octree over a cube is cut where the fit of a cell misses its points; each leaf has a ball of ¾ of its diagonal, a fit
// Q_i in it (field/mpu_fit.hpp) and a weight w_i, a quadratic B-spline of the distance from its middle:
//   f = Σ w_i Q_i / Σ w_i
// is C¹ (but at edges and corners of sharp fits), signed like a distance, and below 0 inside.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "core/interval.hpp"
#include "field/mpu_fit.hpp"
#include "field/point_tree.hpp"
#include "field/scalar_field.hpp"

namespace pellucid {

struct MpuOptions {
    double accuracy = 1e-3;          // cells are cut while a fit misses a point by more, of the diagonal of the points
    std::size_t least_points = 30;   // a fit has so many; balls with fewer are enlarged for it, and not cut (noise: not 15)
    int most_depth = 20;             // <= kMpuMostDepth
    bool sharp = true;               // edges and corners
};
inline constexpr int kMpuMostDepth = 20;
/// Fewer (different) points than this have no surface.
inline constexpr std::size_t kMpuLeastPoints = 15;

/// One leaf in the unit cube, a cache line: its cube, and Q = edge·q((x − center)/edge). Floats hold centres exactly, and
/// what they hold of q *is* the fit.
struct alignas(64) MpuLeaf {
    std::array<float, 3> center{};
    float edge = 0;
    std::array<float, 10> q{};  // as Quadric::c
    Join join = Join::one;
    std::uint32_t rest = 0;     // of the pieces beyond the first
};
static_assert(sizeof(MpuLeaf) == 64);
/// Radius of a leaf's ball in edges, squared: (¾ √3)².
inline constexpr double kMpuSupport2 = 27.0 / 16;

/// |u| is 1.5 knots on the ball's surface, |u| in edges.
inline constexpr double kMpuPerEdge2 = 2.25 / kMpuSupport2;

/// The weight of a leaf at u from |u|², a quadratic B-spline of the distance; ∇w = −slope·u.
struct MpuWeight {
    double value = 0;
    double slope = 0;
    explicit MpuWeight(double u2) {
        if (!(u2 < kMpuSupport2)) return;
        const double t2 = kMpuPerEdge2 * u2;
        if (t2 < 0.25) {
            value = 0.75 - t2;
            slope = 2 * kMpuPerEdge2;
            return;
        }
        const double t = std::sqrt(t2);
        value = 0.5 * (1.5 - t) * (1.5 - t);
        slope = kMpuPerEdge2 * (1.5 / t - 1);
    }
};

/// What f and ∇f can be in a box. Empty gradients: not known.
struct MpuRange {
    Interval value;
    std::array<Interval, 3> gradient;
};

class MpuField final : public ScalarField {
public:
    /// Throws Error(input) where there are too few points. Duplicates are merged, and warned of; so are normals that
    /// contradict each other. The same for any number of threads.
    explicit MpuField(std::vector<OrientedPoint> points, const MpuOptions& options = {});

    /// The cube, object space: a little larger than the points' box. Beyond it f is NaN, or what reaches there.
    [[nodiscard]] const Box& bounds() const { return bounds_; }
    [[nodiscard]] double value(const Vec3& x) const override;
    /// At a kink those of the piece that decides.
    [[nodiscard]] FieldJet jet(const Vec3& x) const override;
    [[nodiscard]] bool excludes(const Box& box) const override;

    // -- in the unit cube, for mpu_cells

    [[nodiscard]] double size() const { return size_; }
    [[nodiscard]] Vec3 to_unit(const Vec3& x) const { return (x - bounds_.lo) / size_; }
    [[nodiscard]] std::span<const MpuLeaf> leaves() const { return leaves_; }
    /// Piece 1 or 2 of a leaf with several.
    [[nodiscard]] const std::array<float, 10>& piece(const MpuLeaf& leaf, std::size_t k) const {
        return k == 0 ? leaf.q : rest_[leaf.rest + k - 1];
    }
    /// Leaves whose balls meet a box, ascending.
    void leaves_at(const Box& unit_box, std::vector<std::uint32_t>& out) const;
    /// Over a box, from all leaves whose balls meet it; of f/size(). Sure but for 1e-13 of the cube.
    [[nodiscard]] MpuRange range(std::span<const std::uint32_t> leaves, const Box& unit_box) const;
    /// Points in the unit cube.
    [[nodiscard]] const PointTree& tree() const { return tree_; }
    /// Typical distance between neighbours among the points.
    [[nodiscard]] double spacing() const { return spacing_; }
    [[nodiscard]] std::size_t bytes() const;

private:
    struct Builder;
    template <class Visit>
    void visit(const Box& unit_box, const Visit& visit) const;

    Box bounds_;
    double size_ = 1;
    PointTree tree_;
    double spacing_ = 0;
    std::vector<std::uint32_t> nodes_;  // first of eight children, or kLeaf | leaf
    std::vector<MpuLeaf> leaves_;       // in the order of the octree
    std::vector<std::array<float, 10>> rest_;
};

}  // namespace pellucid
