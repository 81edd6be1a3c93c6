// The frame of every experiment: command line, configuration, results that appear whole or not at
// all, checks, summary, exit code.
//
//   // Does the drawn opacity of a tilted patch follow PBSR (1)?
//   // configs/opacity_tilt.toml -> results/opacity_tilt/ -> analysis/opacity_tilt.py
//   int main(int argc, char** argv) {
//       return run_experiment(argc, argv, {"opacity_tilt", "Does the drawn opacity … follow …?"},
//                             [](Experiment& ex) {
//           const Settings settings = ex.config(read_settings);  // Settings read_settings(const
//           ConfigTable&) CsvWriter& csv = ex.csv("opacity", {"tilt_deg", "alpha_drawn", "alpha_theory"});
//           auto progress = ex.progress("tilts", settings.tilts_deg.size());
//           for (const double tilt_deg : settings.tilts_deg) {
//               csv.row(tilt_deg, drawn, theory);                // an empty optional is an empty cell
//               progress->step();
//           }
//           ex.check("worst error", worst, "<=", settings.limit);
//       });
//   }
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/image.hpp"
#include "core/random.hpp"
#include "harness/csv.hpp"
#include "harness/options.hpp"
#include "harness/progress.hpp"
#include "io/config.hpp"
#include "scene/scene.hpp"

namespace pellucid {

struct ExperimentInfo {
    std::string name;      // of the binary, configs/NAME.toml and results/NAME
    std::string question;  // for --help
    bool reads_scene = false;  // takes those --set that belong to scenes, too
};

/// Where something ran, for the summary.
struct Device {
    std::string backend;  // "cpu", "vulkan"
    std::string name;
    std::string driver;  // may be empty
    std::string note;    // may be empty
};

class Experiment {
public:
    Experiment(ExperimentInfo info, ExperimentOptions options);
    ~Experiment();
    Experiment(const Experiment&) = delete;
    Experiment& operator=(const Experiment&) = delete;

    /// What `read` makes of the configuration; keys it did not ask for are errors. Call it first.
    template <class Read>
    [[nodiscard]] auto config(const Read& read) {
        auto settings = read(config_table());
        finish_config();
        return settings;
    }
    /// A scene, with those --set values laid over it that belong to scenes (and to no top-level key
    /// of the configuration). Only where ExperimentInfo says reads_scene; elsewhere such a --set is
    /// refused at the start.
    [[nodiscard]] Scene scene(const std::filesystem::path& file);

    [[nodiscard]] const ExperimentOptions& options() const;
    /// --seed, else the key `seed` of the configuration, else 1.
    [[nodiscard]] Seed seed() const;

    /// A table NAME.csv among the results. The reference holds until the run ends.
    [[nodiscard]] CsvWriter& csv(const std::string& name, const std::vector<std::string>& columns);
    /// NAME.exr; experiment, preset, seed and commit are added to its header.
    void image(const std::string& name, const Image& image);
    /// NAME.png: over the background, clamped, sRGB.
    void png(const std::string& name, const Image& image, const Vec3& background);
    /// NAME.json
    void json(const std::string& name, const std::string& text);

    /// Notes `value relation limit` ("<=", ">=", "<", ">", "=="); a NaN fails. The run goes on.
    void check(const std::string& name, double value, const std::string& relation, double limit);
    /// What --backend asks for; without it those of `configured` ("cpu", "vulkan"). Opened once, listed in
    /// the summary. Throws Error(device) where one is not there.
    [[nodiscard]] const std::vector<Backend>& backends(const std::vector<std::string>& configured = {"cpu"});
    /// Devices used beside the CPU, which is always listed.
    void device(const Device& device);

    /// Adds the time until the returned object dies to the stage `name` of the summary.
    class Stage {
    public:
        Stage(Experiment& experiment, std::string name) : experiment_(&experiment), name_(std::move(name)) {}
        ~Stage();
        Stage(const Stage&) = delete;
        Stage& operator=(const Stage&) = delete;

    private:
        Experiment* experiment_;
        std::string name_;
        std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
    };
    [[nodiscard]] Stage stage(const std::string& name) { return {*this, name}; }
    [[nodiscard]] std::unique_ptr<Progress> progress(const std::string& label, std::size_t total) const;

private:
    friend int run_experiment(int, char**, const ExperimentInfo&, const std::function<void(Experiment&)>&);
    [[nodiscard]] ConfigTable config_table() const;
    void finish_config();
    /// Writes the summary and moves everything in place; the exit code.
    int finish();
    [[nodiscard]] std::filesystem::path result(const std::string& name, const std::string& extension);
    void add_stage(const std::string& name, double seconds);

    struct State;
    std::unique_ptr<State> state_;
};

/// Reads the command line, runs `body`, writes results/NAME (--out). Exit code: 0 all checks hold;
/// 1 a check failed (results are written; each is named on stderr); 2 bad input, 3 no such device,
/// 4 the run failed (one line on stderr, no result is touched). A file of an older run that this one
/// did not write is removed if the old summary lists it.
[[nodiscard]] int run_experiment(int argc, char** argv, const ExperimentInfo& info,
                                 const std::function<void(Experiment&)>& body);

}  // namespace pellucid
