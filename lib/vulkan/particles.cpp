#include "vulkan/particles.hpp"

#include <algorithm>
#include <array>
#include <cstring>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "kernel/particle_draw_twin.h"
#include "stage/particle_shading.hpp"
#include "stage/tile_spans.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kDrawWords[] = {
#include "shaders/particle_draw.comp.inc"
};
constexpr std::uint32_t kMeanWords[] = {
#include "shaders/particle_mean.comp.inc"
};

static_assert(sizeof(twin::PixelSums) == 56 && sizeof(twin::PackedSums) == 40 &&
              sizeof(twin::DrawSpan) == 20 && sizeof(twin::Particle) == 16);
static_assert(sizeof(twin::Material) == 84 && sizeof(twin::ViewLight) == 20 &&
              sizeof(twin::Projection) == 80);
static_assert(offsetof(twin::DrawSetup, view) == 80 && offsetof(twin::DrawSetup, tile_columns) == 96 &&
              offsetof(twin::DrawSetup, particles) == 104);

struct Push {
    std::uint64_t setup;
    std::uint32_t count;
    std::uint32_t first = 0;  // item
};

/// Vulkan in software leaves every loop, and silently, once an invocation went round its loops 65535 times
/// all told (Mesa, gallivm: LP_MAX_TGSI_LOOP_ITERATIONS). Items are cut so that they stay below; a GPU knows
/// no such number.
constexpr std::uint64_t kMostIterations = 60000;

/// Workgroups that keep a device busy: tiles are cut by repeats where there are fewer of them.
constexpr std::size_t kEnoughGroups = 1024;
constexpr std::size_t kEnoughGroupsInSoftware = 16;
/// Of the heap, the share that particles may take; images, keys and staging need room beside them.
constexpr std::uint64_t kHeapShare = 4;
constexpr std::uint64_t kMostChunkBytes = std::uint64_t{1} << 30U;

template <class T>
[[nodiscard]] std::span<const std::byte> bytes_of(const std::vector<T>& values) {
    return std::as_bytes(std::span(values));
}

/// Grows and never shrinks.
class Room {
public:
    void hold(const Device& device, std::uint64_t bytes) {
        if (bytes <= buffer_.bytes()) return;
        buffer_ = Buffer();  // the old one first: both may not fit
        buffer_ = Buffer(device, bytes + bytes / 4);
    }
    void exactly(const Device& device, std::uint64_t bytes) {
        if (bytes != buffer_.bytes()) buffer_ = Buffer(device, bytes);
    }
    [[nodiscard]] const Buffer& buffer() const { return buffer_; }
    [[nodiscard]] std::uint64_t address() const { return buffer_.address(); }

private:
    Buffer buffer_;
};

/// Consecutive particles of one repeat.
struct Piece {
    std::uint32_t repeat;
    std::uint32_t begin;
    std::uint32_t count;
    std::uint32_t to;  // place in the chunk
};

/// The same shader for workgroups of one size: shading and adding the winners, or only telling who they are.
struct DrawKernels {
    std::uint32_t size;
    Kernel draw, find;
};

/// Items of one round draw at the same time, so no two of them share a slot.
struct Rounds {
    std::vector<twin::DrawItem> items;  // round after round
    std::vector<std::uint32_t> begin;   // of each round, and their number
};

/// As much of a particle set as is on the device at a time: any spans, since each is drawn on its own.
struct Chunk {
    std::vector<Piece> pieces;
    std::vector<twin::DrawRun> runs;
    std::vector<twin::DrawSpan> spans;
    std::vector<std::uint32_t> tile_of_span;
    std::uint32_t particles = 0;
    std::uint32_t repeats = 0;  // that have a span here

