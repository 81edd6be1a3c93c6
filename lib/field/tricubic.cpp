#include "field/tricubic.hpp"

#include <algorithm>
#include <cmath>

namespace pellucid {
namespace {

/// Of the largest sample, less the isovalue: what sums of 64 products may be off, with room for restrictions.
constexpr double kRounding = 0x1p-44;
/// Boxes around the zeros are larger than they need be, in shares.
constexpr double kRoom = 1e-6;

/// The linear map of the four control points along an axis, for all 16 rows.
using Matrix = std::array<std::array<double, 4>, 4>;

template <std::size_t stride>
void map_rows(const Matrix& m, std::array<double, 64>& b) {
    for (std::size_t o = 0; o < 64; o += 4 * stride) {
        std::array<double, 4 * stride> row;
        std::copy_n(b.begin() + static_cast<std::ptrdiff_t>(o), 4 * stride, row.begin());
        for (std::size_t out = 0; out < 4; ++out)
            for (std::size_t i = 0; i < stride; ++i)
                b[o + out * stride + i] = m[out][0] * row[i] + m[out][1] * row[stride + i] +
                                          m[out][2] * row[2 * stride + i] + m[out][3] * row[3 * stride + i];
    }
}

/// Along x the rows are transposed first, so that all three are the same four lanes.
void transpose(std::array<double, 64>& b) {
    for (std::size_t o = 0; o < 64; o += 16)
        for (std::size_t i = 0; i < 4; ++i)
            for (std::size_t j = 0; j < i; ++j) std::swap(b[o + i + 4 * j], b[o + j + 4 * i]);
}

void map_axis(int axis, const Matrix& m, std::array<double, 64>& b) {
    if (axis == 0) {
        transpose(b);
        map_rows<4>(m, b);
        transpose(b);
    } else if (axis == 1) {
        map_rows<4>(m, b);
    } else {
        map_rows<16>(m, b);
    }
}

/// Control points on [u, v] of those on [0, 1]: the blossom at (u,u,u), (u,u,v), (u,v,v), (v,v,v).
[[nodiscard]] Matrix restriction(double u, double v) {
    Matrix m;
    for (std::size_t row = 0; row < 4; ++row) {
        const double a = row > 2 ? v : u, b = row > 1 ? v : u, c = row > 0 ? v : u;
        m[row] = {(1 - a) * (1 - b) * (1 - c),
                  a * (1 - b) * (1 - c) + (1 - a) * b * (1 - c) + (1 - a) * (1 - b) * c,
                  a * b * (1 - c) + a * (1 - b) * c + (1 - a) * b * c, a * b * c};
    }
    return m;
}

/// The control points by layers across an axis, 16 each.
using Layers = std::array<std::array<double, 16>, 4>;
[[nodiscard]] Layers layers_across(std::size_t axis, const std::array<double, 64>& b) {
    Layers out;
    for (std::size_t layer = 0; layer < 4; ++layer)
        for (std::size_t n = 0; n < 16; ++n)
            out[layer][n] = b[axis == 0   ? layer + 4 * n
                              : axis == 1 ? 4 * layer + n % 4 + 16 * (n / 4)
                                          : n + 16 * layer];
    return out;
}

[[nodiscard]] double least_of(const std::array<double, 16>& a) {
    std::array<double, 4> four{a[0], a[1], a[2], a[3]};
    for (std::size_t n = 4; n < 16; n += 4)
        for (std::size_t i = 0; i < 4; ++i) four[i] = a[n + i] < four[i] ? a[n + i] : four[i];
    return std::min(std::min(four[0], four[1]), std::min(four[2], four[3]));
}
[[nodiscard]] double most_of(const std::array<double, 16>& a) {
    std::array<double, 4> four{a[0], a[1], a[2], a[3]};
    for (std::size_t n = 4; n < 16; n += 4)
        for (std::size_t i = 0; i < 4; ++i) four[i] = a[n + i] > four[i] ? a[n + i] : four[i];
    return std::max(std::max(four[0], four[1]), std::max(four[2], four[3]));
}

/// Least and largest difference of layers that follow each other; the layers become those differences.
[[nodiscard]] Interval differences(Layers& layers, std::size_t count) {
    std::array<double, 16> least, most;
    for (std::size_t layer = 0; layer < count; ++layer)
        for (std::size_t n = 0; n < 16; ++n) {
            const double step = layers[layer + 1][n] - layers[layer][n];
            layers[layer][n] = step;
            least[n] = layer == 0 || step < least[n] ? step : least[n];
            most[n] = layer == 0 || step > most[n] ? step : most[n];
        }
    return {least_of(least), most_of(most)};
}

/// The first place at which a polynomial whose control points are at most `most` can reach 0, that is their
/// convex hull; above 1 where none. The hull's border crosses 0 on the line of two of them.
[[nodiscard]] double first_reach(const std::array<double, 4>& most) {
    if (most[0] >= 0) return 0;
    double first = 2;
    for (std::size_t j = 1; j < 4; ++j) {
        if (!(most[j] >= 0)) continue;
        for (std::size_t i = 0; i < j; ++i)
            if (most[i] < 0)
                first = std::min(first, (static_cast<double>(i) +
                                         static_cast<double>(j - i) * (most[i] / (most[i] - most[j]))) /
                                            3);
    }
    return first;
}

}  // namespace

Tricubic Tricubic::in_cell(const VolumeField::Samples& samples, double isovalue) {
    Tricubic f;
    double largest = 0;
    double nothing = 0;  // NaN where a sample is not finite
    for (std::size_t i = 0; i < 64; ++i) {
        f.b[i] = static_cast<double>(samples[i]) - isovalue;
        const double size = std::abs(f.b[i]);
        largest = size > largest ? size : largest;
        nothing += 0 * f.b[i];
    }
    f.rounding = kRounding * largest + nothing;
    constexpr double sixth = 1.0 / 6;
    static const Matrix kFromSamples{
        {{0, 1, 0, 0}, {-sixth, 1, sixth, 0}, {0, sixth, 1, -sixth}, {0, 0, 1, 0}}};
    for (int axis = 0; axis < 3; ++axis) map_axis(axis, kFromSamples, f.b);
    return f;
}

Tricubic Tricubic::part(const Vec3& lo, const Vec3& hi) const {
    Tricubic f = *this;
    for (int axis = 0; axis < 3; ++axis)
        if (lo[axis] > 0 || hi[axis] < 1) map_axis(axis, restriction(lo[axis], hi[axis]), f.b);
    return f;
}

Interval Tricubic::range() const {
    std::array<double, 16> least, most;
    for (std::size_t n = 0; n < 16; ++n) least[n] = most[n] = b[n];
    for (std::size_t layer = 16; layer < 64; layer += 16)
        for (std::size_t n = 0; n < 16; ++n) {
            const double value = b[layer + n];
            least[n] = value < least[n] ? value : least[n];
            most[n] = value > most[n] ? value : most[n];
        }
    return {least_of(least) - rounding, most_of(most) + rounding};
}

Interval Tricubic::slope(int axis) const {
    Layers layers = layers_across(static_cast<std::size_t>(axis), b);
    const Interval step = differences(layers, 3);
    return {3 * (step.lo - 2 * rounding), 3 * (step.hi + 2 * rounding)};
}

Interval Tricubic::bend(int axis) const {
    Layers layers = layers_across(static_cast<std::size_t>(axis), b);
    (void)differences(layers, 3);
    const Interval turn = differences(layers, 2);
    return {6 * (turn.lo - 4 * rounding), 6 * (turn.hi + 4 * rounding)};
}

Box Tricubic::zeros() const {
    const Interval all = range();
    // Zero counts as positive: where f is nowhere negative nothing changes.
    if (!(all.lo < 0 && all.hi >= 0)) return {};
    Box box;
    for (int axis = 0; axis < 3; ++axis) {
        const Layers layers = layers_across(static_cast<std::size_t>(axis), b);
        std::array<double, 4> least, most;
        for (std::size_t i = 0; i < 4; ++i) {
            most[i] = most_of(layers[i]) + rounding;
            least[i] = -(least_of(layers[i]) - rounding);
        }
        const double lo = std::max(first_reach(most), first_reach(least));
        std::reverse(most.begin(), most.end());
        std::reverse(least.begin(), least.end());
        const double hi = 1 - std::max(first_reach(most), first_reach(least));
        if (!(lo <= hi + kRoom)) return {};
        box.lo[axis] = std::max(0.0, lo - kRoom);
        box.hi[axis] = std::min(1.0, hi + kRoom);
    }
    return box;
}

}  // namespace pellucid
