// SlabCollector's rule `transmittance` (stage/slab_compression.hpp) for rays in lanes: the same operations in the
// same order, so the same bits. What joins the open slab of its ray does so in lanes; a slab that closes goes to
// its ray's nodes, and a ray without room sweeps them, with nodes in lanes.
//
// A Highway header: it may be included once for every target.
#if defined(PELLUCID_CPU_SLAB_COLLECTOR_SIMD_INL) == defined(HWY_TARGET_TOGGLE)
#ifdef PELLUCID_CPU_SLAB_COLLECTOR_SIMD_INL
#undef PELLUCID_CPU_SLAB_COLLECTOR_SIMD_INL
#else
#define PELLUCID_CPU_SLAB_COLLECTOR_SIMD_INL
#endif

#include <bit>

#include "cpu/packet_nodes.hpp"
#include "cpu/twin_simd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

static_assert(hn::MaxLanes(F()) <= kPacketRays && kPacketRays % hn::MaxLanes(F()) == 0);

/// twin::thickness_between.
[[nodiscard]] HWY_INLINE V thickness_between(V front, V back) {
    const I i;
    const V d = hn::Sub(back, front);
    const auto short_of = hn::VecFromMask(i, hn::RebindMask(i, hn::Lt(hn::Sub(back, d), front)));
    return hn::BitCast(F(), hn::Add(hn::BitCast(i, d), short_of));
}

/// Successive slabs by length and by what they take of the light.
struct Falls {
    V a, drop_a, gap, b, drop_b;
};

[[nodiscard]] HWY_INLINE V area_to_chord(const Falls& f) {
    const V gap = hn::Max(f.gap, set(0));
    const V length = hn::Add(hn::Add(f.a, gap), f.b);
    const V slope = hn::Div(hn::Add(f.drop_a, f.drop_b), length);
    const V e1 = hn::Sub(hn::Mul(slope, f.a), f.drop_a);
    const V e2 = hn::Sub(hn::Mul(slope, hn::Add(f.a, gap)), f.drop_a);
    const V sides = hn::Add(hn::Mul(hn::Abs(e1), f.a), hn::Mul(hn::Abs(e2), f.b));
    const V sum = hn::Add(hn::Abs(e1), hn::Abs(e2));
    const V crossed = hn::Div(hn::Add(hn::Mul(e1, e1), hn::Mul(e2, e2)), sum);
    const V middle = hn::IfThenElse(hn::Ge(hn::Mul(e1, e2), set(0)), sum, crossed);
    const V area = hn::Mul(set(0.5F), add_product(sides, middle, gap));
    return hn::IfThenElseZero(hn::And(hn::Gt(length, set(0)), hn::Gt(sum, set(0))), area);
}

/// SlabCollector::cost_of, right where `those`.
[[nodiscard]] HWY_INLINE V cost_of(const Falls& f, hn::Mask<F> those) {
    const V triangle =
        hn::Mul(set(0.5F), hn::Abs(hn::Sub(hn::Mul(f.b, f.drop_a), hn::Mul(f.a, f.drop_b))));
    const auto apart = hn::And(those, hn::Gt(f.gap, hn::Mul(set(SlabCollector::kTouching), f.b)));
    if (HWY_LIKELY(hn::AllFalse(F(), apart))) return triangle;
    return hn::IfThenElse(apart, area_to_chord(f), triangle);
}

/// Of a row of bits those to choose from the right, so that no two neighbours are: of each run every other one.
[[nodiscard]] inline std::uint32_t no_neighbours(std::uint32_t bits) {
    constexpr std::uint32_t kEven = 0x55555555U;
    const std::uint32_t starts = bits & ~(bits << 1);
    const std::uint32_t from_even = bits & ~(bits + (starts & kEven));
    const std::uint32_t from_odd = bits & ~(bits + (starts & ~kEven));
    return (from_even & kEven) | (from_odd & ~kEven);
}

/// Lanes i … of a row of bits.
[[nodiscard]] HWY_INLINE hn::Mask<F> mask_of(std::uint32_t bits, std::size_t i) {
    const std::uint32_t here = bits >> i;
    alignas(8) const std::array<std::uint8_t, 8> bytes{static_cast<std::uint8_t>(here),
                                                       static_cast<std::uint8_t>(here >> 8)};
    return hn::LoadMaskBits(F(), bytes.data());
}
[[nodiscard]] HWY_INLINE std::uint32_t bits_of(hn::Mask<F> mask) {
    alignas(8) std::array<std::uint8_t, 8> bytes{};
    hn::StoreMaskBits(F(), mask, bytes.data());
    const auto all = static_cast<std::uint32_t>(bytes[0] | bytes[1] << 8);
    return all & ((1U << hn::Lanes(F())) - 1U);
}

