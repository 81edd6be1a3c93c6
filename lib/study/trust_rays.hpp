// Lines through a scene, all their crossings by the truth's own ray scene, and what exact arithmetic says of
// them.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/random.hpp"
#include "io/mesh_file.hpp"
#include "reference/ray_scene.hpp"

namespace pellucid {

/// 2^-53: what rounding to nearest may change a double by, as a share of it.
inline constexpr double kRoundoff = 0x1p-53;
/// Embree's edge tests let a ray pass that is outside by this share of the triangle's edge functions: 2^-23
/// (kernels/geometry/triangle_intersector_pluecker.h, `eps = ulp·|U+V+W|`).
inline constexpr double kEmbreeTolerance = 0x1p-23;

/// Uniform on the unit sphere, a function of its arguments alone.
[[nodiscard]] Vec3 random_direction(Seed seed, std::uint64_t number);
/// Three numbers in (0, 1).
[[nodiscard]] std::array<double, 3> random_numbers(Seed seed, std::uint64_t number, std::uint32_t block = 0);
/// Any two directions that make a right-handed frame with `along` (unit length).
struct Frame {
    Vec3 aside, up;
};
[[nodiscard]] Frame frame_around(const Vec3& along);

/// Rays that reach all of a scene made by scene_for_lines, whatever their direction.
class LineShooter {
public:
    explicit LineShooter(const PreparedScene& scene);

    /// The ray through `point` along `direction` (unit length), which it passes half-way between near and
    /// far.
    [[nodiscard]] Ray through(const Vec3& point, const Vec3& direction) const;
    /// As all crossings of `rays` (any number).
    void gather(std::span<const Ray> rays, std::vector<std::vector<RayHit>>& hits) const;

    [[nodiscard]] const Vec3& center() const { return center_; }
    /// Of a sphere around everything.
    [[nodiscard]] double radius() const { return radius_; }

private:
    RayScene rays_;
    Vec3 center_;
    double radius_;
    double t_middle_;
    double stretch_;
};

/// The triangles that a line meets, exactly: signs of determinants in double where their error bound allows,
/// else in rational numbers. Where the line meets an edge or a vertex, it is moved aside by an infinitely
/// small vector, the same for all triangles: a closed mesh is then met an even number of times, whatever the
/// ray. Ascending.
[[nodiscard]] std::vector<std::uint32_t> exact_crossings(const TriangleMesh& mesh, const Ray& ray);

/// 95 % (or `level`) bounds of a Poisson mean of which `events` were seen, exact (Garwood 1936).
struct CountBounds {
    double lo = 0, hi = 0;
};
[[nodiscard]] CountBounds poisson_bounds(double events, double level = 0.95);

}  // namespace pellucid
