// How do error and time of particle rendering fall and grow with the repeats, for every sampler?
// configs/repeat_level.toml, scenes/repeat_level.toml -> results/repeat_level/ -> analysis/repeat_level.py
#include <algorithm>
#include <cmath>
#include <map>

#include "core/stopwatch.hpp"
#include "harness/experiment.hpp"
#include "measure/fit.hpp"
#include "measure/statistics.hpp"
#include "reference/truth.hpp"
#include "render/particles.hpp"
#include "sample/stratify.hpp"
#include "study/sampler_choice.hpp"
#include "study/stage_seconds.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::filesystem::path scene;
    std::vector<std::int64_t> resolution;
    std::vector<std::string> samplers, biased;
    std::vector<std::int64_t> repeats, biased_repeats;
    std::uint32_t seeds;
    TruthSettings truth;
    double gain_from, gain_limit;
    std::uint32_t groups;  // of stratified sets
};

Settings read_settings(const ConfigTable& t) {
    Settings s{t.file("scene"),
               t.integers("resolution", kRequired, {1, 1 << 15}, exactly(2)),
               t.texts("samplers", kRequired),
               t.texts("biased", kRequired),
               t.integers("repeats", kRequired, {1, 1 << 20}, {.min = 3}),
               t.integers("biased_repeats", kRequired, {1, 1 << 20}, {.min = 3}),
               static_cast<std::uint32_t>(t.integer("seeds", kRequired, {2, 1000})),
               {PixelFilter::particle, {}, t.number("truth_error", kRequired, above(0)),
                static_cast<int>(t.integer("truth_samples", kRequired, {64, 1 << 20}))},
               t.number("gain_from", kRequired, above(0)),
               t.number("gain_limit", kRequired, above(0)),
               static_cast<std::uint32_t>(t.integer("groups", kRequired, {1, 1024}))};
    for (const std::string& name : s.samplers) (void)sampler_choice(name);
    return s;
}

/// One drawing against the truth.
struct Outcome {
    double square_error = 0;  // mean over pixels and R, G, B; the truth's own is taken off
    double mean_difference = 0;
    double particles = 0;     // of all repeats
    double sampling_s = 0, drawing_s = 0;
};

Outcome draw(const PreparedScene& scene, const Image& truth, const SamplerChoice& sampler, std::uint32_t repeats,
             std::uint32_t group, Seed seed) {
    ParticleSettings settings{.repeats = repeats, .group = group};
    sampler.apply(settings);
    settings.sampler.seed = seed;
    RenderStats stats;
    const Image image = render_particles(scene, settings, stats);
    Outcome out;
    const double samples = 3 * static_cast<double>(image.pixel_count());
    for (const char* channel : {"R", "G", "B"}) {
        const auto drawn = image.plane(channel);
        const auto right = truth.plane(channel);
        const auto doubt = truth.plane(std::string("variance.") + channel);
        for (std::size_t i = 0; i < image.pixel_count(); ++i) {
            const double off = static_cast<double>(drawn[i]) - static_cast<double>(right[i]);
            out.square_error += (off * off - static_cast<double>(doubt[i])) / samples;
            out.mean_difference += off / samples;
        }
    }
    out.particles = static_cast<double>(stats.particles);
    out.sampling_s = stage_seconds(stats, "cut into pieces") + stage_seconds(stats, "sample particles");
    out.drawing_s = stage_seconds(stats, "project and average");
    return out;
}

/// Means over seeds for one sampler and number of repeats.
struct Row {
    double repeats = 0, rmse = 0, rmse_error = 0, particles = 0, sampling_s = 0, drawing_s = 0;
    MeanVariance squares, differences;
};

Row summarised(std::uint32_t repeats, const std::vector<Outcome>& outcomes) {
    Row row;
    row.repeats = repeats;
    const auto n = static_cast<double>(outcomes.size());
    for (const Outcome& o : outcomes) {
        row.squares.add(o.square_error);
        row.differences.add(o.mean_difference);
        row.particles += o.particles / n;
        row.sampling_s += o.sampling_s / n;
        row.drawing_s += o.drawing_s / n;
    }
    row.rmse = std::sqrt(std::max(0.0, row.squares.mean()));
    row.rmse_error = row.rmse > 0 ? row.squares.standard_error() / (2 * row.rmse) : 0;
    return row;
}

using Rows = std::map<std::string, std::vector<Row>>;

/// Error over repeats as a power law; the slope of independent repeats is −½.
void judge_slopes(Experiment& ex, const Settings& s, const Rows& rows, double level) {
    CsvWriter& csv = ex.csv("slopes", {"sampler", "slope", "slope_error", "factor"});
    for (const auto& [name, of_sampler] : rows) {
        std::vector<ErrorPoint> points;
        // The scatter about the line gives the errors: that of a few seeds is itself too uncertain to weigh by.
        for (const Row& row : of_sampler) points.push_back({row.repeats, row.rmse, 0});
        const FitResult fit = fit_power_law(points);
        const FitParameter& slope = fit.parameters[0];
        csv.row(name, slope.value, slope.standard_error, std::exp(fit.parameters[1].value));
        if (name == "lines" || name == "fast") {
            const double dof = std::max(1.0, fit.dof);
            const double t = std::abs(slope.value + 0.5) / slope.standard_error;
            ex.check(name + ": slope is -1/2: |t|", t, "<=", student_critical_value(level, dof));
        } else if (std::ranges::find(s.biased, name) == s.biased.end()) {
            ex.check(name + ": falls at least as fast as independent repeats: slope", slope.value, "<=", -0.48);
        }
    }
}

