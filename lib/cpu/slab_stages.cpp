#include "cpu/slab_stages.hpp"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cassert>
#include <limits>
#include <optional>

#include "core/parallel.hpp"
#include "core/stopwatch.hpp"
#include "cpu/fast_volume_caster.hpp"
#include "stage/slab_compression.hpp"
#include "stage/slab_merge.hpp"
#include "stage/virtual_slab.hpp"

namespace pellucid {

using twin::Slab;

/// What a thread works with, kept so that nothing is allocated per pixel.
struct SlabFrame::Scratch {
    explicit Scratch(const SlabSettings& settings)
        : collector(settings), room(static_cast<std::size_t>(settings.layers)) {}

    SlabCollector collector;
    std::vector<Slab> room;    // the pixel's array as it was read
    std::vector<Slab> merged;
    std::vector<Slab> sorted;
};

struct SlabFrame::PerThread {
    tbb::enumerable_thread_specific<Scratch> scratch;
};

SlabFrame::SlabFrame(const ZThicknessSize& size, const SlabSettings& settings)
    : settings_(settings),
      buffer_(size),
      nearest_(static_cast<std::size_t>(size.width) * static_cast<std::size_t>(size.height),
               std::numeric_limits<float>::infinity()),
      threads_(new PerThread{tbb::enumerable_thread_specific<Scratch>([settings] { return Scratch(settings); })}) {
    assert(settings.layers == size.layers);
}
SlabFrame::~SlabFrame() = default;

SlabFrame::Scratch& SlabFrame::scratch() { return threads_->scratch.local(); }

void SlabFrame::intermix(std::size_t pixel, std::span<const Slab> array, float nearest) {
    if (array.empty()) return;
    Scratch& s = scratch();
    nearest_[pixel] = std::min(nearest_[pixel], nearest);
    std::span<const Slab> result = array;
    if (buffer_.touched(pixel)) {
        const std::span<const Slab> before = buffer_.read(pixel, s.room);
        s.merged.resize(before.size() + array.size());
        result = std::span<const Slab>(s.merged).first(merge_arrays(before, array, settings_, s.merged));
    }
    if (result.size() > buffer_.most_slabs()) {
        s.collector.start();
        for (const Slab& slab : result)
            if (!s.collector.push(slab)) break;
        result = s.collector.finish();
    }
    buffer_.write(pixel, result);
}

void SlabFrame::intermix_compressed(std::size_t pixel, std::span<const Slab> array, float nearest) {
    if (array.size() <= buffer_.most_slabs()) return intermix(pixel, array, nearest);
    Scratch& s = scratch();
    s.collector.start();
    for (const Slab& slab : array)
        if (!s.collector.push(slab)) break;
    const std::span<const Slab> few = s.collector.finish();
    s.sorted.assign(few.begin(), few.end());  // the collector may be needed once more
    intermix(pixel, s.sorted, nearest);
}

void SlabFrame::intermix_overlapping(std::size_t pixel, std::span<const Slab> slabs, float nearest) {
    // Most do not overlap, and then they are an array.
    const auto overlaps = [](const Slab& a, const Slab& b) { return twin::slab_front(b) < a.z; };
    if (std::ranges::adjacent_find(slabs, overlaps) == slabs.end()) return intermix_compressed(pixel, slabs, nearest);
    SlabArray array;
    for (const Slab& slab : slabs) insert_slab(array, slab, settings_);
    intermix_compressed(pixel, array, nearest);
}

namespace {

/// What all threads spend in the kernel.
class KernelTime {
public:
    void add(double seconds) { nanoseconds_.fetch_add(static_cast<std::int64_t>(1e9 * seconds), std::memory_order_relaxed); }
    [[nodiscard]] double wall_s() const { return 1e-9 * static_cast<double>(nanoseconds_) / thread_count(); }

private:
    std::atomic<std::int64_t> nanoseconds_{0};
};

}  // namespace

// ---- Polygon stage ------------------------------------------------------------------------------------------

void peel_into(SlabFrame& frame, const PreparedScene& scene, const SceneMeshes& meshes, std::uint32_t object,
               int surfaces, SlabStageStats& stats) {
    constexpr int kTimed = 16;  // every such column stands for its neighbours: a clock costs as much as a short array
    const auto width = static_cast<std::size_t>(scene.camera.width());
    KernelTime kernel;
    const PeelStats peeled =
        peel(scene, meshes, std::span(&object, 1), {.layers = surfaces},
             [&](int x, int y, std::span<const SurfaceFragment> fragments) {
                 thread_local std::vector<Slab> slabs;
                 slabs.clear();
                 for (const SurfaceFragment& f : fragments) slabs.push_back(f.slab);
                 const std::size_t pixel = static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
                 std::optional<Stopwatch> watch;
                 if (x % kTimed == 0) watch.emplace();
                 frame.intermix_overlapping(pixel, slabs, slabs.front().z);
                 if (watch) kernel.add(kTimed * watch->lap());
             });
    stats.fragments += peeled.fragments;
    stats.kernel_s += kernel.wall_s();
    stats.bytes = std::max(stats.bytes, static_cast<std::int64_t>(peeled.bytes));
}

// ---- Volume stage -------------------------------------------------------------------------------------------

void cast_into(SlabFrame& frame, const PreparedScene& scene, const Object& object, const CastSettings& settings,
               SlabStageStats& stats) {
    const IsosurfaceCaster caster(scene, object, settings);
    const double thickness = fixed_thickness(scene, object).value_or(caster.pitch());
    const auto width = static_cast<std::size_t>(scene.camera.width());
    std::atomic<std::uint64_t> slabs{0};
    KernelTime kernel;
    parallel_for(static_cast<std::size_t>(scene.camera.height()), 1, [&](std::size_t begin, std::size_t end) {
        SlabList found;
        for (std::size_t y = begin; y < end; ++y)
            for (std::size_t x = 0; x < width; ++x) {
                found.slabs.clear();
                found.clear = 1;
                caster.cast(scene.camera.ray(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5), thickness, found);
                if (found.slabs.empty()) continue;
                Stopwatch watch;
                frame.intermix_overlapping(y * width + x, found.slabs, found.slabs.front().z);
                kernel.add(watch.lap());
                slabs.fetch_add(found.slabs.size(), std::memory_order_relaxed);
            }
    });
    stats.slabs += slabs;
    stats.kernel_s += kernel.wall_s();
    stats.bytes = std::max(stats.bytes, static_cast<std::int64_t>(caster.bytes()));
}

void cast_into(SlabFrame& frame, const PreparedScene& scene, const VolumeObject& volume, const CastSettings& settings,
               float opaque_at, bool on_the_fly, SlabStageStats& stats) {
    const FastVolumeCaster caster(scene, volume, settings);
    const int width = scene.camera.width();
    const int height = scene.camera.height();
    std::atomic<std::uint64_t> slabs{0};
    KernelTime kernel;
    parallel_for(static_cast<std::size_t>((height + kPacketSide - 1) / kPacketSide), 1, [&](std::size_t begin, std::size_t end) {
        FastVolumeCaster::PacketSlabs all;
        FastVolumeCaster::CollectedPacket collected;
        SlabSettings rule = frame.settings();
        rule.opaque_at = opaque_at;
        SlabCollector collector(rule, SlabCollector::negligible_cost(rule, settings.step));
        for (int y0 = static_cast<int>(begin) * kPacketSide; y0 < static_cast<int>(end) * kPacketSide; y0 += kPacketSide)
            for (int x0 = 0; x0 < width; x0 += kPacketSide) {
                if (on_the_fly) caster.cast(x0, y0, opaque_at, all);
                else caster.cast_collected(x0, y0, collector, collected);
                Stopwatch watch;
                for (std::size_t i = 0; i < kPacketRays; ++i) {
                    const std::span<const Slab> array = on_the_fly ? all[i] : collected[i].slabs;
                    if (array.empty()) continue;
                    const auto x = static_cast<std::size_t>(x0) + i % kPacketSide;
                    const auto y = static_cast<std::size_t>(y0) + i / kPacketSide;
                    const float nearest = on_the_fly ? twin::slab_front(array.front()) : collected[i].nearest;
                    frame.intermix(y * static_cast<std::size_t>(width) + x, array, nearest);
                    slabs.fetch_add(on_the_fly ? array.size() : collected[i].seen, std::memory_order_relaxed);
                }
                kernel.add(watch.lap());
            }
    });
    stats.slabs += slabs;
    stats.kernel_s += kernel.wall_s();
    stats.bytes = std::max(stats.bytes, static_cast<std::int64_t>(caster.bytes()));
}

// ---- The image ----------------------------------------------------------------------------------------------

namespace {

/// color(pixel) and nearest(pixel) of every pixel.
template <class Color, class Nearest>
[[nodiscard]] Image make_image(const ZThicknessSize& size, const Color& color, const Nearest& nearest) {
    Image image(size.width, size.height);
    std::array<std::span<float>, 5> planes;
    const std::array<const char*, 5> names{"R", "G", "B", "A", "Z"};
    for (std::size_t i = 0; i < 5; ++i) planes[i] = image.add(names[i]);
    parallel_for(image.pixel_count(), 4096, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const Slab slab = color(i);
            planes[0][i] = slab.r;
            planes[1][i] = slab.g;
            planes[2][i] = slab.b;
            planes[3][i] = slab.a;
            planes[4][i] = nearest(i);
        }
    });
    return image;
}

}  // namespace

