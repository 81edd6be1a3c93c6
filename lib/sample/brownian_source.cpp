#include "sample/brownian_source.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"

namespace pellucid {
namespace {

/// Trials that a walker is given to find a place to start from.
constexpr std::uint64_t kMostStarts = 100'000;
/// Steps in a row without a way back to the surface, after which a walker is put elsewhere.
constexpr std::uint8_t kMostLost = 8;
/// What is worth a word: one step in so many.
constexpr double kLostWorthAWord = 1e-4;
/// Sets the numbers of walks apart from those of lines (block·2³² + index, blocks below 2²³).
constexpr std::uint64_t kWalkIndex = std::uint64_t{1} << 55U;

[[nodiscard]] DrawKey step_key(std::uint32_t object, std::uint32_t repeat, std::uint32_t walker, std::uint32_t step) {
    return {.object = object, .repeat = repeat, .index = kWalkIndex | std::uint64_t{walker} << 32U | step, .block = 0};
}

[[nodiscard]] const Object& with_field(const Object& object) {
    if (!object.geometry->field_surface())
        throw input_error(
            "surface \"{}\": particles.sampler = \"brownian\" walks on f = 0, expected implicit, expression, isosurface or points",
            object.surface.name);
    return object;
}

}  // namespace

namespace {

[[nodiscard]] WalkStep step_of(const Object& object, const WalkSettings& settings) {
    const FieldSurface surface = *object.geometry->field_surface();
    const double cell = surface.cell_width * std::cbrt(std::abs(surface.to_world.determinant()));
    WalkStep step = settings.twin;
    step.length = settings.step ? *settings.step * surface_width(surface)
                  : cell > 0    ? kWalkCellStep * cell
                                : kWalkStep * surface_width(surface);
    step.drift = settings.drift;
    return step;
}

}  // namespace

BrownianSource::BrownianSource(const Object& object, const Camera& camera, std::uint32_t object_id, const WalkSettings& settings)
    : object_(&with_field(object)),
      camera_(&camera),
      object_id_(object_id),
      settings_(settings),
      places_(object, object_id),
      thinning_(object, camera),
      step_(step_of(object, settings)),
      walk_(object, step_),
      view_(camera, object.geometry->field_surface()->to_world, object.surface.opacity_law == OpacityLaw::constant) {
    if (const auto least = thinning_.least_pixel_area(); least && places_.area() > 0) {
        virtual_pixels_ = places_.area() / *least;
        share_ = *least / (2 * M_PI * settings.thinning * step_.length * step_.length);
    }
    walkers_ = settings.walkers.value_or(enough_walkers());
}

double clumping(double share, double chance, double positions) {
    const double m = std::max(1.0, positions);
    // From c/i = chance on the walker is anywhere.
    const double last = std::floor(std::min(m - 1, share / chance));
    const double sure = std::floor(std::min(last, share));
    const auto harmonic = [](double n) { return n < 1 ? 0 : std::log(n) + 0.57721566490153286 + 1 / (2 * n) - 1 / (12 * n * n); };
    const double sum = m * sure - 0.5 * sure * (sure + 1) + share * (m * (harmonic(last) - harmonic(sure)) - (last - sure));
    return 2 / m * sum;
}

double BrownianSource::clumping() const {
    const double places = std::ceil(optical_depth() * virtual_pixels_ / walkers_);
    return virtual_pixels_ > 0 ? pellucid::clumping(share_, 1 / virtual_pixels_, places) : 0;
}

/// The fewest that do not clump: e grows with the positions of a walker.
std::uint32_t BrownianSource::enough_walkers() const {
    const double all = std::ceil(optical_depth() * virtual_pixels_);
    if (!(all > kLeastWalkers)) return kLeastWalkers;
    double good = 1;
    double bad = std::ceil(all / kLeastWalkers) + 1;
    while (bad - good > 1) {
        const double middle = std::floor(0.5 * (good + bad));
        (pellucid::clumping(share_, 1 / virtual_pixels_, middle) <= kMostClumping ? good : bad) = middle;
    }
    return static_cast<std::uint32_t>(std::clamp<double>(std::ceil(all / good), kLeastWalkers, 0x1p31));
}

std::string BrownianSource::label() const { return fmt::format("surface \"{}\"", object_->surface.name); }

double BrownianSource::optical_depth() const { return -std::log1p(-std::min(object_->surface.opacity, kMostParticleOpacity)); }

/// The walkers of one repeat.
struct BrownianSource::Herd {
    explicit Herd(std::size_t count) : lost(count) {
        const std::size_t room = (count / kHerdLanes + 2) * kHerdLanes;  // loads begin at any walker
        for (auto& values : at) values.resize(room);
        for (auto& values : gradient) values.resize(room, 1);  // beyond the last walker: any surface's
        chance.resize(room);
    }
    [[nodiscard]] BrownianWalk::Walker get(std::size_t i) const {
        return {{at[0][i], at[1][i], at[2][i]}, {gradient[0][i], gradient[1][i], gradient[2][i]}};
    }
    void put(std::size_t i, const BrownianWalk::Walker& walker) {
        for (int k = 0; k < 3; ++k) {
            at[static_cast<std::size_t>(k)][i] = walker.at[k];
            gradient[static_cast<std::size_t>(k)][i] = walker.gradient[k];
        }
    }
    [[nodiscard]] HerdArrays arrays() {
        return {{at[0].data(), at[1].data(), at[2].data()}, {gradient[0].data(), gradient[1].data(), gradient[2].data()}, chance.data()};
    }

