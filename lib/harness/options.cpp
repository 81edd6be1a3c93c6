#include "harness/options.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <new>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "harness/provenance.hpp"
#include "io/config.hpp"

namespace pellucid {

struct Arguments::Parser {
    CLI::App app;
    // CLI11 binds no std::optional<number> strictly enough (it takes "1e3x" as 1000), so numbers are
    // read from text here.
    template <class Out, class Read>
    void read(const std::string& names, Out out, const std::string& type, const std::string& help,
              const Read& read) {
        app.add_option_function<std::string>(
               names,
               [out, names, type, read](const std::string& text) {
                   if (!read(text, out))
                       throw input_error("{} {}: expected {}", names.substr(names.rfind(',') + 1),
                                         text.empty() ? "\"\"" : one_line(text, 60), type);
               },
               help)
            ->type_name(type);
    }
};

namespace {

bool read_unsigned(const std::string& text, std::uint64_t& value) {
    if (text.empty() || text.size() > 20 || text.find_first_not_of("0123456789") != std::string::npos)
        return false;
    try {
        value = std::stoull(text);
    } catch (const std::out_of_range&) {
        return false;
    }
    return true;
}

bool read_finite(const std::string& text, double& value) {
    double number = 0;
    int used = 0;
    if (text.empty() || std::isspace(static_cast<unsigned char>(text[0])) != 0 ||
        std::sscanf(text.c_str(), "%lf%n", &number, &used) != 1 ||
        static_cast<std::size_t>(used) != text.size() || !std::isfinite(number))
        return false;
    value = number;
    return true;
}

}  // namespace

Arguments::Arguments(const std::string& name, const std::string& description)
    : parser_(std::make_unique<Parser>()) {
    parser_->app.name(name);
    parser_->app.description(description);
    const BuildInfo build = build_info();
    parser_->app.set_version_flag("--version", name + " " + build.version + " " + build.commit,
                                  "print name, version and commit");
}
Arguments::~Arguments() = default;
Arguments::Arguments(Arguments&&) noexcept = default;
Arguments& Arguments::operator=(Arguments&&) noexcept = default;

void Arguments::flag(const std::string& names, bool& value, const std::string& help) {
    parser_->app
        .add_flag_function(
            names, [&value](std::int64_t) { value = true; }, help)
        ->disable_flag_override();  // no --quiet=maybe
}

void Arguments::option(const std::string& names, std::string& value, const std::string& help, bool required) {
    parser_->app.add_option(names, value, help)->required(required);
}

void Arguments::option(const std::string& names, std::optional<std::string>& value, const std::string& help) {
    parser_->app.add_option_function<std::string>(
        names, [&value](const std::string& text) { value = text; }, help);
}

void Arguments::option(const std::string& names, double& value, const std::string& help) {
    parser_->read(names, std::ref(value), "a finite number", help, read_finite);
}

void Arguments::option(const std::string& names, std::optional<double>& value, const std::string& help) {
    parser_->read(names, std::ref(value), "a finite number", help,
                  [](const std::string& text, std::optional<double>& out) {
                      double number = 0;
                      if (!read_finite(text, number)) return false;
                      out = number;
                      return true;
                  });
}

void Arguments::option(const std::string& names, std::optional<std::uint64_t>& value,
                       const std::string& help) {
    parser_->read(names, std::ref(value), "an integer >= 0", help,
                  [](const std::string& text, std::optional<std::uint64_t>& out) {
                      std::uint64_t number = 0;
                      if (!read_unsigned(text, number)) return false;
                      out = number;
                      return true;
                  });
}

void Arguments::option(const std::string& names, int& value, int lo, int hi, const std::string& help) {
    parser_->read(names, std::ref(value), fmt::format("an integer in [{}, {}]", lo, hi), help,
                  [lo, hi](const std::string& text, int& out) {
                      const bool minus = !text.empty() && text[0] == '-';
                      std::uint64_t size = 0;
                      if (!read_unsigned(minus ? text.substr(1) : text, size) || size > 0x7fffffffU)
                          return false;
                      const int number = minus ? -static_cast<int>(size) : static_cast<int>(size);
                      if (number < lo || number > hi) return false;
                      out = number;
                      return true;
                  });
}

void Arguments::choice(const std::string& names, const std::vector<std::string>& choices,
                       const std::function<void(const std::string&)>& take, const std::string& help) {
    const auto read = [choices](const std::string& text, const std::function<void(const std::string&)>& out) {
        if (std::find(choices.begin(), choices.end(), text) == choices.end()) return false;
        out(text);
        return true;
    };
    parser_->read(names, take, fmt::format("{}", fmt::join(choices, "|")), help, read);
}

void Arguments::repeated(const std::string& names, std::vector<std::string>& values,
                         const std::string& help, const std::string& type) {
    parser_->app.add_option(names, values, help)->type_name(type)->allow_extra_args(false);
}

void Arguments::positional(const std::string& name, std::string& value, const std::string& help,
                           bool required) {
    parser_->app.add_option(name, value, help)->required(required);
}

void Arguments::positionals(const std::string& name, std::vector<std::string>& values,
                            const std::string& help) {
    parser_->app.add_option(name, values, help)->required();
}

bool Arguments::parse(int argc, const char* const* argv) {
    try {
        parser_->app.parse(argc, argv);
        return true;
    } catch (const CLI::Success& e) {  // --help, --version: printed on stdout
        parser_->app.exit(e);
        return false;
    } catch (const CLI::ParseError& e) {
        throw input_error("{} (see --help)", one_line(e.what()));
    }
}

void add_run_options(Arguments& arguments, RunOptions& options) {
    arguments.choice(
        "--backend", {"cpu", "vulkan", "all"},
        [&options](const std::string& name) {
            options.backend = name == "cpu"      ? BackendChoice::cpu
                              : name == "vulkan" ? BackendChoice::vulkan
                                                 : BackendChoice::all;
        },
        "where to run; all = cpu, and vulkan if there is any");
    arguments.option("--device", options.device, "which Vulkan device, by name");
    arguments.option("--seed", options.seed, "seed of all random numbers");
    arguments.option("--threads", options.threads, 0, 4096, "most threads; 0 = all cores");
    arguments.repeated("--set", options.overrides,
                       "replace a key of the configuration or scene; VALUE as in TOML");
    arguments.flag("--quiet", options.quiet, "no progress bar");
}

void add_experiment_options(Arguments& arguments, ExperimentOptions& options) {
    arguments.option("--config", options.config, "configuration; without it configs/NAME.toml");
    arguments.choice(
        "--preset", {"quick", "default", "paper"},
        [&options](const std::string& name) { options.preset = name; }, "how much to compute");
    arguments.option("--out", options.out, "folder of the results; without it results/NAME");
    add_run_options(arguments, options);
}

void apply_run_options(const RunOptions& options) {
    if (!options.device.empty() && options.backend.value_or(BackendChoice::cpu) == BackendChoice::cpu)
        throw input_error(
            "--device {}: it chooses among Vulkan devices, expected --backend vulkan or all beside it",
            one_line(options.device, 60));
    if (options.threads > 0) set_thread_count(options.threads);
}

std::vector<Backend> open_backends(const RunOptions& options, bool validate) {
    const BackendChoice choice = options.backend.value_or(BackendChoice::cpu);
    std::vector<Backend> backends;
    if (choice != BackendChoice::vulkan) backends.push_back(Backend::cpu());
    // A device that was named must be there; of all there are, none is needed.
    if (choice == BackendChoice::vulkan ||
        (choice == BackendChoice::all && (!options.device.empty() || Backend::has_vulkan())))
        backends.push_back(Backend::open_vulkan({.device = options.device, .validate = validate}));
    return backends;
}

int guarded_main(const std::string& name, const std::function<int()>& command) noexcept {
    // One call of fputs, so that the line is whole; no allocation where memory is short.
    const auto say = [&name](const char* message) {
        try {
            const std::string line = name + ": " + one_line(message, 2000) + "\n";
            std::fputs(line.c_str(), stderr);
        } catch (...) {
            std::fputs("out of memory\n", stderr);
        }
    };
    try {
        return command();
    } catch (const Error& e) {
        say(e.what());
        return e.exit_code();
    } catch (const std::bad_alloc&) {
        say("out of memory");
    } catch (const std::exception& e) {
        say(e.what());
    } catch (...) {
        say("unknown failure");
    }
    return static_cast<int>(Failure::run);
}

}  // namespace pellucid
