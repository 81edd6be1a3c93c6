#include "measure/comparison.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/error.hpp"
#include "measure/image_metrics.hpp"

namespace pellucid {
namespace {

constexpr std::array<std::pair<Metric, std::string_view>, 5> kMetrics{{{Metric::rmse, "rmse"},
                                                                       {Metric::mae, "mae"},
                                                                       {Metric::psnr, "psnr"},
                                                                       {Metric::ssim, "ssim"},
                                                                       {Metric::flip, "flip"}}};

/// Beyond float32's own range a background would only overflow the sums.
constexpr double kLargestBackground = 1e38;

std::optional<Metric> metric_called(std::string_view name) {
    for (const auto& [metric, known] : kMetrics)
        if (known == name) return metric;
    return std::nullopt;
}

std::optional<double> finite_number(std::string_view text) {
    if (text.starts_with('+')) text.remove_prefix(1);
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
    return value;
}

std::string_view sign(Bound bound) { return bound == Bound::at_most ? "<=" : ">="; }

std::string number(const std::optional<double>& value, Metric metric) {
    if (value) return fmt::format("{}", *value);
    return metric == Metric::psnr ? "inf" : "none";
}

bool holds(const Limit& limit, const std::optional<double>& value) {
    if (!value) return limit.bound == Bound::at_least;  // PSNR of equal images: infinite
    return limit.bound == Bound::at_most ? *value <= limit.value : *value >= limit.value;
}

}  // namespace

std::string_view metric_name(Metric metric) {
    return std::find_if(kMetrics.begin(), kMetrics.end(), [&](const auto& m) { return m.first == metric; })->second;
}

std::set<Metric> parse_metrics(std::string_view name) {
    std::set<Metric> metrics;
    for (const auto& [metric, known] : kMetrics)
        if (name == "all" || name == known) metrics.insert(metric);
    if (metrics.empty()) throw input_error("--metric {}: expected rmse, mae, psnr, ssim, flip or all", name);
    return metrics;
}

Vec3 parse_background(std::string_view text) {
    Vec3 color{0.0};
    std::string_view rest = text;
    for (int i = 0; i < 3; ++i) {
        const std::size_t comma = i < 2 ? rest.find(',') : rest.size();
        const auto value = comma == std::string_view::npos ? std::nullopt : finite_number(rest.substr(0, comma));
        if (!value || std::abs(*value) > kLargestBackground)
            throw input_error("--background {}: expected three numbers r,g,b", text);
        color[i] = *value;
        rest.remove_prefix(std::min(comma + 1, rest.size()));
    }
    return color;
}

Limit parse_limit(std::string_view text, Bound bound) {
    const std::string_view option = bound == Bound::at_most ? "--max" : "--min";
    const std::size_t equals = text.find('=');
    const auto metric = metric_called(text.substr(0, equals));
    if (equals == std::string_view::npos || !metric)
        throw input_error("{} {}: expected METRIC=VALUE with rmse, mae, psnr, ssim or flip", option, text);
    const auto value = finite_number(text.substr(equals + 1));
    if (!value) throw input_error("{} {}: \"{}\" is no finite number", option, text, text.substr(equals + 1));
    return {*metric, bound, *value};
}

bool Comparison::passed() const {
    return std::all_of(limits.begin(), limits.end(), [](const LimitOutcome& outcome) { return outcome.passed; });
}

Comparison compare_images(const NamedImage& test, const NamedImage& truth, const ComparisonSettings& settings) {
    // Refuse what cannot be compared, before any work.
    const double ppd = settings.pixels_per_degree;
    if (!(ppd >= kMinPixelsPerDegree && ppd <= kMaxPixelsPerDegree))
        throw input_error("--ppd {}: expected {} to {} pixels per degree", ppd, kMinPixelsPerDegree,
                          kMaxPixelsPerDegree);
    if (test.image.width() != truth.image.width() || test.image.height() != truth.image.height())
        throw input_error("{}: {}x{} pixels, expected {}x{} as {}", test.name, test.image.width(), test.image.height(),
                          truth.image.width(), truth.image.height(), truth.name);
    const RgbImage a = over_background(test.image, settings.background, test.name);
    const RgbImage b = over_background(truth.image, settings.background, truth.name);

    std::set<Metric> wanted = settings.metrics;
    for (const Limit& limit : settings.limits) wanted.insert(limit.metric);
    Comparison comparison;
    comparison.width = a.width;
    comparison.height = a.height;
    for (const Metric metric : wanted) {
        std::optional<double>& value = comparison.values[metric];
        switch (metric) {
            case Metric::rmse: value = rmse(a, b); break;
            case Metric::mae: value = mae(a, b); break;
            case Metric::psnr: value = psnr(a, b); break;
            case Metric::ssim: value = ssim(a, b); break;
            case Metric::flip: {
                const FlipError error = flip(a, b, ppd);
                value = error.mean;
                if (settings.wants_map) comparison.map = magma_image(error.map, a.width, a.height);
                break;
            }
        }
    }
    if (settings.wants_map && !comparison.map) comparison.map = absolute_error_map(a, b);

    for (const Limit& limit : settings.limits) {
        const std::optional<double>& value = comparison.values[limit.metric];
        if (limit.metric == Metric::ssim && !value)
            throw input_error("{}: {}x{} pixels, expected at least 11x11 for a limit on ssim", test.name, a.width,
                              a.height);
        comparison.limits.push_back({limit, holds(limit, value)});
    }
    return comparison;
}

std::string comparison_json(const Comparison& comparison, std::string_view test, std::string_view truth) {
    nlohmann::ordered_json json;
    json["test"] = test;
    json["truth"] = truth;
    json["width"] = comparison.width;
    json["height"] = comparison.height;
    for (const auto& [metric, value] : comparison.values) {
        const std::string key(metric_name(metric));
        if (value)
            json[key] = *value;
        else
            json[key] = nullptr;
    }
    json["limits"] = nlohmann::ordered_json::array();
    for (const auto& [limit, passed] : comparison.limits)
        json["limits"].push_back({{"metric", metric_name(limit.metric)},
                                  {"relation", sign(limit.bound)},
                                  {"limit", limit.value},
                                  {"passed", passed}});
    json["passed"] = comparison.passed();
    // A file name need not be UTF-8.
    return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

std::string comparison_text(const Comparison& comparison) {
    std::string text;
    for (const auto& [metric, value] : comparison.values)
        text += fmt::format("{} {}\n", metric_name(metric), number(value, metric));
    return text;
}

std::string describe(const LimitOutcome& outcome, const Comparison& comparison) {
    const Limit& limit = outcome.limit;
    const auto found = comparison.values.find(limit.metric);
    const std::optional<double> value = found == comparison.values.end() ? std::nullopt : found->second;
    return fmt::format("{} = {}, limit {} {}", metric_name(limit.metric), number(value, limit.metric),
                       sign(limit.bound), limit.value);
}

}  // namespace pellucid
