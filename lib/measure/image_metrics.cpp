#include "measure/image_metrics.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <span>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace pellucid {
namespace {

constexpr int kWindow = 11;
constexpr double kWindowSigma = 1.5;
constexpr double kC1 = 0.01 * 0.01;  // (K1·L)², L = 1
constexpr double kC2 = 0.03 * 0.03;

[[maybe_unused]] bool is_pair(const RgbImage& a, const RgbImage& b) {
    return a.width == b.width && a.height == b.height && a.width > 0 && a.height > 0;
}

/// Σ over all pixels and channels of f(test − truth), rows first.
template <class F>
double sum_of_differences(const RgbImage& test, const RgbImage& truth, F f) {
    const auto width = static_cast<std::size_t>(test.width);
    const auto height = static_cast<std::size_t>(test.height);
    std::vector<double> rows(height, 0.0);
    parallel_for(height, 16, [&](std::size_t begin, std::size_t end) {
        for (std::size_t y = begin; y < end; ++y)
            for (std::size_t c = 0; c < 3; ++c)
                for (std::size_t i = y * width; i < (y + 1) * width; ++i)
                    rows[y] += f(test.channels[c][i] - truth.channels[c][i]);
    });
    double sum = 0;
    for (const double row : rows) sum += row;
    return sum;
}

double value_count(const RgbImage& image) { return 3.0 * static_cast<double>(image.pixel_count()); }

/// Squares of float32 values reach 1e77, far below the end of double: the sum is finite.
double mean_square(const RgbImage& test, const RgbImage& truth) {
    const double sum = sum_of_differences(test, truth, [](double d) { return d * d; });
    assert(std::isfinite(sum));
    return sum / value_count(test);
}

std::vector<double> luminance(const RgbImage& image) {
    std::vector<double> y(image.pixel_count());
    for (std::size_t i = 0; i < y.size(); ++i)
        y[i] = 0.2126 * image.channels[0][i] + 0.7152 * image.channels[1][i] + 0.0722 * image.channels[2][i];
    return y;
}

std::array<double, kWindow> gaussian_window() {
    std::array<double, kWindow> weights{};
    double sum = 0;
    for (int i = 0; i < kWindow; ++i) {
        const double x = i - kWindow / 2;
        sum += weights[static_cast<std::size_t>(i)] = std::exp(-x * x / (2 * kWindowSigma * kWindowSigma));
    }
    for (double& w : weights) w /= sum;
    return weights;
}

/// The five local moments of SSIM in one window.
struct Moments {
    double x = 0, y = 0, xx = 0, yy = 0, xy = 0;

    void add(double w, const Moments& m) {
        x += w * m.x;
        y += w * m.y;
        xx += w * m.xx;
        yy += w * m.yy;
        xy += w * m.xy;
    }
};

double similarity(const Moments& m) {
    const double variance_x = m.xx - m.x * m.x;
    const double variance_y = m.yy - m.y * m.y;
    const double covariance = m.xy - m.x * m.y;
    return (2 * m.x * m.y + kC1) * (2 * covariance + kC2) /
           ((m.x * m.x + m.y * m.y + kC1) * (variance_x + variance_y + kC2));  // Wang et al. (13)
}

}  // namespace

RgbImage over_background(const Image& image, const Vec3& background, std::string_view name) {
    if (image.pixel_count() == 0) throw input_error("{}: the image is empty, expected at least one pixel", name);
    for (const char* channel : {"R", "G", "B"})
        if (!image.has(channel)) throw input_error("{}: no channel \"{}\", expected R, G and B", name, channel);

    const bool has_alpha = image.has("A");
    const std::span<const float> alpha = has_alpha ? image.plane("A") : std::span<const float>();
    for (const char* channel : {"R", "G", "B", "A"}) {
        if (!image.has(channel)) continue;
        const std::span<const float> values = image.plane(channel);
        std::size_t bad = 0;
        std::size_t first = 0;
        for (std::size_t i = values.size(); i-- > 0;)
            if (!std::isfinite(values[i])) {
                ++bad;
                first = i;
            }
        if (bad > 0)
            throw input_error("{}: channel {} is {} at pixel ({}, {}) ({} in all), expected finite values", name, channel,
                              std::isnan(values[first]) ? "NaN" : "infinite",
                              first % static_cast<std::size_t>(image.width()),
                              first / static_cast<std::size_t>(image.width()), bad);
    }

    RgbImage rgb{image.width(), image.height(), {}};
    const std::array<const char*, 3> names{"R", "G", "B"};
    for (std::size_t c = 0; c < 3; ++c) {
        const std::span<const float> values = image.plane(names[c]);
        const double behind = background[static_cast<glm::length_t>(c)];
        rgb.channels[c].assign(values.begin(), values.end());
        if (!has_alpha) continue;
        for (std::size_t i = 0; i < values.size(); ++i)
            rgb.channels[c][i] += (1 - static_cast<double>(alpha[i])) * behind;
    }
    return rgb;
}

double rmse(const RgbImage& test, const RgbImage& truth) {
    assert(is_pair(test, truth));
    return std::sqrt(mean_square(test, truth));
}

double mae(const RgbImage& test, const RgbImage& truth) {
    assert(is_pair(test, truth));
    return sum_of_differences(test, truth, [](double d) { return std::abs(d); }) / value_count(test);
}

std::optional<double> psnr(const RgbImage& test, const RgbImage& truth) {
    const double error = rmse(test, truth);
    if (error == 0) return std::nullopt;
    return -20 * std::log10(error);
}

std::optional<double> ssim(const RgbImage& test, const RgbImage& truth) {
    assert(is_pair(test, truth));
    if (test.width < kWindow || test.height < kWindow) return std::nullopt;
    const std::vector<double> x = luminance(test);
    const std::vector<double> y = luminance(truth);
    const std::array<double, kWindow> window = gaussian_window();
    const auto width = static_cast<std::size_t>(test.width);
    const std::size_t valid_width = width - (kWindow - 1);
    const std::size_t valid_height = static_cast<std::size_t>(test.height) - (kWindow - 1);

    // The window is separable: columns into one row of moments, then along that row.
    std::vector<double> rows(valid_height, 0.0);
    parallel_for(valid_height, 8, [&](std::size_t begin, std::size_t end) {
        std::vector<Moments> columns(width);
        for (std::size_t top = begin; top < end; ++top) {
            std::fill(columns.begin(), columns.end(), Moments{});
            for (std::size_t k = 0; k < kWindow; ++k)
                for (std::size_t i = 0; i < width; ++i) {
                    const double a = x[(top + k) * width + i];
                    const double b = y[(top + k) * width + i];
                    columns[i].add(window[k], {a, b, a * a, b * b, a * b});
                }
            for (std::size_t left = 0; left < valid_width; ++left) {
                Moments local;
                for (std::size_t k = 0; k < kWindow; ++k) local.add(window[k], columns[left + k]);
                rows[top] += similarity(local);
            }
        }
    });
    double sum = 0;
    for (const double row : rows) sum += row;
    return sum / (static_cast<double>(valid_width) * static_cast<double>(valid_height));
}

Image absolute_error_map(const RgbImage& test, const RgbImage& truth) {
    assert(is_pair(test, truth));
    Image map(test.width, test.height);
    const std::array<const char*, 3> names{"R", "G", "B"};
    for (std::size_t c = 0; c < 3; ++c) {
        const std::span<float> plane = map.add(names[c]);
        for (std::size_t i = 0; i < plane.size(); ++i)
            plane[i] = static_cast<float>(std::abs(test.channels[c][i] - truth.channels[c][i]));
    }
    return map;
}

}  // namespace pellucid
