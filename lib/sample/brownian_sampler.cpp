#include "sample/brownian_sampler.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"

namespace pellucid {
namespace {

/// Walkers start where random lines land: by a seed of their own.
constexpr std::uint64_t kStartSeed = 0x00b2'0a71'a5ULL;
/// Steps in a row without a way back to the surface, after which a walker is put elsewhere.
constexpr std::uint32_t kMostLost = 8;
/// What is worth a word: one step in so many.
constexpr double kLostWorthAWord = 1e-4;

[[nodiscard]] const Object& with_field(const Object& object) {
    if (!object.geometry->field_surface())
        throw input_error("surface \"{}\": particles.sampler = \"brownian\" needs a surface that is f = 0 of a field "
                          "(implicit, expression, isosurface, points): use \"lines\"",
                          object.surface.name);
    return object;
}

}  // namespace

struct BrownianSampler::Walkers {
    std::vector<BrownianWalk::Walker> walker;
    std::vector<std::uint32_t> starts, lost;  // so far; in a row
};

BrownianSampler::BrownianSampler(const Object& object, const Camera& camera, std::uint32_t object_id,
                                 const WalkSettings& settings)
    : object_(&object),
      object_id_(object_id),
      settings_(settings),
      walk_(with_field(object), settings),
      thinning_(object, camera),
      places_(object) {
    if (object.geometry->patch_count() == 0 || !thinning_.least_pixel_area()) return;
    area_ = places_.area();
    virtual_pixels_ = area_.value / *thinning_.least_pixel_area();
}

std::string BrownianSampler::label() const { return fmt::format("surface \"{}\"", object_->surface.name); }

double BrownianSampler::optical_depth() const {
    return -std::log1p(-std::min(object_->surface.opacity, kMostParticleOpacity));
}

std::string BrownianSampler::remark() const {
    const Tally t = tally();
    if (static_cast<double>(t.lost) <= kLostWorthAWord * static_cast<double>(t.steps)) return {};
    return fmt::format("{}: {} of {} Brownian steps found no way back to the surface and were not made, {} walkers were "
                       "put elsewhere: a smaller particles.walk.step may help",
                       label(), t.lost, t.steps, t.restarts);
}

/// Puts a walker on a fresh uniform place.
void BrownianSampler::start(Walkers& walkers, std::size_t index, Seed seed, std::uint32_t repeat) const {
    constexpr std::uint32_t kMostStarts = 64;
    const bool single = settings_.start == WalkSettings::Start::single;
    for (std::uint32_t i = 0; i < kMostStarts; ++i) {
        // Restarted walkers of one place go where no other is.
        const std::uint64_t attempt = walkers.starts[index]++;
        const std::uint64_t which = single && attempt == 0 ? 0 : index;
        const auto place = places_.place(derived_seed(seed, kStartSeed + object_id_), repeat, which << 16U | (attempt & 0xffffU));
        if (place && walk_.put(place->at, walkers.walker[index])) return;
    }
    throw run_error("{}: no place for a Brownian walk found in {} attempts", label(), kMostStarts);
}

/// Gives `count` positions to take(walker, step) in their order.
template <class Take>
void BrownianSampler::walk(Seed seed, std::uint32_t repeat, std::uint64_t count, const Take& take) const {
    if (count == 0) return;
    const auto n = static_cast<std::size_t>(std::min<std::uint64_t>(settings_.walkers, count));
    Walkers walkers{std::vector<BrownianWalk::Walker>(n), std::vector<std::uint32_t>(n), std::vector<std::uint32_t>(n)};
    for (std::size_t i = 0; i < n; ++i) start(walkers, i, seed, repeat);
    Tally tally;
    std::uint32_t step = 0;
    const auto advance = [&](std::uint32_t steps, std::size_t needed) {
        for (; steps > 0; --steps) {
            ++step;
            for (std::size_t i = 0; i < needed; ++i) {
                const DrawKey key{object_id_, repeat, static_cast<std::uint64_t>(i) << 32U | step};
                if (walk_.advance(walkers.walker[i], seed, key)) {
                    walkers.lost[i] = 0;
                } else {
                    ++tally.lost;
                    if (++walkers.lost[i] < kMostLost) continue;
                    ++tally.restarts;
                    walkers.lost[i] = 0;
                    start(walkers, i, seed, repeat);
                }
            }
            tally.steps += needed;
        }
    };
    const bool moved_first = settings_.start == WalkSettings::Start::single;
    advance(settings_.burn_in + (moved_first ? settings_.thinning : 0), n);
    for (std::uint64_t done = 0; done < count;) {
        const auto round = static_cast<std::size_t>(std::min<std::uint64_t>(n, count - done));
        if (done > 0) advance(settings_.thinning, round);
        for (std::size_t i = 0; i < round; ++i) take(walkers.walker[i], static_cast<std::uint64_t>(i) << 32U | step);
        done += round;
    }
    tally_->steps += tally.steps;
    tally_->lost += tally.lost;
    tally_->restarts += tally.restarts;
}

void BrownianSampler::positions(Seed seed, std::uint32_t repeat, std::uint64_t count, std::vector<Position>& out) const {
    walk(seed, repeat, count, [&](const BrownianWalk::Walker& walker, std::uint64_t index) {
        // Words 0 and 1 of this key made the step that led here.
        const double chance = unit_interval(random_bits(seed, {object_id_, repeat, index})[2]);
        out.push_back({walk_.world(walker), walk_.world_normal(walker), chance});
    });
}

void BrownianSampler::trials_in_block(std::size_t, Seed seed, std::uint32_t repeat, std::uint32_t first,
                                      std::uint32_t count, std::vector<Point>& out) const {
    std::uint64_t trial = 0;
    walk(seed, repeat, std::uint64_t{first} + count, [&](const BrownianWalk::Walker& walker, std::uint64_t index) {
        if (trial++ < first) return;
        const double chance = unit_interval(random_bits(seed, {object_id_, repeat, index})[2]);
        if (const auto point = thinning_.keep(walk_.world(walker), walk_.world_normal(walker), chance)) out.push_back(*point);
    });
}

}  // namespace pellucid