    void add(const ParticleSet& set, std::uint32_t repeat_index, std::uint32_t tile, std::uint32_t first_run,
             std::uint32_t end_run) {
        const RepeatParticles& repeat = set.repeats[repeat_index];
        const std::uint32_t begin = run_begin(repeat, first_run);
        const std::uint32_t count = run_begin(repeat, end_run) - begin;
        if (pieces.empty() || pieces.back().repeat != repeat_index) ++repeats;
        if (!pieces.empty() && pieces.back().repeat == repeat_index &&
            pieces.back().begin + pieces.back().count == begin) {
            pieces.back().count += count;
        } else {
            pieces.push_back({repeat_index, begin, count, particles});
        }
        const auto first = static_cast<std::uint32_t>(runs.size());
        for (std::uint32_t run = first_run; run < end_run; ++run)
            runs.push_back({particles + run_begin(repeat, run) - begin,
                            particles + run_begin(repeat, run + 1) - begin,
                            repeat.runs[run].bin % set.objects});
        spans.push_back({particles, count, begin, first, static_cast<std::uint32_t>(runs.size())});
        tile_of_span.push_back(tile);
        particles += count;
    }
};

class VulkanDrawer final : public ParticleDrawer {
public:
    VulkanDrawer(const Device& device, const PreparedScene& scene, const DrawerSettings& settings)
        : device_(device),
          camera_(scene.camera),
          grid_(scene.camera.width(), scene.camera.height()),
          group_size_(group_size(device, settings)),
          mean_(device, kMeanWords, {.push_bytes = sizeof(Push), .constants = std::array{group_size_}}),
          commands_(device) {
        const ParticleFrame frame(camera_);
        const ParticleShading shading(scene, frame);
        setup_.projection = frame.projection(camera_);
        setup_.view = shading.view;
        const auto kernel = [&](std::uint32_t size, bool shaded) {
            // In software a subgroup runs in step and has one size; a GPU may choose among several.
            const bool one_subgroup = !device.info().is_gpu && size == device.info().subgroup_size;
            const std::array<std::uint32_t, 6> constants{
                size,
                shaded ? 1U : 0U,
                shading.texels.empty() ? 0U : 1U,
                static_cast<std::uint32_t>(shading.view.light_count),
                setup_.projection.doubt < 1 ? 0U : 1U,
                one_subgroup ? 1U : 0U};
            return Kernel(device, kDrawWords, {.push_bytes = sizeof(Push), .constants = constants});
        };
        for (const std::uint32_t size :
             {group_size_, std::min(twin::kMostGroup, device.info().max_workgroup_size)})
            if (kernels_.empty() || size > kernels_.back().size)
                kernels_.push_back({size, kernel(size, true), kernel(size, false)});
        const std::size_t enough = device.info().is_gpu ? kEnoughGroups : kEnoughGroupsInSoftware;
        const std::size_t parts = std::max<std::size_t>(1, enough / grid_.count());
        slots_ = grid_.count() * parts;
        const DeviceInfo& info = device.info();
        chunk_bytes_ =
            settings.particle_bytes > 0
                ? settings.particle_bytes
                : std::min({info.heap_bytes / kHeapShare, info.largest_allocation / 2, kMostChunkBytes});

        materials_ = filled(bytes_of(shading.materials));
        lights_ = filled(bytes_of(shading.lights));
        texels_ = filled(bytes_of(shading.texels));
        keys_ = Buffer(device, slots_ * twin::kSlotPixels * sizeof(std::uint64_t));
        setup_.tile_columns = grid_.columns;
        setup_.slots_a_tile = static_cast<std::uint32_t>(parts);
        setup_.keys = keys_.address();
        setup_.materials = materials_.address();
        setup_.lights = lights_.address();
        setup_.texels = texels_.address();
        setup_buffer_ = Buffer(device, sizeof(setup_));
        commands_.fill(keys_, 0, keys_.bytes(), ~0U);
        commands_.submit_and_wait();
    }