/// Stratified over independent at equal numbers of particles.
void judge_gain(Experiment& ex, const Settings& s, const Rows& rows) {
    if (!rows.contains("lines") || !rows.contains("stratified")) return;
    CsvWriter& csv = ex.csv("gain", {"repeats", "variance_ratio", "variance_ratio_error", "particles_ratio"});
    const auto& lines = rows.at("lines");
    const auto& stratified = rows.at("stratified");
    for (std::size_t i = 0; i < lines.size(); ++i) {
        const double particles = stratified[i].particles / lines[i].particles;
        const double ratio = stratified[i].squares.mean() / lines[i].squares.mean() * particles;
        const double error = ratio * std::hypot(stratified[i].squares.standard_error() / stratified[i].squares.mean(),
                                                lines[i].squares.standard_error() / lines[i].squares.mean());
        csv.row(lines[i].repeats, ratio, error, particles);
        if (lines[i].repeats >= s.gain_from)
            ex.check(fmt::format("stratified over independent variance at equal particles, {:.0f} repeats", lines[i].repeats),
                     ratio, "<=", s.gain_limit);
    }
}

/// The mean over all pixels, drawings and numbers of repeats beside the truth's.
void judge_bias(Experiment& ex, const Settings& s, const Rows& rows, const Image& truth, double level) {
    CsvWriter& csv = ex.csv("bias", {"sampler", "bias", "bias_error"});
    double doubt = 0;
    for (const char* channel : {"R", "G", "B"})
        for (const float v : truth.plane(std::string("variance.") + channel)) doubt += static_cast<double>(v);
    // Channels of a pixel are one colour: taken as fully correlated.
    const double samples = 3 * static_cast<double>(truth.pixel_count());
    const double truth_variance = 3 * doubt / (samples * samples);
    for (const auto& [name, of_sampler] : rows) {
        double sum = 0;
        double weights = 0;
        for (const Row& row : of_sampler) {
            const double variance = 3 * row.squares.mean() / samples / static_cast<double>(row.differences.count());
            if (!(variance > 0)) continue;
            sum += row.differences.mean() / variance;
            weights += 1 / variance;
        }
        const double bias = sum / weights;
        const double error = std::sqrt(1 / weights + truth_variance);
        csv.row(name, bias, error);
        if (std::ranges::find(s.biased, name) == s.biased.end())
            ex.check(name + ": mean colour beside the truth: |z|", std::abs(bias / error), "<=", normal_critical_value(level));
    }
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    Scene file = ex.scene(s.scene);
    const auto& given = ex.options().overrides;
    if (std::ranges::none_of(given, [](const auto& text) { return text.starts_with("image.resolution"); })) {
        file.image.width = static_cast<int>(s.resolution[0]);
        file.image.height = static_cast<int>(s.resolution[1]);
    }
    const PreparedScene scene = prepare(file);
    TruthStats truth_stats;
    const Image truth = [&] {
        const auto stage = ex.stage("truth");
        TruthSettings settings = s.truth;
        settings.seed = derived_seed(ex.seed(), 1);
        return trace_truth(scene, settings, truth_stats);
    }();
    double floor = 0;  // variance of one independent repeat
    for (const char* channel : {"R", "G", "B"})
        for (const float v : truth.plane(std::string("repeat_variance.") + channel))
            floor += static_cast<double>(v) / (3 * static_cast<double>(truth.pixel_count()));

    CsvWriter& csv = ex.csv("errors", {"sampler", "repeats", "rmse", "rmse_error", "floor", "particles", "sampling_s", "draw_s"});
    Rows rows;
    // Of so many repeats the default is the largest group that fits into its memory.
    const std::uint32_t most_group = default_group(scene, make_sources(scene), 1U << 20U, ParticleSettings{}.oversampling);
    const auto repeats_of = [&](const std::string& name) -> const std::vector<std::int64_t>& {
        return std::ranges::find(s.biased, name) == s.biased.end() ? s.repeats : s.biased_repeats;
    };
    std::size_t repeats_of_all = 0;
    for (const std::string& name : s.samplers) repeats_of_all += repeats_of(name).size();
    auto progress = ex.progress("drawings", repeats_of_all);
    for (const std::string& name : s.samplers) {
        const SamplerChoice sampler = sampler_choice(name);
        for (const std::int64_t each : repeats_of(name)) {
            const auto repeats = static_cast<std::uint32_t>(each);
            const std::uint32_t group = std::clamp(repeats / s.groups, 1U, most_group);
            std::vector<Outcome> outcomes;
            for (std::uint32_t k = 0; k < s.seeds; ++k)
                outcomes.push_back(draw(scene, truth, sampler, repeats, group,
                                        derived_seed(ex.seed(), 1000 + std::uint64_t{repeats} * 1000 + k)));
            const Row row = summarised(repeats, outcomes);
            csv.row(name, each, row.rmse, row.rmse_error, std::sqrt(floor / repeats), row.particles, row.sampling_s, row.drawing_s);
            rows[name].push_back(row);
            progress->step();
        }
    }
    const double level = sidak_level(0.001, static_cast<double>(2 * s.samplers.size()));
    judge_slopes(ex, s, rows, level);
    judge_gain(ex, s, rows);
    judge_bias(ex, s, rows, truth, level);
    ex.image("truth", truth);
    ex.png("pictures/truth", truth, scene.settings.image.background);
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv,
                          {.name = "repeat_level",
                           .question = "How do error and time fall and grow with the repeats, for every sampler?",
                           .reads_scene = true},
                          run);
}
