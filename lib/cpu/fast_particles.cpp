#include "cpu/fast_particles.hpp"

#include <algorithm>
#include <array>
#include <mutex>

#include <oneapi/tbb/enumerable_thread_specific.h>

#include "core/parallel.hpp"
#include "stage/particle_shading.hpp"
#include "stage/tile_spans.hpp"

// The part below is compiled once for every instruction set that Highway knows.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "cpu/fast_particles.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "cpu/twin_simd-inl.h"

#ifndef PELLUCID_FAST_PARTICLES_ONCE
#define PELLUCID_FAST_PARTICLES_ONCE
namespace pellucid {
namespace {

constexpr std::uint64_t kNoHit = ~std::uint64_t{0};
/// Most lanes of 32 bits: what is read in whole vectors is padded by this much.
constexpr std::size_t kMostLanes = 64;
/// Particles shaded at a time: their intermediate numbers fit into the first-level cache. A multiple of
/// kMostLanes.
constexpr std::size_t kShadeBlock = 128;

/// A pixel's sums, one cache line.
struct alignas(64) TilePixel {
    std::uint64_t color[4];   // R, G, B, covered
    std::uint64_t square[4];  // the last is not used
};

/// What a winner adds to the first half of a TilePixel.
struct WonColor {
    std::uint32_t red, green, blue, covered;
};

/// Winners of one object that wait for being shaded together, from whatever repeats of the tile: integer sums
/// do not mind the order, and short runs do not leave vectors half empty.
struct WinnerQueue {
    std::uint32_t object = 0;
    std::uint32_t count = 0;
    std::array<Particle, 2 * kShadeBlock + kMostLanes>
        particle;  // a block beyond what is waiting: written on trial
    std::array<std::uint32_t, 2 * kShadeBlock + kMostLanes> pixel;
};
/// Objects share queues where they are more than this.
constexpr std::uint32_t kQueues = 32;

/// What a thread holds: one tile's keys and sums, and the particles of one repeat in it.
struct TileFrame {
    // The last key is nobody's pixel: what a particle clears that has won nothing.
    std::vector<std::uint64_t> keys = std::vector<std::uint64_t>(twin::kTilePixels + 1, kNoHit);
    std::vector<TilePixel> sums = std::vector<TilePixel>(twin::kTilePixels, TilePixel{});
    std::vector<std::uint32_t> depth = std::vector<std::uint32_t>(twin::kTilePixels, ~0U);
    std::vector<WinnerQueue> queues = std::vector<WinnerQueue>(kQueues);

    // Of the span that is drawn, by particle:
    std::vector<std::uint32_t> pixel;  // within the tile
    std::vector<std::uint64_t> key;

    void make_room(std::size_t count) {
        if (pixel.size() >= count + kMostLanes) return;
        pixel.resize(count + kMostLanes);
        key.resize(count + kMostLanes);
    }
};

/// What all spans have in common.
struct DrawConstants {
    twin::Projection projection;
    const ParticleShading* shading;
    std::uint32_t objects;
};

}  // namespace
}  // namespace pellucid
#endif

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

