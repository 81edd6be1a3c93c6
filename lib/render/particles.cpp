#include "render/particles.hpp"

#include <algorithm>
#include <cmath>
#include <memory>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "core/stopwatch.hpp"
#include "render/methods.hpp"
#include "render/shard.hpp"
#include "sample/surface_mesh.hpp"
#include "scene/shading.hpp"

namespace pellucid {
namespace {

[[nodiscard]] std::uint32_t all_repeats(const RenderInput& input) {
    return static_cast<std::uint32_t>(
        input.settings.integer("repeats", ParticleSettings{}.repeats, {.lo = 1, .hi = kMostRepeats}));
}

[[nodiscard]] SourceSettings read_source_settings(const RenderInput& input) {
    SourceSettings s;
    const ConfigTable walk = input.settings.table("walk");
    if (walk.has("step")) s.walk.step = walk.number("step", kRequired, {.lo = 0, .hi = 1, .lo_open = true});
    if (walk.has("walkers"))
        s.walk.walkers = static_cast<std::uint32_t>(walk.integer("walkers", kRequired, {.lo = 1, .hi = kMostWalkers}));
    s.walk.thinning = static_cast<std::uint32_t>(walk.integer("thinning", s.walk.thinning, {.lo = 1, .hi = 1 << 20}));
    s.walk.drift = walk.boolean("drift", s.walk.drift);
    s.walk.start = walk.choice<WalkSettings::Start>(
        "start", s.walk.start, {{"uniform", WalkSettings::Start::uniform}, {"single", WalkSettings::Start::single}});
    const ConfigTable mesh = input.settings.table("mesh");
    s.mesh_cells = static_cast<int>(mesh.integer("cells", s.mesh_cells, {.lo = 2, .hi = kMostMeshCells}));
    s.mesh_error_px = mesh.number("error_px", s.mesh_error_px, within(0, 16));
    s.octree_cells = static_cast<int>(
        input.settings.table("octree").integer("cells", s.octree_cells, {.lo = 2, .hi = kMostMeshCells}));
    s.counting_spheres = input.settings.choice<bool>("opacity_control", false, {{"exact", false}, {"counting-spheres", true}});
    const ConfigTable counting = input.settings.table("counting");
    s.counting.spheres = static_cast<std::uint32_t>(counting.integer("spheres", s.counting.spheres, {.lo = 1, .hi = 1 << 16}));
    s.counting.radius = counting.number("radius", s.counting.radius, at_least(0));
    s.seed = input.seed;
    return s;
}

[[nodiscard]] ParticleSettings read_settings(const RenderInput& input) {
    ParticleSettings s;
    s.repeats = all_repeats(input);
    if (input.shard) {
        const RepeatRange range = input.shard->part.repeats_of(s.repeats);
        s.first_repeat = range.first;
        s.repeats = range.end - range.first;
    }
    std::vector<std::string> names;
    for (const auto& [name, kind] : sampler_names()) names.emplace_back(name);
    const std::string sampler = input.settings.one_of("sampler", names.front(), names);
    for (const auto& [name, kind] : sampler_names())
        if (sampler == name) s.kind = kind;
    s.source = read_source_settings(input);
    s.oversampling = static_cast<std::uint32_t>(input.settings.integer("oversampling", s.oversampling, {.lo = 1, .hi = 1024}));
    if (input.settings.has("group")) {
        s.group = static_cast<std::uint32_t>(input.settings.integer("group", kRequired, {.lo = 1, .hi = 65536}));
        if (*s.group > all_repeats(input))
            throw input_error("particles.group = {}: expected at most particles.repeats = {}", *s.group, all_repeats(input));
    }
    if (s.kind == SamplerKind::stratified && input.shard)
        throw input_error("particles.sampler = \"stratified\" with --shard: its repeats belong together");
    s.sampler.trials = input.settings.choice<TrialLaw>(
        "count", TrialLaw::poisson, {{"poisson", TrialLaw::poisson}, {"binomial", TrialLaw::binomial}});
    s.sampler.lines = input.settings.choice<LineMode>("lines", LineMode::exact,
                                                      {{"exact", LineMode::exact}, {"fast", LineMode::fast}});
    if (s.sampler.lines == LineMode::fast && s.sampler.trials != TrialLaw::poisson)
        throw input_error(
            "particles.lines = \"fast\": expected \"exact\" where particles.count = \"binomial\"");
    if (s.kind == SamplerKind::stratified && (s.sampler.lines == LineMode::fast || s.sampler.trials != TrialLaw::poisson))
        throw input_error("particles.{} with particles.sampler = \"stratified\": expected \"lines\", whose repeats it is about",
                          s.sampler.lines == LineMode::fast ? "lines = \"fast\"" : "count = \"binomial\"");
    s.memory_mib = input.settings.integer("memory_mib", s.memory_mib, {.lo = 1, .hi = 1 << 20});
    s.sampler.seed = input.seed;
    s.max_error = input.max_error;
    s.backend = input.backend;
    return s;
}

/// A setting that some samplers do not read, and those that do.
struct ReadBy {
    std::string_view key;
    std::vector<SamplerKind> samplers;
};

[[nodiscard]] const std::vector<ReadBy>& settings_of_samplers() {
    using enum SamplerKind;
    static const std::vector<ReadBy> kTable{
        // "mesh" throws lines at what is flat already; "stratified" refuses what it does not draw.
        {"lines", {lines, stratified, mesh}},
        {"group", {stratified}},
        {"oversampling", {stratified}},
        {"memory_mib", {lines, brownian, mesh, octree}},
        {"walk.step", {brownian}},
        {"walk.walkers", {brownian}},
        {"walk.thinning", {brownian}},
        {"walk.drift", {brownian}},
        {"walk.start", {brownian}},
        {"mesh.cells", {mesh}},
        {"mesh.error_px", {mesh}},
        {"octree.cells", {octree}},
    };
    return kTable;
}

[[nodiscard]] bool is_given(const ConfigTable& settings, std::string_view key) {
    const std::size_t dot = key.find('.');
    return dot == key.npos ? settings.has(key) : settings.table(key.substr(0, dot)).has(key.substr(dot + 1));
}

void warn_of_unread_settings(const ConfigTable& given, const ParticleSettings& settings) {
    std::string_view sampler;
    for (const auto& [name, kind] : sampler_names())
        if (kind == settings.kind) sampler = name;
    for (const ReadBy& setting : settings_of_samplers())
        if (std::ranges::find(setting.samplers, settings.kind) == setting.samplers.end() && is_given(given, setting.key))
            warn("particles.{} is not read by particles.sampler = \"{}\"", setting.key, sampler);
    for (const std::string_view key : {"counting.spheres", "counting.radius"})
        if (!settings.source.counting_spheres && is_given(given, key))
            warn("particles.{} is not read by particles.opacity_control = \"exact\"", key);
}

/// Mean particles in one repeat, from the share of a few thousand trials that yield one.
[[nodiscard]] double expected_particles(const SourceRefs& sources,
                                        const SamplerSettings& settings) {
    constexpr std::uint64_t kProbes = 4096;
    double sum = 0;
    for (const ParticleSource* source : sources.all()) {
        if (!(source->virtual_pixels() > 0)) continue;
        std::uint64_t kept = 0;
        if (source->has_single_trials()) {
            for (std::uint64_t i = 0; i < kProbes; ++i) kept += source->trial({0}, ~0U, i) ? 1U : 0U;
        } else {
            std::vector<SourcePoint> points;
            source->trials_in_block(0, {0}, ~0U, 0, kProbes, points);
            kept = points.size();
        }
        sum +=
            mean_trials(*source, settings.trials) * static_cast<double>(kept) / static_cast<double>(kProbes);
    }
    return sum;
}

/// Keys and sums: of a tile a thread, and of the image. On a device: of all tiles, and its image as well.
[[nodiscard]] std::int64_t frame_bytes(const Camera& camera, const Backend& backend) {
    const std::int64_t pixels = std::int64_t{camera.width()} * camera.height();
    // A pixel: 8 bytes of key, 64 of sums, 4 of depth (cpu/fast_particles.cpp); for a device an estimate.
    constexpr std::int64_t kTileBytes = 76 * twin::kTilePixels;
    const std::int64_t image = pixels * static_cast<std::int64_t>(sizeof(EnsembleSums::Pixel));
    const auto tiles = static_cast<std::int64_t>(TileGrid(camera.width(), camera.height()).count());
    return backend.on_device() ? 2 * image + tiles * kTileBytes : image + kTileBytes * thread_count();
}

/// Repeats held together: what fits into memory_mib, but at least one a thread, and no more than asked.
[[nodiscard]] std::uint32_t batch_size(const ParticleSettings& settings, double particles_a_repeat) {
    const double fit = static_cast<double>(settings.memory_mib) * 0x1p20 /
                       (sizeof(Particle) * std::max(1.0, particles_a_repeat));
    // Repeats of a group share their lines: a group that is cut would be thrown again for each part.
    const double unit = settings.sampler.lines == LineMode::fast ? kLineGroup : 1;
    const double least = std::max(unit, static_cast<double>(thread_count()));
    const double whole = std::max(std::floor(fit / unit) * unit, std::ceil(least / unit) * unit);
    return static_cast<std::uint32_t>(std::min(whole, static_cast<double>(settings.repeats)));
}

/// Squared standard error of a pixel's worst channel, as estimated, if its repeats were independent. A pixel hit in none
/// or in all of them seems to have no error at all; Laplace's estimate of its share, (hits + 1)/(repeats + 2), does not
/// believe that before 1/n is small.
[[nodiscard]] double independent_error(const EnsembleSums& sums, std::size_t pixel) {
    const double n = sums.repeats_of(pixel);
    const double share = (sums.pixels[pixel].covered + 1) / (n + 2);
    double worst = share * (1 - share) / n;
    for (int c = 0; c < 4; ++c) worst = std::max(worst, sums.variance_of_independent(pixel, c));
    return worst;
}

/// The same of repeats as they are. Those of groups are better than independent ones, but where none or all of them hit.
[[nodiscard]] double squared_error(const EnsembleSums& sums, std::size_t pixel) {
    const double covered = sums.pixels[pixel].covered;
    if (sums.group_squares.empty() || covered == 0 || covered == sums.repeats_of(pixel)) return independent_error(sums, pixel);
    double worst = 0;
    for (int c = 0; c < 4; ++c) worst = std::max(worst, sums.variance_of_mean(pixel, c));
    return worst;
}

/// Squared error of a block of pixels. Groups are few, and the largest of many estimates by few is luck: those of a block
/// are averaged, over the pixels that were hit; the others are as good as their share allows.
class BlockError {
public:
    void add(const EnsembleSums& sums, std::size_t pixel) {
        const double error = squared_error(sums, pixel);
        if (sums.pixels[pixel].covered == 0) {
            empty_ = std::max(empty_, error);
            return;
        }
        sum_ += error;
        independent_ += independent_error(sums, pixel);
        ++hit_;
    }
    [[nodiscard]] double by_pixel() const { return std::max(empty_, sum_); }
    /// Where too few estimates are averaged, what as many independent repeats would have is believed if it is larger.
    [[nodiscard]] double by_groups(std::uint32_t groups) const {
        constexpr double kDegreesOfFreedom = 16;
        if (hit_ == 0) return empty_;
        const double few = hit_ * (groups - 1.0) < kDegreesOfFreedom ? independent_ : 0;
        return std::max(empty_, std::max(sum_, few) / hit_);
    }

private:
    double empty_ = 0, sum_ = 0, independent_ = 0;
    double hit_ = 0;
};

constexpr std::uint32_t kLeastRepeats = 16;  // before the first look

/// Tiles stop one by one, each once its largest standard error is what was asked for.
class AdaptiveTiles {
public:
    AdaptiveTiles(const Camera& camera, double max_error)
        : mask_(camera.width(), camera.height()),
          camera_(camera),
          max_error_(max_error),
          repeats_(mask_.active.size(), 0),
          groups_(mask_.active.size(), 0) {}

