#include "study/trust_images.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "io/image_file.hpp"
#include "render/particles.hpp"
#include "scene/scene_file.hpp"
#include "study/trust_meshes.hpp"

namespace pellucid {
namespace {

constexpr const char* kChannels[] = {"R", "G", "B", "A"};

PreparedScene scene_of(const std::string& toml, const std::filesystem::path& folder = {}) {
    const Config config = Config::parse(toml, "reference_trust", folder);
    Scene scene = scene_from_config(config);
    config.finish();
    return prepare(scene);
}

std::string view(int pixels, const char* camera) {
    return fmt::format("image.resolution = [{0}, {0}]\n[camera]\n{1}\n", pixels, camera);
}

constexpr const char* kAcross = "projection = \"orthographic\"\nposition = [0, 0, 4]\nview_height = 2.4";
constexpr const char* kAslant = "position = [0.9, 1.3, 4]\nfov_degrees = 34";

constexpr const char* kSheets = R"(
[[surface]]
rectangle = { center = [0.1, 0, 0.2], u = [0.7, 0.2, 0.3], v = [-0.1, 0.6, 0.1] }
color = [0.9, 0.3, 0.1]
opacity = 0.6
[[surface]]
rectangle = { center = [-0.2, 0.1, -0.2], u = [0.6, -0.3, 0], v = [0.2, 0.7, 0.2] }
color = [0.1, 0.4, 0.9]
opacity = 0.9
)";

constexpr const char* kRings = R"(
[[surface]]
implicit = "torus"
parameters = { major = 0.7, minor = 0.25 }
rotate_degrees = [50, 20, 0]
color = [0.2, 0.7, 0.3]
opacity = 0.5
shading = { ambient = 0.2, diffuse = 0.7, specular = 0.3, shininess = 20 }
[[surface]]
rectangle = { u = [0.9, 0, 0.1], v = [0, 0.5, 0.4] }
opacity = 0.7
)";

std::string sphere(const char* law) {
    return fmt::format(
        "[[surface]]\nimplicit = \"sphere\"\nscale = 0.8\nopacity = 0.6\nopacity_law = \"{}\"\n", law);
}

/// Twelve sheets, one a ten-thousandth behind the other, and a strip a twentieth of a pixel wide.
std::string thin_layers(int pixels) {
    std::string toml;
    for (int i = 0; i < 12; ++i)
        toml += fmt::format(
            "[[surface]]\nrectangle = {{ center = [0, {}, {}], u = [0.8, 0.1, 0], v = [0, 0.7, 0.2] }}\n"
            "opacity = 0.3\ncolor = [{}, 0.5, {}]\n",
            0.02 * i, -1e-4 * i, i / 11.0, 1 - i / 11.0);
    return toml + fmt::format(
                      "[[surface]]\nrectangle = {{ center = [0, 0, 1], u = [1, 0.13, 0], v = [0, {}, 0] }}\n"
                      "opacity = 0.9\n",
                      0.025 * 2.4 / pixels);
}

void write_checkers(const std::filesystem::path& file) {
    Image image(32, 32);
    for (const char* channel : kChannels) {
        const std::span<float> plane = image.add(channel, 1);
        if (channel[0] == 'A') continue;
        for (std::size_t i = 0; i < plane.size(); ++i) plane[i] = (i / 32 + i % 32) % 2 == 0 ? 1.0F : 0.05F;
    }
    write_png(image, Vec3(0.0), file);
}

double value(const Image& image, const std::string& plane, std::size_t i) {
    return static_cast<double>(image.plane(plane)[i]);
}

/// Whether a pixel's stated variance is the truth's floor: the largest contrast to a neighbour, squared,
/// times the variance that Laplace's rule gives a share of which n sub-rays met nothing, n = 64, 256, ….
bool is_floor(const Image& image, const char* channel, std::size_t i) {
    const double stated = value(image, std::string("variance.") + channel, i);
    if (stated == 0) return false;
    const int x = static_cast<int>(i) % image.width();
    const int y = static_cast<int>(i) / image.width();
    double contrast = 0;
    for (int v = std::max(0, y - 1); v <= std::min(image.height() - 1, y + 1); ++v)
        for (int u = std::max(0, x - 1); u <= std::min(image.width() - 1, x + 1); ++u)
            contrast = std::max(
                contrast, std::abs(value(image, channel, static_cast<std::size_t>(v * image.width() + u)) -
                                   value(image, channel, i)));
    for (double rays = 64; rays <= 1 << 24; rays *= 4) {
        const double floor = contrast * contrast * (1 / (rays + 2)) * (1 - 1 / (rays + 2)) / rays;
        if (std::abs(stated - floor) <= 1e-6 * floor) return true;
    }
    return false;
}

/// One layer of a stack at one depth.
struct Layer {
    Vec3 color;
    double alpha;
};

