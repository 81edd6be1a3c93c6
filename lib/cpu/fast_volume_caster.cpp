#include "cpu/fast_volume_caster.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/parallel.hpp"
#include "core/stopwatch.hpp"
#include "cpu/packed_volume.hpp"
#include "kernel/math_twin.h"

// The part below is compiled once for every instruction set that Highway knows.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "cpu/fast_volume_caster.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "cpu/slab_collector_simd-inl.h"
#include "cpu/twin_simd-inl.h"

#ifndef PELLUCID_FAST_VOLUME_CASTER_ONCE
#define PELLUCID_FAST_VOLUME_CASTER_ONCE
namespace pellucid {
namespace {

/// What is near a face of blocks that are skipped is looked at: beyond the rounding of places, in voxels.
constexpr float kFaceRoom = 2e-3F;
/// Optical depth that stands for what blocks.
constexpr float kBlocks = 1e6F;

/// More go the plain way.
constexpr std::size_t kMostVolumes = 16;

struct PacketLight {
    float x, y, z, intensity;
    bool headlight;
};

/// A volume and what all of its rays have in common.
struct FastVolume {
    FastVolume(const PreparedScene& scene, const VolumeObject& volume, const CastSettings& settings)
        : packed(volume, settings.skip),
          exact(scene, volume, {.step = settings.step, .skip = false}),
          steps(static_cast<float>(std::min(settings.step / volume.opacity_step(), 1e30))) {
        const Shading& s = volume.settings().shading;
        lit = !s.flat;
        ambient = static_cast<float>(s.ambient);
        diffuse = static_cast<float>(s.diffuse);
        specular = static_cast<float>(s.specular);
        shininess = static_cast<float>(s.shininess);
        for (const Light& light : scene.settings.lights)
            lights.push_back({static_cast<float>(light.direction.x), static_cast<float>(light.direction.y),
                              static_cast<float>(light.direction.z), static_cast<float>(light.intensity),
                              light.headlight});
        // −∇f in the world, of any length.
        double largest = 0;
        std::array<Vec3, 3> columns;
        for (int a = 0; a < 3; ++a) {
            Vec3 unit(0.0);
            unit[a] = -1;
            columns[static_cast<std::size_t>(a)] = volume.to_world().normal(unit);
            for (int c = 0; c < 3; ++c)
                largest = std::max(largest, std::abs(columns[static_cast<std::size_t>(a)][c]));
        }
        for (std::size_t a = 0; a < 3; ++a)
            for (int c = 0; c < 3; ++c)
                normal[static_cast<std::size_t>(c)][a] = static_cast<float>(columns[a][c] / largest);
    }

    PackedVolume packed;
    VolumeCaster exact;  // for where rays come in and go out
    float steps;         // opacity steps in a step
    bool lit;
    float ambient, diffuse, specular, shininess;
    std::vector<PacketLight> lights;
    std::array<std::array<float, 3>, 3> normal;  // rows
};

/// Rays of a packet in one volume: at u steps after the packet's first they are at p + u·d, in samples.
struct PacketInVolume {
    alignas(64) PacketRow u_in, u_out;  // u_in >= u_out: misses it
    alignas(64) std::array<PacketRow, 3> p, d;
};
struct Packet {
    std::int64_t first;                              // number of the step
    std::vector<PacketInVolume> in;                  // by volume
    alignas(64) PacketRow last;                      // u where a ray has left all volumes
    alignas(64) std::array<PacketRow, 3> to_viewer;  // unit vectors
    alignas(64) PacketRow z, dt;                     // depth is z + u·dt
    std::array<double, kPacketRays> dt_exact;
    std::array<std::vector<DepthLayer>, kPacketRays> layers;  // surfaces
    bool has_layers = false;
    std::vector<std::array<VolumeCaster::Progress, kPacketRays>> progress;  // scratch
};
/// What has been gathered: associated colour, transmittance, and u where something was seen first.
struct PacketSums {
    alignas(64) std::array<PacketRow, 3> color;
    alignas(64) PacketRow clear, u;
};
using PacketSlabs = FastVolumeCaster::PacketSlabs;

struct PacketSettings {
    SlabMixing mixing;
    bool skip;
    float least_clear;  // a ray ends where what passes is not more
};

}  // namespace
}  // namespace pellucid
#endif

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

using W = hn::Vec<I>;
using M = hn::Mask<F>;
static_assert(hn::MaxLanes(F()) <= kPacketRays && kPacketRays % hn::MaxLanes(F()) == 0);

[[nodiscard]] HWY_INLINE V load(const PacketRow& row, std::size_t ray) {
    return hn::Load(F(), row.data() + ray);
}
HWY_INLINE void store(V value, PacketRow& row, std::size_t ray) {
    hn::Store(value, F(), row.data() + ray);
}
[[nodiscard]] HWY_INLINE W whole(int value) {
    return hn::Set(I(), value);
}
[[nodiscard]] HWY_INLINE V clamp(V value, V lo, V hi) {
    return hn::Min(hn::Max(value, lo), hi);
}

// ---- Samples ----------------------------------------------------------------------------------

/// Four bytes each, at any address.
[[nodiscard]] HWY_INLINE hn::Vec<U> gather(const std::uint8_t* data, W offset) {
#if HWY_TARGET <= HWY_AVX2  // better targets have smaller numbers
    return hn::GatherOffset(U(), reinterpret_cast<const std::uint32_t*>(data), offset);
#else
    alignas(64) std::array<std::int32_t, kPacketRays> at;
    alignas(64) std::array<std::uint32_t, kPacketRays> out;
    hn::Store(offset, I(), at.data());
    for (std::size_t i = 0; i < hn::Lanes(I()); ++i) std::memcpy(&out[i], data + at[i], 4);
    return hn::Load(U(), out.data());
#endif
}

/// A cell's samples: at the low end along x, and what the high end adds. [0] at (y, z), [1] at y + 1, [2] at
/// z + 1, [3] at both.
struct Cell {
    std::array<V, 4> low, more;
    V3 at;  // within the cell
};