    /// Ends the tiles that are good enough by now.
    void update(const EnsembleSums& sums) {
        parallel_for(mask_.active.size(), 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t tile = begin; tile < end; ++tile) {
                if (mask_.active[tile] == 0) continue;
                repeats_[tile] = static_cast<std::uint32_t>(sums.repeats);
                groups_[tile] = sums.groups;
                if (largest_error(sums, tile) <= max_error_) mask_.active[tile] = 0;
            }
        });
    }
    [[nodiscard]] bool done() const { return !mask_.any(); }
    [[nodiscard]] std::shared_ptr<const TileMask> mask() const { return std::make_shared<TileMask>(mask_); }
    [[nodiscard]] std::size_t left() const {
        return static_cast<std::size_t>(std::ranges::count(mask_.active, std::uint8_t{1}));
    }
    [[nodiscard]] std::size_t size() const { return mask_.active.size(); }
    /// Largest error of the tiles that are not done.
    [[nodiscard]] double largest_error(const EnsembleSums& sums) const {
        double worst = 0;
        for (std::size_t tile = 0; tile < mask_.active.size(); ++tile)
            if (mask_.active[tile] != 0) worst = std::max(worst, largest_error(sums, tile));
        return worst;
    }
    /// Tells the sums how often each pixel was drawn.
    void write(EnsembleSums& sums) const {
        sums.pixel_repeats.resize(sums.pixels.size());
        if (!sums.group_squares.empty()) sums.pixel_groups.resize(sums.pixels.size());
        const auto width = static_cast<std::size_t>(camera_.width());
        for (std::size_t pixel = 0; pixel < sums.pixels.size(); ++pixel) {
            const std::size_t tile = mask_.grid.tile(static_cast<int>(pixel % width), static_cast<int>(pixel / width));
            sums.pixel_repeats[pixel] = repeats_[tile];
            if (!sums.pixel_groups.empty()) sums.pixel_groups[pixel] = groups_[tile];
        }
    }

private:
    [[nodiscard]] double largest_error(const EnsembleSums& sums, std::size_t tile) const {
        const int step = sums.group_squares.empty() ? 1 : 4;
        const auto x0 = static_cast<int>(mask_.grid.column_of(tile, 0));
        const auto y0 = static_cast<int>(mask_.grid.row_of(tile, 0));
        const int x1 = std::min(x0 + twin::kTileSide, camera_.width());
        const int y1 = std::min(y0 + twin::kTileSide, camera_.height());
        double worst = 0;
        for (int y = y0; y < y1; y += step)
            for (int x = x0; x < x1; x += step) {
                BlockError block;
                for (int v = y; v < std::min(y + step, y1); ++v)
                    for (int u = x; u < std::min(x + step, x1); ++u)
                        block.add(sums, static_cast<std::size_t>(v) * static_cast<std::size_t>(camera_.width()) +
                                            static_cast<std::size_t>(u));
                worst = std::max(worst, step == 1 ? block.by_pixel() : block.by_groups(sums.groups));
            }
        return std::sqrt(worst);
    }