    void draw(const ParticleSet& set, EnsembleSums& sums) override {
        const std::uint64_t image_pixels = sums.pixels.size();
        sums_.exactly(device_, slots_ * twin::kSlotPixels * sizeof(twin::PackedSums));
        image_.exactly(device_, image_pixels * sizeof(twin::PixelSums));
        commands_.begin_stage("clear");
        commands_.fill(sums_.buffer(), 0, sums_.buffer().bytes(), 0);
        commands_.fill(image_.buffer(), 0, image_.buffer().bytes(), 0);
        commands_.end_stage();
        note(commands_.submit_and_wait());
        for_each_chunk(set, [&](const Chunk& chunk) {
            run(true, set, chunk, "project and resolve");
            const auto padded = static_cast<std::uint32_t>(grid_.count() * twin::kTilePixels);
            commands_.begin_stage("average");
            commands_.dispatch(mean_, Push{setup_buffer_.address(), padded},
                               device_.groups_for(padded, group_size_));
            commands_.end_stage();
            note(commands_.submit_and_wait());
        });
        std::vector<twin::PixelSums> read(image_pixels);
        download(device_, image_.buffer(), std::as_writable_bytes(std::span(read)));
        parallel_for(read.size(), 4096, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const twin::PixelSums& s = read[i];
                sums.pixels[i].add({.color = {s.red, s.green, s.blue},
                                    .square = {s.red_square, s.green_square, s.blue_square},
                                    .covered = s.covered,
                                    .depth = twin::depth_of_nearness(s.nearness)});
            }
        });
        sums.particles += set.count();
        sums.repeats += set.repeats.size();
    }

    [[nodiscard]] std::vector<Winners> winners(const ParticleSet& set) override {
        std::vector<Winners> all(set.repeats.size());
        for (std::size_t r = 0; r < all.size(); ++r) all[r].assign(set.repeats[r].particles.size(), kNoPixel);
        std::vector<std::uint32_t> local;
        for_each_chunk(set, [&](const Chunk& chunk) {
            run(false, set, chunk, "project");
            local.resize(chunk.particles);
            download(device_, pixels_.buffer(), std::as_writable_bytes(std::span(local)));
            std::size_t s = 0;
            for (const Piece& piece : chunk.pieces)
                for (; s < chunk.spans.size() && chunk.spans[s].first < piece.to + piece.count; ++s)
                    for (std::uint32_t i = 0; i < chunk.spans[s].count; ++i) {
                        const std::uint32_t won = local[chunk.spans[s].first + i];
                        if (won != twin::kNoTilePixel)
                            all[piece.repeat][chunk.spans[s].index + i] =
                                pixel_of(chunk.tile_of_span[s], won);
                    }
        });
        return all;
    }

    [[nodiscard]] std::vector<pellucid::StageTime> device_times() const override { return times_; }
    [[nodiscard]] std::int64_t bytes() const override {
        return static_cast<std::int64_t>(device_.peak_bytes());
    }

