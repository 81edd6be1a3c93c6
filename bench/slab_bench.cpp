#include "bench/slab_bench.hpp"

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include <benchmark/benchmark.h>

#include "core/parallel.hpp"
#include "cpu/slab_merge_lanes.hpp"
#include "stage/slab_compression.hpp"
#include "stage/slab_merge.hpp"

namespace pellucid::bench {
namespace {

/// Everything on two threads, as the other stages are measured.
constexpr std::size_t kThreads = 2;
/// Pixels whose arrays of 7 + 7 slabs stay in the first-level cache.
constexpr std::size_t kPixels = 32;
constexpr int kRounds = 2000;

template <class Body>
void on_both_threads(const Body& body) {
    parallel_for(kThreads, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t thread = begin; thread < end; ++thread) body();
    });
}

[[nodiscard]] SlabArray layers(std::mt19937& random) {
    std::uniform_real_distribution<float> unit(0, 1);
    SlabArray slabs;
    float z = 1;
    for (int i = 0; i < 7; ++i) {
        const float d = 0.05F + 0.2F * unit(random);
        const float a = 0.5F * unit(random);
        z += d + (i % 3 == 0 ? 0.05F : 0.0F);
        slabs.push_back({z, d, 0.5F * a, 0.2F * a, a, a});
    }
    return slabs;
}

struct Pixels {
    Pixels() {
        std::mt19937 random(1);
        for (std::size_t i = 0; i < kPixels; ++i) {
            a.push_back(layers(random));
            b.push_back(layers(random));
            out.emplace_back(a[i].size() + b[i].size());
            jobs.push_back({a[i], b[i], out[i]});
        }
    }
    std::vector<SlabArray> a, b, out;
    std::vector<SlabMergeJob> jobs;
};

/// Slabs that come out a second, where all arrays are in cache.
template <bool lanes, SlabInterpolation interpolation, SlabMixing mixing>
void merge_in_cache(benchmark::State& state) {
    const SlabSettings settings{.interpolation = interpolation, .mixing = mixing, .opaque_at = 2};
    const SlabMergeLanes merger(settings);
    std::uint64_t merges = 0;
    for (auto _ : state)
        on_both_threads([&] {
            Pixels pixels;
            std::uint64_t count = 0;
            for (int round = 0; round < kRounds; ++round) {
                if (lanes) merger.merge(pixels.jobs);
                else
                    for (SlabMergeJob& job : pixels.jobs) job.count = merge_arrays(job.a, job.b, settings, job.out);
                for (const SlabMergeJob& job : pixels.jobs) count += job.count;
            }
            __atomic_fetch_add(&merges, count, __ATOMIC_RELAXED);
        });
    state.counters["merges"] = {static_cast<double>(merges), benchmark::Counter::kIsRate};
}

/// Rays of 256 thin slabs into N = 8 layers.
template <SlabCompression compression>
void collect(benchmark::State& state) {
    std::mt19937 random(2);
    std::uniform_real_distribution<float> unit(0, 1);
    std::vector<twin::Slab> ray;
    for (int i = 0; i < 256; ++i) {
        const float a = 0.01F * (1 + std::sin(0.05F * static_cast<float>(i))) * (0.8F + 0.2F * unit(random));
        ray.push_back({2 + 0.01F * static_cast<float>(i + 1), 0.01F, 0.5F * a, 0.2F * a, a, a});
    }
    for (auto _ : state)
        on_both_threads([&] {
            SlabCollector collector({.layers = 8, .compression = compression});
            for (int i = 0; i < kRounds; ++i) {
                collector.start();
                for (const twin::Slab& slab : ray)
                    if (!collector.push(slab)) break;
                benchmark::DoNotOptimize(collector.finish().data());
            }
        });
    const auto pushes = static_cast<double>(state.iterations()) * kThreads * kRounds * static_cast<double>(ray.size());
    state.counters["pushes"] = {pushes, benchmark::Counter::kIsRate};
}

}  // namespace

void register_slab_benchmarks() {
    using enum SlabInterpolation;
    using enum SlabMixing;
    const auto add = [](const char* name, void (*run)(benchmark::State&)) {
        benchmark::RegisterBenchmark(name, run)->Iterations(3)->UseRealTime()->MeasureProcessCPUTime()->Unit(
            benchmark::kMillisecond);
    };
    add("slabs/merge", merge_in_cache<true, modified, average>);
    add("slabs/merge_plain", merge_in_cache<false, modified, average>);
    add("slabs/merge_original_extinction", merge_in_cache<true, original, extinction>);
    add("slabs/collect_tail", collect<SlabCompression::tail>);
    add("slabs/collect_slope", collect<SlabCompression::slope>);
    add("slabs/collect_transmittance", collect<SlabCompression::transmittance>);
}

}  // namespace pellucid::bench
