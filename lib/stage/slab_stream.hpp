// A ray's slabs merged with a finished array while the ray is cast: the hybrid of zSlab section 5.5. The same scan as
// merge_arrays (stage/slab_merge.hpp), of which one array comes slab by slab.
#pragma once

#include <cstddef>
#include <span>

#include "kernel/slab_twin.h"
#include "stage/slab_compression.hpp"
#include "stage/slab_settings.hpp"

namespace pellucid {

class SlabStream {
public:
    /// What is merged goes to `collector`, which must outlive this.
    SlabStream(const SlabSettings& settings, SlabCollector& collector) : settings_(settings), collector_(collector) {}

    /// Begins a ray, and the collector's. The array is sorted and stays until finish().
    void start(std::span<const twin::Slab> array);

    /// False once no more slabs matter. Precondition: not in front of the slabs before it.
    bool push(const twin::Slab& slab) {
        // In front of all that is left: nothing to mix with.
        if (next_ == array_.size() || slab.z < front_) passing_ = collector_.push(slab);
        else merge(slab);
        return passing_;
    }

    /// The rest of the array, and all as the collector keeps it.
    [[nodiscard]] std::span<const twin::Slab> finish();

private:
    void merge(twin::Slab slab);
    void take_next();

    SlabSettings settings_;
    SlabCollector& collector_;
    std::span<const twin::Slab> array_;
    std::size_t next_ = 0;
    twin::Slab head_{};    // what is left of the array's next slab
    float front_ = 0;      // where it begins
    bool passing_ = true;  // the collector still takes slabs
};

}  // namespace pellucid
