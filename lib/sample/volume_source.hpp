// Particles of a volume (PBVR: N. Sakamoto et al., Particle-based volume rendering, APVIS 2007), for one
// view.
//
// The density of opaque particles is what gives a ray of length Δt its opacity α = 1 − exp(−σ Δt):  ρ =
// σ/s(x) a volume a repeat, s(x) the area that one pixel sees at x. The volume is cut into boxes of whole
// cells (and of parts of cells close to the eye), each with a bound σ_max of the extinction in it; a trial is
// a uniform point of a box chosen by its V = volume·σ_max/least s, and is kept with probability  σ(x)/σ_max ·
// least s/s(x).
//
// *Too dense.* Where trials would be more than 2^32 a repeat, σ is taken as at most what gives a voxel, or a pixel's side
// if that is less, the opacity kMostParticleOpacity: all but layers thinner than these look the same.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "sample/alias_table.hpp"
#include "sample/particle_source.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

class VolumeSource final : public ParticleSource {
public:
    /// What density is: `extinction` as above. The others are wrong twins, for tests that must reject them.
    enum class Density { extinction, without_log, without_area };

    /// Volume `index` of a scene that must outlive it.
    VolumeSource(const PreparedScene& scene, std::size_t index, Density density = Density::extinction);

    [[nodiscard]] std::uint32_t object_id() const override { return object_id_; }
    [[nodiscard]] std::string label() const override;
    [[nodiscard]] bool painted() const override { return true; }
    [[nodiscard]] double optical_depth() const override { return 1; }
    [[nodiscard]] double virtual_pixels() const override { return virtual_pixels_; }
    [[nodiscard]] std::size_t block_count() const override { return blocks_.size(); }
    [[nodiscard]] double block_virtual_pixels(std::size_t block) const override {
        return blocks_[block].virtual_pixels;
    }
    [[nodiscard]] std::optional<Box> block_bounds(std::size_t block) const override;
    void trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first,
                         std::uint32_t count, std::vector<Point>& out) const override;
    [[nodiscard]] std::optional<Point> trial(Seed seed, std::uint32_t repeat,
                                             std::uint64_t index) const override;
    [[nodiscard]] std::size_t piece_count() const override { return pieces_.size(); }
    [[nodiscard]] std::size_t bytes() const override;
    [[nodiscard]] std::string complaint() const override;

private:
    /// A box of index space in which extinction is at most `most` and a pixel sees at least `least_area`.
    struct Piece {
        Vec3 lo, size;
        double most, least_area;
    };
    struct Block {
        std::size_t first, count;  // pieces
        double virtual_pixels;
        AliasTable table;
    };
    struct Words {
        double u, v, w, chance;
    };
    class Cutter;

    [[nodiscard]] std::optional<Point> trial_in(const Piece& piece, const Words& words) const;
    void find_pieces();
    [[nodiscard]] double density_of(double opacity) const;
    /// σ at most, where a pixel sees this area.
    [[nodiscard]] double most_density(double area) const;
    [[nodiscard]] Piece piece_of(const Box& box, double most, double least_area) const;
    [[nodiscard]] double pixels_of(const Piece& piece) const;

    const PreparedScene* scene_;
    const VolumeObject* volume_;
    Density density_;
    std::uint32_t object_id_;
    Vec3 brightest_;
    double scale_;          // world volume of a unit of index space
    double voxel_;          // least side of a voxel, world
    bool capped_ = false;   // σ
    Affine to_view_;        // of index space
    double mean_area_ = 1;  // of the wrong twin
    double virtual_pixels_ = 0;
    std::vector<Piece> pieces_;
    std::vector<Block> blocks_;
    AliasTable block_table_;
};

}  // namespace pellucid
