// STEPs 2 and 3 of PBSR on any backend: projection with occlusion, shading of the winners, sums over repeats.
//   plain CPU  cpu/plain_particles.hpp   the specification: one loop after the other
//   fast CPU   cpu/fast_particles.hpp    what Backend::cpu() draws by
//   Vulkan     vulkan/particles.hpp
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "stage/ensemble.hpp"

namespace pellucid {

/// In place of a pixel: the particle won none.
inline constexpr std::uint32_t kNoPixel = ~0U;

/// For every particle of a repeat the pixel (row · width + column) that it won, or kNoPixel.
using Winners = std::vector<std::uint32_t>;

struct StageTime {
    std::string name;
    double device_s;  // seconds by the device's clock
};

/// Draws particle sets of one scene seen by one camera. Whatever the backend and the number of threads, the
/// nearest particle wins its pixel; at equal depth the lower of the indices, scrambled, wins: as good as a
/// coin, and the same everywhere. Sums and winners are equal bit for bit.
class ParticleDrawer {
public:
    virtual ~ParticleDrawer() = default;

    /// Draws every repeat of the set and adds it to the sums.
    virtual void draw(const ParticleSet& set, EnsembleSums& sums) = 0;
    /// The winners of every repeat.
    [[nodiscard]] virtual std::vector<Winners> winners(const ParticleSet& set) = 0;
    /// Device time by stage of all that was drawn; empty for the CPU.
    [[nodiscard]] virtual std::vector<StageTime> device_times() const { return {}; }
    /// Bytes held beside the particles and the sums: on the device if there is one.
    [[nodiscard]] virtual std::int64_t bytes() const = 0;
};

}  // namespace pellucid