HWY_INLINE Cell cell_at(const PackedVolume& volume, const V3& index) {
    const auto cell = [&](V place, std::size_t axis) {
        return hn::Min(hn::ConvertTo(I(), place), whole(volume.last_cell[axis]));
    };
    const W i = cell(index.x, 0), j = cell(index.y, 1), k = cell(index.z, 2);
    Cell c;
    c.at = {hn::Sub(index.x, hn::ConvertTo(F(), i)), hn::Sub(index.y, hn::ConvertTo(F(), j)),
            hn::Sub(index.z, hn::ConvertTo(F(), k))};
    W offset = hn::Add(hn::Add(hn::Mul(i, whole(volume.step[0])), hn::Mul(j, whole(volume.step[1]))),
                       hn::Mul(k, whole(volume.step[2])));
    const std::array<W, 4> corner{whole(0), whole(volume.step[1]), whole(volume.step[2]),
                                  whole(volume.step[1] + volume.step[2])};
    if (volume.kind == PackedVolume::Kind::floats) {
        for (std::size_t n = 0; n < 4; ++n) {
            const W here = hn::Add(offset, corner[n]);
            c.low[n] = hn::BitCast(F(), gather(volume.data, here));
            c.more[n] = hn::Sub(hn::BitCast(F(), gather(volume.data + 4, here)), c.low[n]);
        }
        return c;
    }
    offset = hn::Add(offset, hn::Mul(hn::ShiftRight<3>(i), whole(volume.jump[0])));
    offset = hn::Add(offset, hn::Mul(hn::ShiftRight<3>(j), whole(volume.jump[1])));
    offset = hn::Add(offset, hn::Mul(hn::ShiftRight<3>(k), whole(volume.jump[2])));
    const bool bytes = volume.kind == PackedVolume::Kind::bytes;
    for (std::size_t n = 0; n < 4; ++n) {
        const auto both = gather(volume.data, hn::Add(offset, corner[n]));
        const auto mask = hn::Set(U(), bytes ? 255U : 65535U);
        const auto lo = hn::And(both, mask);
        const auto hi = bytes ? hn::And(hn::ShiftRight<8>(both), mask) : hn::ShiftRight<16>(both);
        c.low[n] = hn::ConvertTo(F(), hn::BitCast(I(), lo));
        c.more[n] = hn::ConvertTo(F(), hn::BitCast(I(), hn::Sub(hi, lo)));
    }
    return c;
}

/// By differences: where all samples are equal, exactly their value.
[[nodiscard]] HWY_INLINE V between(V a, V b, V share) {
    return add_product(a, share, hn::Sub(b, a));
}

[[nodiscard]] HWY_INLINE V value_of(const Cell& c) {
    const V a = add_product(c.low[0], c.at.x, c.more[0]), b = add_product(c.low[1], c.at.x, c.more[1]);
    const V d = add_product(c.low[2], c.at.x, c.more[2]), e = add_product(c.low[3], c.at.x, c.more[3]);
    return between(between(a, b, c.at.y), between(d, e, c.at.y), c.at.z);
}
[[nodiscard]] HWY_INLINE V3 gradient_of(const Cell& c) {
    const V a = add_product(c.low[0], c.at.x, c.more[0]), b = add_product(c.low[1], c.at.x, c.more[1]);
    const V d = add_product(c.low[2], c.at.x, c.more[2]), e = add_product(c.low[3], c.at.x, c.more[3]);
    const V near = hn::Sub(b, a), far = hn::Sub(e, d);
    return {between(between(c.more[0], c.more[1], c.at.y), between(c.more[2], c.more[3], c.at.y), c.at.z),
            between(near, far, c.at.z), hn::Sub(between(d, e, c.at.y), between(a, b, c.at.y))};
}

// ---- Transfer function ------------------------------------------------------------------------

/// Entries of tables by the number of each ray's piece: by permutation where a table fits into four vectors (64 pieces with
/// AVX-512), else from memory.
class Entries {
public:
    HWY_INLINE Entries(std::uint32_t count, W piece)
        : piece_(piece),
          rows_((count + lanes() - 1) / lanes()),
          lane_(hn::IndicesFromVec(F(), hn::And(piece, whole(static_cast<int>(lanes()) - 1)))) {
        if (rows_ > 1 && rows_ <= kMostRows) {
            const auto from = [&](int row) {
                return hn::RebindMask(F(), hn::Gt(piece, whole(row * static_cast<int>(lanes()) - 1)));
            };
            second_ = from(1);
            third_ = from(2);
            fourth_ = from(3);
        }
    }
    [[nodiscard]] HWY_INLINE V operator()(const std::vector<float>& table) const {
        if (HWY_UNLIKELY(rows_ > kMostRows))
            return hn::BitCast(F(), gather(reinterpret_cast<const std::uint8_t*>(table.data()), hn::ShiftLeft<2>(piece_)));
        const auto row = [&](std::size_t number) {
            return hn::TableLookupLanes(hn::LoadU(F(), table.data() + number * lanes()), lane_);
        };
        V entry = row(0);
        if (rows_ == 1) return entry;
        entry = hn::IfThenElse(second_, row(1), entry);
        if (rows_ == 2) return entry;
        entry = hn::IfThenElse(third_, row(2), entry);
        return rows_ == 3 ? entry : hn::IfThenElse(fourth_, row(3), entry);
    }

private:
    static constexpr std::size_t kMostRows = 4;
    [[nodiscard]] static HWY_INLINE std::size_t lanes() { return hn::Lanes(F()); }
    W piece_;
    std::size_t rows_;
    decltype(hn::IndicesFromVec(F(), W())) lane_;
    M second_, third_, fourth_;
};

/// The piece in which each value lies: how many of the others begin at or below.
[[nodiscard]] HWY_INLINE W piece_of(const PackedTransfer& t, V value) {
    W piece = whole(0);
    for (std::uint32_t k = 1; k < t.count; ++k)
        piece = hn::Sub(piece, hn::VecFromMask(I(), hn::RebindMask(I(), hn::Ge(value, set(t.begin[k])))));
    return piece;
}

/// −ln(1 − α) for α going linearly, and what of colour's change is added to its middle by that weight.
struct PieceDepth {
    V mean, skew;
};

/// For |r| > ½ the series is short of digits: cpu/preintegration.cpp has the closed forms.
HWY_NOINLINE void steep_depth(V r, V middle, PieceDepth& out) {
    const M steep = hn::Gt(hn::Abs(r), set(0.5F));
    const V size = hn::Min(hn::Abs(r), set(1.0F));
    constexpr float kLn2 = 0.693147181F;
    const V up = hn::Mul(set(kLn2), quick_log2(hn::Add(set(1.0F), size)));
    const V rest = hn::Max(hn::Sub(set(1.0F), size), set(1e-30F));
    const V down = hn::Mul(set(kLn2), quick_log2(rest));
    const V whole_part = hn::Sub(hn::Mul(hn::Add(set(1.0F), size), up), hn::Mul(rest, down));
    const V safe = hn::Max(size, set(0.5F));
    const V mean = hn::Add(hn::Sub(middle, hn::Div(hn::Mul(set(0.5F), whole_part), safe)), set(1.0F));
    const V inverse = hn::Div(set(1.0F), safe);
    const V odd =
        hn::Mul(hn::Mul(set(0.5F), hn::Sub(set(1.0F), hn::Mul(inverse, inverse))), hn::Sub(up, down));
    const V skew = hn::Mul(set(-0.25F), hn::Add(odd, inverse));
    out.mean = hn::IfThenElse(steep, mean, out.mean);
    out.skew = hn::IfThenElse(steep, with_sign_of(hn::Abs(skew), hn::Neg(r)), out.skew);
}

