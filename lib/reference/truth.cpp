#include "reference/truth.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <functional>
#include <limits>
#include <mutex>
#include <numeric>
#include <span>

#include "core/error.hpp"
#include "core/order_weights.hpp"
#include "core/parallel.hpp"
#include "core/stopwatch.hpp"
#include "reference/layer_pool.hpp"
#include "reference/ray_scene.hpp"
#include "reference/volume_rays.hpp"
#include "sample/particle_source.hpp"
#include "scene/shading.hpp"

namespace pellucid {
namespace {

/// Independent sets of sub-rays a pixel: their spread is the error.
constexpr int kSets = kPoolSets;
/// Strata a side of a set in the pilot, and the least in what is kept.
constexpr int kPilotStrata = 4;
/// Strata a side of a set where 16 sub-rays are all that is asked for.
constexpr int kFewStrata = 2;
/// Errors up to so many times what was asked are the scatter of estimates with few degrees of freedom: three under the
/// particle filter; under the box filter three for each stratum that varies, of which an edge has few.
constexpr double kLuckyPilot = 2;
/// Behind this transmittance nothing is seen: an order below a float's last digit.
constexpr double kOpaque = 1e-9;
/// Depths closer than this share of themselves and of the eye's coordinates are equal: rounding of the same place, told
/// twice.
constexpr double kCoincident = 1e-13;

/// Rays through volumes err by at most this share of the standard error that is asked for …
constexpr double kVolumeShare = 1.0 / 20;
/// … and no more than this, whatever was asked for.
constexpr double kVolumeError = 1e-3;

[[nodiscard]] VolumeRaySettings volume_settings(const TruthSettings& settings) {
    VolumeRaySettings s;
    s.tolerance = std::clamp(kVolumeShare * settings.max_error, 1e-9, kVolumeError);
    if (settings.filter == PixelFilter::particle) {
        s.most_opacity = kMostParticleOpacity;
        s.pooled = true;
    }
    return s;
}

struct Rgba {
    double c[4]{};
};

/// One of the crossings at one depth of a ray.
struct MixedLayer {
    double alpha;
    Vec3 color;
};

/// What the sub-rays of a pixel met: which objects (by number modulo 64), and how many crossings.
struct Signature {
    std::uint64_t objects = 0;
    std::uint32_t least = ~0U;
    std::uint32_t most = 0;

    void add(std::uint64_t more_objects, std::uint32_t crossings) {
        objects |= more_objects;
        least = std::min(least, crossings);
        most = std::max(most, crossings);
    }
    void add(const Signature& more) {
        objects |= more.objects;
        least = std::min(least, more.least);
        most = std::max(most, more.most);
    }
    [[nodiscard]] bool unanimous() const { return least == most; }
    /// Whether `other` met something that this pixel's sub-rays may have missed.
    [[nodiscard]] bool lacks(const Signature& other) const {
        return (other.objects & ~objects) != 0 || other.most > most;
    }
};

class PixelTracer {
public:
    PixelTracer(const PreparedScene& scene, const RayScene& ray_scene, const TruthSettings& settings)
        : scene_(scene), ray_scene_(ray_scene), settings_(settings), volumes_(scene, volume_settings(settings)) {
        pool_error_ = volume_settings(settings).tolerance * std::max(1.0, brightest_color(scene));
    }

    /// Everything about one pixel from kSets sets of strata × strata sub-rays. A pilot has sub-rays of its own:
    /// an estimate that decided when to stop is too small, so it is never the one that is kept.
    void trace(int x, int y, int strata, bool pilot) {
        stream_ = pilot ? kPilotStream : 0;
        nearest_ = std::numeric_limits<double>::infinity();
        signature = {};
        pool_.clear();
        pool_share_ = 1.0 / (kSets * strata * strata);
        strata_sums_.assign(static_cast<std::size_t>(strata) * static_cast<std::size_t>(strata), {});
        if (strata == kFewStrata)
            trace_all_sets(x, y);
        else
            for (int set = 0; set < kSets; ++set) trace_set(x, y, strata, set);
        sub_rays_ = strata * strata;
        if (settings_.filter == PixelFilter::particle) {
            estimate_pooled();
        } else {
            estimate_box();
        }
    }

