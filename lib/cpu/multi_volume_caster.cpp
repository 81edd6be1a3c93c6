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

struct Casters {
    std::vector<VolumeCaster> volumes;
    std::vector<IsosurfaceCaster> surfaces;

    Casters(const PreparedScene& scene, const CastSettings& settings) {
        if (!(settings.step > 0)) return;
        for (const VolumeObject& volume : scene.volumes)
            if (!volume.bounds().empty()) volumes.emplace_back(scene, volume, settings);
        for (const Object& object : scene.objects) surfaces.emplace_back(scene, object, settings);
    }
    [[nodiscard]] std::int64_t bytes() const {
        std::size_t sum = 0;
        for (const VolumeCaster& v : volumes) sum += v.bytes();
        for (const IsosurfaceCaster& s : surfaces) sum += s.bytes();
        return static_cast<std::int64_t>(sum);
    }
};

/// One ray after the other; one a thread.
class MultiVolumeRay {
public:
    MultiVolumeRay(const Casters& casters, const MultiVolumeSettings& settings)
        : casters_(&casters), settings_(settings) {}

    [[nodiscard]] Gathered cast(const Ray& ray) {
        walks_.clear();
        surfaces_.clear();
        for (const VolumeCaster& volume : casters_->volumes)
            if (auto p = volume.start(ray); !p.done()) walks_.push_back({&volume, p});
        for (const IsosurfaceCaster& surface : casters_->surfaces) surface.crossings(ray, surfaces_);
        std::ranges::stable_sort(surfaces_, {}, &IsosurfaceCaster::Crossing::t);

        Gathered sum;
        std::size_t surface = 0;
        const double least_clear = 1 - static_cast<double>(settings_.opaque_at);
        while (sum.clear > least_clear) {
            if (settings_.skip)
                for (Walk& walk : walks_) walk.volume->skip(walk.progress);
            std::erase_if(walks_, [](const Walk& walk) { return walk.progress.done(); });
            // The next of all steps.
            std::int64_t k = std::numeric_limits<std::int64_t>::max();
            for (const Walk& walk : walks_) k = std::min(k, walk.progress.k);
            const double end = walks_.empty() ? kInfinity : static_cast<double>(k + 1) * walks_.front().progress.dt;
            const double begin = walks_.empty() ? kInfinity : static_cast<double>(k) * walks_.front().progress.dt;
            if (surface < surfaces_.size() && surfaces_[surface].t < end) {
                // Surfaces in front of the step or in it cut it; what shares a depth is mixed.
                const double t = surfaces_[surface].t;
                if (t > begin) step_to(k, t, false, sum);
                slabs_.clear();
                for (; surface < surfaces_.size() && surfaces_[surface].t == t; ++surface)
                    slabs_.push_back(IsosurfaceCaster::virtual_slab(surfaces_[surface], 0, 0));
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

    const Casters* casters_;
    MultiVolumeSettings settings_;
    std::vector<Walk> walks_;
    std::vector<IsosurfaceCaster::Crossing> surfaces_;
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
    return pitch < kInfinity ? step_in_voxels * pitch : 0;
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
    if (mixing == SlabMixing::normalised) color = opacities > 0 ? opacity / opacities * sum : Vec3(0.0);  // (4.3)
    if (mixing == SlabMixing::extinction)
        color = solids > 0 ? solid / static_cast<double>(solids)
                           : depths > 0 ? opacity / depths * weighted : Vec3(0.0);
    mixed.r = static_cast<float>(color.x);
    mixed.g = static_cast<float>(color.y);
    mixed.b = static_cast<float>(color.z);
    mixed.a = static_cast<float>(opacity);
    return mixed;
}

Image cast_volumes(const PreparedScene& scene, const MultiVolumeSettings& settings, MultiVolumeStats& stats,
                   const std::function<void(double)>& progress) {
    Stopwatch watch;
    const Casters casters(scene, {.step = common_step(scene, settings.step), .skip = settings.skip});
    stats.prepare_s = watch.lap();
    stats.bytes = casters.bytes();

    const Camera& camera = scene.camera;
    Image image(camera.width(), camera.height());
    std::array<std::span<float>, 5> planes;
    const std::array<const char*, 5> names{"R", "G", "B", "A", "Z"};
    for (std::size_t i = 0; i < 5; ++i) planes[i] = image.add(names[i]);
    std::atomic<int> rows{0};
    parallel_for(static_cast<std::size_t>(camera.height()), 1, [&](std::size_t begin, std::size_t end) {
        MultiVolumeRay ray(casters, settings);
        for (std::size_t y = begin; y < end; ++y) {
            for (int x = 0; x < camera.width(); ++x) {
                Vec3 color(0.0);
                double clear = 0;
                double z = kInfinity;
                for (int part = 0; part < settings.rays * settings.rays; ++part) {
                    const double dx = (part % settings.rays + 0.5) / settings.rays;
                    const double dy = (part / settings.rays + 0.5) / settings.rays;
                    const Gathered sum = ray.cast(camera.ray(x + dx, static_cast<double>(y) + dy));
                    color += sum.color;
                    clear += sum.clear;
                    z = std::min(z, sum.z);
                }
                const double share = 1.0 / (settings.rays * settings.rays);
                const std::size_t pixel = y * static_cast<std::size_t>(camera.width()) + static_cast<std::size_t>(x);
                for (int c = 0; c < 3; ++c)
                    planes[static_cast<std::size_t>(c)][pixel] = static_cast<float>(share * color[c]);
                planes[3][pixel] = static_cast<float>(1 - share * clear);
                planes[4][pixel] = static_cast<float>(z);
            }
            progress(++rows / static_cast<double>(camera.height()));
        }
    });
    stats.rays += image.pixel_count() * static_cast<std::uint64_t>(settings.rays * settings.rays);
    stats.cast_s = watch.lap();
    return image;
}

}  // namespace pellucid
