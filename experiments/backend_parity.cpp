// Do all backends draw the same winner, and the same colour, in every pixel of every repeat?
// configs/backend_parity.toml, scenes/*.toml -> results/backend_parity/ -> analysis/backend_parity.py
#include <algorithm>
#include <map>

#include "core/error.hpp"
#include "harness/experiment.hpp"
#include "measure/statistics.hpp"
#include "study/backend_parity.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::vector<std::string> backends;
    std::vector<std::filesystem::path> scenes;
    int height_px, runs;
    std::uint32_t repeats, border_particles, border_repeats;
};

Settings read_settings(const ConfigTable& t) {
    const auto count = [&](const char* key, std::int64_t lo, std::int64_t hi) { return t.integer(key, kRequired, {lo, hi}); };
    Settings s{.backends = t.texts("backends", kRequired),
               .scenes = {},
               .height_px = static_cast<int>(count("height_px", 1, 1 << 14)),
               .runs = static_cast<int>(count("runs", 1, 1000)),
               .repeats = static_cast<std::uint32_t>(count("repeats", 1, 1 << 16)),
               .border_particles = static_cast<std::uint32_t>(count("border_particles", 1, 1 << 28)),
               .border_repeats = static_cast<std::uint32_t>(count("border_repeats", 1, 1 << 16))};
    (void)t.integer("seed", 1, {.lo = 0});
    const std::filesystem::path folder = t.file("scene_folder");
    for (const std::string& name : t.texts("scenes", kRequired)) s.scenes.push_back(folder / (name + ".toml"));
    for (const std::string& backend : s.backends)
        if (backend != "cpu" && backend != "vulkan")
            throw t.error("backends", fmt::format("holds \"{}\", expected \"cpu\", \"vulkan\"", backend));
    return s;
}

/// The scenes of the config, and particles on borders for each projection that is among them.
std::vector<ParityScene> make_scenes(Experiment& ex, const Settings& s) {
    const auto stage = ex.stage("sampling");
    std::vector<ParityScene> scenes;
    for (std::size_t i = 0; i < s.scenes.size(); ++i) {
        std::string why_not;
        auto scene = sample_parity_scene(s.scenes[i], s.height_px, s.repeats, derived_seed(ex.seed(), i), why_not);
        if (scene) scenes.push_back(std::move(*scene));
        else warn("{}: left out: {}", s.scenes[i].string(), why_not);
    }
    if (scenes.empty()) throw input_error("scenes: none of them can be drawn");
    for (const bool perspective : {true, false}) {
        const auto like = std::ranges::find_if(scenes, [&](const auto& each) { return each.scene->camera.perspective() == perspective; });
        if (like != scenes.end())
            scenes.push_back(make_border_scene(*like, s.border_particles, s.border_repeats, derived_seed(ex.seed(), 1000)));
    }
    return scenes;
}

/// The worst of all scenes, by stage and implementation.
using Worst = std::map<std::pair<std::string, std::string>, ParityDifference>;

std::string title(const Implementation& each) { return fmt::format("{}, {} threads", each.name, each.threads); }

class Report {
public:
    explicit Report(Experiment& ex)
        : table_(ex.csv("parity", {"scene", "projection", "stage", "implementation", "device", "threads", "repeats", "particles", "hits",
                                   "winners_equal_share", "largest_mean_difference_units", "largest_sum_difference_units",
                                   "different", "hash", "hash_is_specified", "time_s", "fastest_s", "slowest_s", "device_s", "particles_per_s"})),
          device_(ex.csv("device", {"scene", "stage", "implementation", "device", "part", "device_s"})) {}

    void add(const ParityScene& scene, const ParityStage& stage, const Implementation& each, const ParityRow& row, std::uint64_t specified) {
        const std::optional<double> time_s = median(row.wall_s);
        const auto particles = static_cast<double>(scene.particles.count());
        std::optional<double> device_s;
        for (const StageTime& part : row.device_s) {
            device_s = device_s.value_or(0) + part.device_s;
            device_.row(scene.name, stage.name, each.name, each.device, part.name, part.device_s);
        }
        const ParityDifference& d = row.difference;
        table_.row(scene.name, scene.scene->camera.perspective() ? "perspective" : "orthographic", stage.name, each.name, each.device,
                   each.threads, scene.particles.repeats.size(), scene.particles.count(), d.hits, d.winners_equal_share,
                   d.largest_mean_units, d.largest_sum_units, d.different, fmt::format("{:016x}", row.hash), row.hash == specified,
                   time_s, quantile(row.wall_s, 0), quantile(row.wall_s, 1), device_s,
                   time_s ? std::optional(particles / *time_s) : std::nullopt);
    }

private:
    CsvWriter& table_;
    CsvWriter& device_;
};

void check_difference(Experiment& ex, const std::string& name, const ParityDifference& d) {
    if (d.winners_equal_share) ex.check(name + ": least share of equal winners", *d.winners_equal_share, "==", 1);
    if (d.largest_mean_units) ex.check(name + ": largest difference of a mean, in 1/65535", *d.largest_mean_units, "<=", 1);
    ex.check(name + ": different, of anything", static_cast<double>(d.different), "==", 0);
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    const std::vector<Implementation> right = parity_implementations(ex.backends(s.backends));
    const Implementation twins[] = {faulty_implementation("wrong twin: float32 alone", DrawFault::float32_pixels),
                                    faulty_implementation("wrong twin: ties by index", DrawFault::ties_by_index)};
    const std::vector<ParityScene> scenes = make_scenes(ex, s);
    const auto progress = ex.progress("scenes", scenes.size());
    Report report(ex);
    Worst worst;
    for (const ParityScene& scene : scenes) {
        for (const ParityStage& stage : parity_stages()) {
            const auto timed = ex.stage(stage.name);
            const std::vector<ParityRow> rows = run_parity(stage, scene, right, s.runs, derived_seed(ex.seed(), 2000));
            for (std::size_t i = 0; i < rows.size(); ++i) {
                report.add(scene, stage, right[i], rows[i], rows[0].hash);
                worst[{stage.name, title(right[i])}].merge(rows[i].difference);
            }
        }
        // The twins are drawn once, not timed.
        const auto timed = ex.stage("wrong twins");
        const ParityStage& winners = parity_stages().front();
        for (const Implementation& twin : twins) {
            const std::vector<ParityRow> rows = run_parity(winners, scene, {right.front(), twin}, 0, {});
            report.add(scene, winners, twin, rows[1], rows[0].hash);
            worst[{"", twin.name}].merge(rows[1].difference);
        }
        progress->step();
    }
    for (const ParityStage& stage : parity_stages())
        for (const Implementation& each : right) check_difference(ex, stage.name + ", " + title(each), worst[{stage.name, title(each)}]);
    for (const Implementation& twin : twins)
        ex.check(twin.name + " is seen: least share of equal winners", worst[{"", twin.name}].winners_equal_share.value_or(1), "<", 1);
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv, {"backend_parity", "Do all backends draw the same winner, and the same colour, in every pixel?"}, run);
}
