// The trials of edge_lines.cpp over SIMD lanes: Highway, with the instruction set chosen at run time.
#include "sample/edge_lines.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sample/edge_lines_simd.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "sample/edge_lines-inl.h"
#include "sample/philox-inl.h"

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

/// The piece of a table, from the words of the second block.
HWY_INLINE VU pick(const AliasTable& table, const Words& words) {
    static_assert(sizeof(AliasTable::Column) == 8);
    const auto index = hn::BitCast(di, hn::ShiftRightSame(words.w[0], table.shift()));
    const auto* columns = reinterpret_cast<const std::int64_t*>(table.columns().data());
    const auto column = hn::GatherIndex(di, columns, index);
    const auto own = hn::And(column, hn::Set(di, std::int64_t{0xffffffff}));
    const auto other = hn::BitCast(di, hn::ShiftRight<32>(hn::BitCast(du, column)));
    return hn::BitCast(du, hn::IfThenElse(hn::Lt(hn::BitCast(di, words.w[1]), own), index, other));
}

template <std::size_t blocks>
void draw_words_of(const LineKeys& keys, const AliasTable* table, std::uint32_t first, std::uint32_t count,
                   LineWords& out) {
    const RoundKeys rounds(keys.seed);
    for (std::uint32_t i = 0; i < count; i += static_cast<std::uint32_t>(hn::Lanes(d))) {
        Words bits[blocks];
        VU highs[blocks];
        for (std::size_t block = 0; block < blocks; ++block) highs[block] = hn::Set(du, keys.block | (block << 24U));
        philox(hn::Add(hn::Iota(du, first), hn::Set(du, std::uint64_t{i})), highs, keys.repeat, keys.object, rounds, bits);
        hn::Store(unit(bits[0].w[0]), d, out.u + i);
        hn::Store(unit(bits[0].w[1]), d, out.v + i);
        hn::Store(bits[0].w[2], du, out.choice + i);
        hn::Store(unit(bits[0].w[3]), d, out.chance + i);
        hn::Store(blocks > 1 ? pick(*table, bits[blocks - 1]) : hn::Zero(du), du, out.piece + i);
    }
}
void words_of(const LineKeys& keys, const AliasTable* table, std::uint32_t first, std::uint32_t count,
              LineWords& out) {
    if (table != nullptr) return draw_words_of<2>(keys, table, first, count, out);
    draw_words_of<1>(keys, table, first, count, out);
}

