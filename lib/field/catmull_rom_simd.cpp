// Lines along an axis through cells of a Catmull-Rom volume: a cubic each, by rows of four samples at once;
// then roots over SIMD lanes.
//
// No step of a line looks at another line, products are not fused, and sums have one order: the same bits on
// every instruction set and for every number of lines.
#include <limits>

#include "field/catmull_rom.hpp"
#include "field/safeguarded_newton.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "field/catmull_rom_simd.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef PELLUCID_FIELD_CATMULL_ROM_LANES
#define PELLUCID_FIELD_CATMULL_ROM_LANES
namespace pellucid {
namespace {

/// Lines at once, and room for what a vector writes beyond them.
constexpr std::size_t kLines = 128;
constexpr std::size_t kLineRoom = kLines + 16;

/// The 4³ samples of a line: rows of four along x.
struct SampleRows {
    const float* first;
    std::ptrdiff_t y, z;
};

struct alignas(64) CubicLanes {
    SampleRows rows[kLines];
    float border[kLines][64];
    double base[kLineRoom];       // of the cell, along the lines
    double across[2][kLineRoom];  // in the cell; lo and hi as well
    double weights[2][kLineRoom][4];
    double sums[kLineRoom][4];  // the four samples of the cubic
    double lo[kLineRoom], hi[kLineRoom];
    // Of lines with a root alone, in their order:
    double cubic[4][kLineRoom];
    double from[kLineRoom], to[kLineRoom], f_from[kLineRoom], f_to[kLineRoom];
    std::uint64_t line[kLineRoom];
    double root[kLineRoom];
    double at[3][kLineRoom];
    double value[3][kLineRoom][4], slope[3][kLineRoom][4];
};

}  // namespace
}  // namespace pellucid
#endif

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;
inline constexpr D d;
inline constexpr hn::RebindToUnsigned<D> du;

/// Four doubles, in as many registers as it takes.
using D4 = hn::CappedTag<double, 4>;
inline constexpr D4 d4;
inline constexpr hn::Rebind<float, D4> f4;
constexpr std::size_t kWidth = hn::MaxLanes(d4);
constexpr std::size_t kParts = 4 / kWidth;
struct Row {
    hn::Vec<D4> part[kParts];
};

HWY_INLINE Row zero_row() {
    Row row;
    for (auto& part : row.part) part = hn::Zero(d4);
    return row;
}
HWY_INLINE Row load_row(const float* from, hn::Vec<D4> less) {
    Row row;
    for (std::size_t p = 0; p < kParts; ++p)
        row.part[p] = hn::Sub(hn::PromoteTo(d4, hn::LoadU(f4, from + p * kWidth)), less);
    return row;
}
HWY_INLINE Row load_row(const double* from) {
    Row row;
    for (std::size_t p = 0; p < kParts; ++p) row.part[p] = hn::Load(d4, from + p * kWidth);
    return row;
}
HWY_INLINE void store_row(const Row& row, double* to) {
    for (std::size_t p = 0; p < kParts; ++p) hn::Store(row.part[p], d4, to + p * kWidth);
}
HWY_INLINE void add(Row& sum, double weight, const Row& row) {
    for (std::size_t p = 0; p < kParts; ++p)
        sum.part[p] = hn::Add(sum.part[p], hn::Mul(hn::Set(d4, weight), row.part[p]));
}
/// Σ of the products of two rows.
HWY_INLINE double dot(const Row& a, const Row& b) {
    alignas(64) double product[4];
    for (std::size_t p = 0; p < kParts; ++p)
        hn::Store(hn::Mul(a.part[p], b.part[p]), d4, product + p * kWidth);
    return (product[0] + product[1]) + (product[2] + product[3]);
}