/// Pixels within the tile, and keys, of `count` particles: SIMD of twin::project_quickly, which is called
/// where float32 does not decide. All of them lie in the tile, so only the pixel is asked for. `first` is
/// their index in the repeat.
void project_span(const twin::Projection& p, const Particle* particles, std::uint32_t first,
                  std::size_t count, TileFrame& frame) {
    const F f;
    const U u;
    const I s;
    const std::size_t lanes = hn::Lanes(f);
    const auto doubt = hn::Set(f, p.doubt);
    const auto sure = hn::Set(f, 1.0F - p.doubt);
    const auto mask = hn::Set(s, twin::kTileSide - 1);
    const auto step = hn::Iota(u, 0);
    std::array<Particle, kMostLanes> rest{};
    for (std::size_t i = 0; i < count; i += lanes) {
        const Particle* from = particles + i;
        if (i + lanes > count) {  // the last ones: never read past the end
            std::copy(from, particles + count, rest.begin());
            from = rest.data();
        }
        hn::Vec<F> x, y, z, normal;
        hn::LoadInterleaved4(f, reinterpret_cast<const float*>(from), x, y, z, normal);
        const auto w = p.perspective != 0 ? hn::Add(hn::Set(f, p.quick_near), z) : hn::Set(f, 1.0F);
        const auto at_x =
            hn::Add(hn::Div(hn::Mul(x, hn::Set(f, p.quick_focal)), w), hn::Set(f, p.quick_center_x));
        const auto at_y =
            hn::Add(hn::Div(hn::Mul(y, hn::Set(f, p.quick_focal)), w), hn::Set(f, p.quick_center_y));
        const auto floor_x = hn::Floor(at_x);
        const auto floor_y = hn::Floor(at_y);
        const auto share_x = hn::Sub(at_x, floor_x);
        const auto share_y = hn::Sub(at_y, floor_y);
        const auto decided = hn::And(hn::And(hn::And(hn::Gt(share_x, doubt), hn::Lt(share_x, sure)),
                                             hn::And(hn::Gt(share_y, doubt), hn::Lt(share_y, sure))),
                                     hn::Gt(w, hn::Set(f, 1e-30F)));
        const auto column = hn::And(hn::ConvertTo(s, floor_x), mask);
        const auto row = hn::And(hn::ConvertTo(s, floor_y), mask);
        hn::StoreU(hn::BitCast(u, hn::Or(hn::ShiftLeft<twin::kTileShift>(row), column)), u,
                   frame.pixel.data() + i);
        const auto index = hn::Add(hn::Set(u, first + static_cast<std::uint32_t>(i)), step);
        const auto scrambled = hn::Mul(index, hn::Set(u, 0x9e3779b1U));  // as twin::particle_key
        hn::StoreInterleaved2(scrambled, hn::BitCast(u, z), u,
                              reinterpret_cast<std::uint32_t*>(frame.key.data() + i));
        if (HWY_UNLIKELY(!hn::AllTrue(f, decided)))
            for (std::size_t k = 0; k < std::min(lanes, count - i); ++k) {
                const twin::PixelDepth exact = twin::project_quickly(p, from[k]);
                constexpr int kMask = twin::kTileSide - 1;
                frame.pixel[i + k] = static_cast<std::uint32_t>(((exact.row & kMask) << twin::kTileShift) |
                                                                (exact.column & kMask));
            }
    }
}

[[nodiscard]] HWY_INLINE V3 unpack_normal(hn::Vec<U> bits) {
    const I s;
    const auto restore = [&](hn::Vec<U> sixteen) {
        return hn::ConvertTo(F(), hn::Sub(hn::BitCast(s, sixteen), hn::Set(s, 32768)));
    };
    const V u = restore(hn::And(bits, hn::Set(U(), 65535)));
    const V v = restore(hn::ShiftRight<16>(bits));
    const V z = hn::Sub(hn::Sub(set(32767.0F), hn::Abs(u)), hn::Abs(v));
    const V fold = hn::Max(hn::Neg(z), set(0));
    const V3 n{hn::Sub(u, with_sign_of(fold, u)), hn::Sub(v, with_sign_of(fold, v)), z};
    return scaled(n, quick_rsqrt(dot(n, n)));
}

[[nodiscard]] HWY_INLINE V3 direction_to_viewer(const twin::ShadingView& view, V x, V y, V above_near) {
    if (view.perspective == 0) return {set(0), set(0), set(-1.0F)};
    const I s;
    const V z = hn::Add(set(view.near), above_near);
    const V largest = hn::Max(hn::Max(hn::Abs(x), hn::Abs(y)), z);
    const auto biased = hn::And(hn::ShiftRight<23>(hn::BitCast(s, largest)), hn::Set(s, 255));
    const auto exponent = hn::Max(hn::Sub(biased, hn::Set(s, 127)), hn::Set(s, -126));
    const V power = hn::BitCast(F(), hn::ShiftLeft<23>(hn::Sub(hn::Set(s, 127), exponent)));
    const V3 v = scaled({x, y, z}, power);
    const V r = quick_rsqrt(dot(v, v));
    return {hn::Mul(hn::Neg(v.x), r), hn::Mul(hn::Neg(v.y), r), hn::Mul(hn::Neg(v.z), r)};
}