template <int a>
void boxes_along(const LineView& view, const BoxLines& lines, int label, const LineWords& words,
                 std::uint32_t count, PointChunk& out) {
    constexpr int b = (a + 1) % 3;
    constexpr int c = (a + 2) % 3;
    using Kind = BoxLines::Kind;
    const Kind kind = lines.kind;
    const auto all = [](double value) { return hn::Set(d, value); };
    const V zero = hn::Zero(d);
    const V3 reach{all(lines.reach[0]), all(lines.reach[1]), all(lines.reach[2])};
    const V one_sign = lines.negative ? all(-0.0) : zero;
    const int label_bits = lines.labels == 4 ? 2 : lines.labels == 2 ? 1 : 0;
    for (std::uint32_t i = 0; i < count; i += static_cast<std::uint32_t>(hn::Lanes(d))) {
        const VU line = hn::Iota(du, i);
        const V xb = hn::Add(all(lines.lo[b]), hn::Mul(hn::Load(d, words.u + i), all(lines.size[b])));
        const V xc = hn::Add(all(lines.lo[c]), hn::Mul(hn::Load(d, words.v + i), all(lines.size[c])));
        const VU which = label < 0 ? hn::ShiftRightSame(hn::Load(du, words.choice + i), 32 - label_bits)
                                   : hn::Set(du, static_cast<std::uint64_t>(label));
        V chance = hn::Load(d, words.chance + i);
        if (label > 0) {
            chance = hn::Add(chance, all(static_cast<double>(label) / lines.labels));
            chance = hn::IfThenElse(hn::Lt(chance, all(1.0)), chance, hn::Sub(chance, all(1.0)));
        }
        Mask alive = hn::FirstN(d, count - i);

        V square = zero;
        V rho = zero;
        V beyond = zero;
        if (kind == Kind::plane || kind == Kind::quadric) {
            const auto term = [&](std::size_t k, V x) {
                return hn::Mul(hn::Add(hn::Mul(all(lines.square[k]), x), all(lines.linear[k])), x);
            };
            square = hn::Mul(sum3(term(b, xb), term(c, xc), all(lines.constant)), all(lines.inverse));
        } else if (kind == Kind::torus_along) {
            rho = hn::Sqrt(hn::Add(hn::Mul(xb, xb), hn::Mul(xc, xc)));
            beyond = hn::Sub(rho, all(lines.major));
            square = hn::Mul(hn::Sub(all(lines.minor), beyond), hn::Add(all(lines.minor), beyond));
        } else {
            const V z = a == 0 ? xc : xb;
            const V y = a == 0 ? xb : xc;
            const V ring = hn::Sqrt(hn::Mul(hn::Sub(all(lines.minor), z), hn::Add(all(lines.minor), z)));
            const VU inner = lines.both_rings ? (lines.both_signs ? hn::ShiftRight<1>(which) : which)
                                              : hn::Set(du, std::uint64_t{lines.inner ? 1U : 0U});
            beyond = hn::Xor(ring, hn::BitCast(d, hn::ShiftLeft<63>(inner)));
            rho = hn::Add(all(lines.major), beyond);
            alive = hn::And(alive, hn::Ge(rho, zero));
            square = hn::Mul(hn::Sub(rho, y), hn::Add(rho, y));
        }
        V root = square;
        if (kind != Kind::plane) {
            alive = hn::And(alive, hn::Gt(square, zero));
            const V sign = lines.both_signs ? hn::BitCast(d, hn::ShiftLeft<63>(which)) : one_sign;
            root = hn::Xor(hn::Sqrt(square), sign);
        }
        alive = hn::And(alive, hn::And(hn::Ge(root, all(lines.root_lo)), hn::Lt(root, all(lines.root_hi))));
        if (hn::AllFalse(d, alive)) continue;
        const V3 x = turned<a>(root, xb, xc);
        V3 g;
        if (kind == Kind::plane || kind == Kind::quadric) {
            const auto slope = [&](std::size_t k, V at) {
                return hn::Add(hn::Mul(all(2 * lines.square[k]), at), all(lines.linear[k]));
            };
            g = {slope(0, x.x), slope(1, x.y), slope(2, x.z)};
        } else {
            g = {hn::Mul(x.x, beyond), hn::Mul(x.y, beyond), hn::Mul(x.z, rho)};
        }
        keep(view, x, g, reach, all(lines.bound), chance, alive, hn::Zero(du), line, out);
    }
}

