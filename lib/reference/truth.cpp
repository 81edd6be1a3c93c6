#include "reference/truth.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>

#include "core/parallel.hpp"
#include "core/stopwatch.hpp"
#include "reference/ray_scene.hpp"
#include "sample/line_sampler.hpp"
#include "scene/shading.hpp"

namespace pellucid {
namespace {

/// Independent sets of sub-rays a pixel: their spread is the error.
constexpr int kSets = 4;
/// Behind this transmittance nothing is seen: an order below a float's last digit.
constexpr double kOpaque = 1e-9;
/// Depths closer than this share of themselves are equal: rounding of the same plane, told twice.
constexpr double kCoincident = 1e-13;

struct Rgba {
    double c[4]{};
};

/// One of the crossings that are pooled for the particle filter.
struct PooledLayer {
    double t;
    double optical_depth;
    Vec3 color;
    int set;
};

/// One of the crossings at one depth of a ray.
struct MixedLayer {
    double alpha;
    Vec3 color;
};

class PixelTracer {
public:
    PixelTracer(const PreparedScene& scene, const RayScene& ray_scene, const TruthSettings& settings)
        : scene_(scene), ray_scene_(ray_scene), settings_(settings) {}

    /// Everything about one pixel from kSets sets of strata × strata sub-rays.
    void trace(int x, int y, int strata) {
        nearest_ = std::numeric_limits<double>::infinity();
        pool_.clear();
        for (int set = 0; set < kSets; ++set) {
            box_[set] = {};
            trace_set(x, y, strata, set);
        }
        sub_rays_ = strata * strata;
        if (settings_.filter == PixelFilter::particle) {
            estimate_pooled();
        } else {
            estimate_box();
        }
    }

