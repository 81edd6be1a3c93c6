#include "study/trust_closed_form.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <boost/multiprecision/cpp_bin_float.hpp>

#include "study/trust_rays.hpp"

namespace pellucid {
namespace {

using Digits = boost::multiprecision::cpp_bin_float_50;
using DigitsVec = std::array<Digits, 3>;

constexpr double kMinor = 0.4;                        // of the torus with major 1
constexpr std::array<double, 3> kAxes{1, 0.75, 0.5};  // of the ellipsoid: exact in binary
constexpr double kSlabHalf = 0.25;                    // half of its thickness; its sides are 2 long

DigitsVec digits(const Vec3& v) {
    return {Digits(v.x), Digits(v.y), Digits(v.z)};
}
Digits dot3(const DigitsVec& a, const DigitsVec& b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

using Powers = std::vector<Digits>;  // a polynomial, constant first

Digits value(const Powers& p, const Digits& t) {
    Digits sum = 0;
    for (std::size_t i = p.size(); i-- > 0;) sum = sum * t + p[i];
    return sum;
}

/// All changes of sign in [lo, hi], from those of the derivative: between two of them p is monotone.
std::vector<Digits> roots(const Powers& p, const Digits& lo, const Digits& hi) {
    std::vector<Digits> stops{lo};
    if (p.size() > 2) {
        Powers slope;
        for (std::size_t i = 1; i < p.size(); ++i) slope.push_back(p[i] * static_cast<int>(i));
        for (const Digits& t : roots(slope, lo, hi)) stops.push_back(t);
    }
    stops.push_back(hi);
    std::vector<Digits> found;
    for (std::size_t i = 0; i + 1 < stops.size(); ++i) {
        Digits a = stops[i];
        Digits b = stops[i + 1];
        const bool rises = value(p, b) > 0;
        if ((value(p, a) > 0) == rises) continue;
        for (int step = 0; step < 150; ++step) {
            const Digits middle = (a + b) / 2;
            if ((value(p, middle) > 0) == rises)
                b = middle;
            else
                a = middle;
        }
        found.push_back((a + b) / 2);
    }
    return found;
}

Powers product(const Powers& a, const Powers& b) {
    Powers c(a.size() + b.size() - 1, Digits(0));
    for (std::size_t i = 0; i < a.size(); ++i)
        for (std::size_t j = 0; j < b.size(); ++j) c[i + j] += a[i] * b[j];
    return c;
}

void add(Powers& a, const Powers& b, const Digits& factor) {
    a.resize(std::max(a.size(), b.size()), Digits(0));
    for (std::size_t i = 0; i < b.size(); ++i) a[i] += factor * b[i];
}

/// A line in the surface's own frame: o + (t − t0)·d there, with t0 close to the surface.
struct LocalLine {
    std::array<Powers, 3> x;  // each coordinate, linear in t − t0
    Digits t0;
    Digits reach;  // the surface lies within t0 ± reach
};

LocalLine local_line(const Ray& ray, const Placement& placement) {
    LocalLine line;
    const DigitsVec o = digits(ray.origin);
    const DigitsVec d = digits(ray.direction);
    const DigitsVec offset = digits(placement.affine().offset);
    const Digits scale = placement.scale;
    DigitsVec from, along;
    for (std::size_t i = 0; i < 3; ++i) {
        from[i] = (o[i] - offset[i]) / scale;
        along[i] = d[i] / scale;
    }
    line.t0 = -dot3(from, along) / dot3(along, along);
    line.reach = 4 / sqrt(dot3(along, along));
    for (std::size_t i = 0; i < 3; ++i) line.x[i] = {from[i] + line.t0 * along[i], along[i]};
    return line;
}

/// Depths at which the surface grown by `grown` (in its own size) is crossed, ascending.
std::vector<Digits> closed_form(TrustShape shape, const LocalLine& line, const Digits& grown) {
    std::vector<Digits> found;
    if (shape == TrustShape::slab) {
        for (const int side : {-1, 1}) {
            if (line.x[2][1] == 0) continue;
            // The planes keep their places: only their rims grow.
            const Digits t = (side * Digits(kSlabHalf) - line.x[2][0]) / line.x[2][1];
            if (abs(value(line.x[0], t)) <= 1 + grown && abs(value(line.x[1], t)) <= 1 + grown)
                found.push_back(t);
        }
        std::ranges::sort(found);
    } else {
        Powers equation;
        if (shape == TrustShape::torus) {
            // (|x|² + R² − r²)² − 4R²(x² + y²), R = 1.
            const Digits minor = Digits(kMinor) + grown;
            Powers square{1 - minor * minor};
            for (const Powers& x : line.x) add(square, product(x, x), 1);
            equation = product(square, square);
            for (int i = 0; i < 2; ++i) {
                const Powers& x = line.x[static_cast<std::size_t>(i)];
                add(equation, product(x, x), -4);
            }
        } else {
            equation = {Digits(-1)};
            for (std::size_t i = 0; i < 3; ++i) {
                const Digits axis = (shape == TrustShape::sphere ? Digits(1) : Digits(kAxes[i])) + grown;
                add(equation, product(line.x[i], line.x[i]), 1 / (axis * axis));
            }
        }
        found = roots(equation, -line.reach, line.reach);
    }
    for (Digits& t : found) t += line.t0;
    return found;
}

std::vector<Surface> surfaces(TrustShape shape, const Affine& to_world) {
    const auto implicit = [&](const char* name, std::map<std::string, double> parameters) {
        Surface s;
        s.name = name;
        s.shape = ImplicitShape{name, std::move(parameters)};
        s.to_world = to_world;
        return std::vector{s};
    };
    switch (shape) {
        case TrustShape::sphere:
            return implicit("sphere", {{"radius", 1}});
        case TrustShape::ellipsoid:
            return implicit("ellipsoid", {{"a", kAxes[0]}, {"b", kAxes[1]}, {"c", kAxes[2]}});
        case TrustShape::torus:
            return implicit("torus", {{"major", 1}, {"minor", kMinor}});
        case TrustShape::slab:
            break;
    }
    std::vector<Surface> both;
    for (const double z : {-kSlabHalf, kSlabHalf}) {
        Surface s;
        s.name = z < 0 ? "lower" : "upper";
        s.shape = RectangleShape{{0, 0, z}, {1, 0, 0}, {0, 1, 0}, {}};
        s.to_world = to_world;
        both.push_back(s);
    }
    return both;
}

}  // namespace

const char* name_of(TrustShape shape) {
    switch (shape) {
        case TrustShape::sphere:
            return "sphere";
        case TrustShape::ellipsoid:
            return "ellipsoid";
        case TrustShape::torus:
            return "torus";
        case TrustShape::slab:
            return "slab";
    }
    return "";
}

ClosedFormResult measure_closed_form(const ClosedFormCase& c, std::uint64_t rays, Seed seed,
                                     double relative_error) {
    constexpr int kPixels = 1024;
    const Placement placement{c.scale, c.offset * normalize(Vec3(3, -2, 6))};
    Scene scene;
    scene.source = "closed form";
    scene.image = {kPixels, kPixels, Vec3(0.0)};
    scene.lights.push_back({.headlight = true});
    scene.surfaces = surfaces(c.shape, placement.affine());
    const Vec3 target = placement.affine().offset;
    scene.camera.projection = c.projection;
    scene.camera.target = target;
    scene.camera.position = target + c.scale * c.distance * normalize(Vec3(2, 3, 4));
    scene.camera.fov_degrees = 2 * std::atan(1.6 / c.distance) * 180 / std::numbers::pi;
    scene.camera.view_height = 3.2 * c.scale;
    const PreparedScene prepared = prepare(scene);
    const RayScene ray_scene(prepared);

    ClosedFormResult result;
    double squares = 0;
    std::uint64_t depths = 0;
    PacketHits hits;
    std::array<Ray, kPacket> packet;
    for (std::uint64_t first = 0; first < rays; first += kPacket) {
        for (std::size_t i = 0; i < kPacket; ++i) {
            const auto [u, v, unused] = random_numbers(seed, first + i);
            packet[i] = prepared.camera.ray(kPixels * u, kPixels * v);
        }
        ray_scene.gather(packet, hits);
        for (std::size_t i = 0; i < kPacket; ++i) {
            const Ray& ray = packet[i];
            const double d = length(ray.direction);
            const LocalLine line = local_line(ray, placement);
            const double t0 = static_cast<double>(line.t0);
            // δ: what rounding all coordinates that take part once moves a point by.
            const double delta =
                kRoundoff * (length(ray.origin) + length(target) + std::abs(t0) * d + c.scale);
            const Digits room = Digits(kCloseUnits * delta) / c.scale;
            const std::vector<Digits> right = closed_form(c.shape, line, Digits(0));
            ++result.rays;
            result.hits += right.size();
            if (closed_form(c.shape, line, room).size() != right.size() ||
                closed_form(c.shape, line, -room).size() != right.size()) {
                ++result.borderline;
                continue;
            }
            if (hits[i].size() != right.size()) {
                ++result.wrong;
                continue;
            }
            for (std::size_t k = 0; k < right.size(); ++k) {
                const RayHit& hit = hits[i][k];
                const double t = hit.t * (1 + relative_error);
                const double error = std::abs(static_cast<double>(Digits(t) - right[k]));
                const double cosine = std::abs(dot(hit.normal, ray.direction)) / (length(hit.normal) * d);
                const double unit = delta / (d * std::max(cosine, std::sqrt(delta / c.scale)));
                result.worst_units = std::max(result.worst_units, error / unit);
                result.worst_error = std::max(result.worst_error, error * d / c.scale);
                squares += (error / unit) * (error / unit);
                ++depths;
            }
        }
    }
    if (depths > 0) result.rms_units = std::sqrt(squares / static_cast<double>(depths));
    return result;
}

double grazing_resolution(double offset) {
    // The ray's origin is six radii from the sphere (three before, by scene_for_lines, at most).
    return kDepthUnits * kRoundoff * (2 * offset + 20);
}

GrazingResult measure_grazing(double delta, double offset, std::uint64_t rays, Seed seed) {
    const Placement placement{1, offset * normalize(Vec3(3, -2, 6))};
    const PreparedScene scene = scene_for_lines(surfaces(TrustShape::sphere, placement.affine()));
    const LineShooter shooter(scene);
    const DigitsVec center = digits(placement.affine().offset);

    GrazingResult result;
    std::vector<Ray> all;
    for (std::uint64_t i = 0; i < rays; ++i) {
        const Vec3 along = random_direction(seed, i);
        const Frame frame = frame_around(along);
        const double angle = 2 * std::numbers::pi * random_numbers(seed, i)[0];
        // Across the direction to fifty digits: only then is the distance what it is meant to be.
        DigitsVec aside = digits(std::cos(angle) * frame.aside + std::sin(angle) * frame.up);
        const DigitsVec d = digits(shooter.through(placement.affine().offset, along).direction);
        const Digits lean = dot3(aside, d) / dot3(d, d);
        for (std::size_t k = 0; k < 3; ++k) aside[k] -= lean * d[k];
        const Digits distance = (1 + Digits(delta)) / sqrt(dot3(aside, aside));
        Ray ray = shooter.through(placement.affine().offset, along);
        const Digits back = dot3({digits(ray.origin)[0] - center[0], digits(ray.origin)[1] - center[1],
                                  digits(ray.origin)[2] - center[2]},
                                 d) /
                            dot3(d, d);
        for (int k = 0; k < 3; ++k) {
            const auto j = static_cast<std::size_t>(k);
            ray.origin[k] = static_cast<double>(Digits(center[j] + back * d[j] + distance * aside[j]));
        }
        all.push_back(ray);
    }
    std::vector<std::vector<RayHit>> hits;
    shooter.gather(all, hits);
    for (std::size_t i = 0; i < all.size(); ++i) {
        // Twice the ray's distance from the centre, squared and exact: |from × d|² against |d|².
        DigitsVec from = digits(all[i].origin);
        for (std::size_t k = 0; k < 3; ++k) from[k] -= center[k];
        const DigitsVec d = digits(all[i].direction);
        const Digits along = dot3(from, d);
        const Digits excess = (dot3(from, from) - 1) * dot3(d, d) - along * along;
        const bool two = excess < 0;
        ++result.rays;
        result.exact_two += two ? 1U : 0U;
        result.found_two += hits[i].size() == 2 ? 1U : 0U;
        result.wrong += hits[i].size() != (two ? 2U : 0U) ? 1U : 0U;
        result.intended += two == (delta < 0) ? 1U : 0U;
    }
    return result;
}

}  // namespace pellucid
