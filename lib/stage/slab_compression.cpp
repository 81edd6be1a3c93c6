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
/// What lets two slabs of different slopes never merge by slope: a gap between them.
constexpr float kNever = std::numeric_limits<float>::infinity();

[[nodiscard]] Slab joined(const Slab& a, const Slab& b) {
    Slab s = twin::slab_over(a, b);
    s.d = twin::thickness_between(twin::slab_front(a), b.z);
    s.z = b.z;
    return s;
}

[[nodiscard]] std::vector<Slab> compress_by_tail(std::span<const Slab> slabs, std::size_t most) {
    std::vector<Slab> kept(slabs.begin(), slabs.begin() + static_cast<std::ptrdiff_t>(most));
    for (const Slab& slab : slabs.subspan(most)) kept.back() = joined(kept.back(), slab);
    return kept;
}

[[nodiscard]] std::vector<Slab> compress_by_slope(std::span<const Slab> slabs, std::size_t most) {
    SlabCollector collector({.layers = static_cast<int>(most) + 1, .compression = SlabCompression::slope, .opaque_at = 1});
    collector.start();
    for (const Slab& slab : slabs) (void)collector.push(slab);
    const auto kept = collector.finish();
    return {kept.begin(), kept.end()};
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
    switch (compression) {
        case SlabCompression::tail: return compress_by_tail(slabs, most);
        case SlabCompression::slope: return compress_by_slope(slabs, most);
        case SlabCompression::transmittance: break;
    }
    return compress_by_cost(slabs, most);
}

SlabCollector::SlabCollector(const SlabSettings& settings, float negligible)
    : settings_(settings),
      compression_(settings.compression),
      most_(static_cast<std::size_t>(std::max(settings.layers, 2) - 1)),
      least_(std::max(1.0F - settings.opaque_at, kNothing)),
      negligible_(negligible) {
    const bool looks_ahead = compression_ == SlabCompression::transmittance;
    nodes_.resize(looks_ahead ? std::max<std::size_t>(2 * most_, 8) : most_);
    costs_.resize(nodes_.size());
    slabs_.resize(nodes_.size());
}

float SlabCollector::negligible_cost(const SlabSettings& settings, double step) {
    if (settings.compression != SlabCompression::transmittance) return 0;
    const double slabs = std::max(settings.layers, 2) - 1;
    return static_cast<float>(step * std::min(1.0 / 64, 4 / (slabs * slabs * slabs)));
}

float SlabCollector::cost_with_gap(const Fall& a, float gap, const Fall& b) {
    return area_to_chord(a.d, std::max(gap, 0.0F), b.d, a.drop, b.drop);
}

/// |G_i − G_{i−1}| of (2.6) for slabs that touch.
float SlabCollector::change_of_slope(const Fall& a, float gap, const Fall& b) {
    if (gap > kTouching * b.d) return kNever;
    const auto slope = [](const Fall& f) { return f.d > 0 ? std::min(f.drop / f.d, kSteepest) : kSteepest; };
    return std::abs(slope(b) - slope(a));
}

/// `tail` and `slope`.
bool SlabCollector::joins_otherwise(const Slab& s, const Seen& seen) {
    bool joins = count_ + 1 == most_;
    if (compression_ == SlabCompression::slope) {
        const float length = open_.slab.z - open_.front;
        const float gap = twin::slab_front(s) - open_.slab.z;
        joins = change_of_slope({length, open_.drop()}, gap, {s.d, seen.drop}) < tolerance_;
    }
    if (joins) join(s);
    return joins;
}

/// The slab did not join the open one: that closes, unless there is no room, and by the slope rule no other pair is
/// better.
void SlabCollector::open_another(const Slab& s, const Seen& seen) {
    close();
    if (compression_ == SlabCompression::slope && count_ == most_) {
        std::size_t best = count_ - 1;  // the last with the new one
        float least = kNever;
        for (std::size_t i = 0; i < count_; ++i) {
            const Node& a = nodes_[i];
            const bool last = i + 1 == count_;
            const Slab& next = last ? s : nodes_[i + 1].slab;
            const float drop = last ? seen.drop : nodes_[i + 1].before * next.a;
            const float change = change_of_slope({a.slab.d, a.before * a.slab.a},
                                                 twin::slab_front(next) - a.slab.z, {next.d, drop});
            if (change < least) {
                least = change;
                best = i;
            }
        }
        if (least < kNever) tolerance_ = std::max(tolerance_, least);
        if (best + 1 == count_) {
            const Node& last = nodes_[--count_];
            open(last.slab, last.before, 0.0F);
            return join(s);
        }
        merge_pair(best);
    }
    open(s, seen.before, 0.0F);
}