/// CatmullRomWeights over lanes.
struct Four {
    V w0, w1, w2, w3;
};
HWY_INLINE V times_add(V a, V b, double c) {
    return hn::Add(hn::Mul(a, b), hn::Set(d, c));
}
HWY_INLINE V scaled(double a, V b) {
    return hn::Mul(hn::Set(d, a), b);
}
HWY_INLINE Four weights_at(V t) {
    const V tt = hn::Mul(t, t);
    return {hn::Mul(t, times_add(t, times_add(t, hn::Set(d, -0.5), 1), -0.5)),
            times_add(tt, times_add(t, hn::Set(d, 1.5), -2.5), 1),
            hn::Mul(t, times_add(t, times_add(t, hn::Set(d, -1.5), 2), 0.5)),
            hn::Mul(tt, times_add(t, hn::Set(d, 0.5), -0.5))};
}
HWY_INLINE Four slopes_at(V t) {
    return {
        times_add(t, times_add(t, hn::Set(d, -1.5), 2), -0.5), hn::Mul(t, times_add(t, hn::Set(d, 4.5), -5)),
        times_add(t, times_add(t, hn::Set(d, -4.5), 4), 0.5), hn::Mul(t, times_add(t, hn::Set(d, 1.5), -1))};
}
HWY_INLINE V sum_of(const Four& w, const Four& c) {
    return hn::Add(hn::Add(hn::Mul(w.w0, c.w0), hn::Mul(w.w1, c.w1)),
                   hn::Add(hn::Mul(w.w2, c.w2), hn::Mul(w.w3, c.w3)));
}
HWY_INLINE void store_each(const Four& w, double (*to)[4]) {
    hn::StoreInterleaved4(w.w0, w.w1, w.w2, w.w3, d, &to[0][0]);
}

/// The four samples of the cubic along an axis. `first` and `second` are the weights of the two other axes,
/// in the order x, y, z.
template <int axis>
HWY_INLINE void sum_samples(const SampleRows& rows, double isovalue, const double* first,
                            const double* second, double* sums) {
    const auto less = hn::Set(d4, isovalue);
    if (axis == 0) {
        Row sum = zero_row();
        for (int k = 0; k < 4; ++k) {
            Row slice = zero_row();
            for (int j = 0; j < 4; ++j)
                add(slice, first[j], load_row(rows.first + j * rows.y + k * rows.z, less));
            add(sum, second[k], slice);
        }
        store_row(sum, sums);
        return;
    }
    const Row x = load_row(first);
    for (int n = 0; n < 4; ++n) {
        Row sum = zero_row();
        for (int m = 0; m < 4; ++m) {
            const int j = axis == 1 ? n : m;
            const int k = axis == 1 ? m : n;
            add(sum, second[m], load_row(rows.first + j * rows.y + k * rows.z, less));
        }
        sums[n] = dot(x, sum);
    }
}

/// The gradient of one line's root.
HWY_INLINE void sum_gradient(const CubicLanes& lanes, const SampleRows& rows, double isovalue, std::size_t i,
                             double* gradient) {
    const auto less = hn::Set(d4, isovalue);
    Row value = zero_row(), by_y = zero_row(), by_z = zero_row();
    for (int k = 0; k < 4; ++k) {
        Row slice = zero_row(), slice_y = zero_row();
        for (int j = 0; j < 4; ++j) {
            const Row row = load_row(rows.first + j * rows.y + k * rows.z, less);
            add(slice, lanes.value[1][i][j], row);
            add(slice_y, lanes.slope[1][i][j], row);
        }
        add(value, lanes.value[2][i][k], slice);
        add(by_y, lanes.value[2][i][k], slice_y);
        add(by_z, lanes.slope[2][i][k], slice);
    }
    const Row x = load_row(lanes.value[0][i]);
    gradient[0] = dot(load_row(lanes.slope[0][i]), value);
    gradient[1] = dot(x, by_y);
    gradient[2] = dot(x, by_z);
}

/// Signs at both ends; lines with a root move to the front: how many.
std::size_t find_changes(std::size_t count, CubicLanes& lanes) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
        Four c;
        hn::LoadInterleaved4(d, &lanes.sums[i][0], c.w0, c.w1, c.w2, c.w3);
        const V lo = hn::Load(d, lanes.lo + i);
        const V hi = hn::Load(d, lanes.hi + i);
        const V f_lo = sum_of(weights_at(lo), c);
        const V f_hi = sum_of(weights_at(hi), c);
        const auto differ = hn::Xor(hn::Ge(f_lo, hn::Zero(d)), hn::Ge(f_hi, hn::Zero(d)));
        const auto mask = hn::And(differ, hn::FirstN(d, count - i));
        const auto put = [&](V v, double* to) { hn::CompressStore(v, mask, d, to + n); };
        put(c.w0, lanes.cubic[0]);
        put(c.w1, lanes.cubic[1]);
        put(c.w2, lanes.cubic[2]);
        put(c.w3, lanes.cubic[3]);
        put(lo, lanes.from);
        put(hi, lanes.to);
        put(f_lo, lanes.f_from);
        put(f_hi, lanes.f_to);
        n += hn::CompressStore(hn::Iota(du, i), hn::RebindMask(du, mask), du, lanes.line + n);
    }
    return n;
}

