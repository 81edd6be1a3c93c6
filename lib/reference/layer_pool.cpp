#include "reference/layer_pool.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace pellucid {
namespace {

constexpr auto kSets = static_cast<std::size_t>(kPoolSets);
constexpr std::size_t kAll = kSets;  // the composite with all sets, behind those without one
/// A part is cut in at most so many.
constexpr int kMostParts = 64;
/// Of cuts in cuts: 64^9 and more is the last digit of a depth.
constexpr int kMostLevels = 12;
/// Parts thinner than this share of their depth have no inside.
constexpr double kThinnest = 1e-13;

/// A part whose colours differ is no thicker, whatever its halves say.
constexpr double kThickest = 0.05;

[[nodiscard]] double largest(const Vec3& v) {
    return std::max({v.x, v.y, v.z});
}
/// 1 − e^−x, x >= 0.
[[nodiscard]] double opacity_of(double x) {
    if (x > 0.01) return -std::expm1(-x);
    return x * (1 - x * (1.0 / 2) * (1 - x * (1.0 / 3) * (1 - x * (1.0 / 4) * (1 - x * (1.0 / 5)))));
}

/// The composites with all sets and without each, front to back.
class Composites {
public:
    Composites(int rays_per_set, double opaque) : opaque_(opaque) {
        clear_.fill(1);
        for (std::size_t k = 0; k < kSets; ++k) share_[k] = 1.0 / (static_cast<double>(rays_per_set) * (kPoolSets - 1));
        share_[kAll] = 1.0 / (static_cast<double>(rays_per_set) * kPoolSets);
    }

    struct Medium {
        std::array<double, kSets> depth{};             // optical, by set
        std::array<std::array<double, 3>, kSets> color{};  // times optical depth
        std::array<double, 3> square{};                // of all sets

        void add(std::size_t set, double own, const Vec3& c) {
            depth[set] += own;
            for (int i = 0; i < 3; ++i) {
                const auto k = static_cast<std::size_t>(i);
                color[set][k] += own * c[i];
                square[k] += own * c[i] * c[i];
            }
        }
    };

    void add(const Medium& m) {
        double depth = 0;
        std::array<double, 3> color{};
        for (std::size_t set = 0; set < kSets; ++set) {
            depth += m.depth[set];
            for (std::size_t c = 0; c < 3; ++c) color[c] += m.color[set][c];
        }
        if (!(depth > 0)) return;
        for (std::size_t k = 0; k <= kSets; ++k) {
            const double own = k == kAll ? depth : depth - m.depth[k];
            // What is left of a difference is rounding.
            if (!(own > 1e-14 * depth) || clear_[k] < opaque_) continue;
            const double weight = clear_[k] * opacity_of(own * share_[k]);
            std::array<double, 4>& sum = k == kAll ? out_.all : out_.without[k];
            for (std::size_t c = 0; c < 3; ++c) {
                sum[c] += weight / own * (k == kAll ? color[c] : color[c] - m.color[k][c]);
                if (k == kAll) out_.square[c] += weight / own * m.square[c];
            }
            sum[3] += weight;
            clear_[k] -= weight;
        }
        out_.square[3] = out_.all[3];
    }

    [[nodiscard]] double clear() const { return *std::ranges::max_element(clear_); }
    /// Of the pool, of optical depths.
    [[nodiscard]] double share() const { return share_[0]; }
    [[nodiscard]] bool done() const { return clear() < opaque_; }
    [[nodiscard]] const PooledColors& colors() const { return out_; }

private:
    double opaque_;
    std::array<double, kSets + 1> clear_{}, share_{};
    PooledColors out_;
};

class Spread {
public:
    Spread(const std::vector<PooledLayer>& layers, Composites& out, double error, LayerTree& tree)
        : layers_(layers), out_(out), error_(error), indices_(tree.indices) {}

    void all() {
        if (layers_.empty()) return;
        double begin = kInfinity, end = -kInfinity;
        for (const PooledLayer& layer : layers_) {
            begin = std::min(begin, layer.begin);
            end = std::max(end, layer.end);
        }
        indices_.resize(layers_.size());
        std::iota(indices_.begin(), indices_.end(), 0U);
        part(begin, end, 0, indices_.size(), 0);
    }

private:
    /// What of a layer lies between: crossings are in the part that names them.
    [[nodiscard]] static double share_between(const PooledLayer& layer, double begin, double end) {
        const double length = layer.end - layer.begin;
        if (!(length > 0)) return 1;
        return std::max(0.0, std::min(end, layer.end) - std::max(begin, layer.begin)) / length;
    }

