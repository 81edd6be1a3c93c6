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

constexpr std::array<std::size_t, 3> kStride{1, 4, 16};

/// Least and largest control point of each of the four layers across an axis.
struct Layers {
    std::array<double, 4> least, most;
};
[[nodiscard]] Layers layers(const std::array<double, 64>& b, std::size_t axis) {
    Layers found;
    const std::size_t s = kStride[axis];
    for (std::size_t layer = 0; layer < 4; ++layer) {
        double least = kInfinity, most = -kInfinity;
        for (std::size_t n = 0; n < 16; ++n) {
            const std::size_t at = axis == 0 ? 4 * n : axis == 1 ? n % 4 + 16 * (n / 4) : n;
            const double value = b[at + s * layer];
            least = value < least ? value : least;
            most = value > most ? value : most;
        }
        found.least[layer] = least;
        found.most[layer] = most;
    }
    return found;
}

/// The first place at which a polynomial whose control points are at most `most` can reach 0; above 1 where none.
[[nodiscard]] double first_reach(const std::array<double, 4>& most) {
    if (most[0] >= 0) return 0;
    double first = 2;
    for (std::size_t i = 1; i < 4; ++i)
        if (most[i] >= 0) first = std::min(first, static_cast<double>(i) / 3 * (-most[0] / (most[i] - most[0])));
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
    static const Matrix kFromSamples{{{0, 1, 0, 0}, {-sixth, 1, sixth, 0}, {0, sixth, 1, -sixth}, {0, 0, 1, 0}}};
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
    double least = kInfinity, most = -kInfinity;
    for (const double value : b) {
        least = value < least ? value : least;
        most = value > most ? value : most;
    }
    return {least - rounding, most + rounding};
}

Interval Tricubic::slope(int axis) const {
    const std::size_t s = kStride[static_cast<std::size_t>(axis)];
    double least = kInfinity, most = -kInfinity;
    for (std::size_t i = 0; i < 64; ++i) {
        if ((i / s) % 4 == 3) continue;
        const double step = b[i + s] - b[i];
        least = step < least ? step : least;
        most = step > most ? step : most;
    }
    return {3 * (least - 2 * rounding), 3 * (most + 2 * rounding)};
}

Interval Tricubic::bend(int axis) const {
    const std::size_t s = kStride[static_cast<std::size_t>(axis)];
    double least = kInfinity, most = -kInfinity;
    for (std::size_t i = 0; i < 64; ++i) {
        if ((i / s) % 4 >= 2) continue;
        const double step = b[i + 2 * s] - 2 * b[i + s] + b[i];
        least = step < least ? step : least;
        most = step > most ? step : most;
    }
    return {6 * (least - 4 * rounding), 6 * (most + 4 * rounding)};
}

Box Tricubic::zeros() const {
    const Interval all = range();
    // Zero counts as positive: where f is nowhere negative nothing changes.
    if (!(all.lo < 0 && all.hi >= 0)) return {};
    Box box;
    for (int axis = 0; axis < 3; ++axis) {
        auto [least, most] = layers(b, static_cast<std::size_t>(axis));
        for (std::size_t i = 0; i < 4; ++i) {
            most[i] += rounding;
            least[i] = -(least[i] - rounding);
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
