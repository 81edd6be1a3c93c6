// What trials along edges share over SIMD lanes: in view or not, kept or not, appended.
//
// A Highway header: it may be included once for every target.

#ifndef PELLUCID_SAMPLE_EDGE_LINES_PACKING
#define PELLUCID_SAMPLE_EDGE_LINES_PACKING
#include "sample/edge_lines.hpp"

namespace pellucid {
namespace {

/// The places of the set bits of a byte, in order.
constexpr std::array<std::array<std::uint8_t, 8>, 256> kPacking = [] {
    std::array<std::array<std::uint8_t, 8>, 256> table{};
    for (std::size_t bits = 0; bits < 256; ++bits) {
        std::size_t n = 0;
        for (std::size_t lane = 0; lane < 8; ++lane)
            if ((bits >> lane & 1U) != 0) table[bits][n++] = static_cast<std::uint8_t>(lane);
    }
    return table;
}();

}  // namespace
}  // namespace pellucid
#endif

#if defined(PELLUCID_SAMPLE_EDGE_LINES_INL) == defined(HWY_TARGET_TOGGLE)
#ifdef PELLUCID_SAMPLE_EDGE_LINES_INL
#undef PELLUCID_SAMPLE_EDGE_LINES_INL
#else
#define PELLUCID_SAMPLE_EDGE_LINES_INL
#endif

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<double>;
using DU = hn::RebindToUnsigned<D>;
using DI = hn::RebindToSigned<D>;
using V = hn::Vec<D>;
using VU = hn::Vec<DU>;
using Mask = hn::Mask<D>;
inline constexpr D d;
inline constexpr DU du;
inline constexpr DI di;

/// Gathers take 32-bit places for 32-bit lanes.
HWY_INLINE hn::Vec<hn::Rebind<std::int32_t, D>> short_place(hn::Vec<DI> place) {
    return hn::BitCast(hn::Rebind<std::int32_t, D>(),
                       hn::TruncateTo(hn::Rebind<std::uint32_t, D>(), hn::BitCast(du, place)));
}

struct V3 {
    V x, y, z;
};
HWY_INLINE V lerp(V a, V b, V t) { return hn::Add(a, hn::Mul(t, hn::Sub(b, a))); }
HWY_INLINE V sum3(V a, V b, V c) { return hn::Add(hn::Add(a, b), c); }
HWY_INLINE V dot3(const V3& a, const V3& b) {
    return sum3(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y), hn::Mul(a.z, b.z));
}
template <class Row>
HWY_INLINE V dot3(const Row& m, const V3& x) {
    return sum3(hn::Mul(hn::Set(d, m[0]), x.x), hn::Mul(hn::Set(d, m[1]), x.y),
                hn::Mul(hn::Set(d, m[2]), x.z));
}

HWY_INLINE Mask in_view(const LineView& view, const V3& at) {
    const V depth = view.perspective ? at.z : hn::Set(d, 1.0);
    const Mask z = hn::And(hn::Ge(at.z, hn::Set(d, view.near)), hn::Le(at.z, hn::Set(d, view.far)));
    const Mask x = hn::And(hn::Ge(at.x, hn::Mul(hn::Set(d, view.x_lo), depth)),
                           hn::Lt(at.x, hn::Mul(hn::Set(d, view.x_hi), depth)));
    const Mask y = hn::And(hn::Ge(at.y, hn::Mul(hn::Set(d, view.y_lo), depth)),
                           hn::Lt(at.y, hn::Mul(hn::Set(d, view.y_hi), depth)));
    return hn::And(z, hn::And(x, y));
}
HWY_INLINE V depth_cubed(const LineView& view, const V3& at) {
    if (!view.perspective) return hn::Set(d, 1.0);
    const V z = hn::Mul(at.z, hn::Set(d, view.depth_scale));
    return hn::Mul(hn::Mul(z, z), z);
}
HWY_INLINE V distance_squared(const LineView& view, const V3& at) {
    if (!view.perspective) return hn::Set(d, 1.0);
    return hn::Mul(dot3(at, at), hn::Set(d, view.depth_scale * view.depth_scale));
}

