// Tests over every instruction set that this machine and this build have.
#pragma once

#include <cstdint>
#include <vector>

#include <hwy/targets.h>

namespace pellucid {

/// The last one is scalar code.
inline std::vector<std::int64_t> simd_targets() {
    hwy::SetSupportedTargetsForTest(0);
    std::vector<std::int64_t> found;
    for (std::int64_t bits = hwy::SupportedTargets(); bits != 0; bits &= bits - 1)
        found.push_back(bits & -bits);
    return found;
}

class ChosenTarget {
public:
    explicit ChosenTarget(std::int64_t target) {
        hwy::SetSupportedTargetsForTest(target);
        hwy::GetChosenTarget().Update(target);
    }
    ~ChosenTarget() {
        hwy::SetSupportedTargetsForTest(0);
        hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    }
    ChosenTarget(const ChosenTarget&) = delete;
    ChosenTarget& operator=(const ChosenTarget&) = delete;
};

}  // namespace pellucid