template <int a>
void cells_along(const LineView& view, const CellBlock& block, const LineWords& words, std::uint32_t count,
                 PointChunk& out) {
    constexpr hn::Rebind<float, D> df;
    constexpr hn::Rebind<std::int32_t, D> di32;
    constexpr int eb = 1 << (a + 1) % 3;
    constexpr int ec = 1 << (a + 2) % 3;
    constexpr int ea = 1 << a;
    constexpr int kFloatBits = 4;
    static_assert(sizeof(CellRecord) == sizeof(float) << kFloatBits);
    const auto all = [](double value) { return hn::Set(d, value); };
    const V zero = hn::Zero(d);
    const V isovalue = all(block.isovalue);
    const auto* corners = reinterpret_cast<const float*>(block.cells);
    const auto* bases = reinterpret_cast<const std::int32_t*>(block.cells) + 8;
    const auto* bounds = reinterpret_cast<const double*>(block.cells) + 6;
    const auto signs_differ = [&](V f0, V f1) { return hn::Xor(hn::Ge(f0, zero), hn::Ge(f1, zero)); };
    for (std::uint32_t i = 0; i < count; i += static_cast<std::uint32_t>(hn::Lanes(d))) {
        const VU line = hn::Iota(du, i);
        const auto piece = hn::BitCast(di, hn::Load(du, words.piece + i));
        const auto place = short_place(hn::ShiftLeft<kFloatBits>(piece));
        const auto f = [&](int corner) {
            return hn::Sub(hn::PromoteTo(d, hn::GatherIndex(df, corners + corner, place)), isovalue);
        };
        const V u = hn::Load(d, words.u + i);
        const V v = hn::Load(d, words.v + i);
        const V l00 = f(0), l10 = f(eb), l01 = f(ec), l11 = f(eb | ec);
        const V h00 = f(ea), h10 = f(ea | eb), h01 = f(ea | ec), h11 = f(ea | eb | ec);
        const V f0 = lerp(lerp(l00, l10, u), lerp(l01, l11, u), v);
        const V f1 = lerp(lerp(h00, h10, u), lerp(h01, h11, u), v);
        const Mask alive = hn::And(hn::FirstN(d, count - i), signs_differ(f0, f1));
        if (hn::AllFalse(d, alive)) continue;
        const V t = hn::Div(f0, hn::Sub(f0, f1));
        const V m00 = lerp(l00, h00, t), m10 = lerp(l10, h10, t), m01 = lerp(l01, h01, t),
                m11 = lerp(l11, h11, t);
        const V3 g = turned<a>(hn::Sub(f1, f0), lerp(hn::Sub(m10, m00), hn::Sub(m11, m01), v),
                               lerp(hn::Sub(m01, m00), hn::Sub(m11, m10), u));
        const auto base_at = [&](int k) { return hn::PromoteTo(d, hn::GatherIndex(di32, bases + k, place)); };
        const V3 base{base_at(0), base_at(1), base_at(2)};
        const V3 inside = turned<a>(t, u, v);
        const V3 x{hn::Add(base.x, inside.x), hn::Add(base.y, inside.y), hn::Add(base.z, inside.z)};
        V3 reach{all(view.reach[0]), all(view.reach[1]), all(view.reach[2])};
        if (view.perspective && view.constant_law) {
            const auto farthest = [&](V at, double eye) {
                const V from = all(eye);
                return hn::Max(hn::Abs(hn::Sub(at, from)), hn::Abs(hn::Sub(hn::Add(at, all(1.0)), from)));
            };
            reach = {farthest(base.x, view.eye[0]), farthest(base.y, view.eye[1]),
                     farthest(base.z, view.eye[2])};
        }
        const V bound = hn::GatherIndex(d, bounds, hn::ShiftLeft<3>(piece));
        keep(view, x, g, reach, bound, hn::Load(d, words.chance + i), alive, hn::BitCast(du, piece), line,
             out);
    }
}

void boxes(const LineView& view, const BoxLines& lines, int label, const LineWords& words,
           std::uint32_t count, PointChunk& out) {
    if (lines.axis == 0) return boxes_along<0>(view, lines, label, words, count, out);
    if (lines.axis == 1) return boxes_along<1>(view, lines, label, words, count, out);
    boxes_along<2>(view, lines, label, words, count, out);
}

void cells(const LineView& view, const CellBlock& block, const LineWords& words, std::uint32_t count,
           PointChunk& out) {
    if (block.axis == 0) return cells_along<0>(view, block, words, count, out);
    if (block.axis == 1) return cells_along<1>(view, block, words, count, out);
    cells_along<2>(view, block, words, count, out);
}