/// SlabCollector::sweep of `room` nodes; how many stay.
HWY_NOINLINE std::uint32_t sweep(RayNodes& nodes, std::uint32_t room, float& tolerance) {
    using N = RayNodes;
    const std::size_t lanes = hn::Lanes(F());
    const auto at = [&](N::Field field, std::size_t i) { return hn::LoadU(F(), nodes.rows[field].data() + i); };
    alignas(64) PacketRow costs;
    V least = set(std::numeric_limits<float>::infinity());
    auto sum = hn::Zero(U());
    const std::uint32_t pairs = room - 1;
    for (std::size_t i = 0; i < pairs; i += lanes) {
        const auto those = hn::FirstN(F(), std::min<std::size_t>(pairs - i, lanes));
        const V d = at(N::d, i + 1);
        const V gap = hn::Sub(hn::Sub(at(N::z, i + 1), d), at(N::z, i));
        const V cost = cost_of({at(N::d, i), hn::Mul(at(N::before, i), at(N::a, i)), gap, d,
                                hn::Mul(at(N::before, i + 1), at(N::a, i + 1))},
                               those);
        const V all = hn::Add(hn::Add(at(N::error, i), at(N::error, i + 1)), cost);
        hn::Store(all, F(), costs.data() + i);
        least = hn::Min(least, hn::IfThenElse(those, all, least));
        sum = hn::Add(sum, hn::ShiftRight<SlabCollector::kCostShift>(hn::BitCast(U(), hn::IfThenElseZero(those, all))));
    }
    tolerance = SlabCollector::tolerance_after(tolerance, hn::GetLane(hn::MinOfLanes(F(), least)),
                                               hn::GetLane(hn::SumOfLanes(U(), sum)), pairs);
    std::uint32_t cheap = 0;
    for (std::size_t i = 0; i < pairs; i += lanes)
        cheap |= bits_of(hn::Le(hn::Load(F(), costs.data() + i), set(tolerance))) << i;
    const std::uint32_t first = no_neighbours(cheap & ((1U << pairs) - 1U));
    const std::uint32_t stay = ~(first << 1) & ((1U << room) - 1U);
    std::size_t kept = 0;
    for (std::size_t i = 0; i < room; i += lanes) {
        const auto joins = mask_of(first, i), stays = mask_of(stay, i);
        const V a = at(N::a, i), z = at(N::z, i), d = at(N::d, i), next_z = at(N::z, i + 1);
        const V clear = hn::Sub(set(1.0F), a);
        const auto over = [&](N::Field field) {
            const V near = at(field, i);
            return hn::IfThenElse(joins, add_product(near, clear, at(field, i + 1)), near);
        };
        // Everything is read before anything is written.
        std::array<V, N::fields> out;
        out[N::z] = hn::IfThenElse(joins, next_z, z);
        out[N::d] = hn::IfThenElse(joins, thickness_between(hn::Sub(z, d), next_z), d);
        out[N::r] = over(N::r);
        out[N::g] = over(N::g);
        out[N::b] = over(N::b);
        out[N::a] = over(N::a);
        out[N::before] = at(N::before, i);
        out[N::error] = hn::IfThenElse(joins, hn::Load(F(), costs.data() + i), at(N::error, i));
        for (std::size_t f = 0; f < N::fields; ++f)
            (void)hn::CompressStore(out[f], stays, F(), nodes.rows[f].data() + kept);
        kept += hn::CountTrue(F(), stays);
    }
    return static_cast<std::uint32_t>(kept);
}

/// The open slabs of as many rays as there are lanes, from `ray` of the packet on.
class OpenSlabs {
public:
    HWY_INLINE OpenSlabs(PacketNodes& nodes, std::size_t ray) : nodes_(nodes), ray_(ray) {
        const V zero = set(0);
        // Nothing joins at this error. The depth: nothing is far behind it.
        error_ = z_ = set(std::numeric_limits<float>::infinity());
        front_ = d_ = r_ = g_ = b_ = a_ = clear_ = before_ = zero;
        seen_ = hn::Zero(I());
    }

