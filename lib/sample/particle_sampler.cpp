#include "sample/particle_sampler.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "sample/pack_points.hpp"

namespace pellucid {
namespace {

[[nodiscard]] double particle_opacity(const LineSampler& sampler) {
    return std::min(sampler.object().surface.opacity, kMostParticleOpacity);
}

/// The stream for the numbers of trials of one object in one repeat.
[[nodiscard]] RandomStream count_stream(const LineSampler& sampler, const SamplerSettings& settings,
                                        std::uint32_t repeat) {
    return {settings.seed, {.object = static_cast<std::uint32_t>(Purpose::particle_count),
                            .repeat = repeat,
                            .index = static_cast<std::uint64_t>(sampler.object_id()) << 24U}};
}

/// floor(mean) trials and one more with probability p such that (1−q)^fraction = 1 − p q, q = 1/V.
[[nodiscard]] std::uint64_t fixed_trials(const LineSampler& sampler, double mean, RandomStream& random) {
    const double whole = std::floor(mean);
    const double q = 1 / sampler.virtual_pixels();
    const double one_more = -std::expm1((mean - whole) * std::log1p(-q)) / q;
    return static_cast<std::uint64_t>(whole) + (unit_interval(random()) < one_more ? 1 : 0);
}

[[nodiscard]] std::uint32_t poisson_number(double mean, RandomStream& random) {
    const std::uint64_t number = std::poisson_distribution<std::uint64_t>(mean)(random);
    if (number > 0xffffffffU)
        throw run_error("more than 2^32 trials in one repeat: lower opacity or resolution");
    return static_cast<std::uint32_t>(number);
}

/// Trials that each block gets by the Poisson law: a Poisson number in every block is one in all.
[[nodiscard]] double block_mean(const LineSampler& sampler, std::size_t block) {
    return mean_trials(sampler, TrialLaw::poisson) * sampler.block_virtual_pixels(block) /
           sampler.virtual_pixels();
}

class RepeatBuilder {
public:
    RepeatBuilder(const ParticleFrame& frame, const SamplerSettings& settings, std::uint32_t repeat)
        : frame_(frame), settings_(settings), repeat_(repeat) {}

    /// Objects are begun and ended one after the other; in between come blocks, for the Poisson law.
    void begin(const LineSampler& sampler) { counts_.emplace(count_stream(sampler, settings_, repeat_)); }
    void end() { ends_.push_back(static_cast<std::uint32_t>(particles_.size())); }

    void add_block(const LineSampler& sampler, std::size_t block, double mean) {
        points_.clear();
        sampler.trials_in_block(block, settings_.seed, repeat_, 0, poisson_number(mean, *counts_), points_);
        add(points_);
    }

    void add_whole(const LineSampler& sampler) {
        if (settings_.exact_count) return add_exactly(sampler, *settings_.exact_count);
        const double mean = mean_trials(sampler, settings_.trials);
        if (!(mean > 0)) return;
        if (settings_.keep_all_crossings) {
            const double lines = mean * sampler.line_pixels() / sampler.virtual_pixels();
            return add_all_crossings(sampler, std::poisson_distribution<std::uint64_t>(lines)(*counts_));
        }
        const std::uint64_t trials = fixed_trials(sampler, mean, *counts_);
        for (std::uint64_t i = 0; i < trials; ++i)
            if (const auto point = sampler.trial(settings_.seed, repeat_, i)) push(*point);
    }

    void add(std::span<const LineSampler::Point> points) {
        if (points.size() > 0xffffffffU - particles_.size())
            throw run_error("more than 2^32 particles in one repeat: lower opacity or resolution");
        const std::size_t before = particles_.size();
        particles_.resize(before + points.size());
        pack_points(frame_, points, std::span(particles_).subspan(before));
    }

    [[nodiscard]] RepeatParticles finish(const twin::Projection& projection) const {
        return sort_by_tile(particles_, ends_, projection);
    }

private:
    void add_all_crossings(const LineSampler& sampler, std::uint64_t lines) {
        std::vector<LineSampler::Point> points;
        for (std::uint64_t i = 0; i < lines; ++i) {
            sampler.trial_keeping_all(settings_.seed, repeat_, i, points);
            for (const LineSampler::Point& point : points) push(point);
        }
    }

    void add_exactly(const LineSampler& sampler, std::uint64_t count) {
        // So many trials without a single particle in view mean that there is nothing to find.
        constexpr std::uint64_t kFruitless = 10'000'000;
        std::uint64_t found = 0;
        std::uint64_t last = 0;
        for (std::uint64_t i = 0; found < count; ++i) {
            if (!(sampler.virtual_pixels() > 0) || i - last > kFruitless)
                throw run_error("surface \"{}\": no particle in view in {} trials, {} wanted",
                                sampler.object().surface.name, i, count);
            if (const auto point = sampler.trial(settings_.seed, repeat_, i)) {
                push(*point);
                ++found;
                last = i;
            }
        }
    }

    void push(const LineSampler::Point& point) {
        if (particles_.size() == 0xffffffffU)
            throw run_error("more than 2^32 particles in one repeat: lower opacity or resolution");
        particles_.push_back(frame_.pack(point.view, point.view_normal));
    }

