// The trials of triangle_throws.cpp over SIMD lanes: Highway, with the instruction set chosen at run time.
#include "sample/triangle_throws.hpp"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sample/triangle_throws_simd.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "sample/edge_lines-inl.h"
#include "sample/philox-inl.h"

#ifndef PELLUCID_SAMPLE_TRIANGLE_THROWS
#define PELLUCID_SAMPLE_TRIANGLE_THROWS
namespace pellucid {
namespace {

/// What a chunk of trials has drawn.
struct alignas(64) Throws {
    double u[kChunkRoom], v[kChunkRoom], chance[kChunkRoom];
    std::uint64_t piece[kChunkRoom];  // at first the word that chooses it
};

}  // namespace
}  // namespace pellucid
#endif

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

/// The piece of a table from one word: its top bits choose a column, the others the part.
HWY_INLINE VU pick_by_word(const AliasTable& table, VU word) {
    static_assert(sizeof(AliasTable::Column) == 8);
    const VU low = hn::Set(du, std::uint64_t{0xffffffff});
    const auto index = hn::BitCast(di, hn::ShiftRightSame(word, table.shift()));
    const auto side = hn::BitCast(di, hn::And(hn::ShiftLeftSame(word, 32 - table.shift()), low));
    const auto column = hn::GatherIndex(di, reinterpret_cast<const std::int64_t*>(table.columns().data()), index);
    const auto own = hn::And(column, hn::BitCast(di, low));
    const auto other = hn::BitCast(di, hn::ShiftRight<32>(hn::BitCast(du, column)));
    return hn::BitCast(du, hn::IfThenElse(hn::Lt(side, own), index, other));
}

void draw(const LineKeys& keys, const RoundKeys& rounds, std::uint32_t first,
          std::uint32_t count, Throws& out) {
    const VU highs[1] = {hn::Set(du, std::uint64_t{keys.block})};
    for (std::uint32_t i = 0; i < count; i += static_cast<std::uint32_t>(hn::Lanes(d))) {
        Words bits[1];
        philox(hn::Add(hn::Iota(du, first), hn::Set(du, std::uint64_t{i})), highs, keys.repeat, keys.object, rounds, bits);
        V u = unit(bits[0].w[1]);
        V v = unit(bits[0].w[2]);
        const V one = hn::Set(d, 1.0);
        const Mask beyond = hn::Gt(hn::Add(u, v), one);
        u = hn::IfThenElse(beyond, hn::Sub(one, u), u);
        v = hn::IfThenElse(beyond, hn::Sub(one, v), v);
        hn::Store(u, d, out.u + i);
        hn::Store(v, d, out.v + i);
        hn::Store(unit(bits[0].w[3]), d, out.chance + i);
        hn::Store(bits[0].w[0], du, out.piece + i);
    }
}

/// From words to pieces. Both look-ups miss the nearest cache: each is fetched ahead for all trials of the chunk.
void pick(const TriangleBlock& block, std::uint32_t count, Throws& throws) {
    const auto* columns = block.table->columns().data();
    const int shift = block.table->shift();
    for (std::uint32_t i = 0; i < count; ++i) __builtin_prefetch(columns + (throws.piece[i] >> static_cast<unsigned>(shift)));
    for (std::uint32_t i = 0; i < count; i += static_cast<std::uint32_t>(hn::Lanes(d)))
        hn::Store(pick_by_word(*block.table, hn::Load(du, throws.piece + i)), du, throws.piece + i);
    for (std::uint32_t i = 0; i < count; ++i) __builtin_prefetch(block.records + throws.piece[i]);
}

/// Two floats in lanes of 64 bits.
HWY_INLINE V low_float(VU pair) {
    constexpr hn::Rebind<float, D> df;
    return hn::PromoteTo(d, hn::BitCast(df, hn::TruncateTo(hn::Rebind<std::uint32_t, D>(), pair)));
}
HWY_INLINE V high_float(VU pair) { return low_float(hn::ShiftRight<32>(pair)); }

HWY_INLINE V3 unpack_normal(VU bits) {
    const VU low = hn::Set(du, std::uint64_t{0x1fffff});
    const VU magic = hn::Set(du, 0x4330000000000000ULL);
    const auto component = [&](VU shifted) {
        return hn::Sub(hn::BitCast(d, hn::Or(hn::And(shifted, low), magic)), hn::Set(d, 0x1p52 + 0x1p20));
    };
    return {component(bits), component(hn::ShiftRight<21>(bits)), component(hn::ShiftRight<42>(bits))};
}

