#include "field/mpu_lines.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace pellucid {
namespace {

[[nodiscard]] Vec3 vector(const std::array<float, 3>& v) { return {v[0], v[1], v[2]}; }

[[nodiscard]] Quadric quadric(const std::array<float, 10>& q) {
    Quadric out;
    std::ranges::copy(q, out.c.begin());
    return out;
}

/// Most leaves have one piece: without a call.
[[nodiscard]] std::size_t decides(Join join, const std::array<double, 3>& value) {
    return join == Join::one ? 0 : deciding_piece(join, value);
}

/// Of [lo, hi], against rounding.
constexpr double kRoom = 1e-9;

}  // namespace

void MpuLine::set(const MpuField& field, std::span<const std::uint32_t> leaves, const Vec3& origin,
                  const Vec3& direction, double lo, double hi) {
    parts_.clear();
    const Vec3 from = field.to_unit(origin);
    const Vec3 along = direction / field.size();
    const double per_along2 = 1 / dot(along, along);
    const double along2 = dot(along, along);
    const double line_middle = lo + 0.5 * (hi - lo);
    const double line_half = 0.5 * (hi - lo) * (1 + kRoom);
    for (const std::uint32_t number : leaves) __builtin_prefetch(field.leaves().data() + number);
    for (const std::uint32_t number : leaves) {
        const MpuLeaf& leaf = field.leaves()[number];
        const double edge = leaf.edge;
        const double per_edge = 1 / edge;  // exact: edges are powers of two
        const Vec3 center = vector(leaf.center);
        Part part;
        part.middle = dot(center - from, along) * per_along2;
        const Vec3 u = (from + part.middle * along - center) * per_edge;
        part.near2 = dot(u, u);
        part.per2 = along2 * (per_edge * per_edge);
        const double ahead = std::max(std::abs(line_middle - part.middle) - line_half, 0.0);
        if (!(part.near2 + part.per2 * (ahead * ahead) < kMpuSupport2)) continue;
        const Vec3 du = along * per_edge;
        part.join = leaf.join;
        for (std::size_t k = 0; k < piece_count(leaf.join); ++k) {
            const Quadric q = quadric(field.piece(leaf, k));
            const auto& c = q.c;
            part.pieces[k] = {edge * q.value(u), edge * dot(q.gradient(u), du),
                              edge * (du.x * (c[4] * du.x + c[7] * du.y + c[8] * du.z) +
                                      du.y * (c[5] * du.y + c[9] * du.z) + c[6] * du.z * du.z)};
        }
        parts_.push_back(part);
    }
}

double MpuLine::value(double t) const {
    double sum = 0;
    double weights = 0;
    for (const Part& part : parts_) {
        const double off = t - part.middle;
        const double w = MpuWeight(part.near2 + part.per2 * (off * off)).value;
        std::array<double, 3> q{};
        for (std::size_t k = 0; k < piece_count(part.join); ++k) {
            const Piece& p = part.pieces[k];
            q[k] = p.a0 + off * (p.a1 + off * p.a2);
        }
        weights += w;
        sum += w * q[decides(part.join, q)];
    }
    return sum / weights;
}

MpuLine::Slope MpuLine::value_and_slope(double t) const {
    double sum = 0;
    double weights = 0;
    double sum_slope = 0;
    double weights_slope = 0;
    for (const Part& part : parts_) {
        const double off = t - part.middle;
        const MpuWeight w(part.near2 + part.per2 * (off * off));
        std::array<double, 3> q{};
        for (std::size_t k = 0; k < piece_count(part.join); ++k) {
            const Piece& p = part.pieces[k];
            q[k] = p.a0 + off * (p.a1 + off * p.a2);
        }
        const std::size_t k = decides(part.join, q);
        const double dw = -w.slope * part.per2 * off;
        weights += w.value;
        weights_slope += dw;
        sum += w.value * q[k];
        sum_slope += w.value * (part.pieces[k].a1 + 2 * off * part.pieces[k].a2) + dw * q[k];
    }
    const double f = sum / weights;
    return {f, (sum_slope - f * weights_slope) / weights};
}

