// The tables of a per-pixel test of opacity: outcomes, histograms, and the share outside 3σ by surfaces.
#pragma once

#include "harness/experiment.hpp"
#include "measure/particle_test.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

class CoverageTables {
public:
    /// Opens coverage.csv, p_values.csv, z_scores.csv and outside.csv. The scene must outlive the tables.
    CoverageTables(Experiment& experiment, const PreparedScene& scene);

    /// Writes one test under a name; `largest_error_share` is the rule by which its pixels were chosen.
    void add(const std::string& name, double largest_error_share, const CoverageTest& test);

private:
    const PreparedScene* scene_;
    std::vector<SurfaceClass> classes_;
    CsvWriter *tests_, *p_values_, *z_scores_, *outside_;
};

}  // namespace pellucid