    Rgba mean, variance, repeat_variance;
    /// What the sub-rays met, for the comparison with neighbours.
    Signature signature;
    std::uint64_t rays = 0;
    std::uint64_t hits = 0;
    [[nodiscard]] double nearest() const { return nearest_; }
    [[nodiscard]] const IsolationStats& isolation() const { return found_.patch.stats; }
    [[nodiscard]] std::uint64_t cut_short() const { return volumes_.cut_short(); }
    [[nodiscard]] double worst_error() const {
        return std::sqrt(std::max({variance.c[0], variance.c[1], variance.c[2], variance.c[3]}));
    }

private:
    void trace_set(int x, int y, int strata, int set) {
        const std::uint64_t pixel = number(x, y);
        // A packet takes 4×4 neighbouring strata.
        for (int block_y = 0; block_y < strata; block_y += 4)
            for (int block_x = 0; block_x < strata; block_x += 4) {
                std::array<Ray, kPacket> packet;
                const auto repeat = static_cast<std::uint32_t>(stream_ + ((strata * kSets + set) << 14) +
                                                               (block_y / 4) * 128 + block_x / 4);
                RandomStream random(settings_.seed, {.object = static_cast<std::uint32_t>(Purpose::truth_jitter),
                                                     .repeat = repeat,
                                                     .index = pixel});
                for (int i = 0; i < kPacket; ++i) {
                    const double u = (block_x + (i & 3) + unit_interval(random())) / strata;
                    const double v = (block_y + (i >> 2) + unit_interval(random())) / strata;
                    packet[static_cast<std::size_t>(i)] = scene_.camera.ray(x + u, y + v);
                }
                ray_scene_.gather(packet, found_);
                rays += kPacket;
                for (int i = 0; i < kPacket; ++i)
                    add_ray(packet[static_cast<std::size_t>(i)], found_[static_cast<std::size_t>(i)], set,
                            (block_y + (i >> 2)) * strata + block_x + (i & 3));
            }
    }

    /// Sets of 2 × 2 strata: one packet holds them all.
    void trace_all_sets(int x, int y) {
        static_assert(kSets * kFewStrata * kFewStrata == kPacket);
        std::array<Ray, kPacket> packet;
        RandomStream random(settings_.seed, {.object = static_cast<std::uint32_t>(Purpose::truth_jitter),
                                             .repeat = static_cast<std::uint32_t>(stream_ + (kFewStrata * kSets << 14)),
                                             .index = number(x, y)});
        for (int i = 0; i < kPacket; ++i) {
            const double u = ((i & 1) + unit_interval(random())) / kFewStrata;
            const double v = ((i >> 1 & 1) + unit_interval(random())) / kFewStrata;
            packet[static_cast<std::size_t>(i)] = scene_.camera.ray(x + u, y + v);
        }
        ray_scene_.gather(packet, found_);
        rays += kPacket;
        for (int i = 0; i < kPacket; ++i)
            add_ray(packet[static_cast<std::size_t>(i)], found_[static_cast<std::size_t>(i)], i >> 2, i & 3);
    }

    /// Of a pixel in the whole image, so that a crop has the same pixels.
    [[nodiscard]] std::uint64_t number(int x, int y) const {
        return (static_cast<std::uint64_t>(y + scene_.camera.crop().y0) << 24U) |
               static_cast<std::uint64_t>(x + scene_.camera.crop().x0);
    }

