// How far is a picture from the truth? Numbers for people and for CI, and a map of where.
//
// compare TEST.exr TRUTH.exr [--metric M] [--max METRIC=V]… [--min METRIC=V]… [--map OUT.png] [--json]
// Exit 0: fine; 1: past a limit; 2: bad input; 4: the map could not be written.
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "core/error.hpp"
#include "io/image_file.hpp"
#include "measure/comparison.hpp"

namespace {

using namespace pellucid;

constexpr const char* kVersion = "compare (Pellucid) 0.1.0";

struct Options {
    std::string test;
    std::string truth;
    std::string metric = "all";
    std::vector<std::string> max;
    std::vector<std::string> min;
    std::string background = "0,0,0";
    double ppd = kDefaultPixelsPerDegree;
    std::string map;
    bool json = false;
};

void declare(CLI::App& app, Options& options) {
    app.set_version_flag("--version", kVersion);
    app.add_option("TEST", options.test, "the picture to judge, OpenEXR")->required();
    app.add_option("TRUTH", options.truth, "the picture it should be, OpenEXR")->required();
    app.add_option("--metric", options.metric, "rmse, mae, psnr, ssim, flip or all")->capture_default_str();
    app.add_option("--max", options.max, "METRIC=V: exit 1 where the metric is above V; repeatable")
        ->allow_extra_args(false);
    app.add_option("--min", options.min, "METRIC=V: exit 1 where the metric is below V; repeatable")
        ->allow_extra_args(false);
    app.add_option("--background", options.background, "r,g,b, linear")->capture_default_str();
    app.add_option("--ppd", options.ppd, "pixels per degree of visual angle, for FLIP")->capture_default_str();
    app.add_option("--map", options.map, "PNG: FLIP map if FLIP is computed, else absolute error");
    app.add_flag("--json", options.json, "print one JSON object");
}

ComparisonSettings settings_of(const Options& options) {
    ComparisonSettings settings;
    settings.metrics = parse_metrics(options.metric);
    for (const std::string& text : options.max) settings.limits.push_back(parse_limit(text, Bound::at_most));
    for (const std::string& text : options.min) settings.limits.push_back(parse_limit(text, Bound::at_least));
    settings.background = parse_background(options.background);
    settings.pixels_per_degree = options.ppd;
    settings.wants_map = !options.map.empty();
    return settings;
}

int compare(const Options& options) {
    const ComparisonSettings settings = settings_of(options);
    const Image test = read_exr(options.test);
    const Image truth = read_exr(options.truth);
    const Comparison comparison = compare_images({options.test, test}, {options.truth, truth}, settings);

    if (comparison.map) write_png(*comparison.map, Vec3{0.0}, options.map);
    const std::string report = options.json ? comparison_json(comparison, options.test, options.truth)
                                            : comparison_text(comparison);
    std::fputs(report.c_str(), stdout);
    for (const LimitOutcome& outcome : comparison.limits)
        if (!outcome.passed) std::fputs((options.test + ": " + describe(outcome, comparison) + "\n").c_str(), stderr);
    return comparison.passed() ? 0 : 1;
}

int fail(const std::string& message, int code) {
    std::fputs(("error: " + message + "\n").c_str(), stderr);
    return code;
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app{"Compares two pictures: RGB over a background, linear."};
    Options options;
    declare(app, options);
    try {
        app.parse(argc, argv);
        return compare(options);
    } catch (const CLI::ParseError& error) {
        if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
        return fail(error.what(), static_cast<int>(Failure::input));
    } catch (const Error& error) {
        return fail(error.what(), error.exit_code());
    } catch (const std::exception& error) {
        return fail(error.what(), static_cast<int>(Failure::run));
    }
}
