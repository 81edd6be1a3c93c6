#include "harness/experiment.hpp"

#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <fstream>
#include <set>
#include <sstream>
#include <stdexcept>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "harness/provenance.hpp"
#include "io/atomic_file.hpp"
#include "io/image_file.hpp"
#include "scene/scene_file.hpp"

namespace pellucid {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

const std::vector<std::string> kPresets{"quick", "default", "paper"};
constexpr const char* kSummary = "summary.json";

struct Check {
    std::string name;
    double value = 0;
    std::string relation;
    double limit = 0;
    bool passed = false;
};

bool holds(double value, const std::string& relation, double limit) {
    if (relation == "<=") return value <= limit;
    if (relation == ">=") return value >= limit;
    if (relation == "<") return value < limit;
    if (relation == ">") return value > limit;
    if (relation == "==") return value == limit;
    throw std::logic_error("unknown relation of a check: " + relation);
}

/// configs/NAME.toml beside the build tree, in the source, or where it was installed.
fs::path standard_config(const std::string& name) {
    std::vector<fs::path> places;
    std::error_code failure;
    const fs::path binary = fs::read_symlink("/proc/self/exe", failure);
    if (!failure) places.push_back(binary.parent_path() / "../../../configs");
    places.emplace_back(PELLUCID_SOURCE_DIR "/configs");
    if (!failure) places.push_back(binary.parent_path() / "../share/pellucid/configs");
    for (const fs::path& place : places) {
        const fs::path file = (place / (name + ".toml")).lexically_normal();
        if (fs::is_regular_file(file, failure)) return file;
    }
    throw input_error("no configs/{}.toml found in {}; give one by --config", name,
                      fs::path(PELLUCID_SOURCE_DIR).string());
}

/// The folder of the results, checked but not made.
fs::path results_folder(const std::string& name, const std::string& given) {
    if (given.empty()) return fs::absolute(fs::path("results") / name);
    fs::path out = fs::absolute(given).lexically_normal();
    if (!out.has_filename()) out = out.parent_path();  // a slash at the end
    std::error_code failure;
    const fs::file_status status = fs::status(out, failure);
    if (fs::exists(status) && !fs::is_directory(status))
        throw input_error("--out {}: is a file, expected a folder", one_line(given));
    return out;
}

/// A new empty folder on the same file system as `out`: inside it if it is there, else beside it, where
/// missing parents are made.
fs::path make_folder_aside(const fs::path& out) {
    std::error_code failure;
    const bool there = fs::is_directory(out, failure);
    if (!there) fs::create_directories(out.parent_path(), failure);  // a failure shows in the next lines
    std::string name = (there ? out : out.parent_path()).string();
    name += fmt::format("/.{}.partial-XXXXXX", out.filename().string());
    if (mkdtemp(name.data()) == nullptr)
        throw run_error("--out {}: cannot be written ({})", one_line(out.string()), std::strerror(errno));
    return name;
}

/// What the summary of an older run says it wrote. A summary is a file like any other: only plain
/// relative names are believed.
std::set<std::string> files_of_older_run(const fs::path& out) {
    std::set<std::string> files;
    std::ifstream in(out / kSummary);
    const Json summary = Json::parse(in, nullptr, false);
    if (!summary.is_object() || !summary.contains("files") || !summary["files"].is_array()) return files;
    for (const Json& file : summary["files"]) {
        if (!file.is_string()) continue;
        const fs::path path = fs::path(file.get<std::string>());
        if (path.is_absolute() || path.empty() || path != path.lexically_normal() || *path.begin() == "..")
            continue;
        files.insert(path.string());
    }
    return files;
}

}  // namespace

struct Experiment::State {
    State(ExperimentInfo info_, ExperimentOptions options_, Config config_)
        : info(std::move(info_)), options(std::move(options_)), config(std::move(config_)) {}

    ExperimentInfo info;
    ExperimentOptions options;
    std::chrono::steady_clock::time_point start = std::chrono::steady_clock::now();
    std::string date = utc_now();
    Config config;
    std::vector<std::string> scene_overrides;
    Seed seed;
    fs::path out;
    fs::path aside;
    std::vector<fs::path> new_parents;  // of `out`, innermost first: go again where the run fails
    std::vector<std::string> files;  // relative to the folder, in the order of writing
    std::deque<CsvWriter> tables;    // a deque: references hold
    std::vector<Check> checks;
    std::vector<Device> devices;
    std::vector<Backend> backends;
    std::vector<std::pair<std::string, double>> stages;
};

