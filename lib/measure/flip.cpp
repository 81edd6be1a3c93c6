#include "measure/flip.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <span>

#include "core/parallel.hpp"
#include "core/vec.hpp"
#include "measure/magma.hpp"

namespace pellucid {
namespace {

using Plane = std::vector<double>;
using Kernel = std::vector<double>;  // odd length, centre in the middle

// --- Constants of the paper ----------------------------------------------------------------------

constexpr double kColorExponent = 0.7;       // q_c
constexpr double kFeatureExponent = 0.5;     // q_f
constexpr double kKneeShare = 0.4;           // p_c: share of the largest colour error …
constexpr double kKneeError = 0.95;          // p_t: … that is mapped to this error
constexpr double kFeatureWidthDegrees = 0.082;  // w: peak to trough of the human edge detector

/// Contrast sensitivity as a sum of Gaussians a·sqrt(π/b)·exp(−π² x²/b), x in degrees (paper, table 1).
struct Sensitivity {
    double a1, b1, a2, b2;
};
constexpr Sensitivity kAchromatic{1, 0.0047, 0, 1e-5};
constexpr Sensitivity kRedGreen{1, 0.0053, 0, 1e-5};
constexpr Sensitivity kBlueYellow{34.1, 0.04, 13.5, 0.025};
constexpr double kWidestSensitivity = 0.04;  // the largest b: all filters share its radius

/// D65 as the published programs have it.
const Vec3 kWhite{0.950428545, 1.0, 1.088900371};

/// Linear sRGB to XYZ, the rational matrix of the published programs.
const Mat3 kRgbToXyz(10135552.0 / 24577794, 2613072.0 / 12288897, 1425312.0 / 73733382,  // column R
                     8788810.0 / 24577794, 8788810.0 / 12288897, 8788810.0 / 73733382,   // column G
                     4435075.0 / 24577794, 887015.0 / 12288897, 70074185.0 / 73733382);  // column B
const Mat3 kXyzToRgb = glm::inverse(kRgbToXyz);

// --- Colour spaces -------------------------------------------------------------------------------

/// The linearised L*a*b* in which the eye's spatial filters act.
Vec3 ycxcz_from_rgb(const Vec3& rgb) {
    const Vec3 v = (kRgbToXyz * rgb) / kWhite;
    return {116 * v.y - 16, 500 * (v.x - v.y), 200 * (v.y - v.z)};
}

Vec3 rgb_from_ycxcz(const Vec3& color) {
    const double y = (color.x + 16) / 116;
    const Vec3 v{y + color.y / 500, y, y - color.z / 200};
    return kXyzToRgb * (v * kWhite);
}

double lab_curve(double t) {
    constexpr double kDelta = 6.0 / 29;
    return t > kDelta * kDelta * kDelta ? std::cbrt(t) : t / (3 * kDelta * kDelta) + 4.0 / 29;
}

/// L*a*b* with the chroma scaled by lightness (Hunt effect): differences in dark colours show less.
Vec3 hunt_lab_from_rgb(const Vec3& rgb) {
    const Vec3 v = (kRgbToXyz * rgb) / kWhite;
    const Vec3 f{lab_curve(v.x), lab_curve(v.y), lab_curve(v.z)};
    const double lightness = 116 * f.y - 16;
    return {lightness, 0.01 * lightness * 500 * (f.x - f.y), 0.01 * lightness * 200 * (f.y - f.z)};
}

/// HyAB: city block in lightness, Euclid in chroma; fit for large differences.
double hyab(const Vec3& a, const Vec3& b) {
    return std::abs(a.x - b.x) + std::hypot(a.y - b.y, a.z - b.z);
}

// --- Filters -------------------------------------------------------------------------------------

Kernel sampled(int radius, auto value_at) {
    Kernel kernel;
    for (int x = -radius; x <= radius; ++x) kernel.push_back(value_at(static_cast<double>(x)));
    return kernel;
}

/// Divides by the sum; returns that sum.
double normalise(Kernel& kernel) {
    double sum = 0;
    for (const double w : kernel) sum += w;
    for (double& w : kernel) w /= sum;
    return sum;
}

/// Scales positive weights to the sum 1 and negative ones to −1, so that a full step answers with 1. The
/// paper does so with the kernel in two dimensions; the factor across is positive and normalised, so
/// doing it along one is the same.
Kernel detector(Kernel kernel) {
    double positive = 0;
    double negative = 0;
    for (const double w : kernel) (w > 0 ? positive : negative) += w;
    for (double& w : kernel) w /= w > 0 ? positive : -negative;
    return kernel;
}

/// Correlates each row with `kernel`; the border pixel goes on outwards.
Plane along_rows(const Plane& in, std::size_t width, const Kernel& kernel) {
    const std::size_t radius = kernel.size() / 2;
    const std::size_t height = in.size() / width;
    Plane out(in.size(), 0.0);
    parallel_for(height, 8, [&](std::size_t begin, std::size_t end) {
        std::vector<double> row(width + 2 * radius);
        for (std::size_t y = begin; y < end; ++y) {
            const double* from = &in[y * width];
            std::fill_n(row.begin(), radius, from[0]);
            std::copy_n(from, width, row.begin() + static_cast<std::ptrdiff_t>(radius));
            std::fill_n(row.end() - static_cast<std::ptrdiff_t>(radius), radius, from[width - 1]);
            double* to = &out[y * width];
            for (std::size_t k = 0; k < kernel.size(); ++k) {
                const double w = kernel[k];
                for (std::size_t x = 0; x < width; ++x) to[x] += w * row[x + k];
            }
        }
    });
    return out;
}

/// The same down the columns.
Plane along_columns(const Plane& in, std::size_t width, const Kernel& kernel) {
    const auto radius = static_cast<std::ptrdiff_t>(kernel.size() / 2);
    const std::size_t height = in.size() / width;
    const auto last = static_cast<std::ptrdiff_t>(height) - 1;
    Plane out(in.size(), 0.0);
    parallel_for(height, 8, [&](std::size_t begin, std::size_t end) {
        for (std::size_t y = begin; y < end; ++y) {
            double* to = &out[y * width];
            for (std::size_t k = 0; k < kernel.size(); ++k) {
                const std::ptrdiff_t row = static_cast<std::ptrdiff_t>(y + k) - radius;
                const double* from = &in[static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(row, 0, last)) * width];
                const double w = kernel[k];
                for (std::size_t x = 0; x < width; ++x) to[x] += w * from[x];
            }
        }
    });
    return out;
}

/// One channel through its contrast sensitivity filter. The kernel a1·g1(x)g1(y) + a2·g2(x)g2(y) is not
/// separable, its two Gaussians are: the paper's normalisation (all weights in the plane sum to 1)
/// becomes a share of each.
Plane filtered(const Plane& in, std::size_t width, const Sensitivity& csf, double pixels_per_degree) {
    const double pi = std::numbers::pi;
    const int radius =
        static_cast<int>(std::ceil(3 * std::sqrt(kWidestSensitivity / (2 * pi * pi)) * pixels_per_degree));
    Plane out(in.size(), 0.0);
    std::array<Kernel, 2> kernels;
    std::array<double, 2> shares{};
    const std::array<double, 2> as{csf.a1, csf.a2};
    const std::array<double, 2> bs{csf.b1, csf.b2};
    for (std::size_t i = 0; i < 2; ++i) {
        const double per_px2 = pi * pi / (bs[i] * pixels_per_degree * pixels_per_degree);
        kernels[i] = sampled(radius, [&](double x) { return std::exp(-per_px2 * x * x); });
        const double sum = normalise(kernels[i]);
        shares[i] = as[i] * std::sqrt(pi / bs[i]) * sum * sum;
    }
    for (std::size_t i = 0; i < 2; ++i) {
        if (as[i] == 0) continue;
        const Plane part = along_columns(along_rows(in, width, kernels[i]), width, kernels[i]);
        const double share = shares[i] / (shares[0] + shares[1]);
        for (std::size_t p = 0; p < out.size(); ++p) out[p] += share * part[p];
    }
    return out;
}

// --- The two pipelines ---------------------------------------------------------------------------

/// What is compared: the colours after the eye's blur, and the strength of edges and points.
struct Percept {
    std::vector<Vec3> colors;  // Hunt-adjusted L*a*b*
    Plane edges;
    Plane points;
};

/// Strength of a feature: the length of the answers of the detector along x and along y.
Plane feature_strength(const Plane& along_x, const Plane& along_y) {
    Plane out(along_x.size());
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = std::hypot(along_x[i], along_y[i]);
    return out;
}

Percept perceive(const RgbImage& image, double pixels_per_degree) {
    const auto width = static_cast<std::size_t>(image.width);
    const std::size_t pixels = image.pixel_count();

    // Opponent colours, and the achromatic channel alone scaled to [0, 1] for the detectors.
    std::array<Plane, 3> opponent{Plane(pixels), Plane(pixels), Plane(pixels)};
    Plane luminance(pixels);
    for (std::size_t i = 0; i < pixels; ++i) {
        const Vec3 rgb{image.channels[0][i], image.channels[1][i], image.channels[2][i]};
        const Vec3 color = ycxcz_from_rgb(glm::clamp(rgb, 0.0, 1.0));
        for (std::size_t c = 0; c < 3; ++c) opponent[c][i] = color[static_cast<glm::length_t>(c)];
        luminance[i] = (color.x + 16) / 116;
    }

    Percept percept;

    // Colour: blur as the eye does, back into the box of the screen's colours, on to L*a*b*.
    opponent[0] = filtered(opponent[0], width, kAchromatic, pixels_per_degree);
    opponent[1] = filtered(opponent[1], width, kRedGreen, pixels_per_degree);
    opponent[2] = filtered(opponent[2], width, kBlueYellow, pixels_per_degree);
    percept.colors.resize(pixels);
    parallel_for(pixels, 4096, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const Vec3 rgb = rgb_from_ycxcz({opponent[0][i], opponent[1][i], opponent[2][i]});
            percept.colors[i] = hunt_lab_from_rgb(glm::clamp(rgb, 0.0, 1.0));
        }
    });

    // Features: first and second derivative of a Gaussian across, the Gaussian itself along.
    const double sigma = 0.5 * kFeatureWidthDegrees * pixels_per_degree;
    const int radius = static_cast<int>(std::ceil(3 * sigma));
    const auto gaussian = [sigma](double x) { return std::exp(-x * x / (2 * sigma * sigma)); };
    Kernel smooth = sampled(radius, gaussian);
    normalise(smooth);
    const Kernel edge = detector(sampled(radius, [&](double x) { return -x * gaussian(x); }));
    const Kernel point =
        detector(sampled(radius, [&](double x) { return (x * x / (sigma * sigma) - 1) * gaussian(x); }));
    const Plane smooth_x = along_rows(luminance, width, smooth);
    percept.edges = feature_strength(along_columns(along_rows(luminance, width, edge), width, smooth),
                                     along_columns(smooth_x, width, edge));
    percept.points = feature_strength(along_columns(along_rows(luminance, width, point), width, smooth),
                                      along_columns(smooth_x, width, point));
    return percept;
}