[[nodiscard]] HWY_INLINE PieceDepth depth_of(V a0, V a1) {
    const V middle = hn::Mul(set(0.5F), hn::Add(a0, a1));
    const V m = hn::Max(hn::Sub(set(1.0F), middle), set(1e-30F));
    const V lost = hn::Sub(hn::Sub(set(1.0F), m), middle);  // 1 − middle = m + lost
    const V inverse = hn::Div(set(1.0F), m);
    const V r = clamp(hn::Mul(hn::Mul(set(0.5F), hn::Sub(a0, a1)), inverse), set(-1.0F), set(1.0F));
    const V log_middle = hn::Neg(add_product(hn::Mul(lost, inverse), set(0.693147181F), quick_log2(m)));
    const V r2 = hn::Mul(r, r);
    const auto series = [&](float c0, float c1, float c2, float c3, float c4) {
        V sum = add_product(set(c3), r2, set(c4));
        sum = add_product(set(c2), r2, sum);
        sum = add_product(set(c1), r2, sum);
        return add_product(set(c0), r2, sum);
    };
    PieceDepth out;
    out.mean = add_product(log_middle, r2, series(1.0F / 6, 1.0F / 20, 1.0F / 42, 1.0F / 72, 1.0F / 110));
    out.skew = hn::Mul(hn::Mul(set(-0.5F), r), series(1.0F / 3, 1.0F / 15, 1.0F / 35, 1.0F / 63, 1.0F / 99));
    if (HWY_UNLIKELY(!hn::AllFalse(F(), hn::Gt(hn::Abs(r), set(0.5F))))) steep_depth(r, log_middle, out);
    return out;
}

/// 1 − e^(−depth) to full relative precision, depth >= 0.
[[nodiscard]] HWY_INLINE V opacity_of(V depth) {
    const V t = hn::Max(hn::Mul(depth, set(-1.44269504F)), set(-126.0F));
    const auto n = hn::Sub(hn::BitCast(I(), hn::Add(t, set(12582912.0F))), hn::Set(I(), 0x4b400000));
    const V r = hn::Sub(t, hn::ConvertTo(F(), n));
    // 2^r − 1 by the polynomial of quick_exp2.
    const V r2 = hn::Mul(r, r);
    const V high = add_product(set(0.00961848907F), r, set(0.00133999309F));
    const V tail = add_product(add_product(set(0.0555032864F), r, high), hn::Mul(r2, r), set(0.00015345811F));
    const V p = hn::Mul(r, add_product(add_product(set(0.693147182F), r, set(0.240226462F)), r2, tail));
    const V power = hn::BitCast(F(), hn::ShiftLeft<23>(hn::Add(n, whole(127))));
    return hn::Sub(hn::Sub(set(1.0F), power), hn::Mul(power, p));
}

/// A step: optical depth, opacity, straight colour times opacity.
struct StepLook {
    V depth, opacity;
    V3 color;
};

/// Where colour changes evenly along a part, what is seen of it stands by this share of the part behind its
/// middle: for opacity that changes, skew/mean; for what attenuates on the way, 1/τ − 1/(e^τ − 1) − ½ to
/// 0.02, and to 2e-3 up to a depth of 2.
[[nodiscard]] HWY_INLINE V color_shift(const PieceDepth& piece, V depth) {
    const V thin = add_product(set(12.0F), set(0.2F), hn::Mul(depth, depth));
    const V mean = hn::Max(piece.mean, set(1e-30F));
    V shift = hn::Div(hn::Sub(hn::Mul(piece.skew, thin), hn::Mul(depth, mean)), hn::Mul(mean, thin));
    const M thick = hn::Gt(depth, set(5.0F));
    if (HWY_UNLIKELY(!hn::AllFalse(F(), thick))) {
        const V front = hn::Sub(hn::Div(set(1.0F), depth), set(0.5F));
        shift = hn::IfThenElse(thick, hn::Add(hn::Div(piece.skew, mean), front), shift);
    }
    return clamp(shift, set(-0.5F), set(0.5F));
}

/// Pre-integration between two values, as cpu/preintegration.hpp; `piece` is that of `from` and becomes that
/// of `to`. `steps`: opacity steps in it.
HWY_INLINE StepLook preintegrate(const PackedTransfer& t, V from, V to, V steps, M inside, W& piece) {
    StepLook look{set(0), set(0), {set(0), set(0), set(0)}};
    M active = hn::And(inside, hn::And(hn::Eq(from, from), hn::Eq(to, to)));
    V at = from;
    V clear = set(1.0F);
    const V change = hn::Sub(to, from);
    for (bool one_piece = true;; one_piece = false) {
        const Entries entry(t.count, piece);
        const V begin = entry(t.begin), end_of = entry(t.end);
        const V end = clamp(to, begin, end_of);
        const M beyond = hn::Ge(to, end_of), before = hn::Lt(to, begin);
        const M go_on = hn::And(active, hn::Or(beyond, before));
        const V base = entry(t.base);
        const V opacity = entry(t.opacity);
        const V slope = entry(t.opacity_slope);
        const V x0 = hn::Sub(at, base), x1 = hn::Sub(end, base);
        const V a0 = clamp(add_product(opacity, slope, x0), set(0), set(1.0F));
        const V a1 = clamp(add_product(opacity, slope, x1), set(0), set(1.0F));
        const bool last = hn::AllFalse(F(), go_on);
        V share = set(1.0F);
        if (!one_piece || !last)
            share = hn::IfThenElse(hn::Eq(change, set(0)), share, hn::Div(hn::Sub(end, at), change));
        const M seen = hn::And(active, hn::And(hn::Gt(hn::Add(a0, a1), set(0)), hn::Gt(share, set(0))));
        if (!hn::AllFalse(F(), seen)) {
            const PieceDepth piece_depth = depth_of(a0, a1);
            V depth = hn::Mul(hn::Mul(piece_depth.mean, steps), share);
            V middle = hn::Mul(set(0.5F), hn::Add(x0, x1));
            middle = add_product(middle, color_shift(piece_depth, depth), hn::Sub(x1, x0));
            if (t.ever_opaque) {
                const M blocks = hn::Ge(hn::Min(a0, a1), set(1.0F));
                depth = hn::IfThenElse(blocks, set(kBlocks), depth);
                middle = hn::IfThenElse(blocks, x0, middle);
            }
            depth = hn::IfThenElseZero(seen, hn::Min(depth, set(kBlocks)));
            const V alpha = opacity_of(depth);
            const V weight = hn::Mul(clear, alpha);
            const auto channel = [&](std::size_t c) {
                return hn::Mul(weight, add_product(entry(t.color[c]), middle, entry(t.color_slope[c])));
            };
            const auto nothing = hn::Not(seen);
            look.color = {hn::Add(look.color.x, hn::IfThenZeroElse(nothing, channel(0))),
                          hn::Add(look.color.y, hn::IfThenZeroElse(nothing, channel(1))),
                          hn::Add(look.color.z, hn::IfThenZeroElse(nothing, channel(2)))};
            look.depth = hn::Add(look.depth, depth);
            look.opacity = hn::Add(look.opacity, weight);
            clear = hn::Mul(clear, hn::Sub(set(1.0F), alpha));
        }
        if (last) break;
        active = go_on;
        const I s;
        piece = hn::Sub(piece, hn::VecFromMask(s, hn::RebindMask(s, hn::And(go_on, beyond))));
        piece = hn::Add(piece, hn::VecFromMask(s, hn::RebindMask(s, hn::And(go_on, before))));
        at = hn::IfThenElse(go_on, end, at);
    }
    return look;
}

