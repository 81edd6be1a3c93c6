// Hits of rays through closed meshes: their number is even, and what exact arithmetic says.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/random.hpp"
#include "study/trust_rays.hpp"

namespace pellucid {

/// Where rays go.
enum class Aim {
    random,       // uniform among the lines that meet the sphere around the mesh, 16 neighbours parallel
    vertex,       // through a vertex, any direction
    edge_middle,  // through the middle of a triangle's edge
    along_edge,   // along a triangle's edge
    axis_vertex,  // through a vertex, along x, y or z
};
[[nodiscard]] const char* name_of(Aim aim);
inline constexpr Aim kAims[] = {Aim::random, Aim::vertex, Aim::edge_middle, Aim::along_edge,
                                Aim::axis_vertex};

/// Ray number `number` of this aim.
[[nodiscard]] Ray aimed_ray(const LineShooter& shooter, const TriangleMesh& mesh, Aim aim, Seed seed,
                            std::uint64_t number);

/// All hits of some rays: the truth's, or a twin's.
using Gather = std::function<void(std::span<const Ray>, std::vector<std::vector<RayHit>>&)>;

struct ParityCount {
    std::uint64_t rays = 0;
    std::uint64_t hits = 0;
    std::uint64_t odd = 0;  // rays with an odd number of hits
    std::uint64_t odd_short =
        0;  // of them: fewer hits than exact arithmetic finds; random rays, and checked ones
    std::uint64_t checked = 0;  // rays spread evenly over all, compared with exact arithmetic
    std::uint64_t lost = 0;     // of them: rays with too few hits
    std::uint64_t doubled = 0;  // rays with too many
    std::uint64_t swapped = 0;  // as many, but other triangles: neighbours of those

    [[nodiscard]] bool operator==(const ParityCount&) const = default;
    ParityCount& operator+=(const ParityCount& more);
};

struct ParityPlan {
    Aim aim = Aim::random;
    std::uint64_t rays = 0;
    std::uint64_t checked = 0;
    Seed seed;
};

/// On all threads; the same for any number of them.
[[nodiscard]] ParityCount count_parity(const TriangleMesh& mesh, const LineShooter& shooter,
                                       const Gather& gather, const ParityPlan& plan);

/// What Embree's tolerance alone makes of a random ray, per hit: each of a triangle's three sides lets pass a
/// strip of width 2^-23 of the height over it, 2·2^-23 of the area, where the neighbour is hit as well.
inline constexpr double kExtraPerHit = 6 * kEmbreeTolerance;

}  // namespace pellucid