/// Moves the lanes of a mask to the front.
struct Packer {
    explicit HWY_INLINE Packer(Mask kept) : count(hn::CountTrue(d, kept)) {
#if HWY_TARGET != HWY_SCALAR
        // One look-up for all values: Highway 1.0 makes one a value, from a table that g++ copies each time.
        std::uint8_t bits[8];
        (void)hn::StoreMaskBits(d, kept, bits);
        const auto places = hn::LoadU(hn::Rebind<std::uint8_t, D>(), kPacking[bits[0]].data());
        order = hn::IndicesFromVec(d, hn::PromoteTo(du, hn::PromoteTo(hn::Rebind<std::uint32_t, D>(), places)));
#endif
    }
    HWY_INLINE V operator()(V value) const {
#if HWY_TARGET == HWY_SCALAR
        return value;
#else
        return hn::TableLookupLanes(value, order);
#endif
    }
    HWY_INLINE VU operator()(VU value) const { return hn::BitCast(du, (*this)(hn::BitCast(d, value))); }

    std::size_t count;
#if HWY_TARGET != HWY_SCALAR
    decltype(hn::IndicesFromVec(d, hn::Zero(du))) order;
#endif
};

/// Appends the lanes of the mask.
HWY_INLINE void append(PointChunk& out, Mask kept, const V3& view, const V3& normal, const V3& place,
                       VU piece, VU line) {
    const std::size_t n = out.count;
    const Packer packed(kept);
    const auto put = [&](V value, double* to) { hn::StoreU(packed(value), d, to + n); };
    put(view.x, out.view[0]);
    put(view.y, out.view[1]);
    put(view.z, out.view[2]);
    put(normal.x, out.normal[0]);
    put(normal.y, out.normal[1]);
    put(normal.z, out.normal[2]);
    put(place.x, out.place[0]);
    put(place.y, out.place[1]);
    put(place.z, out.place[2]);
    const auto put_word = [&](VU value, std::uint64_t* to) {
        hn::StoreU(packed(value), du, to + n);
    };
    put_word(piece, out.piece);
    put_word(line, out.line);
    out.count += packed.count;
}

/// Places x in view, decides and appends.
HWY_INLINE void keep(const LineView& view, const V3& x, const V3& g, const V3& reach, V bound, V chance,
                     Mask alive, VU piece, VU line, PointChunk& out) {
    const auto place = [&](std::size_t k) {
        return hn::Add(dot3(view.to_view[k], x), hn::Set(d, view.to_view[k][3]));
    };
    const V3 at{place(0), place(1), place(2)};
    alive = hn::And(alive, in_view(view, at));
    const V sum =
        sum3(hn::Mul(reach.x, hn::Abs(g.x)), hn::Mul(reach.y, hn::Abs(g.y)), hn::Mul(reach.z, hn::Abs(g.z)));
    const V paid = hn::Mul(chance, hn::Mul(depth_cubed(view, at), sum));
    const V3 normal{dot3(view.normal[0], g), dot3(view.normal[1], g), dot3(view.normal[2], g)};
    if (view.constant_law) {
        V3 rho{hn::Set(d, view.eye[0]), hn::Set(d, view.eye[1]), hn::Set(d, view.eye[2])};
        if (view.perspective) rho = {hn::Sub(x.x, rho.x), hn::Sub(x.y, rho.y), hn::Sub(x.z, rho.z)};
        alive = hn::And(alive, hn::Lt(paid, hn::Mul(bound, hn::Abs(dot3(g, rho)))));
    } else {
        const V size = hn::Sqrt(hn::Mul(dot3(normal, normal), distance_squared(view, at)));
        alive = hn::And(alive, hn::Lt(paid, hn::Mul(bound, size)));
    }
    append(out, alive, at, normal, x, piece, line);
}

/// From coordinates along (axis, next, after that) to (x, y, z).
template <int axis>
HWY_INLINE V3 turned(V a, V b, V c) {
    if (axis == 0) return {a, b, c};
    if (axis == 1) return {c, a, b};
    return {b, c, a};
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#endif