    const ParticleFrame& frame_;
    const SamplerSettings& settings_;
    std::uint32_t repeat_;
    std::optional<RandomStream> counts_;
    std::vector<LineSampler::Point> points_;  // of one block
    std::vector<Particle> particles_;
    std::vector<std::uint32_t> ends_;
};

}  // namespace

std::vector<LineSampler> make_samplers(const PreparedScene& scene) {
    std::vector<LineSampler> samplers;
    samplers.reserve(scene.objects.size());
    for (std::size_t i = 0; i < scene.objects.size(); ++i)
        samplers.emplace_back(scene.objects[i], scene.camera, static_cast<std::uint32_t>(i));
    return samplers;
}

double mean_trials(const LineSampler& sampler, TrialLaw law) {
    const double pixels = sampler.virtual_pixels();
    const double optical_depth = -std::log1p(-particle_opacity(sampler));
    if (law == TrialLaw::poisson) return optical_depth * pixels;
    if (pixels == 0) return 0;
    if (pixels <= 1)
        throw run_error("surface \"{}\": it spans less than one pixel, where PBSR (1) does not hold: use "
                        "particles.count = \"poisson\"",
                        sampler.object().surface.name);
    return -optical_depth / std::log1p(-1 / pixels);
}

namespace {

/// The lines of one block that a group of repeats shares; repeats that are not built are dropped.
void add_dealt_lines(const LineSampler& sampler, std::size_t block, const SamplerSettings& settings,
                     std::uint32_t group, RandomStream& counts, std::span<RepeatBuilder> builders,
                     std::uint32_t first_built) {
    const double mean = kLineGroup * block_mean(sampler, block) / sampler.block_crossings(block);
    std::array<std::vector<LineSampler::Point>, kLineGroup> dealt;
    sampler.lines_in_block(
        block, settings.seed, group, poisson_number(mean, counts),
        settings.deal_to_one_repeat ? LineSampler::Deal::together : LineSampler::Deal::apart, dealt);
    for (std::size_t i = 0; i < builders.size(); ++i) builders[i].add(dealt[(first_built + i) % kLineGroup]);
}

/// Consecutive repeats together, block by block: a block stays in the near cache for all of them. In fast
/// mode they belong to one group.
void build_repeats(std::span<const LineSampler> samplers, const SamplerSettings& settings,
                   std::uint32_t first, std::span<RepeatBuilder> builders) {
    const bool blockwise =
        settings.trials == TrialLaw::poisson && !settings.exact_count && !settings.keep_all_crossings;
    const std::uint32_t group = first / kLineGroup;
    for (const LineSampler& sampler : samplers) {
        for (RepeatBuilder& builder : builders) builder.begin(sampler);
        const std::uint64_t index = (static_cast<std::uint64_t>(sampler.object_id()) << 24U) | 1U << 23U;
        const auto purpose = static_cast<std::uint32_t>(Purpose::particle_count);
        RandomStream group_counts(settings.seed, {.object = purpose, .repeat = group, .index = index});
        if (blockwise) {
            for (std::size_t block = 0; block < sampler.block_count(); ++block) {
                if (settings.lines == LineMode::fast && sampler.block_crossings(block) > 1) {
                    add_dealt_lines(sampler, block, settings, group, group_counts, builders, first);
                } else {
                    const double mean = block_mean(sampler, block);
                    for (RepeatBuilder& builder : builders) builder.add_block(sampler, block, mean);
                }
            }
        } else {
            for (RepeatBuilder& builder : builders) builder.add_whole(sampler);
        }
        for (RepeatBuilder& builder : builders) builder.end();
    }
}

/// How many repeats are built together in exact mode: as many as leave work for all threads and do not
/// hold more than some 256 MiB, if every trial gave a particle.
[[nodiscard]] std::uint32_t exact_run(std::span<const LineSampler> samplers, const SamplerSettings& settings,
                                      std::uint32_t count) {
    if (settings.exact_count || settings.keep_all_crossings) return 1;
    double trials = 0;
    for (const LineSampler& sampler : samplers) trials += mean_trials(sampler, settings.trials);
    const double fit = 0x1p28 / (sizeof(Particle) * std::max(trials, 1.0));
    const std::uint32_t share = count / (4 * static_cast<std::uint32_t>(std::max(1, thread_count())));
    return std::clamp(static_cast<std::uint32_t>(std::min<double>(fit, share)), 1U, kLineGroup);
}

}  // namespace

ParticleSet sample_particles(const PreparedScene& scene, std::span<const LineSampler> samplers,
                             const SamplerSettings& settings, std::uint32_t first, std::uint32_t count) {
    const bool fast = settings.lines == LineMode::fast;
    if (fast && (settings.trials != TrialLaw::poisson || settings.exact_count))
        throw input_error(
            "particles.lines = \"fast\", expected \"exact\" where the number of particles is fixed");
    ParticleSet set{ParticleFrame(scene.camera), static_cast<std::uint32_t>(samplers.size()),
                    std::vector<RepeatParticles>(count)};
    const twin::Projection projection = set.frame.projection(scene.camera);
    const std::uint32_t run = fast ? kLineGroup : exact_run(samplers, settings, count);
    const std::uint32_t offset = fast ? first % run : 0;  // of the first repeat in its run
    parallel_for((offset + count + run - 1) / run, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const auto from = static_cast<std::uint32_t>(i * run < offset ? 0 : i * run - offset);
            const auto to = static_cast<std::uint32_t>(std::min<std::size_t>(count, (i + 1) * run - offset));
            std::vector<RepeatBuilder> builders;
            for (std::uint32_t k = from; k < to; ++k)
                builders.emplace_back(set.frame, settings, settings.same_set_in_all_repeats ? 0 : first + k);
            build_repeats(samplers, settings, first + from, builders);
            for (std::uint32_t k = to; k-- > from; builders.pop_back())
                set.repeats[k] = builders.back().finish(projection);
        }
    });
    return set;
}

}  // namespace pellucid