[[nodiscard]] HWY_INLINE hn::Vec<U> channel_units(V value, float units) {
    const V scaled_value = add_product(set(0.5F), hn::Max(value, set(0)), set(units));
    const auto whole = hn::BitCast(U(), hn::ConvertTo(I(), hn::Min(scaled_value, set(2097152.0F))));
    return hn::Min(whole, hn::Set(U(), twin::kMostColorUnits));
}

/// Numbers of a block of particles, by vector.
using Column = std::array<float, kShadeBlock>;
HWY_INLINE V get(const Column& column, std::size_t i) { return hn::Load(F(), column.data() + i); }
HWY_INLINE void put(V value, Column& column, std::size_t i) { hn::Store(value, F(), column.data() + i); }
struct alignas(64) Column3 {
    Column x, y, z;
};
HWY_INLINE V3 get(const Column3& column, std::size_t i) {
    return {get(column.x, i), get(column.y, i), get(column.z, i)};
}
HWY_INLINE void put(const V3& value, Column3& column, std::size_t i) {
    put(value.x, column.x, i);
    put(value.y, column.y, i);
    put(value.z, column.z, i);
}

/// Diffuse and specular light on `count` particles, step by step for all of them: a step's chain of
/// operations is short, and those of several vectors run side by side.
void light_block(const ParticleShading& shading, float shininess, const Particle* particles,
                 std::size_t count, Column& diffuse, Column& specular) {
    const std::size_t lanes = hn::Lanes(F());
    alignas(64) Column3 viewer, normal;
    alignas(64) Column n_h, exponent;
    for (std::size_t i = 0; i < count; i += lanes) {
        V x, y, z, packed;
        hn::LoadInterleaved4(F(), reinterpret_cast<const float*>(particles + i), x, y, z, packed);
        const V3 v = direction_to_viewer(shading.view, x, y, z);
        put(v, viewer, i);
        put(turned_to(unpack_normal(hn::BitCast(U(), packed)), v), normal, i);
        put(set(0), diffuse, i);
        put(set(0), specular, i);
    }
    for (const twin::ViewLight& light : shading.lights) {
        const V3 direction{set(light.direction.x), set(light.direction.y), set(light.direction.z)};
        const V intensity = set(light.intensity);
        for (std::size_t i = 0; i < count; i += lanes) {
            const V3 v = get(viewer, i);
            const V3 n = get(normal, i);
            const V3 l = light.headlight != 0 ? v : direction;
            const V3 h{hn::Add(l.x, v.x), hn::Add(l.y, v.y), hn::Add(l.z, v.z)};
            const V product = hn::Mul(dot(n, h), quick_rsqrt(hn::Max(dot(h, h), set(1e-30F))));
            put(hn::Min(hn::Max(product, set(0)), set(1.0F)), n_h, i);
            put(add_product(get(diffuse, i), intensity, hn::Max(set(0), dot(n, l))), diffuse, i);
        }
        for (std::size_t i = 0; i < count; i += lanes)
            put(power_exponent(get(n_h, i), shininess), exponent, i);
        for (std::size_t i = 0; i < count; i += lanes)
            put(add_product(get(specular, i), intensity, power_of(get(n_h, i), shininess, get(exponent, i))),
                specular, i);
    }
}

/// Colours of at most kShadeBlock particles of one object without an image.
void shade_block(const ParticleShading& shading, const twin::Material& m, const Particle* particles,
                 std::size_t count, WonColor* out) {
    alignas(64) Column diffuse, specular;
    const bool lit = m.flat_colored == 0;
    if (lit) light_block(shading, m.shininess, particles, count, diffuse, specular);
    const float units = shading.view.units;
    for (std::size_t i = 0; i < count; i += hn::Lanes(F())) {
        V color[3] = {set(m.red), set(m.green), set(m.blue)};
        if (lit) {
            const V all = add_product(set(m.ambient), set(m.diffuse), get(diffuse, i));
            const V highlight = hn::Mul(set(m.specular), get(specular, i));
            for (V& channel : color) channel = hn::Add(hn::Mul(channel, all), highlight);
        }
        hn::StoreInterleaved4(channel_units(color[0], units), channel_units(color[1], units),
                              channel_units(color[2], units), hn::Set(U(), 1), U(),
                              reinterpret_cast<std::uint32_t*>(out + i));
    }
}

