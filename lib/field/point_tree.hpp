// Points in a kd-tree: those in a ball, and those nearest to a place.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/vec.hpp"
#include "io/points_file.hpp"

namespace pellucid {

/// Safe from several threads; the same for any number of them.
class PointTree {
public:
    /// Reorders the points.
    explicit PointTree(std::vector<OrientedPoint> points);

    [[nodiscard]] std::span<const OrientedPoint> points() const { return points_; }
    [[nodiscard]] const Box& bounds() const { return nodes_[0]; }
    /// Numbers of the points nearer to a centre than a radius, ascending.
    void within(const Vec3& center, double radius, std::vector<std::uint32_t>& out) const;
    /// Numbers of the `count` points (or all, if fewer) nearest to a place, by distance.
    void nearest(const Vec3& place, std::size_t count, std::vector<std::uint32_t>& out) const;
    /// Distance to the nearest point that is nearer than `below`; `below` where there is none.
    [[nodiscard]] double distance(const Vec3& place, double below = kInfinity) const;
    [[nodiscard]] std::size_t bytes() const {
        return points_.capacity() * sizeof(OrientedPoint) + nodes_.capacity() * sizeof(Box);
    }

private:
    struct Range {
        std::size_t begin, end;
    };

    std::vector<OrientedPoint> points_;
    std::vector<Box> nodes_;  // of a complete binary tree: the children of i are 2i + 1 and 2i + 2
    int depth_ = 0;
};

}  // namespace pellucid
