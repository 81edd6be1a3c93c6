// Are surfaces, volumes, slices and polygons that are fused as particles what a ray tracer sees of them together?
// configs/fused_scenes.toml, scenes/fused/*.toml -> results/fused_scenes/ -> analysis/fused_scenes.py
#include <algorithm>
#include <cmath>
#include <fstream>
#include <sstream>

#include "core/error.hpp"
#include "harness/experiment.hpp"
#include "core/stopwatch.hpp"
#include "io/temporary_folder.hpp"
#include "measure/comparison.hpp"
#include "measure/particle_test.hpp"
#include "reference/truth.hpp"
#include "render/particles.hpp"
#include "scene/scene_file.hpp"
#include "study/fused_inputs.hpp"
#include "study/stage_seconds.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::vector<std::string> scenes, table_scenes;
    std::filesystem::path folder, templates;
    std::vector<std::int64_t> resolution, table_resolution, table_repeats;
    std::uint32_t repeats;
    TruthSettings truth;
    double color_limit;
};

Settings read_settings(const ConfigTable& t) {
    const auto count = [&](const char* key, std::int64_t lo) {
        return static_cast<std::uint32_t>(t.integer(key, kRequired, {lo, 1 << 20}));
    };
    std::vector<std::string> table_scenes = t.texts("table_scenes", kRequired);
    std::vector<std::int64_t> table_repeats = t.integers("table_repeats", kRequired, {1, 1 << 20}, exactly(table_scenes.size()));
    return {t.texts("scenes", kRequired),
            std::move(table_scenes),
            t.file("folder"),
            t.file("templates"),
            t.integers("resolution", kRequired, {1, 1 << 15}, exactly(2)),
            t.integers("table_resolution", kRequired, {1, 1 << 15}, exactly(2)),
            std::move(table_repeats),
            count("repeats", 2),
            {.filter = PixelFilter::particle, .samples = static_cast<int>(count("truth_samples", 16))},
            t.number("color_limit", kRequired, above(0))};
}

/// scenes/fused/NAME.toml, its inputs in `folder`.
Scene read_scene(const Settings& s, const std::string& name, const std::filesystem::path& folder) {
    if (!std::filesystem::exists(s.templates))
        throw input_error("templates = \"{}\" is not there, expected that of Debian's package mricron-data", s.templates.string());
    write_fused_inputs(name, s.templates, folder);
    for (const auto& entry : std::filesystem::directory_iterator(s.folder))
        if (entry.path().extension() == ".nrrd")
            std::filesystem::copy_file(entry.path(), folder / entry.path().filename(),
                                       std::filesystem::copy_options::overwrite_existing);
    const std::filesystem::path file = s.folder / (name + ".toml");
    std::ifstream in(file);
    if (!in) throw input_error("{}: cannot be read", file.string());
    std::ostringstream text;
    text << in.rdbuf();
    const Config config = Config::parse(text.str(), file.string(), folder);
    Scene scene = scene_from_config(config);
    config.finish();
    return scene;
}

void set_resolution(Scene& scene, const std::vector<std::int64_t>& resolution) {
    scene.image.width = static_cast<int>(resolution[0]);
    scene.image.height = static_cast<int>(resolution[1]);
}

/// What the paper says of its scene in kind: particles, sampling time on an i7-980, frames a second on a GTX 580.
struct Published {
    const char* scene;
    const char* title;
    double particles, sampling_s, frames_per_s;
};
constexpr Published kPublished[] = {{"head", "breast, fig. 3 right", 6.3e7, 3294, 3.2},
                                    {"organs", "organs, fig. 4 left", 9.5e7, 3708, 2.5},
                                    {"scan_and_wave", "dragon and wave, fig. 4 right", 5.0e7, 1449, 3.6}};