/// Of numbers below 2^32.
template <class D, class N = hn::Vec<D>>
[[nodiscard]] HWY_INLINE N squared(D d, N value) {
#if HWY_TARGET == HWY_SCALAR
    return hn::Set(d, hn::GetLane(value) * hn::GetLane(value));
#else
    (void)d;
    const auto halves = hn::BitCast(hn::Repartition<std::uint32_t, D>(), value);
    return hn::MulEven(halves, halves);
#endif
}

/// Adds colours and depths to the sums of their pixels, one after the other.
void add_winners(const Particle* particles, const std::uint32_t* pixels, const WonColor* colors,
                 std::size_t count, TileFrame& frame) {
    using Wide = hn::CappedTag<std::uint64_t, 4>;
    const Wide wide;
    const hn::Rebind<std::uint32_t, Wide> narrow;
    for (std::size_t k = 0; k < count; ++k) {
        TilePixel& sum = frame.sums[pixels[k]];
        const std::uint32_t* units = &colors[k].red;
        for (std::size_t channel = 0; channel < 4; channel += hn::Lanes(wide)) {
            const auto one = hn::PromoteTo(wide, hn::Load(narrow, units + channel));
            hn::Store(hn::Add(hn::Load(wide, sum.color + channel), one), wide, sum.color + channel);
            hn::Store(hn::Add(hn::Load(wide, sum.square + channel), squared(wide, one)), wide,
                      sum.square + channel);
        }
        std::uint32_t& depth = frame.depth[pixels[k]];
        depth = std::min(depth, twin::floatBitsToUint(particles[k].above_near));
    }
}

/// Shades and adds up to a block of what waits in the queue, and moves the rest to its front.
void shade_queue(const ParticleShading& shading, WinnerQueue& queue, TileFrame& frame) {
    alignas(64) std::array<WonColor, kShadeBlock + kMostLanes> color;
    const std::size_t count = std::min<std::size_t>(queue.count, kShadeBlock);
    const twin::Material& m = shading.materials[queue.object];
    for (std::size_t k = 0; k < count; ++k) __builtin_prefetch(&frame.sums[queue.pixel[k]], 1);
    if (m.texture_width == 0 && m.painted == 0) {
        shade_block(shading, m, queue.particle.data(), count, color.data());
    } else {
        for (std::size_t i = 0; i < count; ++i) {
            const twin::ColorUnits c = shade_particle(shading, queue.object, queue.particle[i]);
            color[i] = {c.red, c.green, c.blue, 1};
        }
    }
    add_winners(queue.particle.data(), queue.pixel.data(), color.data(), count, frame);
    queue.count -= static_cast<std::uint32_t>(count);
    std::copy_n(queue.particle.begin() + count, queue.count, queue.particle.begin());
    std::copy_n(queue.pixel.begin() + count, queue.count, queue.pixel.begin());
}

[[nodiscard]] WinnerQueue& queue_of(std::uint32_t object, const ParticleShading& shading, TileFrame& frame) {
    WinnerQueue& queue = frame.queues[object % kQueues];
    while (queue.object != object && queue.count > 0) shade_queue(shading, queue, frame);
    queue.object = object;
    return queue;
}

/// Projects the particles of one repeat in one tile and takes the least key of every pixel.
void splat_span(const RepeatParticles& repeat, const TileSpan& span, const DrawConstants& constants,
                TileFrame& frame) {
    const std::uint32_t begin = run_begin(repeat, span.first_run);
    const std::size_t count = run_begin(repeat, span.end_run) - begin;
    frame.make_room(count);
    project_span(constants.projection, repeat.particles.data() + begin, begin, count, frame);
    for (std::size_t i = 0; i < count; ++i) {
        std::uint64_t& held = frame.keys[frame.pixel[i]];
        held = std::min(held, frame.key[i]);
    }
}