    /// indices_[first, last) reach into [begin, end].
    void part(double begin, double end, std::size_t first, std::size_t last, int level) {
        if (first == last || out_.done()) return;
        std::array<Composites::Medium, 2> half{};
        std::array<double, 2> depth{};
        std::array<Vec3, 2> mean{Vec3(0.0), Vec3(0.0)};
        Vec3 least(kInfinity), most(-kInfinity);
        const double middle = 0.5 * (begin + end);
        for (std::size_t i = first; i < last; ++i) {
            const PooledLayer& layer = layers_[indices_[i]];
            const bool crossing = layer.begin == layer.end;
            bool counts = false;
            for (std::size_t h = 0; h < 2; ++h) {
                if (crossing && (layer.begin >= middle) != (h == 1)) continue;
                const double own = layer.optical_depth *
                                   share_between(layer, h == 0 ? begin : middle, h == 0 ? middle : end);
                if (!(own > 0)) continue;
                counts = true;
                half[h].add(static_cast<std::size_t>(layer.set), own, layer.color);
                depth[h] += own;
                mean[h] += own * layer.color;
            }
            if (!counts) continue;
            least = glm::min(least, layer.color);
            most = glm::max(most, layer.color);
        }
        for (double& d : depth) d *= out_.share();
        const double whole = depth[0] + depth[1];
        if (!(whole > 0)) return;
        // Two layers as one are wrong by ½ τ₀τ₁ (c₀ − c₁); each half by a quarter of that, if alike.
        double wrong = 0;
        if (depth[0] > 0 && depth[1] > 0)
            wrong = std::sqrt(out_.clear()) * out_.share() * largest(glm::abs(mean[0] / depth[0] - mean[1] / depth[1])) *
                    std::min(1.0, 0.125 * depth[0] * depth[1] / whole);
        const double range = largest(most - least);
        const double thick = std::sqrt(out_.clear()) * std::min(1.0, range) * whole;
        const bool fine = wrong <= 0.5 * error_ && (thick <= kThickest || range <= error_);
        if (fine || level == kMostLevels || !(end - begin > kThinnest * (std::abs(begin) + std::abs(end)))) {
            out_.add(half[0]);
            out_.add(half[1]);
            return;
        }

        // Into as many parts as would do if all were alike.
        const double wanted = std::max(std::sqrt(2 * wrong / error_), range > error_ ? thick / kThickest : 1.0);
        const int parts = static_cast<int>(std::clamp(std::ceil(1.3 * wanted), 2.0, double{kMostParts}));
        const double per_depth = parts / (end - begin);
        const auto part_of = [&](double t) { return std::clamp(static_cast<int>((t - begin) * per_depth), 0, parts - 1); };
        std::array<std::size_t, kMostParts + 1> at{};
        for (std::size_t i = first; i < last; ++i) {
            const PooledLayer& layer = layers_[indices_[i]];
            const int to = part_of(layer.end);
            for (int k = part_of(layer.begin); k <= to; ++k) ++at[static_cast<std::size_t>(k) + 1];
        }
        at[0] = last;
        for (std::size_t k = 1; k <= static_cast<std::size_t>(parts); ++k) at[k] += at[k - 1];
        const std::array<std::size_t, kMostParts + 1> start = at;
        const std::size_t stop = at[static_cast<std::size_t>(parts)];
        if (indices_.size() < stop) indices_.resize(stop);
        for (std::size_t i = first; i < last; ++i) {
            const PooledLayer& layer = layers_[indices_[i]];
            const int to = part_of(layer.end);
            for (int k = part_of(layer.begin); k <= to; ++k) indices_[at[static_cast<std::size_t>(k)]++] = indices_[i];
        }
        // Children write behind all of these.
        for (int k = 0; k < parts; ++k) {
            const auto n = static_cast<std::size_t>(k);
            part_after(k == 0 ? begin : begin + k / per_depth, k + 1 == parts ? end : begin + (k + 1) / per_depth,
                       start[n], start[n + 1], stop, level + 1);
        }
    }

    /// A child's list, moved to the end of what is in use.
    void part_after(double begin, double end, std::size_t first, std::size_t last, std::size_t stop, int level) {
        const std::size_t count = last - first;
        if (count == 0) return;
        if (indices_.size() < stop + count) indices_.resize(stop + count);
        std::copy_n(indices_.begin() + static_cast<std::ptrdiff_t>(first), count, indices_.begin() + static_cast<std::ptrdiff_t>(stop));
        part(begin, end, stop, stop + count, level);
    }

    const std::vector<PooledLayer>& layers_;
    Composites& out_;
    double error_;
    std::vector<std::uint32_t>& indices_;
};

}  // namespace

PooledColors composite_sorted(std::vector<PooledLayer>& layers, int rays_per_set, double opaque) {
    // Stable: surfaces at equal depth alternate ray by ray, which mixes them by their extinctions, as particles do
    // that meet at one depth.
    std::stable_sort(layers.begin(), layers.end(),
                     [](const PooledLayer& a, const PooledLayer& b) { return a.begin < b.begin; });
    PooledColors out;
    for (int left_out = 0; left_out <= kPoolSets; ++left_out) {
        const bool all = left_out == kPoolSets;
        const double share = 1.0 / (static_cast<double>(rays_per_set) * (all ? kPoolSets : kPoolSets - 1));
        std::array<double, 4>& sum = all ? out.all : out.without[static_cast<std::size_t>(left_out)];
        double clear = 1;
        double known_depth = -1;
        double alpha = 0;
        for (const PooledLayer& layer : layers) {
            if (layer.set == left_out) continue;
            if (layer.optical_depth != known_depth) {  // many layers share one: exp is the dearest thing here
                known_depth = layer.optical_depth;
                alpha = -std::expm1(-layer.optical_depth * share);
            }
            const double weight = clear * alpha;
            for (int c = 0; c < 3; ++c) sum[static_cast<std::size_t>(c)] += weight * layer.color[c];
            sum[3] += weight;
            if (all) {
                for (int c = 0; c < 3; ++c)
                    out.square[static_cast<std::size_t>(c)] += weight * layer.color[c] * layer.color[c];
                out.square[3] += weight;
            }
            clear -= weight;
            if (clear < opaque) break;
        }
    }
    return out;
}

PooledColors composite_spread(const std::vector<PooledLayer>& layers, int rays_per_set, double opaque, double error,
                              LayerTree& tree) {
    Composites out(rays_per_set, opaque);
    Spread(layers, out, error, tree).all();
    return out.colors();
}

}  // namespace pellucid
