// How fast is each stage, beside a bare probe of what this machine gives?
// tools/speed.sh -> results/speed/speed.json, speed.csv, speed.md
//
// Names are stage/what: `probe` is the bare loop, all others are Pellucid. Only ratios of medians mean
// something: run with --benchmark_enable_random_interleaving=true and at least 5 repetitions.
// `--memory` instead draws once in this process and prints what it held as JSON.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <string>

#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include "bench/probes.hpp"
#include "bench/slab_bench.hpp"
#include "bench/workloads.hpp"
#include "core/error.hpp"
#include "core/parallel.hpp"
#include "cpu/depth_peeling.hpp"
#include "cpu/fast_particles.hpp"
#include "cpu/fast_volume_caster.hpp"
#include "cpu/plain_particles.hpp"
#include "harness/provenance.hpp"
#include "reference/ray_scene.hpp"
#include "reference/truth.hpp"
#include "render/backend.hpp"
#include "sample/particle_sampler.hpp"
#include "stage/slab_compression.hpp"
#include "vulkan/multi_volume_caster.hpp"
#include "vulkan/particles.hpp"
#include "vulkan/peeling.hpp"
#include "vulkan/slab_pipeline.hpp"
#include "vulkan/surface_drawer.hpp"

namespace pellucid::bench {
namespace {

/// The machine's limits were measured with two threads.
constexpr int kThreads = 2;
constexpr std::uint32_t kRepeats = 500;

[[nodiscard]] benchmark::Counter rate(std::uint64_t count) {
    return {static_cast<double>(count), benchmark::Counter::kIsRate};
}

[[nodiscard]] std::uint64_t done(const benchmark::State& state) {
    return static_cast<std::uint64_t>(state.iterations());
}

// ---- Drawing ----------------------------------------------------------------------------------

struct Drawing {
    PreparedScene scene;
    ParticleSet particles;
};

/// `total` particles over 500 repeats, as many of each surface. Only the first 20 repeats are sampled, the
/// others are copies: drawing them costs the same.
[[nodiscard]] Drawing make_drawing(std::uint64_t total) {
    constexpr std::uint32_t kSampled = 20;
    PreparedScene scene = overlapping_surfaces();
    const auto samplers = make_samplers(scene);
    const SamplerSettings settings{.seed = {}, .exact_count = total / kRepeats / samplers.size()};
    ParticleSet particles = sample_particles(scene, samplers, settings, 0, kSampled);
    particles.repeats.reserve(kRepeats);
    for (std::size_t i = kSampled; i < kRepeats; ++i)
        particles.repeats.push_back(particles.repeats[i % kSampled]);
    return {std::move(scene), std::move(particles)};
}

template <std::uint64_t total>
[[nodiscard]] const Drawing& drawing() {
    static const Drawing made = make_drawing(total);
    return made;
}

using MakeDrawer = std::unique_ptr<ParticleDrawer> (*)(const PreparedScene&);

/// Everything: sums cleared, particles projected, winners shaded and added.
template <std::uint64_t total, MakeDrawer make_drawer>
void draw_whole_ensemble(benchmark::State& state) {
    const Drawing& d = drawing<total>();
    const auto drawer = make_drawer(d.scene);
    for (auto _ : state) {
        EnsembleSums sums = make_sums(d.scene);
        drawer->draw(d.particles, sums);
        benchmark::DoNotOptimize(sums.pixels.data());
    }
    state.counters["particles"] = rate(done(state) * d.particles.count());
}

/// Projection and nearest-wins alone, a frame a thread.
void draw_winners_only(benchmark::State& state) {
    const Drawing& d = drawing<50'000'000>();
    const twin::Projection projection = d.particles.frame.projection(d.scene.camera);
    for (auto _ : state)
        parallel_for(kThreads, 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t thread = begin; thread < end; ++thread) {
                WinnerFrame frame(kImageSize, kImageSize);
                for (std::size_t i = thread; i < kRepeats; i += kThreads) {
                    frame.draw(d.particles.repeats[i].particles, projection);
                    frame.clear();
                }
            }
        });
    state.counters["particles"] = rate(done(state) * d.particles.count());
}

