// Random lines along the edges of cells of formulas, volumes and points: one trial at a time and over SIMD lanes.
//
// In a cell where ∂f/∂a keeps its sign, lines along axis a alone give every part of the surface its chance: they
// cross the area element dA with probability |n·e_a| dA/volume (edge_lines.hpp), and with R_a the largest
// |g·ρ|/|g_a| in the cell (constant law) or |N|/|g_a| (oblique) a crossing is kept with probability
// (z_l/z)³ |g·ρ|/(R_a |g_a|), or its like. Such a line has one root at most, and the signs at both ends tell.
//
// Scalar and SIMD functions do the same operations in the same order.
#pragma once

#include <array>
#include <cstdint>

#include "field/expression.hpp"
#include "field/point_evaluator.hpp"
#include "field/surface_cells.hpp"
#include "sample/edge_lines.hpp"

namespace pellucid {

/// A box in object space in which f is monotone along one axis, a cache line.
struct alignas(64) FieldPiece {
    std::array<double, 3> lo{}, hi{};
    double reach = 0;  // R along the axis
    double bound = 0;  // as in BoxLines
};
static_assert(sizeof(FieldPiece) == 64);

/// The programs of one formula, ready for many points.
struct FieldPrograms {
    explicit FieldPrograms(const Expression& f)
        : field(f),
          value(f.value()),
          slope{PointEvaluator(f.slope(0)), PointEvaluator(f.slope(1)), PointEvaluator(f.slope(2))},
          gradient(f.gradient()) {}

    Expression field;
    PointEvaluator value;
    std::array<PointEvaluator, 3> slope;
    PointEvaluator gradient;
};

struct FieldBlock {
    const FieldPiece* pieces = nullptr;
    const FieldPrograms* programs = nullptr;  // of a formula; else the two that follow
    const SurfaceCells* cells = nullptr;
    const std::uint32_t* cell = nullptr;  // one a piece
    int axis = 0;
};

/// The crossing of one line, if it is kept; `u`, `v`, `chance` in (0, 1).
[[nodiscard]] bool cross_field(const LineView& view, const FieldBlock& block, std::uint32_t piece, double u, double v,
                               double chance, LinePoint& out);
/// The same for a chunk of lines.
void cross_fields(const LineView& view, const FieldBlock& block, const LineWords& words, std::uint32_t count,
                  PointChunk& out);

/// A root and the gradient there, or so near that it makes no difference.
struct FieldStep {
    double root = 0;
    std::array<double, 3> gradient{};
};
/// For the few lines that plain steps of Newton's do not serve: with halving, from the bracket.
[[nodiscard]] FieldStep refine_slowly(const Expression& field, std::size_t axis, std::array<double, 3> x, double lo,
                                      double hi, bool rising);
/// After a step of Newton's so small, of the bracket, the next would be smaller than 2^-34 of it times the bend of f,
/// which is below 1: 1e-12 of the surface, a thousandth of what a particle's depth resolves.
inline constexpr double kSmallStep = 0x1p-17;
/// Plain steps before a line is refined slowly.
inline constexpr int kPlainSteps = 3;

}  // namespace pellucid
