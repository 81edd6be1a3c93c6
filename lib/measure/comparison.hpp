// One picture judged against another: what the command `compare` does, without its files.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "core/image.hpp"
#include "core/vec.hpp"
#include "measure/flip.hpp"

namespace pellucid {

enum class Metric { rmse, mae, psnr, ssim, flip };

[[nodiscard]] std::string_view metric_name(Metric metric);

/// A metric by its name, or all of them for "all". Throws Error(input) for another name.
[[nodiscard]] std::set<Metric> parse_metrics(std::string_view name);

/// Three finite numbers "r,g,b". Throws Error(input).
[[nodiscard]] Vec3 parse_background(std::string_view text);

enum class Bound { at_most, at_least };

/// What CI holds a metric to.
struct Limit {
    Metric metric = Metric::rmse;
    Bound bound = Bound::at_most;
    double value = 0;
};

/// "METRIC=V" with a finite V. Throws Error(input).
[[nodiscard]] Limit parse_limit(std::string_view text, Bound bound);

struct ComparisonSettings {
    std::set<Metric> metrics = {};
    std::vector<Limit> limits = {};  // their metrics are computed too
    Vec3 background{0.0};
    double pixels_per_degree = kDefaultPixelsPerDegree;
    bool wants_map = false;
};

struct LimitOutcome {
    Limit limit;
    bool passed = false;
};

struct Comparison {
    int width = 0;
    int height = 0;
    /// Empty: PSNR of equal images (infinite), SSIM of an image below 11×11.
    std::map<Metric, std::optional<double>> values;
    std::vector<LimitOutcome> limits;
    /// If wanted: FLIP in magma if FLIP was computed, else the absolute error. Linear R, G, B.
    std::optional<Image> map;

    [[nodiscard]] bool passed() const;
};

struct NamedImage {
    std::string name;  // the file, for messages
    const Image& image;
};

/// Compares the colours over the background. The PSNR of equal images satisfies any at_least and breaks any
/// at_most. Throws Error(input): different sizes, a missing channel, NaN or infinite values, pixels per
/// degree out of range, a limit on an SSIM that does not exist.
[[nodiscard]] Comparison compare_images(const NamedImage& test, const NamedImage& truth,
                                        const ComparisonSettings& settings);

/// One JSON object with a key per metric (null for an empty value), "limits" and "passed", ends in "\n".
[[nodiscard]] std::string comparison_json(const Comparison& comparison, std::string_view test, std::string_view truth);

/// One line a metric, "rmse 0.0123", ends in "\n".
[[nodiscard]] std::string comparison_text(const Comparison& comparison);

/// "flip = 0.07, limit <= 0.05".
[[nodiscard]] std::string describe(const LimitOutcome& outcome, const Comparison& comparison);

}  // namespace pellucid