/// The one root of each cubic, as safeguarded_newton finds it.
void find_roots(std::size_t n, CubicLanes& lanes) {
    const V half = hn::Set(d, 0.5);
    for (std::size_t i = 0; i < n; i += hn::Lanes(d)) {
        const V c0 = hn::Load(d, lanes.cubic[0] + i);
        const V c1 = hn::Load(d, lanes.cubic[1] + i);
        const V c2 = hn::Load(d, lanes.cubic[2] + i);
        const V c3 = hn::Load(d, lanes.cubic[3] + i);
        const V a1 = hn::Mul(half, hn::Sub(c2, c0));
        const V a2 = hn::Sub(hn::Add(hn::Sub(c0, scaled(2.5, c1)), scaled(2, c2)), hn::Mul(half, c3));
        const V a3 = hn::Add(hn::Mul(half, hn::Sub(c3, c0)), scaled(1.5, hn::Sub(c1, c2)));
        V lo = hn::Load(d, lanes.from + i);
        V hi = hn::Load(d, lanes.to + i);
        const V f_lo = hn::Load(d, lanes.f_from + i);
        const V f_hi = hn::Load(d, lanes.f_to + i);
        const V width = hn::Sub(hi, lo);
        const V small = scaled(kLastStep, width);
        const auto rising = hn::Ge(f_hi, hn::Zero(d));
        V t = hn::Sub(lo, hn::Mul(f_lo, hn::Div(width, hn::Sub(f_hi, f_lo))));
        V last = width;
        auto active = hn::FirstN(d, n - i);
        for (int step = 0; step < 100; ++step) {
            const auto inside = hn::And(hn::Gt(t, lo), hn::Lt(t, hi));
            t = hn::IfThenElse(hn::Or(inside, hn::Not(active)), t,
                               hn::Add(lo, hn::Mul(half, hn::Sub(hi, lo))));
            const V f = hn::Add(hn::Mul(hn::Add(hn::Mul(hn::Add(hn::Mul(a3, t), a2), t), a1), t), c1);
            const V slope = hn::Add(hn::Mul(hn::Add(hn::Mul(scaled(3, a3), t), scaled(2, a2)), t), a1);
            const auto above = hn::Not(hn::Xor(hn::Ge(f, hn::Zero(d)), rising));
            hi = hn::IfThenElse(above, t, hi);
            lo = hn::IfThenElse(above, lo, t);
            V next = hn::Sub(t, hn::Div(f, slope));
            const auto good = hn::And(hn::And(hn::Ge(next, lo), hn::Le(next, hi)),
                                      hn::Le(hn::Abs(hn::Sub(next, t)), hn::Mul(half, last)));
            next = hn::IfThenElse(good, next, hn::Add(lo, hn::Mul(half, hn::Sub(hi, lo))));
            last = hn::IfThenElse(active, hn::Abs(hn::Sub(next, t)), last);
            t = hn::IfThenElse(active, next, t);
            const auto going = hn::And(hn::Gt(last, small), hn::Gt(hn::Sub(hi, lo), hn::Set(d, 0x1p-52)));
            active = hn::And(active, going);
            if (hn::AllFalse(d, active)) break;
        }
        hn::Store(t, d, lanes.root + i);
    }
}

