// Particles uniform on a surface by random lines (Cauchy-Crofton), for one view.
//
// A *trial* picks a piece of the surface, shoots a uniform random line through the piece's convex
// body, draws j uniform in 1…K (K = most crossings of a line) and keeps crossing j if there is one:
// never two of one line, so particles are independent. Whatever the surface, every trial lands on an
// area element dA with probability
//     dA / (s(x)·V),      V = Σ_pieces K · crofton_area / least s on the piece,
// s(x) the area one pixel sees at x (a crossing is kept with probability least s/s(x)). No area needs
// to be known: PBSR (1) holds with trials for particles and V for S/s, pixels on the surface:
//     α = 1 − (1 − 1/V)^trials.
// A flat body is met once by every line through it, so its trial is a uniform point on it. Cells of a
// trilinear field are met once at most by lines along their edges: they throw their points themselves
// (SurfaceGeometry::throw_point), with their throw_area in place of K·crofton_area.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/random.hpp"
#include "sample/alias_table.hpp"
#include "sample/particle_set.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

/// Opacities are taken as at most this: at 1 the number of particles is infinite.
inline constexpr double kMostParticleOpacity = 1 - 0x1p-20;

class LineSampler {
public:
    /// Cuts the surface into pieces for the view: what is surely out of view or empty is left out, and
    /// pieces over which s varies much are cut smaller where that saves trials. `object_id` keys the random numbers.
    /// The object must outlive the sampler.
    LineSampler(const Object& object, const Camera& camera, std::uint32_t object_id);

    /// V above; 0 where nothing can be seen.
    [[nodiscard]] double virtual_pixels() const { return virtual_pixels_; }
    [[nodiscard]] std::size_t piece_count() const { return pieces_.size(); }
    [[nodiscard]] std::size_t bytes() const;
    [[nodiscard]] const Object& object() const { return *object_; }
    [[nodiscard]] std::uint32_t object_id() const { return object_id_; }

    struct Point {
        Vec3 view;         // view space
        Vec3 view_normal;  // for shading, view space
    };
    /// One trial: a point in view, or none. Points follow the surface's opacity law: for `constant`
    /// a particle is kept with probability |cosθ|.
    [[nodiscard]] std::optional<Point> trial(Seed seed, std::uint32_t repeat, std::uint64_t index) const;
    /// All crossings of a line at once, as no sampler should: dependent particles in one repeat.
    /// Kept as the wrong twin of `trial` that the tests must reject: K times as many points a line. For
    /// surfaces whose pieces do not throw themselves.
    int trial_keeping_all(Seed seed, std::uint32_t repeat, std::uint64_t index,
                          std::span<Point, kMaxCrossings> out) const;
    [[nodiscard]] int max_crossings() const { return object_->geometry->max_crossings(); }

    /// Pieces come in blocks of neighbours, which fit into a near cache together: trials taken block by
    /// block (a Poisson number in each) are several times as fast as trials all over the surface.
    [[nodiscard]] std::size_t block_count() const { return blocks_.size(); }
    [[nodiscard]] double block_virtual_pixels(std::size_t block) const { return blocks_[block].virtual_pixels; }
    [[nodiscard]] std::optional<Point> trial_in_block(std::size_t block, Seed seed, std::uint32_t repeat,
                                                      std::uint32_t index) const;

private:
    struct Piece {
        std::uint32_t patch;
        std::int32_t part;      // index into parts_, or −1: the patch's own body
        double least_area;      // least s
    };
    struct Block {
        std::size_t first_piece;
        double virtual_pixels;
        AliasTable pieces;
    };
    /// The random numbers of a trial: two blocks of the counter.
    struct Bits;

    double add_pieces(std::uint32_t patch, const Body& body, int depth, std::vector<double>& weights);
    void build_blocks(std::span<const double> weights);
    [[nodiscard]] const Piece& pick_piece(const Bits& bits) const;
    [[nodiscard]] std::optional<Point> trial_on(const Piece& piece, const Bits& bits) const;
    [[nodiscard]] int shoot(const Piece& piece, const std::array<std::uint32_t, 4>& bits, std::uint32_t more_bits,
                            std::span<Crossing, kMaxCrossings> hits, Vec3& origin, Vec3& direction) const;
    [[nodiscard]] bool throws_itself(const Piece& piece) const {
        return piece.part < 0 && object_->geometry->throw_area(piece.patch).has_value();
    }
    [[nodiscard]] std::optional<Point> keep(const Piece& piece, const SurfacePoint& at, double chance) const;

    const Object* object_;
    const Camera* camera_;
    std::uint32_t object_id_;
    double virtual_pixels_ = 0;
    std::vector<Piece> pieces_;
    std::vector<Body> parts_;
    std::vector<Block> blocks_;
    AliasTable block_table_;
};

}  // namespace pellucid