private:
    /// Whole subgroups: lavapipe 22.3 lets the idle invocations of a broken one write.
    [[nodiscard]] static std::uint32_t group_size(const Device& device, const DrawerSettings& settings) {
        const DeviceInfo& info = device.info();
        const std::uint32_t wished = settings.workgroup_size > 0 ? settings.workgroup_size
                                     : info.is_gpu               ? 256
                                                                 : 1;
        const std::uint32_t subgroup = std::max(1U, info.subgroup_size);
        const std::uint32_t most = std::min(twin::kMostGroup, info.max_workgroup_size);
        return std::min((wished + subgroup - 1) / subgroup * subgroup, most);
    }

    [[nodiscard]] Buffer filled(std::span<const std::byte> bytes) const {
        Buffer buffer(device_, bytes.size());
        upload(device_, buffer, bytes);
        return buffer;
    }

    [[nodiscard]] std::uint32_t pixel_of(std::uint32_t tile, std::uint32_t local) const {
        const auto width = static_cast<std::size_t>(camera_.width());
        return static_cast<std::uint32_t>(grid_.row_of(tile, local) * width + grid_.column_of(tile, local));
    }

    template <class Draw>
    void for_each_chunk(const ParticleSet& set, const Draw& draw) {
        Chunk chunk;
        const auto finish = [&] {
            if (!chunk.spans.empty()) draw(chunk);
            chunk = {};
        };
        for (std::uint32_t r = 0; r < set.repeats.size(); ++r)
            for_each_span(set.repeats[r], set.objects, grid_.count(),
                          [&](std::uint32_t tile, std::uint32_t first_run, std::uint32_t end_run) {
                              const std::uint64_t count =
                                  run_begin(set.repeats[r], end_run) - run_begin(set.repeats[r], first_run);
                              const bool full = (chunk.particles + count) * sizeof(Particle) > chunk_bytes_;
                              const bool next_repeat =
                                  chunk.pieces.empty() || chunk.pieces.back().repeat != r;
                              if (full || (next_repeat && chunk.repeats == twin::kPackedRepeats)) finish();
                              chunk.add(set, r, tile, first_run, end_run);
                          });
        finish();
    }

    /// How often, at most, an invocation goes round the loops of particle_draw.comp.glsl for a span. The
    /// round in which a loop finds that it is over counts, too.
    [[nodiscard]] std::uint64_t iterations(const twin::DrawSpan& span, bool shaded,
                                           std::uint32_t size) const {
        const std::uint64_t runs = span.end_run - span.first_run;
        const std::uint64_t steps = span.count / size + 1;
        const std::uint64_t lights = static_cast<std::uint64_t>(std::max(setup_.view.light_count - 2, 0)) + 1;
        // The loop over spans, over the particles, over the runs, over the particles of each, over further
        // lights.
        return 1 + (steps + 1) + (runs + 1) + (steps + 2 * runs) + (shaded ? (steps + runs) * lights : 0);
    }

    /// The chunk's spans by tile, a tile's in as many items as it has slots, in order of repeats; in software
    /// cut further, into rounds.
    [[nodiscard]] Rounds make_items(const Chunk& chunk, bool shaded, std::uint32_t size,
                                    std::vector<twin::DrawSpan>& sorted) const {
        std::vector<std::uint32_t> begin(grid_.count() + 1, 0);
        for (const std::uint32_t tile : chunk.tile_of_span) ++begin[tile + 1];
        for (std::size_t tile = 0; tile < grid_.count(); ++tile) begin[tile + 1] += begin[tile];
        sorted.resize(chunk.spans.size());
        std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
        for (std::size_t s = 0; s < chunk.spans.size(); ++s)
            sorted[next[chunk.tile_of_span[s]]++] = chunk.spans[s];
        std::vector<std::vector<twin::DrawItem>> rounds;
        const std::uint32_t parts = setup_.slots_a_tile;
        for (std::uint32_t tile = 0; tile < grid_.count(); ++tile)
            for (std::uint32_t part = 0; part < parts; ++part) {
                const std::uint64_t count = begin[tile + 1] - begin[tile];
                const auto end = static_cast<std::uint32_t>(begin[tile] + count * (part + 1) / parts);
                auto first = static_cast<std::uint32_t>(begin[tile] + count * part / parts);
                for (std::size_t round = 0; first < end; ++round) {
                    const std::uint32_t cut = end_of_item(sorted, first, end, shaded, size);
                    if (rounds.size() == round) rounds.emplace_back();
                    rounds[round].push_back({tile * parts + part, first, cut});
                    first = cut;
                }
            }
        Rounds all;
        for (const auto& round : rounds) {
            all.begin.push_back(static_cast<std::uint32_t>(all.items.size()));
            all.items.insert(all.items.end(), round.begin(), round.end());
        }
        all.begin.push_back(static_cast<std::uint32_t>(all.items.size()));
        return all;
    }

    /// As many spans as one item takes, at least one.
    [[nodiscard]] std::uint32_t end_of_item(const std::vector<twin::DrawSpan>& spans, std::uint32_t first,
                                            std::uint32_t end, bool shaded, std::uint32_t size) const {
        if (device_.info().is_gpu) return end;
        std::uint64_t sum = 0;
        std::uint32_t cut = first;
        while (cut < end && (sum += iterations(spans[cut], shaded, size)) <= kMostIterations) ++cut;
        if (cut == first)
            throw run_error(
                "{}: {} particles of one repeat in one tile of {} x {} pixels are more than Vulkan in "
                "software draws",
                device_.info().name, spans[first].count, twin::kTileSide, twin::kTileSide);
        return cut;
    }

    /// The narrowest kernel in which every span stays below the limit on loops, or the widest.
    [[nodiscard]] const DrawKernels& kernels_for(const Chunk& chunk, bool shaded) const {
        const auto fits = [&](const DrawKernels& each) {
            return device_.info().is_gpu || std::ranges::all_of(chunk.spans, [&](const twin::DrawSpan& span) {
                       return iterations(span, shaded, each.size) <= kMostIterations;
                   });
        };
        const auto first = std::ranges::find_if(kernels_, fits);
        return first == kernels_.end() ? kernels_.back() : *first;
    }

    /// Draws the chunk: shades and adds the winners, or only tells who they are.
    void run(bool shaded, const ParticleSet& set, const Chunk& chunk, const char* stage) {
        const DrawKernels& kernels = kernels_for(chunk, shaded);
        const Kernel& kernel = shaded ? kernels.draw : kernels.find;
        std::vector<twin::DrawSpan> spans;
        const Rounds rounds = make_items(chunk, shaded, kernels.size, spans);
        particles_.hold(device_, std::uint64_t{chunk.particles} * sizeof(Particle));
        pixels_.hold(device_, std::uint64_t{chunk.particles} * sizeof(std::uint32_t));
        runs_.hold(device_, bytes_of(chunk.runs).size());
        spans_.hold(device_, bytes_of(spans).size());
        items_.hold(device_, bytes_of(rounds.items).size());
        upload_particles(set, chunk);
        upload(device_, runs_.buffer(), bytes_of(chunk.runs));
        upload(device_, spans_.buffer(), bytes_of(spans));
        upload(device_, items_.buffer(), bytes_of(rounds.items));
        upload_setup();
        commands_.begin_stage(stage);
        for (std::size_t round = 0; round + 1 < rounds.begin.size(); ++round) {
            const std::uint32_t first = rounds.begin[round];
            const std::uint32_t count = rounds.begin[round + 1] - first;
            if (round > 0) commands_.barrier();  // keys and sums of the slots
            commands_.dispatch(kernel, Push{setup_buffer_.address(), count, first},
                               device_.groups_for(count, 1));
        }
        commands_.end_stage();
        note(commands_.submit_and_wait());
    }

    void upload_setup() {
        setup_.particles = particles_.address();
        setup_.runs = runs_.address();
        setup_.spans = spans_.address();
        setup_.items = items_.address();
        setup_.pixels = pixels_.address();
        setup_.sums = sums_.address();
        setup_.image = image_.address();
        upload(device_, setup_buffer_, std::as_bytes(std::span(&setup_, 1)));
    }

    void upload_particles(const ParticleSet& set, const Chunk& chunk) {
        const auto source = [&](const Piece& piece) {
            return std::as_bytes(
                std::span(set.repeats[piece.repeat].particles).subspan(piece.begin, piece.count));
        };
        const std::span<std::byte> mapped = particles_.buffer().mapped();
        if (mapped.empty()) {
            for (const Piece& piece : chunk.pieces)
                upload(device_, particles_.buffer(), source(piece),
                       std::uint64_t{piece.to} * sizeof(Particle));
            return;
        }
        parallel_for(chunk.pieces.size(), 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const auto bytes = source(chunk.pieces[i]);
                std::memcpy(mapped.data() + std::size_t{chunk.pieces[i].to} * sizeof(Particle), bytes.data(),
                            bytes.size());
            }
        });
    }

    void note(const std::vector<vulkan::StageTime>& times) {
        for (const vulkan::StageTime& t : times) {
            const auto known = std::find_if(times_.begin(), times_.end(),
                                            [&](const auto& each) { return each.name == t.name; });
            if (known == times_.end()) {
                times_.push_back({t.name, t.seconds});
            } else {
                known->device_s += t.seconds;
            }
        }
    }

    const Device& device_;
    const Camera& camera_;
    TileGrid grid_;
    std::uint32_t group_size_;
    std::uint64_t chunk_bytes_ = 0;
    std::uint64_t slots_ = 0;
    std::vector<DrawKernels> kernels_;  // by size
    Kernel mean_;
    Commands commands_;
    twin::DrawSetup setup_{};
    Buffer setup_buffer_, materials_, lights_, texels_, keys_;
    Room particles_, pixels_, runs_, spans_, items_, sums_, image_;
    std::vector<pellucid::StageTime> times_;
};

}  // namespace

std::unique_ptr<ParticleDrawer> make_particle_drawer(const Device& device, const PreparedScene& scene,
                                                     const DrawerSettings& settings) {
    return std::make_unique<VulkanDrawer>(device, scene, settings);
}

}  // namespace pellucid::vulkan