/// R, G, B, A of the stack, the mean over all orders in depth: zSlab (4.4) for two.
std::array<double, 4> mean_over_orders(const std::vector<Layer>& layers) {
    std::vector<std::size_t> order(layers.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::array<double, 4> sum{};
    int orders = 0;
    do {
        double clear = 1;
        for (const std::size_t k : order) {
            for (int c = 0; c < 3; ++c)
                sum[static_cast<std::size_t>(c)] += clear * layers[k].alpha * layers[k].color[c];
            clear *= 1 - layers[k].alpha;
        }
        sum[3] += 1 - clear;
        ++orders;
    } while (std::next_permutation(order.begin(), order.end()));
    for (double& s : sum) s /= orders;
    return sum;
}

const Layer kLayers[] = {
    {{1, 0.1, 0}, 0.6}, {{0, 0.9, 0.2}, 0.5}, {{0.1, 0, 1}, 0.3}, {{0.7, 0.8, 0.1}, 0.8}};

std::string surface_of(Coincidence kind, std::size_t layer) {
    std::string shape;
    switch (kind) {
        case Coincidence::rectangles:
            shape = "rectangle = {}\nrotate_degrees = [20, 10, 5]";
            break;
        case Coincidence::spheres:
            shape = "implicit = \"sphere\"";
            break;
        case Coincidence::mesh_on_plane:
            shape = layer % 2 == 0 ? "mesh = \"square.off\"" : "implicit = \"plane\"";
            shape += "\nrotate_degrees = [20, 10, 5]";
            break;
    }
    const Layer& l = kLayers[layer];
    return fmt::format("[[surface]]\n{}\nopacity = {}\ncolor = [{}, {}, {}]\nshading = \"flat\"\n", shape,
                       l.alpha, l.color.x, l.color.y, l.color.z);
}

const char* name_of(Coincidence kind) {
    switch (kind) {
        case Coincidence::rectangles:
            return "rectangles";
        case Coincidence::spheres:
            return "spheres";
        case Coincidence::mesh_on_plane:
            return "mesh on implicit";
    }
    return "";
}

}  // namespace

std::vector<TrustScene> error_scenes(int pixels, const std::filesystem::path& folder) {
    write_checkers(folder / "checkers.png");
    const std::string texture =
        "[[surface]]\nrectangle = { u = [0.9, 0, 0.4], v = [0.1, 0.8, 0], image = \"checkers.png\" "
        "}\nopacity = 0.8\n";
    std::vector<TrustScene> scenes;
    scenes.push_back({"edges", scene_of(view(pixels, kAcross) + kSheets)});
    scenes.push_back({"silhouette", scene_of(view(pixels, kAslant) + sphere("constant"))});
    scenes.push_back({"thin layers", scene_of(view(pixels, kAcross) + thin_layers(pixels))});
    scenes.push_back({"texture", scene_of(view(pixels, kAslant) + texture, folder)});
    scenes.push_back({"ring and sheet", scene_of(view(pixels, kAslant) + kRings)});
    scenes.push_back({"oblique rim", scene_of(view(pixels, kAslant) + sphere("oblique")), true});
    return scenes;
}

StatedError measure_stated_error(const PreparedScene& scene, const StatedErrorPlan& plan) {
    StatedError result;
    result.seeds = plan.seeds;
    const auto n = static_cast<double>(plan.seeds);
    const double asked = plan.truth.max_error * plan.truth.max_error;
    std::vector<std::vector<double>> values(plan.seeds);  // of a seed: all pixels of R, then of G, …
    std::vector<double> said(plan.seeds);                 // its sum of stated variances without floors
    double floors = 0, allowed = 0;
    std::uint64_t rays = 0;
    for (std::size_t s = 0; s < plan.seeds; ++s) {
        TruthSettings settings = plan.truth;
        settings.seed = derived_seed(plan.seed, s);
        TruthStats stats;
        const Image image = trace_truth(scene, settings, stats);
        rays += stats.rays;
        for (const char* channel : kChannels) {
            const std::span<const float> stated = image.plane(std::string("variance.") + channel);
            for (std::size_t i = 0; i < image.pixel_count(); ++i) {
                values[s].push_back(value(image, channel, i));
                const double variance = plan.variance_factor * static_cast<double>(stated[i]);
                (is_floor(image, channel, i) ? floors : said[s]) += variance;
                allowed += std::max(variance, asked);
            }
        }
    }
    const std::size_t cells = values[0].size();
    std::vector<double> was(plan.seeds);  // a seed's sum of squared deviations, its mean the true variance
    for (std::size_t k = 0; k < cells; ++k) {
        MeanVariance seen;
        for (const auto& picture : values) seen.add(picture[k]);
        result.worst_rms = std::max(result.worst_rms, std::sqrt(seen.variance()));
        for (std::size_t s = 0; s < plan.seeds; ++s) {
            const double off = values[s][k] - seen.mean();
            was[s] += off * off * n / (n - 1);
        }
    }
    const double all_said = std::accumulate(said.begin(), said.end(), 0.0);
    const double all_was = std::accumulate(was.begin(), was.end(), 0.0);
    const double count = n * static_cast<double>(cells);
    result.stated_variance = all_said / count;
    result.floor_variance = floors / count;
    result.true_variance = all_was / count;
    result.allowed_variance = allowed / count;
    result.rms = std::sqrt(result.true_variance);
    result.rays_per_pixel = 4 * static_cast<double>(rays) / count;
    if (all_was == 0) return result;
    result.ratio = all_said / all_was;
    // A ratio of two sums over independent seeds: the scatter of their difference from it (delta method).
    MeanVariance difference;
    for (std::size_t s = 0; s < plan.seeds; ++s) difference.add(said[s] - result.ratio * was[s]);
    result.ratio_error = difference.standard_error() / (all_was / n);
    return result;
}

