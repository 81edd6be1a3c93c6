#include "cpu/slab_merge_lanes.hpp"

#include <array>
#include <cassert>
#include <cstdint>

#include <hwy/targets.h>

#include "kernel/intermix_twin.h"

namespace pellucid {
namespace {

using twin::Slab;

constexpr std::size_t kLanes = 16;

struct SlabLanes {
    alignas(64) std::array<float, kLanes> z, d, r, g, b, a;

    [[nodiscard]] Slab get(std::size_t i) const { return {z[i], d[i], r[i], g[i], b[i], a[i]}; }
    void set(std::size_t i, const Slab& s) {
        z[i] = s.z;
        d[i] = s.d;
        r[i] = s.r;
        g[i] = s.g;
        b[i] = s.b;
        a[i] = s.a;
    }
};

}  // namespace

/// The heads of 16 pairs of arrays, and one step of all.
struct SlabMergeLanes::State {
    SlabLanes a, b, out;
    alignas(64) std::array<float, kLanes> transmittance;
    alignas(64) std::array<std::uint32_t, kLanes> a_used, b_used;
};

namespace {

// The compiler makes the loop SIMD code of the function's target; twin functions have no branches and, without
// contraction, the same bits at any width.
#define PELLUCID_STEP_LOOP                                                                                    \
    for (std::size_t i = 0; i < kLanes; ++i) {                                                                \
        const twin::MergeStep r = twin::merge_step(s.a.get(i), s.b.get(i), interpolation, mixing);            \
        s.out.set(i, r.out_slab);                                                                             \
        s.a.set(i, r.a);                                                                                      \
        s.b.set(i, r.b);                                                                                      \
        s.a_used[i] = r.a_used;                                                                               \
        s.b_used[i] = r.b_used;                                                                               \
        s.transmittance[i] *= 1.0F - r.out_slab.a;                                                            \
    }

template <class State, twin::uint interpolation, twin::uint mixing>
__attribute__((flatten)) void step_plain(State& s) {
    PELLUCID_STEP_LOOP
}
#ifdef __x86_64__
template <class State, twin::uint interpolation, twin::uint mixing>
__attribute__((flatten, target("avx2"))) void step_avx2(State& s) {
    PELLUCID_STEP_LOOP
}
template <class State, twin::uint interpolation, twin::uint mixing>
__attribute__((flatten, target("avx512f,avx512bw,avx512dq,avx512vl,prefer-vector-width=512"))) void step_avx512(
    State& s) {
    PELLUCID_STEP_LOOP
}
#endif
#undef PELLUCID_STEP_LOOP

template <class State, twin::uint interpolation, twin::uint mixing>
[[nodiscard]] auto best_step() -> void (*)(State&) {
#ifdef __x86_64__
    const std::int64_t targets = hwy::SupportedTargets();
    const std::int64_t best = targets & -targets;  // better ones have lower bits
    if (best <= HWY_AVX3) return step_avx512<State, interpolation, mixing>;
    if (best <= HWY_AVX2) return step_avx2<State, interpolation, mixing>;
#endif
    return step_plain<State, interpolation, mixing>;
}

template <class State, twin::uint interpolation>
[[nodiscard]] auto best_step(SlabMixing mixing) {
    if (mixing == SlabMixing::average) return best_step<State, interpolation, twin::kMixAverage>();
    if (mixing == SlabMixing::normalised) return best_step<State, interpolation, twin::kMixNormalised>();
    return best_step<State, interpolation, twin::kMixExtinction>();
}

template <class State>
[[nodiscard]] auto best_step(const SlabSettings& settings) {
    if (settings.interpolation == SlabInterpolation::modified)
        return best_step<State, twin::kInterpolateModified>(settings.mixing);
    if (settings.interpolation == SlabInterpolation::original)
        return best_step<State, twin::kInterpolateOriginal>(settings.mixing);
    return best_step<State, twin::kInterpolateTextbook>(settings.mixing);
}

}  // namespace

/// Gives each lane a job, and another one when that is done.
class SlabMergeLanes::Run {
public:
    Run(std::span<SlabMergeJob> jobs, StepFunction step, float least) : jobs_(jobs), step_(step), least_(least) {
        for (std::size_t lane = 0; lane < kLanes; ++lane) take_job(lane);
    }