    void add_ray(const Ray& ray, const std::vector<RayHit>& list, int set, int stratum) {
        hits += list.size();
        const double ray_length = length(ray.direction);
        const double eye = std::max({std::abs(ray.origin.x), std::abs(ray.origin.y), std::abs(ray.origin.z)}) / ray_length;
        std::uint64_t objects = 0;
        for (const RayHit& hit : list) objects |= std::uint64_t{1} << (hit.object & 63U);
        double clear = 1;
        Rgba sum;
        if (volumes_.has_volumes()) volumes_.start(ray, pool_share_);
        for (std::size_t i = 0; i < list.size() && clear >= kOpaque;) {
            // Crossings at one depth are mixed, whatever their order.
            std::size_t end = i + 1;
            while (end < list.size() && list[end].t - list[i].t <= kCoincident * (list[i].t + eye)) ++end;
            if (volumes_.has_volumes()) add_volumes(list[i].t, set, clear, sum);
            mixed_.clear();
            for (; i < end; ++i) {
                const RayHit& hit = list[i];
                const Object& object = scene_.objects[hit.object];
                const Vec3 point = ray.origin + hit.t * ray.direction;
                const double share = object.geometry->opacity_at(point);
                if (object.surface.opacity * share == 0) continue;
                nearest_ = std::min(nearest_, hit.t);
                const double cosine =
                    std::max(std::abs(dot(hit.normal, ray.direction)) / (length(hit.normal) * ray_length), 1e-12);
                const Vec3 color = shade(scene_, object, point, object.geometry->shading_normal(hit.patch, point, hit.normal));
                if (settings_.filter == PixelFilter::particle) {
                    pool_.push_back({hit.t, hit.t, object.optical_depth(cosine, kMostParticleOpacity, share), color, set});
                } else {
                    mixed_.push_back({object.opacity(cosine, share), color});
                }
            }
            double passes = 1;
            mixed_alphas_.clear();
            for (const MixedLayer& layer : mixed_) mixed_alphas_.push_back(layer.alpha);
            weigh_all_orders(mixed_alphas_, mixed_weights_);
            for (std::size_t k = 0; k < mixed_.size(); ++k) {
                const MixedLayer& layer = mixed_[k];
                const double weight = clear * layer.alpha * mixed_weights_[k];
                for (int c = 0; c < 3; ++c) sum.c[c] += weight * layer.color[c];
                passes *= 1 - layer.alpha;
            }
            sum.c[3] += clear * (1 - passes);
            clear *= passes;
        }
        std::uint32_t met = 0;
        if (volumes_.has_volumes()) {
            if (clear >= kOpaque) add_volumes(kInfinity, set, clear, sum);
            // Their bits behind those of the surfaces, round the end of the 64.
            objects |= std::rotl(volumes_.met(), static_cast<int>(scene_.objects.size() & 63U));
            met = static_cast<std::uint32_t>(std::popcount(volumes_.met()));
        }
        signature.add(objects, static_cast<std::uint32_t>(list.size()) + met);
        StratumSums& sums = strata_sums_[static_cast<std::size_t>(stratum)];
        for (std::size_t c = 0; c < 4; ++c) {
            sums.value[c] += sum.c[c];
            sums.square[c] += sum.c[c] * sum.c[c];
        }
    }

    /// What volumes hold from the last place of the ray up to depth t.
    void add_volumes(double t, int set, double& clear, Rgba& sum) {
        layers_.clear();
        volumes_.advance(t, clear, kOpaque, layers_);
        for (const VolumeLayer& layer : layers_) {
            nearest_ = std::min(nearest_, layer.t - layer.half_length);
            if (settings_.filter == PixelFilter::particle) {
                // What has no inside in double is a crossing.
                const double half = layer.half_length > 1e-11 * std::abs(layer.t) ? layer.half_length : 0;
                pool_.push_back({layer.t - half, layer.t + half, layer.optical_depth, layer.color, set});
                continue;
            }
            const double weight = -clear * std::expm1(-layer.optical_depth);
            for (int c = 0; c < 3; ++c) sum.c[c] += weight * layer.color[c];
            sum.c[3] += weight;
            clear -= weight;
        }
    }

    /// Every stratum has one sub-ray of each set: their spread within strata is the variance of the stratified mean,
    /// without bias and with three degrees of freedom a stratum.
    void estimate_box() {
        mean = variance = repeat_variance = {};
        const auto strata = static_cast<double>(strata_sums_.size());
        for (std::size_t c = 0; c < 4; ++c) {
            for (const StratumSums& sums : strata_sums_) {
                mean.c[c] += sums.value[c];
                variance.c[c] += std::max(0.0, sums.square[c] - sums.value[c] * sums.value[c] / kSets);
            }
            mean.c[c] /= kSets * strata;
            variance.c[c] /= (kSets - 1) * kSets * strata * strata;
        }
    }

