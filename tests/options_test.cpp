#include "harness/options.hpp"

#include <new>
#include <stdexcept>

#include <gtest/gtest.h>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "harness/progress.hpp"
#include "harness/provenance.hpp"

namespace pellucid {
namespace {

struct Parsed {
    ExperimentOptions options;
    std::string scene;
    bool plan = false;
    std::optional<double> max_error;
    double scale = 2;
    bool run = false;
};

Parsed parse(std::vector<const char*> words) {
    Parsed p;
    Arguments arguments("tool", "A tool.");
    arguments.positional("SCENE", p.scene, "scene file", false);
    arguments.flag("--plan", p.plan, "plan");
    arguments.option("--max-error", p.max_error, "limit");
    arguments.option("--scale", p.scale, "factor");
    add_experiment_options(arguments, p.options);
    words.insert(words.begin(), "tool");
    p.run = arguments.parse(static_cast<int>(words.size()), words.data());
    return p;
}

TEST(Options, WithoutArgumentsAreTheDefaults) {
    const Parsed p = parse({});
    EXPECT_TRUE(p.run);
    EXPECT_FALSE(p.options.backend.has_value());
    EXPECT_EQ(p.options.preset, "default");
    EXPECT_EQ(p.options.seed, std::nullopt);
    EXPECT_EQ(p.options.threads, 0);
    EXPECT_TRUE(p.options.config.empty() && p.options.out.empty() && p.options.device.empty());
    EXPECT_TRUE(p.options.overrides.empty());
    EXPECT_FALSE(p.options.quiet || p.plan);
    EXPECT_EQ(p.max_error, std::nullopt);
    EXPECT_EQ(p.scale, 2);
}

TEST(Options, AllAreRead) {
    const Parsed p = parse({"--config",
                            "c.toml",
                            "--preset",
                            "paper",
                            "--backend=all",
                            "--device",
                            "llvmpipe",
                            "--out",
                            "o",
                            "--seed",
                            "18446744073709551615",
                            "--threads",
                            "3",
                            "--set",
                            "counts=[1,10]",
                            "s.toml",
                            "--set",
                            "a.b=c",
                            "--set=x=1",
                            "--quiet",
                            "--plan",
                            "--max-error",
                            "1e-3",
                            "--scale",
                            "-0.5"});
    EXPECT_EQ(p.options.config, "c.toml");
    EXPECT_EQ(p.options.preset, "paper");
    EXPECT_EQ(p.options.backend, BackendChoice::all);
    EXPECT_EQ(p.options.device, "llvmpipe");
    EXPECT_EQ(p.options.out, "o");
    EXPECT_EQ(p.options.seed, 18446744073709551615U);
    EXPECT_EQ(p.options.threads, 3);
    EXPECT_EQ(p.options.overrides, (std::vector<std::string>{"counts=[1,10]", "a.b=c", "x=1"}));
    EXPECT_TRUE(p.options.quiet && p.plan);
    EXPECT_EQ(p.scene, "s.toml");
    EXPECT_EQ(p.max_error, 1e-3);
    EXPECT_EQ(p.scale, -0.5);
}

TEST(Options, SetTakesAnythingAsItStands) {
    const std::vector<const char*> values{"a=[[1,2],[3,4]]", "a={b=1}", "a=\"x, y\"", "a=", "=",
                                          "[1,2]",           "a=-1"};
    for (const char* value : values)
        EXPECT_EQ(parse({"--set", value}).options.overrides, std::vector<std::string>{value}) << value;
}

TEST(Options, BadOnesAreOneLineThatNamesThem) {
    const std::vector<std::pair<std::vector<const char*>, std::string>> cases{
        {{"--preset", "fast"}, "--preset fast: expected quick|default|paper"},
        {{"--backend", "gpu"}, "--backend gpu: expected cpu|vulkan|all"},
        {{"--seed", "-1"}, "--seed -1: expected an integer >= 0"},
        {{"--seed", "1e3"}, "--seed 1e3: expected an integer >= 0"},
        {{"--seed", "18446744073709551616"}, "--seed 18446744073709551616: expected"},
        {{"--seed", ""}, "--seed"},
        {{"--threads", "-1"}, "--threads -1: expected an integer in [0, 4096]"},
        {{"--threads", "4097"}, "--threads 4097"},
        {{"--threads", "two"}, "--threads two"},
        {{"--max-error", "nan"}, "--max-error nan: expected a finite number"},
        {{"--max-error", "1x"}, "--max-error 1x"},
        {{"--scale", "inf"}, "--scale inf: expected a finite number"},
        {{"--scale", "2 "}, "--scale 2 : expected a finite number"},
        {{"--seed"}, "--seed"},
        {{"--set"}, "--set"},
        {{"--seed", "1", "--seed", "2"}, "--seed"},
        {{"--nonsense"}, "--nonsense"},
        {{"s.toml", "two\nlines"}, "two lines"},
        {{"--quiet=maybe"}, "quiet"},
    };
    for (const auto& [words, message] : cases) try {
            (void)parse(words);
            ADD_FAILURE() << message << " was taken";
        } catch (const Error& e) {
            EXPECT_EQ(e.exit_code(), 2);
            const std::string what = e.what();
            EXPECT_NE(what.find(message), std::string::npos) << what;
            EXPECT_EQ(what.find('\n'), std::string::npos) << what;
        }
}

TEST(Options, MissingPositionalIsNamed) {
    std::string scene;
    Arguments arguments("tool", "");
    arguments.positional("SCENE", scene, "scene file");
    const char* words[] = {"tool"};
    try {
        (void)arguments.parse(1, words);
        ADD_FAILURE();
    } catch (const Error& e) {
        EXPECT_NE(std::string(e.what()).find("SCENE"), std::string::npos) << e.what();
    }
}

TEST(Options, VersionPrintsNameVersionCommit) {
    testing::internal::CaptureStdout();
    const Parsed p = parse({"--version"});
    const std::string printed = testing::internal::GetCapturedStdout();
    EXPECT_FALSE(p.run);
    EXPECT_EQ(printed, "tool " + build_info().version + " " + build_info().commit + "\n");
}

TEST(Options, HelpNamesEveryOption) {
    testing::internal::CaptureStdout();
    const Parsed p = parse({"--help"});
    const std::string printed = testing::internal::GetCapturedStdout();
    EXPECT_FALSE(p.run);
    for (const char* name : {"SCENE", "--config", "--preset", "--backend", "--device", "--out", "--seed",
                             "--threads", "--set", "--quiet", "--version", "--help"})
        EXPECT_NE(printed.find(name), std::string::npos) << name;
}

TEST(Options, ApplySetsThreadsAndRefusesAbsentDevices) {
    RunOptions options;
    options.threads = 1;
    apply_run_options(options);
    EXPECT_EQ(thread_count(), 1);
    set_thread_count(0);

    options.device = "no such card";
    EXPECT_EQ(guarded_main("t", [&] { return apply_run_options(options), 0; }),
              2);  // the CPU takes no device
    for (const BackendChoice choice : {BackendChoice::vulkan, BackendChoice::all}) {
        options.backend = choice;
        EXPECT_EQ(guarded_main("t", [&] { return open_backends(options).empty() ? 1 : 0; }), 3);
    }
}

TEST(Options, BackendsAreThoseAskedFor) {
    RunOptions options;
    EXPECT_EQ(open_backends(options).size(), 1U);
    EXPECT_EQ(open_backends(options)[0].name(), "cpu");
    options.backend = BackendChoice::all;
    const std::vector<Backend> all = open_backends(options);
    EXPECT_EQ(all.size(), Backend::has_vulkan() ? 2U : 1U);
    EXPECT_EQ(all[0].name(), "cpu");
    if (!Backend::has_vulkan()) GTEST_SKIP() << "skipped: no Vulkan device";
    EXPECT_EQ(all[1].name(), "vulkan");
    EXPECT_FALSE(all[1].device_name().empty());
    options.backend = BackendChoice::vulkan;
    ASSERT_EQ(open_backends(options).size(), 1U);
    EXPECT_TRUE(open_backends(options)[0].on_device());
}

TEST(GuardedMain, MapsFailuresToExitCodesAndOneLine) {
    const auto run = [](const std::function<int()>& command, int code, const std::string& line) {
        testing::internal::CaptureStderr();
        EXPECT_EQ(guarded_main("tool", command), code);
        EXPECT_EQ(testing::internal::GetCapturedStderr(), line);
    };
    run([] { return 0; }, 0, "");
    run([] { return 1; }, 1, "");
    run([]() -> int { throw input_error("a.toml:1: {}", "bad\nvalue"); }, 2, "tool: a.toml:1: bad value\n");
    run([]() -> int { throw Error(Failure::device, "none"); }, 3, "tool: none\n");
    run([]() -> int { throw run_error("disk full"); }, 4, "tool: disk full\n");
    run([]() -> int { throw std::bad_alloc(); }, 4, "tool: out of memory\n");
    run([]() -> int { throw std::logic_error("our bug"); }, 4, "tool: our bug\n");
    run([]() -> int { throw 42; }, 4, "tool: unknown failure\n");
}

TEST(Provenance, IsFilledIn) {
    EXPECT_FALSE(build_info().version.empty());
    EXPECT_TRUE(build_info().commit == "unknown" || build_info().commit.size() >= 40) << build_info().commit;
    EXPECT_GE(host_info().cores, 1);
    EXPECT_GT(host_info().memory_bytes, 1U << 20);
    EXPECT_NE(host_info().os.find("Linux"), std::string::npos);
    EXPECT_GT(peak_rss_bytes(), 1U << 20);
    EXPECT_LE(peak_rss_bytes(), host_info().memory_bytes);
    EXPECT_EQ(utc_now().size(), std::string("2026-01-31T12:00:00Z").size());
}

TEST(Progress, LineShowsRateAndTimeLeft) {
    EXPECT_EQ(progress_line("draw", 50, 100, 5), "draw [############            ] 50/100  10/s  5 s left");
    EXPECT_EQ(progress_line("draw", 0, 100, 5), "draw [                        ] 0/100");
    EXPECT_EQ(progress_line("draw", 1, 10000, 1), "draw [                        ] 1/10000  1/s  2.8 h left");
    EXPECT_EQ(progress_line("draw", 0, 0, 0), "draw [########################] 0/0");
}

}  // namespace
}  // namespace pellucid
