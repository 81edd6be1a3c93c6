#include "stage/ensemble.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>

#include <unistd.h>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "scene/shading.hpp"

namespace pellucid {

void EnsembleSums::Pixel::add(const Pixel& other) {
    for (int c = 0; c < 3; ++c) {
        color[c] += other.color[c];
        square[c] += other.square[c];
    }
    covered += other.covered;
    depth = std::min(depth, other.depth);
}

EnsembleSums::EnsembleSums(const Camera& camera, double units_of_one)
    : EnsembleSums(static_cast<std::size_t>(camera.width()) * static_cast<std::size_t>(camera.height()),
                   units_of_one) {}

EnsembleSums::EnsembleSums(std::size_t pixel_count, double units_of_one)
    : pixels(pixel_count), units(units_of_one) {}

void EnsembleSums::add(const EnsembleSums& other) {
    parallel_for(pixels.size(), 4096, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) pixels[i].add(other.pixels[i]);
    });
    particles += other.particles;
    repeats += other.repeats;
}

namespace {

/// Sums of R, G, B in units and of A.
[[nodiscard]] std::array<double, 4> channel_sums(const EnsembleSums::Pixel& p) {
    return {static_cast<double>(p.color[0]), static_cast<double>(p.color[1]), static_cast<double>(p.color[2]),
            static_cast<double>(p.covered)};
}

}  // namespace

void EnsembleSums::add_group(const EnsembleSums& group) {
    group_squares.resize(pixels.size());
    if (groups == 0) group_repeats = group.repeats;
    assert(group.repeats <= group_repeats && complete_sums.empty());
    const bool complete = group.repeats == group_repeats;
    if (!complete) complete_sums.resize(pixels.size());
    const auto n = static_cast<double>(group.repeats);
    parallel_for(pixels.size(), 4096, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            if (!complete) {
                complete_sums[i] = channel_sums(pixels[i]);
                continue;
            }
            const std::array<double, 4> sums = channel_sums(group.pixels[i]);
            for (std::size_t c = 0; c < 4; ++c) group_squares[i][c] += sums[c] * sums[c] / n;
        }
    });
    groups += complete ? 1 : 0;
    add(group);
}

double EnsembleSums::variance_by_groups(std::size_t pixel, std::size_t channel) const {
    const double k = pixel_groups.empty() ? groups : pixel_groups[pixel];
    if (k < 2) return kInfinity;
    const double n = repeats_of(pixel);
    const auto size = static_cast<double>(group_repeats);
    const double sum = channel_sums(pixels[pixel])[channel];
    const double squares = group_squares[pixel][channel];
    const double part = n - k * size;  // repeats of a last group that is not complete
    const double complete = part > 0 ? complete_sums[pixel][channel] : sum;
    // A complete group's mean has the variance σ²/G.
    const double of_groups = std::max(0.0, squares - complete * (complete / (k * size))) / (k - 1);
    const double unit = channel == 3 ? 1 : units * units;
    if (!(part > 0)) return of_groups / n / unit;
    // The mean of m of its repeats, chosen at random, has w²(1/m − 1/G) more, w² the variance between repeats of a group: from
    // the squares within all groups. Repeats that are covered count 1, so do their squares.
    const double rest = sum - complete;
    const double all_squares =
        channel == 3 ? sum : static_cast<double>(pixels[pixel].square[channel]);
    const double within = std::max(0.0, all_squares - squares - rest * (rest / part)) / (n - k - 1);
    const double of_part = part * (part / size * of_groups + (1 - part / size) * within);
    return (k * size * of_groups + of_part) / (n * n) / unit;
}

double EnsembleSums::variance_of_mean(std::size_t pixel, int channel) const {
    return group_squares.empty() ? variance_of_independent(pixel, channel)
                                 : variance_by_groups(pixel, static_cast<std::size_t>(channel));
}

double EnsembleSums::variance_of_independent(std::size_t pixel, int channel) const {
    const double n = repeats_of(pixel);
    const Pixel& p = pixels[pixel];
    if (n < 2) return kInfinity;
    if (channel == 3) return (p.covered - p.covered / n * p.covered) / (n * (n - 1));
    const double sum = static_cast<double>(p.color[channel]) / units;
    const double squares = static_cast<double>(p.square[channel]) / (units * units);
    return std::max(0.0, squares - sum * (sum / n)) / (n * (n - 1));
}

double color_units_of(double brightest) {
    const int excess = brightest > 16 ? static_cast<int>(std::ceil(std::log2(brightest))) - 4 : 0;
    return std::ldexp(65535.0, -excess);
}

EnsembleSums make_sums(const PreparedScene& scene) {
    // The sums, and the nine planes that are made of them. Asked for and touched page by page, memory that is
    // not there would end the program, and perhaps others, before any error could be said.
    constexpr double kBytesOfPixel = sizeof(EnsembleSums::Pixel) + 9 * sizeof(float);
    const Camera& camera = scene.camera;
    const double needed = kBytesOfPixel * camera.width() * camera.height();
    const double there = static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
    if (needed > there)
        throw run_error("an image of {} x {} pixels needs {:.3g} GB of memory, this machine has {:.3g}", camera.width(),
                        camera.height(), needed / 1e9, there / 1e9);
    return {camera, color_units_of(brightest_color(scene))};
}

Image ensemble_image(const Camera& camera, const ParticleFrame& frame, const EnsembleSums& sums) {
    Image image(camera.width(), camera.height());
    add_ensemble_planes(frame, sums, image);
    return image;
}

void add_ensemble_planes(const ParticleFrame& frame, const EnsembleSums& sums, Image& image) {
    const char* const names[4] = {"R", "G", "B", "A"};
    std::span<float> mean[4];
    std::span<float> variance[4];
    for (int c = 0; c < 4; ++c) {
        mean[c] = image.add(names[c]);
        variance[c] = image.add(std::string("variance.") + names[c]);
    }
    const std::span<float> z = image.add("Z", std::numeric_limits<float>::infinity());
    if (!sums.pixel_repeats.empty()) {
        const std::span<float> count = image.add("repeats");
        for (std::size_t i = 0; i < sums.pixels.size(); ++i) count[i] = static_cast<float>(sums.pixel_repeats[i]);
    }

    for (std::size_t i = 0; i < sums.pixels.size(); ++i) {
        const EnsembleSums::Pixel& p = sums.pixels[i];
        const double repeats = sums.repeats_of(i);
        for (int c = 0; c < 3; ++c)
            mean[c][i] = static_cast<float>(static_cast<double>(p.color[c]) / sums.units / repeats);
        mean[3][i] = static_cast<float>(p.covered / repeats);
        for (int c = 0; c < 4; ++c) variance[c][i] = static_cast<float>(sums.variance_of_mean(i, c));
        if (p.covered > 0)
            z[i] = static_cast<float>(frame.view_position({0, 0, twin::uintBitsToFloat(p.depth), 0}).z);
    }
}

}  // namespace pellucid
