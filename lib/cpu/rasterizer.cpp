#include "cpu/rasterizer.hpp"

#include <algorithm>
#include <cmath>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

/// Pixels from the view axis. Differences of snapped coordinates stay below 2^30, products below 2^60.
constexpr double kGuard = 1 << 20;
/// Triangles that are set up at a time: enough that the list of a piece is small beside its work.
constexpr std::size_t kPiece = 8192;

/// A polygon while it is clipped: three corners, and one more for each of five planes.
struct Polygon {
    std::array<Vec3, 8> corner;
    std::size_t count = 0;
};

/// Keeps what has distance >= 0. An edge is cut from its inner end to its outer, whichever way it is walked: its other
/// triangle cuts it at the same place.
template <class Distance>
void clip(Polygon& polygon, const Distance& distance) {
    Polygon out;
    for (std::size_t i = 0; i < polygon.count; ++i) {
        const Vec3& a = polygon.corner[i];
        const Vec3& b = polygon.corner[(i + 1) % polygon.count];
        const double da = distance(a);
        const double db = distance(b);
        if (da >= 0) out.corner[out.count++] = a;
        if ((da >= 0) == (db >= 0)) continue;
        out.corner[out.count++] = da >= 0 ? a + da / (da - db) * (b - a) : b + db / (db - da) * (a - b);
    }
    polygon = out;
}

}  // namespace

DepthPlane depth_plane(const Camera& camera, const Vec3& a, const Vec3& b, const Vec3& c) {
    const Vec3 n = cross(b - a, c - a);
    const double s = camera.pixel_size();
    const double lo = std::min({a.z, b.z, c.z});
    const double hi = std::max({a.z, b.z, c.z});
    // From a to the plane along the ray: n·(a − a.z r)/(n·r) with r = (s u, s v, 1); orthographic rays have r = (0, 0, 1)
    // and start at (s u, s v). A plane across the axis has exactly the depth of a.
    const double across = n.x * a.x + n.y * a.y;
    if (camera.perspective()) return {a.z, across, -n.x * a.z * s, -n.y * a.z * s, n.z, n.x * s, n.y * s, lo, hi};
    return {a.z, across, -n.x * s, -n.y * s, n.z, 0, 0, lo, hi};
}

TriangleSetup::TriangleSetup(const Camera& camera) : camera_(&camera), guard_(kGuard * camera.pixel_size()) {}

TriangleSetup::Corner TriangleSetup::snap(const Vec3& view) const {
    const Camera& camera = *camera_;
    const double reach = camera.perspective() ? guard_ * view.z : guard_;
    if (!(view.z >= camera.near() && std::abs(view.x) <= reach && std::abs(view.y) <= reach)) return {};
    // On the grid of the whole image, so that a crop rounds the same way.
    const PixelRect& crop = camera.crop();
    const Vec2 corner(crop.x0, crop.y0);
    const double scale = 1 / (camera.perspective() ? camera.pixel_size() * view.z : camera.pixel_size());
    const Vec2 place = glm::floor(double{kSubpixels} * (camera.center() + corner + scale * Vec2(view)) + 0.5);
    return {static_cast<std::int32_t>(place.x) - kSubpixels * crop.x0,
            static_cast<std::int32_t>(place.y) - kSubpixels * crop.y0};
}

void TriangleSetup::add_snapped(const std::array<Corner, 3>& p, std::uint32_t number,
                                std::vector<RasterTriangle>& out) const {
    const auto wide = [](std::int32_t v) { return std::int64_t{v}; };
    const std::int64_t area = (wide(p[1].x) - p[0].x) * (wide(p[2].y) - p[0].y) -
                              (wide(p[1].y) - p[0].y) * (wide(p[2].x) - p[0].x);
    if (area == 0) return;
    const std::size_t second = area > 0 ? 1 : 2;
    const RasterTriangle t{{p[0].x, p[second].x, p[3 - second].x}, {p[0].y, p[second].y, p[3 - second].y}, number};
    const PixelRect r = centers_within(t, {0, 0, camera_->width(), camera_->height()});
    if (r.x0 < r.x1 && r.y0 < r.y1) out.push_back(t);
}

void TriangleSetup::add(const std::array<Vec3, 3>& view, const std::array<Corner, 3>& corners, std::uint32_t number,
                        std::vector<RasterTriangle>& out) const {
    if (!corners[0].clipped() && !corners[1].clipped() && !corners[2].clipped()) {
        add_snapped(corners, number, out);
        return;
    }
    const double near = camera_->near();
    if (view[0].z < near && view[1].z < near && view[2].z < near) return;
    Polygon polygon{{view[0], view[1], view[2]}, 3};
    clip(polygon, [&](const Vec3& p) { return p.z - near; });
    for (std::size_t i = 0; i < polygon.count; ++i) polygon.corner[i].z = std::max(polygon.corner[i].z, near);
    const auto reach = [&](const Vec3& p) { return camera_->perspective() ? guard_ * p.z : guard_; };
    clip(polygon, [&](const Vec3& p) { return reach(p) - p.x; });
    clip(polygon, [&](const Vec3& p) { return reach(p) + p.x; });
    clip(polygon, [&](const Vec3& p) { return reach(p) - p.y; });
    clip(polygon, [&](const Vec3& p) { return reach(p) + p.y; });
    // What was cut is on the band, give or take its rounding.
    std::array<Corner, 8> snapped;
    for (std::size_t i = 0; i < polygon.count; ++i) {
        Vec3& p = polygon.corner[i];
        p.x = std::clamp(p.x, -reach(p), reach(p));
        p.y = std::clamp(p.y, -reach(p), reach(p));
        snapped[i] = snap(p);
    }
    for (std::size_t i = 2; i < polygon.count; ++i)
        add_snapped({snapped[0], snapped[i - 1], snapped[i]}, number, out);
}