void splat_probe(benchmark::State& state) {
    static SplatProbe probe(std::size_t{1} << 24U, kImageSize);
    std::uint64_t points = 0;
    for (auto _ : state) points += probe.run();
    state.counters["particles"] = rate(points);
}

// ---- Drawing on Vulkan ------------------------------------------------------------------------

/// Opened at the first use; only called where there is a device.
[[nodiscard]] const vulkan::Device& device() {
    static const vulkan::Device opened;
    return opened;
}

void vulkan_splat_probe(benchmark::State& state) {
    static VulkanSplatProbe probe(device(), std::size_t{1} << 24U, kImageSize);
    for (auto _ : state) state.SetIterationTime(probe.run());
    state.counters["particles"] = rate(done(state) * probe.count());
}

/// Clear, project, resolve: who won which pixel, and no more.
void winners_on_vulkan(benchmark::State& state) {
    const Drawing& d = drawing<50'000'000>();
    static const auto drawer = vulkan::make_particle_drawer(device(), d.scene);
    for (auto _ : state) {
        const double before = drawer->device_times().empty() ? 0 : drawer->device_times().front().device_s;
        benchmark::DoNotOptimize(drawer->winners(d.particles).data());
        state.SetIterationTime(drawer->device_times().front().device_s - before);
    }
    state.counters["particles"] = rate(done(state) * d.particles.count());
}

/// The whole ensemble by the device's clock; `wall`: by the host's, with all copies.
template <bool wall>
void draw_on_vulkan(benchmark::State& state) {
    const Drawing& d = drawing<50'000'000>();
    static const auto drawer = vulkan::make_particle_drawer(device(), d.scene);
    const auto device_s = [&] {
        double sum = 0;
        for (const StageTime& time : drawer->device_times()) sum += time.device_s;
        return sum;
    };
    for (auto _ : state) {
        const double before = device_s();
        const auto start = std::chrono::steady_clock::now();
        EnsembleSums sums = make_sums(d.scene);
        drawer->draw(d.particles, sums);
        benchmark::DoNotOptimize(sums.pixels.data());
        const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - start;
        state.SetIterationTime(wall ? passed.count() : device_s() - before);
    }
    state.counters["particles"] = rate(done(state) * d.particles.count());
}

/// What depth peeling on Vulkan works on: triangles of the scene, and as the probe draws them.
struct PeelWork {
    PreparedScene scene = eight_spheres(kImageSize);
    SceneMeshes meshes{scene, {}};
    [[nodiscard]] std::vector<VulkanRasterProbe::Corner> corners() const {
        std::vector<VulkanRasterProbe::Corner> all;
        std::uint32_t number = 0;
        for (const ObjectMesh& object : meshes.objects())
            for (const auto& triangle : object.mesh->triangles) {
                for (const std::uint32_t i : triangle) {
                    const Vec2 place = scene.camera.project(object.view[i]) * (2.0 / kImageSize) - 1.0;
                    all.push_back({static_cast<float>(place.x), static_cast<float>(place.y),
                                   static_cast<float>(object.view[i].z), number});
                }
                ++number;
            }
        return all;
    }
};
[[nodiscard]] const PeelWork& peel_work() {
    static const PeelWork work;
    return work;
}

void vulkan_raster_probe(benchmark::State& state) {
    static VulkanRasterProbe probe(device(), peel_work().corners(), kImageSize);
    for (auto _ : state) state.SetIterationTime(probe.run());
    state.counters["triangles"] = rate(done(state) * peel_work().meshes.triangle_count());
}

/// One pass that keeps the nearest `slots` of each pixel, by the device's clock: no shading.
template <int slots>
void vulkan_peel_pass(benchmark::State& state) {
    const PeelWork& work = peel_work();
    static vulkan::Peeler peeler(device(), work.scene, work.meshes, {.targets = slots, .thickness = false});
    const auto peel_s = [] {
        double sum = 0;
        for (const StageTime& time : peeler.device_times()) sum += time.name == "peel" ? time.device_s : 0;
        return sum;
    };
    for (auto _ : state) {
        const double before = peel_s();
        (void)peeler.peel(all_objects(work.meshes), {.layers = slots, .thickness = false}, [](const vulkan::PeeledTargets&) {});
        state.SetIterationTime(peel_s() - before);
    }
    state.counters["triangles"] = rate(done(state) * work.meshes.triangle_count());
}

