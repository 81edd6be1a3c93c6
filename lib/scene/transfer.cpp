#include "scene/transfer.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace pellucid {
namespace {

[[nodiscard]] Vec3 color_of(const TransferPoint& p) {
    return {p[1], p[2], p[3]};
}

}  // namespace

double TransferFunction::Piece::opacity_at(double value) const {
    return std::clamp(opacity + (value - from) * opacity_slope, 0.0, 1.0);
}

TransferFunction::TransferFunction(std::vector<TransferPoint> points) {
    assert(!points.empty());
    const auto constant = [](const TransferPoint& p) { return Piece{p[0], color_of(p), Vec3(0.0), p[4], 0}; };
    pieces_.push_back(constant(points.front()));
    for (std::size_t i = 0; i < points.size(); ++i) {
        const TransferPoint& a = points[i];
        brightest_ = glm::max(brightest_, color_of(a));
        if (i + 1 < points.size() && points[i + 1][0] == a[0])
            continue;  // the last of a jump begins what follows
        kinks_.push_back(a[0]);
        if (i + 1 == points.size()) {
            pieces_.push_back(constant(a));
            continue;
        }
        const TransferPoint& b = points[i + 1];
        const double span = b[0] - a[0];
        pieces_.push_back(
            {a[0], color_of(a), (color_of(b) - color_of(a)) / span, a[4], (b[4] - a[4]) / span});
    }
}

std::size_t TransferFunction::piece_of(double value) const {
    return static_cast<std::size_t>(std::upper_bound(kinks_.begin(), kinks_.end(), value) - kinks_.begin());
}

Vec3 TransferFunction::color(double value) const {
    return std::isfinite(value) ? pieces_[piece_of(value)].color_at(value) : Vec3(0.0);
}

double TransferFunction::opacity(double value) const {
    return std::isfinite(value) ? pieces_[piece_of(value)].opacity_at(value) : 0;
}

double TransferFunction::most_opacity(double lo, double hi) const {
    if (!(lo <= hi)) return 0;
    // Linear between kinks: largest at an end, or at a kink on one of its two sides.
    double most = std::max(pieces_[piece_of(lo)].opacity_at(lo), pieces_[piece_of(hi)].opacity_at(hi));
    for (auto k =
             static_cast<std::size_t>(std::lower_bound(kinks_.begin(), kinks_.end(), lo) - kinks_.begin());
         k < kinks_.size() && kinks_[k] <= hi; ++k)
        most = std::max({most, pieces_[k].opacity_at(kinks_[k]), pieces_[k + 1].opacity_at(kinks_[k])});
    return most;
}

}  // namespace pellucid