// ---- Tiles

namespace {

/// Triangles of one mesh that are set up together.
struct Piece {
    std::size_t object = 0, begin = 0, end = 0;
    std::vector<RasterTriangle> triangles = {};
    struct Place {
        std::uint32_t tile, triangle;
    };
    std::vector<Place> places = {};
};

[[nodiscard]] std::uint32_t narrow(std::size_t n) { return static_cast<std::uint32_t>(n); }

}  // namespace

BinnedTriangles::BinnedTriangles(const Camera& camera, const SceneMeshes& meshes, std::span<const std::uint32_t> objects)
    : width_(camera.width()), height_(camera.height()), columns_((width_ + kRasterTile - 1) / kRasterTile) {
    const TriangleSetup setup(camera);
    std::vector<Piece> pieces;
    std::vector<std::vector<TriangleSetup::Corner>> corners(meshes.objects().size());
    for (const std::uint32_t o : objects) {
        const ObjectMesh& object = meshes.objects()[o];
        corners[o].resize(object.view.size());
        parallel_for(object.view.size(), kPiece, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) corners[o][i] = setup.snap(object.view[i]);
        });
        const std::size_t count = object.mesh->triangles.size();
        for (std::size_t begin = 0; begin < count; begin += kPiece)
            pieces.push_back({o, begin, std::min(begin + kPiece, count)});
    }

    // Set up, and find the tiles of each.
    parallel_for(pieces.size(), 1, [&](std::size_t first, std::size_t last) {
        for (std::size_t k = first; k < last; ++k) {
            Piece& piece = pieces[k];
            const ObjectMesh& object = meshes.objects()[piece.object];
            const auto& own = corners[piece.object];
            piece.triangles.reserve(piece.end - piece.begin);
            for (std::size_t i = piece.begin; i < piece.end; ++i) {
                const auto& [a, b, c] = object.mesh->triangles[i];
                setup.add({object.view[a], object.view[b], object.view[c]}, {own[a], own[b], own[c]},
                          meshes.first_triangle(piece.object) + narrow(i), piece.triangles);
            }
            for (std::size_t i = 0; i < piece.triangles.size(); ++i) {
                const RasterTriangle& t = piece.triangles[i];
                const PixelRect r = centers_within(t, {0, 0, width_, height_});
                const int x0 = r.x0 / kRasterTile, x1 = (r.x1 - 1) / kRasterTile;
                const int y0 = r.y0 / kRasterTile, y1 = (r.y1 - 1) / kRasterTile;
                const RasterEdge e[3] = {{t, 0, 1}, {t, 1, 2}, {t, 2, 0}};
                for (int y = y0; y <= y1; ++y)
                    for (int x = x0; x <= x1; ++x) {
                        const std::size_t number = static_cast<std::size_t>(y) * static_cast<std::size_t>(columns_) +
                                                   static_cast<std::size_t>(x);
                        const PixelRect area = tile(number);
                        if (x1 > x0 && y1 > y0 && (e[0].most(area) < 0 || e[1].most(area) < 0 || e[2].most(area) < 0))
                            continue;
                        piece.places.push_back({narrow(number), narrow(i)});
                    }
            }
        }
    });

    // Sorted by tile, and in a tile by number.
    const int rows = (height_ + kRasterTile - 1) / kRasterTile;
    first_.assign(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows) + 1, 0);
    std::size_t count = 0;
    for (const Piece& piece : pieces) {
        count += piece.triangles.size();
        for (const Piece::Place& place : piece.places) ++first_[place.tile + 1];
    }
    for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
    triangles_.reserve(count);
    in_tile_.resize(first_.back());
    std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
    for (Piece& piece : pieces) {
        const std::size_t base = triangles_.size();
        triangles_.insert(triangles_.end(), piece.triangles.begin(), piece.triangles.end());
        for (const Piece::Place& place : piece.places) in_tile_[next[place.tile]++] = narrow(base + place.triangle);
        piece = {};
    }
}

PixelRect BinnedTriangles::tile(std::size_t tile) const {
    const int column = static_cast<int>(tile) % columns_;
    const int row = static_cast<int>(tile) / columns_;
    return {column * kRasterTile, row * kRasterTile, std::min((column + 1) * kRasterTile, width_),
            std::min((row + 1) * kRasterTile, height_)};
}

std::size_t BinnedTriangles::bytes() const {
    return sizeof(RasterTriangle) * triangles_.capacity() + sizeof(std::size_t) * first_.size() +
           sizeof(std::uint32_t) * in_tile_.size();
}

}  // namespace pellucid
