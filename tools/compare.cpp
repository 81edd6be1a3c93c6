// How far is a picture from the truth? Numbers for people and for CI, and a map of where.
//
// compare TEST.exr TRUTH.exr [--metric M] [--max METRIC=V]… [--min METRIC=V]… [--map OUT.png] [--json]
// Exit 0: fine; 1: past a limit; 2: bad input; 4: the map could not be written.
#include <cstdio>
#include <string>
#include <vector>

#include "harness/options.hpp"
#include "io/image_file.hpp"
#include "measure/comparison.hpp"

namespace {

using namespace pellucid;

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

}  // namespace

int main(int argc, char** argv) {
    return guarded_main("compare", [&] {
        Options options;
        Arguments arguments("compare", "Compares two pictures: RGB over a background, linear.");
        arguments.positional("TEST", options.test, "the picture to judge, OpenEXR");
        arguments.positional("TRUTH", options.truth, "the picture it should be, OpenEXR");
        arguments.option("--metric", options.metric, "rmse, mae, psnr, ssim, flip or all (default)");
        arguments.repeated("--max", options.max, "exit 1 where the metric is above V", "METRIC=V");
        arguments.repeated("--min", options.min, "exit 1 where the metric is below V", "METRIC=V");
        arguments.option("--background", options.background, "r,g,b, linear (default 0,0,0)");
        arguments.option("--ppd", options.ppd, "pixels per degree of visual angle, for FLIP (default 67.02)");
        arguments.option("--map", options.map, "PNG: FLIP map if FLIP is computed, else absolute error");
        arguments.flag("--json", options.json, "print one JSON object");
        if (!arguments.parse(argc, argv)) return 0;
        return compare(options);
    });
}
