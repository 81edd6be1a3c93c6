#include "sample/particle_sampler.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "sample/pack_points.hpp"
#include "sample/poisson_number.hpp"

namespace pellucid {
namespace {

/// The stream for the numbers of trials of one object in one repeat.
[[nodiscard]] RandomStream count_stream(const ParticleSource& source, const SamplerSettings& settings,
                                        std::uint32_t repeat) {
    return {settings.seed, {.object = static_cast<std::uint32_t>(Purpose::particle_count),
                            .repeat = repeat,
                            .index = static_cast<std::uint64_t>(source.object_id()) << 24U}};
}

/// floor(mean) trials and one more with probability p such that (1−q)^fraction = 1 − p q, q = 1/V.
[[nodiscard]] std::uint64_t fixed_trials(const ParticleSource& source, double mean, RandomStream& random) {
    const double whole = std::floor(mean);
    const double q = 1 / source.virtual_pixels();
    const double one_more = -std::expm1((mean - whole) * std::log1p(-q)) / q;
    return static_cast<std::uint64_t>(whole) + (unit_interval(random()) < one_more ? 1 : 0);
}

/// Trials that each block gets by the Poisson law: a Poisson number in every block is one in all.
[[nodiscard]] double block_mean(const ParticleSource& source, std::size_t block) {
    return mean_trials(source, TrialLaw::poisson) * source.block_virtual_pixels(block) /
           source.virtual_pixels();
}

class RepeatBuilder {
public:
    RepeatBuilder(const ParticleFrame& frame, const SamplerSettings& settings, std::uint32_t repeat)
        : frame_(frame), settings_(settings), repeat_(repeat) {}

    /// Objects are begun and ended one after the other; in between come blocks, for the Poisson law.
    void begin(const ParticleSource& source) {
        counts_.emplace(count_stream(source, settings_, repeat_));
        painted_ = source.painted();
    }
    void end() { ends_.push_back(static_cast<std::uint32_t>(particles_.size())); }

    /// `seen`: false draws the number of trials, for those that follow, and no more.
    void add_block(const ParticleSource& source, std::size_t block, double mean, bool seen) {
        const std::uint32_t trials = poisson_number(mean, *counts_);
        if (!seen) return;
        points_.clear();
        source.trials_in_block(block, settings_.seed, repeat_, 0, trials, points_);
        add(points_);
    }

    void add_whole(const ParticleSource& source) {
        if (settings_.exact_count) return add_exactly(source, *settings_.exact_count);
        const double mean = mean_trials(source, settings_.trials);
        if (!(mean > 0)) return;
        if (settings_.keep_all_crossings) {
            const auto& lines = dynamic_cast<const LineSampler&>(source);
            const double mean_lines = mean * lines.line_pixels() / lines.virtual_pixels();
            return add_all_crossings(lines, std::poisson_distribution<std::uint64_t>(mean_lines)(*counts_));
        }
        if (!source.has_single_trials())
            throw input_error("{}: particles.count = \"binomial\" needs a sampler whose trials do not follow each other",
                              source.label());
        const std::uint64_t trials = fixed_trials(source, mean, *counts_);
        for (std::uint64_t i = 0; i < trials; ++i)
            if (const auto point = source.trial(settings_.seed, repeat_, i)) push(*point);
    }

    void add(std::span<const SourcePoint> points) {
        if (points.size() > 0xffffffffU - particles_.size())
            throw run_error("more than 2^32 particles in one repeat: lower opacity or resolution");
        const std::size_t before = particles_.size();
        particles_.resize(before + points.size());
        pack_points(frame_, points, painted_, std::span(particles_).subspan(before));
    }

    [[nodiscard]] RepeatParticles finish(const twin::Projection& projection) {
        if (settings_.tiles) settings_.tiles->drop_others(particles_, ends_, projection);
        return sort_by_tile(particles_, ends_, projection);
    }

private:
    void add_all_crossings(const LineSampler& source, std::uint64_t lines) {
        std::vector<SourcePoint> points;
        for (std::uint64_t i = 0; i < lines; ++i) {
            source.trial_keeping_all(settings_.seed, repeat_, i, points);
            for (const SourcePoint& point : points) push(point);
        }
    }

