// Do all backends draw the same winner, and the same colour, in every pixel of every repeat?
// configs/backend_parity.toml, scenes/*.toml -> results/backend_parity/ -> analysis/backend_parity.py
#include <algorithm>

#include "core/error.hpp"
#include "harness/experiment.hpp"
#include "study/parity_report.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::vector<std::string> backends;
    std::vector<std::filesystem::path> scenes;
    int height_px, runs;
    std::uint32_t repeats, border_particles, border_repeats;
};

Settings read_settings(const ConfigTable& t) {
    const auto count = [&](const char* key, std::int64_t lo, std::int64_t hi) {
        return t.integer(key, kRequired, {lo, hi});
    };
    Settings s{.backends = t.texts("backends", kRequired),
               .scenes = {},
               .height_px = static_cast<int>(count("height_px", 1, 1 << 14)),
               .runs = static_cast<int>(count("runs", 1, 1000)),
               .repeats = static_cast<std::uint32_t>(count("repeats", 1, 1 << 16)),
               .border_particles = static_cast<std::uint32_t>(count("border_particles", 1, 1 << 28)),
               .border_repeats = static_cast<std::uint32_t>(count("border_repeats", 1, 1 << 16))};
    (void)t.integer("seed", 1, {.lo = 0});
    const std::filesystem::path folder = t.file("scene_folder");
    for (const std::string& name : t.texts("scenes", kRequired))
        s.scenes.push_back(folder / (name + ".toml"));
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
        auto scene =
            sample_parity_scene(s.scenes[i], s.height_px, s.repeats, derived_seed(ex.seed(), i), why_not);
        if (scene)
            scenes.push_back(std::move(*scene));
        else
            warn("{}: left out: {}", s.scenes[i].string(), why_not);
    }
    if (scenes.empty()) throw input_error("scenes: none of them can be drawn");
    for (const bool perspective : {true, false}) {
        const auto like = std::ranges::find_if(
            scenes, [&](const auto& each) { return each.scene->camera.perspective() == perspective; });
        if (like != scenes.end())
            scenes.push_back(make_border_scene(*like, s.border_particles, s.border_repeats,
                                               derived_seed(ex.seed(), 1000)));
    }
    return scenes;
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    const std::vector<Implementation> right = parity_implementations(ex.backends(s.backends));
    const Implementation twins[] = {
        faulty_implementation("wrong twin: float32 alone", DrawFault::float32_pixels),
        faulty_implementation("wrong twin: ties by index", DrawFault::ties_by_index)};
    const std::vector<ParityScene> scenes = make_scenes(ex, s);
    const auto progress = ex.progress("scenes", scenes.size());
    ParityReport report(ex);
    for (const ParityScene& scene : scenes) {
        for (const ParityStage& stage : parity_stages()) {
            const auto timed = ex.stage(stage.name);
            const auto rows = run_parity(stage, scene, right, s.runs, derived_seed(ex.seed(), 2000));
            for (std::size_t i = 0; i < rows.size(); ++i)
                report.add(scene, stage, right[i], rows[i], rows[0].hash);
        }
        // The twins are drawn once, not timed.
        const auto timed = ex.stage("wrong twins");
        const ParityStage& winners = parity_stages().front();
        for (const Implementation& twin : twins) {
            const auto rows = run_parity(winners, scene, {right.front(), twin}, 0, {});
            report.add(scene, winners, twin, rows[1], rows[0].hash);
        }
        progress->step();
    }
    for (const ParityStage& stage : parity_stages())
        for (const Implementation& each : right) report.check_equal(stage, each);
    for (const Implementation& twin : twins) report.check_seen(parity_stages().front(), twin);
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(
        argc, argv,
        {"backend_parity", "Do all backends draw the same winner, and the same colour, in every pixel?"},
        run);
}
