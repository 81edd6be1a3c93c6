#include "study/outlines.hpp"

#include <algorithm>
#include <cmath>

namespace pellucid {

std::vector<std::uint8_t> near_outlines(const Image& image, double jump, int reach) {
    const int width = image.width();
    const int height = image.height();
    const auto z = image.plane("Z");
    const auto at = [&](int x, int y) {
        return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
    };
    std::vector<std::uint8_t> mask(image.pixel_count(), 0);
    const auto mark = [&](int x, int y) {
        for (int v = std::max(0, y - reach); v <= std::min(height - 1, y + reach); ++v)
            for (int u = std::max(0, x - reach); u <= std::min(width - 1, x + reach); ++u) mask[at(u, v)] = 1;
    };
    const auto turns = [&](std::size_t a, std::size_t b, std::size_t c) {
        const double second = static_cast<double>(z[a]) - 2 * static_cast<double>(z[b]) + static_cast<double>(z[c]);
        const bool nothing = !std::isfinite(z[a]) && !std::isfinite(z[b]) && !std::isfinite(z[c]);
        return !nothing && !(std::abs(second) <= jump);
    };
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const bool along_row = x > 0 && x + 1 < width && turns(at(x - 1, y), at(x, y), at(x + 1, y));
            const bool along_column = y > 0 && y + 1 < height && turns(at(x, y - 1), at(x, y), at(x, y + 1));
            if (along_row || along_column) mark(x, y);
        }
    return mask;
}

RgbImage without(const std::vector<std::uint8_t>& mask, RgbImage test, const RgbImage& truth) {
    for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t i = 0; i < mask.size(); ++i)
            if (mask[i] != 0) test.channels[c][i] = truth.channels[c][i];
    return test;
}

}  // namespace pellucid
