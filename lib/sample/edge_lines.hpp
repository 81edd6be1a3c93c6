// Random lines along the edges of a box: the arithmetic of a trial, one at a time and over SIMD lanes.
//
// Cauchy-Crofton for parallel lines: a line along edge e_a through a uniform point of the face across from it
// crosses the area element dA with normal n with probability |n·e_a| dA/volume. With the edge chosen with
// weights A_a R_a (A_a the face's area, R_a below) this is in proportion to Σ_a R_a |g_a| (g the gradient in
// the box's own coordinates), and thinning makes it the density that is wanted:
//   constant   |cosθ|/s ∝ |g·ρ|/z³, ρ = x − eye. With R_a the largest |ρ_a| in the box, z_l its least depth:
//              |g·ρ| <= Σ R_a |g_a|: a crossing is kept with probability (z_l/z)³ |g·ρ|/Σ R_a |g_a|.
//   oblique    1/s ∝ |r|/z³, r the point in view space. N = M g is the normal, R_a length of M's column a:
//              |N| <= Σ R_a |g_a|, kept with probability (least s/s) |N|/Σ R_a |g_a|.
// Orthographic views have z = |r| = 1 and the view's direction for ρ. Along an edge quadrics, the torus and
// trilinear cells have closed-form crossings.
//
// Scalar and SIMD functions do the same operations in the same order (+ − × ÷ √, no fused multiply-add):
// their results are equal to the last bit on every instruction set.
#pragma once

#include <array>
#include <cstdint>

#include "core/random.hpp"
#include "sample/alias_table.hpp"
#include "scene/camera.hpp"

namespace pellucid {

/// Places as kernels keep them.
[[nodiscard]] inline std::array<double, 3> triple(const Vec3& v) { return {v.x, v.y, v.z}; }
[[nodiscard]] inline Vec3 vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

/// Camera and opacity law as the trials need them, for one object.
struct LineView {
    bool perspective = true;
    bool constant_law = true;
    double near = 0, far = 0;
    double depth_scale = 1;                          // depths are scaled by it before they are cubed
    double x_lo = 0, x_hi = 0, y_lo = 0, y_hi = 0;   // of the image at depth 1
    std::array<std::array<double, 4>, 3> to_view{};  // object → view space
    std::array<std::array<double, 3>, 3> normal{};   // M: gradient → normal in view space
    std::array<double, 3> reach{};                   // R where it does not depend on the place
    std::array<double, 3> eye{};           // in object space: the eye, or the view's direction (orthographic)
    std::array<double, 3> camera_place{};  // world