/// As MpuField::range, along the line.
MpuLine::Range MpuLine::range(double lo, double hi) const {
    struct Bound {
        double a0, a1, a2;  // of the piece that decides in the middle; −1 … 1 from end to end
        double most, least, here;              // weights
        double push, push_here, push_varies;   // w': largest, in the middle, off it
        double other, other_slope;             // how far the other pieces of the leaf may be
    };
    constexpr double kSlack = 1e-14;
    thread_local std::vector<Bound> bounds;
    bounds.clear();
    const double middle = lo + 0.5 * (hi - lo);
    const double half = 0.5 * (hi - lo);
    double mean[3] = {0, 0, 0};
    double weight_here = 0;
    double least_weight = 0;
    double most_weight = 0;
    double pull = 0;
    double pull_varies = 0;
    for (const Part& part : parts_) {
        const double off = middle - part.middle;
        const double near = std::max(std::abs(off) - half, 0.0);
        const double far = std::abs(off) + half;
        const MpuWeight most(part.near2 + part.per2 * near * near);
        if (!(most.value > 0)) continue;
        const MpuWeight least(part.near2 + part.per2 * far * far);
        const MpuWeight here(part.near2 + part.per2 * off * off);
        // w' = −slope·per2·off, the slope falls with the distance; per half-width.
        const double a = -half * part.per2 * (off - half);
        const double b = -half * part.per2 * (off + half);
        const double push_lo = std::min({most.slope * a, most.slope * b, least.slope * a, least.slope * b});
        const double push_hi = std::max({most.slope * a, most.slope * b, least.slope * a, least.slope * b});
        const double push_here = -half * here.slope * part.per2 * off;
        std::array<double, 3> q{};
        std::array<std::array<double, 3>, 3> pieces{};
        for (std::size_t k = 0; k < piece_count(part.join); ++k) {
            const Piece& p = part.pieces[k];
            q[k] = p.a0 + off * (p.a1 + off * p.a2);
            pieces[k] = {q[k], half * (p.a1 + 2 * off * p.a2), half * half * p.a2};
        }
        const auto& own = pieces[decides(part.join, q)];
        double other = 0;
        double other_slope = 0;
        for (std::size_t k = 0; part.join != Join::one && k < piece_count(part.join); ++k) {
            const double d0 = pieces[k][0] - own[0];
            const double d1 = std::abs(pieces[k][1] - own[1]);
            const double d2 = std::abs(pieces[k][2] - own[2]);
            const bool larger = part.join == Join::max2 || part.join == Join::max3;
            const bool smaller = part.join == Join::min2 || part.join == Join::min3;
            // A piece that is surely on the wrong side of another never decides.
            if ((larger && d0 + d1 + d2 < 0) || (smaller && d0 - d1 - d2 > 0)) continue;
            other = std::max(other, std::abs(d0) + d1 + d2);
            other_slope = std::max(other_slope, d1 + 2 * d2);
        }
        bounds.push_back({own[0], own[1], own[2], most.value, least.value, here.value,
                          std::max(push_hi, -push_lo), push_here, std::max(push_hi - push_here, push_here - push_lo),
                          other, other_slope});
        for (std::size_t i = 0; i < 3; ++i) mean[i] += here.value * own[i];
        weight_here += here.value;
        least_weight += least.value;
        most_weight += most.value;
        pull += push_here;
        pull_varies += bounds.back().push_varies;
    }
    Range range{Interval::everything(true), Interval::everything(true)};
    if (!(weight_here > 0)) return range;
    for (double& m : mean) m /= weight_here;
    pull = std::abs(pull) + pull_varies;
    least_weight = std::max(least_weight, weight_here - pull);
    most_weight = std::min(most_weight, weight_here + pull);
    if (!(least_weight > 0) || !(half > 0)) return range;

    double off = 0;
    double slope_off = 0;
    for (Bound& b : bounds) {
        b.a0 -= mean[0];
        b.a1 -= mean[1];
        b.a2 -= mean[2];
        const double share = b.here / weight_here;
        const double most = std::min(1.0, b.most / least_weight);
        const double moved = (b.push + most * pull) / least_weight;
        const double change = std::min(moved, std::max(most - share, share - b.least / most_weight));
        off += change * (std::abs(b.a0) + std::abs(b.a1) + std::abs(b.a2)) + most * b.other;
        slope_off += change * (std::abs(b.a1) + 2 * std::abs(b.a2)) + most * b.other_slope;
    }
    double push = 0;
    double varies = 0;
    for (const Bound& b : bounds) {
        const double wide = std::abs(b.a1) + std::abs(b.a2);
        push += b.push_here * b.a0;
        varies += b.push_varies * (std::abs(b.a0) + wide) + std::abs(b.push_here) * wide + b.push * (b.other + off);
    }
    const Interval drift = Interval(push - varies, push + varies) / Interval(least_weight, most_weight);
    const double more = 2 * std::abs(mean[2]) + slope_off + kSlack;
    const Interval slope(mean[1] + drift.lo - more, mean[1] + drift.hi + more);  // per half-width
    const double wide = std::min(std::abs(mean[1]) + std::abs(mean[2]) + off, slope.reach()) + kSlack;
    range.value = Interval(mean[0] - wide, mean[0] + wide);
    range.slope = Interval(slope.lo / half, slope.hi / half);
    return range;
}

Vec3 mpu_gradient(const MpuField& field, std::span<const std::uint32_t> leaves, const Vec3& place) {
    const Vec3 x = field.to_unit(place);
    double weights = 0;
    double sum = 0;
    Vec3 gradient(0.0);
    Vec3 weights_gradient(0.0);
    for (const std::uint32_t number : leaves) {
        const MpuLeaf& leaf = field.leaves()[number];
        const double edge = leaf.edge;
        const Vec3 u = (x - vector(leaf.center)) / edge;
        const MpuWeight w(dot(u, u));
        if (!(w.value > 0)) continue;
        std::array<double, 3> q{};
        for (std::size_t k = 0; k < piece_count(leaf.join); ++k) q[k] = edge * quadric(field.piece(leaf, k)).value(u);
        const std::size_t k = decides(leaf.join, q);
        const Vec3 push = -(w.slope / edge) * u;
        weights += w.value;
        sum += w.value * q[k];
        weights_gradient += push;
        gradient += w.value * quadric(field.piece(leaf, k)).gradient(u) + q[k] * push;
    }
    return (gradient - (sum / weights) * weights_gradient) / weights;
}

}  // namespace pellucid
