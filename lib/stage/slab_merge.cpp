#include "stage/slab_merge.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>

#include "core/order_weights.hpp"
#include "kernel/intermix_twin.h"
#include "kernel/plain_cast_twin.h"

namespace pellucid {
namespace {

using twin::Slab;

static_assert(twin::kInterpolateModified == twin::uint(SlabInterpolation::modified));
static_assert(twin::kInterpolateOriginal == twin::uint(SlabInterpolation::original));
static_assert(twin::kInterpolateTextbook == twin::uint(SlabInterpolation::original_textbook));
static_assert(twin::kMixAverage == twin::uint(SlabMixing::average));
static_assert(twin::kMixNormalised == twin::uint(SlabMixing::normalised));
static_assert(twin::kMixExtinction == twin::uint(SlabMixing::extinction));

/// Early ray termination.
class Passing {
public:
    explicit Passing(float opaque_at) : least_(1.0F - opaque_at) {}
    /// False from the slab on after which too little passes.
    [[nodiscard]] bool through(const Slab& slab) {
        transmittance_ *= 1.0F - slab.a;
        return transmittance_ > least_;
    }

private:
    float least_;
    float transmittance_ = 1.0F;
};

/// merge_step, which slabs that do not meet need not go through.
[[nodiscard]] twin::MergeStep quick_step(const Slab& a, const Slab& b, const SlabSettings& settings) {
    const bool a_first = a.z <= b.z;
    const Slab& prior = a_first ? a : b;
    const Slab& posterior = a_first ? b : a;
    if (prior.z < posterior.z && twin::slab_front(posterior) >= prior.z)
        return {prior, posterior, posterior, twin::uint(a_first), twin::uint(!a_first)};
    return twin::merge_step(a, b, twin::uint(settings.interpolation), twin::uint(settings.mixing));
}

// ---- Order-free -------------------------------------------------------------------------------

/// Mixes any number of slabs of one interval, sums in the order given.
class ManyMixer {
public:
    explicit ManyMixer(SlabMixing mixing) : mixing_(mixing) {}

    /// Depths are the caller's.
    [[nodiscard]] Slab mix(std::span<const Slab> parts) {
        if (parts.size() == 1) return parts[0];
        if (parts.size() == 2) return twin::mix_slabs(parts[0], parts[1], twin::uint(mixing_));
        double a = 0;
        for (const Slab& part : parts) a += (1 - a) * static_cast<double>(part.a);
        weigh(parts, a);
        double r = 0;
        double g = 0;
        double b = 0;
        for (std::size_t i = 0; i < parts.size(); ++i) {
            r += weights_[i] * static_cast<double>(parts[i].r);
            g += weights_[i] * static_cast<double>(parts[i].g);
            b += weights_[i] * static_cast<double>(parts[i].b);
        }
        return {0, 0, static_cast<float>(r), static_cast<float>(g), static_cast<float>(b), static_cast<float>(a)};
    }

private:
    void weigh(std::span<const Slab> parts, double a) {
        weights_.assign(parts.size(), 0);
        switch (mixing_) {
            case SlabMixing::average:
                alphas_.clear();
                for (const Slab& part : parts) alphas_.push_back(static_cast<double>(part.a));
                weigh_all_orders(alphas_, weights_);
                break;
            case SlabMixing::normalised: weigh_normalised(parts, a); break;
            case SlabMixing::extinction: weigh_extinction(parts, a); break;
        }
    }

    void weigh_normalised(std::span<const Slab> parts, double a) {
        double sum = 0;
        for (const Slab& part : parts) sum += static_cast<double>(part.a);
        std::fill(weights_.begin(), weights_.end(), sum > 0 ? a / sum : 1.0);
    }