    std::array<std::vector<double>, 3> at, gradient;
    std::vector<double> chance;
    std::vector<std::uint8_t> lost;  // steps not made in a row
    std::vector<std::uint32_t> left;  // by the last step of many at once
    std::uint64_t trial = 0;          // of places to start from
    Stats stats;
};

/// A walker on the next uniform place.
BrownianWalk::Walker BrownianSource::start(Herd& herd, Seed seed, std::uint32_t repeat) const {
    BrownianWalk::Walker walker;
    for (const std::uint64_t end = herd.trial + kMostStarts; herd.trial < end;)
        if (const auto place = places_.point(seed, repeat, herd.trial++); place && walk_.put(*place, walker)) return walker;
    throw run_error("{}: particles.sampler = \"brownian\" finds no place to start in {} trials", label(), kMostStarts);
}

/// One step of one walker.
void BrownianSource::advance(Herd& herd, std::uint32_t i, Seed seed, std::uint32_t repeat, std::uint32_t step) const {
    BrownianWalk::Walker walker = herd.get(i);
    const WalkOutcome outcome = walk_.advance(walker, seed, step_key(object_id_, repeat, i, step));
    if (outcome == WalkOutcome::lost) {
        ++herd.stats.lost;
        if (++herd.lost[i] < kMostLost) return;
        ++herd.stats.restarts;
        walker = start(herd, seed, repeat);
    } else if (outcome != WalkOutcome::moved) {
        ++herd.stats.at_borders;
    }
    herd.lost[i] = 0;
    herd.put(i, walker);
}

template <class Take>
void BrownianSource::walk(Seed seed, std::uint32_t repeat, std::uint32_t count, const Take& take) const {
    if (count == 0) return;
    const std::uint32_t n = std::min(walkers_, count);
    Herd herd(n);
    const bool single = settings_.start == WalkSettings::Start::single;
    for (std::uint32_t i = 0; i < n; ++i) herd.put(i, single && i > 0 ? herd.get(0) : start(herd, seed, repeat));

    std::uint32_t step = 0;
    for (std::uint64_t done = 0; done < count; done += n) {
        const auto round = static_cast<std::uint32_t>(std::min<std::uint64_t>(n, count - done));
        for (const std::uint32_t end = step + settings_.thinning; step < end; ++step) {
            if (walk_.has_herds()) {
                herd.left.clear();
                walk_herd(walk_.quick(), seed, step_key(object_id_, repeat, 0, step), herd.arrays(), round, herd.left);
                for (const std::uint32_t i : herd.left) advance(herd, i, seed, repeat, step);
            } else {
                for (std::uint32_t i = 0; i < round; ++i) advance(herd, i, seed, repeat, step);
            }
            herd.stats.steps += round;
        }
        take(static_cast<std::uint32_t>(done), herd, round, step - 1);
    }
    steps_ += herd.stats.steps;
    at_borders_ += herd.stats.at_borders;
    lost_ += herd.stats.lost;
    restarts_ += herd.stats.restarts;
}

std::vector<Vec3> BrownianSource::positions(Seed seed, std::uint32_t repeat, std::uint32_t count) const {
    std::vector<Vec3> out;
    out.reserve(count);
    walk(seed, repeat, count, [&](std::uint32_t, Herd& herd, std::uint32_t walkers, std::uint32_t) {
        for (std::uint32_t i = 0; i < walkers; ++i) out.push_back(walk_.world(herd.get(i)));
    });
    return out;
}

void BrownianSource::trials_in_block(std::size_t, Seed seed, std::uint32_t repeat, std::uint32_t first, std::uint32_t count,
                                     std::vector<Point>& out) const {
    const double side = camera_->pixel_size();
    const double bound = thinning_.least_pixel_area().value_or(0) / (side * side);
    PointChunk chunk;
    walk(seed, repeat, first + count, [&](std::uint32_t index, Herd& herd, std::uint32_t walkers, std::uint32_t step) {
        const std::uint32_t skip = index < first ? std::min(first - index, walkers) : 0;
        if (walk_.has_herds()) {
            for (std::uint32_t i = skip; i < walkers; i += kLineChunk) {
                keep_herd(view_, bound, herd.arrays(), i, std::min(kLineChunk, walkers - i), chunk);
                for (std::size_t k = 0; k < chunk.count; ++k)
                    out.push_back({{chunk.view[0][k], chunk.view[1][k], chunk.view[2][k]},
                                   {chunk.normal[0][k], chunk.normal[1][k], chunk.normal[2][k]}});
            }
            return;
        }
        for (std::uint32_t i = skip; i < walkers; ++i) {
            // Words 0 and 1 of this key made the step that led here.
            const double chance = unit_interval(random_bits(seed, step_key(object_id_, repeat, i, step))[2]);
            const BrownianWalk::Walker walker = herd.get(i);
            if (const auto point = thinning_.keep(walk_.world(walker), walk_.world_normal(walker), chance)) out.push_back(*point);
        }
    });
}

BrownianSource::Stats BrownianSource::stats() const { return {steps_, at_borders_, lost_, restarts_}; }

std::string BrownianSource::complaint() const {
    std::string words;
    if (const double own = clumping(); own > kClumpingWorthAWord)
        words = fmt::format("a particle shares its pixel with {:.2g} more of its own walker than by chance, so opacity is too low: "
                            "more particles.walk.walkers (now {}), more thinning or a larger step, or no walkers stated",
                            own, walkers_);
    // From one place a walk of T steps spreads over T·step².
    const double rounds = std::ceil(optical_depth() * virtual_pixels_ / walkers_);
    const double reached = rounds * settings_.thinning * step_.length * step_.length;
    if (settings_.start == WalkSettings::Start::single && reached < places_.area())
        words += fmt::format("{}walkers that start at one place reach an area of {:.3g}, the surface has {:.3g}: more steps, "
                             "a larger particles.walk.step or start = \"uniform\"",
                             words.empty() ? "" : "; ", reached, places_.area());
    if (static_cast<double>(lost_) > kLostWorthAWord * static_cast<double>(steps_))
        words += fmt::format("{}{} of {} Brownian steps found no way back to the surface and were not made, {} walkers were "
                             "put elsewhere: a smaller particles.walk.step loses fewer",
                             words.empty() ? "" : "; ", lost_.load(), steps_.load(), restarts_.load());
    return words.empty() ? words : fmt::format("{}: {}", label(), words);
}

}  // namespace pellucid
