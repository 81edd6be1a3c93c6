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

#ifndef PELLUCID_FAST_PARTICLES_ONCE
#define PELLUCID_FAST_PARTICLES_ONCE
namespace pellucid {
namespace {

constexpr std::uint64_t kNoHit = ~std::uint64_t{0};
/// Most lanes of 32 bits: what is read in whole vectors is padded by this much.
constexpr std::size_t kMostLanes = 64;
/// Particles shaded at a time: all their intermediate numbers fit into the first-level cache.
constexpr std::size_t kShadeBlock = 128;

/// A pixel's sums, one cache line.
struct alignas(64) TilePixel {
    std::uint64_t color[4];   // R, G, B, covered
    std::uint64_t square[4];  // the last is not used
};

/// What a thread holds: one tile's keys and sums, and the particles of one repeat in it.
struct TileFrame {
    std::vector<std::uint64_t> keys = std::vector<std::uint64_t>(twin::kTilePixels, kNoHit);
    std::vector<TilePixel> sums = std::vector<TilePixel>(twin::kTilePixels, TilePixel{});
    std::vector<std::uint32_t> depth = std::vector<std::uint32_t>(twin::kTilePixels, ~0U);

    // Of the span that is drawn, by particle:
    std::vector<std::uint32_t> pixel;       // within the tile
    std::vector<std::uint64_t> key;
    // … and by winner:
    std::vector<Particle> won;
    std::vector<std::uint32_t> won_pixel;
    std::vector<std::uint32_t> won_index;   // within the span; only where colours are not asked for
    std::vector<twin::ColorUnits> won_color;

