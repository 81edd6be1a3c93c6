// What `backend_parity` writes: a row a scene, stage and implementation, device times by part, the checks.
#pragma once

#include <cstdint>
#include <map>
#include <string>

#include "harness/experiment.hpp"
#include "study/backend_parity.hpp"

namespace pellucid {

class ParityReport {
public:
    /// Opens parity.csv and device.csv.
    explicit ParityReport(Experiment& experiment);

    /// `specified`: hash of the specification's output.
    void add(const ParityScene& scene, const ParityStage& stage, const Implementation& each,
             const ParityRow& row, std::uint64_t specified);
    /// Checks over all scenes: nothing differs; at least one thing does.
    void check_equal(const ParityStage& stage, const Implementation& each);
    void check_seen(const ParityStage& stage, const Implementation& each);

private:
    Experiment* experiment_;
    CsvWriter* table_;
    CsvWriter* device_;
    std::map<std::string, ParityDifference> worst_;  // of all scenes, by title
};

}  // namespace pellucid
