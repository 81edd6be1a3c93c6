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
        Composites::Medium sum;
        Vec3 least(kInfinity), most(-kInfinity);
        double depth = 0;
        for (std::size_t i = first; i < last; ++i) {
            const PooledLayer& layer = layers_[indices_[i]];
            const double own = layer.optical_depth * share_between(layer, begin, end);
            if (!(own > 0)) continue;
            const auto set = static_cast<std::size_t>(layer.set);
            depth += own;
            sum.depth[set] += own;
            for (int c = 0; c < 3; ++c) {
                const auto k = static_cast<std::size_t>(c);
                sum.color[set][k] += own * layer.color[c];
                sum.square[k] += own * layer.color[c] * layer.color[c];
            }
            least = glm::min(least, layer.color);
            most = glm::max(most, layer.color);
        }
        if (!(depth > 0)) return;
        const Vec3 range = most - least;
        const double wrong = std::sqrt(out_.clear()) * std::max({range.x, range.y, range.z}) *
                             std::min(1.0, depth * out_.share() / 8);
        if (!(wrong > 0.5 * error_) || level == kMostLevels || !(end - begin > kThinnest * (std::abs(begin) + std::abs(end))))
            return out_.add(sum);

        // Into as many parts as would do if all were alike.
        const double wanted = std::ceil(1.5 * depth * out_.share() / 8 * std::max({range.x, range.y, range.z}) *
                                        std::sqrt(out_.clear()) / (0.5 * error_));
        const int parts = static_cast<int>(std::clamp(wanted, 2.0, double{kMostParts}));
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