Experiment::Experiment(ExperimentInfo info, ExperimentOptions options) {
    const fs::path file = options.config.empty() ? standard_config(info.name) : fs::path(options.config);
    state_ = std::make_unique<State>(std::move(info), std::move(options), Config::read(file));
    State& s = *state_;
    s.config.apply_preset(s.options.preset, kPresets);
    for (const std::string& assignment : s.options.overrides) {
        const bool known_here = s.config.holds(assignment.substr(0, assignment.find_first_of(".=")));
        if (!is_scene_override(assignment) || known_here)
            s.config.apply_override(assignment);
        else if (s.info.reads_scene)
            s.scene_overrides.push_back(assignment);
        else
            throw input_error("--set {}: unknown key, this experiment reads no scene file",
                              one_line(assignment.substr(0, assignment.find('=')), 100));
    }
    const std::int64_t configured = s.config.root().integer("seed", 1, {.lo = 0});
    s.seed = {s.options.seed.value_or(static_cast<std::uint64_t>(configured))};
    s.out = results_folder(s.info.name, s.options.out);
    std::error_code failure;
    for (fs::path parent = s.out.parent_path(); parent.has_relative_path(); parent = parent.parent_path())
        if (!fs::exists(parent, failure)) s.new_parents.push_back(parent);
    s.aside = make_folder_aside(s.out);
}

Experiment::~Experiment() {
    state_->tables.clear();
    std::error_code ignored;
    fs::remove_all(state_->aside, ignored);
    for (const fs::path& parent : state_->new_parents) fs::remove(parent, ignored);  // only if empty
}

ConfigTable Experiment::config_table() const {
    return state_->config.root();
}
void Experiment::finish_config() {
    state_->config.finish();
}
const ExperimentOptions& Experiment::options() const {
    return state_->options;
}
Seed Experiment::seed() const {
    return state_->seed;
}

Scene Experiment::scene(const fs::path& file) {
    if (!state_->info.reads_scene) throw std::logic_error("a scene is read against ExperimentInfo");
    return load_scene(file, state_->scene_overrides);
}

fs::path Experiment::result(const std::string& name, const std::string& extension) {
    const fs::path relative = fs::path(name + extension);
    if (name.empty() || relative.is_absolute() || relative != relative.lexically_normal() ||
        *relative.begin() == ".." || relative == kSummary)
        throw std::logic_error("not a name for a result: " + relative.string());
    for (const std::string& file : state_->files)
        if (file == relative.string()) throw std::logic_error("a result written twice: " + file);
    std::error_code failure;
    fs::create_directories((state_->aside / relative).parent_path(), failure);
    state_->files.push_back(relative.string());
    return state_->aside / relative;
}

CsvWriter& Experiment::csv(const std::string& name, const std::vector<std::string>& columns) {
    return state_->tables.emplace_back(result(name, ".csv"), columns);
}

void Experiment::image(const std::string& name, const Image& image) {
    Image labelled = image;
    labelled.attributes["experiment"] = state_->info.name;
    labelled.attributes["preset"] = state_->options.preset;
    labelled.attributes.try_emplace("seed", std::to_string(state_->seed.value));
    labelled.attributes["commit"] = build_info().commit;
    write_exr(labelled, result(name, ".exr"));
}

void Experiment::png(const std::string& name, const Image& image, const Vec3& background) {
    write_png(image, background, result(name, ".png"));
}

void Experiment::json(const std::string& name, const std::string& text) {
    write_text_file(result(name, ".json"), text);
}

void Experiment::check(const std::string& name, double value, const std::string& relation, double limit) {
    state_->checks.push_back({name, value, relation, limit, holds(value, relation, limit)});
}

const std::vector<Backend>& Experiment::backends(const std::vector<std::string>& configured) {
    State& s = *state_;
    if (!s.backends.empty()) return s.backends;
    RunOptions options = s.options;
    const auto configures = [&](const char* name) {
        return std::ranges::find(configured, name) != configured.end();
    };
    if (!options.backend && configures("vulkan"))
        options.backend = configures("cpu") ? BackendChoice::all : BackendChoice::vulkan;
    s.backends = open_backends(options);
    for (const Backend& backend : s.backends)
        if (backend.on_device()) device({backend.name(), backend.device_name(), backend.driver(), ""});
    if (options.backend == BackendChoice::all && s.backends.size() == 1)
        device({"vulkan", "", "", "none: there is no usable Vulkan device"});
    return s.backends;
}

void Experiment::device(const Device& device) {
    state_->devices.push_back(device);
}

Experiment::Stage::~Stage() {
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start_;
    experiment_->add_stage(name_, seconds.count());
}

