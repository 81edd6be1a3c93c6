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

/// Which code this machine takes is found out once, when this is made.
class SlabMergeLanes {
public:
    explicit SlabMergeLanes(const SlabSettings& settings);

    /// All of the jobs on the calling thread; any number of threads may call. As fast as can be where jobs are many: lanes
    /// stand idle at the end.
    void merge(std::span<SlabMergeJob> jobs) const;

private:
    struct State;
    class Run;
    using StepFunction = void (*)(State&);

    StepFunction step_;
    float least_;
};

}  // namespace pellucid
