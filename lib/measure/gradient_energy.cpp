#include "measure/gradient_energy.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>
#include <vector>

namespace pellucid {
namespace {

constexpr double kWindowSigma = 1.5;
constexpr std::size_t kWindowRadius = 5;
constexpr double kMostSensitive = 8;  // cycles per degree

/// Half of a Gaussian, from its middle on; not normalised.
std::vector<double> gaussian(double sigma, std::size_t radius) {
    std::vector<double> weight{1.0};
    for (std::size_t k = 1; k <= radius; ++k)
        weight.push_back(std::exp(-static_cast<double>(k * k) / (2 * sigma * sigma)));
    return weight;
}

enum class Border { cut, goes_on };

/// Lines of a plane: `count` of `length` values, `stride` from one to the next.
struct Lines {
    std::size_t count, line_stride, length, stride;
};

/// Weighted mean along lines.
void blur_lines(std::vector<double>& values, const Lines& lines, const std::vector<double>& weight, Border border) {
    const auto radius = static_cast<std::ptrdiff_t>(weight.size()) - 1;
    const auto end = static_cast<std::ptrdiff_t>(lines.length);
    std::vector<double> line(lines.length);
    for (std::size_t n = 0; n < lines.count; ++n) {
        double* const first = values.data() + n * lines.line_stride;
        for (std::size_t i = 0; i < lines.length; ++i) line[i] = first[i * lines.stride];
        for (std::ptrdiff_t i = 0; i < end; ++i) {
            double sum = 0;
            double weights = 0;
            for (std::ptrdiff_t j = i - radius; j <= i + radius; ++j) {
                if (border == Border::cut && (j < 0 || j >= end)) continue;
                const double w = weight[static_cast<std::size_t>(std::abs(j - i))];
                sum += w * line[static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(j, 0, end - 1))];
                weights += w;
            }
            first[static_cast<std::size_t>(i) * lines.stride] = sum / weights;
        }
    }
}

void blur(std::vector<double>& plane, const RgbImage& image, const std::vector<double>& weight, Border border) {
    const auto width = static_cast<std::size_t>(image.width);
    const auto height = static_cast<std::size_t>(image.height);
    blur_lines(plane, {height, width, width, 1}, weight, border);
    blur_lines(plane, {width, 1, height, width}, weight, border);
}

/// g ∗ mean over channels of the squared differences to the right and downwards of h ∗ c.
std::vector<double> local_energy(const RgbImage& image, const std::vector<double>& eye) {
    const auto width = static_cast<std::size_t>(image.width);
    const auto height = static_cast<std::size_t>(image.height);
    std::vector<double> energy(image.pixel_count(), 0.0);
    for (std::vector<double> c : image.channels) {
        if (eye.size() > 1) blur(c, image, eye, Border::goes_on);
        for (std::size_t y = 0; y < height; ++y)
            for (std::size_t x = 0; x < width; ++x) {
                const std::size_t i = y * width + x;
                const double dx = x + 1 < width ? c[i + 1] - c[i] : 0;
                const double dy = y + 1 < height ? c[i + width] - c[i] : 0;
                energy[i] += (dx * dx + dy * dy) / 3;
            }
    }
    blur(energy, image, gaussian(kWindowSigma, kWindowRadius), Border::cut);
    return energy;
}

}  // namespace

GradientDifference gradient_difference(const RgbImage& test, const RgbImage& truth, double pixels_per_degree) {
    assert(test.width == truth.width && test.height == truth.height && test.width > 0 && test.height > 0);
    const double sigma = pixels_per_degree / (2 * std::numbers::pi * kMostSensitive);
    const std::vector<double> eye = gaussian(sigma, static_cast<std::size_t>(std::ceil(4 * sigma)));
    const std::vector<double> of_test = local_energy(test, eye);
    const std::vector<double> of_truth = local_energy(truth, eye);
    double excess = 0;
    double lack = 0;
    for (std::size_t i = 0; i < of_test.size(); ++i) {
        excess += std::max(0.0, of_test[i] - of_truth[i]);
        lack += std::max(0.0, of_truth[i] - of_test[i]);
    }
    const auto n = static_cast<double>(of_test.size());
    return {std::sqrt(excess / n), std::sqrt(lack / n)};
}

double contrast_sensitivity(double cycles_per_degree) {
    const double f = 0.114 * cycles_per_degree;
    return 2.6 * (0.0192 + f) * std::exp(-std::pow(f, 1.1));
}

}  // namespace pellucid