Image frame_image(const SlabFrame& frame) {
    return make_image(
        frame.buffer().size(), [&](std::size_t i) { return frame.buffer().image(i); },
        [&](std::size_t i) { return frame.nearest()[i]; });
}

Image order_free_image(std::span<const SlabFrame* const> frames, const SlabSettings& settings) {
    assert(!frames.empty());
    const auto color = [&](std::size_t pixel) {
        thread_local std::vector<std::vector<Slab>> rooms;
        thread_local std::vector<std::span<const Slab>> arrays;
        rooms.resize(std::max(rooms.size(), frames.size()));
        arrays.clear();
        for (std::size_t i = 0; i < frames.size(); ++i) {
            const ZThicknessBuffer& buffer = frames[i]->buffer();
            if (!buffer.touched(pixel)) continue;
            rooms[i].resize(buffer.most_slabs());
            arrays.push_back(buffer.read(pixel, rooms[i]));
        }
        return arrays.empty() ? Slab{} : composite(merge_order_free(arrays, settings));
    };
    return make_image(frames.front()->buffer().size(), color, [&](std::size_t pixel) {
        float nearest = std::numeric_limits<float>::infinity();
        for (const SlabFrame* frame : frames) nearest = std::min(nearest, frame->nearest()[pixel]);
        return nearest;
    });
}