    TileMask mask_;
    const Camera& camera_;
    double max_error_;
    std::vector<std::uint32_t> repeats_, groups_;
};

void warn_of_opacity(const char* kind, const std::string& name, double opacity) {
    if (opacity > kMostParticleOpacity)
        warn("{} \"{}\": opacity {} is drawn as 1 - 2^-20: at 1 particles are infinitely many", kind, name, opacity);
}

/// What stratified sets cost: their candidates.
[[nodiscard]] Stage plan_stratified(const PreparedScene& scene, const Sources& sources, const ParticleSettings& settings) {
    const std::uint32_t group = settings.group.value_or(
        default_group(scene, sources, settings.repeats, settings.oversampling));
    double all = 0;
    double most = 0;
    for (const auto& source : sources) {
        const CandidatePlan plan = plan_candidates(scene, *source, settings.oversampling);
        all += plan.particles * plan.oversampling;
        most = std::max(most, plan.particles * plan.oversampling);
    }
    // Candidates of one object are held twice, while they are sorted.
    return {"sample particles", 0, static_cast<std::int64_t>(2 * most * group * sizeof(Particle)),
            fmt::format("{:.3g} candidates for each of {} repeats, in groups of {}", all, settings.repeats, group)};
}

[[nodiscard]] std::vector<Stage> plan_particles(const RenderInput& input) {
    const ParticleSettings settings = read_settings(input);
    const Sources sources = make_sources(input.scene, settings.kind, settings.source);
    std::size_t pieces = 0;
    std::size_t sampler_bytes = 0;
    double trials = 0;
    for (const auto& source : sources) {
        pieces += source->piece_count();
        sampler_bytes += source->bytes();
        trials += mean_trials(*source, settings.sampler.trials);
    }
    const double particles = expected_particles(sources, settings.sampler);
    const std::uint32_t batch = batch_size(settings, particles);
    return {
        {"read scene", 0, static_cast<std::int64_t>(input.scene.bytes()),
         fmt::format("{} objects", sources.size())},
        {"cut into pieces", 0, static_cast<std::int64_t>(sampler_bytes), fmt::format("{} pieces", pieces)},
        settings.kind == SamplerKind::stratified
            ? plan_stratified(input.scene, sources, settings)
            : Stage{"sample particles", 0, static_cast<std::int64_t>(particles * batch * sizeof(Particle)),
                    fmt::format("{:.3g} particles from {:.3g} trials in each of {} repeats, {} repeats at a time", particles,
                                trials, settings.repeats, batch)},
        {"project and average", 0, frame_bytes(input.scene.camera, input.backend),
         input.backend.on_device() ? input.backend.device_name() : fmt::format("{} threads", thread_count())},
        {"image", 0, std::int64_t{9 * 4} * input.scene.camera.width() * input.scene.camera.height(),
         "9 planes"},
    };
}