    void finish() {
        while (busy_ > 0) {
            step_(state_);
            for (std::size_t lane = 0; lane < kLanes; ++lane)
                if (cursors_[lane].job != nullptr) advance(lane);
        }
    }

private:
    struct Cursor {
        SlabMergeJob* job = nullptr;
        std::size_t a = 0, b = 0;
    };

    /// A job of one array alone needs no kernel.
    void take_job(std::size_t lane) {
        Cursor& at = cursors_[lane];
        while (next_ < jobs_.size()) {
            SlabMergeJob& job = jobs_[next_++];
            assert(job.out.size() >= job.a.size() + job.b.size());
            job.count = 0;
            if (job.a.empty() || job.b.empty()) {
                float transmittance = 1;
                copy_rest(job, job.a.empty() ? job.b : job.a, transmittance);
                continue;
            }
            at = {&job, 0, 0};
            state_.a.set(lane, job.a[0]);
            state_.b.set(lane, job.b[0]);
            state_.transmittance[lane] = 1;
            ++busy_;
            return;
        }
        at.job = nullptr;
        state_.a.set(lane, {});
        state_.b.set(lane, {});
        state_.transmittance[lane] = 1;
    }

    void advance(std::size_t lane) {
        Cursor& at = cursors_[lane];
        SlabMergeJob& job = *at.job;
        job.out[job.count++] = state_.out.get(lane);
        float transmittance = state_.transmittance[lane];
        if (transmittance > least_) {
            at.a += state_.a_used[lane];
            at.b += state_.b_used[lane];
            if (at.a < job.a.size() && at.b < job.b.size()) {
                if (state_.a_used[lane] != 0) state_.a.set(lane, job.a[at.a]);
                if (state_.b_used[lane] != 0) state_.b.set(lane, job.b[at.b]);
                return;
            }
            copy_cut(lane, at, job, transmittance);
        }
        --busy_;
        take_job(lane);
    }

    /// Of the array that is left: the slab that may have been cut, and those behind it.
    void copy_cut(std::size_t lane, const Cursor& at, SlabMergeJob& job, float& transmittance) {
        const bool of_a = at.a < job.a.size();
        const auto rest = of_a ? job.a.subspan(at.a) : job.b.subspan(at.b);
        if (rest.empty()) return;
        const bool whole = (of_a ? state_.a_used : state_.b_used)[lane] != 0;
        const Slab first = whole ? rest[0] : (of_a ? state_.a : state_.b).get(lane);
        if (copy_rest(job, std::span(&first, 1), transmittance)) copy_rest(job, rest.subspan(1), transmittance);
    }

    /// False where too little passes.
    bool copy_rest(SlabMergeJob& job, std::span<const Slab> rest, float& transmittance) const {
        for (const Slab& slab : rest) {
            job.out[job.count++] = slab;
            transmittance *= 1.0F - slab.a;
            if (!(transmittance > least_)) return false;
        }
        return true;
    }

    std::span<SlabMergeJob> jobs_;
    StepFunction step_;
    float least_;
    std::size_t next_ = 0;
    std::size_t busy_ = 0;
    std::array<Cursor, kLanes> cursors_;
    State state_;
};

SlabMergeLanes::SlabMergeLanes(const SlabSettings& settings)
    : step_(best_step<State>(settings)), least_(1.0F - settings.opaque_at) {}

void SlabMergeLanes::merge(std::span<SlabMergeJob> jobs) const { Run(jobs, step_, least_).finish(); }

}  // namespace pellucid
