#include "study/coverage_tables.hpp"

#include <cmath>

namespace pellucid {
namespace {

[[nodiscard]] std::string names_of(const PreparedScene& scene, const SurfaceClass& surfaces) {
    std::string names;
    for (std::size_t i = 0; i < scene.objects.size(); ++i)
        if ((surfaces.objects >> i & 1U) != 0) names += (names.empty() ? "" : " + ") + scene.objects[i].surface.name;
    return names.empty() ? "smaller than a pixel" : names;
}

void write_bins(CsvWriter& csv, const std::string& name, const Histogram& h) {
    for (std::size_t i = 0; i < h.counts.size(); ++i) {
        const double lo = h.lo + static_cast<double>(i) * h.width;
        csv.row(name, lo, lo + h.width, h.counts[i], h.expected[i]);
    }
}

}  // namespace

CoverageTables::CoverageTables(Experiment& experiment, const PreparedScene& scene)
    : scene_(&scene),
      classes_(surface_classes(scene)),
      tests_(&experiment.csv("coverage", {"case", "largest_error_share", "pixels", "left_out", "worst_error_share",
                                          "mean_noise_share", "outside", "outside_expected", "outside_z", "outside_p",
                                          "ks_distance", "ks_p", "chi2_p"})),
      p_values_(&experiment.csv("p_values", {"case", "p_lo", "p_hi", "pixels", "expected"})),
      z_scores_(&experiment.csv("z_scores", {"case", "z_lo", "z_hi", "pixels", "expected"})),
      outside_(&experiment.csv("outside", {"case", "surfaces", "place", "pixels", "outside", "outside_expected",
                                           "outside_sd"})) {}

void CoverageTables::add(const std::string& name, double largest_error_share, const CoverageTest& t) {
    const TestResult ks = t.ks.value_or(TestResult{});
    const TestResult chi2 = t.chi2.value_or(TestResult{});
    tests_->row(name, largest_error_share, t.pixels.size(), t.left_out, t.worst_error_share, t.mean_noise_share,
                t.outside, t.outside_expected, t.outside_test.statistic, t.outside_test.p_value, ks.statistic,
                ks.p_value, chi2.p_value);
    write_bins(*p_values_, name, p_value_histogram(t));
    write_bins(*z_scores_, name, z_histogram(t));
    for (const ClassOutcome& c : outside_by_class(t, classes_))
        outside_->row(name, names_of(*scene_, c.surfaces), c.surfaces.edge ? "edge" : "inner", c.pixels, c.outside,
                      c.expected, std::sqrt(c.variance));
}

}  // namespace pellucid