// ---- The pipeline -------------------------------------------------------------------------------------------

namespace {

class CpuPipeline final : public SlabPipeline {
public:
    CpuPipeline(const PreparedScene& scene, const ZThicknessSize& size, const SlabSettings& settings)
        : scene_(scene), size_(size), settings_(settings) {}

    void add_polygons(const SceneMeshes& meshes, std::uint32_t object, int surfaces, SlabStageStats& stats) override {
        peel_into(frame(), scene_, meshes, object, surfaces, stats);
    }
    void add_isosurface(const Object& object, const CastSettings& settings, SlabStageStats& stats) override {
        cast_into(frame(), scene_, object, settings, stats);
    }
    void add_volume(const VolumeObject& volume, const CastSettings& settings, bool on_the_fly, SlabStageStats& stats) override {
        cast_into(frame(), scene_, volume, settings, settings_.opaque_at, on_the_fly, stats);
    }
    [[nodiscard]] Image image() override {
        if (frames_.empty()) (void)frame();
        if (settings_.intermix != SlabIntermix::order_free) return frame_image(*frames_.front());
        std::vector<const SlabFrame*> all;
        for (const auto& each : frames_) all.push_back(each.get());
        return order_free_image(all, settings_);
    }
    [[nodiscard]] std::size_t bytes() const override {
        return static_cast<std::size_t>(planned_slab_bytes(size_, settings_, frames_.size()));
    }
    [[nodiscard]] std::size_t buffers() const override { return frames_.size(); }

private:
    [[nodiscard]] SlabFrame& frame() {
        if (frames_.empty() || settings_.intermix == SlabIntermix::order_free)
            frames_.push_back(std::make_unique<SlabFrame>(size_, settings_));
        return *frames_.back();
    }

    const PreparedScene& scene_;
    ZThicknessSize size_;
    SlabSettings settings_;
    std::vector<std::unique_ptr<SlabFrame>> frames_;
};

}  // namespace

std::int64_t planned_slab_bytes(const ZThicknessSize& size, const SlabSettings& settings, std::size_t objects) {
    if (settings.intermix != SlabIntermix::order_free) return static_cast<std::int64_t>(planned_slab_bytes(size));
    const std::size_t slabs = objects * static_cast<std::size_t>(size.layers - 1);
    const std::size_t merge = slabs * sizeof(Slab) + order_free_plan(slabs).bytes;
    return static_cast<std::int64_t>(objects * planned_slab_bytes(size) + static_cast<std::size_t>(thread_count()) * merge);
}

std::unique_ptr<SlabPipeline> make_slab_pipeline(const PreparedScene& scene, const ZThicknessSize& size,
                                                 const SlabSettings& settings) {
    return std::make_unique<CpuPipeline>(scene, size, settings);
}

}  // namespace pellucid
