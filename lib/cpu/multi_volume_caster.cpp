#include "cpu/multi_volume_caster.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

#include "core/parallel.hpp"
#include "core/stopwatch.hpp"

namespace pellucid {
namespace {

/// What a ray has gathered.
struct Gathered {
    double clear = 1;
    Vec3 color{0.0};
    double z = kInfinity;

    void add(double front, double opacity, const Vec3& associated) {
        if (!(opacity > 0)) return;
        color += clear * associated;
        clear *= 1 - opacity;
        z = std::min(z, front);
    }
};

[[nodiscard]] std::vector<VolumeCaster> make_casters(const PreparedScene& scene,
                                                     const CastSettings& settings) {
    std::vector<VolumeCaster> casters;
    for (const VolumeObject& volume : scene.volumes)
        if (!volume.bounds().empty()) casters.emplace_back(scene, volume, settings);
    return casters;
}

/// One ray after the other; one a thread.
class MultiVolumeRay {
public:
    MultiVolumeRay(const std::vector<VolumeCaster>& casters, const LayersOfRay& layers,
                   const MultiVolumeSettings& settings)
        : casters_(&casters), layers_of_ray_(&layers), settings_(settings) {}

    [[nodiscard]] Gathered cast(const Ray& ray, std::span<const twin::Slab> others) {
        walks_.clear();
        for (const VolumeCaster& volume : *casters_)
            if (auto p = volume.start(ray); !p.done()) walks_.push_back({&volume, p});
        layers_of_ray_->find(ray, others, settings_.mixing, layers_);
        Gathered sum;
        std::size_t layer = 0;
        const double least_clear = 1 - static_cast<double>(settings_.opaque_at);
        while (sum.clear > least_clear) {
            if (settings_.skip)
                for (Walk& walk : walks_) walk.volume->skip(walk.progress);
            std::erase_if(walks_, [](const Walk& walk) { return walk.progress.done(); });
            // The next of all steps.
            std::int64_t k = std::numeric_limits<std::int64_t>::max();
            for (const Walk& walk : walks_) k = std::min(k, walk.progress.k);
            const double end =
                walks_.empty() ? kInfinity : static_cast<double>(k + 1) * walks_.front().progress.dt;
            const double begin =
                walks_.empty() ? kInfinity : static_cast<double>(k) * walks_.front().progress.dt;
            if (layer < layers_.size() && layers_[layer].t < end) {
                // Surfaces in front of the step or in it cut it.
                const double t = layers_[layer].t;
                if (t > begin) step_to(k, t, false, sum);
                slabs_.assign(1, layers_[layer++].slab);
                add_mixed(t, sum);
                continue;
            }
            if (walks_.empty()) break;
            step_to(k, end, true, sum);
        }
        return sum;
    }

private:
    struct Walk {
        const VolumeCaster* volume;
        VolumeCaster::Progress progress;
    };

    /// All volumes that are in step k, up to depth t.
    void step_to(std::int64_t k, double t, bool whole, Gathered& sum) {
        slabs_.clear();
        double front = kInfinity;
        for (Walk& walk : walks_) {
            VolumeCaster::Progress& p = walk.progress;
            if (p.k != k) continue;
            const double begin = p.t;
            const double end = std::min(t, p.t_out);
            if (end > begin) {
                const twin::Slab slab = walk.volume->advance(p, end);
                if (slab.a > 0) {
                    slabs_.push_back(slab);
                    front = std::min(front, begin);
                }
            }
            if (whole) ++p.k;
        }
        add_mixed(front, sum);
    }

    void add_mixed(double front, Gathered& sum) const {
        if (slabs_.empty()) return;
        const twin::Slab mixed = slabs_.size() == 1 ? slabs_.front() : mix_shared(slabs_, settings_.mixing);
        sum.add(front, static_cast<double>(mixed.a),
                {static_cast<double>(mixed.r), static_cast<double>(mixed.g), static_cast<double>(mixed.b)});
    }