/// Moves those who still hold their pixel to the queue, and clears their keys: no other particle's key could
/// have been equal. Without a branch, since nobody could predict it. `next`: what will be read after this,
/// another repeat's particles, which no hardware foresees; asked for little by little.
void queue_winners(const Particle* particles, std::size_t begin, std::size_t end, const Particle* next,
                   WinnerQueue& queue, TileFrame& frame) {
    std::uint32_t count = queue.count;
    for (std::size_t i = begin; i < end; ++i) {
        __builtin_prefetch(next + i, 0, 2);
        const std::uint32_t pixel = frame.pixel[i];
        const bool won = frame.keys[pixel] == frame.key[i];
        queue.particle[count] = particles[i];
        queue.pixel[count] = pixel;
        frame.keys[won ? pixel : static_cast<std::uint32_t>(twin::kTilePixels)] = kNoHit;
        count += won ? 1U : 0U;
    }
    queue.count = count;
}

void draw_spans(const ParticleSet& set, std::span<const TileSpan> spans, const DrawConstants& constants,
                TileFrame& frame) {
    for (std::size_t s = 0; s < spans.size(); ++s) {
        const TileSpan& span = spans[s];
        const TileSpan& after = spans[std::min(s + 1, spans.size() - 1)];
        const Particle* next = set.repeats[after.repeat].particles.data() +
                               run_begin(set.repeats[after.repeat], after.first_run);
        const RepeatParticles& repeat = set.repeats[span.repeat];
        const std::uint32_t begin = run_begin(repeat, span.first_run);
        splat_span(repeat, span, constants, frame);
        for (std::uint32_t run = span.first_run; run < span.end_run; ++run) {
            WinnerQueue& queue =
                queue_of(repeat.runs[run].bin % constants.objects, *constants.shading, frame);
            const std::size_t end = run_begin(repeat, run + 1) - begin;
            for (std::size_t i = run_begin(repeat, run) - begin; i < end; i += kShadeBlock) {
                queue_winners(repeat.particles.data() + begin, i, std::min(i + kShadeBlock, end), next, queue,
                              frame);
                if (queue.count >= kShadeBlock) shade_queue(*constants.shading, queue, frame);
            }
        }
    }
    for (WinnerQueue& queue : frame.queues)
        while (queue.count > 0) shade_queue(*constants.shading, queue, frame);
}

