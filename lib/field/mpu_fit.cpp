#include "field/mpu_fit.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

namespace pellucid {
namespace {

/// Of the sum of weights: what keeps coefficients that no point determines (a scan line) at zero.
constexpr double kRidge = 1e-7;
/// Normals of one sheet without an edge differ by less: the paper's 0.9.
constexpr double kEdgeCosine = 0.9;
/// … and a third face stands out of the plane of the two that differ most by so much: the paper's 0.7.
constexpr double kCornerCosine = 0.7;
/// Noise makes edges too: pieces are believed where they leave this share of the smooth fit's error (root mean square).
/// On the bunny's scans ½ leaves 223 false edges, which cost most of the time of all lines.
constexpr double kSharpGain = 0.2;
/// Neighbours whose normals must agree on the side of an auxiliary point: the paper's 6.
constexpr std::size_t kAuxiliaryNeighbours = 6;

/// Solves A x = b for a symmetric positive A by Cholesky; what is not positive is left out (its unknown is 0).
template <std::size_t n>
[[nodiscard]] std::array<double, n> solve(std::array<std::array<double, n>, n> a, std::array<double, n> b) {
    std::array<bool, n> known{};
    for (std::size_t j = 0; j < n; ++j) {
        double pivot = a[j][j];
        const double diagonal = pivot;
        for (std::size_t k = 0; k < j; ++k) pivot -= a[j][k] * a[j][k];
        known[j] = pivot > 1e-13 * diagonal;
        const double root = known[j] ? std::sqrt(pivot) : 0;
        for (std::size_t i = j; i < n; ++i) {
            double sum = a[i][j];
            for (std::size_t k = 0; k < j; ++k) sum -= a[i][k] * a[j][k];
            a[i][j] = known[j] ? sum / root : 0;
        }
    }
    for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t k = 0; k < i; ++k) b[i] -= a[i][k] * b[k];
        b[i] = known[i] ? b[i] / a[i][i] : 0;
    }
    for (std::size_t i = n; i-- > 0;) {
        for (std::size_t k = i + 1; k < n; ++k) b[i] -= a[k][i] * b[k];
        b[i] = known[i] ? b[i] / a[i][i] : 0;
    }
    return b;
}

template <std::size_t n>
struct LeastSquares {
    std::array<std::array<double, n>, n> a{};
    std::array<double, n> b{};
    void add(const std::array<double, n>& row, double value, double weight) {
        for (std::size_t i = 0; i < n; ++i) {
            const double w = weight * row[i];
            for (std::size_t j = 0; j <= i; ++j) a[i][j] += w * row[j];
            b[i] += w * value;
        }
    }
};

/// The quadratic B-spline on [−1.5, 1.5].
[[nodiscard]] double spline(double t) {
    if (t >= 1.5) return 0;
    return t < 0.5 ? 0.75 - t * t : 0.5 * (1.5 - t) * (1.5 - t);
}

struct Weighted {
    std::span<const LocalPoint> points;
    std::vector<double> weight;
    double sum = 0;

    Weighted(std::span<const LocalPoint> all, double radius) : points(all), weight(all.size()) {
        for (std::size_t i = 0; i < all.size(); ++i) {
            weight[i] = spline(1.5 * length(all[i].at) / radius);
            sum += weight[i];
        }
        if (sum > 0) return;
        std::ranges::fill(weight, 1.0);
        sum = static_cast<double>(all.size());
    }
};

[[nodiscard]] Vec3 some_normal(const Vec3& mean) {
    const double size = length(mean);
    return size > 0 ? mean / size : Vec3(0, 0, 1);
}

/// w = h(u, v), a quadratic polynomial in the frame of the mean normal: sec. 4.2. Points of weight 0 do not count.
[[nodiscard]] Quadric bivariate(const Weighted& p) {
    Vec3 origin(0.0);
    Vec3 mean(0.0);
    for (std::size_t i = 0; i < p.points.size(); ++i) {
        origin += p.weight[i] * p.points[i].at;
        mean += p.weight[i] * p.points[i].normal;
    }
    origin /= p.sum;
    const Vec3 w = some_normal(mean);
    const Vec3 aside = std::abs(w.x) < 0.6 ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
    const Vec3 u = normalize(cross(w, aside));
    const Vec3 v = cross(w, u);
    LeastSquares<6> squares;
    for (std::size_t i = 0; i < p.points.size(); ++i) {
        const Vec3 x = p.points[i].at - origin;
        const double a = dot(u, x);
        const double b = dot(v, x);
        squares.add({1, a, b, a * a, a * b, b * b}, dot(w, x), p.weight[i]);
    }
    for (std::size_t i = 1; i < 6; ++i) squares.a[i][i] += kRidge * p.sum;
    const auto h = solve<6>(squares.a, squares.b);

    // q = w·x − h(u·x, v·x) = xᵀMx + l·x − h0
    const Vec3 l = w - h[1] * u - h[2] * v;
    const auto m = [&](int i, int j) {
        return -(h[3] * u[i] * u[j] + 0.5 * h[4] * (u[i] * v[j] + v[i] * u[j]) + h[5] * v[i] * v[j]);
    };
    const Quadric q{{-h[0], l.x, l.y, l.z, m(0, 0), m(1, 1), m(2, 2), 2 * m(0, 1), 2 * m(0, 2), 2 * m(1, 2)}};
    return q.seen_from(-origin, 1);
}