[[nodiscard]] Image mean_image(const PreparedScene& scene, const EnsembleSums& sums, RenderStats& stats) {
    Stopwatch watch;
    Image image = ensemble_image(scene.camera, ParticleFrame(scene.camera), sums);
    stats.stages.push_back({"image", watch.lap(), 0, ""});
    return image;
}

}  // namespace

std::span<const std::pair<std::string_view, SamplerKind>> sampler_names() {
    static constexpr std::pair<std::string_view, SamplerKind> kNames[] = {
        {"lines", SamplerKind::lines},
        {"stratified", SamplerKind::stratified},
        {"brownian", SamplerKind::brownian},
        {"mesh", SamplerKind::mesh},
        {"octree", SamplerKind::octree},
    };
    return kNames;
}

EnsembleSums draw_particles(const PreparedScene& scene, const ParticleSettings& settings, RenderStats& stats,
                            const std::function<void(double)>& progress) {
    if (!(brightest_color(scene) <= kMostParticleColor))
        throw input_error("{}: lights and shading give colours up to {:.3g}, particles hold at most {}",
                          scene.settings.source, brightest_color(scene), kMostParticleColor);
    Stopwatch watch;
    const Sources sources = make_sources(scene, settings.kind, settings.source);
    const std::uint32_t batch = batch_size(settings, expected_particles(sources, settings.sampler));
    Stage cutting{"cut into pieces", watch.lap(), 0, ""};
    for (const auto& source : sources) cutting.bytes += static_cast<std::int64_t>(source->bytes());
    Stage sampling{"sample particles", 0, 0, ""};
    Stage drawing{"project and average", 0, 0, ""};

    // First the drawer: a device that is too small says so before the host fills its memory.
    const std::unique_ptr<ParticleDrawer> drawer = settings.backend.make_particle_drawer(scene);
    EnsembleSums sums = make_sums(scene);
    // With an error to reach, the number of repeats doubles until it is reached, tile by tile: a rule that does not
    // depend on memory or threads, so neither does the image.
    std::optional<AdaptiveTiles> tiles;
    if (settings.max_error) tiles.emplace(scene.camera, *settings.max_error);
    SamplerSettings sampler = settings.sampler;
    if (settings.kind == SamplerKind::stratified)
        sampler.stratify = StratifySettings{
            settings.group.value_or(default_group(scene, sources, settings.repeats, settings.oversampling)), settings.oversampling};
    const std::uint32_t unit = sampler.stratify ? sampler.stratify->group : 1;
    EnsembleSums group_sums{0, sums.units};
    std::uint32_t done = 0;
    // Looks come after whole groups: a group that is cut would be drawn twice, and tell less than its repeats should.
    std::uint32_t goal = tiles ? std::min(unit * std::max(4U, (kLeastRepeats + unit - 1) / unit), settings.repeats) : settings.repeats;
    while (done < settings.repeats) {
        const std::uint32_t count = std::min(sampler.stratify ? unit : batch, goal - done);
        const ParticleSet set = sample_particles(scene, sources, sampler, settings.first_repeat + done, count);
        sampling.wall_s += watch.lap();
        sampling.bytes = std::max(sampling.bytes, static_cast<std::int64_t>(set.bytes()));
        if (sampler.stratify) {
            group_sums = EnsembleSums(sums.pixels.size(), sums.units);
            drawer->draw(set, group_sums);
            sums.add_group(group_sums);
        } else {
            drawer->draw(set, sums);
        }
        drawing.wall_s += watch.lap();
        done += count;
        progress(static_cast<double>(done) / settings.repeats);
        if (!tiles || done < goal) continue;
        tiles->update(sums);
        if (tiles->done()) break;
        sampler.tiles = tiles->mask();
        goal = std::min(settings.repeats, 2 * goal);
    }
    if (tiles && !tiles->done())
        warn("the largest standard error is {:.3g} after particles.repeats = {}, {} was asked for: in {} of {} tiles",
             tiles->largest_error(sums), settings.repeats, *settings.max_error, tiles->left(), tiles->size());
    if (tiles) tiles->write(sums);
    drawing.bytes =
        drawer->bytes() + static_cast<std::int64_t>(sums.pixels.size() * sizeof(EnsembleSums::Pixel));
    stats.particles = sums.particles;
    stats.repeats = sums.repeats;
    for (const auto& source : sources) {
        stats.isolation += source->isolation();
        if (const std::string complaint = source->complaint(); !complaint.empty()) warn("{}", complaint);
    }
    stats.stages.insert(stats.stages.end(), {cutting, sampling, drawing});
    // What the device's clock says of parts of the drawing; their wall time is in "project and average".
    for (const StageTime& time : drawer->device_times())
        stats.stages.push_back({time.name, 0, 0, "part of the drawing", time.device_s});
    return sums;
}

