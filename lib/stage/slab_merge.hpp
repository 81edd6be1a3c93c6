// Arrays of zSlabs: merged in one scan, filled in any order, merged without regard to order, composited (zSlab
// dissertation, chapter 4).
//
// A sorted array's slabs do not overlap: each begins at or behind the end of the one before it.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "kernel/slab_twin.h"
#include "stage/slab_settings.hpp"

namespace pellucid {

using SlabArray = std::vector<twin::Slab>;

/// Sorted, no overlap, every number finite, thickness >= 0, opacity in [0, 1].
[[nodiscard]] bool is_sorted_array(std::span<const twin::Slab> slabs);

/// Two sorted arrays in one scan, O(n + m); sorted, and never longer than both together. The same bits for (b, a).
///   settings.opaque_at  what lies behind the slab that reaches it is left out
[[nodiscard]] SlabArray merge_arrays(std::span<const twin::Slab> a, std::span<const twin::Slab> b,
                                     const SlabSettings& settings);
/// The same into `out`, which holds a.size() + b.size() at least and is neither; the number of slabs.
[[nodiscard]] std::size_t merge_arrays(std::span<const twin::Slab> a, std::span<const twin::Slab> b,
                                       const SlabSettings& settings, std::span<twin::Slab> out);

/// One more slab into a sorted array, wherever it lies: at most one longer, O(n).
void insert_slab(SlabArray& array, const twin::Slab& slab, const SlabSettings& settings);

/// All slabs of all arrays at once, over the intervals between all their ends, so that no result depends on the
/// order of arrays or slabs, to the last bit; the arrays may overlap themselves. Two slabs mix by settings.mixing; for
/// more, `average` is the mean over all orders of compositing, Σ C_i ∫₀¹ Π_{j≠i}(1 − tα_j) dt, which is (4.4) for two.
///   settings.opaque_at  as in merge_arrays
[[nodiscard]] SlabArray merge_order_free(std::span<const std::span<const twin::Slab>> arrays, const SlabSettings& settings);

/// What merge_order_free of `slabs` slabs needs at most.
struct OrderFreePlan {
    std::size_t most_slabs = 0;  // of the result
    std::size_t bytes = 0;       // held at one time, the result included
};
[[nodiscard]] OrderFreePlan order_free_plan(std::size_t slabs);

/// All of a sorted array as one slab from the first's front to the last's back; of none: all zero.
[[nodiscard]] twin::Slab composite(std::span<const twin::Slab> slabs);

}  // namespace pellucid