/// A quadric for two sheets or a closed surface, held by signed distances at the corners and the centre of the cell where
/// the points agree on them: sec. 4.1. Empty where they agree nowhere.
[[nodiscard]] std::optional<Quadric> general_quadric(const Weighted& p) {
    LeastSquares<10> squares;
    const auto row = [](const Vec3& x) {
        return std::array<double, 10>{1,         x.x,       x.y,       x.z,       x.x * x.x,
                                      x.y * x.y, x.z * x.z, x.x * x.y, x.x * x.z, x.y * x.z};
    };
    for (std::size_t i = 0; i < p.points.size(); ++i) squares.add(row(p.points[i].at), 0, p.weight[i] / p.sum);
    std::array<std::pair<Vec3, double>, 9> auxiliary;
    std::size_t count = 0;
    std::vector<std::pair<double, std::size_t>> near(p.points.size());
    const std::size_t neighbours = std::min(kAuxiliaryNeighbours, near.size());
    for (unsigned corner = 0; corner < 9; ++corner) {
        Vec3 q(0.0);
        if (corner < 8) q = {corner & 1U ? 0.5 : -0.5, corner & 2U ? 0.5 : -0.5, corner & 4U ? 0.5 : -0.5};
        for (std::size_t i = 0; i < near.size(); ++i) {
            const Vec3 x = q - p.points[i].at;
            near[i] = {dot(x, x), i};
        }
        std::ranges::partial_sort(near, near.begin() + static_cast<std::ptrdiff_t>(neighbours));
        double sum = 0;
        std::size_t outside = 0;
        for (std::size_t i = 0; i < neighbours; ++i) {
            const LocalPoint& point = p.points[near[i].second];
            const double d = dot(point.normal, q - point.at);
            sum += d;
            outside += d >= 0 ? 1U : 0U;
        }
        if (outside == 0 || outside == neighbours) auxiliary[count++] = {q, sum / static_cast<double>(neighbours)};
    }
    if (count == 0) return std::nullopt;
    for (std::size_t i = 0; i < count; ++i)
        squares.add(row(auxiliary[i].first), auxiliary[i].second, 1 / static_cast<double>(count));
    for (std::size_t i = 1; i < 10; ++i) squares.a[i][i] += kRidge;
    return Quadric{solve<10>(squares.a, squares.b)};
}

[[nodiscard]] double taubin_distance(const Quadric& q, const Vec3& at) {
    const double slope = length(q.gradient(at));
    const double value = std::abs(q.value(at));
    return slope > 1e-9 ? value / slope : value > 0 ? kInfinity : 0;
}

[[nodiscard]] double distance_from(const LocalFit& fit, const Vec3& at) {
    std::array<double, 3> values{};
    for (std::size_t k = 0; k < piece_count(fit.join); ++k) values[k] = fit.pieces[k].value(at);
    return taubin_distance(fit.pieces[deciding_piece(fit.join, values)], at);
}

struct FitError {
    double largest = 0;
    double mean_square = 0;
};

[[nodiscard]] FitError error_of(const LocalFit& fit, const Weighted& p, double own_radius) {
    FitError error;
    for (std::size_t i = 0; i < p.points.size(); ++i) {
        const double d = distance_from(fit, p.points[i].at);
        error.mean_square += p.weight[i] * d * d / p.sum;
        if (dot(p.points[i].at, p.points[i].at) < own_radius * own_radius) error.largest = std::max(error.largest, d);
    }
    return error;
}

