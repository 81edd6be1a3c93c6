// A triangle rasteriser for the CPU: which pixels' centres a triangle covers, and how deep it is there.
//
// Corners are snapped to 1/256 pixel and edges are judged in 64-bit integers, exactly. A centre on an edge belongs to
// the triangle whose top or left edge it is, so that of triangles which share an edge exactly one covers it: a closed mesh
// has neither cracks nor double hits. What reaches behind the near plane, or out of a guard band of 2^20 pixels, is clipped
// first; both triangles of a cut edge cut it at the same place. Triangles are two-sided.
//
// Depth is that of the triangle's own plane on the pixel's ray, in double, within the depths of its corners: snapping moves
// the outline by up to 1/512 pixel along each axis and never the plane. Error: a few 1e-16 of the distance, over |cosθ|.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "scene/camera.hpp"
#include "stage/scene_meshes.hpp"

namespace pellucid {

inline constexpr int kSubpixels = 256;
/// Side of a tile: its fragments fit the second cache, and edge functions over small triangles fit 32 bits.
inline constexpr int kRasterTile = 32;

/// A triangle in the image, in 1/256 pixel from the crop's corner. Its area is positive: clockwise as rows grow downwards.
struct RasterTriangle {
    std::array<std::int32_t, 3> x, y;
    std::uint32_t number;  // of the triangle it is (a part of): SceneMeshes
};

/// z of a plane on the rays of an image.
struct DepthPlane {
    double base, c0, cu, cv, d0, du, dv, lo, hi;

    /// (u, v) in pixels from the view axis.
    [[nodiscard]] double at(double u, double v) const {
        const double z = base + (c0 + cu * u + cv * v) / (d0 + du * u + dv * v);
        // Also where a plane is seen edge-on: 0/0.
        return z > lo ? (z < hi ? z : hi) : lo;
    }
};
/// Of a triangle in view space.
[[nodiscard]] DepthPlane depth_plane(const Camera& camera, const Vec3& a, const Vec3& b, const Vec3& c);

/// Clips and snaps triangles of one camera.
class TriangleSetup {
public:
    explicit TriangleSetup(const Camera& camera);

    /// A place on the image grid, or none: then triangles with this corner must be clipped.
    struct Corner {
        std::int32_t x = kNone, y = kNone;
        static constexpr std::int32_t kNone = INT32_MIN;
        [[nodiscard]] bool clipped() const { return x == kNone; }
    };
    [[nodiscard]] Corner snap(const Vec3& view) const;
    /// The triangle's parts that can cover a pixel's centre of the image are appended: none, one, or up to six.
    void add(const std::array<Vec3, 3>& view, const std::array<Corner, 3>& corners, std::uint32_t number,
             std::vector<RasterTriangle>& out) const;

private:
    void add_snapped(const std::array<Corner, 3>& corners, std::uint32_t number, std::vector<RasterTriangle>& out) const;

    const Camera* camera_;
    double guard_;  // view-space x or y of the guard band at depth 1 (perspective), or everywhere
};

/// Pixels of `within` whose centres may be in the triangle.
[[nodiscard]] inline PixelRect centers_within(const RasterTriangle& t, const PixelRect& within) {
    const auto [x_lo, x_hi] = std::minmax({t.x[0], t.x[1], t.x[2]});
    const auto [y_lo, y_hi] = std::minmax({t.y[0], t.y[1], t.y[2]});
    constexpr int kHalf = kSubpixels / 2;
    const auto first = [](std::int32_t lo) { return (lo - kHalf + kSubpixels - 1) >> 8; };
    const auto end = [](std::int32_t hi) { return ((hi - kHalf) >> 8) + 1; };
    return {std::max(first(x_lo), within.x0), std::max(first(y_lo), within.y0), std::min(end(x_hi), within.x1),
            std::min(end(y_hi), within.y1)};
}

/// An edge as a function of the pixel, >= 0 where its centre is inside.
struct RasterEdge {
    std::int64_t at_origin, step_x, step_y;

    RasterEdge(const RasterTriangle& t, std::size_t from, std::size_t to) {
        const std::int64_t dx = std::int64_t{t.x[to]} - t.x[from];
        const std::int64_t dy = std::int64_t{t.y[to]} - t.y[from];
        constexpr std::int64_t kHalf = kSubpixels / 2;
        // Top-left rule: edges that go up, or along the top to the right, hold their points.
        const bool holds = dy < 0 || (dy == 0 && dx > 0);
        at_origin = dx * (kHalf - t.y[from]) - dy * (kHalf - t.x[from]) - (holds ? 0 : 1);
        step_x = -dy * kSubpixels;
        step_y = dx * kSubpixels;
    }
    [[nodiscard]] std::int64_t at(int x, int y) const { return at_origin + x * step_x + y * step_y; }
    /// Largest value over the centres of some pixels.
    [[nodiscard]] std::int64_t most(const PixelRect& r) const {
        return at(step_x > 0 ? r.x1 - 1 : r.x0, step_y > 0 ? r.y1 - 1 : r.y0);
    }
};

/// take(x, y) for every pixel of `within` whose centre the triangle covers, row by row.
template <class Take>
void for_each_covered(const RasterTriangle& t, const PixelRect& within, Take&& take) {
    const PixelRect r = centers_within(t, within);
    if (r.x0 >= r.x1 || r.y0 >= r.y1) return;
    const RasterEdge e[3] = {{t, 0, 1}, {t, 1, 2}, {t, 2, 0}};
    std::int64_t row[3] = {e[0].at(r.x0, r.y0), e[1].at(r.x0, r.y0), e[2].at(r.x0, r.y0)};
    for (int y = r.y0; y < r.y1; ++y) {
        std::int64_t here[3] = {row[0], row[1], row[2]};
        for (int x = r.x0; x < r.x1; ++x) {
            if ((here[0] | here[1] | here[2]) >= 0) take(x, y);
            for (std::size_t i = 0; i < 3; ++i) here[i] += e[i].step_x;
        }
        for (std::size_t i = 0; i < 3; ++i) row[i] += e[i].step_y;
    }
}

/// Triangles of some objects, clipped, snapped and sorted into tiles.
class BinnedTriangles {
public:
    /// All must outlive it.
    ///   objects  numbers in SceneMeshes::objects, ascending
    BinnedTriangles(const Camera& camera, const SceneMeshes& meshes, std::span<const std::uint32_t> objects);

    [[nodiscard]] std::size_t tile_count() const { return first_.size() - 1; }
    [[nodiscard]] PixelRect tile(std::size_t tile) const;
    /// Those that may cover something of a tile, by their number ascending.
    [[nodiscard]] std::size_t count(std::size_t tile) const { return first_[tile + 1] - first_[tile]; }
    [[nodiscard]] const RasterTriangle& triangle(std::size_t tile, std::size_t i) const {
        return triangles_[in_tile_[first_[tile] + i]];
    }
    [[nodiscard]] std::size_t bytes() const;

private:
    int width_, height_, columns_;
    std::vector<RasterTriangle> triangles_;
    std::vector<std::size_t> first_;        // of a tile in in_tile_
    std::vector<std::uint32_t> in_tile_;
};

}  // namespace pellucid