/// Errors of one scene's drawing beside its truth.
void compare_with_truth(Experiment& ex, const Settings& s, const std::string& name, Scene scene, CsvWriter& csv, double level) {
    set_resolution(scene, s.resolution);
    const PreparedScene prepared = prepare(scene);
    TruthStats truth_stats;
    const Image truth = [&] {
        const auto stage = ex.stage("truth, " + name);
        TruthSettings settings = s.truth;
        settings.seed = derived_seed(ex.seed(), 1);
        return trace_truth(prepared, settings, truth_stats);
    }();
    for (const SamplerKind kind : {SamplerKind::lines, SamplerKind::stratified}) {
        const bool stratified = kind == SamplerKind::stratified;
        ParticleSettings settings{.repeats = s.repeats, .kind = kind};
        settings.sampler.seed = derived_seed(ex.seed(), 2);
        RenderStats stats;
        const Image drawn = render_particles(prepared, settings, stats);
        const ColorTest color = test_colors(drawn, truth, s.repeats);
        const Comparison seen = compare_images({"particles", drawn}, {"truth", truth},
                                               {.metrics = parse_metrics("all"), .background = scene.image.background, .wants_map = true});
        const auto metric = [&](const char* wanted) {
            for (const auto& [key, value] : seen.values)
                if (metric_name(key) == std::string_view(wanted)) return value;
            return std::optional<double>();
        };
        csv.row(name, stratified ? "stratified" : "lines", s.repeats, stats.particles, color.rmse, color.floor, color.truth_error,
                color.ratio, color.ratio_error, color.p_value, metric("psnr"), metric("ssim"), metric("flip"));
        if (!stratified) {
            ex.check(name + ": colour, RMSE over noise floor: p", color.p_value, ">=", level);
            if (normal_critical_value(level) * color.ratio_error < s.color_limit)
                ex.check(name + ": colour, |RMSE over noise floor - 1|", std::abs(color.ratio - 1), "<=", s.color_limit);
            ex.png("pictures/" + name + "_particles", drawn, scene.image.background);
            if (seen.map) ex.png("pictures/" + name + "_flip", *seen.map, Vec3(0.0));
        } else {
            ex.check(name + ": stratified, RMSE over that of independent repeats", color.ratio, "<", 1);
        }
    }
    ex.png("pictures/" + name + "_truth", truth, scene.image.background);
    ex.image(name + "_truth", truth);
}

/// The whole run of the paper's table: files read, particles sampled, all repeats drawn. Beside the published numbers in
/// particles a second: those of the scenes differ.
void time_drawing(Experiment& ex, const Settings& s, const std::string& name, Scene scene, std::uint32_t repeats, CsvWriter& csv) {
    set_resolution(scene, s.table_resolution);
    Stopwatch watch;
    const PreparedScene prepared = prepare(scene);
    const double preparing_s = watch.lap();
    ParticleSettings settings{.repeats = repeats};
    settings.sampler.seed = ex.seed();
    RenderStats stats;
    const auto stage = ex.stage("table, " + name);
    (void)render_particles(prepared, settings, stats);
    const double sampling_s = stage_seconds(stats, "cut into pieces") + stage_seconds(stats, "sample particles");
    const double draw_s = stage_seconds(stats, "project and average");
    const auto particles = static_cast<double>(stats.particles);
    const auto* published = std::ranges::find_if(kPublished, [&](const Published& p) { return name == p.scene; });
    std::optional<double> sampling_gain, drawing_gain;
    if (published != std::end(kPublished)) {
        sampling_gain = particles / sampling_s / (published->particles / published->sampling_s);
        drawing_gain = particles / draw_s / (published->particles * published->frames_per_s);
    }
    csv.row("Pellucid", name, "lines", scene.image.width, repeats, stats.particles, preparing_s, sampling_s, draw_s, 1 / draw_s,
            particles / sampling_s, sampling_gain, drawing_gain);
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    CsvWriter& errors = ex.csv("errors", {"scene", "sampler", "repeats", "particles", "rmse", "floor", "truth_error", "ratio",
                                          "ratio_error", "p", "psnr_db", "ssim", "flip"});
    CsvWriter& table = ex.csv("table", {"source", "scene", "sampler", "resolution_px", "repeats", "particles", "preparing_s",
                                        "sampling_s", "draw_s", "frames_per_s", "sampled_per_s", "sampling_gain", "drawing_gain"});
    for (const Published& p : kPublished)
        table.row("Tanaka 2012", fmt::format("{}: {}", p.scene, p.title), "Brownian", 1024, 500, p.particles, std::nullopt, p.sampling_s,
                  std::nullopt, p.frames_per_s, p.particles / p.sampling_s, std::nullopt, std::nullopt);
    const double level = sidak_level(0.001, static_cast<double>(s.scenes.size()));
    auto progress = ex.progress("scenes", 2 * s.scenes.size());
    for (const std::string& name : s.scenes) {
        const TemporaryFolder folder;
        const Scene scene = read_scene(s, name, folder.path());
        compare_with_truth(ex, s, name, scene, errors, level);
        progress->step();
        const auto place = std::ranges::find(s.table_scenes, name);
        if (place != s.table_scenes.end())
            time_drawing(ex, s, name, scene, static_cast<std::uint32_t>(s.table_repeats[static_cast<std::size_t>(place - s.table_scenes.begin())]),
                         table);
        progress->step();
    }
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv,
                          {.name = "fused_scenes",
                           .question = "Are surfaces, volumes, slices and polygons fused as particles what a ray tracer sees?"},
                          run);
}
