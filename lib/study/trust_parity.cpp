#include "study/trust_parity.hpp"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <numbers>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

constexpr std::uint64_t kBlock = 4096;  // rays at a time

std::size_t pick(double u, std::size_t count) {
    return std::min(static_cast<std::size_t>(u * static_cast<double>(count)), count - 1);
}

std::vector<std::uint32_t> patches(const std::vector<RayHit>& hits) {
    std::vector<std::uint32_t> found;
    for (const RayHit& hit : hits) found.push_back(hit.patch);
    std::ranges::sort(found);
    return found;
}

}  // namespace

const char* name_of(Aim aim) {
    switch (aim) {
        case Aim::random:
            return "random";
        case Aim::vertex:
            return "vertex";
        case Aim::edge_middle:
            return "edge middle";
        case Aim::along_edge:
            return "along edge";
        case Aim::axis_vertex:
            return "vertex, along axis";
    }
    return "";
}

Ray aimed_ray(const LineShooter& shooter, const TriangleMesh& mesh, Aim aim, Seed seed,
              std::uint64_t number) {
    const auto [u, v, w] = random_numbers(seed, number);
    if (aim == Aim::random) {
        const Vec3 along = random_direction(seed, number / kPacket);
        const Frame frame = frame_around(along);
        const double r = shooter.radius() * std::sqrt(u);
        const double angle = 2 * std::numbers::pi * v;
        const Vec3 point =
            shooter.center() + r * (std::cos(angle) * frame.aside + std::sin(angle) * frame.up);
        return shooter.through(point, along);
    }
    const auto& triangle = mesh.triangles[pick(u, mesh.triangles.size())];
    const std::size_t corner = pick(v, 3);
    const Vec3& a = mesh.positions[triangle[corner]];
    const Vec3& b = mesh.positions[triangle[(corner + 1) % 3]];
    switch (aim) {
        case Aim::vertex:
            return shooter.through(a, random_direction(seed, number));
        case Aim::edge_middle:
            return shooter.through(0.5 * (a + b), random_direction(seed, number));
        case Aim::along_edge:
            return shooter.through(a, normalize(b - a));
        default:
            break;
    }
    Vec3 along(0.0);
    along[static_cast<int>(pick(w, 3))] = w < 0.5 ? 1 : -1;
    return shooter.through(a, along);
}

ParityCount& ParityCount::operator+=(const ParityCount& more) {
    rays += more.rays;
    hits += more.hits;
    odd += more.odd;
    odd_short += more.odd_short;
    checked += more.checked;
    lost += more.lost;
    doubled += more.doubled;
    swapped += more.swapped;
    return *this;
}

ParityCount count_parity(const TriangleMesh& mesh, const LineShooter& shooter, const Gather& gather,
                         const ParityPlan& plan) {
    ParityCount total;
    std::mutex adding;
    const std::uint64_t blocks = (plan.rays + kBlock - 1) / kBlock;
    parallel_for(blocks, 1, [&](std::size_t begin, std::size_t end) {
        ParityCount count;
        std::vector<Ray> rays;
        std::vector<std::vector<RayHit>> hits;
        for (std::uint64_t block = begin; block < end; ++block) {
            const std::uint64_t first = block * kBlock;
            rays.clear();
            for (std::uint64_t i = first; i < std::min(plan.rays, first + kBlock); ++i)
                rays.push_back(aimed_ray(shooter, mesh, plan.aim, plan.seed, i));
            gather(rays, hits);
            for (std::size_t i = 0; i < rays.size(); ++i) {
                ++count.rays;
                count.hits += hits[i].size();
                const bool odd = hits[i].size() % 2 == 1;
                count.odd += odd ? 1U : 0U;
                // The checked ones are spread evenly; odd ones among random rays are rare, and looked at
                // anyway.
                const std::uint64_t number = first + i;
                const bool checked =
                    number * plan.checked / plan.rays != (number + 1) * plan.checked / plan.rays;
                if (!checked && !(odd && plan.aim == Aim::random)) continue;
                const std::vector<std::uint32_t> right = exact_crossings(mesh, rays[i]);
                count.odd_short += odd && hits[i].size() < right.size() ? 1U : 0U;
                if (!checked) continue;
                ++count.checked;
                count.lost += hits[i].size() < right.size() ? 1U : 0U;
                count.doubled += hits[i].size() > right.size() ? 1U : 0U;
                count.swapped += hits[i].size() == right.size() && patches(hits[i]) != right ? 1U : 0U;
            }
        }
        const std::scoped_lock lock(adding);
        total += count;
    });
    return total;
}

}  // namespace pellucid