    const std::vector<VolumeCaster>* casters_;
    const LayersOfRay* layers_of_ray_;
    MultiVolumeSettings settings_;
    std::vector<Walk> walks_;
    std::vector<DepthLayer> layers_;
    std::vector<twin::Slab> slabs_;
};

}  // namespace

double common_step(const PreparedScene& scene, double step_in_voxels) {
    double pitch = kInfinity;
    for (const VolumeObject& volume : scene.volumes)
        if (!volume.bounds().empty()) pitch = std::min(pitch, voxel_pitch(volume.to_world()));
    for (const Object& object : scene.objects)
        if (IsosurfaceCaster::casts(object))
            pitch = std::min(pitch, voxel_pitch(object.geometry->field_surface()->to_world));
    if (pitch < kInfinity) return step_in_voxels * pitch;
    return std::max(scene.camera.far() - scene.camera.near(), 1e-100);
}

twin::Slab mix_shared(std::span<const twin::Slab> slabs, SlabMixing mixing) {
    twin::Slab mixed = slabs.front();
    Vec3 color(static_cast<double>(mixed.r), static_cast<double>(mixed.g), static_cast<double>(mixed.b));
    double opacity = static_cast<double>(mixed.a);
    Vec3 sum = color, weighted(0.0), solid(0.0);
    double opacities = opacity, depths = 0;
    int solids = 0;
    const auto weigh = [&](double a, const Vec3& c) {
        if (a >= 1) {
            ++solids;
            solid += c;
        } else if (a > 0) {
            const double depth = -std::log1p(-a);
            depths += depth;
            weighted += depth / a * c;
        }
    };
    weigh(opacity, color);
    for (const twin::Slab& slab : slabs.subspan(1)) {
        const auto a = static_cast<double>(slab.a);
        const Vec3 c(static_cast<double>(slab.r), static_cast<double>(slab.g), static_cast<double>(slab.b));
        weigh(a, c);
        sum += c;
        opacities += a;
        color = color + c - 0.5 * (color * a + c * opacity);  // zSlab (4.4)
        opacity = 1 - (1 - opacity) * (1 - a);                // zSlab (4.1)
        mixed.d = std::max(mixed.z, slab.z) - std::min(mixed.z - mixed.d, slab.z - slab.d);
        mixed.z = std::max(mixed.z, slab.z);
    }
    if (mixing == SlabMixing::normalised)
        color = opacities > 0 ? opacity / opacities * sum : Vec3(0.0);  // (4.3)
    if (mixing == SlabMixing::extinction)
        color = solids > 0   ? solid / static_cast<double>(solids)
                : depths > 0 ? opacity / depths * weighted
                             : Vec3(0.0);
    mixed.r = static_cast<float>(color.x);
    mixed.g = static_cast<float>(color.y);
    mixed.b = static_cast<float>(color.z);
    mixed.a = static_cast<float>(opacity);
    return mixed;
}

LayersOfRay::LayersOfRay(const PreparedScene& scene, const CastSettings& settings) {
    for (const Object& object : scene.objects)
        if (IsosurfaceCaster::casts(object)) isosurfaces_.emplace_back(scene, object, settings);
}

std::size_t LayersOfRay::bytes() const {
    std::size_t sum = 0;
    for (const IsosurfaceCaster& surface : isosurfaces_) sum += surface.bytes();
    return sum;
}

void LayersOfRay::find(const Ray& ray, std::span<const twin::Slab> others, SlabMixing mixing,
                       std::vector<DepthLayer>& out) const {
    out.clear();
    for (const twin::Slab& slab : others) out.push_back({static_cast<double>(slab.z), slab});
    if (!isosurfaces_.empty()) {
        std::vector<IsosurfaceCaster::Crossing> found;
        for (const IsosurfaceCaster& surface : isosurfaces_) surface.crossings(ray, found);
        for (const IsosurfaceCaster::Crossing& c : found)
            out.push_back({c.t, IsosurfaceCaster::virtual_slab(c, 0)});
        std::ranges::stable_sort(out, {}, &DepthLayer::t);
    }
    // One layer a depth.
    std::vector<twin::Slab> same;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < out.size();) {
        same.clear();
        const double t = out[i].t;
        for (; i < out.size() && out[i].t == t; ++i) same.push_back(out[i].slab);
        out[kept++] = {t, same.size() == 1 ? same.front() : mix_shared(same, mixing)};
    }
    out.resize(kept);
}

