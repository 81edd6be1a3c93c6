// Random numbers as a function of place, not of history: Philox4x32-10 (Salmon et al. 2011,
// "Parallel random numbers: as easy as 1, 2, 3"; Random123) keyed by the seed, with what is being
// drawn as the counter. No state, so threads, shards and backends agree.
#pragma once

#include <array>
#include <cstdint>

namespace pellucid {

/// What the user gives with --seed.
struct Seed {
    std::uint64_t value = 0;
};

/// Which draw this is. Different keys give independent numbers.
struct DrawKey {
    std::uint32_t object = 0;  // the object, or a purpose: see `Purpose`
    std::uint32_t repeat = 0;
    std::uint64_t index = 0;  // < 2^56: particle, line or pixel
    std::uint32_t block = 0;  // < 256: which 128 bits of that index
};

/// Streams that belong to no object; objects count from 0.
enum class Purpose : std::uint32_t {
    truth_jitter = 0xffffff00U,
    p_value = 0xffffff01U,
    particle_count = 0xffffff02U,
    test = 0xffffff03U,
    derived_seed = 0xffffff04U,
    stratify = 0xffffff05U,
};

/// 128 random bits.
[[nodiscard]] std::array<std::uint32_t, 4> random_bits(Seed seed, const DrawKey& key);

/// Uniform on (0, 1): (bits + ½)/2³² is neither 0 nor 1.
[[nodiscard]] constexpr double unit_interval(std::uint32_t bits) {
    return (static_cast<double>(bits) + 0.5) * 0x1p-32;
}

/// A seed for part `part` of a run: rows of an experiment, for instance.
[[nodiscard]] Seed derived_seed(Seed seed, std::uint64_t part);

/// The same numbers as a standard generator, for the distributions of <random> and Boost.
class RandomStream {
public:
    using result_type = std::uint32_t;
    RandomStream(Seed seed, const DrawKey& key) : seed_(seed), key_(key) {}
    [[nodiscard]] static constexpr result_type min() { return 0; }
    [[nodiscard]] static constexpr result_type max() { return 0xffffffffU; }
    result_type operator()();

private:
    Seed seed_;
    DrawKey key_;
    std::array<std::uint32_t, 4> bits_{};
    int used_ = 4;
};

}  // namespace pellucid
