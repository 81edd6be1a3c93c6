#include "cpu/depth_peeling.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <mutex>
#include <numeric>

#include "core/order_weights.hpp"
#include "core/parallel.hpp"
#include "scene/shading.hpp"
#include "stage/virtual_slab.hpp"

namespace pellucid {
namespace {

constexpr std::size_t kTilePixels = std::size_t{kRasterTile} * kRasterTile;
/// As the truth has it.
constexpr double kLeastCosine = 1e-12;

/// Position in the order: (depth or rank, number). Depths are not negative, so their bits ascend with them.
using Key = std::uint64_t;
[[nodiscard]] Key make_key(std::uint32_t first, std::uint32_t second) { return Key{first} << 32U | second; }
[[nodiscard]] std::uint32_t first_of(Key key) { return static_cast<std::uint32_t>(key >> 32U); }
[[nodiscard]] std::uint32_t second_of(Key key) { return static_cast<std::uint32_t>(key); }
[[nodiscard]] std::uint32_t depth_bits(double depth) { return std::bit_cast<std::uint32_t>(static_cast<float>(depth)); }

/// A triangle as its fragments need it.
struct DrawnTriangle {
    DepthPlane plane;
    Vec3 facet;  // normal, world
    std::uint32_t number, object;  // the object's place in SceneMeshes
};

/// What is the same for all fragments of an object.
struct DrawnObject {
    const Object* object;
    const ObjectMesh* mesh;
    bool cut;           // fragments must ask Object::keeps
    bool even;          // the same opacity all over
    double opacity;     // then that
    bool smooth;        // has normals at vertices
    std::optional<double> thickness;
    /// No fragment of it lets anything shine through.
    [[nodiscard]] bool hides() const { return even && opacity == 1 && !cut; }
    /// Whatever it covers has a fragment.
    [[nodiscard]] bool always_there() const { return even && opacity > 0 && !cut; }
};

/// The ray of a pixel's centre.
struct PixelRay {
    Ray ray;
    double length;
    Vec3 to_viewer;  // unit length
    double u, v;     // from the view axis

    PixelRay(const Camera& camera, int x, int y)
        : ray(camera.ray(x + 0.5, y + 0.5)),
          length(pellucid::length(ray.direction)),
          to_viewer(-ray.direction / length),
          u(x + 0.5 - camera.center().x),
          v(y + 0.5 - camera.center().y) {}
};

class FragmentShader {
public:
    FragmentShader(const PreparedScene& scene, const SceneMeshes& meshes, bool thickness)
        : scene_(scene), meshes_(meshes), thickness_(thickness) {
        for (const ObjectMesh& mesh : meshes.objects()) {
            const Object& object = scene.objects[mesh.object];
            const bool even = object.surface.opacity_law == OpacityLaw::constant && !object.geometry->painted();
            objects_.push_back({.object = &object,
                                .mesh = &mesh,
                                .cut = !object.surface.clip.empty() || (object.surface.bounds && !object.bounds_are_geometry()),
                                .even = even,
                                .opacity = object.surface.opacity,
                                .smooth = !mesh.mesh->normals.empty(),
                                .thickness = fixed_thickness(scene, object)});
        }
    }

    [[nodiscard]] const DrawnObject& object(std::size_t i) const { return objects_[i]; }

    [[nodiscard]] DrawnTriangle triangle(std::uint32_t number, std::size_t object) const {
        const ObjectMesh& mesh = meshes_.objects()[object];
        const auto& [a, b, c] = mesh.mesh->triangles[number - meshes_.first_triangle(object)];
        const auto& world = mesh.mesh->positions;
        return {depth_plane(scene_.camera, mesh.view[a], mesh.view[b], mesh.view[c]),
                cross(world[b] - world[a], world[c] - world[a]), number, static_cast<std::uint32_t>(object)};
    }

