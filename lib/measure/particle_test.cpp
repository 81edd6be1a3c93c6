#include "measure/particle_test.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <map>
#include <string>

#include "core/color.hpp"
#include "core/parallel.hpp"
#include "reference/ray_scene.hpp"

namespace pellucid {
namespace {

const std::array<std::string, 3> kColors{"R", "G", "B"};

[[nodiscard]] double squared(double x) { return x * x; }

/// What the theory says of one pixel, and what was drawn.
[[nodiscard]] PixelOutcome judge(std::size_t pixel, double covered, const BinomialLaw& law, const CoverageRule& rule) {
    const auto bits = random_bits(rule.seed, {.object = static_cast<std::uint32_t>(Purpose::p_value), .index = pixel});
    PixelOutcome outcome{.pixel = pixel};
    outcome.z = binomial_randomized_z(covered, law, unit_interval(bits[0]));
    outcome.p_value = normal_cdf(outcome.z);
    const double mean = law.trials * law.probability;
    outcome.outside = std::abs(covered - mean) > rule.sigmas * std::sqrt(mean * (1 - law.probability));
    outcome.share_outside = binomial_share_outside(law, rule.sigmas);
    return outcome;
}

void test_outside(CoverageTest& test) {
    for (const PixelOutcome& each : test.pixels) {
        test.outside += each.outside ? 1 : 0;
        test.outside_expected += each.share_outside;
        test.outside_variance += each.share_outside * (1 - each.share_outside);
    }
    const auto n = static_cast<double>(test.pixels.size());
    const auto outside = static_cast<double>(test.outside);
    if (test.outside_variance > 0)
        test.outside_test.statistic = (outside - test.outside_expected) / std::sqrt(test.outside_variance);
    test.outside_test.p_value = binomial_two_sided_p(outside, {.trials = n, .probability = test.outside_expected / n});
}

void test_uniformity(CoverageTest& test) {
    std::vector<double> values;
    for (const PixelOutcome& each : test.pixels) values.push_back(each.p_value);
    test.ks = ks_uniformity(values);
    test.chi2 = chi2_uniformity(p_value_histogram(test).counts);
}

void count(Histogram& histogram, double value) {
    const double bin = std::floor((value - histogram.lo) / histogram.width);
    ++histogram.counts[static_cast<std::size_t>(std::clamp(bin, 0.0, static_cast<double>(histogram.counts.size() - 1)))];
}

}  // namespace

double CoverageTest::smallest_p() const {
    return std::min({outside_test.p_value, ks ? ks->p_value : 1, chi2 ? chi2->p_value : 1});
}

CoverageTest test_coverage(std::span<const float> drawn, std::span<const float> truth,
                           std::span<const float> chosen_variance, const CoverageRule& rule) {
    assert(drawn.size() == truth.size() && truth.size() == chosen_variance.size());
    CoverageTest test;
    for (std::size_t i = 0; i < truth.size(); ++i) {
        const double p = truth[i];
        if (!(p > 0 && p < 1)) continue;
        const double variance = p * (1 - p) / rule.repeats;
        const double share = std::sqrt(chosen_variance[i] / variance);
        if (share > rule.largest_error_share) {
            ++test.left_out;
            continue;
        }
        test.pixels.push_back({.pixel = i});
        test.worst_error_share = std::max(test.worst_error_share, share);
        test.mean_noise_share += share * share;
        test.sensitivity += -(1 - p) * std::log1p(-p) / std::sqrt(variance);
    }
    if (test.pixels.empty()) return test;
    test.mean_noise_share /= static_cast<double>(test.pixels.size());
    test.sensitivity /= static_cast<double>(test.pixels.size());

    parallel_for(test.pixels.size(), 256, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const std::size_t pixel = test.pixels[i].pixel;
            const double covered = std::round(drawn[pixel] * rule.repeats);
            test.pixels[i] = judge(pixel, covered, {.trials = rule.repeats, .probability = truth[pixel]}, rule);
        }
    });
    test_outside(test);
    test_uniformity(test);
    return test;
}

Histogram p_value_histogram(const CoverageTest& test) {
    Histogram histogram{0, 1.0 / kPValueBins, std::vector<std::int64_t>(kPValueBins), {}};
    histogram.expected.assign(kPValueBins, static_cast<double>(test.pixels.size()) / kPValueBins);
    for (const PixelOutcome& each : test.pixels) count(histogram, each.p_value);
    return histogram;
}