    void add_exactly(const ParticleSource& source, std::uint64_t count) {
        // So many trials without a single particle in view mean that there is nothing to find.
        constexpr std::uint64_t kFruitless = 10'000'000;
        std::uint64_t found = 0;
        std::uint64_t last = 0;
        for (std::uint64_t i = 0; found < count; ++i) {
            if (!(source.virtual_pixels() > 0) || i - last > kFruitless)
                throw run_error("{}: no particle in view in {} trials, {} wanted",
                                source.label(), i, count);
            if (const auto point = source.trial(settings_.seed, repeat_, i)) {
                push(*point);
                ++found;
                last = i;
            }
        }
    }

    void push(const SourcePoint& point) { add({&point, 1}); }

    const ParticleFrame& frame_;
    const SamplerSettings& settings_;
    std::uint32_t repeat_;
    std::optional<RandomStream> counts_;
    bool painted_ = false;             // the object that was begun
    std::vector<SourcePoint> points_;  // of one block
    std::vector<Particle> particles_;
    std::vector<std::uint32_t> ends_;
};

}  // namespace

double mean_trials(const ParticleSource& source, TrialLaw law) {
    const double pixels = source.virtual_pixels();
    const double optical_depth = source.optical_depth();
    if (law == TrialLaw::poisson) return optical_depth * pixels;
    if (pixels == 0) return 0;
    if (pixels <= 1)
        throw run_error("{}: it spans less than one pixel, where PBSR (1) does not hold: use "
                        "particles.count = \"poisson\"",
                        source.label());
    return -optical_depth / std::log1p(-1 / pixels);
}

namespace {

/// The lines of one block that a group of repeats shares; repeats that are not built are dropped.
void add_dealt_lines(const ParticleSource& source, std::size_t block, const SamplerSettings& settings,
                     std::uint32_t group, RandomStream& counts, std::span<RepeatBuilder> builders,
                     std::uint32_t first_built) {
    const double mean = kLineGroup * block_mean(source, block) / source.block_crossings(block);
    std::array<std::vector<SourcePoint>, kLineGroup> dealt;
    source.lines_in_block(
        block, settings.seed, group, poisson_number(mean, counts),
        settings.deal_to_one_repeat ? ParticleSource::Deal::together : ParticleSource::Deal::apart, dealt);
    for (std::size_t i = 0; i < builders.size(); ++i) builders[i].add(dealt[(first_built + i) % kLineGroup]);
}

/// Which blocks may have particles in the tiles that are drawn.
class BlocksSeen {
public:
    BlocksSeen(const SourceRefs& sources, const Camera& camera, const TileMask* tiles) {
        if (tiles == nullptr || std::ranges::all_of(tiles->active, [](std::uint8_t each) { return each != 0; })) return;
        for (const ParticleSource* source : sources.all()) {
            std::vector<std::uint8_t>& of_source = seen_[source];
            of_source.resize(source->block_count());
            parallel_for(of_source.size(), 1, [&](std::size_t begin, std::size_t end) {
                for (std::size_t block = begin; block < end; ++block) {
                    const auto bounds = source->block_bounds(block);
                    of_source[block] = !bounds || tiles->touches(*bounds, camera) ? 1 : 0;
                }
            });
        }
    }
    [[nodiscard]] bool operator()(const ParticleSource& source, std::size_t block) const {
        const auto found = seen_.find(&source);
        return found == seen_.end() || found->second[block] != 0;
    }

private:
    std::map<const ParticleSource*, std::vector<std::uint8_t>> seen_;  // empty: all
};

/// Consecutive repeats together, block by block: a block stays in the near cache for all of them. In fast
/// mode they belong to one group.
void build_repeats(const SourceRefs& sources, const SamplerSettings& settings, const BlocksSeen& seen,
                   std::uint32_t first, std::span<RepeatBuilder> builders) {
    const bool blockwise =
        settings.trials == TrialLaw::poisson && !settings.exact_count && !settings.keep_all_crossings;
    const std::uint32_t group = first / kLineGroup;
    for (const ParticleSource* each : sources.all()) {
        const ParticleSource& source = *each;
        for (RepeatBuilder& builder : builders) builder.begin(source);
        const std::uint64_t index = (static_cast<std::uint64_t>(source.object_id()) << 24U) | 1U << 23U;
        const auto purpose = static_cast<std::uint32_t>(Purpose::particle_count);
        RandomStream group_counts(settings.seed, {.object = purpose, .repeat = group, .index = index});
        if (blockwise) {
            for (std::size_t block = 0; block < source.block_count(); ++block) {
                if (settings.lines == LineMode::fast && source.block_crossings(block) > 1) {
                    add_dealt_lines(source, block, settings, group, group_counts, builders, first);
                } else {
                    const double mean = block_mean(source, block);
                    for (RepeatBuilder& builder : builders) builder.add_block(source, block, mean, seen(source, block));
                }
            }
        } else {
            for (RepeatBuilder& builder : builders) builder.add_whole(source);
        }
        for (RepeatBuilder& builder : builders) builder.end();
    }
}

/// How many repeats are built together in exact mode: as many as leave work for all threads and do not
/// hold more than some 256 MiB, if every trial gave a particle.
[[nodiscard]] std::uint32_t exact_run(const SourceRefs& sources, const SamplerSettings& settings,
                                      std::uint32_t count) {
    if (settings.exact_count || settings.keep_all_crossings) return 1;
    double trials = 0;
    for (const ParticleSource* source : sources.all()) trials += mean_trials(*source, settings.trials);
    const double fit = 0x1p28 / (sizeof(Particle) * std::max(trials, 1.0));
    const std::uint32_t share = count / (4 * static_cast<std::uint32_t>(std::max(1, thread_count())));
    return std::clamp(static_cast<std::uint32_t>(std::min<double>(fit, share)), 1U, kLineGroup);
}

}  // namespace

namespace {

/// Group by group; of a group that is asked for in part, the rest is dropped.
[[nodiscard]] ParticleSet stratified_repeats(const PreparedScene& scene, const SourceRefs& sources,
                                             const SamplerSettings& settings, std::uint32_t first, std::uint32_t count) {
    ParticleSet set{ParticleFrame(scene.camera), static_cast<std::uint32_t>(sources.size()), {}};
    set.repeats.reserve(count);
    const std::uint32_t size = settings.stratify->group;
    for (std::uint32_t begin = first / size * size; begin < first + count; begin += size) {
        auto group = stratified_group(scene, sources, set.frame, settings.seed, *settings.stratify, begin, settings.tiles.get());
        for (std::uint32_t i = 0; i < size; ++i)
            if (begin + i >= first && begin + i < first + count) set.repeats.push_back(std::move(group[i]));
    }
    return set;
}

}  // namespace

ParticleSet sample_particles(const PreparedScene& scene, const SourceRefs& sources,
                             const SamplerSettings& settings, std::uint32_t first, std::uint32_t count) {
    const bool fast = settings.lines == LineMode::fast;
    if (fast && (settings.trials != TrialLaw::poisson || settings.exact_count))
        throw input_error(
            "particles.lines = \"fast\", expected \"exact\" where the number of particles is fixed");
    if (settings.stratify) return stratified_repeats(scene, sources, settings, first, count);
    ParticleSet set{ParticleFrame(scene.camera), static_cast<std::uint32_t>(sources.size()),
                    std::vector<RepeatParticles>(count)};
    const twin::Projection projection = set.frame.projection(scene.camera);
    const BlocksSeen seen(sources, scene.camera, settings.tiles.get());
    const std::uint32_t run = fast ? kLineGroup : exact_run(sources, settings, count);
    const std::uint32_t offset = fast ? first % run : 0;  // of the first repeat in its run
    parallel_for((offset + count + run - 1) / run, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const auto from = static_cast<std::uint32_t>(i * run < offset ? 0 : i * run - offset);
            const auto to = static_cast<std::uint32_t>(std::min<std::size_t>(count, (i + 1) * run - offset));
            std::vector<RepeatBuilder> builders;
            for (std::uint32_t k = from; k < to; ++k)
                builders.emplace_back(set.frame, settings, settings.same_set_in_all_repeats ? 0 : first + k);
            build_repeats(sources, settings, seen, first + from, builders);
            for (std::uint32_t k = to; k-- > from; builders.pop_back())
                set.repeats[k] = builders.back().finish(projection);
        }
    });
    return set;
}

}  // namespace pellucid
