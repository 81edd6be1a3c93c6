// Fewer zSlabs with the same composite (zSlab dissertation, section 2.2.1): tail-handling, the greedy slope rule, and
// the future work it names: what is merged is what changes the transmittance curve least.
//
// Two successive slabs become one from the first's front to the second's back: they composite (1.4, 1.5), and a gap
// between them becomes part of it. So what later comes to lie in the gap is mixed with the medium instead of
// standing free; that is why `transmittance` counts a filled gap as a change and `slope` merges touching slabs only.
//
//   tail           the first n − 1 stay, all others become the last
//   slope          G = |A_i − A_{i−1}|/(z_i − z_{i−1}) (2.6), of each slab from its own front. A slab joins the
//                  touching one before it where G changes by less than ε (2.7). ε starts at 0; where room is
//                  needed the two neighbours whose G differs least merge, and ε becomes that difference if it is
//                  larger. Nothing touches: tail.
//   transmittance  of a curve that falls linearly within a slab and is level in gaps, merging two slabs makes one chord:
//                  the area between both is the cost. The least cost goes first.
#pragma once

#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "kernel/slab_twin.h"
#include "stage/slab_settings.hpp"

namespace pellucid {

/// A sorted array as at most `most` slabs, >= 1. O(n log n).
[[nodiscard]] std::vector<twin::Slab> compress_slabs(std::span<const twin::Slab> slabs, std::size_t most,
                                                     SlabCompression compression);

/// Area between the transmittance curves of two successive slabs and of the one that replaces them, where `before`
/// is the transmittance in front of them.
[[nodiscard]] double merging_cost(const twin::Slab& a, const twin::Slab& b, double before);

/// The same while a ray is cast: sorted slabs come one by one, at most `layers` − 1 stay. After construction nothing
/// is allocated. `tail` and `slope` are as above. `transmittance` looks at up to 2(N − 1) slabs at one time: one that can
/// join the last at no more than what merging has cost so far does so at once; where room is needed, neighbours
/// that cost little merge in one sweep; what is left at the end goes by least cost.
class SlabCollector {
public:
    explicit SlabCollector(const SlabSettings& settings);

    /// Begins a ray.
    void start() {
        count_ = 0;
        before_ = 1.0F;
        tolerance_ = 0.0F;
    }

    /// False once the accumulated opacity is settings.opaque_at or more: no more slabs matter.
    /// Precondition: not in front of the slabs before it.
    bool push(const twin::Slab& slab) {
        const Node node{slab, before_, 0.0F};
        before_ *= 1.0F - slab.a;
        if (count_ == 0 || !joins_last(node)) append(node);
        return before_ > least_;
    }

    /// The array, sorted; valid until the next start(). Call it once a ray.
    [[nodiscard]] std::span<const twin::Slab> finish();

private:
    struct Node {
        twin::Slab slab;
        float before;  // transmittance in front of it
        float error;   // what merging within it has cost

        [[nodiscard]] float drop() const { return before * slab.a; }
    };

    static void join(Node& a, const Node& b) {
        const float front = twin::slab_front(a.slab);
        a.slab = twin::slab_over(a.slab, b.slab);
        a.slab.d = twin::thickness_between(front, b.slab.z);
        a.slab.z = b.slab.z;
    }

    [[nodiscard]] bool joins_last(const Node& node) {
        Node& last = nodes_[count_ - 1];
        if (compression_ == SlabCompression::transmittance) {
            const float error = last.error + cost(last, node);
            if (!(error <= tolerance_)) return false;
            join(last, node);
            last.error = error;
            return true;
        }
        return joins_otherwise(last, node);
    }

    void append(const Node& node) {
        if (count_ == nodes_.size()) sweep();
        nodes_[count_++] = node;
    }

    /// Of two neighbours that touch it is the triangle over the chord, without a division.
    [[nodiscard]] static float cost(const Node& a, const Node& b) {
        const float gap = twin::slab_front(b.slab) - a.slab.z;
        if (gap <= kTouching * b.slab.d) return 0.5F * std::abs(b.slab.d * a.drop() - a.slab.d * b.drop());
        return cost_with_gap(a, b);
    }

    [[nodiscard]] static float cost_with_gap(const Node& a, const Node& b);
    [[nodiscard]] static float slope_change(const Node& a, const Node& b);
    [[nodiscard]] bool joins_otherwise(Node& last, const Node& node);
    [[nodiscard]] bool makes_room_by_slope(Node& last, const Node& node);
    void merge_pair(std::size_t i);
    void merge_cheapest_pair();
    void sweep();

    /// Steps of a ray touch but for rounding.
    static constexpr float kTouching = 1.0F / 64;

    SlabCompression compression_;
    std::size_t most_;
    float least_;
    float before_ = 1.0F;     // transmittance so far
    float tolerance_ = 0.0F;  // ε
    std::size_t count_ = 0;
    std::vector<Node> nodes_;  // as many as are looked at
    std::vector<twin::Slab> slabs_;
};

}  // namespace pellucid
