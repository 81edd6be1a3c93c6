#include "field/point_tree.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

/// Points a leaf of the tree: fewer make it deeper, more make balls test points that are far away.
constexpr std::size_t kLeafPoints = 12;

[[nodiscard]] double square(const Vec3& v) { return dot(v, v); }

[[nodiscard]] double near_square(const Box& box, const Vec3& p) {
    return square(glm::max(glm::max(box.lo - p, p - box.hi), Vec3(0.0)));
}
[[nodiscard]] double far_square(const Box& box, const Vec3& p) { return square(glm::max(p - box.lo, box.hi - p)); }

}  // namespace

PointTree::PointTree(std::vector<OrientedPoint> points) : points_(std::move(points)) {
    while ((points_.size() >> depth_) > kLeafPoints) ++depth_;
    nodes_.resize((std::size_t{2} << depth_) - 1);
    std::vector<Range> level{{0, points_.size()}};
    for (int d = 0;; ++d) {
        const std::size_t first = (std::size_t{1} << d) - 1;
        const bool last = d == depth_;
        std::vector<Range> next(last ? 0 : 2 * level.size());
        parallel_for(level.size(), d < 8 ? 1 : 64, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const Range range = level[i];
                Box& box = nodes_[first + i];
                for (std::size_t p = range.begin; p < range.end; ++p) box.include(points_[p].position);
                if (last) continue;
                const Vec3 size = box.size();
                const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
                const std::size_t middle = range.begin + (range.end - range.begin) / 2;
                const auto at = [&](std::size_t p) { return points_.begin() + static_cast<std::ptrdiff_t>(p); };
                std::nth_element(at(range.begin), at(middle), at(range.end),
                                 [axis](const OrientedPoint& a, const OrientedPoint& b) {
                                     return a.position[axis] < b.position[axis];
                                 });
                next[2 * i] = {range.begin, middle};
                next[2 * i + 1] = {middle, range.end};
            }
        });
        if (last) break;
        level = std::move(next);
    }
}

void PointTree::within(const Vec3& center, double radius, std::vector<std::uint32_t>& out) const {
    out.clear();
    const double radius2 = radius * radius;
    struct Entry {
        std::size_t node;
        Range range;
        int depth;
    };
    std::array<Entry, 64> stack;
    std::size_t top = 0;
    stack[top++] = {0, {0, points_.size()}, 0};
    while (top > 0) {
        const Entry e = stack[--top];
        const Box& box = nodes_[e.node];
        if (!(near_square(box, center) < radius2)) continue;
        if (far_square(box, center) < radius2) {
            for (std::size_t p = e.range.begin; p < e.range.end; ++p) out.push_back(static_cast<std::uint32_t>(p));
            continue;
        }
        if (e.depth == depth_) {
            for (std::size_t p = e.range.begin; p < e.range.end; ++p)
                if (square(points_[p].position - center) < radius2) out.push_back(static_cast<std::uint32_t>(p));
            continue;
        }
        const std::size_t middle = e.range.begin + (e.range.end - e.range.begin) / 2;
        stack[top++] = {2 * e.node + 2, {middle, e.range.end}, e.depth + 1};
        stack[top++] = {2 * e.node + 1, {e.range.begin, middle}, e.depth + 1};
    }
}

void PointTree::nearest(const Vec3& place, std::size_t count, std::vector<std::uint32_t>& out) const {
    out.clear();
    using Found = std::pair<double, std::uint32_t>;  // of equal distances the first
    thread_local std::vector<Found> heap;
    heap.clear();
    const auto search = [&](const auto& self, std::size_t node, Range range, int depth) -> void {
        const auto full = [&] { return heap.size() == count; };
        if (full() && near_square(nodes_[node], place) > heap.front().first) return;
        if (depth == depth_) {
            for (std::size_t p = range.begin; p < range.end; ++p) {
                const Found found{square(points_[p].position - place), static_cast<std::uint32_t>(p)};
                if (full()) {
                    if (!(found < heap.front())) continue;
                    std::ranges::pop_heap(heap);
                    heap.pop_back();
                }
                heap.push_back(found);
                std::ranges::push_heap(heap);
            }
            return;
        }
        const std::size_t middle = range.begin + (range.end - range.begin) / 2;
        const std::size_t left = 2 * node + 1;
        const bool right_first = near_square(nodes_[left + 1], place) < near_square(nodes_[left], place);
        const auto go = [&](bool right) {
            if (right)
                self(self, left + 1, Range{middle, range.end}, depth + 1);
            else
                self(self, left, Range{range.begin, middle}, depth + 1);
        };
        go(right_first);
        go(!right_first);
    };
    if (count > 0) search(search, 0, Range{0, points_.size()}, 0);
    std::ranges::sort_heap(heap);
    for (const Found& found : heap) out.push_back(found.second);
}

double PointTree::distance(const Vec3& place, double below) const {
    double best2 = below * below;
    const auto search = [&](const auto& self, std::size_t node, Range range, int depth) -> void {
        if (!(near_square(nodes_[node], place) < best2)) return;
        if (depth == depth_) {
            for (std::size_t p = range.begin; p < range.end; ++p)
                best2 = std::min(best2, square(points_[p].position - place));
            return;
        }
        const std::size_t middle = range.begin + (range.end - range.begin) / 2;
        const std::size_t left = 2 * node + 1;
        const bool right_first = near_square(nodes_[left + 1], place) < near_square(nodes_[left], place);
        for (const bool right : {right_first, !right_first}) {
            if (right)
                self(self, left + 1, Range{middle, range.end}, depth + 1);
            else
                self(self, left, Range{range.begin, middle}, depth + 1);
        }
    };
    search(search, 0, Range{0, points_.size()}, 0);
    return std::sqrt(best2);
}

}  // namespace pellucid