/// Precondition: count <= kLines; rows, base, across, lo and hi are set.
template <int a>
void lines_along(double isovalue, std::size_t first, std::size_t count, CubicLanes& lanes,
                 const AxisRoots& out) {
    constexpr int b = a == 0 ? 1 : 0;
    constexpr int c = a == 2 ? 1 : 2;
    for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
        store_each(weights_at(hn::Load(d, lanes.across[0] + i)), lanes.weights[0] + i);
        store_each(weights_at(hn::Load(d, lanes.across[1] + i)), lanes.weights[1] + i);
    }
    for (std::size_t i = 0; i < count; ++i)
        sum_samples<a>(lanes.rows[i], isovalue, lanes.weights[0][i], lanes.weights[1][i], lanes.sums[i]);

    const std::size_t n = find_changes(count, lanes);
    find_roots(n, lanes);
    for (std::size_t i = 0; i < count; ++i) {
        out.root[first + i] = std::numeric_limits<double>::quiet_NaN();
        for (double* gradient : out.gradient) gradient[first + i] = 0;
    }
    for (std::size_t i = 0; i < n; ++i) {
        lanes.at[a][i] = lanes.root[i];
        lanes.at[b][i] = lanes.across[0][lanes.line[i]];
        lanes.at[c][i] = lanes.across[1][lanes.line[i]];
    }
    for (int axis = 0; axis < 3; ++axis)
        for (std::size_t i = 0; i < n; i += hn::Lanes(d)) {
            const V t = hn::Load(d, lanes.at[axis] + i);
            store_each(weights_at(t), lanes.value[axis] + i);
            store_each(slopes_at(t), lanes.slope[axis] + i);
        }
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t line = lanes.line[i];
        double gradient[3];
        sum_gradient(lanes, lanes.rows[line], isovalue, i, gradient);
        out.root[first + line] = lanes.base[line] + lanes.root[i];
        for (std::size_t axis = 0; axis < 3; ++axis) out.gradient[axis][first + line] = gradient[axis];
    }
}

void cubics(double isovalue, std::size_t axis, std::size_t first, std::size_t count, CubicLanes& lanes,
            const AxisRoots& out) {
    if (axis == 0) return lines_along<0>(isovalue, first, count, lanes, out);
    if (axis == 1) return lines_along<1>(isovalue, first, count, lanes, out);
    lines_along<2>(isovalue, first, count, lanes, out);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include <algorithm>

#include <hwy/cache_control.h>

namespace pellucid {

HWY_EXPORT(cubics);

void CatmullRomCells::cross_along(const AxisLines& lines, const AxisRoots& out) const {
    thread_local CubicLanes lanes;
    const VolumeField& volume = field_.volume();
    const VoxelGrid& grid = volume.grid();
    const auto y = static_cast<std::ptrdiff_t>(grid.size[0]);
    const std::ptrdiff_t z = y * grid.size[1];
    const std::size_t a = lines.axis;
    const std::size_t b = a == 0 ? 1 : 0;
    const std::size_t c = a == 2 ? 1 : 2;
    for (std::size_t first = 0; first < lines.count; first += kLines) {
        const std::size_t count = std::min(kLines, lines.count - first);
        for (std::size_t i = 0; i < count; ++i) hwy::Prefetch(&cells_[lines.cell[first + i]]);
        for (std::size_t i = 0; i < count; ++i) {
            const std::array<int, 3> base = base_of(cells_[lines.cell[first + i]]);
            lanes.base[i] = base[a];
            lanes.across[0][i] = lines.at[b][first + i] - base[b];
            lanes.across[1][i] = lines.at[c][first + i] - base[c];
            lanes.lo[i] = lines.lo[first + i] - base[a];
            lanes.hi[i] = lines.hi[first + i] - base[a];
            if (volume.is_inside(base)) {
                const float* from = grid.values.data() + grid.index(base[0] - 1, base[1] - 1, base[2] - 1);
                lanes.rows[i] = {from, y, z};
                for (int k = 0; k < 4; ++k)
                    for (int j = 0; j < 4; ++j) hwy::Prefetch(from + j * y + k * z);
            } else {
                const VolumeField::Samples samples = volume.samples_around(base);
                std::copy(samples.begin(), samples.end(), lanes.border[i]);
                lanes.rows[i] = {lanes.border[i], 4, 16};
            }
        }
        HWY_DYNAMIC_DISPATCH(cubics)(field_.isovalue(), a, first, count, lanes, out);
    }
}

}  // namespace pellucid
#endif