    LineView() = default;
    LineView(const Camera& camera, const Affine& to_world, bool constant);
};

/// Lines along one edge of a box in object space, and what they meet: a quadric or a torus.
struct BoxLines {
    enum class Kind : std::uint8_t { plane, quadric, torus_along, torus_across };  // what a line sees
    Kind kind = Kind::quadric;
    int axis = 0;
    int labels = 1;  // crossings that a line may have: sign and ring of a root
    bool both_signs = false;
    bool negative = false;    // the sign, where there is only one
    bool both_rings = false;  // of a torus: inside and outside of the circle in its middle
    bool inner = false;       // the ring, where there is only one
    std::array<double, 3> lo{}, size{};
    double root_lo = 0, root_hi = 0;           // half-open: of two neighbours one takes it
    std::array<double, 3> square{}, linear{};  // f = Σ square x² + linear x + constant
    double constant = 0;
    double inverse = 0;  // of the coefficient along the axis, negative
    double major = 0, minor = 0;
    std::array<double, 3> reach{};  // R
    double bound = 0;               // z_l³, or least s
};

/// A cell of a trilinear field, a cache line.
struct alignas(64) CellRecord {
    std::array<float, 8> corner{};       // x fastest
    std::array<std::int32_t, 3> base{};  // its first sample
    std::uint32_t patch = 0;
    double bound = 0;  // as in BoxLines
};
static_assert(sizeof(CellRecord) == 64);

struct FlatPiece {
    std::uint32_t triangle = 0;
    std::int32_t part = -1;  // -1: a whole patch
    double bound = 0;  // as in BoxLines; a throw is kept with (z_l/z)³ or least s/s
};
static_assert(sizeof(FlatPiece) == 16);

/// Triangles, or parallelograms by three of their corners.
struct FlatBlock {
    const double* positions = nullptr;         // three a vertex, world
    const std::uint32_t* triangles = nullptr;  // three a piece
    const FlatPiece* pieces = nullptr;
    bool fold = true;  // a triangle: u + v > 1 is folded back
};

struct CellBlock {
    const CellRecord* cells = nullptr;
    double isovalue = 0;
    int axis = 0;
};

/// A point that was kept.
struct LinePoint {
    std::array<double, 3> view{};
    std::array<double, 3> normal{};  // view space; of flat pieces not set
    std::array<double, 3> place{};   // object space; flat pieces: (u, v, 0)
};

/// One crossing of one line; `u`, `v`, `chance` in (0, 1).
[[nodiscard]] bool cross_box(const LineView& view, const BoxLines& lines, int label, double u, double v,
                             double chance, LinePoint& out);
[[nodiscard]] bool cross_cell(const LineView& view, const CellRecord& cell, double isovalue, int axis,
                              double u, double v, double chance, LinePoint& out);
[[nodiscard]] bool throw_flat(const LineView& view, const FlatBlock& block, std::uint32_t piece, double u,
                              double v, double chance, LinePoint& out);

/// Whether a crossing at `x` (object space) with gradient `g` is kept; then `out` holds it. The payment is bound,
/// what it is compared with grows with `reach`.
[[nodiscard]] bool keep_crossing(const LineView& view, const std::array<double, 3>& x,
                                 const std::array<double, 3>& g, const std::array<double, 3>& reach, double bound,
                                 double chance, LinePoint& out);

/// Which random numbers: blocks 0 and 1 of Philox at (seed, object, repeat, block·2^32 + index).
struct LineKeys {
    std::uint64_t seed = 0;
    std::uint32_t object = 0;
    std::uint32_t repeat = 0;
    std::uint32_t block = 0;  // < 2^24
};

/// Lines are handled by so many at once, to stay in the first-level cache.
inline constexpr std::uint32_t kLineChunk = 256;
inline constexpr std::size_t kChunkRoom = kLineChunk + 16;  // whole vectors are stored

/// The random numbers of a chunk of lines: a place on a face, a choice and the chance of being kept.
struct alignas(64) LineWords {
    double u[kChunkRoom], v[kChunkRoom], chance[kChunkRoom];
    std::uint64_t choice[kChunkRoom];  // 32 bits
    std::uint64_t piece[kChunkRoom];   // where a table has several
};
/// Lines first … first + count − 1, count <= kLineChunk. `table` may be null.
void draw_words(const LineKeys& keys, const AliasTable* table, std::uint32_t first, std::uint32_t count,
                LineWords& out);

/// Points that were kept, in the order of their lines.
struct alignas(64) PointChunk {
    double view[3][kChunkRoom];
    double normal[3][kChunkRoom];
    double place[3][kChunkRoom];
    std::uint64_t piece[kChunkRoom];
    std::uint64_t line[kChunkRoom];  // of the chunk, from 0
    std::size_t count;
};

/// The functions above for a chunk of lines. Boxes: crossing `label` of every line with the chance turned
/// round by label/labels; or, for label < 0, the crossing that the line's choice names.
void cross_boxes(const LineView& view, const BoxLines& lines, int label, const LineWords& words,
                 std::uint32_t count, PointChunk& out);
void cross_cells(const LineView& view, const CellBlock& block, const LineWords& words, std::uint32_t count,
                 PointChunk& out);
void throw_flats(const LineView& view, const FlatBlock& block, const LineWords& words, std::uint32_t count,
                 PointChunk& out);

/// The crossing that a line's choice names in exact mode: its top bits.
[[nodiscard]] inline int chosen_label(std::uint32_t choice, int labels) {
    return static_cast<int>((std::uint64_t{choice} * static_cast<std::uint64_t>(labels)) >> 32U);
}
/// Chances of the crossings of one line: each uniform, apart from each other as far as can be.
[[nodiscard]] inline double turned_chance(double chance, int label, int labels) {
    const double sum = chance + static_cast<double>(label) / labels;
    return sum < 1 ? sum : sum - 1;
}

}  // namespace pellucid