    [[nodiscard]] bool in_range(double depth) const {
        return depth >= scene_.camera.near() && depth <= scene_.camera.far();
    }

    /// Empty where it is cut away or has no opacity.
    [[nodiscard]] bool shade(const DrawnTriangle& t, const PixelRay& pixel, SurfaceFragment& out) const {
        const DrawnObject& drawn = objects_[t.object];
        const Object& object = *drawn.object;
        const double z = t.plane.at(pixel.u, pixel.v);
        const Vec3 world = pixel.ray.origin + z * pixel.ray.direction;
        if (drawn.cut && !object.keeps(world)) return false;
        const double share = drawn.even ? 1 : object.geometry->opacity_at(world);
        if (object.surface.opacity * share == 0) return false;

        const Vec3 smooth = drawn.smooth ? vertex_normal(t, world) : t.facet;
        const Vec3& geometric = drawn.mesh->of_field ? smooth : t.facet;
        double alpha = drawn.opacity;
        if (!drawn.even) {
            const double cosine = std::abs(dot(geometric, pixel.ray.direction)) / (length(geometric) * pixel.length);
            alpha = object.opacity(cosine > kLeastCosine ? std::min(cosine, 1.0) : kLeastCosine, share);
        }
        if (static_cast<float>(alpha) == 0) return false;
        const Vec3 own = object.geometry->has_color() ? object.geometry->color(world) : object.surface.color;
        const Vec3 color = pellucid::shade(scene_.settings.lights, object.surface.shading, own, pixel.to_viewer, smooth);
        double thickness = 0;
        if (thickness_) {
            const Camera& camera = scene_.camera;
            thickness = drawn.thickness ? *drawn.thickness
                                        : pixel_thickness(camera, camera.to_view(world), camera.view_vector(geometric));
            thickness = seen_thickness(thickness, z);
        }
        const auto narrow = [](double v) { return static_cast<float>(v); };
        out = {{narrow(z), narrow(thickness), narrow(alpha * color.x), narrow(alpha * color.y), narrow(alpha * color.z),
                narrow(alpha)},
               drawn.mesh->object,
               t.number};
        return true;
    }

private:
    /// Of the vertices, interpolated on the facet; the facet's where they cancel.
    [[nodiscard]] Vec3 vertex_normal(const DrawnTriangle& t, const Vec3& point) const {
        const TriangleMesh& mesh = *objects_[t.object].mesh->mesh;
        const auto& [i, j, k] = mesh.triangles[t.number - meshes_.first_triangle(t.object)];
        const Vec3 from = point - mesh.positions[i];
        const double area2 = dot(t.facet, t.facet);
        const double v1 = dot(cross(from, mesh.positions[k] - mesh.positions[i]), t.facet) / area2;
        const double v2 = dot(cross(mesh.positions[j] - mesh.positions[i], from), t.facet) / area2;
        const Vec3 normal = (1 - v1 - v2) * mesh.normals[i] + v1 * mesh.normals[j] + v2 * mesh.normals[k];
        return dot(normal, normal) > 0 ? normal : t.facet;
    }

    const PreparedScene& scene_;
    const SceneMeshes& meshes_;
    bool thickness_;
    std::vector<DrawnObject> objects_;
};

/// When a pixel needs no more fragments.
class PixelEnd {
public:
    explicit PixelEnd(const PeelSettings& settings)
        : most_(settings.layers > 0 ? static_cast<std::size_t>(settings.layers) : ~std::size_t{0}),
          most_clear_(1 - settings.opaque_at) {}

