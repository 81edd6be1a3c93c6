// merge_arrays (stage/slab_merge.hpp) for many pixels at once: the same twin functions, 16 pixels side by side in SIMD of
// whatever width there is, chosen at run time. Equal bits.
#pragma once

#include <cstddef>
#include <span>

#include "kernel/slab_twin.h"
#include "stage/slab_settings.hpp"

namespace pellucid {

/// One pixel's two sorted arrays and where they go.
struct SlabMergeJob {
    std::span<const twin::Slab> a, b;
    std::span<twin::Slab> out;  // room for a.size() + b.size(), and neither of them
    std::size_t count = 0;      // of slabs in it, when done
};

/// All of the jobs on the calling thread. As fast as can be where jobs are about equally long or many.
void merge_many(std::span<SlabMergeJob> jobs, const SlabSettings& settings);

}  // namespace pellucid