    /// Delete-one-set jackknife: pooling is not linear in the sets, so it takes the bias of order 1/n away too.
    void estimate_pooled() {
        const PooledColors pooled =
            volumes_.has_volumes()
                ? composite_spread(pool_, sub_rays_, kOpaque, pool_error_, layer_tree_)
                : composite_sorted(pool_, sub_rays_, kOpaque);
        mean = variance = repeat_variance = {};
        for (std::size_t c = 0; c < 4; ++c) {
            double average = 0;
            for (const auto& part : pooled.without) average += part[c] / kSets;
            mean.c[c] = kSets * pooled.all[c] - (kSets - 1) * average;
            if (c == 3) mean.c[c] = std::clamp(mean.c[c], 0.0, 1.0);
            for (const auto& part : pooled.without) {
                const double off = part[c] - average;
                variance.c[c] += off * off * (kSets - 1) / kSets;
            }
            repeat_variance.c[c] = std::max(0.0, pooled.square[c] - pooled.all[c] * pooled.all[c]);
        }
    }

    static constexpr int kPilotStream = 1 << 30;

    const PreparedScene& scene_;
    const RayScene& ray_scene_;
    const TruthSettings& settings_;
    VolumeRay volumes_;
    std::vector<VolumeLayer> layers_;
    int stream_ = 0;
    PacketHits found_;
    std::vector<PooledLayer> pool_;
    LayerTree layer_tree_;
    double pool_share_ = 1;  // of one sub-ray in the pool
    double pool_error_ = 0;  // that spreading layers may make
    std::vector<MixedLayer> mixed_;  // of one ray and depth
    std::vector<double> mixed_alphas_, mixed_weights_;
    struct StratumSums {  // over the sets
        double value[4]{};
        double square[4]{};
    };
    std::vector<StratumSums> strata_sums_;
    int sub_rays_ = 0;
    double nearest_ = 0;
};

/// The image in the making, pixel by pixel.
class TruthImage {
public:
    TruthImage(const PreparedScene& scene, const RayScene& rays, const TruthSettings& settings)
        : image(scene.camera.width(), scene.camera.height()),
          signatures_(image.pixel_count()),
          strata_(image.pixel_count(), 0),
          unresolved_(image.pixel_count(), 0),
          scene_(scene),
          rays_(rays),
          settings_(settings) {
        for (std::size_t c = 0; c < 4; ++c) {
            mean_[c] = image.add(kChannels[c]);
            variance_[c] = image.add(std::string("variance.") + kChannels[c]);
            if (settings.filter == PixelFilter::particle)
                repeat_variance_[c] = image.add(std::string("repeat_variance.") + kChannels[c]);
        }
        z_ = image.add("Z", std::numeric_limits<float>::infinity());
    }

    /// Traces pixels with at least strata × strata sub-rays a set, and finer until the error is small enough.
    void trace(std::span<const std::size_t> pixels, int strata, TruthStats& stats,
               const std::function<void(double)>& progress = [](double) {}) {
        std::mutex merging;
        std::size_t done = 0;
        parallel_for(pixels.size(), 64, [&](std::size_t begin, std::size_t end) {
            PixelTracer tracer(scene_, rays_, settings_);
            for (std::size_t k = begin; k < end; ++k) trace_pixel(tracer, pixels[k], strata);
            const std::scoped_lock lock(merging);
            stats.rays += tracer.rays;
            stats.hits += tracer.hits;
            stats.isolation += tracer.isolation();
            stats.cut_short += tracer.cut_short();
            done += end - begin;
            progress(static_cast<double>(done) / static_cast<double>(pixels.size()));
        });
    }

    /// The finest strata that settings allow.
    [[nodiscard]] int finest() const {
        int strata = kPilotStrata;
        while (16 * strata * strata * kSets / 4 <= settings_.max_samples) strata *= 2;
        return strata;
    }

