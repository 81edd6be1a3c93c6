// What the search for roots could not decide, as counts.
#pragma once

#include <cstdint>

namespace pellucid {

/// What could not be decided, and what was met that is no root.
struct IsolationStats {
    std::uint64_t undecided = 0;  // clusters of pieces of kLeastShare of the interval that may hold more roots than were
                                  // given, in even number, or (formula not surely continuous) one that is none
    std::uint64_t touching = 0;   // roots given that do not change the sign
    std::uint64_t poles = 0;      // changes of sign through infinity or across a gap: no roots
    std::uint64_t exact = 0;      // intervals that needed exact arithmetic

    IsolationStats& operator+=(const IsolationStats& more) {
        undecided += more.undecided;
        touching += more.touching;
        poles += more.poles;
        exact += more.exact;
        return *this;
    }
};

}  // namespace pellucid