std::vector<TrustScene> particle_scenes(int pixels) {
    std::string oblique_sheets = kSheets;
    for (std::size_t at = 0; (at = oblique_sheets.find("opacity = 0.", at)) != std::string::npos; at += 12)
        oblique_sheets.insert(oblique_sheets.find('\n', at), "\nopacity_law = \"oblique\"");
    std::vector<TrustScene> scenes;
    scenes.push_back({"edges, constant", scene_of(view(pixels, kAcross) + kSheets)});
    scenes.push_back({"edges, oblique", scene_of(view(pixels, kAslant) + oblique_sheets)});
    scenes.push_back({"ring and sheet, constant", scene_of(view(pixels, kAslant) + kRings)});
    scenes.push_back({"sphere, oblique", scene_of(view(pixels, kAslant) + sphere("oblique"))});
    return scenes;
}

ParticleVerdict judge_particles(const PreparedScene& scene, const ParticlePlan& plan) {
    RenderStats render_stats;
    ParticleSettings particles{.repeats = plan.repeats};
    particles.sampler.seed = derived_seed(plan.seed, 0);
    const Image drawn = render_particles(scene, particles, render_stats);
    const auto trace = [&](PixelFilter filter, std::uint64_t stream) {
        TruthStats stats;
        TruthSettings settings = plan.truth;
        settings.filter = filter;
        settings.seed = derived_seed(plan.seed, stream);
        return trace_truth(scene, settings, stats);
    };
    const Image truth = trace(plan.truth.filter, 1);
    const Image other = trace(PixelFilter::particle, 2);  // chooses the pixels: see particle_test.hpp

    const std::vector<float> opacity = opacity_off_by(truth.plane("A"), plan.optical_depth_error);
    const CoverageRule rule{.repeats = static_cast<double>(plan.repeats), .seed = derived_seed(plan.seed, 3)};
    const CoverageTest test = test_coverage(drawn.plane("A"), opacity, other.plane("variance.A"), rule);
    ParticleVerdict verdict;
    verdict.pixels = test.pixels.size();
    verdict.left_out = test.left_out;
    for (const PixelOutcome& pixel : test.pixels)
        verdict.worst_z = std::max(verdict.worst_z, std::abs(pixel.z));
    verdict.smallest_p = test.smallest_p();
    if (truth.has("repeat_variance.R")) {
        const ColorTest color = test_colors(drawn, truth, rule.repeats);
        verdict.color_ratio = color.ratio;
        verdict.color_p = color.p_value;
    }
    verdict.drawn_where_nothing_is =
        static_cast<double>(test_empty(drawn.plane("A"), opacity, drawn.width()).drawn);
    if (test.sensitivity > 0 && verdict.pixels > 0)
        verdict.smallest_error_seen = smallest_shift_seen(verdict.pixels, 0.001) / test.sensitivity;
    return verdict;
}

CoincidentResult measure_coincident(Coincidence kind, int layers, int pixels,
                                    const std::filesystem::path& folder, Seed seed) {
    TriangleMesh square;
    square.positions = {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}};
    square.triangles = {{0, 1, 2}, {0, 2, 3}};
    write_off(folder / "square.off", square);

    const auto count = static_cast<std::size_t>(layers);
    std::array<double, 4> right = mean_over_orders({kLayers, kLayers + count});
    if (kind == Coincidence::spheres) {  // met twice
        const double alpha = right[3];
        for (double& c : right) c *= 2 - alpha;
    }
    CoincidentResult result{.name = name_of(kind), .layers = layers};
    std::vector<std::size_t> order(count);
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::optional<Image> first;
    do {
        std::string toml = view(pixels, "position = [0.3, 0.4, 4]\nfov_degrees = 12");
        for (const std::size_t k : order) toml += surface_of(kind, k);
        TruthStats stats;
        Image image =
            trace_truth(scene_of(toml, folder), {.seed = seed, .max_error = 0.01, .max_samples = 64}, stats);
        for (std::size_t c = 0; c < 4; ++c)
            for (std::size_t i = 0; i < image.pixel_count(); ++i) {
                const double here = value(image, kChannels[c], i);
                result.worst_theory = std::max(result.worst_theory, std::abs(here - right[c]));
                const double there = first ? value(*first, kChannels[c], i) : here;
                const double unit = std::numeric_limits<float>::epsilon() * std::max(std::abs(there), 1e-30);
                result.worst_ulps = std::max(result.worst_ulps, std::abs(here - there) / unit);
            }
        result.pixels = image.pixel_count();
        ++result.orders;
        if (!first) first = std::move(image);
    } while (std::next_permutation(order.begin(), order.end()));
    return result;
}

}  // namespace pellucid