// ---- Shading ----------------------------------------------------------------------------------

/// rgb = color·(ambient + diffuse·Σ) + specular·Σ, of associated colours; unlit where there is no gradient.
HWY_INLINE V3 lit_color(const FastVolume& volume, const V3& color, V opacity, const V3& gradient,
                        const V3& viewer) {
    const V largest = hn::Max(hn::Max(hn::Abs(gradient.x), hn::Abs(gradient.y)), hn::Abs(gradient.z));
    const M steep = hn::Gt(largest, set(0));
    const V3 g = scaled(gradient, hn::Div(set(1.0F), hn::IfThenElse(steep, largest, set(1.0F))));
    const auto row = [&](std::size_t r) {
        const auto& m = volume.normal[r];
        return add_product(add_product(hn::Mul(set(m[0]), g.x), set(m[1]), g.y), set(m[2]), g.z);
    };
    const V3 carried{row(0), row(1), row(2)};
    const V3 n = turned_to(scaled(carried, quick_rsqrt(hn::Max(dot(carried, carried), set(1e-30F)))), viewer);
    V diffuse = set(0), specular = set(0);
    for (const PacketLight& light : volume.lights) {
        const V3 l = light.headlight ? viewer : V3{set(light.x), set(light.y), set(light.z)};
        diffuse = add_product(diffuse, set(light.intensity), hn::Max(set(0), dot(n, l)));
        if (volume.specular == 0) continue;
        const V3 h{hn::Add(l.x, viewer.x), hn::Add(l.y, viewer.y), hn::Add(l.z, viewer.z)};
        const V product = hn::Mul(dot(n, h), quick_rsqrt(hn::Max(dot(h, h), set(1e-30F))));
        const V n_h = hn::Min(hn::Max(product, set(0)), set(1.0F));
        specular = add_product(specular, set(light.intensity),
                               power_of(n_h, volume.shininess, power_exponent(n_h, volume.shininess)));
    }
    const V all = add_product(set(volume.ambient), set(volume.diffuse), diffuse);
    const V highlight = hn::Mul(opacity, hn::Mul(set(volume.specular), specular));
    const auto channel = [&](V c) { return hn::IfThenElse(steep, add_product(highlight, c, all), c); };
    return {channel(color.x), channel(color.y), channel(color.z)};
}

// ---- One volume along some rays ---------------------------------------------------------------

class Walk {
public:
    HWY_INLINE void begin(const FastVolume& volume, const PacketInVolume& in, std::size_t ray) {
        volume_ = &volume;
        p_ = {load(in.p[0], ray), load(in.p[1], ray), load(in.p[2], ray)};
        d_ = {load(in.d[0], ray), load(in.d[1], ray), load(in.d[2], ray)};
        u_in_ = load(in.u_in, ray);
        u_out_ = load(in.u_out, ray);
    }

    /// Before step i, wherever the rays were before.
    HWY_INLINE void prime(V i) {
        u_ = clamp(i, u_in_, u_out_);
        value_ = value_at(u_);
        piece_ = piece_of(volume_->packed.transfer, value_);
    }
    /// prime() for whole steps, whose samples are read one step ahead: memory answers while a step is looked at.
    HWY_INLINE void prime_ahead(float i) {
        prime(set(i));
        next_value_ = value_at(clamp(set(i + 1), u_in_, u_out_));
    }
    /// Of those that are `alive`, on to u = `target`.
    HWY_INLINE StepLook step(V target, M alive, const V3& viewer) {
        const V u = clamp(target, u_in_, u_out_);
        return advance(u, value_at(u), alive, viewer);
    }
    /// From i to i + 1, after prime_ahead(i) or step_ahead(i - 1).
    HWY_INLINE StepLook step_ahead(float i, M alive, const V3& viewer) {
        const V value = next_value_;
        next_value_ = value_at(clamp(set(i + 2), u_in_, u_out_));
        return advance(clamp(set(i + 1), u_in_, u_out_), value, alive, viewer);
    }
    /// The first step from i on in which any of the rays that are `alive` may see something; kNever.
    HWY_INLINE float next_step(V i, M alive) const {
        const PackedVolume& volume = volume_->packed;
        const V u = clamp(i, u_in_, u_out_);
        const M here = hn::And(alive, hn::And(hn::Lt(u_in_, u_out_), hn::Lt(u, u_out_)));
        if (hn::AllFalse(F(), here)) return kNever;
        const EmptySpace& space = volume.space;
        if (space.distance().empty())
            return hn::GetLane(hn::MinOfLanes(F(), hn::IfThenElse(here, hn::Floor(u), set(kNever))));
        if (!space.anything()) return kNever;
        const V3 at = index(u);
        const auto block = [&](V place, std::size_t axis) {
            return hn::Min(hn::ShiftRight<3>(hn::ConvertTo(I(), place)), whole(space.blocks()[axis] - 1));
        };
        const W bx = block(at.x, 0), by = block(at.y, 1), bz = block(at.z, 2);
        const W number = hn::Add(
            bx, hn::Mul(whole(space.blocks()[0]), hn::Add(by, hn::Mul(whole(space.blocks()[1]), bz))));
        const W away = hn::BitCast(I(), hn::And(gather(space.distance().data(), number), hn::Set(U(), 255U)));
        const M empty = hn::RebindMask(F(), hn::Gt(away, whole(0)));
        // Along each axis the face of the cube of empty blocks through which a ray leaves, a hair before it.
        V end = set(kNever);
        const auto leave = [&](W b, V p, V d) {
            const V up = hn::Sub(hn::ConvertTo(F(), hn::ShiftLeft<3>(hn::Add(b, away))), set(kFaceRoom));
            const V down = hn::Add(hn::ConvertTo(F(), hn::ShiftLeft<3>(hn::Add(hn::Sub(b, away), whole(1)))),
                                   set(kFaceRoom));
            const V face = hn::IfThenElse(hn::Gt(d, set(0)), up, down);
            const V meet = hn::Div(hn::Sub(face, p), d);
            end = hn::IfThenElse(hn::Eq(d, set(0)), end, hn::Min(end, meet));
        };
        leave(bx, p_.x, d_.x);
        leave(by, p_.y, d_.y);
        leave(bz, p_.z, d_.z);
        const V after = hn::Floor(hn::Max(u, end));
        const V target =
            hn::IfThenElse(empty, hn::IfThenElse(hn::Ge(end, u_out_), set(kNever), after), hn::Floor(u));
        return hn::GetLane(hn::MinOfLanes(F(), hn::IfThenElse(here, target, set(kNever))));
    }
    static constexpr float kNever = 1e9F;

