#include "cpu/particle_stages.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <oneapi/tbb/enumerable_thread_specific.h>

#include "core/parallel.hpp"
#include "kernel/normal_twin.h"
#include "scene/shading.hpp"

namespace pellucid {
namespace {

constexpr std::uint64_t kNoHit = ~std::uint64_t{0};
constexpr double kColorUnits = 65535;

/// Particles that are projected before any pixel is touched: their pixels' cache lines travel
/// meanwhile, and the batch (6 kB) stays in the first-level cache. Flat between 128 and 1024.
constexpr std::size_t kBatch = 256;
/// Pixels between fetching a sum and adding to it; one is shaded in about 50 ns, memory answers in 100.
constexpr std::size_t kFetchAhead = 16;

/// Asks for both ends: a pixel of the sums may lie on two cache lines.
void fetch(const EnsembleSums::Pixel& pixel) {
    __builtin_prefetch(&pixel, 1);
    __builtin_prefetch(reinterpret_cast<const char*>(&pixel + 1) - 1, 1);
}

/// Shades the winner of every hit pixel and adds it.
void add_frame(const PreparedScene& scene, const ParticleFrame& frame, const RepeatParticles& repeat,
               const WinnerFrame& winners, EnsembleSums& sums) {
    const std::span<const std::uint32_t> hit = winners.hit_pixels();
    for (std::size_t i = 0; i < hit.size(); ++i) {
        if (i + kFetchAhead < hit.size()) fetch(sums.pixels[hit[i + kFetchAhead]]);
        const std::uint32_t pixel = hit[i];
        const std::uint32_t index = winners.winner(pixel);
        const Particle& particle = repeat.particles[index];
        const auto object = std::upper_bound(repeat.object_ends.begin(), repeat.object_ends.end(), index) -
                            repeat.object_ends.begin();
        const twin::Vec3f n = twin::unpack_normal(particle.normal);
        const Vec3 color = shade(scene, scene.objects[static_cast<std::size_t>(object)],
                                 scene.camera.to_world(frame.view_position(particle)),
                                 scene.camera.world_vector({n.x, n.y, n.z}));
        EnsembleSums::Pixel& sum = sums.pixels[pixel];
        for (int c = 0; c < 3; ++c) {
            const double most = std::numeric_limits<std::uint32_t>::max();
            const auto units = static_cast<std::uint64_t>(std::min(color[c] * kColorUnits + 0.5, most));
            sum.color[c] += units;
            sum.square[c] += static_cast<WideCount>(units) * units;
        }
        ++sum.covered;
        sum.depth = std::min(sum.depth, twin::floatBitsToUint(particle.above_near));
    }
}

}  // namespace

WinnerFrame::WinnerFrame(int width, int height)
    : keys_(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), kNoHit), width_(width) {}

void WinnerFrame::draw(std::span<const Particle> particles, const twin::Projection& projection) {
    std::array<std::uint64_t, kBatch> keys;
    std::array<std::uint32_t, kBatch> pixels;
    for (std::size_t begin = 0; begin < particles.size(); begin += kBatch) {
        const std::size_t end = std::min(begin + kBatch, particles.size());
        std::size_t in_view = 0;
        for (std::size_t i = begin; i < end; ++i) {
            const twin::PixelDepth at = twin::project_particle(projection, particles[i]);
            if (at.column < 0) continue;
            pixels[in_view] = static_cast<std::uint32_t>(at.row) * static_cast<std::uint32_t>(width_) +
                              static_cast<std::uint32_t>(at.column);
            keys[in_view] = (static_cast<std::uint64_t>(at.depth) << 32U) | twin::scramble_index(static_cast<std::uint32_t>(i));
            __builtin_prefetch(&keys_[pixels[in_view]], 1);
            ++in_view;
        }
        for (std::size_t k = 0; k < in_view; ++k) {
            std::uint64_t& held = keys_[pixels[k]];
            if (held == kNoHit) hit_.push_back(pixels[k]);
            held = std::min(held, keys[k]);
        }
    }
}

void WinnerFrame::clear() {
    for (const std::uint32_t pixel : hit_) keys_[pixel] = kNoHit;
    hit_.clear();
}

void EnsembleSums::add(const EnsembleSums& other) {
    parallel_for(pixels.size(), 4096, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            Pixel& to = pixels[i];
            const Pixel& from = other.pixels[i];
            for (int c = 0; c < 3; ++c) {
                to.color[c] += from.color[c];
                to.square[c] += from.square[c];
            }
            to.covered += from.covered;
            to.depth = std::min(to.depth, from.depth);
        }
    });
    particles += other.particles;
    repeats += other.repeats;
}

double EnsembleSums::variance_of_mean(std::size_t pixel, int channel) const {
    if (repeats < 2) return kInfinity;
    const auto n = static_cast<double>(repeats);
    const Pixel& p = pixels[pixel];
    if (channel == 3) return (p.covered - p.covered / n * p.covered) / (n * (n - 1));
    const double sum = static_cast<double>(p.color[channel]) / kColorUnits;
    const double squares = static_cast<double>(p.square[channel]) / (kColorUnits * kColorUnits);
    return std::max(0.0, squares - sum * (sum / n)) / (n * (n - 1));
}

void draw_ensemble(const PreparedScene& scene, const ParticleSet& set, EnsembleSums& sums) {
    const Camera& camera = scene.camera;
    const twin::Projection projection = set.frame.projection(camera);
    struct Frames {
        WinnerFrame winners;
        EnsembleSums sums;
    };
    const std::size_t pixels = sums.pixels.size();
    oneapi::tbb::enumerable_thread_specific<Frames> frames([&] {
        return Frames{WinnerFrame(camera.width(), camera.height()),
                      {.pixels = std::vector<EnsembleSums::Pixel>(pixels)}};
    });
    parallel_for(set.repeats.size(), 1, [&](std::size_t begin, std::size_t end) {
        Frames& mine = frames.local();
        for (std::size_t i = begin; i < end; ++i) {
            const RepeatParticles& repeat = set.repeats[i];
            mine.winners.draw(repeat.particles, projection);
            add_frame(scene, set.frame, repeat, mine.winners, mine.sums);
            mine.winners.clear();
            mine.sums.particles += repeat.particles.size();
            ++mine.sums.repeats;
        }
    });
    for (const Frames& each : frames) sums.add(each.sums);
}

Image ensemble_image(const Camera& camera, const ParticleFrame& frame, const EnsembleSums& sums) {
    Image image(camera.width(), camera.height());
    const auto repeats = static_cast<double>(sums.repeats);
    const char* const names[4] = {"R", "G", "B", "A"};
    std::span<float> mean[4];
    std::span<float> variance[4];
    for (int c = 0; c < 4; ++c) {
        mean[c] = image.add(names[c]);
        variance[c] = image.add(std::string("variance.") + names[c]);
    }
    const std::span<float> z = image.add("Z", std::numeric_limits<float>::infinity());

    for (std::size_t i = 0; i < sums.pixels.size(); ++i) {
        const EnsembleSums::Pixel& p = sums.pixels[i];
        for (int c = 0; c < 3; ++c) mean[c][i] = static_cast<float>(static_cast<double>(p.color[c]) / kColorUnits / repeats);
        mean[3][i] = static_cast<float>(p.covered / repeats);
        for (int c = 0; c < 4; ++c) variance[c][i] = static_cast<float>(sums.variance_of_mean(i, c));
        if (p.covered > 0)
            z[i] = static_cast<float>(frame.view_position({0, 0, twin::uintBitsToFloat(p.depth), 0}).z);
    }
    return image;
}

}  // namespace pellucid
