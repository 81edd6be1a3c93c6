#include "cpu/plain_particles.hpp"

#include <algorithm>

#include <oneapi/tbb/enumerable_thread_specific.h>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

constexpr std::uint64_t kNoHit = ~std::uint64_t{0};

class PlainDrawer final : public ParticleDrawer {
public:
    explicit PlainDrawer(const PreparedScene& scene)
        : camera_(scene.camera),
          frame_(scene.camera),
          projection_(frame_.projection(scene.camera)),
          shading_(scene, frame_) {}

    void draw(const ParticleSet& set, EnsembleSums& sums) override {
        struct Frames {
            WinnerFrame winners;
            EnsembleSums sums;
        };
        oneapi::tbb::enumerable_thread_specific<Frames> frames([&] {
            return Frames{WinnerFrame(camera_.width(), camera_.height()), EnsembleSums(camera_, sums.units)};
        });
        parallel_for(set.repeats.size(), 1, [&](std::size_t begin, std::size_t end) {
            Frames& mine = frames.local();
            for (std::size_t i = begin; i < end; ++i) {
                const RepeatParticles& repeat = set.repeats[i];
                mine.winners.draw(repeat.particles, projection_);
                add_frame(repeat, set.objects, mine.winners, mine.sums);
                mine.winners.clear();
                mine.sums.particles += repeat.particles.size();
                ++mine.sums.repeats;
            }
        });
        for (const Frames& each : frames) sums.add(each.sums);
    }

    [[nodiscard]] std::vector<Winners> winners(const ParticleSet& set) override {
        std::vector<Winners> all(set.repeats.size());
        parallel_for(set.repeats.size(), 1, [&](std::size_t begin, std::size_t end) {
            WinnerFrame frame(camera_.width(), camera_.height());
            for (std::size_t i = begin; i < end; ++i) {
                all[i].assign(set.repeats[i].particles.size(), kNoPixel);
                frame.draw(set.repeats[i].particles, projection_);
                for (const std::uint32_t pixel : frame.hit_pixels()) all[i][frame.winner(pixel)] = pixel;
                frame.clear();
            }
        });
        return all;
    }

    [[nodiscard]] std::int64_t bytes() const override {
        const std::int64_t pixels = std::int64_t{camera_.width()} * camera_.height();
        const std::int64_t one = sizeof(std::uint64_t) + sizeof(std::uint32_t) + sizeof(EnsembleSums::Pixel);
        return pixels * one * thread_count();
    }

private:
    /// Shades the winner of every hit pixel and adds it.
    void add_frame(const RepeatParticles& repeat, std::uint32_t objects, const WinnerFrame& winners,
                   EnsembleSums& sums) const {
        for (const std::uint32_t pixel : winners.hit_pixels()) {
            const std::uint32_t index = winners.winner(pixel);
            const Particle& particle = repeat.particles[index];
            sums.pixels[pixel].add(winner_sums(shading_, repeat.bin_of(index) % objects, particle));
        }
    }

    const Camera& camera_;
    ParticleFrame frame_;
    twin::Projection projection_;
    ParticleShading shading_;
};

}  // namespace

WinnerFrame::WinnerFrame(int width, int height)
    : keys_(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), kNoHit), width_(width) {}

void WinnerFrame::draw(std::span<const Particle> particles, const twin::Projection& projection) {
    for (std::size_t i = 0; i < particles.size(); ++i) {
        const twin::PixelDepth at = twin::project_particle(projection, particles[i]);
        if (at.column < 0) continue;
        const std::uint32_t pixel = static_cast<std::uint32_t>(at.row) * static_cast<std::uint32_t>(width_) +
                                    static_cast<std::uint32_t>(at.column);
        const std::uint64_t key = twin::particle_key(particles[i], static_cast<std::uint32_t>(i));
        if (keys_[pixel] == kNoHit) hit_.push_back(pixel);
        keys_[pixel] = std::min(keys_[pixel], key);
    }
}

void WinnerFrame::clear() {
    for (const std::uint32_t pixel : hit_) keys_[pixel] = kNoHit;
    hit_.clear();
}

std::unique_ptr<ParticleDrawer> make_plain_drawer(const PreparedScene& scene) {
    return std::make_unique<PlainDrawer>(scene);
}

}  // namespace pellucid