Histogram z_histogram(const CoverageTest& test) {
    constexpr int kBins = 50;
    Histogram histogram{-5, 0.2, std::vector<std::int64_t>(kBins), {}};
    for (int i = 0; i < kBins; ++i) {
        const double below = i == 0 ? 0 : normal_cdf(histogram.lo + i * histogram.width);
        const double up_to = i == kBins - 1 ? 1 : normal_cdf(histogram.lo + (i + 1) * histogram.width);
        histogram.expected.push_back(static_cast<double>(test.pixels.size()) * (up_to - below));
    }
    for (const PixelOutcome& each : test.pixels) count(histogram, each.z);
    return histogram;
}

double smallest_shift_seen(std::size_t pixels, double level) {
    const double distance = std::sqrt(std::log(2 / level) / 2 / static_cast<double>(pixels));  // Kolmogorov's tail
    const double steepest = 0.3989422804014327;                                                // 1/sqrt(2π)
    return distance / steepest;
}

std::vector<float> opacity_off_by(std::span<const float> truth, double error) {
    std::vector<float> wrong(truth.size());
    std::transform(truth.begin(), truth.end(), wrong.begin(), [error](float opacity) {
        return static_cast<float>(-std::expm1((1 + error) * std::log1p(-static_cast<double>(opacity))));
    });
    return wrong;
}

EmptyPixels test_empty(std::span<const float> drawn, std::span<const float> truth, int width) {
    assert(width > 0 && drawn.size() == truth.size());
    const int height = static_cast<int>(truth.size() / static_cast<std::size_t>(width));
    const auto at = [width](int x, int y) {
        return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
    };
    EmptyPixels found;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            if (truth[at(x, y)] != 0) continue;
            bool alone = true;
            for (int v = std::max(0, y - 1); v <= std::min(height - 1, y + 1); ++v)
                for (int u = std::max(0, x - 1); u <= std::min(width - 1, x + 1); ++u) alone = alone && truth[at(u, v)] == 0;
            const int hit = drawn[at(x, y)] != 0 ? 1 : 0;
            (alone ? found.pixels : found.rim) += 1;
            (alone ? found.drawn : found.rim_drawn) += hit;
        }
    return found;
}

ColorTest test_colors(const Image& drawn, const Image& truth, double repeats) {
    double squares = 0, noise = 0, truth_noise = 0, variance_of_squares = 0;
    const std::span<const float> opacity = truth.plane("A");
    for (std::size_t i = 0; i < truth.pixel_count(); ++i) {
        double pixel_noise = 0, pixel_truth_noise = 0;
        for (const std::string& c : kColors) {
            squares += squared(static_cast<double>(drawn.plane(c)[i]) - static_cast<double>(truth.plane(c)[i]));
            pixel_noise += truth.plane("repeat_variance." + c)[i] / repeats;
            pixel_truth_noise += truth.plane("variance." + c)[i];
        }
        noise += pixel_noise;
        truth_noise += pixel_truth_noise;
        // Var(x̄²) of a mean of L_R values: (2 + excess kurtosis/L_R)·Var(x̄)²; of a coin: (1−6pq)/(pq).
        const double pq = static_cast<double>(opacity[i]) * (1 - static_cast<double>(opacity[i]));
        const double excess = pq > 0 ? std::max(0.0, (1 - 6 * pq) / pq) / repeats : 0;
        variance_of_squares += 2 * squared(pixel_noise + pixel_truth_noise) + excess * squared(pixel_noise);
    }
    const double values = 3 * static_cast<double>(truth.pixel_count());
    const double expected = noise + truth_noise;
    ColorTest test{.rmse = std::sqrt(squares / values), .floor = std::sqrt(noise / values),
                   .truth_error = std::sqrt(truth_noise / values)};
    if (!(expected > 0)) return test;
    test.ratio = std::sqrt(squares / expected);
    test.ratio_error = std::sqrt(variance_of_squares) / (2 * expected);  // d sqrt(x) = dx/2 at x = 1
    test.p_value = normal_two_sided_p((test.ratio - 1) / test.ratio_error);
    return test;
}

