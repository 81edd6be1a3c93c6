// Particles of a surface by random lines (Cauchy-Crofton), for one view.
//
// A *trial* picks a piece of the surface, throws a random line through it, draws one of the K crossings that
// the line may have and keeps it if it is there: never two of one line, so particles are independent.
// Whatever the surface and its opacity law, every trial lands on an area element dA with probability
//     w dA / (s(x)·V),      w = 1 (oblique law) or |cosθ| (constant law),
// s(x) the area one pixel sees at x, by thinning of what the lines give. No area needs to be known: PBSR (1)
// holds with trials for particles and V for S/s, pixels on the surface:
//     α = 1 − (1 − 1/V)^trials.
// The fewer pixels V, the fewer trials:
//   catalogue surfaces   lines along the edges of boxes that hold it     K = 1, 2 or 4   edge_lines.hpp
//   trilinear cells      lines along the edges of the cell               K = 1           edge_lines.hpp
//   formulas' cells      lines along the one edge that suits     K = 1           field_lines.hpp
//   … where none does    lines along all edges of the cell       K by degree and intervals
//   triangles            uniform points                                  K = 1           triangle_throws.hpp
//   other flat bodies    uniform points                                  K = 1           edge_lines.hpp
//   parts of cut cells   uniform random lines through the piece's body   K = max_crossings;
//                        then V = K · Crofton's area / least s, and w is paid in trials
//
// *Fast mode* (`lines_in_block`) keeps all crossings of a line and deals them to different repeats of a group
// of kLineGroup: crossing l to repeat start + l·step mod 16, start uniform, step odd. With Poisson(16·τ·V/K)
// lines a group every repeat is the process of exact mode: (1) a line gives a repeat at most one point, so
// the points of one repeat are a thinned and mapped Poisson process of lines, which is Poisson (marking
// theorem); (2) every crossing comes to a repeat with chance 1/16, so its intensity is
// 16·τ·(V/K)·(K/V)·w dA/s / 16 = τ w dA/s. Repeats of one group depend on each other, and only by where the
// crossings of one line lie.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/random.hpp"
#include "field/surface_cells.hpp"
#include "sample/alias_table.hpp"
#include "sample/edge_lines.hpp"
#include "sample/field_lines.hpp"
#include "sample/particle_set.hpp"
#include "sample/particle_source.hpp"
#include "sample/triangle_throws.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

class LineSampler final : public ParticleSource {

public:
    /// Cuts the surface into pieces for the view: what is surely out of view or empty is left out, and
    /// pieces over which s varies much are cut smaller where that saves trials. `object_id` keys the random
    /// numbers. The object must outlive the sampler.
    ///   lights  must outlive it, too; asked for by objects that are painted only
    LineSampler(const Object& object, const Camera& camera, std::uint32_t object_id, std::span<const Light> lights = {});

    /// V above; 0 where nothing can be seen.
    [[nodiscard]] double virtual_pixels() const override { return virtual_pixels_; }
    [[nodiscard]] std::size_t piece_count() const override {
        return flats_.size() + cells_.size() + box_count_ + pieces_.size() + fields_.size() + field_cells_;
    }
    [[nodiscard]] std::size_t bytes() const override;
    [[nodiscard]] const Object& object() const { return *object_; }
    [[nodiscard]] std::uint32_t object_id() const override { return object_id_; }
    [[nodiscard]] std::string label() const override;
    [[nodiscard]] double optical_depth() const override;
    [[nodiscard]] bool painted() const override { return object_->geometry->painted(); }

    /// What fields could not decide so far; crossings beyond K count as undecided.
    [[nodiscard]] IsolationStats isolation() const override;

    /// One trial: a point in view, or none.
    [[nodiscard]] std::optional<Point> trial(Seed seed, std::uint32_t repeat, std::uint64_t index) const override;
    /// All crossings of a random line at once, as no sampler should: dependent particles in one repeat.
    /// Kept as the wrong twin of `trial` that the tests must reject: `line_pixels` takes the place of V. For
    /// surfaces of one patch that is not flat.
    void trial_keeping_all(Seed seed, std::uint32_t repeat, std::uint64_t index,
                           std::vector<Point>& out) const;
    [[nodiscard]] double line_pixels() const;

    /// Trials taken block by block (a Poisson number in each) are many times as fast as trials all over the surface.
    [[nodiscard]] std::size_t block_count() const override { return blocks_.size(); }
    [[nodiscard]] double block_virtual_pixels(std::size_t block) const override {
        return blocks_[block].virtual_pixels;
    }
    [[nodiscard]] std::optional<Box> block_bounds(std::size_t block) const override;
    [[nodiscard]] std::optional<Point> trial_in_block(std::size_t block, Seed seed, std::uint32_t repeat,
                                                      std::uint32_t index) const;
    /// Equal to `trial_in_block` to the last bit: SIMD.
    void trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first,
                         std::uint32_t count, std::vector<Point>& out) const override;

    [[nodiscard]] int block_crossings(std::size_t block) const override;
    void lines_in_block(std::size_t block, Seed seed, std::uint32_t group, std::uint32_t count, Deal deal,
                        std::span<std::vector<Point>, kLineGroup> out) const override;