/// Colour error to [0, 1]: linear up to the knee, compressed above it, where differences are large anyway.
double redistributed(double error, double largest) {
    const double knee = kKneeShare * largest;
    return error < knee ? kKneeError / knee * error
                        : kKneeError + (error - knee) / (largest - knee) * (1 - kKneeError);
}

}  // namespace

FlipError flip(const RgbImage& test, const RgbImage& truth, double pixels_per_degree) {
    assert(test.width == truth.width && test.height == truth.height && test.pixel_count() > 0);
    assert(pixels_per_degree >= kMinPixelsPerDegree && pixels_per_degree <= kMaxPixelsPerDegree);
    const Percept a = perceive(test, pixels_per_degree);
    const Percept b = perceive(truth, pixels_per_degree);

    // The largest colour difference of the screen is that between its green and its blue.
    const double largest = std::pow(hyab(hunt_lab_from_rgb({0, 1, 0}), hunt_lab_from_rgb({0, 0, 1})), kColorExponent);

    const auto width = static_cast<std::size_t>(test.width);
    const auto height = static_cast<std::size_t>(test.height);
    FlipError error{0, Plane(test.pixel_count())};
    Plane rows(height, 0.0);
    parallel_for(height, 8, [&](std::size_t begin, std::size_t end) {
        for (std::size_t y = begin; y < end; ++y)
            for (std::size_t i = y * width; i < (y + 1) * width; ++i) {
                const double color =
                    redistributed(std::pow(hyab(a.colors[i], b.colors[i]), kColorExponent), largest);
                const double feature =
                    std::max(std::abs(a.edges[i] - b.edges[i]), std::abs(a.points[i] - b.points[i]));
                // At most 1 on paper; rounding must not make the exponent below negative.
                const double amplified = std::min(1.0, std::pow(feature / std::numbers::sqrt2, kFeatureExponent));
                error.map[i] = std::pow(color, 1 - amplified);
                rows[y] += error.map[i];
            }
    });
    for (const double row : rows) error.mean += row;
    error.mean /= static_cast<double>(test.pixel_count());
    return error;
}

Image magma_image(const std::vector<double>& values, int width, int height) {
    Image image(width, height);
    assert(values.size() == image.pixel_count());
    const auto linear = [](std::uint8_t byte) {
        const double v = byte / 255.0;
        return static_cast<float>(v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4));
    };
    const std::array<std::span<float>, 3> planes{image.add("R"), image.add("G"), image.add("B")};
    for (std::size_t i = 0; i < values.size(); ++i) {
        const auto entry = static_cast<std::size_t>(std::lround(255 * std::clamp(values[i], 0.0, 1.0)));
        for (std::size_t c = 0; c < 3; ++c) planes[c][i] = linear(kMagma[entry][c]);
    }
    return image;
}

}  // namespace pellucid
