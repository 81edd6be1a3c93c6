#include "cpu/preintegration.hpp"

#include <algorithm>
#include <cmath>

namespace pellucid {
namespace {

/// Of λ = −ln(1 − α) where α goes linearly: its mean, and ∫(u − ½)·λ du over u in [0, 1].
struct Moments {
    double mean;
    double skew;
};

/// With the middle m of 1 − α and 1 − α = m·(1 + r·s), s in [−1, 1]: λ = −ln m − ln(1 + r·s).
[[nodiscard]] Moments moments_of(double a0, double a1) {
    constexpr double kSeries =
        0.05;  // the first terms left out: r^10/110 and 2·r^9/99, below double's rounding
    const double middle = -std::log1p(-0.5 * (a0 + a1));
    const double r = (a0 - a1) / (2 - a0 - a1);
    const double r2 = r * r;
    if (std::abs(r) < kSeries)
        return {middle + r2 * (1.0 / 6 + r2 * (1.0 / 20 + r2 * (1.0 / 42 + r2 / 72))),
                -0.5 * r * (1.0 / 3 + r2 * (1.0 / 15 + r2 * (1.0 / 35 + r2 / 63)))};
    // Where one end has opacity 1, r = ±1 and the logarithm's factor is 0.
    const double up = std::log1p(r);
    const double down = std::log1p(-r);
    const double whole = (r > -1 ? (1 + r) * up : 0) - (r < 1 ? (1 - r) * down : 0);
    const double odd = std::abs(r) < 1 ? 0.5 * (1 - 1 / r2) * (up - down) : 0;
    return {middle - whole / (2 * r) + 1, -0.25 * (odd + 1 / r)};
}

/// Where colour goes linearly with optical depth by Δ over a depth of τ, what is seen of it differs from the
/// mean colour by Δ times this: 1/τ − 1/(e^τ − 1) − ½.
[[nodiscard]] double front_weight(double depth) {
    if (depth < 0.01) return -depth / 12;
    return 1 / depth - 1 / std::expm1(depth) - 0.5;
}

/// Front to back.
struct Sum {
    double depth = 0;
    Vec3 color{0.0};

    void add(double more, const Vec3& straight) {
        color += std::exp(-depth) * -std::expm1(-more) * straight;
        depth += more;
    }
};

/// A part between two points of the transfer function.
void add_piece(const TransferFunction::Piece& piece, double from, double to, double steps, Sum& sum) {
    if (piece.opacity == 0 && piece.opacity_slope == 0) return;
    const double a0 = piece.opacity_at(from), a1 = piece.opacity_at(to);
    const Vec3 c0 = piece.color_at(from), c1 = piece.color_at(to);
    if (a0 >= 1 && a1 >= 1) return sum.add(kInfinity, c0);
    const Vec3 change = c1 - c0;
    const double most = std::max({std::abs(change.x), std::abs(change.y), std::abs(change.z)});
    const Moments whole = moments_of(a0, a1);
    const double depth = whole.mean * steps;
    if (!(depth > 0)) return;
    if (most == 0) return sum.add(depth, c0);
    // Colour linear in optical depth is a model where opacity changes as well: its error falls with the
    // square of the number of parts.
    constexpr double kMostParts = 64;
    const int parts =
        a0 == a1 ? 1 : static_cast<int>(std::clamp(std::ceil(6 * std::sqrt(depth * most)), 1.0, kMostParts));
    for (int i = 0; i < parts; ++i) {
        const double u0 = static_cast<double>(i) / parts, u1 = (i + 1.0) / parts;
        const Moments m = parts == 1 ? whole : moments_of(a0 + u0 * (a1 - a0), a0 + u1 * (a1 - a0));
        if (!(m.mean > 0)) continue;
        const double part = m.mean * steps / parts;
        const double shift = std::clamp(m.skew / m.mean + front_weight(part), -0.5, 0.5);
        sum.add(part, c0 + (0.5 * (u0 + u1) + shift / parts) * change);
    }
}

}  // namespace

Look preintegrate(const TransferFunction& transfer, double from, double to, double steps) {
    if (!std::isfinite(from) || !std::isfinite(to) || !(steps > 0)) return {};
    const auto pieces = transfer.pieces();
    const auto kinks = transfer.kinks();
    Sum sum;
    std::size_t piece = transfer.piece_of(from);
    const std::size_t last = transfer.piece_of(to);
    if (piece == last) {
        add_piece(pieces[piece], from, to, steps, sum);
    } else {
        const bool rising = to > from;
        for (double at = from; sum.depth < kInfinity;) {
            const double end = piece == last ? to : rising ? kinks[piece] : kinks[piece - 1];
            const double share = std::abs(end - at) / std::abs(to - from);
            if (share > 0) add_piece(pieces[piece], at, end, steps * share, sum);
            if (piece == last) break;
            at = end;
            piece = rising ? piece + 1 : piece - 1;
        }
    }
    return {-std::expm1(-sum.depth), sum.color};
}

}  // namespace pellucid
