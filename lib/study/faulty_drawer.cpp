#include "study/faulty_drawer.hpp"

#include <unordered_map>

#include "stage/particle_shading.hpp"

namespace pellucid {
namespace {

class FaultyDrawer final : public ParticleDrawer {
public:
    FaultyDrawer(const PreparedScene& scene, DrawFault fault)
        : fault_(fault),
          width_(static_cast<std::uint32_t>(scene.camera.width())),
          frame_(scene.camera),
          projection_(frame_.projection(scene.camera)),
          shading_(scene, frame_) {
        if (fault == DrawFault::float32_pixels) projection_.doubt = 0;  // float32 is never in doubt
    }

    void draw(const ParticleSet& set, EnsembleSums& sums) override {
        const std::vector<Winners> all = winners(set);
        for (std::size_t r = 0; r < all.size(); ++r)
            for (std::uint32_t i = 0; i < all[r].size(); ++i) {
                if (all[r][i] == kNoPixel) continue;
                const RepeatParticles& repeat = set.repeats[r];
                const std::uint32_t object = repeat.bin_of(i) % set.objects;
                sums.pixels[all[r][i]].add(winner_sums(shading_, object, repeat.particles[i]));
            }
        sums.particles += set.count();
        sums.repeats += set.repeats.size();
    }

    [[nodiscard]] std::vector<Winners> winners(const ParticleSet& set) override {
        std::vector<Winners> all;
        for (const RepeatParticles& repeat : set.repeats) all.push_back(winners_of(repeat));
        return all;
    }

    [[nodiscard]] std::int64_t bytes() const override { return 0; }

private:
    [[nodiscard]] twin::PixelDepth project(const Particle& particle) const {
        return fault_ == DrawFault::float32_pixels ? twin::project_quickly(projection_, particle)
                                                   : twin::project_particle(projection_, particle);
    }

    [[nodiscard]] Winners winners_of(const RepeatParticles& repeat) const {
        struct Held {
            std::uint64_t key;
            std::uint32_t index;
        };
        std::unordered_map<std::uint32_t, Held> nearest;
        for (std::uint32_t i = 0; i < repeat.particles.size(); ++i) {
            const twin::PixelDepth at = project(repeat.particles[i]);
            if (at.column < 0) continue;
            const std::uint32_t order = fault_ == DrawFault::ties_by_index ? i : twin::scramble_index(i);
            const Held mine{(std::uint64_t{at.depth} << 32U) | order, i};
            const auto [held, fresh] = nearest.try_emplace(
                static_cast<std::uint32_t>(at.row) * width_ + static_cast<std::uint32_t>(at.column), mine);
            if (!fresh && mine.key < held->second.key) held->second = mine;
        }
        Winners winners(repeat.particles.size(), kNoPixel);
        for (const auto& [pixel, held] : nearest) winners[held.index] = pixel;
        return winners;
    }

    DrawFault fault_;
    std::uint32_t width_;
    ParticleFrame frame_;
    twin::Projection projection_;
    ParticleShading shading_;
};

}  // namespace

std::unique_ptr<ParticleDrawer> make_faulty_drawer(const PreparedScene& scene, DrawFault fault) {
    return std::make_unique<FaultyDrawer>(scene, fault);
}

}  // namespace pellucid
