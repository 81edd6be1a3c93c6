// All crossings of rays with a scene, through Embree.
//
// Triangles are Embree's own, in robust mode, gathered sixteen rays at a time by a context filter that
// rejects every hit after writing it down: one traversal a ray, no restarts, nothing lost behind an
// epsilon. All other patches are user geometry and answer in closed form, in double. Embree decides in
// float32, in a frame in which the scene has size 1; the depth of every hit is then computed in double.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "scene/prepared_scene.hpp"

namespace pellucid {

inline constexpr int kPacket = 16;

struct RayHit {
    double t;             // depth along the view axis
    std::uint32_t object;
    std::uint32_t patch;
    Vec3 normal;          // geometric, world; not normalised
};

/// The hits of a packet's rays, each in order of depth (then of object and patch).
struct PacketHits {
    std::array<std::vector<RayHit>, kPacket> rays;
    CrossingList patch;  // of one patch; its stats add up what fields could not decide

    [[nodiscard]] const std::vector<RayHit>& operator[](std::size_t ray) const { return rays[ray]; }
};

class RayScene {
public:
    explicit RayScene(const PreparedScene& scene);
    ~RayScene();
    RayScene(const RayScene&) = delete;
    RayScene& operator=(const RayScene&) = delete;

    /// All crossings between near and far that no clip plane cuts away. Rays should be coherent.
    void gather(std::span<const Ray, kPacket> rays, PacketHits& hits) const;
    /// Bytes that Embree holds.
    [[nodiscard]] std::int64_t bytes() const;

private:
    /// Sorted hits, without those that tell a crossing again.
    void drop_repeated(const Ray& ray, std::vector<RayHit>& list) const;

    struct Embree;
    const PreparedScene* scene_;
    std::unique_ptr<Embree> embree_;
};

}  // namespace pellucid