    /// SlabCollector::push of what is `seen`, with `before` in front of it.
    HWY_INLINE void push(hn::Mask<F> seen, V back, V d, const V3& color, V opacity, V before) {
        const V front = hn::Sub(back, d);
        const I whole;
        seen_ = hn::Sub(seen_, hn::VecFromMask(whole, hn::RebindMask(whole, seen)));
        const V cost = cost_of({hn::Sub(z_, front_), hn::Mul(before_, a_), hn::Sub(front, z_), d,
                                hn::Mul(before, opacity)},
                               seen);
        const V error = hn::Add(error_, cost);
        const V tolerance = hn::Load(F(), nodes_.tolerance.data() + ray_);
        const auto joins = hn::And(seen, hn::Le(error, tolerance));
        const auto opens = hn::AndNot(joins, seen);
        const V share = hn::IfThenElseZero(joins, clear_);
        r_ = add_product(r_, share, color.x);
        g_ = add_product(g_, share, color.y);
        b_ = add_product(b_, share, color.z);
        a_ = add_product(a_, share, opacity);
        const V passes = hn::Sub(set(1.0F), opacity);
        clear_ = hn::IfThenElse(joins, hn::Mul(clear_, passes), clear_);
        error_ = hn::IfThenElse(joins, error, error_);
        z_ = hn::IfThenElse(joins, back, z_);
        d_ = hn::IfThenElse(joins, set(-1.0F), d_);
        if (hn::AllFalse(F(), opens)) return;
        close(bits_of(opens), front);
        front_ = hn::IfThenElse(opens, front, front_);
        z_ = hn::IfThenElse(opens, back, z_);
        d_ = hn::IfThenElse(opens, d, d_);
        r_ = hn::IfThenElse(opens, color.x, r_);
        g_ = hn::IfThenElse(opens, color.y, g_);
        b_ = hn::IfThenElse(opens, color.z, b_);
        a_ = hn::IfThenElse(opens, opacity, a_);
        clear_ = hn::IfThenElse(opens, passes, clear_);
        before_ = hn::IfThenElse(opens, before, before_);
        error_ = hn::IfThenElse(opens, set(0), error_);
    }

    HWY_INLINE void finish() {
        close((1U << hn::Lanes(F())) - 1U, set(std::numeric_limits<float>::infinity()));
        hn::Store(seen_, I(), nodes_.seen.data() + ray_);
    }

private:
    /// SlabCollector::close of those lanes; `front` is that of the slab which comes next.
    HWY_INLINE void close(std::uint32_t those, V front) {
        using N = RayNodes;
        alignas(64) std::array<PacketRow, N::fields + 1> rows;
        const auto put = [&](V value, std::size_t field) { hn::Store(value, F(), rows[field].data()); };
        const auto joined = hn::Lt(d_, set(0));
        put(z_, N::z);
        put(hn::IfThenElse(joined, thickness_between(front_, z_), d_), N::d);
        put(r_, N::r);
        put(g_, N::g);
        put(b_, N::b);
        put(hn::Min(a_, set(1.0F)), N::a);
        put(before_, N::before);
        put(error_, N::error);
        put(front, N::fields);
        for (; those != 0; those &= those - 1) {
            const auto lane = static_cast<std::size_t>(std::countr_zero(those));
            std::int32_t& count = nodes_.count[ray_ + lane];
            if (count < 0) {
                nodes_.nearest[ray_ + lane] = rows[N::fields][lane];
                count = 0;
                continue;
            }
            RayNodes& nodes = nodes_.rays[ray_ + lane];
            if (HWY_UNLIKELY(static_cast<std::uint32_t>(count) == nodes_.room))
                count = static_cast<std::int32_t>(sweep(nodes, nodes_.room, nodes_.tolerance[ray_ + lane]));
            for (std::size_t f = 0; f < N::fields; ++f)
                nodes.rows[f][static_cast<std::size_t>(count)] = rows[f][lane];
            ++count;
        }
    }

    PacketNodes& nodes_;
    std::size_t ray_;
    V front_, z_, d_;  // d < 0: more than one slab, and what it is comes at the end
    V r_, g_, b_, a_, clear_, before_, error_;
    hn::Vec<I> seen_;
};

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#endif  // per target