    /// Of the last step.
    [[nodiscard]] HWY_INLINE V front() const { return begin_; }
    [[nodiscard]] HWY_INLINE V back() const { return u_; }

private:
    [[nodiscard]] HWY_INLINE V value_at(V u) const { return value_of(cell_at(volume_->packed, index(u))); }
    HWY_INLINE StepLook advance(V u, V value, M alive, const V3& viewer) {
        const V share = hn::Sub(u, u_);
        const M inside = hn::And(alive, hn::Gt(share, set(0)));
        W piece = piece_;
        StepLook look = preintegrate(volume_->packed.transfer, value_, value,
                                     hn::Mul(share, set(volume_->steps)), inside, piece);
        if (volume_->lit && !hn::AllFalse(F(), hn::Gt(look.opacity, set(0)))) {
            const V middle = hn::Mul(set(0.5F), hn::Add(u_, u));
            const V3 gradient = gradient_of(cell_at(volume_->packed, index(middle)));
            look.color = lit_color(*volume_, look.color, look.opacity, gradient, viewer);
        }
        // Where a ray was not looked at its piece may be another one: after numbers that are none, and before
        // it comes in.
        const M followed = hn::And(inside, hn::Eq(value_, value_));
        if (HWY_UNLIKELY(!hn::AllTrue(F(), hn::Or(followed, hn::Eq(value, value_)))))
            piece = piece_of(volume_->packed.transfer, value);
        piece_ = piece;
        begin_ = u_;
        u_ = u;
        value_ = value;
        return look;
    }
    [[nodiscard]] HWY_INLINE V3 index(V u) const {
        const auto axis = [&](V p, V d, std::size_t a) {
            return clamp(add_product(p, u, d), set(0), set(volume_->packed.last[a]));
        };
        return {axis(p_.x, d_.x, 0), axis(p_.y, d_.y, 1), axis(p_.z, d_.z, 2)};
    }

    const FastVolume* volume_;
    V3 p_, d_;
    V u_in_, u_out_;
    V u_, value_, begin_, next_value_;
    W piece_;
};

/// Lanes of the last vector of a packet that are of no ray have u_in >= u_out.
struct Rays {
    V clear, left;
    V3 viewer;
    [[nodiscard]] HWY_INLINE M alive(float least_clear, V i) const {
        return hn::And(hn::Gt(clear, set(least_clear)), hn::Lt(i, left));
    }
};

/// Along some rays of one volume: sink(seen, back, d, color, opacity, transmittance in front).
template <class Sink>
HWY_INLINE void cast_rays(const FastVolume& volume, const Packet& packet, const PacketSettings& settings,
                          std::size_t ray, Sink&& sink) {
    Walk walk;
    walk.begin(volume, packet.in[0], ray);
    Rays rays{
        set(1.0F),
        load(packet.last, ray),
        {load(packet.to_viewer[0], ray), load(packet.to_viewer[1], ray), load(packet.to_viewer[2], ray)}};
    const V z = load(packet.z, ray), dt = load(packet.dt, ray);
    bool look_ahead = true, primed = false;
    for (float i = 0;; i += 1) {
        M alive = rays.alive(settings.least_clear, set(i));
        if (hn::AllFalse(F(), alive)) break;
        if (look_ahead) {
            const float next = walk.next_step(set(i), alive);
            if (next >= Walk::kNever) break;
            if (next > i) {
                i = next;
                primed = false;
            }
        }
        if (!primed) walk.prime_ahead(i);
        primed = true;
        const StepLook look = walk.step_ahead(i, alive, rays.viewer);
        const M seen = hn::Gt(look.opacity, set(0));
        look_ahead = hn::AllFalse(F(), seen);
        if (look_ahead) continue;
        const V back = add_product(z, walk.back(), dt);
        const V front = add_product(z, walk.front(), dt);
        sink(seen, back, hn::Sub(back, front), look.color, look.opacity, rays.clear);
        rays.clear = hn::Mul(rays.clear, hn::Sub(set(1.0F), look.opacity));
    }
}

/// Slabs of one volume.
void cast_slabs(const FastVolume& volume, const Packet& packet, const PacketSettings& settings,
                PacketSlabs& out) {
    const std::size_t lanes = hn::Lanes(F());
    for (std::size_t ray = 0; ray < kPacketRays; ray += lanes)
        cast_rays(volume, packet, settings, ray, [&](M, V back, V d, const V3& color, V opacity, V) HWY_ATTR {
            alignas(64) std::array<PacketRow, 6> row;
            store(back, row[0], 0);
            store(d, row[1], 0);
            store(color.x, row[2], 0);
            store(color.y, row[3], 0);
            store(color.z, row[4], 0);
            store(opacity, row[5], 0);
            for (std::size_t k = 0; k < lanes; ++k)
                if (row[5][k] > 0)
                    out[ray + k].push_back(
                        {row[0][k], row[1][k], row[2][k], row[3][k], row[4][k], row[5][k]});
        });
}

/// The same, collected.
void collect_slabs(const FastVolume& volume, const Packet& packet, const PacketSettings& settings,
                   PacketNodes& nodes) {
    for (std::size_t ray = 0; ray < kPacketRays; ray += hn::Lanes(F())) {
        OpenSlabs open(nodes, ray);
        cast_rays(volume, packet, settings, ray,
                  [&](M seen, V back, V d, const V3& color, V opacity, V before) HWY_ATTR {
                      open.push(seen, back, d, color, opacity, before);
                  });
        open.finish();
    }
}

/// zSlab (4.1) to (4.4), and by extinction: what one volume's step adds to those before it.
class Mixture {
public:
    HWY_INLINE Mixture() {
        total_ = set(0);
        weighted_ = {total_, total_, total_};
        sum_ = {total_, total_, weighted_};
    }
    HWY_INLINE void add(const StepLook& look, SlabMixing mixing) {
        if (count_++ == 0) {
            sum_ = look;
            return;
        }
        if (count_ == 2) {
            if (mixing == SlabMixing::extinction) weighted_ = scaled(straight(sum_), sum_.depth);
            total_ = sum_.opacity;
        }
        switch (mixing) {
            case SlabMixing::average: {
                const auto channel = [&](V a, V b) {
                    const V both = add_product(hn::Mul(a, look.opacity), b, sum_.opacity);
                    return hn::Sub(hn::Add(a, b), hn::Mul(set(0.5F), both));
                };
                sum_.color = {channel(sum_.color.x, look.color.x), channel(sum_.color.y, look.color.y),
                              channel(sum_.color.z, look.color.z)};
                break;
            }
            case SlabMixing::normalised:
                sum_.color = {hn::Add(sum_.color.x, look.color.x), hn::Add(sum_.color.y, look.color.y),
                              hn::Add(sum_.color.z, look.color.z)};
                total_ = hn::Add(total_, look.opacity);
                break;
            case SlabMixing::extinction: {
                const V3 more = scaled(straight(look), look.depth);
                weighted_ = {hn::Add(weighted_.x, more.x), hn::Add(weighted_.y, more.y),
                             hn::Add(weighted_.z, more.z)};
                break;
            }
        }
        sum_.depth = hn::Add(sum_.depth, look.depth);
        sum_.opacity = hn::Sub(hn::Add(sum_.opacity, look.opacity), hn::Mul(sum_.opacity, look.opacity));
    }
    [[nodiscard]] HWY_INLINE StepLook result(SlabMixing mixing) const {
        StepLook mixed = sum_;
        if (count_ > 1 && mixing == SlabMixing::normalised)
            mixed.color = scaled(sum_.color, hn::Div(sum_.opacity, hn::Max(total_, set(1e-30F))));
        if (count_ > 1 && mixing == SlabMixing::extinction)
            mixed.color = scaled(weighted_, hn::Div(sum_.opacity, hn::Max(sum_.depth, set(1e-30F))));
        return mixed;
    }
    [[nodiscard]] bool empty() const { return count_ == 0; }

private:
    [[nodiscard]] static HWY_INLINE V3 straight(const StepLook& look) {
        return scaled(look.color, hn::Div(set(1.0F), hn::Max(look.opacity, set(1e-30F))));
    }
    int count_ = 0;
    StepLook sum_;
    V3 weighted_;
    V total_;
};