    /// Opaque ones hide all others and have the mean of their colours.
    void weigh_extinction(std::span<const Slab> parts, double a) {
        double opaque = 0;
        double sum = 0;
        for (const Slab& part : parts) {
            opaque += part.a >= 1.0F ? 1 : 0;
            if (part.a < 1.0F) sum -= twin::log1p_d(-static_cast<double>(part.a));
        }
        for (std::size_t i = 0; i < parts.size(); ++i) {
            const auto alpha = static_cast<double>(parts[i].a);
            const double ratio = alpha > 0 ? -twin::log1p_d(-alpha) / alpha : 1;
            if (opaque > 0) weights_[i] = alpha >= 1 ? 1 / opaque : 0;
            else weights_[i] = sum > 0 ? a * ratio / sum : 1;
        }
    }

    SlabMixing mixing_;
    std::vector<double> weights_;
    std::vector<double> alphas_;
};

/// By depth, then by bits: one order for one set of slabs.
[[nodiscard]] bool canonical_less(const Slab& a, const Slab& b) {
    const auto key = [](const Slab& s) {
        return std::array{twin::slab_front(s), s.z, s.d, s.a, s.r, s.g, s.b};
    };
    return key(a) < key(b);
}

/// The sweep from interval to interval.
class OrderFreeSweep {
public:
    OrderFreeSweep(std::vector<Slab> slabs, const SlabSettings& settings)
        : slabs_(std::move(slabs)), settings_(settings), mixer_(settings.mixing), passing_(settings.opaque_at) {
        std::sort(slabs_.begin(), slabs_.end(), canonical_less);
        ends_.reserve(2 * slabs_.size());
        for (const Slab& slab : slabs_) {
            ends_.push_back(twin::slab_front(slab));
            ends_.push_back(slab.z);
        }
        std::sort(ends_.begin(), ends_.end());
        ends_.erase(std::unique(ends_.begin(), ends_.end()), ends_.end());
        active_.reserve(slabs_.size());
        parts_.reserve(slabs_.size());
        out_.reserve(2 * slabs_.size());
    }

    [[nodiscard]] SlabArray run() && {
        for (std::size_t i = 0; i < ends_.size(); ++i) {
            take_slabs_at(ends_[i]);
            if (!emit(ends_[i], ends_[i])) break;
            if (i + 1 == ends_.size()) break;
            cut_active(ends_[i], ends_[i + 1]);
            if (!emit(ends_[i], ends_[i + 1])) break;
        }
        return std::move(out_);
    }

private:
    /// Those without thickness are parts at once.
    void take_slabs_at(float depth) {
        for (; next_ < slabs_.size() && twin::slab_front(slabs_[next_]) <= depth; ++next_)
            (slabs_[next_].z <= depth ? parts_ : active_).push_back(slabs_[next_]);
    }

    void cut_active(float front, float back) {
        std::size_t kept = 0;
        for (const Slab& slab : active_) {
            if (slab.z <= back) {
                parts_.push_back(slab);
                continue;
            }
            const twin::SlabParts cut = twin::split_slab(slab, front, back, twin::uint(settings_.interpolation));
            parts_.push_back(cut.front);
            active_[kept++] = cut.back;
        }
        active_.resize(kept);
    }

    /// The mixture of the parts between two depths; false where too little passes it.
    [[nodiscard]] bool emit(float front, float back) {
        if (parts_.empty()) return true;
        Slab mixed = mixer_.mix(parts_);
        mixed.z = back;
        float d = parts_[0].d;
        for (const Slab& part : parts_) d = std::max(d, part.d);
        mixed.d = parts_.size() == 1 || front == back ? d : twin::thickness_between(front, back);
        out_.push_back(mixed);
        parts_.clear();
        return passing_.through(mixed);
    }

