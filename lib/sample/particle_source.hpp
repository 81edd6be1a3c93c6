// Where the particles of one object come from, for one view: random lines, a walk, a volume.
//
// A *trial* gives one particle or none. Whatever the object, every trial of block b lands on an area element dA (of a
// surface) with probability  w dA·τ(x)/τ / (s(x)·V_b),  w = 1 (oblique law) or |cosθ| (constant law), τ(x)/τ = 1 but for
// slices; on a volume element dV with  σ(x) dV/(s(x)·V_b).  s(x) is the area that one pixel sees at x. A Poisson number
// of trials with mean optical_depth()·V_b in every block gives the object its opacity exactly, PBSR (1) in its limit.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/random.hpp"
#include "core/vec.hpp"
#include "field/isolation_stats.hpp"

namespace pellucid {

/// Opacities are taken as at most this: at 1 the number of particles is infinite.
inline constexpr double kMostParticleOpacity = 1 - 0x1p-20;

/// Repeats that share lines in fast mode: repeat/16 is the group.
inline constexpr std::uint32_t kLineGroup = 16;

/// A particle before it is packed.
struct SourcePoint {
    Vec3 view;         // view space
    Vec3 view_normal;  // for shading, view space; of painted sources the shaded colour
};

/// The object must outlive its source. Safe from several threads.
class ParticleSource {
public:
    using Point = SourcePoint;
    virtual ~ParticleSource() = default;

    /// Keys the random numbers: the object's place in the scene, volumes after surfaces.
    [[nodiscard]] virtual std::uint32_t object_id() const = 0;
    /// For messages: surface "ring".
    [[nodiscard]] virtual std::string label() const = 0;
    /// Whether points carry their colour, by twin::pack_paint.
    [[nodiscard]] virtual bool painted() const { return false; }
    /// τ above: −ln(1 − α) of a surface, its largest on a slice; 1 for volumes, whose V holds the extinction.
    [[nodiscard]] virtual double optical_depth() const = 0;
    /// V, Σ V_b; 0 where nothing can be seen.
    [[nodiscard]] virtual double virtual_pixels() const = 0;

    /// Pieces come in blocks of neighbours, which fit into a near cache together.
    [[nodiscard]] virtual std::size_t block_count() const = 0;
    [[nodiscard]] virtual double block_virtual_pixels(std::size_t block) const = 0;
    /// Holds all of a block's points, world; empty where it is not known.
    [[nodiscard]] virtual std::optional<Box> block_bounds(std::size_t) const { return std::nullopt; }
    /// Appends the points of trials first … first + count − 1 of a block in a repeat, in their order: functions of seed,
    /// object, repeat, block and index alone.
    virtual void trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first,
                                 std::uint32_t count, std::vector<Point>& out) const = 0;
    /// One trial anywhere on the object; walks have none (has_single_trials).
    [[nodiscard]] virtual std::optional<Point> trial(Seed seed, std::uint32_t repeat, std::uint64_t index) const = 0;
    [[nodiscard]] virtual bool has_single_trials() const { return true; }

    /// Fast mode: most crossings of the block's lines; 1: there is nothing to deal, and fast is exact mode.
    [[nodiscard]] virtual int block_crossings(std::size_t) const { return 1; }
    enum class Deal { apart, together };  // together: the wrong twin, for tests
    /// Lines 0 … count − 1 of a group; crossings are appended to the repeats they are dealt to. Precondition:
    /// block_crossings(block) > 1.
    virtual void lines_in_block(std::size_t block, Seed seed, std::uint32_t group, std::uint32_t count, Deal deal,
                                std::span<std::vector<Point>, kLineGroup> out) const;

    [[nodiscard]] virtual std::size_t piece_count() const = 0;
    [[nodiscard]] virtual std::size_t bytes() const = 0;
    /// What went wrong so far, for a warning; empty: nothing.
    [[nodiscard]] virtual std::string complaint() const { return {}; }
    /// What fields could not decide so far.
    [[nodiscard]] virtual IsolationStats isolation() const { return {}; }
};

}  // namespace pellucid