EdgeBias edge_bias(const Image& particle_truth, const Image& box_truth, double repeats) {
    EdgeBias bias{.map = Image(particle_truth.width(), particle_truth.height())};
    const std::size_t pixels = particle_truth.pixel_count();
    std::vector<double> off(pixels), noise(pixels), error(pixels);  // squares, summed over R, G, B
    for (const char* const name : {"R", "G", "B", "A"}) {
        const std::string c = name;
        const std::span<float> map = bias.map.add(c);
        const auto sharp = particle_truth.plane(c), box = box_truth.plane(c);
        const auto sharp_error = particle_truth.plane("variance." + c), box_error = box_truth.plane("variance." + c);
        for (std::size_t i = 0; i < pixels; ++i) {
            map[i] = sharp[i] - box[i];
            if (c == "A") continue;
            off[i] += squared(map[i]);
            noise[i] += particle_truth.plane("repeat_variance." + c)[i] / repeats;
            error[i] += static_cast<double>(sharp_error[i]) + static_cast<double>(box_error[i]);
        }
    }
    double squares = 0, errors = 0;
    std::int64_t covered = 0, above = 0;
    for (std::size_t i = 0; i < pixels; ++i) {
        squares += off[i];
        errors += error[i];
        covered += particle_truth.plane("A")[i] > 0 ? 1 : 0;
        above += off[i] > noise[i] && off[i] > 9 * error[i] ? 1 : 0;
    }
    bias.rmse = std::sqrt(std::max(0.0, squares - errors) / (3 * static_cast<double>(pixels)));
    bias.truth_error = std::sqrt(errors / (3 * static_cast<double>(pixels)));
    if (covered > 0) bias.share_above_noise = static_cast<double>(above) / static_cast<double>(covered);
    return bias;
}

Image signed_grey(const Image& map, double range) {
    Image grey(map.width(), map.height());
    std::array<std::span<float>, 3> planes{grey.add("R"), grey.add("G"), grey.add("B")};
    const auto red = map.plane("R"), green = map.plane("G"), blue = map.plane("B");
    for (std::size_t i = 0; i < map.pixel_count(); ++i) {
        const double luminance = 0.2126 * red[i] + 0.7152 * green[i] + 0.0722 * blue[i];
        const double byte = 128 + std::round(127 * std::clamp(luminance / range, -1.0, 1.0));
        for (const std::span<float>& plane : planes) plane[i] = static_cast<float>(srgb_decode(byte / 255));
    }
    return grey;
}

std::vector<SurfaceClass> surface_classes(const PreparedScene& scene) {
    assert(scene.objects.size() <= 32);
    const RayScene rays(scene);
    const auto width = static_cast<std::size_t>(scene.camera.width());
    const auto height = static_cast<std::size_t>(scene.camera.height());
    const std::size_t objects = scene.objects.size();
    // How often the ray through each corner of the pixel grid crosses each object.
    std::vector<std::uint16_t> crossings((width + 1) * (height + 1) * objects);
    parallel_for(height + 1, 1, [&](std::size_t begin, std::size_t end) {
        std::array<Ray, kPacket> packet;
        PacketHits hits;
        for (std::size_t y = begin; y < end; ++y)
            for (std::size_t first = 0; first <= width; first += kPacket) {
                for (std::size_t k = 0; k < kPacket; ++k)
                    packet[k] = scene.camera.ray(static_cast<double>(std::min(first + k, width)), static_cast<double>(y));
                rays.gather(packet, hits);
                for (std::size_t k = 0; k < kPacket && first + k <= width; ++k)
                    for (const RayHit& hit : hits[k]) ++crossings[(y * (width + 1) + first + k) * objects + hit.object];
            }
    });
    std::vector<SurfaceClass> classes(width * height);
    for (std::size_t i = 0; i < classes.size(); ++i)
        for (std::size_t object = 0; object < objects; ++object) {
            const std::size_t corner = i + i / width;  // the grid has one column more
            const auto count = [&](std::size_t at) { return crossings[at * objects + object]; };
            const std::array<std::uint16_t, 4> four{count(corner), count(corner + 1), count(corner + width + 1),
                                                    count(corner + width + 2)};
            const auto [least, most] = std::minmax_element(four.begin(), four.end());
            if (*most > 0) classes[i].objects |= 1U << object;
            classes[i].edge = classes[i].edge || *least != *most;
        }
    return classes;
}

std::vector<ClassOutcome> outside_by_class(const CoverageTest& test, std::span<const SurfaceClass> classes) {
    std::map<std::pair<std::uint32_t, bool>, ClassOutcome> found;
    for (const PixelOutcome& each : test.pixels) {
        const SurfaceClass& surfaces = classes[each.pixel];
        ClassOutcome& sums = found[{surfaces.objects, surfaces.edge}];
        sums.surfaces = surfaces;
        ++sums.pixels;
        sums.outside += each.outside ? 1 : 0;
        sums.expected += each.share_outside;
        sums.variance += each.share_outside * (1 - each.share_outside);
    }
    std::vector<ClassOutcome> outcomes;
    for (const auto& [key, outcome] : found) outcomes.push_back(outcome);
    return outcomes;
}

}  // namespace pellucid
