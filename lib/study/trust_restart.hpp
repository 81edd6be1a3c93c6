// Wrong twin of the ray scene: the nearest hit, and again behind it by an epsilon, until none is left.
//
// What is closer behind a hit than epsilon is lost; where epsilon is below the rounding of a hit's depth the
// same triangle is found again.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "study/trust_parity.hpp"

namespace pellucid {

class RestartScene {
public:
    /// `mesh` must outlive it.
    explicit RestartScene(const TriangleMesh& mesh);
    ~RestartScene();
    RestartScene(const RestartScene&) = delete;
    RestartScene& operator=(const RestartScene&) = delete;

    /// `epsilon` in radii of the mesh. Depths in `hits` are Embree's.
    void gather(std::span<const Ray> rays, double epsilon, std::vector<std::vector<RayHit>>& hits) const;

private:
    struct Embree;
    std::unique_ptr<Embree> embree_;
};

}  // namespace pellucid
