// Transfer functions: what a value of a volume looks like.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "core/vec.hpp"
#include "scene/scene.hpp"

namespace pellucid {

/// Straight colour and opacity, linear in the value between points and constant outside of them. A repeated
/// value is a jump, and at the value itself what follows counts. Values that are not finite are empty.
class TransferFunction {
public:
    /// points: values do not fall; at least one.
    explicit TransferFunction(std::vector<TransferPoint> points);

    /// Between two points, or outside: linear in the value.
    struct Piece {
        double from = 0;  // the value at which color and opacity hold …
        Vec3 color{0.0}, color_slope{0.0};
        double opacity = 0, opacity_slope = 0;

        [[nodiscard]] Vec3 color_at(double value) const { return color + (value - from) * color_slope; }
        [[nodiscard]] double opacity_at(double value) const;
    };
    /// Number of pieces, one more than of points that differ in value; piece k ends at kinks()[k].
    [[nodiscard]] std::span<const Piece> pieces() const { return pieces_; }
    /// The values at which a piece ends and another begins, rising.
    [[nodiscard]] std::span<const double> kinks() const { return kinks_; }
    /// Precondition: the value is a number.
    [[nodiscard]] std::size_t piece_of(double value) const;

    [[nodiscard]] Vec3 color(double value) const;
    [[nodiscard]] double opacity(double value) const;
    /// Largest opacity of any value in [lo, hi]; 0 where lo > hi.
    [[nodiscard]] double most_opacity(double lo, double hi) const;
    /// Largest of each channel over all values.
    [[nodiscard]] Vec3 brightest() const { return brightest_; }

private:
    std::vector<Piece> pieces_;
    std::vector<double> kinks_;
    Vec3 brightest_{0.0};
};

}  // namespace pellucid