void SlabCollector::close() {
    if (count_ == nodes_.size()) sweep();
    Node& node = nodes_[count_++];
    node = {open_.slab, open_.before, open_.error};
    if (open_.slabs == 1) return;
    node.slab.d = twin::thickness_between(open_.front, open_.slab.z);
    node.slab.a = std::min(open_.slab.a, 1.0F);
}

void SlabCollector::merge_pair(std::size_t i) {
    nodes_[i].slab = joined(nodes_[i].slab, nodes_[i + 1].slab);
    const auto at = nodes_.begin() + static_cast<std::ptrdiff_t>(i);
    std::copy(at + 2, nodes_.begin() + static_cast<std::ptrdiff_t>(count_), at + 1);
    --count_;
}

/// So many times the geometric mean of the costs: after four sweeps a ray of 256 steps has its tolerance. More
/// loses detail, and less takes more sweeps.
constexpr float kToleranceStep = 4.0F;

/// A float's bits are its logarithm, nearly; and sums of whole numbers are the same in any order.
float SlabCollector::tolerance_after(float tolerance, float least, std::uint32_t sum, std::uint32_t pairs) {
    const float mean = twin::uintBitsToFloat((sum / pairs) << kCostShift);
    return std::max({tolerance, least, kToleranceStep * mean});
}

/// ε rises. The least cost is within it, so that there is room after the sweep. No slab is in two pairs.
void SlabCollector::sweep() {
    float least = kNever;
    std::uint32_t sum = 0;
    for (std::size_t i = 0; i + 1 < count_; ++i) {
        costs_[i] = nodes_[i].error + nodes_[i + 1].error + cost_of(nodes_[i], nodes_[i + 1]);
        least = std::min(least, costs_[i]);
        sum += twin::floatBitsToUint(costs_[i]) >> kCostShift;
    }
    tolerance_ = tolerance_after(tolerance_, least, sum, static_cast<std::uint32_t>(count_ - 1));
    std::size_t kept = 0;
    for (std::size_t i = 0; i < count_; ++kept) {
        const bool pair = i + 1 < count_ && costs_[i] <= tolerance_;
        nodes_[kept] = pair ? Node{joined(nodes_[i].slab, nodes_[i + 1].slab), nodes_[i].before, costs_[i]} : nodes_[i];
        i += pair ? 2 : 1;
    }
    count_ = kept;
}

/// Pair by pair, the least cost first, as many as fit.
void SlabCollector::keep_dearest() {
    for (std::size_t i = 0; i + 1 < count_; ++i) costs_[i] = cost_of(nodes_[i], nodes_[i + 1]);
    while (count_ > most_) {
        const auto last = costs_.begin() + static_cast<std::ptrdiff_t>(count_) - 1;
        const auto least = std::min_element(costs_.begin(), last);
        const auto best = static_cast<std::size_t>(least - costs_.begin());
        merge_pair(best);
        std::copy(least + 1, last, least);
        if (best > 0) costs_[best - 1] = cost_of(nodes_[best - 1], nodes_[best]);
        if (best + 1 < count_) costs_[best] = cost_of(nodes_[best], nodes_[best + 1]);
    }
}

std::span<const Slab> SlabCollector::finish() {
    if (open_.slabs > 0) close();
    open_.slabs = 0;
    return finish_closed();
}

std::span<const Slab> SlabCollector::finish(std::span<const Node> nodes) {
    assert(nodes.size() <= nodes_.size());
    std::copy(nodes.begin(), nodes.end(), nodes_.begin());
    count_ = nodes.size();
    return finish_closed();
}

std::span<const Slab> SlabCollector::finish_closed() {
    if (count_ > most_) keep_dearest();
    for (std::size_t i = 0; i < count_; ++i) slabs_[i] = nodes_[i].slab;
    return {slabs_.data(), count_};
}

}  // namespace pellucid
