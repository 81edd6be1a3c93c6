#include "stage/slab_compression.hpp"

#include <algorithm>
#include <cassert>
#include <cstdint>
#include <limits>
#include <queue>

#include "stage/slab_merge.hpp"

namespace pellucid {
namespace {

using twin::Slab;

/// What merging A, then a gap, then B changes. The curve goes from (0, T0) to (a, T1), level to (a + gap, T1) and to
/// (a + gap + b, T2); e1 and e2 are its heights over the chord at the two inner corners.
template <class Real>
[[nodiscard]] Real area_to_chord(Real a, Real gap, Real b, Real drop_a, Real drop_b) {
    const Real length = a + gap + b;
    if (!(length > 0)) return 0;
    const Real slope = (drop_a + drop_b) / length;
    const Real e1 = slope * a - drop_a;
    const Real e2 = slope * (a + gap) - drop_a;
    const Real sides = std::abs(e1) * a + std::abs(e2) * b;
    const Real sum = std::abs(e1) + std::abs(e2);
    if (!(sum > 0)) return 0;
    // Where the curve crosses the chord in the gap, two triangles.
    const Real middle = e1 * e2 >= 0 ? sum : (e1 * e1 + e2 * e2) / sum;
    return (sides + middle * gap) / 2;
}

/// G of (2.6); of a surface: as large as can be.
constexpr float kSteepest = 1e30F;
/// A transmittance that no colour survives; products with it are normal numbers.
constexpr float kNothing = 1e-30F;
/// What lets two slabs of different slopes never merge by slope: a gap between them.
constexpr float kNever = std::numeric_limits<float>::infinity();

[[nodiscard]] Slab joined(const Slab& a, const Slab& b) {
    Slab s = twin::slab_over(a, b);
    s.d = twin::thickness_between(twin::slab_front(a), b.z);
    s.z = b.z;
    return s;
}

/// Least cost first, by a heap whose outdated entries are skipped.
[[nodiscard]] std::vector<Slab> compress_by_cost(std::span<const Slab> slabs, std::size_t most) {
    struct Node {
        Slab slab;
        double before;
        std::uint32_t next, previous;
        std::uint32_t version;
    };
    struct Entry {
        double cost;
        std::uint32_t node, version, next_version;
        // The nearer one of equal ones.
        bool operator<(const Entry& o) const { return cost != o.cost ? cost > o.cost : node > o.node; }
    };
    const auto count = static_cast<std::uint32_t>(slabs.size());
    std::vector<Node> nodes(count);
    double before = 1;
    for (std::uint32_t i = 0; i < count; ++i) {
        nodes[i] = {slabs[i], before, i + 1, i - 1, 0};
        before *= 1 - static_cast<double>(slabs[i].a);
    }
    std::priority_queue<Entry> queue;
    const auto consider = [&](std::uint32_t i) {
        if (i >= count || nodes[i].next >= count) return;
        const Node& next = nodes[nodes[i].next];
        queue.push({merging_cost(nodes[i].slab, next.slab, nodes[i].before), i, nodes[i].version, next.version});
    };
    for (std::uint32_t i = 0; i + 1 < count; ++i) consider(i);
    for (std::size_t left = count; left > most;) {
        const Entry entry = queue.top();
        queue.pop();
        Node& a = nodes[entry.node];
        if (a.version != entry.version || a.next >= count || nodes[a.next].version != entry.next_version) continue;
        Node& b = nodes[a.next];
        a.slab = joined(a.slab, b.slab);
        a.next = b.next;
        ++a.version;
        ++b.version;
        if (a.next < count) nodes[a.next].previous = entry.node;
        consider(entry.node);
        consider(a.previous);
        --left;
    }
    std::vector<Slab> out;
    for (std::uint32_t i = 0; i < count; i = nodes[i].next) out.push_back(nodes[i].slab);
    return out;
}

}  // namespace

double merging_cost(const Slab& a, const Slab& b, double before) {
    const auto wide = [](float v) { return static_cast<double>(v); };
    const double gap = std::max(0.0, wide(b.z) - wide(b.d) - wide(a.z));
    const double drop_b = before * (1 - wide(a.a)) * wide(b.a);
    return area_to_chord(wide(a.d), gap, wide(b.d), before * wide(a.a), drop_b);
}

std::vector<Slab> compress_slabs(std::span<const Slab> slabs, std::size_t most, SlabCompression compression) {
    assert(most >= 1);
    if (slabs.size() <= most) return {slabs.begin(), slabs.end()};
    if (compression == SlabCompression::transmittance) return compress_by_cost(slabs, most);
    SlabSettings settings;
    settings.layers = static_cast<int>(most) + 1;
    settings.compression = compression;
    SlabCollector collector(settings);
    collector.start();
    for (const Slab& slab : slabs) collector.push(slab);
    const auto kept = collector.finish();
    return {kept.begin(), kept.end()};
}

SlabCollector::SlabCollector(const SlabSettings& settings)
    : compression_(settings.compression),
      most_(static_cast<std::size_t>(std::max(settings.layers, 2) - 1)),
      least_(std::max(1.0F - settings.opaque_at, kNothing)) {
    const bool looks_ahead = compression_ == SlabCompression::transmittance;
    nodes_.resize(looks_ahead ? std::max<std::size_t>(2 * most_, 8) : most_);
    slabs_.resize(nodes_.size());
}

float SlabCollector::cost_with_gap(const Node& a, const Node& b) {
    const float gap = std::max(0.0F, twin::slab_front(b.slab) - a.slab.z);
    return area_to_chord(a.slab.d, gap, b.slab.d, a.drop(), b.drop());
}

float SlabCollector::slope_change(const Node& a, const Node& b) {
    if (twin::slab_front(b.slab) - a.slab.z > kTouching * b.slab.d) return kNever;
    const auto slope = [](const Node& n) {
        return n.slab.d > 0 ? std::min(n.drop() / n.slab.d, kSteepest) : kSteepest;
    };
    return std::abs(slope(b) - slope(a));
}

/// `tail` and `slope`.
bool SlabCollector::joins_otherwise(Node& last, const Node& node) {
    const bool full = count_ == most_;
    if (compression_ == SlabCompression::slope) {
        const float change = slope_change(last, node);
        if (!(change < tolerance_) || change == kNever) return full && makes_room_by_slope(last, node);
    } else if (!full) {
        return false;
    }
    join(last, node);
    return true;
}

/// False where neighbours before the last have merged: then there is room.
bool SlabCollector::makes_room_by_slope(Node& last, const Node& node) {
    std::size_t best = count_ - 1;  // the last with the new one
    float least = slope_change(last, node);
    for (std::size_t i = 0; i + 1 < count_; ++i) {
        const float change = slope_change(nodes_[i], nodes_[i + 1]);
        if (change < least) {
            least = change;
            best = i;
        }
    }
    if (least < kNever) tolerance_ = std::max(tolerance_, least);
    if (best == count_ - 1) {
        join(last, node);
        return true;
    }
    merge_pair(best);
    return false;
}

void SlabCollector::merge_pair(std::size_t i) {
    Node& a = nodes_[i];
    const Node& b = nodes_[i + 1];
    a.error += b.error + cost(a, b);
    join(a, b);
    std::copy(nodes_.begin() + static_cast<std::ptrdiff_t>(i) + 2, nodes_.begin() + static_cast<std::ptrdiff_t>(count_),
              nodes_.begin() + static_cast<std::ptrdiff_t>(i) + 1);
    --count_;
}

void SlabCollector::merge_cheapest_pair() {
    std::size_t best = 0;
    float least = kNever;
    for (std::size_t i = 0; i + 1 < count_; ++i) {
        const float c = cost(nodes_[i], nodes_[i + 1]);
        if (c < least) {
            least = c;
            best = i;
        }
    }
    merge_pair(best);
}

/// ε rises to the mean of those costs that are not above the mean of all: about the lower half. The least one is
/// among them, so that there is room after the sweep.
void SlabCollector::sweep() {
    const auto cost_at = [&](std::size_t i) {
        return nodes_[i].error + nodes_[i + 1].error + cost(nodes_[i], nodes_[i + 1]);
    };
    float sum = 0;
    float least = kNever;
    for (std::size_t i = 0; i + 1 < count_; ++i) {
        sum += cost_at(i);
        least = std::min(least, cost_at(i));
    }
    const float mean = sum / static_cast<float>(count_ - 1);
    float low_sum = 0;
    float low_count = 0;
    for (std::size_t i = 0; i + 1 < count_; ++i) {
        const float c = cost_at(i);
        low_sum += c <= mean ? c : 0.0F;
        low_count += c <= mean ? 1.0F : 0.0F;
    }
    tolerance_ = std::max({tolerance_, least, low_sum / std::max(low_count, 1.0F)});
    std::size_t kept = 0;
    for (std::size_t i = 1; i < count_; ++i) {
        const float error = nodes_[kept].error + nodes_[i].error + cost(nodes_[kept], nodes_[i]);
        if (error <= tolerance_) {
            join(nodes_[kept], nodes_[i]);
            nodes_[kept].error = error;
        } else {
            nodes_[++kept] = nodes_[i];
        }
    }
    count_ = kept + 1;
}

std::span<const Slab> SlabCollector::finish() {
    while (count_ > most_) merge_cheapest_pair();
    for (std::size_t i = 0; i < count_; ++i) slabs_[i] = nodes_[i].slab;
    return {slabs_.data(), count_};
}

}  // namespace pellucid