    void make_room(std::size_t count) {
        if (pixel.size() >= count + kMostLanes) return;
        pixel.resize(count + kMostLanes);
        key.resize(count + kMostLanes);
        won.resize(count + kMostLanes);
        won_pixel.resize(count + kMostLanes);
        won_index.resize(count + kMostLanes);
        won_color.resize(count + kMostLanes);
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
namespace hn = hwy::HWY_NAMESPACE;
namespace {

using F = hn::ScalableTag<float>;
using U = hn::RebindToUnsigned<F>;
using I = hn::RebindToSigned<F>;

/// Pixels within the tile, and keys, of `count` particles: SIMD of twin::project_quickly, which is called where float32
/// does not decide. All of them lie in the tile, so only the pixel is asked for. `first` is their index in the repeat.
void project_span(const twin::Projection& p, const Particle* particles, std::uint32_t first, std::size_t count, TileFrame& frame) {
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
        const auto at_x = hn::Add(hn::Div(hn::Mul(x, hn::Set(f, p.quick_focal)), w), hn::Set(f, p.quick_center_x));
        const auto at_y = hn::Add(hn::Div(hn::Mul(y, hn::Set(f, p.quick_focal)), w), hn::Set(f, p.quick_center_y));
        const auto floor_x = hn::Floor(at_x);
        const auto floor_y = hn::Floor(at_y);
        const auto share_x = hn::Sub(at_x, floor_x);
        const auto share_y = hn::Sub(at_y, floor_y);
        const auto decided = hn::And(hn::And(hn::And(hn::Gt(share_x, doubt), hn::Lt(share_x, sure)),
                                             hn::And(hn::Gt(share_y, doubt), hn::Lt(share_y, sure))),
                                     hn::Gt(w, hn::Set(f, 1e-30F)));
        const auto column = hn::And(hn::ConvertTo(s, floor_x), mask);
        const auto row = hn::And(hn::ConvertTo(s, floor_y), mask);
        hn::StoreU(hn::BitCast(u, hn::Or(hn::ShiftLeft<twin::kTileShift>(row), column)), u, frame.pixel.data() + i);
        const auto index = hn::Add(hn::Set(u, first + static_cast<std::uint32_t>(i)), step);
        const auto scrambled = hn::Mul(index, hn::Set(u, 0x9e3779b1U));  // twin::scramble_index
        hn::StoreInterleaved2(scrambled, hn::BitCast(u, z), u, reinterpret_cast<std::uint32_t*>(frame.key.data() + i));
        if (HWY_UNLIKELY(!hn::AllTrue(f, decided)))
            for (std::size_t k = 0; k < std::min(lanes, count - i); ++k) {
                const twin::PixelDepth exact = twin::project_quickly(p, from[k]);
                constexpr int kMask = twin::kTileSide - 1;
                frame.pixel[i + k] = static_cast<std::uint32_t>(((exact.row & kMask) << twin::kTileShift) | (exact.column & kMask));
            }
    }
}

/// Colours of `count` particles of one object without an image: loops over the twins that the compiler vectorises.
HWY_ATTR __attribute__((flatten)) void shade_block(const ParticleShading& shading, const twin::Material& m, const Particle* particles, std::size_t count,
                 twin::ColorUnits* out) {
    using Column = std::array<float, kShadeBlock>;
    alignas(64) Column view_x, view_y, view_z, normal_x, normal_y, normal_z, diffuse, specular;
    const twin::ShadingView view = shading.view;
    for (std::size_t i = 0; i < count; ++i) {
        const twin::Vec3f v = twin::direction_to_viewer(view, particles[i]);
        const twin::Vec3f n = twin::turned_to(twin::unpack_normal(particles[i].normal), v);
        view_x[i] = v.x;
        view_y[i] = v.y;
        view_z[i] = v.z;
        normal_x[i] = n.x;
        normal_y[i] = n.y;
        normal_z[i] = n.z;
        diffuse[i] = 0;
        specular[i] = 0;
    }
    for (const twin::ViewLight light : shading.lights) {
        if (m.flat_colored != 0) break;
        const bool headlight = light.headlight != 0;
        for (std::size_t i = 0; i < count; ++i) {
            const twin::Vec3f v{view_x[i], view_y[i], view_z[i]};
            const twin::Vec3f l{headlight ? v.x : light.direction.x, headlight ? v.y : light.direction.y,
                                headlight ? v.z : light.direction.z};
            const twin::LightSums sums = twin::add_light({diffuse[i], specular[i]}, {normal_x[i], normal_y[i], normal_z[i]},
                                                         v, l, light.intensity, m.shininess);
            diffuse[i] = sums.diffuse;
            specular[i] = sums.specular;
        }
    }
    for (std::size_t i = 0; i < count; ++i)
        out[i] = twin::color_units(m, {diffuse[i], specular[i]}, m.red, m.green, m.blue, view.units);
}

void shade_run(const ParticleShading& shading, std::uint32_t object, const Particle* particles, std::size_t count, twin::ColorUnits* out) {
    const twin::Material& m = shading.materials[object];
    if (m.texture_width > 0) {
        for (std::size_t i = 0; i < count; ++i) out[i] = shade_particle(shading, object, particles[i]);
        return;
    }
    for (std::size_t i = 0; i < count; i += kShadeBlock)
        shade_block(shading, m, particles + i, std::min(kShadeBlock, count - i), out + i);
}

/// The nearest particle of every pixel, among those of one repeat in one tile. The winners, their pixels and
/// colours (or indices) stand in the frame; returns how many. The keys are as they were before.
template <bool shaded>
std::size_t find_winners(const RepeatParticles& repeat, const TileSpan& span, TileFrame& frame,
                         const DrawConstants& constants) {
    const std::uint32_t begin = run_begin(repeat, span.first_run);
    const std::size_t count = run_begin(repeat, span.end_run) - begin;
    const Particle* particles = repeat.particles.data() + begin;
    frame.make_room(count);
    project_span(constants.projection, particles, begin, count, frame);
    for (std::size_t i = 0; i < count; ++i) {
        std::uint64_t& held = frame.keys[frame.pixel[i]];
        held = std::min(held, frame.key[i]);
        if constexpr (shaded) __builtin_prefetch(&frame.sums[frame.pixel[i]], 1);
    }
    // Who still holds its pixel? Written without a branch: nobody could predict it.
    std::size_t winners = 0;
    std::size_t i = 0;
    for (std::uint32_t run = span.first_run; run < span.end_run; ++run) {
        const std::size_t first_winner = winners;
        const std::size_t end = run_begin(repeat, run + 1) - begin;
        for (; i < end; ++i) {
            frame.won[winners] = particles[i];
            frame.won_pixel[winners] = frame.pixel[i];
            if constexpr (!shaded) frame.won_index[winners] = static_cast<std::uint32_t>(i);
            winners += frame.keys[frame.pixel[i]] == frame.key[i] ? 1U : 0U;
        }
        if constexpr (shaded)
            shade_run(*constants.shading, repeat.runs[run].bin % constants.objects, &frame.won[first_winner],
                      winners - first_winner, &frame.won_color[first_winner]);
    }
    for (std::size_t k = 0; k < winners; ++k) frame.keys[frame.won_pixel[k]] = kNoHit;
    return winners;
}

/// Adds the winners of one repeat, of which no two share a pixel.
void add_winners(std::size_t winners, TileFrame& frame) {
    for (std::size_t k = 0; k < winners; ++k) {
        TilePixel& sum = frame.sums[frame.won_pixel[k]];
        const twin::ColorUnits& c = frame.won_color[k];
        const std::uint64_t units[4] = {c.red, c.green, c.blue, 1};
        for (int channel = 0; channel < 4; ++channel) {
            sum.color[channel] += units[channel];
            sum.square[channel] += units[channel] * units[channel];
        }
        std::uint32_t& depth = frame.depth[frame.won_pixel[k]];
        depth = std::min(depth, twin::floatBitsToUint(frame.won[k].above_near));
    }
}

/// Asks for the particles of the span that comes next: another repeat's, so no hardware foresees them.
void fetch(const RepeatParticles& repeat, const TileSpan& span) {
    constexpr std::uint32_t kLine = 64 / sizeof(Particle);
    constexpr std::uint32_t kMostLines = 256;  // a third of the first-level cache
    const std::uint32_t begin = run_begin(repeat, span.first_run);
    const std::uint32_t end = std::min(run_begin(repeat, span.end_run), begin + kMostLines * kLine);
    for (std::uint32_t i = begin; i < end; i += kLine) __builtin_prefetch(&repeat.particles[i]);
}

void draw_spans(const ParticleSet& set, std::span<const TileSpan> spans, const DrawConstants& constants, TileFrame& frame) {
    for (std::size_t i = 0; i < spans.size(); ++i) {
        if (i + 1 < spans.size()) fetch(set.repeats[spans[i + 1].repeat], spans[i + 1]);
        add_winners(find_winners<true>(set.repeats[spans[i].repeat], spans[i], frame, constants), frame);
    }
}

void find_span_winners(const ParticleSet& set, const TileSpan& span, const DrawConstants& constants, TileFrame& frame,
                       std::size_t& winners) {
    winners = find_winners<false>(set.repeats[span.repeat], span, frame, constants);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace pellucid {
namespace {

HWY_EXPORT(draw_spans);
HWY_EXPORT(find_span_winners);

/// One piece of work: some repeats of one tile.
struct Item {
    std::uint32_t tile;
    std::uint32_t first_span;
    std::uint32_t end_span;
};

/// Tiles, cut by repeats where there are too few of them for all threads.
[[nodiscard]] std::vector<Item> cut_into_items(const TileSpans& spans) {
    const std::size_t most = std::max<std::size_t>(16, spans.spans.size() / (8 * static_cast<std::size_t>(thread_count())));
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
          constants_{frame_.projection(scene.camera), &shading_, static_cast<std::uint32_t>(scene.objects.size())} {}

    void draw(const ParticleSet& set, EnsembleSums& sums) override {
        const TileSpans spans(set, grid_.count());
        const std::vector<Item> items = cut_into_items(spans);
        std::vector<std::mutex> owned(grid_.count());  // items of one tile add to the same pixels
        parallel_for(items.size(), 1, [&](std::size_t begin, std::size_t end) {
            TileFrame& mine = frames_.local();
            for (std::size_t i = begin; i < end; ++i) {
                const Item& item = items[i];
                const auto part = std::span(spans.spans).subspan(item.first_span, item.end_span - item.first_span);
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
                for (const TileSpan& span : spans.of(tile)) note_winners(set, tile, span, mine, all[span.repeat]);
        });
        return all;
    }

    [[nodiscard]] std::int64_t bytes() const override {
        constexpr std::int64_t kOnePixel = sizeof(std::uint64_t) + sizeof(TilePixel) + sizeof(std::uint32_t);
        return kOnePixel * twin::kTilePixels * thread_count();
    }

private:
    [[nodiscard]] std::size_t pixel_of(std::size_t tile, std::size_t local) const {
        const std::size_t column = (tile % grid_.columns << twin::kTileShift) + (local & (twin::kTileSide - 1));
        const std::size_t row = (tile / grid_.columns << twin::kTileShift) + (local >> twin::kTileShift);
        return row * static_cast<std::size_t>(camera_.width()) + column;
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

    void note_winners(const ParticleSet& set, std::size_t tile, const TileSpan& span, TileFrame& frame, Winners& out) const {
        std::size_t winners = 0;
        HWY_DYNAMIC_DISPATCH(find_span_winners)(set, span, constants_, frame, winners);
        const std::uint32_t begin = run_begin(set.repeats[span.repeat], span.first_run);
        for (std::size_t k = 0; k < winners; ++k)
            out[begin + frame.won_index[k]] = static_cast<std::uint32_t>(pixel_of(tile, frame.won_pixel[k]));
    }

    const Camera& camera_;
    TileGrid grid_;
    ParticleFrame frame_;
    ParticleShading shading_;
    DrawConstants constants_;
    oneapi::tbb::enumerable_thread_specific<TileFrame> frames_;
};

}  // namespace

std::unique_ptr<ParticleDrawer> make_fast_drawer(const PreparedScene& scene) { return std::make_unique<FastDrawer>(scene); }

}  // namespace pellucid
#endif
