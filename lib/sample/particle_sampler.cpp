#include "sample/particle_sampler.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace pellucid {
namespace {

[[nodiscard]] double particle_opacity(const LineSampler& sampler) {
    return std::min(sampler.object().surface.opacity, kMostParticleOpacity);
}

/// The stream for the numbers of trials of one object in one repeat.
[[nodiscard]] RandomStream count_stream(const LineSampler& sampler, const SamplerSettings& settings, std::uint32_t repeat) {
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

class RepeatBuilder {
public:
    RepeatBuilder(const ParticleFrame& frame, const SamplerSettings& settings, std::uint32_t repeat)
        : frame_(frame), settings_(settings), repeat_(repeat) {}

    void add(const LineSampler& sampler) {
        if (settings_.exact_count) {
            add_exactly(sampler, *settings_.exact_count);
        } else {
            add_trials(sampler);
        }
        ends_.push_back(static_cast<std::uint32_t>(particles_.size()));
    }

    [[nodiscard]] RepeatParticles finish() {
        // A copy of exact size: 16 bytes a particle stay, whatever the vector grew to.
        return {std::vector<Particle>(particles_.begin(), particles_.end()), std::move(ends_)};
    }

private:
    void add_trials(const LineSampler& sampler) {
        const double mean = mean_trials(sampler, settings_.trials);
        if (!(mean > 0)) return;
        RandomStream random = count_stream(sampler, settings_, repeat_);
        if (settings_.keep_all_crossings) {
            const double lines = mean * sampler.line_pixels() / sampler.virtual_pixels();
            add_all_crossings(sampler, std::poisson_distribution<std::uint64_t>(lines)(random));
        } else if (settings_.trials == TrialLaw::poisson) {
            // A Poisson number in every block is a Poisson number in all.
            for (std::size_t block = 0; block < sampler.block_count(); ++block) {
                const double share = sampler.block_virtual_pixels(block) / sampler.virtual_pixels();
                const std::uint64_t trials = std::poisson_distribution<std::uint64_t>(mean * share)(random);
                if (trials > 0xffffffffU) throw run_error("more than 2^32 trials in one repeat: lower opacity or resolution");
                points_.clear();
                sampler.trials_in_block(block, settings_.seed, repeat_, 0, static_cast<std::uint32_t>(trials), points_);
                for (const LineSampler::Point& point : points_) push(point);
            }
        } else {
            const std::uint64_t trials = fixed_trials(sampler, mean, random);
            for (std::uint64_t i = 0; i < trials; ++i)
                if (const auto point = sampler.trial(settings_.seed, repeat_, i)) push(*point);
        }
    }

    void add_all_crossings(const LineSampler& sampler, std::uint64_t lines) {
        for (std::uint64_t i = 0; i < lines; ++i) {
            std::array<LineSampler::Point, kMaxCrossings> points;
            const int found = sampler.trial_keeping_all(settings_.seed, repeat_, i, points);
            for (int k = 0; k < found; ++k) push(points[static_cast<std::size_t>(k)]);
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

ParticleSet sample_particles(const PreparedScene& scene, std::span<const LineSampler> samplers,
                             const SamplerSettings& settings, std::uint32_t first, std::uint32_t count) {
    ParticleSet set{ParticleFrame(scene.camera), std::vector<RepeatParticles>(count)};
    parallel_for(count, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const std::uint32_t repeat = settings.same_set_in_all_repeats ? 0 : first + static_cast<std::uint32_t>(i);
            RepeatBuilder builder(set.frame, settings, repeat);
            for (const LineSampler& sampler : samplers) builder.add(sampler);
            set.repeats[i] = builder.finish();
        }
    });
    return set;
}

}  // namespace pellucid