Image render_particles(const PreparedScene& scene, const ParticleSettings& settings, RenderStats& stats,
                       const std::function<void(double)>& progress) {
    return mean_image(scene, draw_particles(scene, settings, stats, progress), stats);
}

Method particles_method() {
    static const std::string kSummary = fmt::format("opaque particles, ensemble mean (PBSR, PBVR): {}; volumes", kEveryShape);
    return {
        "particles",
        kSummary,
        {
            {"particles.repeats", "500", "L_R, independent particle sets that are averaged"},
            {"particles.sampler", "\"lines\"",
             "\"lines\": random lines along the edges of boxes and cells, points of triangles; \"stratified\": the same, "
             "at most one particle of an object in a pixel and repeats that make up for each other; "
             "\"brownian\": a walk on f = 0 (equations 2 and 3); \"mesh\", \"octree\": points of triangles that stand for "
             "f = 0"},
            {"particles.group", "1/8 of repeats",
             "stratified: repeats that share their candidates; 1/16 while that is 64 or more. A group is one value of variance.*"},
            {"particles.oversampling", "8",
             "stratified: candidates for each particle of independent repeats; fewer for objects that are almost opaque"},
            {"particles.walk.step", "0.03, or 0.3 of a cell",
             "brownian: sqrt(2 dt) as a share of the surface's width; of a cell's where volumes or points give no step"},
            {"particles.walk.walkers", "as many as do not clump",
             "brownian: walkers of a repeat; few, with small steps, put several particles into one pixel and lower the opacity"},
            {"particles.walk.thinning", "1", "brownian: every k-th position is kept"},
            {"particles.walk.drift", "true", "brownian: dx^(S) of equation (3)"},
            {"particles.walk.start", "\"uniform\"", "brownian: each walker at a uniform place, or all at a \"single\" one"},
            {"particles.mesh.cells", "128", "mesh: along the longest edge of the bounds (meshes are taken as they are)"},
            {"particles.mesh.error_px", "0", "mesh: in place of cells, largest distance from the surface; 0: cells"},
            {"particles.octree.cells", "128", "octree: leaves along the longest edge of the bounds"},
            {"particles.opacity_control", "\"exact\"",
             "\"exact\": particles by area; \"counting-spheres\": until spheres on the surface hold enough, as in the paper"},
            {"particles.counting.spheres", "100", "counting-spheres: how many"},
            {"particles.counting.radius", "0", "counting-spheres: scene units; 0: 2 % of the surface's size, 4 pixels at least"},
            {"particles.lines", "\"exact\"",
             "\"exact\": one crossing of a line at most; \"fast\": deals a line's crossings to different "
             "repeats, so that variance.* is too small, at most 4 times, where a view runs along them"},
            {"particles.count", "\"poisson\"",
             "law of a repeat's trials: \"poisson\" or \"binomial\" (a fixed number)"},
            {"particles.memory_mib", "1024", "particles held at a time"},
        },
        refusal_of_ray_and_particle_methods,
        [](const RenderInput& input) { warn_of_unread_settings(input.settings, read_settings(input)); },
        plan_particles,
        [](const RenderInput& input, RenderStats& stats) {
            const ParticleSettings settings = read_settings(input);
            if (settings.max_error && settings.sampler.lines == LineMode::fast)
                warn("--max-error takes repeats for independent, which those of particles.lines = \"fast\" "
                     "are not quite: the error may be larger");
            for (const Object& object : input.scene.objects)
                if (object.geometry->patch_count() > 0)
                    warn_of_opacity("surface", object.surface.name, object.surface.opacity * object.geometry->most_opacity());
            for (const VolumeObject& volume : input.scene.volumes)
                warn_of_opacity("volume", volume.settings().name, volume.most_opacity());
            EnsembleSums sums = draw_particles(input.scene, settings, stats, input.progress);
            Image image = mean_image(input.scene, sums, stats);
            if (input.shard)
                *input.shard = {input.shard->part, all_repeats(input), ParticleFrame(input.scene.camera),
                                std::move(sums)};
            return image;
        },
        true,
        true,
    };
}

}  // namespace pellucid
