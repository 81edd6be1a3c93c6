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

}  // namespace

void MpuLine::set(const MpuField& field, std::span<const std::uint32_t> leaves, const Vec3& origin,
                  const Vec3& direction) {
    parts_.clear();
    const Vec3 from = field.to_unit(origin);
    const Vec3 along = direction / field.size();
    const double along2 = dot(along, along);
    for (const std::uint32_t number : leaves) {
        const MpuLeaf& leaf = field.leaves()[number];
        const double edge = leaf.edge;
        const Vec3 center = vector(leaf.center);
        Part part;
        part.middle = dot(center - from, along) / along2;
        const Vec3 u = (from + part.middle * along - center) / edge;
        const Vec3 du = along / edge;
        part.near2 = dot(u, u);
        if (!(part.near2 < kMpuSupport2)) continue;
        part.per2 = dot(du, du);
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
        sum += w * q[deciding_piece(part.join, q)];
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
        const std::size_t k = deciding_piece(part.join, q);
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
        double a0, a1, a2, push;
        std::size_t part;
    };
    thread_local std::vector<Bound> bounds;
    bounds.clear();
    const double middle = lo + 0.5 * (hi - lo);
    const double half = 0.5 * (hi - lo);
    Bound mean{0, 0, 0, 0, 0};
    double weight_at_middle = 0;
    double least_weight = 0;
    for (std::size_t i = 0; i < parts_.size(); ++i) {
        const Part& part = parts_[i];
        const double off = middle - part.middle;
        const double near = std::max(std::abs(off) - half, 0.0);
        const double far = std::abs(off) + half;
        const MpuWeight most(part.near2 + part.per2 * near * near);
        if (!(most.value > 0)) continue;
        least_weight += MpuWeight(part.near2 + part.per2 * far * far).value;
        const double here = MpuWeight(part.near2 + part.per2 * off * off).value;
        weight_at_middle += here;
        const double push = most.slope * part.per2 * far;
        std::array<double, 3> q{};
        const std::size_t first = bounds.size();
        for (std::size_t k = 0; k < piece_count(part.join); ++k) {
            const Piece& p = part.pieces[k];
            q[k] = p.a0 + off * (p.a1 + off * p.a2);
            bounds.push_back({q[k], half * (p.a1 + 2 * off * p.a2), half * half * p.a2, push, i});
        }
        const Bound& own = bounds[first + deciding_piece(part.join, q)];
        mean.a0 += here * own.a0;
        mean.a1 += here * own.a1;
        mean.a2 += here * own.a2;
    }
    Range range{Interval::everything(true), Interval::everything(true)};
    if (!(weight_at_middle > 0)) return range;
    mean.a0 /= weight_at_middle;
    mean.a1 /= weight_at_middle;
    mean.a2 /= weight_at_middle;
    double value_lo = kInfinity, value_hi = -kInfinity, slope_lo = kInfinity, slope_hi = -kInfinity;
    for (Bound& b : bounds) {
        b.a0 -= mean.a0;
        b.a1 -= mean.a1;
        b.a2 -= mean.a2;
        const double wide = std::abs(b.a1) + std::abs(b.a2);
        value_lo = std::min(value_lo, b.a0 - wide);
        value_hi = std::max(value_hi, b.a0 + wide);
        slope_lo = std::min(slope_lo, b.a1 - 2 * std::abs(b.a2));
        slope_hi = std::max(slope_hi, b.a1 + 2 * std::abs(b.a2));
    }
    constexpr double kSlack = 1e-14;
    const double wide = std::abs(mean.a1) + std::abs(mean.a2) + kSlack;
    range.value = Interval(mean.a0 - wide + value_lo, mean.a0 + wide + value_hi);
    if (!(least_weight > 0) || !(half > 0)) return range;
    double push = 0;
    double largest = 0;
    std::size_t last = parts_.size();
    for (const Bound& b : bounds) {
        if (b.part != last) push += std::exchange(largest, 0.0);
        last = b.part;
        const double own = std::abs(b.a1) + std::abs(b.a2);
        largest = std::max(largest, b.push * std::max(b.a0 + own - value_lo, value_hi - (b.a0 - own)));
    }
    push += largest;
    const double more = half * push / least_weight + kSlack;
    const double bend = 2 * std::abs(mean.a2);
    range.slope = Interval((mean.a1 - bend + slope_lo - more) / half, (mean.a1 + bend + slope_hi + more) / half);
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
        const std::size_t k = deciding_piece(leaf.join, q);
        const Vec3 push = -(w.slope / edge) * u;
        weights += w.value;
        sum += w.value * q[k];
        weights_gradient += push;
        gradient += w.value * quadric(field.piece(leaf, k)).gradient(u) + q[k] * push;
    }
    return (gradient - (sum / weights) * weights_gradient) / weights;
}

}  // namespace pellucid