/// All layers to one colour a pixel, by the host's clock, triangles aside.
void vulkan_depth_peeling(benchmark::State& state) {
    const PeelWork& work = peel_work();
    static const auto drawer = vulkan::make_surface_drawer(device(), work.scene, work.meshes);
    std::uint64_t fragments = 0;
    for (auto _ : state) {
        SurfaceDrawStats stats;
        const auto start = std::chrono::steady_clock::now();
        benchmark::DoNotOptimize(drawer->draw({}, stats).plane("A").data());
        state.SetIterationTime(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
        fragments += stats.fragments;
    }
    state.counters["fragments"] = rate(fragments);
}

// ---- Sampling ---------------------------------------------------------------------------------

/// About 2·10^7 trials for every shape, in repeats of some 10^5.
template <PreparedScene (*make_scene)(), LineMode lines>
void sample(benchmark::State& state) {
    static const PreparedScene scene = make_scene();
    static const std::vector<LineSampler> samplers = make_samplers(scene);
    double trials = 0;
    for (const LineSampler& sampler : samplers) trials += mean_trials(sampler, TrialLaw::poisson);
    const auto repeats = static_cast<std::uint32_t>(1 + 2e7 / trials);
    std::uint64_t particles = 0;
    for (auto _ : state)
        particles +=
            sample_particles(scene, samplers, {.seed = {}, .lines = lines, .exact_count = {}}, 0, repeats)
                .count();
    state.counters["particles"] = rate(particles);
    // By their mean: the Poisson law's spread is one in a thousand here.
    state.counters["trials"] = rate(done(state) * static_cast<std::uint64_t>(trials * repeats));
}

/// 16 bytes a particle.
void copy_probe(benchmark::State& state) {
    static CopyProbe probe(std::uint64_t{1} << 29U);
    std::uint64_t bytes = 0;
    for (auto _ : state) bytes += probe.run();
    state.counters["particles"] = rate(bytes / sizeof(Particle));
}

void walk_probe(benchmark::State& state) {
    TorusWalkProbe probe(std::uint64_t{1} << 25U);
    std::uint64_t steps = 0;
    for (auto _ : state) steps += probe.run();
    state.counters["steps"] = rate(steps);
}

/// Brownian motion on the torus; `thinning` positions a particle of the view, 1: all of them.
template <std::uint32_t thinning>
void walk_torus(benchmark::State& state) {
    static const PreparedScene scene = torus();
    static const BrownianSource source(scene.objects[0], scene.camera, 0, {.thinning = thinning});
    constexpr std::uint32_t kRepeatsNow = 16;
    constexpr std::uint32_t kTrials = (1U << 21U) / thinning;
    std::atomic<std::uint64_t> particles = 0;
    const std::uint64_t before = source.stats().steps;
    for (auto _ : state)
        parallel_for(kRepeatsNow, 1, [&](std::size_t begin, std::size_t end) {
            std::vector<SourcePoint> points;
            for (std::size_t i = begin; i < end; ++i) {
                points.clear();
                source.trials_in_block(0, {}, static_cast<std::uint32_t>(i), 0, kTrials, points);
                particles += points.size();
            }
        });
    state.counters["steps"] = rate(source.stats().steps - before);
    state.counters["particles"] = rate(particles);
}

/// Sampling by another sampler, as `sample`.
template <PreparedScene (*make_scene)(), SamplerKind kind>
void sample_by(benchmark::State& state) {
    static const PreparedScene scene = make_scene();
    static const Sources sources = make_sources(scene, kind);
    double trials = 0;
    for (const auto& source : sources) trials += mean_trials(*source, TrialLaw::poisson);
    const auto repeats = static_cast<std::uint32_t>(1 + 2e7 / trials);
    std::uint64_t particles = 0;
    for (auto _ : state)
        particles += sample_particles(scene, sources, {.seed = {}, .exact_count = {}}, 0, repeats).count();
    state.counters["particles"] = rate(particles);
    state.counters["trials"] = rate(done(state) * static_cast<std::uint64_t>(trials * repeats));
}

/// An MPU surface from points in memory: octree and fits.
void fit_points(benchmark::State& state) {
    constexpr int kPoints = 360'000;
    static const std::vector<OrientedPoint> points = points_on_wavy_ball(kPoints);
    for (auto _ : state) benchmark::DoNotOptimize(MpuField(points).leaves().data());
    state.counters["points"] = rate(done(state) * kPoints);
}

[[nodiscard]] PreparedScene nested_spheres_in_full() { return nested_spheres(kImageSize, 0.005); }

[[nodiscard]] PreparedScene barth_sextic_in_full() { return barth_sextic(kImageSize); }

template <Interpolation interpolation>
[[nodiscard]] PreparedScene head() {
    return real_head(interpolation);
}
template <Interpolation interpolation>
[[nodiscard]] PreparedScene wavy_ball() {
    return wavy_isosurface(interpolation);
}

template <class Probe>
void lines_probe(benchmark::State& state) {
    constexpr std::uint64_t kLines = std::uint64_t{1} << 23U;
    Probe probe(kLines);
    std::uint64_t particles = 0;
    for (auto _ : state) particles += probe.run();
    state.counters["particles"] = rate(particles);
    state.counters["trials"] = rate(done(state) * kLines);
    state.counters["rays"] = rate(done(state) * kLines);
}

// ---- Truth ------------------------------------------------------------------------------------

[[nodiscard]] const PreparedScene& mesh_scene() {
    static const PreparedScene scene = nested_spheres_in_full();
    return scene;
}

void embree_probe(benchmark::State& state) {
    const PreparedScene& scene = mesh_scene();
    static const EmbreeProbe probe(*scene.objects[0].geometry->mesh(),
                                   {scene.camera.eye().z, scene.camera.pixel_size(), kImageSize});
    std::uint64_t hits = 0;
    for (auto _ : state) hits += probe.run();
    state.counters["hits"] = rate(hits);
    state.counters["rays"] = rate(done(state) * kImageSize * kImageSize);
}

/// The same rays through the truth's own gathering.
void gather_all_hits(benchmark::State& state) {
    const PreparedScene& scene = mesh_scene();
    static const RayScene rays(scene);
    std::atomic<std::uint64_t> hits = 0;
    for (auto _ : state)
        parallel_for(kImageSize / 4, 1, [&](std::size_t begin, std::size_t end) {
            PacketHits found;
            std::array<Ray, kPacket> packet;
            std::uint64_t sum = 0;
            for (std::size_t block_y = begin; block_y < end; ++block_y)
                for (std::size_t block_x = 0; block_x < kImageSize / 4; ++block_x) {
                    for (std::size_t i = 0; i < kPacket; ++i)
                        packet[i] = scene.camera.ray(static_cast<double>(4 * block_x + (i & 3U)) + 0.5,
                                                     static_cast<double>(4 * block_y + (i >> 2U)) + 0.5);
                    rays.gather(packet, found);
                    for (const auto& list : found.rays) sum += list.size();
                }
            hits += sum;
        });
    state.counters["hits"] = rate(hits);
    state.counters["rays"] = rate(done(state) * kImageSize * kImageSize);
}

/// Everything: jitter, all hits, shading, compositing; 64 rays a pixel. Building the ray scene is left out.
template <PixelFilter filter>
void trace_whole_truth(benchmark::State& state) {
    static const PreparedScene scene = nested_spheres(160, 0.3);
    TruthStats stats;
    for (auto _ : state) {
        const double before = stats.trace_s;
        TruthStats once;
        benchmark::DoNotOptimize(trace_truth(scene, {.filter = filter, .seed = {}, .max_samples = 64}, once));
        state.SetIterationTime(once.trace_s);
        stats.trace_s = before + once.trace_s;
        stats.hits += once.hits;
        stats.rays += once.rays;
    }
    state.counters["hits"] = rate(stats.hits);
    state.counters["rays"] = rate(stats.rays);
}

/// A formula of degree 6 at 512², 16 rays a pixel, everything: reading the formula, cells, rays, shading.
void trace_formula(benchmark::State& state) {
    std::uint64_t rays = 0;
    std::uint64_t hits = 0;
    for (auto _ : state) {
        const PreparedScene scene = barth_sextic(512);
        TruthStats stats;
        benchmark::DoNotOptimize(trace_truth(scene, {.seed = {}, .samples = 16}, stats));
        rays += stats.rays;
        hits += stats.hits;
    }
    state.counters["hits"] = rate(hits);
    state.counters["rays"] = rate(rays);
}

/// All from the mesh in memory to the composited image: to view space, snapped, binned, peeled, shaded.
///   layers  most a pixel; 0: all
template <int layers>
void peel_surfaces(benchmark::State& state) {
    static const PreparedScene scene = eight_spheres(kImageSize);
    std::vector<Composite> image(std::size_t{kImageSize} * kImageSize);
    std::uint64_t fragments = 0;
    std::uint64_t most = 0;
    for (auto _ : state) {
        const SceneMeshes meshes(scene, {});
        const PeelStats stats = peel(scene, meshes, all_objects(meshes), {.layers = layers, .thickness = false},
                                     [&](int x, int y, std::span<const SurfaceFragment> list) {
                                         image[static_cast<std::size_t>(y) * kImageSize + static_cast<std::size_t>(x)] =
                                             composite_surfaces(list);
                                     });
        fragments += stats.fragments;
        most = stats.layers;
    }
    benchmark::DoNotOptimize(image.data());
    state.counters["fragments"] = rate(fragments);
    state.counters["layers"] = static_cast<double>(most);
}

// ---- Casting ----------------------------------------------------------------------------------

void trilinear_probe(benchmark::State& state) {
    static const TrilinearProbe probe(kCubeSamples, kCubePixels, cube_value);
    std::uint64_t samples = 0;
    for (auto _ : state) samples += probe.run();
    state.counters["samples"] = rate(samples);
}

struct Casting {
    PreparedScene scene;
    std::uint64_t samples;  // that all rays take, one voxel apart
    std::uint64_t blocks;   // that are not empty

    explicit Casting(const CubeSettings& settings) : scene(transparent_cube(settings)), samples(0), blocks(0) {
        for (const VolumeObject& volume : scene.volumes) {
            const VolumeCaster rays(scene, volume, {.step = 1});
            for (const std::uint8_t distance : rays.empty_space().distance()) blocks += distance == 0 ? 1 : 0;
            for (int y = 0; y < kCubePixels; ++y)
                for (int x = 0; x < kCubePixels; ++x) {
                    const VolumeCaster::Progress p = rays.enter(scene.camera.ray(x + 0.5, y + 0.5));
                    if (!p.done()) samples += static_cast<std::uint64_t>((p.t_out - p.t_in) / p.dt) + 1;
                }
        }
    }
};
constexpr Shading kLit{.flat = false, .ambient = 0.2, .diffuse = 0.8, .specular = 0, .shininess = 32};

/// An image of volumes, without packing them. In percent: how much of the cube is filled.
template <int percent, int copies, bool lit>
void cast_image(benchmark::State& state) {
    static const Casting casting({.share = 0.01 * percent, .shading = lit ? kLit : Shading{.flat = true}, .copies = copies});
    for (auto _ : state) {
        MultiVolumeStats stats;
        benchmark::DoNotOptimize(cast_volumes_fast(casting.scene, {.opaque_at = 1}, stats, [](double) {}));
        state.SetIterationTime(stats.cast_s);
    }
    state.counters["samples"] = rate(done(state) * casting.samples);
    state.counters["blocks"] = rate(done(state) * casting.blocks);
}

/// Slabs of all rays: thrown away, through a collector of eight layers one by one, or collected in lanes.
enum class SlabsOfRays : std::uint8_t { all, one_by_one, in_lanes };
template <SlabsOfRays how>
void cast_slabs(benchmark::State& state) {
    static const Casting casting(CubeSettings{});
    static const FastVolumeCaster caster(casting.scene, casting.scene.volumes[0], {.step = 1});
    constexpr std::size_t kPackets = kCubePixels / kPacketSide;
    for (auto _ : state)
        parallel_for(kPackets, 1, [&](std::size_t begin, std::size_t end) {
            FastVolumeCaster::PacketSlabs slabs;
            FastVolumeCaster::CollectedPacket collected;
            const SlabSettings rule{.layers = 8, .opaque_at = 1};
            SlabCollector collector(rule, SlabCollector::negligible_cost(rule, 1));
            std::size_t kept = 0;
            for (std::size_t row = begin; row < end; ++row)
                for (std::size_t column = 0; column < kPackets; ++column) {
                    const int x0 = kPacketSide * static_cast<int>(column), y0 = kPacketSide * static_cast<int>(row);
                    if (how == SlabsOfRays::in_lanes) {
                        caster.cast_collected(x0, y0, collector, collected);
                        for (const auto& ray : collected) kept += ray.slabs.size();
                        continue;
                    }
                    caster.cast(x0, y0, 1, slabs);
                    for (const auto& ray : slabs) {
                        if (how == SlabsOfRays::one_by_one) {
                            collector.start();
                            for (const twin::Slab& slab : ray)
                                if (!collector.push(slab)) break;
                            kept += collector.finish().size();
                        } else {
                            kept += ray.size();
                        }
                    }
                }
            benchmark::DoNotOptimize(kept);
        });
    state.counters["samples"] = rate(done(state) * casting.samples);
}

template <bool packed>
void vulkan_march_probe(benchmark::State& state) {
    static VulkanMarchProbe probe(device(), kCubeSamples, kCubePixels, cube_value, packed);
    for (auto _ : state) state.SetIterationTime(probe.run());
    state.counters["samples"] = rate(done(state) * probe.taken());
}

/// The cube of cast/flat by the device's clock: all volumes together.
template <bool lit>
void vulkan_cast_image(benchmark::State& state) {
    static const Casting casting({.shading = lit ? kLit : Shading{.flat = true}});
    for (auto _ : state) {
        MultiVolumeStats stats;
        benchmark::DoNotOptimize(vulkan::cast_volumes(device(), casting.scene, {.opaque_at = 1}, stats, [](double) {}, {}));
        state.SetIterationTime(stats.cast_device_s);
    }
    state.counters["samples"] = rate(done(state) * casting.samples);
}

/// The same into a z-thickness buffer of eight layers: rays, casting, kernel and read-back.
void vulkan_cast_slabs(benchmark::State& state) {
    static const Casting casting(CubeSettings{});
    const SlabSettings rule{.layers = 8, .opaque_at = 1};
    for (auto _ : state) {
        const auto pipeline = vulkan::make_slab_pipeline(device(), casting.scene, {kCubePixels, kCubePixels, rule.layers, SlabFormat::float32}, rule);
        SlabStageStats stats;
        pipeline->add_volume(casting.scene.volumes[0], {.step = 1}, false, stats);
        (void)pipeline->image();
        double seconds = 0;
        for (const StageTime& time : pipeline->device_times()) seconds += time.device_s;
        state.SetIterationTime(seconds);
    }
    state.counters["samples"] = rate(done(state) * casting.samples);
}

void register_all() {
    using benchmark::RegisterBenchmark;
    // Each run is long enough to be timed once; the repetitions are what counts.
    const auto once = [](benchmark::internal::Benchmark* b) {
        return b->Iterations(1)->UseRealTime()->MeasureProcessCPUTime()->Unit(benchmark::kMillisecond);
    };
    const auto thrice = [&](benchmark::internal::Benchmark* b) { return once(b)->Iterations(3); };
    thrice(RegisterBenchmark("draw/probe", splat_probe));
    once(RegisterBenchmark("draw/winners_5e7", draw_winners_only));
    thrice(RegisterBenchmark("draw/fast_5e7", draw_whole_ensemble<50'000'000, make_fast_drawer>));
    thrice(RegisterBenchmark("draw/fast_5e6", draw_whole_ensemble<5'000'000, make_fast_drawer>));
    once(RegisterBenchmark("draw/plain_5e7", draw_whole_ensemble<50'000'000, make_plain_drawer>));
    if (Backend::has_vulkan()) {
        const auto by_own_clock = [](benchmark::internal::Benchmark* b) {
            return b->Iterations(1)->UseManualTime()->Unit(benchmark::kMillisecond);
        };
        by_own_clock(RegisterBenchmark("vulkan/probe", vulkan_splat_probe));
        by_own_clock(RegisterBenchmark("vulkan/winners_5e7", winners_on_vulkan));
        by_own_clock(RegisterBenchmark("vulkan/ensemble_5e7", draw_on_vulkan<false>));
        by_own_clock(RegisterBenchmark("vulkan/ensemble_5e7_with_copies", draw_on_vulkan<true>));
        by_own_clock(RegisterBenchmark("vulkan/raster_probe", vulkan_raster_probe));
        by_own_clock(RegisterBenchmark("vulkan/peel_pass_1", vulkan_peel_pass<1>));
        by_own_clock(RegisterBenchmark("vulkan/peel_pass_8", vulkan_peel_pass<8>));
        by_own_clock(RegisterBenchmark("vulkan/depth_peeling", vulkan_depth_peeling));
        by_own_clock(RegisterBenchmark("vulkan/march_probe", vulkan_march_probe<false>));
        by_own_clock(RegisterBenchmark("vulkan/packed_march_probe", vulkan_march_probe<true>));
        by_own_clock(RegisterBenchmark("vulkan/cast_flat", vulkan_cast_image<false>));
        by_own_clock(RegisterBenchmark("vulkan/cast_lit", vulkan_cast_image<true>));
        by_own_clock(RegisterBenchmark("vulkan/slabs_8_layers", vulkan_cast_slabs));
    }
    thrice(RegisterBenchmark("sample/probe", lines_probe<TorusLinesProbe>));
    once(RegisterBenchmark("sample/copy", copy_probe));
    once(RegisterBenchmark("walk/probe", walk_probe));
    once(RegisterBenchmark("walk/torus", walk_torus<1>));
    once(RegisterBenchmark("walk/torus_thinned", walk_torus<100>));
    once(RegisterBenchmark("sample/torus_brownian", sample_by<torus, SamplerKind::brownian>));
    once(RegisterBenchmark("sample/torus_mesh", sample_by<torus, SamplerKind::mesh>));
    once(RegisterBenchmark("sample/torus_octree", sample_by<torus, SamplerKind::octree>));
    once(RegisterBenchmark("sample/torus", sample<torus, LineMode::exact>));
    once(RegisterBenchmark("sample/torus_fast_mode", sample<torus, LineMode::fast>));
    thrice(RegisterBenchmark("sample/sextic_probe", lines_probe<SexticLinesProbe>));
    once(RegisterBenchmark("sample/sextic", sample<barth_sextic_in_full, LineMode::exact>));
    once(RegisterBenchmark("sample/mesh", sample<nested_spheres_in_full, LineMode::exact>));
    once(RegisterBenchmark("sample/isosurface", sample<wavy_ball<Interpolation::trilinear>, LineMode::exact>));
    once(RegisterBenchmark("sample/catmull_rom", sample<wavy_ball<Interpolation::catmull_rom>, LineMode::exact>));
    once(RegisterBenchmark("sample/points", sample<wavy_points, LineMode::exact>));
    once(RegisterBenchmark("points/fit", fit_points));
    if (std::filesystem::exists(kHeadFile)) {
        once(RegisterBenchmark("sample/head", sample<head<Interpolation::trilinear>, LineMode::exact>));
        once(RegisterBenchmark("sample/head_catmull_rom", sample<head<Interpolation::catmull_rom>, LineMode::exact>));
    }
    register_slab_benchmarks();
    thrice(RegisterBenchmark("surfaces/peel_eight_spheres", peel_surfaces<0>));
    thrice(RegisterBenchmark("surfaces/peel_four_layers", peel_surfaces<4>));
    thrice(RegisterBenchmark("truth/probe", embree_probe));
    thrice(RegisterBenchmark("truth/gather", gather_all_hits));
    once(RegisterBenchmark("truth/sextic_512", trace_formula));
    RegisterBenchmark("truth/whole_box", trace_whole_truth<PixelFilter::box>)
        ->Iterations(1)->UseManualTime()->Unit(benchmark::kMillisecond);
    RegisterBenchmark("truth/whole_particle", trace_whole_truth<PixelFilter::particle>)
        ->Iterations(1)->UseManualTime()->Unit(benchmark::kMillisecond);
    thrice(RegisterBenchmark("cast/probe", trilinear_probe));
    const auto by_cast_time = [](benchmark::internal::Benchmark* b) {
        return b->Iterations(1)->UseManualTime()->Unit(benchmark::kMillisecond);
    };
    by_cast_time(RegisterBenchmark("cast/flat", cast_image<100, 1, false>));
    by_cast_time(RegisterBenchmark("cast/lit", cast_image<100, 1, true>));
    by_cast_time(RegisterBenchmark("cast/three_flat", cast_image<100, 3, false>));
    by_cast_time(RegisterBenchmark("cast/filled_50", cast_image<50, 1, false>));
    by_cast_time(RegisterBenchmark("cast/filled_20", cast_image<20, 1, false>));
    by_cast_time(RegisterBenchmark("cast/filled_5", cast_image<5, 1, false>));
    once(RegisterBenchmark("cast/slabs", cast_slabs<SlabsOfRays::all>));
    once(RegisterBenchmark("cast/slabs_8_layers", cast_slabs<SlabsOfRays::in_lanes>));
    once(RegisterBenchmark("cast/slabs_8_layers_one_by_one", cast_slabs<SlabsOfRays::one_by_one>));
}

// ---- Memory -----------------------------------------------------------------------------------

/// Samples and draws 5e7 particles and prints what was resident, in bytes. The budget: 16 a particle and
/// what a thread holds of one tile; and the image of sums that the caller gets.
void print_memory() {
    const PreparedScene scene = crossing_cards();
    const auto samplers = make_samplers(scene);
    const std::uint64_t before = peak_rss_bytes();
    const SamplerSettings settings{.seed = {}, .exact_count = 50'000'000 / kRepeats / samplers.size()};
    const ParticleSet particles = sample_particles(scene, samplers, settings, 0, kRepeats);
    const std::uint64_t sampled = peak_rss_bytes();
    EnsembleSums sums = make_sums(scene);
    const auto drawer = make_fast_drawer(scene);
    drawer->draw(particles, sums);
    const std::uint64_t drawn = peak_rss_bytes();
    const auto frames = static_cast<std::uint64_t>(drawer->bytes());
    const std::uint64_t image = sums.pixels.size() * sizeof(EnsembleSums::Pixel);
    const std::uint64_t budget = sizeof(Particle) * particles.count() + frames + image;
    fmt::print("{{\"threads\": {}, \"particles\": {}, \"particle_set_bytes\": {}, "
               "\"frame_bytes\": {}, \"sums_bytes\": {}, \"rss_before_bytes\": {}, "
               "\"rss_sampled_bytes\": {}, \"rss_drawn_bytes\": {}, \"budget_bytes\": {}}}\n",
               kThreads, particles.count(), particles.bytes(), frames, image, before, sampled, drawn, budget);
}

}  // namespace
}  // namespace pellucid::bench

int main(int argc, char** argv) {
    using namespace pellucid;
    set_thread_count(bench::kThreads);
    try {
        if (argc == 2 && std::strcmp(argv[1], "--memory") == 0) {
            bench::print_memory();
            return 0;
        }
        const BuildInfo build = build_info();
        benchmark::AddCustomContext("threads", std::to_string(bench::kThreads));
        benchmark::AddCustomContext("commit", build.commit);
        benchmark::AddCustomContext("compiler", build.compiler);
        benchmark::AddCustomContext("flags", build.flags);
        benchmark::AddCustomContext("build_type", build.build_type);
        const HostInfo host = host_info();
        benchmark::AddCustomContext("cpu", host.cpu);
        benchmark::AddCustomContext("os", host.os);
        benchmark::AddCustomContext("memory_bytes", std::to_string(host.memory_bytes));
        bench::register_all();
        benchmark::Initialize(&argc, argv);
        if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
        benchmark::RunSpecifiedBenchmarks();
    } catch (const std::exception& error) {
        fmt::print(stderr, "pellucid_bench: {}\n", error.what());
        return 4;
    }
    return 0;
}