    /// Pixels whose sub-rays all met the same, beside one that met more: what is there may have slipped
    /// between the sub-rays, and their agreement is no measure of the error.
    [[nodiscard]] std::vector<std::size_t> doubtful(int strata) const {
        std::vector<std::size_t> found;
        for (int y = 0; y < image.height(); ++y)
            for (int x = 0; x < image.width(); ++x) {
                const std::size_t i = at(x, y);
                if (strata_[i] < strata && signatures_[i].unanimous() && beside_more(x, y)) found.push_back(i);
            }
        return found;
    }

    /// Such pixels that stay unanimous: the error of a share of which n sub-rays met nothing, by Laplace's rule,
    /// times the contrast to the neighbours.
    void add_doubt() {
        for (int y = 0; y < image.height(); ++y)
            for (int x = 0; x < image.width(); ++x) {
                const std::size_t i = at(x, y);
                if (!signatures_[i].unanimous() || !beside_more(x, y)) continue;
                const double n = double{kSets} * strata_[i] * strata_[i];
                const double share_variance = (1 / (n + 2)) * (1 - 1 / (n + 2)) / n;
                for (std::size_t c = 0; c < 4; ++c) {
                    double contrast = 0;
                    for_neighbours(x, y, [&](std::size_t k) {
                        contrast = std::max(contrast, std::abs(static_cast<double>(mean_[c][k]) - static_cast<double>(mean_[c][i])));
                    });
                    variance_[c][i] = std::max(variance_[c][i], static_cast<float>(contrast * contrast * share_variance));
                }
            }
    }

    void summarise(TruthStats& stats) const {
        double squares = 0;
        for (std::size_t i = 0; i < image.pixel_count(); ++i) {
            double worst = 0;
            for (std::size_t c = 0; c < 4; ++c) worst = std::max(worst, static_cast<double>(variance_[c][i]));
            worst = std::sqrt(worst);
            stats.unresolved_pixels += unresolved_[i];
            stats.worst_error = std::max(stats.worst_error, worst);
            for (std::size_t c = 0; c < 3; ++c) squares += static_cast<double>(variance_[c][i]);
        }
        stats.mean_square_error = squares / (3 * static_cast<double>(image.pixel_count()));
    }

    Image image;

private:
    static constexpr const char* kChannels[4] = {"R", "G", "B", "A"};

    [[nodiscard]] std::size_t at(int x, int y) const {
        return static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width()) + static_cast<std::size_t>(x);
    }

    void for_neighbours(int x, int y, const std::function<void(std::size_t)>& look) const {
        for (int v = std::max(0, y - 1); v <= std::min(image.height() - 1, y + 1); ++v)
            for (int u = std::max(0, x - 1); u <= std::min(image.width() - 1, x + 1); ++u)
                if (u != x || v != y) look(at(u, v));
    }

    [[nodiscard]] bool beside_more(int x, int y) const {
        bool more = false;
        for_neighbours(x, y, [&](std::size_t k) { more = more || signatures_[at(x, y)].lacks(signatures_[k]); });
        return more;
    }

    void trace_pixel(PixelTracer& tracer, std::size_t i, int strata) {
        const int x = static_cast<int>(i % static_cast<std::size_t>(image.width()));
        const int y = static_cast<int>(i / static_cast<std::size_t>(image.width()));
        if (settings_.samples) {
            tracer.trace(x, y, strata, false);
            keep(tracer, i, strata, tracer.signature, false);
            return;
        }
        // Rays through volumes are dear, and many pixels of them even: at the first look a pilot asks whether 16 will do.
        Signature met;
        if (!scene_.volumes.empty() && strata_[i] == 0) {
            tracer.trace(x, y, kFewStrata, true);
            met = tracer.signature;
            if (met.unanimous() && tracer.worst_error() <= settings_.max_error) {
                tracer.trace(x, y, kFewStrata, false);
                met.add(tracer.signature);
                if (met.unanimous() && tracer.worst_error() <= kLuckyPilot * settings_.max_error)
                    return keep(tracer, i, kFewStrata, met, false);
            }
        }
        tracer.trace(x, y, kPilotStrata, true);
        met.add(tracer.signature);
        // The error falls at least with the strata a side, as the root of the number of sub-rays.
        const double wanted = kPilotStrata * tracer.worst_error() / settings_.max_error;
        while (strata < wanted && 2 * strata <= finest()) strata *= 2;
        tracer.trace(x, y, strata, false);
        met.add(tracer.signature);
        // The pilot was lucky where the error is this much larger: what it missed is then known, and the
        // choice among estimates that remains is of the rarest.
        while (tracer.worst_error() > kLuckyPilot * settings_.max_error && 2 * strata <= finest()) {
            strata *= 2;
            tracer.trace(x, y, strata, false);
            met.add(tracer.signature);
        }
        const bool unresolved = tracer.worst_error() > kLuckyPilot * settings_.max_error ||
                                (strata < wanted && tracer.worst_error() > settings_.max_error);
        keep(tracer, i, strata, met, unresolved);
    }

