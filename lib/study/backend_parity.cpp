#include "study/backend_parity.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <fmt/format.h>
#include <hwy/targets.h>

#include "core/parallel.hpp"
#include "core/stopwatch.hpp"
#include "cpu/fast_particles.hpp"
#include "cpu/plain_particles.hpp"
#include "harness/provenance.hpp"
#include "render/method.hpp"
#include "scene/scene_file.hpp"

namespace pellucid {
namespace {

class Fnv {
public:
    void add(const void* data, std::size_t bytes) {
        const auto* from = static_cast<const unsigned char*>(data);
        for (std::size_t i = 0; i < bytes; ++i) hash_ = (hash_ ^ from[i]) * 1099511628211ULL;
    }
    [[nodiscard]] std::uint64_t value() const { return hash_; }

private:
    std::uint64_t hash_ = 14695981039346656037ULL;
};

StageOutput run_winners(ParticleDrawer& drawer, const ParityScene& scene) {
    return {.winners = drawer.winners(scene.particles), .sums = {}};
}

ParityDifference compare_winners(const StageOutput& specified, const StageOutput& other) {
    ParityDifference d;
    std::uint64_t won = 0;
    std::uint64_t equal = 0;
    for (std::size_t r = 0; r < specified.winners.size(); ++r)
        for (std::size_t i = 0; i < specified.winners[r].size(); ++i) {
            const std::uint32_t here = specified.winners[r][i];
            const std::uint32_t there = other.winners[r][i];
            d.hits += here != kNoPixel ? 1U : 0U;
            won += here != kNoPixel || there != kNoPixel ? 1U : 0U;
            equal += here != kNoPixel && here == there ? 1U : 0U;
        }
    d.winners_equal_share = won > 0 ? static_cast<double>(equal) / static_cast<double>(won) : 1.0;
    d.different = won - equal;
    return d;
}

std::uint64_t hash_winners(const StageOutput& output) {
    Fnv fnv;
    for (const Winners& repeat : output.winners)
        fnv.add(repeat.data(), repeat.size() * sizeof(std::uint32_t));
    return fnv.value();
}

StageOutput run_colors(ParticleDrawer& drawer, const ParityScene& scene) {
    StageOutput output{.winners = {}, .sums = make_sums(*scene.scene)};
    drawer.draw(scene.particles, *output.sums);
    return output;
}

ParityDifference compare_colors(const StageOutput& specified, const StageOutput& other) {
    ParityDifference d{.hits = 0, .largest_mean_units = 0, .largest_sum_units = 0};
    std::uint64_t largest = 0;
    for (std::size_t i = 0; i < specified.sums->pixels.size(); ++i) {
        const EnsembleSums::Pixel& here = specified.sums->pixels[i];
        const EnsembleSums::Pixel& there = other.sums->pixels[i];
        d.hits += here.covered;
        for (int c = 0; c < 3; ++c)
            largest = std::max(
                largest, std::max(here.color[c], there.color[c]) - std::min(here.color[c], there.color[c]));
        d.different += std::memcmp(&here, &there, sizeof(here)) != 0 ? 1U : 0U;
    }
    d.largest_sum_units = static_cast<double>(largest);
    d.largest_mean_units =
        *d.largest_sum_units / static_cast<double>(std::max<std::uint64_t>(1, specified.sums->repeats));
    return d;
}

std::uint64_t hash_colors(const StageOutput& output) {
    static_assert(std::has_unique_object_representations_v<EnsembleSums::Pixel>);
    Fnv fnv;
    fnv.add(output.sums->pixels.data(), output.sums->pixels.size() * sizeof(EnsembleSums::Pixel));
    return fnv.value();
}

void keep_larger(std::optional<double>& value, const std::optional<double>& other) {
    if (other && (!value || *other > *value)) value = other;
}

/// Why the method cannot draw the scene here; empty where it can.
[[nodiscard]] std::string obstacle(const Scene& scene) {
    if (const auto refusal = method_by_name("particles").refusal(scene)) return *refusal;
    for (const Surface& surface : scene.surfaces)
        if (const auto* iso = std::get_if<IsosurfaceShape>(&surface.shape);
            iso != nullptr && !std::filesystem::exists(iso->volume))
            return fmt::format("surface \"{}\": volume {} is not there", surface.name, iso->volume.string());
    return {};
}

/// One thread for 1, else all that --threads gave.
class ThreadCount {
public:
    explicit ThreadCount(int threads) : before_(thread_count()) { set_thread_count(threads); }
    ~ThreadCount() { set_thread_count(before_); }
    ThreadCount(const ThreadCount&) = delete;
    ThreadCount& operator=(const ThreadCount&) = delete;

private:
    int before_;
};

/// Highway's choice of instruction set, put back when it goes.
class InstructionSet {
public:
    explicit InstructionSet(std::int64_t target) { hwy::SetSupportedTargetsForTest(target); }
    ~InstructionSet() { hwy::SetSupportedTargetsForTest(0); }
    InstructionSet(const InstructionSet&) = delete;
    InstructionSet& operator=(const InstructionSet&) = delete;
};

/// Device time of one part, 0 where it has not run.
[[nodiscard]] double time_of(const std::vector<StageTime>& times, const std::string& part) {
    for (const StageTime& time : times)
        if (time.name == part) return time.device_s;
    return 0;
}

}  // namespace

std::optional<ParityScene> sample_parity_scene(const std::filesystem::path& file, int height_px,
                                               std::uint32_t repeats, Seed seed, std::string& why_not) {
    Scene scene = load_scene(file);
    why_not = obstacle(scene);
    if (!why_not.empty()) return std::nullopt;
    scene.image.width =
        std::max(1, static_cast<int>(std::lround(1.0 * height_px * scene.image.width / scene.image.height)));
    scene.image.height = height_px;
    auto prepared = std::make_unique<const PreparedScene>(prepare(scene));
    ParticleSet particles = sample_particles(*prepared, make_sources(*prepared), {.seed = seed}, 0, repeats);
    return ParityScene{file.stem().string(), std::move(prepared), std::move(particles)};
}

ParityScene make_border_scene(const ParityScene& like, std::uint32_t particles_a_repeat,
                              std::uint32_t repeats, Seed seed) {
    auto prepared = std::make_unique<const PreparedScene>(prepare(like.scene->settings));
    const Camera& camera = prepared->camera;
    const ParticleFrame frame(camera);
    const auto objects = static_cast<std::uint32_t>(prepared->object_count());
    ParticleSet set{frame, objects, {}};
    std::vector<Particle> particles(particles_a_repeat, Particle{});
    std::vector<std::uint32_t> ends;
    for (std::uint32_t object = 1; object <= objects; ++object)
        ends.push_back(static_cast<std::uint32_t>(std::uint64_t{particles_a_repeat} * object / objects));
    for (std::uint32_t r = 0; r < repeats; ++r) {
        RandomStream random(seed, {.object = static_cast<std::uint32_t>(Purpose::test), .repeat = r});
        const auto unit = [&] { return unit_interval(random()); };
        for (std::uint32_t i = 0; i < particles_a_repeat; ++i) {
            // A corner of a pixel, or of a tile; from it 0.5 to 5e-9 pixels off.
            const double step = i % 3 == 0 ? twin::kTileSide : 1;
            Vec2 at(std::round(camera.width() * unit() / step) * step,
                    std::round(camera.height() * unit() / step) * step);
            at += std::pow(10.0, -8 * unit()) * Vec2(unit() - 0.5, unit() - 0.5);
            const double z = camera.near() + (camera.far() - camera.near()) * (i % 2 == 0 ? 0.5 : unit());
            const Vec2 side = (at - camera.center()) * camera.pixel_size() * (camera.perspective() ? z : 1);
            particles[i] = frame.pack({side.x, side.y, z}, {unit() - 0.5, unit() - 0.5, -unit()});
        }
        set.repeats.push_back(sort_by_tile(particles, ends, frame.projection(camera)));
    }
    return {camera.perspective() ? "borders, perspective" : "borders, orthographic", std::move(prepared),
            std::move(set)};
}

void Implementation::with(const std::function<void()>& run) const {
    const ThreadCount use_threads(threads);
    const InstructionSet use_target(target);
    run();
}

std::vector<Implementation> parity_implementations(const std::vector<Backend>& backends) {
    const std::string cpu = host_info().cpu;
    const int all = thread_count();
    std::vector<Implementation> list{{"plain CPU", cpu, 1, 0, make_plain_drawer},
                                     {"plain CPU", cpu, all, 0, make_plain_drawer}};
    for (const Backend& backend : backends) {
        if (backend.on_device()) {
            list.push_back({"Vulkan", backend.device_name(), all, 0, [backend](const PreparedScene& scene) {
                                return backend.make_particle_drawer(scene);
                            }});
            continue;
        }
        const std::vector<std::int64_t> targets = hwy::SupportedAndGeneratedTargets();  // the best one first
        const auto name = [](std::int64_t target) {
            return fmt::format("fast CPU, {}", hwy::TargetName(target));
        };
        list.push_back({name(targets.front()), cpu, 1, targets.front(), make_fast_drawer});
        for (const std::int64_t target : targets)
            list.push_back({name(target), cpu, all, target, make_fast_drawer});
    }
    // One core: what differs in its threads alone is the same.
    for (std::size_t i = 1; i < list.size();) {
        const bool known = std::any_of(
            list.begin(), list.begin() + static_cast<std::ptrdiff_t>(i), [&](const Implementation& each) {
                return each.name == list[i].name && each.device == list[i].device &&
                       each.threads == list[i].threads;
            });
        if (known)
            list.erase(list.begin() + static_cast<std::ptrdiff_t>(i));
        else
            ++i;
    }
    return list;
}

Implementation faulty_implementation(const std::string& name, DrawFault fault) {
    return {name, host_info().cpu, 1, 0,
            [fault](const PreparedScene& scene) { return make_faulty_drawer(scene, fault); }};
}

void ParityDifference::merge(const ParityDifference& other) {
    hits = std::max(hits, other.hits);
    if (other.winners_equal_share)
        winners_equal_share = std::min(winners_equal_share.value_or(1), *other.winners_equal_share);
    keep_larger(largest_mean_units, other.largest_mean_units);
    keep_larger(largest_sum_units, other.largest_sum_units);
    different = std::max(different, other.different);
}

const std::vector<ParityStage>& parity_stages() {
    static const std::vector<ParityStage> stages{
        {"winners", run_winners, compare_winners, hash_winners},
        {"colours", run_colors, compare_colors, hash_colors},
    };
    return stages;
}

std::vector<ParityRow> run_parity(const ParityStage& stage, const ParityScene& scene,
                                  const std::vector<Implementation>& implementations, int runs, Seed seed) {
    std::vector<std::unique_ptr<ParticleDrawer>> drawers;
    std::vector<ParityRow> rows(implementations.size());
    std::vector<std::size_t> order;
    StageOutput specified;

    // To warm up, and for the hash.
    for (std::size_t i = 0; i < implementations.size(); ++i) {
        implementations[i].with([&] {
            drawers.push_back(implementations[i].make_drawer(*scene.scene));
            StageOutput output = stage.run(*drawers[i], scene);
            rows[i].hash = stage.hash(output);
            rows[i].device_s = drawers[i]->device_times();
            if (i == 0)
                specified = std::move(output);
            else
                rows[i].difference = stage.compare(specified, output);
        });
        order.push_back(i);
    }

    RandomStream random(seed, {.object = static_cast<std::uint32_t>(Purpose::test)});
    for (int run = 0; run < runs; ++run) {
        std::shuffle(order.begin(), order.end(), random);
        for (const std::size_t i : order)
            implementations[i].with([&] {
                Stopwatch watch;
                const StageOutput output = stage.run(*drawers[i], scene);
                rows[i].wall_s.push_back(watch.lap());
                rows[i].difference.merge(stage.compare(specified, output));
            });
    }
    for (std::size_t i = 0; i < rows.size(); ++i) {
        std::vector<StageTime> times = drawers[i]->device_times();
        for (StageTime& time : times)
            time.device_s = runs > 0 ? (time.device_s - time_of(rows[i].device_s, time.name)) / runs : 0;
        rows[i].device_s = std::move(times);
    }
    return rows;
}

}  // namespace pellucid
