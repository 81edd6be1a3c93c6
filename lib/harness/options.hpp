// The command line that all commands share, and how they end.
//
//   int main(int argc, char** argv) {
//       return guarded_main("render", [&] {
//           RunOptions run;
//           std::string scene;
//           Arguments arguments("render", "Renders one scene by one method.");
//           arguments.positional("SCENE", scene, "scene file");
//           add_run_options(arguments, run);
//           if (!arguments.parse(argc, argv)) return 0;  // --help or --version was printed
//           apply_run_options(run);
//           …
//       });
//   }
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "render/backend.hpp"

namespace pellucid {

/// all: the CPU, and Vulkan if there is any.
enum class BackendChoice { cpu, vulkan, all };

/// What every command takes.
struct RunOptions {
    std::optional<BackendChoice> backend;  // absent: the CPU
    std::string device;  // --device; empty: choose
    std::optional<std::uint64_t> seed;
    int threads = 0;                     // 0: all cores
    std::vector<std::string> overrides;  // --set, in order
    bool quiet = false;
};

/// What every experiment takes besides.
struct ExperimentOptions : RunOptions {
    std::string config;              // empty: configs/NAME.toml
    std::string preset = "default";  // quick, default, paper
    std::string out;                 // empty: results/NAME
};

/// A command line to be: options are bound to variables, which keep their values (the defaults)
/// where the option is not given. Names are as in CLI11: "-o,--output". --help and --version are there.
class Arguments {
public:
    Arguments(const std::string& name, const std::string& description);
    ~Arguments();
    Arguments(Arguments&&) noexcept;
    Arguments& operator=(Arguments&&) noexcept;

    void flag(const std::string& names, bool& value, const std::string& help);
    void option(const std::string& names, std::string& value, const std::string& help, bool required = false);
    void option(const std::string& names, std::optional<std::string>& value, const std::string& help);
    void option(const std::string& names, double& value, const std::string& help);
    void option(const std::string& names, std::optional<double>& value, const std::string& help);
    void option(const std::string& names, std::optional<std::uint64_t>& value, const std::string& help);
    void option(const std::string& names, int& value, int lo, int hi, const std::string& help);
    /// One of `choices`, which is given to `take`.
    void choice(const std::string& names, const std::vector<std::string>& choices,
                const std::function<void(const std::string&)>& take, const std::string& help);
    /// May be given more than once; each time with one value, which the help calls `type`.
    void repeated(const std::string& names, std::vector<std::string>& values, const std::string& help,
                  const std::string& type = "KEY=VALUE");
    /// Named in capitals in the help: SCENE.
    void positional(const std::string& name, std::string& value, const std::string& help,
                    bool required = true);
    /// One or more, after the others.
    void positionals(const std::string& name, std::vector<std::string>& values, const std::string& help);

    /// False where --help or --version was asked for and printed. Throws Error(input), one line.
    [[nodiscard]] bool parse(int argc, const char* const* argv);

private:
    struct Parser;
    std::unique_ptr<Parser> parser_;
};

/// --backend --device --seed --threads --set --quiet
void add_run_options(Arguments& arguments, RunOptions& options);
/// The same and --config --preset --out
void add_experiment_options(Arguments& arguments, ExperimentOptions& options);

/// Sets the number of threads. Throws Error(input) for a --device without Vulkan.
void apply_run_options(const RunOptions& options);
/// The backends asked for, each opened. Throws Error(device) where one is not there.
[[nodiscard]] std::vector<Backend> open_backends(const RunOptions& options, bool validate = false);

/// Runs a command: its return value, or the exit code of what it threw (Error: its kind; anything
/// else, memory included: 4) after one line `NAME: message` on stderr.
[[nodiscard]] int guarded_main(const std::string& name, const std::function<int()>& command) noexcept;

}  // namespace pellucid
