#include "measure/gradient_energy.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <vector>

namespace pellucid {
namespace {

constexpr int kRadius = 5;
constexpr double kSigma = 1.5;

/// Mean over channels of the squared differences to the right and downwards; none beyond the borders.
std::vector<double> gradient_energy(const RgbImage& image) {
    const auto width = static_cast<std::size_t>(image.width);
    const auto height = static_cast<std::size_t>(image.height);
    std::vector<double> energy(image.pixel_count(), 0.0);
    for (const std::vector<double>& c : image.channels)
        for (std::size_t y = 0; y < height; ++y)
            for (std::size_t x = 0; x < width; ++x) {
                const std::size_t i = y * width + x;
                const double dx = x + 1 < width ? c[i + 1] - c[i] : 0;
                const double dy = y + 1 < height ? c[i + width] - c[i] : 0;
                energy[i] += (dx * dx + dy * dy) / 3;
            }
    return energy;
}

/// Gaussian mean along one axis: `count` lines of `length` values, `stride` apart.
void blur_lines(std::vector<double>& values, std::size_t count, std::size_t line_stride, std::size_t length,
                std::size_t stride) {
    std::array<double, kRadius + 1> weight{};
    for (std::size_t k = 0; k <= kRadius; ++k)
        weight[k] = std::exp(-static_cast<double>(k * k) / (2 * kSigma * kSigma));
    std::vector<double> line(length);
    const auto end = static_cast<std::ptrdiff_t>(length);
    for (std::size_t n = 0; n < count; ++n) {
        double* const first = values.data() + n * line_stride;
        for (std::size_t i = 0; i < length; ++i) line[i] = first[i * stride];
        for (std::ptrdiff_t i = 0; i < end; ++i) {
            double sum = 0;
            double weights = 0;
            for (std::ptrdiff_t j = std::max<std::ptrdiff_t>(0, i - kRadius);
                 j <= std::min<std::ptrdiff_t>(end - 1, i + kRadius); ++j) {
                const double w = weight[static_cast<std::size_t>(std::abs(j - i))];
                sum += w * line[static_cast<std::size_t>(j)];
                weights += w;
            }
            first[static_cast<std::size_t>(i) * stride] = sum / weights;
        }
    }
}

std::vector<double> local_energy(const RgbImage& image) {
    const auto width = static_cast<std::size_t>(image.width);
    const auto height = static_cast<std::size_t>(image.height);
    std::vector<double> energy = gradient_energy(image);
    blur_lines(energy, height, width, width, 1);
    blur_lines(energy, width, 1, height, width);
    return energy;
}

}  // namespace

GradientDifference gradient_difference(const RgbImage& test, const RgbImage& truth) {
    assert(test.width == truth.width && test.height == truth.height && test.width > 0 && test.height > 0);
    const std::vector<double> of_test = local_energy(test);
    const std::vector<double> of_truth = local_energy(truth);
    double excess = 0;
    double lack = 0;
    for (std::size_t i = 0; i < of_test.size(); ++i) {
        excess += std::max(0.0, of_test[i] - of_truth[i]);
        lack += std::max(0.0, of_truth[i] - of_test[i]);
    }
    const auto n = static_cast<double>(of_test.size());
    return {std::sqrt(excess / n), std::sqrt(lack / n)};
}

}  // namespace pellucid
