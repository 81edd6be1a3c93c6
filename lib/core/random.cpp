#include "core/random.hpp"

#include <Random123/philox.h>

namespace pellucid {

std::array<std::uint32_t, 4> random_bits(Seed seed, const DrawKey& key) {
    using Philox = r123::Philox4x32;
    const Philox::key_type k{{static_cast<std::uint32_t>(seed.value), static_cast<std::uint32_t>(seed.value >> 32)}};
    const Philox::ctr_type c{{static_cast<std::uint32_t>(key.index),
                              static_cast<std::uint32_t>(key.index >> 32) | (key.block << 24), key.repeat, key.object}};
    const Philox::ctr_type r = Philox()(c, k);
    return {r[0], r[1], r[2], r[3]};
}

Seed derived_seed(Seed seed, std::uint64_t part) {
    const auto bits = random_bits(seed, {.object = static_cast<std::uint32_t>(Purpose::derived_seed), .index = part & 0x00ffffffffffffffULL});
    return {(static_cast<std::uint64_t>(bits[1]) << 32) | bits[0]};
}

RandomStream::result_type RandomStream::operator()() {
    if (used_ == 4) {
        bits_ = random_bits(seed_, key_);
        used_ = 0;
        // The index runs on where the 256 blocks of one index are used up.
        key_.block = (key_.block + 1) & 0xffU;
        if (key_.block == 0) ++key_.index;
    }
    return bits_[static_cast<std::size_t>(used_++)];
}

}  // namespace pellucid