private:
    /// A piece for uniform random lines.
    struct Piece {
        std::uint32_t patch;
        std::int32_t part;  // index into parts_, or −1: the patch's own body
        double least_area;  // least s
    };
    /// A cell of a formula, or part of one, in which lines along an axis may have several roots.
    struct FieldLines {
        FieldPiece piece;  // without its reach
        std::array<double, 3> reach;
        std::uint32_t cell;
        int axis;
    };
    enum class Kind : std::uint8_t { flat_patches, flat_parts, cells, box, fields, field_lines, lines };
    struct Block {
        Kind kind;
        int axis;
        int labels;  // K
        std::size_t first;  // of its pieces
        std::size_t count;
        double virtual_pixels;
        AliasTable table;
        BoxLines box;
    };
    struct Weights;
    struct Doubts {
        std::atomic<std::uint64_t> undecided = 0, touching = 0, poles = 0, exact = 0;

        void add(const IsolationStats& more) {
            if (more.undecided != 0) undecided += more.undecided;
            if (more.touching != 0) touching += more.touching;
            if (more.poles != 0) poles += more.poles;
            if (more.exact != 0) exact += more.exact;
        }
    };
    /// The random numbers of a trial: two blocks of the counter.
    struct Bits;

    [[nodiscard]] double edge_weight(const Affine& to_world, const Box& box, int axis, double reach,
                                     double least_depth, double least_area) const;
    [[nodiscard]] double edge_bound(double least_depth, double least_area) const;
    double add_boxes(const ImplicitPatch& patch, const Box& box, int depth, double most);
    double add_pieces(std::uint32_t patch, const Body& body, int depth, Weights& weights);
    double add_cell(std::uint32_t patch, const Body& body, double least_depth, double least_area,
                    Weights& weights);
    void add_fields(const SurfaceCells& cells, Weights& weights);
    double add_field(const SurfaceCells& cells, std::uint32_t index, const SurfaceCell& cell, const Box& box, int depth,
                     Weights& weights) const;
    [[nodiscard]] double field_reach(const SurfaceCell& cell, const Box& box, std::size_t axis) const;
    void add_blocks(Kind kind, int axis, int labels, std::size_t offset, std::span<const double> weights);

    void make_records();
    [[nodiscard]] TriangleBlock triangle_block(const Block& block) const;
    [[nodiscard]] FlatBlock flat_block(const Block& block) const;
    [[nodiscard]] CellBlock cell_block(const Block& block) const;
    [[nodiscard]] FieldBlock field_block(const Block& block) const;
    /// Blocks whose kernels give points of object space, ready but for clip planes.
    [[nodiscard]] static bool gives_object_points(const Block& block) {
        return block.kind == Kind::cells || block.kind == Kind::box || block.kind == Kind::fields ||
               block.kind == Kind::field_lines;
    }
    [[nodiscard]] const AliasTable* table(const Block& block) const {
        return block.kind == Kind::box ? nullptr : &block.table;
    }
    /// `choice`: 32 random bits that nothing else of the trial depends on.
    [[nodiscard]] std::optional<Point> finish(const Block& block, std::uint32_t piece, const LinePoint& found,
                                              std::uint32_t choice) const;
    [[nodiscard]] std::optional<Point> paint(const Vec3& view, const Vec3& world, const Vec3& normal,
                                             std::uint32_t choice) const;
    [[nodiscard]] std::optional<Point> trial_on(const Block& block, const Bits& bits) const;
    /// Roots of the line through `place`, which is set on the face across the piece's axis; they hold until the next call.
    [[nodiscard]] std::span<const FieldRoot> field_roots(const FieldLines& piece, int labels, double u,
                                                         double v, Vec3& place) const;
    [[nodiscard]] std::optional<Point> keep_field_root(const Block& block, const FieldLines& piece, Vec3 place,
                                                       const FieldRoot& root, double chance) const;
    const Body& body_of_piece(const Piece& piece, Body& own) const;
    [[nodiscard]] std::optional<Point> shoot_and_keep(const Piece& piece, const Bits& bits) const;
    [[nodiscard]] std::optional<Point> keep(std::uint32_t patch, const Crossing& hit, const Vec3& world,
                                            double least_area, double chance) const;
    void finish_chunk(const Block& block, const LineWords& words, const PointChunk& chunk, std::vector<Point>& out) const;

    const Object* object_;
    const Camera* camera_;
    std::uint32_t object_id_;
    std::span<const Light> lights_;
    Vec3 brightest_{0.0};  // of painted objects
    double virtual_pixels_ = 0;
    bool clipped_ = false;  // points must be asked for Object::keeps
    Affine to_world_;       // from the space in which edges are axes
    double isovalue_ = 0;
    LineView view_;
    LineView flat_view_;  // of world space
    std::vector<Piece> pieces_;
    std::vector<Body> parts_;
    std::vector<CellRecord> cells_;
    std::vector<FieldPiece> fields_;
    std::vector<std::uint32_t> fields_cell_;  // one a piece of fields_
    std::vector<FieldLines> field_lines_;
    std::size_t field_cells_ = 0;  // that field_lines_ serve
    std::shared_ptr<const FieldPrograms> programs_;
    std::shared_ptr<Doubts> doubts_;
    std::vector<FlatPiece> flats_;
    std::vector<TriangleRecord> records_;  // of flats_ that are whole patches
    std::size_t flat_parts_ = 0;       // the first of flats_ that is a part, once all are there
    std::vector<Vec3> own_positions_;  // of flat bodies that are no whole triangle of a mesh
    std::vector<std::array<std::uint32_t, 3>> own_triangles_;
    std::vector<std::uint32_t> own_patches_;
    std::size_t box_count_ = 0;
    std::vector<Block> blocks_;
    AliasTable block_table_;
};

}  // namespace pellucid
