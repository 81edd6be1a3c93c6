// What `opacity_vs_n` writes: the table of opacities, the fits, the wrong twins, and the checks.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "harness/experiment.hpp"
#include "render/backend.hpp"
#include "study/opacity_patch.hpp"

namespace pellucid {

struct OpacityRow {
    PatchView view;
    std::int64_t count = 0;
    std::int64_t repeats = 0;
    Seed seed;
};

class OpacityReport {
public:
    /// `family_level`: of all z-scores together, and of all intervals together. Rows are drawn on every
    /// backend; they are the same particles, so the first one's enter the statistics and the others' must
    /// equal them.
    OpacityReport(Experiment& experiment, double family_level, std::vector<Backend> backends);

    /// A row without a theory (s >= S cosθ): its cells stay empty.
    void outside_theory(const OpacityRow& row);
    /// One a backend, for the rows of one patch.
    [[nodiscard]] std::vector<std::unique_ptr<ParticleDrawer>> make_drawers(const PreparedScene& scene) const;
    /// Draws a row if `measurable`, tests it against the theory and keeps it for the fits.
    void add(const OpacityRow& row, const OpacityPatch& patch, const PreparedScene& scene,
             const LineSampler& sampler, std::span<const std::unique_ptr<ParticleDrawer>> drawers,
             bool measurable);
    /// Fits, wrong twins, checks; writes fit.json, repeats.csv, twins.csv.
    void finish(const std::vector<double>& ring_edges_deg);

private:
    struct RepeatError {
        double squares = 0, variance = 0;
        std::size_t pixels = 0;
    };
    void write_row(const OpacityRow& row, const Backend& backend, const Ring* ring, const RingDraw* draw,
                   std::optional<double> z);
    void keep(const OpacityRow& row, const OpacityPatch& patch, const Ring& ring, const RingDraw& draw,
              double z);
    void check_fits();
    void check_slope();
    void check_twins(const std::vector<double>& ring_edges_deg);
    void draw_twin(const std::string& name, const PatchView& view, DrawTwin twin,
                   const std::vector<double>& edges);
    void draw_close_sheets();
    void note_twin(const std::string& name, double drawn, double theory, double z, double z_of_right_one);

    Experiment* experiment_;
    double family_level_;
    std::vector<Backend> backends_;
    std::size_t rows_different_ = 0;  // from the first backend's
    CsvWriter* csv_;
    CsvWriter* twins_csv_;
    std::vector<double> z_scores_;
    std::vector<OpacityPoint> points_;
    std::map<std::int64_t, RepeatError> errors_;  // by repeats
    std::string fits_json_;
};

}  // namespace pellucid
