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
#include <cstdint>
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
/// join the last at no more than what merging has cost so far does so at once; where room is needed, pairs of
/// neighbours that cost little merge in one sweep; what is left at the end goes by least cost.
/// `negligible` is what merging may cost from the start; 0: slabs that fit all stay.
class SlabCollector {
public:
    /// A transmittance that no colour survives; products with it are normal numbers.
    static constexpr float kNothing = 1e-30F;
    /// Steps of a ray touch but for rounding.
    static constexpr float kTouching = 1.0F / 64;
    struct Node {
        twin::Slab slab;
        float before;  // transmittance in front of it
        float error;   // what merging within it has cost
    };

    explicit SlabCollector(const SlabSettings& settings, float negligible = 0);

    /// Of rays with steps of this length: a curve that bends evenly along a whole ray costs n³ times less in each of n
    /// slabs, and no more is let go. At most a 64th of a step: within two steps transmittance is off by 1/64.
    [[nodiscard]] static float negligible_cost(const SlabSettings& settings, double step);

    /// Begins a ray.
    void start() {
        count_ = 0;
        open_.slabs = 0;
        before_ = 1.0F;
        tolerance_ = negligible_;
    }

    /// False once the accumulated opacity is settings.opaque_at or more: no more slabs matter, and behind a
    /// transmittance of 1e-30 none is taken. Precondition: not in front of the slabs before it.
    bool push(const twin::Slab& slab) {
        const Seen seen{before_, before_ * slab.a};
        if (seen.before <= kNothing) return false;
        before_ *= 1.0F - slab.a;
        if (open_.slabs == 0) open(slab, seen.before, 0.0F);
        else if (!joins(slab, seen)) open_another(slab, seen);
        return before_ > least_;
    }

    /// The array, sorted; valid until the next start(). Call it once a ray.
    [[nodiscard]] std::span<const twin::Slab> finish();

    [[nodiscard]] const SlabSettings& settings() const { return settings_; }
    [[nodiscard]] float negligible() const { return negligible_; }
    /// How many slabs are looked at.
    [[nodiscard]] std::size_t room() const { return nodes_.size(); }
    /// finish() of a ray that was collected elsewhere by the same rule, such as in lanes: at most room() nodes.
    [[nodiscard]] std::span<const twin::Slab> finish(std::span<const Node> nodes);
    /// ε of a sweep over so many pairs, from the least of their costs and the sum of the bits of all, each
    /// shifted down by kCostShift.
    [[nodiscard]] static float tolerance_after(float tolerance, float least, std::uint32_t sum, std::uint32_t pairs);
    static constexpr int kCostShift = 8;

private:
    /// What the eye gets of a slab: the transmittance in front of it and what it takes of that.
    struct Seen {
        float before, drop;
    };
    /// The last slab, which others may join. Its thickness is set when it closes.
    struct Open {
        twin::Slab slab;
        float front, clear;  // where it begins, and what passes through it
        float before, error;
        std::size_t slabs;  // in it
        [[nodiscard]] float drop() const { return before * slab.a; }
    };

    void open(const twin::Slab& s, float before, float error) {
        open_ = {s, twin::slab_front(s), 1.0F - s.a, before, error, 1};
    }
    void join(const twin::Slab& s) {
        open_.slab.z = s.z;
        open_.slab.r += open_.clear * s.r;
        open_.slab.g += open_.clear * s.g;
        open_.slab.b += open_.clear * s.b;
        open_.slab.a += open_.clear * s.a;
        open_.clear *= 1.0F - s.a;
        ++open_.slabs;
    }

    [[nodiscard]] bool joins(const twin::Slab& s, const Seen& seen) {
        if (compression_ != SlabCompression::transmittance) return joins_otherwise(s, seen);
        const float cost = cost_of({open_.slab.z - open_.front, open_.drop()},
                                   twin::slab_front(s) - open_.slab.z, {s.d, seen.drop});
        const float error = open_.error + cost;
        if (!(error <= tolerance_)) return false;
        join(s);
        open_.error = error;
        return true;
    }

    [[nodiscard]] bool joins_otherwise(const twin::Slab& s, const Seen& seen);
    /// Area of merging two slabs with a gap between them: of two that touch it is the triangle over the chord, without
    /// a division.
    struct Fall {
        float d, drop;
    };
    [[nodiscard]] static float cost_of(const Fall& a, float gap, const Fall& b) {
        if (gap <= kTouching * b.d) return 0.5F * std::abs(b.d * a.drop - a.d * b.drop);
        return cost_with_gap(a, gap, b);
    }
    [[nodiscard]] static float cost_of(const Node& a, const Node& b) {
        return cost_of({a.slab.d, a.before * a.slab.a}, twin::slab_front(b.slab) - a.slab.z,
                       {b.slab.d, b.before * b.slab.a});
    }
    [[nodiscard]] static float cost_with_gap(const Fall& a, float gap, const Fall& b);
    [[nodiscard]] static float change_of_slope(const Fall& a, float gap, const Fall& b);
    void open_another(const twin::Slab& s, const Seen& seen);
    void close();
    void merge_pair(std::size_t i);
    void sweep();
    void keep_dearest();
    [[nodiscard]] std::span<const twin::Slab> finish_closed();

    SlabSettings settings_;
    SlabCompression compression_;
    std::size_t most_;
    float least_;
    float negligible_;
    float before_ = 1.0F;     // transmittance so far
    float tolerance_ = 0.0F;  // ε
    Open open_{};
    std::size_t count_ = 0;    // nodes in use: closed, all in front of the open one
    std::vector<Node> nodes_;  // as many as are looked at
    std::vector<float> costs_;
    std::vector<twin::Slab> slabs_;
};

}  // namespace pellucid