/// `won`: for every particle of the span its pixel of the tile if it won, else kNoPixel.
void find_winners(const ParticleSet& set, const TileSpan& span, const DrawConstants& constants,
                  TileFrame& frame, std::vector<std::uint32_t>& won) {
    const RepeatParticles& repeat = set.repeats[span.repeat];
    splat_span(repeat, span, constants, frame);
    won.resize(run_begin(repeat, span.end_run) - run_begin(repeat, span.first_run));
    for (std::size_t i = 0; i < won.size(); ++i) {
        std::uint64_t& held = frame.keys[frame.pixel[i]];
        won[i] = held == frame.key[i] ? frame.pixel[i] : kNoPixel;
        if (won[i] != kNoPixel) held = kNoHit;
    }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {
namespace {

HWY_EXPORT(draw_spans);
HWY_EXPORT(find_winners);

/// One piece of work: some repeats of one tile.
struct Item {
    std::uint32_t tile;
    std::uint32_t first_span;
    std::uint32_t end_span;
};

/// Tiles, cut by repeats where there are too few of them for all threads.
[[nodiscard]] std::vector<Item> cut_into_items(const TileSpans& spans) {
    const std::size_t most =
        std::max<std::size_t>(16, spans.spans.size() / (8 * static_cast<std::size_t>(thread_count())));
    std::vector<Item> items;
    for (std::uint32_t tile = 0; tile + 1 < spans.tile_begin.size(); ++tile) {
        const std::size_t begin = spans.tile_begin[tile];
        const std::size_t end = spans.tile_begin[tile + 1];
        const std::size_t parts = (end - begin + most - 1) / most;
        for (std::size_t part = 0; part < parts; ++part)
            items.push_back({tile, static_cast<std::uint32_t>(begin + (end - begin) * part / parts),
                             static_cast<std::uint32_t>(begin + (end - begin) * (part + 1) / parts)});
    }
    return items;
}

class FastDrawer final : public ParticleDrawer {
public:
    explicit FastDrawer(const PreparedScene& scene)
        : camera_(scene.camera),
          grid_(scene.camera.width(), scene.camera.height()),
          frame_(scene.camera),
          shading_(scene, frame_),
          constants_{frame_.projection(scene.camera), &shading_,
                     static_cast<std::uint32_t>(scene.object_count())} {}

    void draw(const ParticleSet& set, EnsembleSums& sums) override {
        const TileSpans spans(set, grid_.count());
        const std::vector<Item> items = cut_into_items(spans);
        std::vector<std::mutex> owned(grid_.count());  // items of one tile add to the same pixels
        parallel_for(items.size(), 1, [&](std::size_t begin, std::size_t end) {
            TileFrame& mine = frames_.local();
            for (std::size_t i = begin; i < end; ++i) {
                const Item& item = items[i];
                const auto part =
                    std::span(spans.spans).subspan(item.first_span, item.end_span - item.first_span);
                HWY_DYNAMIC_DISPATCH(draw_spans)(set, part, constants_, mine);
                const std::lock_guard lock(owned[item.tile]);
                add_tile(item.tile, mine, sums);
            }
        });
        sums.particles += set.count();
        sums.repeats += set.repeats.size();
    }

    [[nodiscard]] std::vector<Winners> winners(const ParticleSet& set) override {
        std::vector<Winners> all(set.repeats.size());
        for (std::size_t r = 0; r < all.size(); ++r) all[r].assign(set.repeats[r].particles.size(), kNoPixel);
        const TileSpans spans(set, grid_.count());
        parallel_for(grid_.count(), 1, [&](std::size_t begin, std::size_t end) {
            TileFrame& mine = frames_.local();
            for (std::size_t tile = begin; tile < end; ++tile)
                for (const TileSpan& span : spans.of(tile))
                    note_winners(set, tile, span, mine, all[span.repeat]);
        });
        return all;
    }

    [[nodiscard]] std::int64_t bytes() const override {
        constexpr std::int64_t kOnePixel = sizeof(std::uint64_t) + sizeof(TilePixel) + sizeof(std::uint32_t);
        constexpr std::int64_t kOneThread = kOnePixel * twin::kTilePixels + sizeof(WinnerQueue) * kQueues;
        return kOneThread * thread_count();
    }

private:
    [[nodiscard]] std::size_t pixel_of(std::size_t tile, std::size_t local) const {
        return grid_.row_of(tile, local) * static_cast<std::size_t>(camera_.width()) +
               grid_.column_of(tile, local);
    }

    /// Moves the tile's sums to where they belong and leaves the frame empty.
    void add_tile(std::size_t tile, TileFrame& frame, EnsembleSums& sums) const {
        for (std::size_t local = 0; local < twin::kTilePixels; ++local) {
            TilePixel& from = frame.sums[local];
            if (from.color[3] == 0) continue;
            EnsembleSums::Pixel& to = sums.pixels[pixel_of(tile, local)];
            for (int c = 0; c < 3; ++c) {
                to.color[c] += from.color[c];
                to.square[c] += from.square[c];
            }
            to.covered += static_cast<std::uint32_t>(from.color[3]);
            to.depth = std::min(to.depth, frame.depth[local]);
            from = {};
            frame.depth[local] = ~0U;
        }
    }

    void note_winners(const ParticleSet& set, std::size_t tile, const TileSpan& span, TileFrame& frame,
                      Winners& out) const {
        std::vector<std::uint32_t> won;
        HWY_DYNAMIC_DISPATCH(find_winners)(set, span, constants_, frame, won);
        const std::uint32_t begin = run_begin(set.repeats[span.repeat], span.first_run);
        for (std::size_t i = 0; i < won.size(); ++i)
            if (won[i] != kNoPixel) out[begin + i] = static_cast<std::uint32_t>(pixel_of(tile, won[i]));
    }

    const Camera& camera_;
    TileGrid grid_;
    ParticleFrame frame_;
    ParticleShading shading_;
    DrawConstants constants_;
    oneapi::tbb::enumerable_thread_specific<TileFrame> frames_;
};

}  // namespace

std::unique_ptr<ParticleDrawer> make_fast_drawer(const PreparedScene& scene) {
    return std::make_unique<FastDrawer>(scene);
}

}  // namespace pellucid
#endif