    /// Whether a fragment after those that were added, at this place in the order, is still wanted.
    [[nodiscard]] bool wants(std::uint32_t place) const {
        return count_ < most_ && !(clear_ <= most_clear_ && place != last_);
    }
    void add(std::uint32_t place, float alpha) {
        ++count_;
        last_ = place;
        clear_ *= 1 - static_cast<double>(alpha);
    }

private:
    std::size_t most_;
    double most_clear_;
    std::size_t count_ = 0;
    double clear_ = 1;
    std::uint32_t last_ = ~0U;
};

/// All fragments of a tile's pixels.
class TileFragments {
public:
    TileFragments(const PreparedScene& scene, const SceneMeshes& meshes, const FragmentShader& shader,
                  const PeelSettings& settings, const BinnedTriangles& bins)
        : scene_(scene), meshes_(meshes), shader_(shader), settings_(settings), bins_(bins) {}

    void draw(std::size_t tile, const TakePixel& take, PeelStats& stats) {
        area_ = bins_.tile(tile);
        if (bins_.count(tile) == 0) return;
        collect(tile);
        if (keys_.empty()) return;
        sort_by_pixel();
        for (std::size_t pixel = 0; pixel < kTilePixels; ++pixel)
            if (first_[pixel] < first_[pixel + 1]) draw_pixel(pixel, take, stats);
    }
    [[nodiscard]] std::size_t bytes() const {
        return triangles_.capacity() * sizeof(DrawnTriangle) + (keys_.capacity() + sorted_.capacity()) * sizeof(Key) +
               where_.capacity() * sizeof(std::uint16_t);
    }

private:
    /// Keys hold the triangle's place in the tile, which ascends as its number does.
    void collect(std::size_t tile) {
        triangles_.clear();
        keys_.clear();
        where_.clear();
        nearest_hidden_.fill(~0U);
        std::size_t object = meshes_.objects().size();
        for (std::size_t i = 0; i < bins_.count(tile); ++i) {
            const RasterTriangle& t = bins_.triangle(tile, i);
            if (object == meshes_.objects().size() || t.number >= meshes_.first_triangle(object + 1))
                object = meshes_.object_of(t.number);
            const DrawnObject& drawn = shader_.object(object);
            const bool by_depth = settings_.order.empty();
            const bool hides = by_depth && (drawn.hides() || (settings_.layers == 1 && drawn.always_there()));
            const Vec2 axis = scene_.camera.center() - 0.5;
            bool made = false;  // many small triangles cover no centre
            for_each_covered(t, area_, [&](int x, int y) {
                if (!made) triangles_.push_back(shader_.triangle(t.number, object));
                made = true;
                const double z = triangles_.back().plane.at(x - axis.x, y - axis.y);
                if (!shader_.in_range(z)) return;
                const std::uint32_t first = by_depth ? depth_bits(z) : settings_.order[t.number];
                const auto pixel = static_cast<std::size_t>((y - area_.y0) * kRasterTile + (x - area_.x0));
                if (first > nearest_hidden_[pixel]) return;
                if (hides) nearest_hidden_[pixel] = first;
                keys_.push_back(make_key(first, static_cast<std::uint32_t>(triangles_.size() - 1)));
                where_.push_back(static_cast<std::uint16_t>(pixel));
            });
        }
    }

    void sort_by_pixel() {
        first_.fill(0);
        for (const std::uint16_t pixel : where_) ++first_[pixel + 1U];
        for (std::size_t i = 1; i <= kTilePixels; ++i) first_[i] += first_[i - 1];
        std::array<std::uint32_t, kTilePixels> next;
        std::copy_n(first_.begin(), kTilePixels, next.begin());
        sorted_.resize(keys_.size());
        for (std::size_t i = 0; i < keys_.size(); ++i) sorted_[next[where_[i]]++] = keys_[i];
    }