/// Faces that meet in an edge or corner, by their normals: sec. 4.3. Empty where there is none.
[[nodiscard]] std::optional<LocalFit> sharp_fit(const Weighted& p) {
    const auto points = p.points;
    double least = kEdgeCosine;
    std::array<std::size_t, 2> apart{};
    for (std::size_t i = 0; i < points.size(); ++i)
        for (std::size_t j = i + 1; j < points.size(); ++j)
            if (const double c = dot(points[i].normal, points[j].normal); c < least) {
                least = c;
                apart = {i, j};
            }
    if (!(least < kEdgeCosine)) return std::nullopt;
    std::array<Vec3, 3> axis{points[apart[0]].normal, points[apart[1]].normal, Vec3(0.0)};
    std::size_t faces = 2;
    const Vec3 edge = cross(axis[0], axis[1]);
    if (length(edge) > 1e-3) {
        double most = kCornerCosine;
        for (const LocalPoint& point : points)
            if (const double c = std::abs(dot(point.normal, normalize(edge))); c > most) {
                most = c;
                axis[2] = point.normal;
                faces = 3;
            }
    }
    // Each point to the face whose normal is most like its own.
    std::array<std::vector<LocalPoint>, 3> face;
    std::array<std::vector<double>, 3> weight;
    for (std::size_t i = 0; i < points.size(); ++i) {
        std::size_t best = 0;
        for (std::size_t k = 1; k < faces; ++k)
            if (dot(points[i].normal, axis[k]) > dot(points[i].normal, axis[best])) best = k;
        face[best].push_back(points[i]);
        weight[best].push_back(p.weight[i]);
    }
    LocalFit fit;
    std::array<Vec3, 3> middle;
    std::array<Vec3, 3> normal;
    for (std::size_t k = 0; k < faces; ++k) {
        Weighted part(face[k], 1);
        part.weight = weight[k];
        part.sum = 0;
        for (const double w : part.weight) part.sum += w;
        if (!(part.sum > 1e-6 * p.sum)) return std::nullopt;
        fit.pieces[k] = bivariate(part);
        middle[k] = normal[k] = Vec3(0.0);
        for (const LocalPoint& point : face[k]) {
            middle[k] += point.at / static_cast<double>(face[k].size());
            normal[k] += point.normal / static_cast<double>(face[k].size());
        }
    }
    const auto convex = [&](std::size_t i, std::size_t j) {
        return dot(middle[j] - middle[i], normal[j] - normal[i]) > 0;
    };
    if (faces == 2) {
        fit.join = convex(0, 1) ? Join::max2 : Join::min2;
        return fit;
    }
    // The pair that is unlike the other two comes first.
    const std::array<bool, 3> opposite{convex(1, 2), convex(0, 2), convex(0, 1)};
    const auto count = std::ranges::count(opposite, true);
    if (count == 3 || count == 0) {
        fit.join = count == 3 ? Join::max3 : Join::min3;
        return fit;
    }
    const auto odd = static_cast<std::size_t>(std::ranges::find(opposite, count == 1) - opposite.begin());
    std::swap(fit.pieces[odd], fit.pieces[2]);
    fit.join = count == 2 ? Join::max_min : Join::min_max;
    return fit;
}

}  // namespace

Quadric Quadric::seen_from(const Vec3& o, double s) const {
    const Vec3 g = gradient(o);
    const double s2 = s * s;
    return {{value(o), s * g.x, s * g.y, s * g.z, s2 * c[4], s2 * c[5], s2 * c[6], s2 * c[7], s2 * c[8], s2 * c[9]}};
}

std::size_t deciding_piece(Join join, const std::array<double, 3>& v) {
    const auto larger = [&](std::size_t a, std::size_t b) { return v[b] > v[a] ? b : a; };
    const auto smaller = [&](std::size_t a, std::size_t b) { return v[b] < v[a] ? b : a; };
    switch (join) {
        case Join::one: return 0;
        case Join::max2: return larger(0, 1);
        case Join::min2: return smaller(0, 1);
        case Join::max3: return larger(larger(0, 1), 2);
        case Join::min3: return smaller(smaller(0, 1), 2);
        case Join::max_min: return larger(smaller(0, 1), 2);
        case Join::min_max: return smaller(larger(0, 1), 2);
    }
    return 0;
}

LocalFit fit_locally(std::span<const LocalPoint> points, const LocalFitOptions& options) {
    const Weighted p(points, options.radius);
    Vec3 mean(0.0);
    for (std::size_t i = 0; i < points.size(); ++i) mean += p.weight[i] * points[i].normal;
    mean = some_normal(mean);
    const bool one_sheet =
        std::ranges::all_of(points, [&](const LocalPoint& point) { return dot(point.normal, mean) > 0; });
    LocalFit fit;
    bool trusted = true;
    if (one_sheet) {
        fit.pieces[0] = bivariate(p);
    } else {
        const auto quadric = general_quadric(p);
        trusted = quadric.has_value();
        fit.pieces[0] = trusted ? *quadric : bivariate(p);
    }
    FitError error = error_of(fit, p, options.own_radius);
    if (options.sharp && points.size() <= options.few && error.largest > options.good_enough) {
        if (auto sharp = sharp_fit(p)) {
            const FitError sharp_error = error_of(*sharp, p, options.own_radius);
            if (sharp_error.mean_square <= kSharpGain * kSharpGain * error.mean_square) {
                sharp->error = sharp_error.largest;
                return *sharp;
            }
        }
    }
    fit.error = trusted ? error.largest : kInfinity;
    return fit;
}

}  // namespace pellucid
