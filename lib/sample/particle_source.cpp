#include "sample/particle_source.hpp"

#include <cassert>

namespace pellucid {

void ParticleSource::lines_in_block(std::size_t, Seed, std::uint32_t, std::uint32_t, Deal,
                                    std::span<std::vector<Point>, kLineGroup>) const {
    assert(false);
}

}  // namespace pellucid