    void keep(const PixelTracer& tracer, std::size_t i, int strata, const Signature& met, bool unresolved) {
        strata_[i] = strata;
        unresolved_[i] = unresolved ? 1 : 0;
        signatures_[i] = met;
        for (std::size_t c = 0; c < 4; ++c) {
            mean_[c][i] = static_cast<float>(tracer.mean.c[c]);
            variance_[c][i] = static_cast<float>(tracer.variance.c[c]);
            if (!repeat_variance_[c].empty()) repeat_variance_[c][i] = static_cast<float>(tracer.repeat_variance.c[c]);
        }
        z_[i] = static_cast<float>(tracer.nearest());
    }

    std::span<float> mean_[4], variance_[4], repeat_variance_[4], z_;
    std::vector<Signature> signatures_;
    std::vector<int> strata_;
    std::vector<std::uint8_t> unresolved_;  // 0 or 1
    const PreparedScene& scene_;
    const RayScene& rays_;
    const TruthSettings& settings_;
};

/// Strata a side of each set for so many sub-rays a pixel.
[[nodiscard]] int strata_of(int samples) {
    int strata = kFewStrata;
    while (kSets * strata * strata < samples) strata *= 2;
    return strata;
}

/// Doubtful pixels are traced with up to this many strata a side: 1024 sub-rays.
constexpr int kDoubtStrata = 16;

}  // namespace

Image trace_truth(const PreparedScene& scene, const TruthSettings& settings, TruthStats& stats,
                  const std::function<void(double)>& progress) {
    constexpr double kMostColor = 1e30;  // float32 holds ten thousand times as much
    if (!(brightest_color(scene) <= kMostColor))
        throw input_error("{}: lights and shading give colours up to {:.3g}, expected at most {}", scene.settings.source,
                          brightest_color(scene), kMostColor);
    if (settings.samples && kSets * strata_of(*settings.samples) * strata_of(*settings.samples) != *settings.samples)
        throw input_error("{} sub-rays a pixel, expected 16, 64, 256, … (a power of 4)", *settings.samples);
    Stopwatch watch;
    const RayScene rays(scene);
    stats.build_s = watch.lap();
    stats.embree_bytes = rays.bytes();

    TruthImage truth(scene, rays, settings);
    std::vector<std::size_t> pixels(truth.image.pixel_count());
    std::iota(pixels.begin(), pixels.end(), std::size_t{0});
    truth.trace(pixels, settings.samples ? strata_of(*settings.samples) : kPilotStrata, stats, progress);
    // Finding something makes neighbours doubtful in turn: thin things are followed along.
    const int strata = std::min(kDoubtStrata, truth.finest());
    if (!settings.samples)
        for (pixels = truth.doubtful(strata); !pixels.empty(); pixels = truth.doubtful(strata))
            truth.trace(pixels, strata, stats);
    truth.add_doubt();
    truth.summarise(stats);
    if (stats.cut_short > 0)
        warn("{} of {} rays through volumes needed more than {} halvings: what they saw may err by more than was asked for",
             stats.cut_short, stats.rays, VolumeRay::kMostHalvings);
    stats.trace_s = watch.lap();
    return std::move(truth.image);
}

}  // namespace pellucid