/// Writes what is kept from `out` on; how many. Whole vectors are written.
std::size_t place(const TriangleBlock& block, const Throws& throws, std::uint32_t count, SourcePoint* out) {
    const LineView& view = *block.view;
    const auto all = [](double value) { return hn::Set(d, value); };
    const auto* words = reinterpret_cast<const std::int64_t*>(block.records);
    std::size_t kept = 0;
    for (std::uint32_t i = 0; i < count; i += static_cast<std::uint32_t>(hn::Lanes(d))) {
        const auto entry = hn::ShiftLeft<3>(hn::BitCast(di, hn::Load(du, throws.piece + i)));
        const auto word = [&](std::int64_t k) { return hn::BitCast(du, hn::GatherIndex(di, words + k, entry)); };
        const VU w0 = word(0), w1 = word(1), w2 = word(2), w3 = word(3), w4 = word(4);
        const V3 p{low_float(w0), high_float(w0), low_float(w1)};
        const V3 e{high_float(w1), low_float(w2), high_float(w2)};
        const V3 f{low_float(w3), high_float(w3), low_float(w4)};
        const V u = hn::Load(d, throws.u + i);
        const V v = hn::Load(d, throws.v + i);
        const auto along = [&](V from, V one, V other) { return sum3(from, hn::Mul(u, one), hn::Mul(v, other)); };
        const V3 at{along(p.x, e.x, f.x), along(p.y, e.y, f.y), hn::Add(along(p.z, e.z, f.z), all(view.near))};
        Mask alive = hn::And(hn::FirstN(d, count - i), in_view(view, at));
        if (view.perspective) {
            const V bound = high_float(w4);
            const V paid = hn::Mul(hn::Load(d, throws.chance + i), depth_cubed(view, at));
            const V most = view.constant_law ? bound : hn::Mul(bound, hn::Sqrt(distance_squared(view, at)));
            alive = hn::And(alive, hn::Lt(paid, most));
        }
        const V3 n0 = unpack_normal(word(5)), n1 = unpack_normal(word(6)), n2 = unpack_normal(word(7));
        const V w = hn::Sub(hn::Sub(all(1.0), u), v);
        const auto blend = [&](V a, V b, V c) { return sum3(hn::Mul(w, a), hn::Mul(u, b), hn::Mul(v, c)); };
        V3 n{blend(n0.x, n1.x, n2.x), blend(n0.y, n1.y, n2.y), blend(n0.z, n1.z, n2.z)};
        const V zero = hn::Zero(d);
        const Mask none = hn::And(hn::Eq(n.x, zero), hn::And(hn::Eq(n.y, zero), hn::Eq(n.z, zero)));
        if (!hn::AllFalse(d, none)) {
            const auto cross = [](V a, V b, V c, V g) { return hn::Sub(hn::Mul(a, b), hn::Mul(c, g)); };
            n = {hn::IfThenElse(none, cross(e.y, f.z, e.z, f.y), n.x), hn::IfThenElse(none, cross(e.z, f.x, e.x, f.z), n.y),
                 hn::IfThenElse(none, cross(e.x, f.y, e.y, f.x), n.z)};
        }
        alignas(64) double lanes[7][hn::MaxLanes(d)];
        hn::Store(at.x, d, lanes[0]);
        hn::Store(at.y, d, lanes[1]);
        hn::Store(at.z, d, lanes[2]);
        hn::Store(n.x, d, lanes[3]);
        hn::Store(n.y, d, lanes[4]);
        hn::Store(n.z, d, lanes[5]);
        hn::Store(hn::IfThenElseZero(alive, all(1.0)), d, lanes[6]);
        for (std::size_t lane = 0; lane < hn::Lanes(d); ++lane) {
            out[kept] = {{lanes[0][lane], lanes[1][lane], lanes[2][lane]}, {lanes[3][lane], lanes[4][lane], lanes[5][lane]}};
            kept += lanes[6][lane] != 0 ? 1U : 0U;
        }
    }
    return kept;
}

void throw_all(const TriangleBlock& block, const LineKeys& keys, std::uint32_t first, std::uint32_t count,
               std::vector<SourcePoint>& out) {
    const RoundKeys rounds(keys.seed);
    Throws throws;
    std::size_t size = out.size();
    for (std::uint32_t done = 0; done < count; done += kLineChunk) {
        const std::uint32_t n = std::min(kLineChunk, count - done);
        draw(keys, rounds, first + done, n, throws);
        pick(block, n, throws);
        out.resize(size + n + hn::Lanes(d));
        size += place(block, throws, n, out.data() + size);
    }
    out.resize(size);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {

HWY_EXPORT(throw_all);

void throw_triangles(const TriangleBlock& block, const LineKeys& keys, std::uint32_t first, std::uint32_t count,
                     std::vector<SourcePoint>& out) {
    HWY_DYNAMIC_DISPATCH(throw_all)(block, keys, first, count, out);
}

}  // namespace pellucid
#endif