/// The next surface of each ray.
struct NextLayers {
    alignas(64) PacketRow u;
    alignas(64) std::array<PacketRow, 4> rgba;
    std::array<std::size_t, kPacketRays> next;

    void read(const Packet& packet, std::size_t ray, std::size_t k) {
        const auto& layers = packet.layers[ray + k];
        if (next[k] == layers.size()) {
            u[k] = Walk::kNever;
            return;
        }
        const DepthLayer& layer = layers[next[k]++];
        u[k] = static_cast<float>(layer.t / packet.dt_exact[ray + k] - static_cast<double>(packet.first));
        const std::array<float, 4> channels{layer.slab.r, layer.slab.g, layer.slab.b, layer.slab.a};
        for (std::size_t c = 0; c < 4; ++c) rgba[c][k] = channels[c];
    }
};

/// All volumes together, composited, with surfaces between the parts of their steps.
void cast_sums(const std::vector<FastVolume>& volumes, const Packet& packet, const PacketSettings& settings,
               PacketSums& out) {
    const std::size_t lanes = hn::Lanes(F());
    const std::size_t count = volumes.size();
    for (std::size_t ray = 0; ray < kPacketRays; ray += lanes) {
        std::array<Walk, kMostVolumes> walks;
        std::array<float, kMostVolumes> next{}, primed{};
        std::array<bool, kMostVolumes> look_ahead{};
        for (std::size_t v = 0; v < count; ++v) {
            walks[v].begin(volumes[v], packet.in[v], ray);
            primed[v] = -1;
            look_ahead[v] = true;
        }
        NextLayers layers{};
        layers.u.fill(Walk::kNever);
        if (packet.has_layers)
            for (std::size_t k = 0; k < lanes; ++k) layers.read(packet, ray, k);
        Rays rays{
            set(1.0F),
            load(packet.last, ray),
            {load(packet.to_viewer[0], ray), load(packet.to_viewer[1], ray), load(packet.to_viewer[2], ray)}};
        V3 color{set(0), set(0), set(0)};
        V first = set(Walk::kNever);
        const auto add = [&](const V3& associated, V opacity, V begin, M those) {
            const V share = hn::IfThenElseZero(those, rays.clear);
            color = {add_product(color.x, share, associated.x), add_product(color.y, share, associated.y),
                     add_product(color.z, share, associated.z)};
            rays.clear = hn::Mul(rays.clear, hn::Sub(set(1.0F), hn::IfThenElseZero(those, opacity)));
            first = hn::IfThenElse(hn::And(those, hn::Gt(opacity, set(0))), hn::Min(first, begin), first);
        };
        for (float i = 0;; i += 1) {
            M alive = rays.alive(settings.least_clear, set(i));
            if (hn::AllFalse(F(), alive)) break;
            // Where the last step of a volume showed nothing: when does it again?
            float soonest = Walk::kNever;
            for (std::size_t v = 0; v < count; ++v) {
                if (next[v] <= i && look_ahead[v]) next[v] = walks[v].next_step(set(i), alive);
                soonest = std::min(soonest, std::max(next[v], i));
            }
            if (packet.has_layers) {
                const V u = hn::IfThenElse(alive, load(layers.u, 0), set(Walk::kNever));
                soonest = std::min(soonest, std::max(hn::GetLane(hn::MinOfLanes(F(), hn::Floor(u))), i));
            }
            if (soonest >= Walk::kNever) break;
            i = soonest;
            std::array<bool, kMostVolumes> seen{};
            for (std::size_t v = 0; v < count; ++v) {
                if (next[v] > i || primed[v] == i) continue;
                if (packet.has_layers) walks[v].prime(set(i));
                else walks[v].prime_ahead(i);
            }
            for (;;) {
                const V target = hn::Min(set(i + 1), load(layers.u, 0));
                Mixture mixture;
                V begin = set(Walk::kNever);
                for (std::size_t v = 0; v < count; ++v) {
                    if (next[v] > i) continue;
                    const StepLook look = packet.has_layers ? walks[v].step(target, alive, rays.viewer)
                                                            : walks[v].step_ahead(i, alive, rays.viewer);
                    const M visible = hn::Gt(look.opacity, set(0));
                    if (hn::AllFalse(F(), visible)) continue;
                    seen[v] = true;
                    mixture.add(look, settings.mixing);
                    begin = hn::IfThenElse(visible, hn::Min(begin, walks[v].front()), begin);
                }
                if (!mixture.empty()) {
                    const StepLook sum = mixture.result(settings.mixing);
                    add(sum.color, sum.opacity, begin, alive);
                }
                if (!packet.has_layers) break;
                const V u = load(layers.u, 0);
                const M met = hn::Lt(u, set(i + 1));
                if (hn::AllFalse(F(), met)) break;
                alive = hn::And(alive, hn::Gt(rays.clear, set(settings.least_clear)));
                add({load(layers.rgba[0], 0), load(layers.rgba[1], 0), load(layers.rgba[2], 0)},
                    load(layers.rgba[3], 0), u, hn::And(alive, met));
                alive = hn::And(alive, hn::Gt(rays.clear, set(settings.least_clear)));
                for (std::size_t k = 0; k < lanes; ++k)
                    if (layers.u[k] < i + 1) layers.read(packet, ray, k);
            }
            for (std::size_t v = 0; v < count; ++v) {
                if (next[v] > i) continue;
                primed[v] = i + 1;
                look_ahead[v] = !seen[v];
            }
        }
        store(color.x, out.color[0], ray);
        store(color.y, out.color[1], ray);
        store(color.z, out.color[2], ray);
        store(rays.clear, out.clear, ray);
        store(first, out.u, ray);
    }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {
namespace {

HWY_EXPORT(cast_slabs);
HWY_EXPORT(collect_slabs);
HWY_EXPORT(cast_sums);

/// Rays through image positions x, y.
void make_packet(const Camera& camera, double step, const std::vector<const FastVolume*>& volumes,
                 const std::array<Vec2, kPacketRays>& at, std::size_t count, Packet& packet) {
    packet.in.resize(volumes.size());
    packet.first = std::numeric_limits<std::int64_t>::max();
    std::array<Ray, kPacketRays> rays;
    auto& progress = packet.progress;
    progress.resize(volumes.size());
    for (std::size_t r = 0; r < count; ++r) {
        rays[r] = camera.ray(at[r].x, at[r].y);
        for (std::size_t v = 0; v < volumes.size(); ++v) {
            progress[v][r] = volumes[v]->exact.enter(rays[r]);
            if (!progress[v][r].done()) packet.first = std::min(packet.first, progress[v][r].k);
        }
    }
    for (PacketRow* row : {&packet.last, &packet.z, &packet.dt}) row->fill(0);
    for (PacketRow& row : packet.to_viewer) row.fill(0);
    for (PacketInVolume& in : packet.in) {
        in.u_in.fill(0);
        in.u_out.fill(0);
        for (std::size_t a = 0; a < 3; ++a) {
            in.p[a].fill(0);
            in.d[a].fill(0);
        }
    }
    for (std::size_t r = 0; r < count; ++r) {
        packet.dt_exact[r] = step / length(rays[r].direction);
        if (packet.has_layers && !packet.layers[r].empty())
            packet.first = std::min(
                packet.first,
                static_cast<std::int64_t>(std::floor(packet.layers[r].front().t / packet.dt_exact[r])));
    }
    if (packet.first == std::numeric_limits<std::int64_t>::max()) return;
    const auto first = static_cast<double>(packet.first);
    for (std::size_t r = 0; r < count; ++r) {
        if (packet.has_layers && !packet.layers[r].empty())
            packet.last[r] = static_cast<float>(packet.layers[r].back().t / packet.dt_exact[r] - first) + 1;
        const Vec3 viewer = -normalize(rays[r].direction);
        for (std::size_t a = 0; a < 3; ++a)
            packet.to_viewer[a][r] = static_cast<float>(viewer[static_cast<int>(a)]);
        for (std::size_t v = 0; v < volumes.size(); ++v) {
            const VolumeCaster::Progress& p = progress[v][r];
            packet.z[r] = static_cast<float>(first * p.dt);
            packet.dt[r] = static_cast<float>(p.dt);
            if (p.done()) continue;
            PacketInVolume& in = packet.in[v];
            in.u_in[r] = static_cast<float>(p.t_in / p.dt - first);
            in.u_out[r] = static_cast<float>(p.t_out / p.dt - first);
            packet.last[r] = std::max(packet.last[r], in.u_out[r]);
            const Vec3 from = p.from + (first * p.dt) * p.along;
            const Vec3 along = p.dt * p.along;
            for (std::size_t a = 0; a < 3; ++a) {
                in.p[a][r] = static_cast<float>(from[static_cast<int>(a)]);
                in.d[a][r] = static_cast<float>(along[static_cast<int>(a)]);
            }
        }
    }
}

}  // namespace

// ---- One volume -------------------------------------------------------------------------------

struct FastVolumeCaster::Parts {
    const Camera* camera;
    double step;
    std::unique_ptr<FastVolume> fast;
    std::unique_ptr<VolumeCaster> plain;
};

FastVolumeCaster::FastVolumeCaster(const PreparedScene& scene, const VolumeObject& volume,
                                   const CastSettings& settings)
    : parts_(std::make_unique<Parts>()) {
    parts_->camera = &scene.camera;
    parts_->step = settings.step;
    const bool fits = scene.camera.far() / settings.step < kMostSteps || volume.bounds().empty() ||
                      length(volume.bounds().size()) / settings.step < kMostSteps;
    if (PackedVolume::takes(volume) && fits)
        parts_->fast = std::make_unique<FastVolume>(scene, volume, settings);
    else
        parts_->plain = std::make_unique<VolumeCaster>(scene, volume, settings);
}
FastVolumeCaster::~FastVolumeCaster() = default;
FastVolumeCaster::FastVolumeCaster(FastVolumeCaster&&) noexcept = default;

std::size_t FastVolumeCaster::bytes() const {
    return parts_->fast ? parts_->fast->packed.bytes() : parts_->plain->bytes();
}

namespace {

/// The pixel centres of a packet that are within the image.
struct PacketPixels {
    PacketPixels(const Camera& camera, int x0, int y0) {
        for (int i = 0; i < static_cast<int>(kPacketRays); ++i) {
            const int x = x0 + i % kPacketSide, y = y0 + i / kPacketSide;
            if (x >= camera.width() || y >= camera.height()) continue;
            place[count] = static_cast<std::size_t>(i);
            at[count++] = {x + 0.5, y + 0.5};
        }
    }
    std::size_t count = 0;
    std::array<Vec2, kPacketRays> at;
    std::array<std::size_t, kPacketRays> place{};  // number in the packet
};

}  // namespace

void FastVolumeCaster::cast(int x0, int y0, float opaque_at, PacketSlabs& out) const {
    for (auto& slabs : out) slabs.clear();
    const Camera& camera = *parts_->camera;
    const PacketPixels pixels(camera, x0, y0);
    if (parts_->plain) {
        for (std::size_t r = 0; r < pixels.count; ++r) {
            std::vector<twin::Slab>& slabs = out[pixels.place[r]];
            SlabList list{std::move(slabs), opaque_at};
            parts_->plain->cast(camera.ray(pixels.at[r].x, pixels.at[r].y), list);
            slabs = std::move(list.slabs);
        }
        return;
    }
    static thread_local Packet packet;
    make_packet(camera, parts_->step, {parts_->fast.get()}, pixels.at, pixels.count, packet);
    HWY_DYNAMIC_DISPATCH(cast_slabs)(*parts_->fast, packet, {SlabMixing::average, true, 1 - opaque_at}, out);
    // Rays were packed; put them where their pixels are, from the last on.
    for (std::size_t r = pixels.count; r-- > 0;)
        if (pixels.place[r] != r) std::swap(out[r], out[pixels.place[r]]);
}

void FastVolumeCaster::cast_collected(int x0, int y0, SlabCollector& collector, CollectedPacket& out) const {
    const float opaque_at = collector.settings().opaque_at;
    const bool in_lanes = parts_->fast && collector.settings().compression == SlabCompression::transmittance &&
                          collector.room() <= RayNodes::most;
    if (!in_lanes) {
        static thread_local PacketSlabs all;
        cast(x0, y0, opaque_at, all);
        for (std::size_t i = 0; i < kPacketRays; ++i) {
            collector.start();
            for (const twin::Slab& slab : all[i])
                if (!collector.push(slab)) break;
            const auto kept = collector.finish();
            out[i].slabs.assign(kept.begin(), kept.end());
            out[i].seen = all[i].size();
            out[i].nearest = all[i].empty() ? 0 : twin::slab_front(all[i].front());
        }
        return;
    }
    const Camera& camera = *parts_->camera;
    const PacketPixels pixels(camera, x0, y0);
    static thread_local Packet packet;
    static thread_local PacketNodes nodes;
    make_packet(camera, parts_->step, {parts_->fast.get()}, pixels.at, pixels.count, packet);
    nodes.start(static_cast<std::uint32_t>(collector.room()), collector.negligible());
    const float least_clear = std::max(1 - opaque_at, SlabCollector::kNothing);
    HWY_DYNAMIC_DISPATCH(collect_slabs)(*parts_->fast, packet, {SlabMixing::average, true, least_clear}, nodes);
    for (auto& ray : out) {
        ray.slabs.clear();
        ray.seen = 0;
    }
    std::array<SlabCollector::Node, RayNodes::most> row;
    for (std::size_t r = 0; r < pixels.count; ++r) {
        const auto count = static_cast<std::size_t>(nodes.count[r]);
        const auto& n = nodes.rays[r].rows;
        using N = RayNodes;
        for (std::size_t i = 0; i < count; ++i)
            row[i] = {{n[N::z][i], n[N::d][i], n[N::r][i], n[N::g][i], n[N::b][i], n[N::a][i]},
                      n[N::before][i],
                      n[N::error][i]};
        const auto kept = collector.finish(std::span(row).first(count));
        Collected& ray = out[pixels.place[r]];
        ray.slabs.assign(kept.begin(), kept.end());
        ray.seen = static_cast<std::size_t>(nodes.seen[r]);
        ray.nearest = nodes.nearest[r];
    }
}

// ---- All volumes ------------------------------------------------------------------------------

Image cast_volumes_fast(const PreparedScene& scene, const MultiVolumeSettings& settings,
                        MultiVolumeStats& stats, const std::function<void(double)>& progress,
                        const FindSurfaces& surfaces) {
    const CastSettings cast{.step = common_step(scene, settings.step), .skip = settings.skip};
    bool all = true;
    double reach = scene.camera.far() - scene.camera.near();
    std::size_t count = 0;
    for (const VolumeObject& volume : scene.volumes) {
        if (volume.bounds().empty()) continue;
        all = all && PackedVolume::takes(volume);
        reach += length(volume.bounds().size());
        ++count;
    }
    if (!all || count > kMostVolumes || reach / cast.step > kMostSteps)
        return cast_volumes(scene, settings, stats, progress, surfaces);

    Stopwatch watch;
    std::vector<FastVolume> volumes;
    volumes.reserve(count);
    std::vector<const FastVolume*> pointers;
    for (const VolumeObject& volume : scene.volumes)
        if (!volume.bounds().empty()) {
            volumes.emplace_back(scene, volume, cast);
            pointers.push_back(&volumes.back());
            stats.bytes += static_cast<std::int64_t>(volumes.back().packed.bytes());
        }
    const LayersOfRay layers_of_ray(scene, cast);
    stats.bytes += static_cast<std::int64_t>(layers_of_ray.bytes());
    stats.prepare_s += watch.lap();

    const Camera& camera = scene.camera;
    Image image(camera.width(), camera.height());
    std::array<std::span<float>, 5> planes;
    const std::array<const char*, 5> names{"R", "G", "B", "A", "Z"};
    for (std::size_t i = 0; i < 5; ++i) planes[i] = image.add(names[i]);
    const auto wide = [](int number) { return static_cast<std::size_t>(number); };
    const int n = settings.rays;
    const int columns = (camera.width() + kPacketSide - 1) / kPacketSide;
    const int rows = (camera.height() + kPacketSide - 1) / kPacketSide;
    const int band = surfaces ? std::max(1, rows_of_band(camera, n) / kPacketSide) : std::max(1, rows);
    std::atomic<int> done{0};
    for (int first_row = 0; first_row < rows; first_row += band) {
        const int y0 = first_row * kPacketSide;
        const int end_row = std::min(first_row + band, rows);
        const SurfaceLayers layers =
            surfaces ? surfaces(y0, std::min(end_row * kPacketSide, camera.height())) : SurfaceLayers{};
        stats.surfaces_s += watch.lap();
        parallel_for(wide(end_row - first_row), 1, [&](std::size_t begin, std::size_t end) {
            Packet packet;
            packet.has_layers = static_cast<bool>(surfaces) || !layers_of_ray.none();
            PacketSums sums;
            for (std::size_t row = begin; row < end; ++row) {
                for (int column = 0; column < columns; ++column) {
                    std::array<glm::ivec2, kPacketRays> at{};
                    std::size_t rays = 0;
                    for (int i = 0; i < static_cast<int>(kPacketRays); ++i) {
                        const glm::ivec2 p(column * kPacketSide + i % kPacketSide,
                                           y0 + static_cast<int>(row) * kPacketSide + i / kPacketSide);
                        if (p.x < camera.width() && p.y < camera.height()) at[rays++] = p;
                    }
                    std::array<std::array<double, 5>, kPacketRays> total{};
                    for (auto& t : total) t[4] = kInfinity;
                    for (int part = 0; part < n * n; ++part) {
                        const int i = part % n, j = part / n;
                        std::array<Vec2, kPacketRays> places;
                        for (std::size_t r = 0; r < rays; ++r) {
                            places[r] = {at[r].x + (i + 0.5) / n, at[r].y + (j + 0.5) / n};
                            if (!packet.has_layers) continue;
                            const std::size_t number =
                                (wide(at[r].y - y0) * wide(n) + wide(j)) * wide(camera.width()) * wide(n) +
                                wide(at[r].x) * wide(n) + wide(i);
                            layers_of_ray.find(camera.ray(places[r].x, places[r].y), layers.of(number),
                                               settings.mixing, packet.layers[r]);
                        }
                        make_packet(camera, cast.step, pointers, places, rays, packet);
                        HWY_DYNAMIC_DISPATCH(cast_sums)
                        (volumes, packet, {settings.mixing, settings.skip, 1 - settings.opaque_at}, sums);
                        for (std::size_t r = 0; r < rays; ++r) {
                            for (std::size_t c = 0; c < 3; ++c)
                                total[r][c] += static_cast<double>(sums.color[c][r]);
                            total[r][3] += static_cast<double>(sums.clear[r]);
                            if (sums.clear[r] < 1)
                                total[r][4] = std::min(total[r][4], (static_cast<double>(packet.first) +
                                                                     static_cast<double>(sums.u[r])) *
                                                                        packet.dt_exact[r]);
                        }
                    }
                    const double share = 1.0 / (n * n);
                    for (std::size_t r = 0; r < rays; ++r) {
                        const std::size_t pixel = wide(at[r].y) * wide(camera.width()) + wide(at[r].x);
                        for (std::size_t c = 0; c < 3; ++c)
                            planes[c][pixel] = static_cast<float>(share * total[r][c]);
                        planes[3][pixel] = static_cast<float>(1 - share * total[r][3]);
                        planes[4][pixel] = static_cast<float>(total[r][4]);
                    }
                }
                progress(++done / static_cast<double>(rows));
            }
        });
        stats.cast_s += watch.lap();
    }
    stats.rays += image.pixel_count() * static_cast<std::uint64_t>(n * n);
    return image;
}

}  // namespace pellucid
#endif
