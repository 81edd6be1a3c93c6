#include "stage/slab_stream.hpp"

#include "kernel/intermix_twin.h"

namespace pellucid {

void SlabStream::start(std::span<const twin::Slab> array) {
    collector_.start();
    array_ = array;
    next_ = 0;
    passing_ = true;
    if (!array.empty()) head_ = array[0];
    front_ = twin::slab_front(head_);
}

void SlabStream::take_next() {
    if (++next_ < array_.size()) head_ = array_[next_];
    front_ = twin::slab_front(head_);
}

void SlabStream::merge(twin::Slab slab) {
    while (next_ < array_.size()) {
        const twin::MergeStep step =
            twin::merge_step(head_, slab, twin::uint(settings_.interpolation), twin::uint(settings_.mixing));
        passing_ = collector_.push(step.out_slab);
        if (step.a_used != 0) {
            take_next();
        } else {
            head_ = step.a;
            front_ = twin::slab_front(head_);
        }
        if (!passing_ || step.b_used != 0) return;
        slab = step.b;
    }
    passing_ = collector_.push(slab);
}

std::span<const twin::Slab> SlabStream::finish() {
    for (; passing_ && next_ < array_.size(); take_next()) passing_ = collector_.push(head_);
    return collector_.finish();
}

}  // namespace pellucid