    Rgba mean, variance, repeat_variance;
    std::uint64_t rays = 0;
    std::uint64_t hits = 0;
    [[nodiscard]] double nearest() const { return nearest_; }
    [[nodiscard]] double worst_error() const {
        return std::sqrt(std::max({variance.c[0], variance.c[1], variance.c[2], variance.c[3]}));
    }

private:
    void trace_set(int x, int y, int strata, int set) {
        // Numbered in the whole image, so that a crop has the same pixels.
        const auto pixel = (static_cast<std::uint64_t>(y + scene_.camera.crop().y0) << 24U) |
                           static_cast<std::uint64_t>(x + scene_.camera.crop().x0);
        // A packet takes 4×4 neighbouring strata.
        for (int block_y = 0; block_y < strata; block_y += 4)
            for (int block_x = 0; block_x < strata; block_x += 4) {
                std::array<Ray, kPacket> packet;
                const auto repeat = static_cast<std::uint32_t>(((strata * kSets + set) << 14) +
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
                    add_ray(packet[static_cast<std::size_t>(i)], found_[static_cast<std::size_t>(i)], set);
            }
    }

    void add_ray(const Ray& ray, const std::vector<RayHit>& list, int set) {
        hits += list.size();
        const double ray_length = length(ray.direction);
        double clear = 1;
        Rgba& sum = box_[set];
        for (std::size_t i = 0; i < list.size() && clear >= kOpaque;) {
            // Crossings at one depth are mixed, whatever their order.
            std::size_t end = i + 1;
            while (end < list.size() && list[end].t - list[i].t <= kCoincident * list[i].t) ++end;
            mixed_.clear();
            for (; i < end; ++i) {
                const RayHit& hit = list[i];
                const Object& object = scene_.objects[hit.object];
                if (object.surface.opacity == 0) continue;
                nearest_ = std::min(nearest_, hit.t);
                const double cosine =
                    std::max(std::abs(dot(hit.normal, ray.direction)) / (length(hit.normal) * ray_length), 1e-12);
                const Vec3 point = ray.origin + hit.t * ray.direction;
                const Vec3 color = shade(scene_, object, point, object.geometry->shading_normal(hit.patch, point, hit.normal));
                if (settings_.filter == PixelFilter::particle) {
                    pool_.push_back({hit.t, object.optical_depth(cosine, kMostParticleOpacity), color, set});
                } else {
                    mixed_.push_back({object.opacity(cosine), color});
                }
            }
            double passes = 1;
            for (const MixedLayer& layer : mixed_) {
                const double weight = clear * layer.alpha * mixed_share(layer);
                for (int c = 0; c < 3; ++c) sum.c[c] += weight * layer.color[c];
                passes *= 1 - layer.alpha;
            }
            sum.c[3] += clear * (1 - passes);
            clear *= passes;
        }
    }

    /// Equation (4.4) of the zSlab dissertation, for any number: what a layer of mixed_ keeps of its colour when the layers at its depth
    /// are put in front of it with chance ½ each, averaged over all orders: ∫₀¹ Π (1 − u α_j) du over the
    /// others. Of two, 1 − α_j/2.
    [[nodiscard]] double mixed_share(const MixedLayer& layer) const {
        if (mixed_.size() == 1) return 1;
        std::vector<double> product{1};  // coefficients of Π (1 − u α_j)
        for (const MixedLayer& other : mixed_) {
            if (&other == &layer) continue;
            product.push_back(0);
            for (std::size_t k = product.size() - 1; k > 0; --k) product[k] -= other.alpha * product[k - 1];
        }
        double integral = 0;
        for (std::size_t k = 0; k < product.size(); ++k) integral += product[k] / static_cast<double>(k + 1);
        return integral;
    }

    void estimate_box() {
        mean = variance = repeat_variance = {};
        for (int c = 0; c < 4; ++c) {
            for (const Rgba& set : box_) mean.c[c] += set.c[c] / sub_rays_ / kSets;
            for (const Rgba& set : box_) {
                const double off = set.c[c] / sub_rays_ - mean.c[c];
                variance.c[c] += off * off / (kSets * (kSets - 1));
            }
        }
    }

    /// The composite of the pooled layers, without one of the sets (−1: with all).
    [[nodiscard]] Rgba composite(int left_out, Rgba* second_moment) const {
        const int sets = left_out < 0 ? kSets : kSets - 1;
        const double share = 1.0 / (static_cast<double>(sub_rays_) * sets);
        Rgba sum;
        double clear = 1;
        double known_depth = -1;
        double alpha = 0;
        for (const PooledLayer& layer : pool_) {
            if (layer.set == left_out) continue;
            if (layer.optical_depth != known_depth) {  // many layers share one: exp is the dearest thing here
                known_depth = layer.optical_depth;
                alpha = -std::expm1(-layer.optical_depth * share);
            }
            const double weight = clear * alpha;
            for (int c = 0; c < 3; ++c) sum.c[c] += weight * layer.color[c];
            sum.c[3] += weight;
            if (second_moment != nullptr) {
                for (int c = 0; c < 3; ++c) second_moment->c[c] += weight * layer.color[c] * layer.color[c];
                second_moment->c[3] += weight;
            }
            clear -= weight;
            if (clear < kOpaque) break;
        }
        return sum;
    }

    /// Delete-one-set jackknife: pooling is not linear in the sets, so it takes the bias of order 1/n away too.
    void estimate_pooled() {
        // Stable: surfaces at equal depth alternate ray by ray, which mixes them by their extinctions, as
        // particles do that meet at one depth.
        std::stable_sort(pool_.begin(), pool_.end(), [](const PooledLayer& a, const PooledLayer& b) { return a.t < b.t; });
        Rgba square;
        const Rgba all = composite(-1, &square);
        mean = variance = repeat_variance = {};
        Rgba part[kSets];
        Rgba average;
        for (int set = 0; set < kSets; ++set) {
            part[set] = composite(set, nullptr);
            for (int c = 0; c < 4; ++c) average.c[c] += part[set].c[c] / kSets;
        }
        for (int c = 0; c < 4; ++c) {
            mean.c[c] = kSets * all.c[c] - (kSets - 1) * average.c[c];
            if (c == 3) mean.c[c] = std::clamp(mean.c[c], 0.0, 1.0);
            for (const Rgba& each : part) {
                const double off = each.c[c] - average.c[c];
                variance.c[c] += off * off * (kSets - 1) / kSets;
            }
            repeat_variance.c[c] = std::max(0.0, square.c[c] - all.c[c] * all.c[c]);
        }
    }

    const PreparedScene& scene_;
    const RayScene& ray_scene_;
    const TruthSettings& settings_;
    PacketHits found_;
    std::vector<PooledLayer> pool_;
    std::vector<MixedLayer> mixed_;  // of one ray and depth
    Rgba box_[kSets];
    int sub_rays_ = 0;
    double nearest_ = 0;
};

}  // namespace

Image trace_truth(const PreparedScene& scene, const TruthSettings& settings, TruthStats& stats) {
    Stopwatch watch;
    const RayScene rays(scene);
    stats.build_s = watch.lap();
    stats.embree_bytes = rays.bytes();

    const int width = scene.camera.width();
    Image image(width, scene.camera.height());
    const char* const names[4] = {"R", "G", "B", "A"};
    std::span<float> mean[4], variance[4], repeat_variance[4];
    for (int c = 0; c < 4; ++c) {
        mean[c] = image.add(names[c]);
        variance[c] = image.add(std::string("variance.") + names[c]);
        if (settings.filter == PixelFilter::particle)
            repeat_variance[c] = image.add(std::string("repeat_variance.") + names[c]);
    }
    const std::span<float> z = image.add("Z", std::numeric_limits<float>::infinity());

    (void)watch.lap();
    std::mutex merging;
    double squares = 0;
    // Sums of floats are kept a row and added in order at the end: the same for any number of threads.
    std::vector<double> row_squares(static_cast<std::size_t>(scene.camera.height()), 0);
    parallel_for(static_cast<std::size_t>(scene.camera.height()), 1, [&](std::size_t begin, std::size_t end) {
        PixelTracer tracer(scene, rays, settings);
        std::uint64_t unresolved = 0;
        double worst = 0;
        for (std::size_t row = begin; row < end; ++row)
            for (int x = 0; x < width; ++x) {
                int strata = 4;
                tracer.trace(x, static_cast<int>(row), strata);
                while (tracer.worst_error() > settings.max_error && 4 * strata * strata * kSets <= settings.max_samples) {
                    strata *= 2;
                    tracer.trace(x, static_cast<int>(row), strata);
                }
                unresolved += tracer.worst_error() > settings.max_error ? 1U : 0U;
                worst = std::max(worst, tracer.worst_error());
                const std::size_t i = row * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
                for (int c = 0; c < 4; ++c) {
                    mean[c][i] = static_cast<float>(tracer.mean.c[c]);
                    variance[c][i] = static_cast<float>(tracer.variance.c[c]);
                    if (c < 3) row_squares[row] += tracer.variance.c[c];
                    if (!repeat_variance[c].empty())
                        repeat_variance[c][i] = static_cast<float>(tracer.repeat_variance.c[c]);
                }
                z[i] = static_cast<float>(tracer.nearest());
            }
        const std::scoped_lock lock(merging);
        stats.rays += tracer.rays;
        stats.hits += tracer.hits;
        stats.unresolved_pixels += unresolved;
        stats.worst_error = std::max(stats.worst_error, worst);
    });
    for (const double s : row_squares) squares += s;
    stats.mean_square_error = squares / (3 * static_cast<double>(image.pixel_count()));
    stats.trace_s = watch.lap();
    return image;
}

}  // namespace pellucid