    void draw_pixel(std::size_t pixel, const TakePixel& take, PeelStats& stats) {
        const std::span<Key> keys(sorted_.data() + first_[pixel], first_[pixel + 1] - first_[pixel]);
        std::sort(keys.begin(), keys.end());
        const int x = area_.x0 + static_cast<int>(pixel) % kRasterTile;
        const int y = area_.y0 + static_cast<int>(pixel) / kRasterTile;
        const PixelRay ray(scene_.camera, x, y);
        PixelEnd end(settings_);
        fragments_.clear();
        SurfaceFragment fragment;
        for (const Key key : keys) {
            if (!end.wants(first_of(key))) break;
            if (!shader_.shade(triangles_[second_of(key)], ray, fragment)) continue;
            fragments_.push_back(fragment);
            end.add(first_of(key), fragment.slab.a);
        }
        if (fragments_.empty()) return;
        ++stats.pixels;
        stats.fragments += fragments_.size();
        stats.layers = std::max<std::uint64_t>(stats.layers, fragments_.size());
        take(x, y, fragments_);
    }

    const PreparedScene& scene_;
    const SceneMeshes& meshes_;
    const FragmentShader& shader_;
    const PeelSettings& settings_;
    const BinnedTriangles& bins_;
    PixelRect area_{};
    std::vector<DrawnTriangle> triangles_;
    std::vector<Key> keys_, sorted_;
    std::vector<std::uint16_t> where_;                          // pixel of a key
    std::array<std::uint32_t, kTilePixels + 1> first_{};        // of a pixel in sorted_
    std::array<std::uint32_t, kTilePixels> nearest_hidden_{};   // nothing is seen behind this place in the order
    std::vector<SurfaceFragment> fragments_;
};

}  // namespace

PeelStats peel(const PreparedScene& scene, const SceneMeshes& meshes, std::span<const std::uint32_t> objects,
               const PeelSettings& settings, const TakePixel& take) {
    const BinnedTriangles bins(scene.camera, meshes, objects);
    const FragmentShader shader(scene, meshes, settings.thickness);
    PeelStats all;
    all.passes = 1;
    std::mutex mutex;
    parallel_for(bins.tile_count(), 1, [&](std::size_t begin, std::size_t end) {
        TileFragments fragments(scene, meshes, shader, settings, bins);
        PeelStats own;
        for (std::size_t tile = begin; tile < end; ++tile) fragments.draw(tile, take, own);
        const std::scoped_lock lock(mutex);
        all.fragments += own.fragments;
        all.pixels += own.pixels;
        all.layers = std::max(all.layers, own.layers);
        all.bytes = std::max(all.bytes, fragments.bytes());
    });
    all.bytes = bins.bytes() + all.bytes * static_cast<std::size_t>(thread_count());
    return all;
}

PeelStats peel_by_passes(const PreparedScene& scene, const SceneMeshes& meshes, std::span<const std::uint32_t> objects,
                         const PeelSettings& settings, int targets,
                         const std::function<void(std::span<const PeelTarget>)>& intermix) {
    const Camera& camera = scene.camera;
    const FragmentShader shader(scene, meshes, settings.thickness);
    const TriangleSetup setup(camera);
    const PixelRect image{0, 0, camera.width(), camera.height()};
    const auto pixels = static_cast<std::size_t>(image.x1) * static_cast<std::size_t>(image.y1);
    constexpr Key kNone = ~Key{0};

    std::vector<Key> last(pixels, 0), next(pixels);  // of a key plus one; and what is found in a pass
    std::vector<PixelEnd> end(pixels, PixelEnd(settings));
    std::vector<std::uint32_t> depth_of_last(pixels, 0);
    std::vector<PeelTarget> filled;
    PeelStats stats;
    std::vector<RasterTriangle> parts;
    SurfaceFragment fragment;
    while (true) {
        // The nearest fragment behind the last one.
        std::fill(next.begin(), next.end(), kNone);
        bool any = false;
        for (const std::uint32_t o : objects) {
            const ObjectMesh& mesh = meshes.objects()[o];
            for (std::uint32_t i = 0; i < mesh.mesh->triangles.size(); ++i) {
                const auto& [a, b, c] = mesh.mesh->triangles[i];
                const std::array<Vec3, 3> view{mesh.view[a], mesh.view[b], mesh.view[c]};
                const std::uint32_t number = meshes.first_triangle(o) + i;
                parts.clear();
                setup.add(view, {setup.snap(view[0]), setup.snap(view[1]), setup.snap(view[2])}, number, parts);
                if (parts.empty()) continue;
                const DrawnTriangle drawn = shader.triangle(number, o);
                for (const RasterTriangle& part : parts)
                    for_each_covered(part, image, [&](int x, int y) {
                        const PixelRay pixel(camera, x, y);
                        const double z = drawn.plane.at(pixel.u, pixel.v);
                        const auto at = static_cast<std::size_t>(y) * static_cast<std::size_t>(image.x1) + static_cast<std::size_t>(x);
                        const Key key = make_key(depth_bits(z), number);
                        if (!shader.in_range(z) || key < last[at] || key >= next[at]) return;
                        if (!end[at].wants(first_of(key)) || !shader.shade(drawn, pixel, fragment)) return;
                        next[at] = key;
                        any = true;
                    });
            }
        }
        ++stats.passes;
        if (!any) break;
        PeelTarget& target = filled.emplace_back();
        target.fragments.assign(pixels, {{}, 0, PeelTarget::kNoFragment});
        for (std::size_t at = 0; at < pixels; ++at) {
            if (next[at] == kNone) continue;
            const std::uint32_t number = second_of(next[at]);
            const PixelRay pixel(camera, static_cast<int>(at) % image.x1, static_cast<int>(at) / image.x1);
            (void)shader.shade(shader.triangle(number, meshes.object_of(number)), pixel, target.fragments[at]);
            end[at].add(first_of(next[at]), target.fragments[at].slab.a);
            last[at] = next[at] + 1;
            ++stats.fragments;
            if (stats.layers == 0) ++stats.pixels;
        }
        ++stats.layers;
        stats.bytes = std::max(stats.bytes, pixels * (2 * sizeof(Key) + sizeof(PixelEnd) + filled.size() * sizeof(SurfaceFragment)));
        if (filled.size() == static_cast<std::size_t>(targets)) {
            intermix(filled);
            filled.clear();
        }
    }
    if (!filled.empty()) intermix(filled);
    return stats;
}

std::int64_t planned_peel_bytes(double triangles, double vertices) {
    // Snapped corners while triangles are set up; then triangles in the image, half of them again in the lists of tiles.
    const double bytes = sizeof(TriangleSetup::Corner) * vertices + (sizeof(RasterTriangle) + 1.5 * sizeof(std::uint32_t)) * triangles;
    return static_cast<std::int64_t>(bytes);
}

std::vector<std::uint32_t> all_objects(const SceneMeshes& meshes) {
    std::vector<std::uint32_t> all(meshes.objects().size());
    std::iota(all.begin(), all.end(), 0U);
    return all;
}

Composite composite_surfaces(std::span<const SurfaceFragment> fragments) {
    Composite sum;
    double clear = 1;
    for (std::size_t i = 0; i < fragments.size();) {
        std::size_t end = i + 1;
        while (end < fragments.size() && fragments[end].slab.z == fragments[i].slab.z) ++end;
        const auto together = fragments.subspan(i, end - i);
        thread_local std::vector<double> alphas, weights;
        alphas.clear();
        for (const SurfaceFragment& f : together) alphas.push_back(static_cast<double>(f.slab.a));
        weigh_all_orders(alphas, weights);
        double passes = 1;
        for (std::size_t k = 0; k < together.size(); ++k) {
            const twin::Slab& slab = together[k].slab;
            const double weight = clear * weights[k];
            sum.r += weight * static_cast<double>(slab.r);
            sum.g += weight * static_cast<double>(slab.g);
            sum.b += weight * static_cast<double>(slab.b);
            passes *= 1 - static_cast<double>(slab.a);
        }
        clear *= passes;
        i = end;
    }
    sum.a = 1 - clear;
    return sum;
}

}  // namespace pellucid
