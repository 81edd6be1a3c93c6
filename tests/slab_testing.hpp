// zSlabs for tests: random ones, the awkward ones, and what they are held against.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <ostream>
#include <random>
#include <span>
#include <vector>

#include "kernel/slab_twin.h"
#include "stage/slab_settings.hpp"

namespace pellucid::twin {

inline bool operator==(const Slab& a, const Slab& b) { return std::memcmp(&a, &b, sizeof(Slab)) == 0; }
inline std::ostream& operator<<(std::ostream& out, const Slab& s) {
    return out << "[" << s.z << " - " << s.d << "; " << s.r << ", " << s.g << ", " << s.b << ", " << s.a << "]";
}

}  // namespace pellucid::twin

namespace pellucid::testing_slabs {

using twin::Slab;
using Real = long double;

constexpr SlabInterpolation kInterpolations[] = {SlabInterpolation::modified, SlabInterpolation::original,
                                                 SlabInterpolation::original_textbook};
constexpr SlabMixing kMixings[] = {SlabMixing::average, SlabMixing::normalised, SlabMixing::extinction};
constexpr SlabCompression kCompressions[] = {SlabCompression::tail, SlabCompression::slope,
                                             SlabCompression::transmittance};

/// Opacities at and beside every border.
inline const std::vector<float> kOpacities{0.0F, 1e-38F, 1e-30F, 1e-7F, 0.1F, 0.5F, 0.9F, 0.99999F, 0.99999994F, 1.0F};
inline const std::vector<float> kThicknesses{0.0F, 1.2e-38F, 1e-30F, 1e-6F, 0.1F, 1.0F, 37.0F, 1e30F};

class RandomSlabs {
public:
    explicit RandomSlabs(unsigned seed) : random_(seed) {}

    [[nodiscard]] float unit() { return unit_(random_); }
    [[nodiscard]] std::size_t below(std::size_t n) { return random_() % n; }
    template <class T>
    [[nodiscard]] T one_of(const std::vector<T>& values) {
        return values[below(values.size())];
    }

    /// One in three at a border.
    [[nodiscard]] float opacity() {
        const auto kind = below(6);
        return kind < 2 ? one_of(kOpacities) : kind == 2 ? 1 - std::exp2(-24 * unit()) : unit();
    }
    /// In [1, 1 + extent]; depths on a grid of `extent`/8 half the time, so that borders coincide.
    [[nodiscard]] Slab slab(float extent = 4) {
        const auto depth = [&] { return 1 + extent * (below(2) == 0 ? static_cast<float>(below(9)) / 8 : unit()); };
        float front = depth();
        float back = depth();
        if (front > back) std::swap(front, back);
        const float a = opacity();
        const float d = below(5) == 0 ? 0.0F : twin::thickness_between(front, back);
        return {back, d, a * unit(), a * unit(), a, a};
    }
    /// Sorted, with gaps, touching ones and surfaces.
    [[nodiscard]] std::vector<Slab> array(std::size_t most, float extent = 4) {
        const std::size_t count = below(most + 1);
        std::vector<float> ends(2 * count);
        for (float& end : ends) end = 1 + extent * (below(3) == 0 ? static_cast<float>(below(9)) / 8 : unit());
        std::sort(ends.begin(), ends.end());
        std::vector<Slab> slabs;
        for (std::size_t i = 0; i < count; ++i) {
            const float a = opacity();
            const float front = i > 0 && below(2) == 0 ? slabs.back().z : ends[2 * i];
            slabs.push_back({ends[2 * i + 1], twin::thickness_between(front, ends[2 * i + 1]), a * unit(), a * unit(), a, a});
        }
        return slabs;
    }

private:
    std::mt19937_64 random_;
    std::uniform_real_distribution<float> unit_{0, 1};
};

struct RealColor {
    Real r = 0, g = 0, b = 0, a = 0;
};
[[nodiscard]] inline RealColor composite_real(std::span<const Slab> slabs) {
    RealColor sum;
    for (const Slab& s : slabs) {
        const Real t = 1 - sum.a;
        sum = {sum.r + t * s.r, sum.g + t * s.g, sum.b + t * s.b, sum.a + t * s.a};
    }
    return sum;
}

/// Units in the last place of the float next to `exact` (of the smallest normal number below it).
[[nodiscard]] inline Real ulps_off(Real value, Real exact) {
    const Real size = std::max(std::abs(exact), static_cast<Real>(0x1p-126F));
    return std::abs(value - exact) / std::ldexp(Real{1}, std::ilogb(size) - 23);
}

}  // namespace pellucid::testing_slabs