void flats(const LineView& view, const FlatBlock& block, const LineWords& words, std::uint32_t count,
           PointChunk& out) {
    const auto all = [](double value) { return hn::Set(d, value); };
    const V one = all(1.0);
    const auto* bounds = reinterpret_cast<const double*>(block.pieces) + 1;
    const auto* heads = reinterpret_cast<const std::int64_t*>(block.pieces);
    const auto low = hn::Set(di, std::int64_t{0xffffffff});
    constexpr hn::Rebind<std::int32_t, D> di32;
    const auto* triangles = reinterpret_cast<const std::int32_t*>(block.triangles);
    const V3 camera{all(view.camera_place[0]), all(view.camera_place[1]), all(view.camera_place[2])};
    for (std::uint32_t i = 0; i < count; i += static_cast<std::uint32_t>(hn::Lanes(d))) {
        const VU line = hn::Iota(du, i);
        const auto piece = hn::BitCast(di, hn::Load(du, words.piece + i));
        V u = hn::Load(d, words.u + i);
        V v = hn::Load(d, words.v + i);
        if (block.fold) {
            const Mask beyond = hn::Gt(hn::Add(u, v), one);
            u = hn::IfThenElse(beyond, hn::Sub(one, u), u);
            v = hn::IfThenElse(beyond, hn::Sub(one, v), v);
        }
        const auto entry = hn::ShiftLeft<1>(piece);
        const auto triangle = hn::And(hn::GatherIndex(di, heads, entry), low);
        const auto corner0 = hn::Add(hn::ShiftLeft<1>(triangle), triangle);
        const auto vertex = [&](std::int64_t k) {
            const auto at = short_place(hn::Add(corner0, hn::Set(di, k)));
            const auto v32 = hn::And(hn::PromoteTo(di, hn::GatherIndex(di32, triangles, at)), low);
            return hn::Add(hn::ShiftLeft<1>(v32), v32);
        };
        const auto v0 = vertex(0), v1 = vertex(1), v2 = vertex(2);
        const auto coordinate = [&](int k, V eye) {
            const V p0 = hn::GatherIndex(d, block.positions + k, v0);
            const V p1 = hn::GatherIndex(d, block.positions + k, v1);
            const V p2 = hn::GatherIndex(d, block.positions + k, v2);
            return hn::Sub(sum3(p0, hn::Mul(u, hn::Sub(p1, p0)), hn::Mul(v, hn::Sub(p2, p0))), eye);
        };
        const V3 x{coordinate(0, camera.x), coordinate(1, camera.y), coordinate(2, camera.z)};
        const V3 at{dot3(view.to_view[0], x), dot3(view.to_view[1], x), dot3(view.to_view[2], x)};
        Mask alive = hn::And(hn::FirstN(d, count - i), in_view(view, at));
        if (view.perspective) {
            const V bound = hn::GatherIndex(d, bounds, entry);
            const V paid = hn::Mul(hn::Load(d, words.chance + i), depth_cubed(view, at));
            const V most = view.constant_law ? bound : hn::Mul(bound, hn::Sqrt(distance_squared(view, at)));
            alive = hn::And(alive, hn::Lt(paid, most));
        }
        const V zero = hn::Zero(d);
        append(out, alive, at, {zero, zero, zero}, {u, v, zero}, hn::BitCast(du, piece), line);
    }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include <hwy/cache_control.h>

namespace pellucid {

HWY_EXPORT(words_of);
HWY_EXPORT(boxes);
HWY_EXPORT(cells);
HWY_EXPORT(flats);

void draw_words(const LineKeys& keys, const AliasTable* table, std::uint32_t first, std::uint32_t count,
                LineWords& out) {
    HWY_DYNAMIC_DISPATCH(words_of)(keys, table, first, count, out);
}
void cross_boxes(const LineView& view, const BoxLines& lines, int label, const LineWords& words,
                 std::uint32_t count, PointChunk& out) {
    out.count = 0;
    HWY_DYNAMIC_DISPATCH(boxes)(view, lines, label, words, count, out);
}
void cross_cells(const LineView& view, const CellBlock& block, const LineWords& words, std::uint32_t count,
                 PointChunk& out) {
    for (std::uint32_t i = 0; i < count; ++i) hwy::Prefetch(block.cells + words.piece[i]);
    out.count = 0;
    HWY_DYNAMIC_DISPATCH(cells)(view, block, words, count, out);
}
void throw_flats(const LineView& view, const FlatBlock& block, const LineWords& words, std::uint32_t count,
                 PointChunk& out) {
    // Three look-ups, each by what the one before it found: fetch ahead for all lines at once.
    const auto corners = [&](std::uint32_t i) {
        return block.triangles + std::size_t{3} * block.pieces[words.piece[i]].triangle;
    };
    for (std::uint32_t i = 0; i < count; ++i) hwy::Prefetch(block.pieces + words.piece[i]);
    for (std::uint32_t i = 0; i < count; ++i) hwy::Prefetch(corners(i));
    for (std::uint32_t i = 0; i < count; ++i)
        for (std::size_t k = 0; k < 3; ++k) hwy::Prefetch(block.positions + std::size_t{3} * corners(i)[k]);
    out.count = 0;
    HWY_DYNAMIC_DISPATCH(flats)(view, block, words, count, out);
}

}  // namespace pellucid
#endif