void Experiment::add_stage(const std::string& name, double seconds) {
    for (auto& [known, sum] : state_->stages)
        if (known == name) {
            sum += seconds;
            return;
        }
    state_->stages.emplace_back(name, seconds);
}

std::unique_ptr<Progress> Experiment::progress(const std::string& label, std::size_t total) const {
    return std::make_unique<Progress>(label, total, !state_->options.quiet && on_terminal());
}

int Experiment::finish() {
    State& s = *state_;
    finish_config();
    for (CsvWriter& table : s.tables) table.close();

    // The summary
    const BuildInfo build = build_info();
    const HostInfo host = host_info();
    Json summary;
    summary["experiment"] = s.info.name;
    summary["question"] = s.info.question;
    summary["preset"] = s.options.preset;
    summary["seed"] = s.seed.value;
    summary["version"] = build.version;
    summary["commit"] = build.commit;
    summary["date_utc"] = s.date;
    summary["build"] = {{"compiler", build.compiler}, {"flags", build.flags}, {"type", build.build_type}};
    summary["host"] = {{"cpu", host.cpu},
                       {"cores", host.cores},
                       {"threads", thread_count()},
                       {"memory_bytes", host.memory_bytes},
                       {"os", host.os}};
    summary["devices"] = Json::array({{{"backend", "cpu"}, {"name", host.cpu}, {"threads", thread_count()}}});
    for (const Device& device : s.devices) {
        Json entry{{"backend", device.backend}, {"name", device.name}};
        if (!device.driver.empty()) entry["driver"] = device.driver;
        if (!device.note.empty()) entry["note"] = device.note;
        summary["devices"].push_back(std::move(entry));
    }
    summary["stages"] = Json::array();
    for (const auto& [name, seconds] : s.stages)
        summary["stages"].push_back({{"name", name}, {"wall_s", seconds}});
    summary["checks"] = Json::array();
    bool all_hold = true;
    for (const Check& check : s.checks) {  // NaN and infinities become null: JSON has none
        summary["checks"].push_back({{"name", check.name},
                                     {"value", check.value},
                                     {"relation", check.relation},
                                     {"limit", check.limit},
                                     {"passed", check.passed}});
        all_hold = all_hold && check.passed;
    }
    summary["files"] = s.files;
    summary["config"] = Json::parse(s.config.to_json());
    summary["wall_s"] = std::chrono::duration<double>(std::chrono::steady_clock::now() - s.start).count();
    summary["peak_rss_bytes"] = peak_rss_bytes();
    write_text_file(s.aside / kSummary, summary.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");

    // Everything in place, file by file; the summary last, so that it never speaks of what is not there.
    std::set<std::string> stale = files_of_older_run(s.out);
    std::error_code failure;
    const auto or_fail = [&failure](const fs::path& path) {
        if (failure)
            throw run_error("{}: cannot be written ({})", one_line(path.string()), failure.message());
    };
    fs::create_directories(s.out, failure);
    or_fail(s.out);
    std::vector<std::string> moves = s.files;
    moves.emplace_back(kSummary);
    for (const std::string& file : moves) {
        stale.erase(file);
        fs::create_directories((s.out / file).parent_path(), failure);
        or_fail(s.out / file);
        fs::rename(s.aside / file, s.out / file, failure);
        or_fail(s.out / file);
    }
    for (const std::string& file : stale)
        if (fs::is_regular_file(fs::symlink_status(s.out / file, failure))) fs::remove(s.out / file, failure);

    for (const Check& check : s.checks)
        if (!check.passed)
            fmt::print(stderr, "{}: check failed: {} = {}, expected {} {}\n", s.info.name,
                       one_line(check.name), check.value, check.relation, check.limit);
    if (!s.options.quiet && on_terminal())
        fmt::print(stderr, "{}: {} files in {}, {} checks\n", s.info.name, moves.size(), s.out.string(),
                   s.checks.size());
    return all_hold ? 0 : 1;
}

int run_experiment(int argc, char** argv, const ExperimentInfo& info,
                   const std::function<void(Experiment&)>& body) {
    return guarded_main(info.name, [&] {
        ExperimentOptions options;
        Arguments arguments(info.name, info.question);
        add_experiment_options(arguments, options);
        if (!arguments.parse(argc, argv)) return 0;
        apply_run_options(options);
        Experiment experiment(info, options);
        // An experiment that asks for no backend runs on the CPU alone.
        if (options.backend) (void)experiment.backends();
        body(experiment);
        return experiment.finish();
    });
}

}  // namespace pellucid