    std::vector<Slab> slabs_;
    SlabSettings settings_;
    ManyMixer mixer_;
    Passing passing_;
    std::vector<float> ends_;
    std::vector<Slab> active_;  // what is left of the slabs that have begun, in canonical order
    std::vector<Slab> parts_;
    std::size_t next_ = 0;
    SlabArray out_;
};

}  // namespace

bool is_sorted_array(std::span<const Slab> slabs) {
    float end = -std::numeric_limits<float>::infinity();
    for (const Slab& s : slabs) {
        const bool finite = std::isfinite(s.z) && std::isfinite(s.d) && std::isfinite(s.r) && std::isfinite(s.g) &&
                            std::isfinite(s.b);
        if (!finite || s.d < 0 || !(s.a >= 0 && s.a <= 1) || twin::slab_front(s) < end) return false;
        end = s.z;
    }
    return true;
}

std::size_t merge_arrays(std::span<const Slab> a, std::span<const Slab> b, const SlabSettings& settings,
                         std::span<Slab> out) {
    assert(out.size() >= a.size() + b.size());
    Passing passing(settings.opaque_at);
    std::size_t count = 0;
    std::size_t next_a = 0;
    std::size_t next_b = 0;
    Slab at_a = a.empty() ? Slab{} : a[0];
    Slab at_b = b.empty() ? Slab{} : b[0];
    while (next_a < a.size() && next_b < b.size()) {
        const twin::MergeStep step = quick_step(at_a, at_b, settings);
        out[count++] = step.out_slab;
        if (!passing.through(step.out_slab)) return count;
        next_a += step.a_used;
        next_b += step.b_used;
        at_a = step.a_used == 0 ? step.a : next_a < a.size() ? a[next_a] : Slab{};
        at_b = step.b_used == 0 ? step.b : next_b < b.size() ? b[next_b] : Slab{};
    }
    // Of one array nothing is left; of the other the slab that may have been cut, and all that follow it.
    const auto rest = next_a < a.size() ? a.subspan(next_a) : b.subspan(std::min(next_b, b.size()));
    for (std::size_t i = 0; i < rest.size(); ++i) {
        out[count++] = i > 0 ? rest[i] : next_a < a.size() ? at_a : at_b;
        if (!passing.through(out[count - 1])) break;
    }
    return count;
}

SlabArray merge_arrays(std::span<const Slab> a, std::span<const Slab> b, const SlabSettings& settings) {
    SlabArray out(a.size() + b.size());
    out.resize(merge_arrays(a, b, settings, out));
    return out;
}

void insert_slab(SlabArray& array, const Slab& slab, const SlabSettings& settings) {
    const float front = twin::slab_front(slab);
    const auto first = std::partition_point(array.begin(), array.end(), [&](const Slab& s) { return s.z < front; });
    auto at = static_cast<std::size_t>(first - array.begin());
    Slab carried = slab;
    for (; at < array.size(); ++at) {
        const bool carried_first = carried.z <= array[at].z;
        const twin::Intermixed r =
            twin::intermix(carried_first ? carried : array[at], carried_first ? array[at] : carried,
                           twin::uint(settings.interpolation), twin::uint(settings.mixing));
        array[at] = r.integrated;
        if (r.remains == 0) return;
        carried = r.remaining;
        if (carried_first) {
            array.insert(array.begin() + static_cast<std::ptrdiff_t>(at) + 1, carried);
            return;
        }
    }
    array.push_back(carried);
}

SlabArray merge_order_free(std::span<const std::span<const Slab>> arrays, const SlabSettings& settings) {
    std::size_t count = 0;
    for (const auto& array : arrays) count += array.size();
    std::vector<Slab> slabs;
    slabs.reserve(count);
    for (const auto& array : arrays) slabs.insert(slabs.end(), array.begin(), array.end());
    return OrderFreeSweep(std::move(slabs), settings).run();
}

OrderFreePlan order_free_plan(std::size_t slabs) {
    // Slabs in canonical order, begun ones, parts and the result; ends; weights and opacities of the mixer.
    const std::size_t bytes = slabs * (5 * sizeof(Slab) + 2 * sizeof(float) + 2 * sizeof(double));
    return {.most_slabs = 2 * slabs, .bytes = bytes};
}

Slab composite(std::span<const Slab> slabs) {
    if (slabs.empty()) return {};
    Slab sum{};
    for (const Slab& slab : slabs) sum = twin::slab_over(sum, slab);
    sum.z = slabs.back().z;
    sum.d = slabs.size() == 1 ? slabs[0].d : twin::thickness_between(twin::slab_front(slabs[0]), sum.z);
    return sum;
}

}  // namespace pellucid