int rows_of_band(const Camera& camera, int rays) {
    constexpr double kMostRays = 1 << 21;
    return std::max(1, static_cast<int>(kMostRays / (static_cast<double>(camera.width()) * rays * rays)));
}

Image cast_volumes(const PreparedScene& scene, const MultiVolumeSettings& settings, MultiVolumeStats& stats,
                   const std::function<void(double)>& progress, const FindSurfaces& surfaces) {
    Stopwatch watch;
    const CastSettings cast{.step = common_step(scene, settings.step), .skip = settings.skip};
    const std::vector<VolumeCaster> casters = make_casters(scene, cast);
    const LayersOfRay layers_of_ray(scene, cast);
    for (const VolumeCaster& caster : casters) stats.bytes += static_cast<std::int64_t>(caster.bytes());
    stats.bytes += static_cast<std::int64_t>(layers_of_ray.bytes());
    stats.prepare_s += watch.lap();

    const Camera& camera = scene.camera;
    const int n = settings.rays;
    Image image(camera.width(), camera.height());
    std::array<std::span<float>, 5> planes;
    const std::array<const char*, 5> names{"R", "G", "B", "A", "Z"};
    for (std::size_t i = 0; i < 5; ++i) planes[i] = image.add(names[i]);
    const auto wide = [](int number) { return static_cast<std::size_t>(number); };
    std::atomic<int> done{0};
    const int band = surfaces ? rows_of_band(camera, n) : std::max(1, camera.height());
    for (int y0 = 0; y0 < camera.height(); y0 += band) {
        const int y1 = std::min(y0 + band, camera.height());
        const SurfaceLayers layers = surfaces ? surfaces(y0, y1) : SurfaceLayers{};
        stats.surfaces_s += watch.lap();
        parallel_for(wide(y1 - y0), 1, [&](std::size_t begin, std::size_t end) {
            MultiVolumeRay ray(casters, layers_of_ray, settings);
            for (std::size_t row = begin; row < end; ++row) {
                const int y = y0 + static_cast<int>(row);
                for (int x = 0; x < camera.width(); ++x) {
                    Vec3 color(0.0);
                    double clear = 0;
                    double z = kInfinity;
                    for (int part = 0; part < n * n; ++part) {
                        const int i = part % n, j = part / n;
                        const std::size_t number =
                            (row * wide(n) + wide(j)) * wide(camera.width()) * wide(n) + wide(x) * wide(n) +
                            wide(i);
                        const Gathered sum =
                            ray.cast(camera.ray(x + (i + 0.5) / n, y + (j + 0.5) / n), layers.of(number));
                        color += sum.color;
                        clear += sum.clear;
                        z = std::min(z, sum.z);
                    }
                    const double share = 1.0 / (n * n);
                    const std::size_t pixel = wide(y) * wide(camera.width()) + wide(x);
                    for (int c = 0; c < 3; ++c) planes[wide(c)][pixel] = static_cast<float>(share * color[c]);
                    planes[3][pixel] = static_cast<float>(1 - share * clear);
                    planes[4][pixel] = static_cast<float>(z);
                }
                progress(++done / static_cast<double>(camera.height()));
            }
        });
        stats.cast_s += watch.lap();
    }
    stats.rays += image.pixel_count() * static_cast<std::uint64_t>(n * n);
    return image;
}

}  // namespace pellucid
