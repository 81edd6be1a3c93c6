#include "study/opacity_patch.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegree = kPi / 180;
constexpr double kMinorOverMajor = 0.4;
/// Perspective views have this vertical field of view: wide enough that leaving out cosβ or the change
/// of s over the patch would be rejected.
constexpr double kFovDegrees = 40;
/// A pixel over which θ changes by more than this is integrated with more points.
constexpr double kWideDegrees = 1;

/// Gauss-Legendre on [0, 1].
struct Rule {
    std::vector<double> node, weight;
};
[[nodiscard]] Rule gauss_rule(int n) {
    // Newton on the Legendre polynomial, from Chebyshev's guess.
    Rule rule;
    for (int i = 0; i < n; ++i) {
        double x = std::cos(kPi * (i + 0.75) / (n + 0.5));
        double slope = 1;
        for (int step = 0; step < 100; ++step) {
            double p0 = 1;
            double p1 = x;
            for (int k = 2; k <= n; ++k) {
                const double p2 = ((2 * k - 1) * x * p1 - (k - 1) * p0) / k;
                p0 = p1;
                p1 = p2;
            }
            slope = n * (x * p1 - p0) / (x * x - 1);
            const double dx = p1 / slope;
            x -= dx;
            if (std::abs(dx) < 1e-15) break;
        }
        rule.node.push_back(0.5 * (1 - x));
        rule.weight.push_back(1 / ((1 - x * x) * slope * slope));
    }
    return rule;
}

/// ∫∫ f over [a0, a1] × [b0, b1].
[[nodiscard]] double integrate(double a0, double a1, double b0, double b1,
                               const std::function<double(double, double)>& f) {
    static const Rule rule = gauss_rule(64);
    double sum = 0;
    for (std::size_t i = 0; i < rule.node.size(); ++i)
        for (std::size_t j = 0; j < rule.node.size(); ++j)
            sum += rule.weight[i] * rule.weight[j] *
                   f(a0 + (a1 - a0) * rule.node[i], b0 + (b1 - b0) * rule.node[j]);
    return sum * (a1 - a0) * (b1 - b0);
}

/// The view before its camera exists: one pixel has side 1 at the plane z = 0, the camera looks down −z.
struct Stage {
    bool perspective;
    double distance;  // camera to that plane

    /// 1/s at a world point, from the definition of s (Camera::pixel_area).
    [[nodiscard]] double pixels_per_area(const Vec3& p) const {
        if (!perspective) return 1;
        const Vec3 from_eye(p.x, p.y, distance - p.z);
        const double side = from_eye.z / distance;
        return length(from_eye) / (from_eye.z * side * side);
    }
};

/// Rectangle of pixels on the grid: width columns, from row `top` (in y) down by `rows` pixels.
struct FlatPlan {
    double width, left, top, slant, cos_tilt, sin_tilt;  // slant: length along the tilted side
    [[nodiscard]] Vec3 at(double a, double b) const {    // a, b in [0, 1]
        return {left + a * width, top - b * slant * cos_tilt, (0.5 - b) * slant * sin_tilt};
    }
};

[[nodiscard]] double virtual_pixels(const FlatPlan& plan, const Stage& stage) {
    return plan.width * plan.slant *
           integrate(0, 1, 0, 1, [&](double a, double b) { return stage.pixels_per_area(plan.at(a, b)); });
}

/// Part of a sphere of radius r around the origin that faces the camera: z >= floor.
[[nodiscard]] double sphere_floor(double radius, const Stage& stage) {
    return stage.perspective ? radius * radius / stage.distance : 0;
}
[[nodiscard]] double sphere_pixels(double radius, const Stage& stage) {
    return integrate(sphere_floor(radius, stage), radius, 0, 2 * kPi, [&](double z, double phi) {
        const double rho = std::sqrt(std::max(0.0, radius * radius - z * z));
        return radius * stage.pixels_per_area({rho * std::cos(phi), rho * std::sin(phi), z});
    });
}

[[nodiscard]] double torus_pixels(double major, const Stage& stage) {
    const double minor = kMinorOverMajor * major;
    return integrate(0, kPi, 0, 2 * kPi, [&](double tube, double phi) {
        const double rho = major + minor * std::cos(tube);
        return minor * rho *
               stage.pixels_per_area({rho * std::cos(phi), rho * std::sin(phi), minor * std::sin(tube)});
    });
}

/// x in (lo, hi) where the rising f(x) is `goal`.
[[nodiscard]] double solve(double goal, double lo, double hi, const std::function<double(double)>& f) {
    for (int step = 0; step < 200 && hi - lo > 1e-15 * hi; ++step) {
        const double middle = 0.5 * (lo + hi);
        (f(middle) < goal ? lo : hi) = middle;
    }
    return 0.5 * (lo + hi);
}

[[nodiscard]] Scene empty_scene(const Stage& stage, int width, int height) {
    Scene scene;
    scene.source = "opacity patch";
    scene.image = {.width = width, .height = height};
    scene.camera.projection = stage.perspective ? Projection::perspective : Projection::orthographic;
    scene.camera.position = {0, 0, stage.distance};
    scene.camera.view_height = height;
    scene.camera.fov_degrees = 2 * std::atan(0.5 * height / stage.distance) / kDegree;
    scene.lights.push_back({.headlight = true});
    return scene;
}

[[nodiscard]] Surface patch_surface(Shape shape) {
    Surface surface;
    surface.name = "patch";
    surface.shape = std::move(shape);
    surface.opacity = 0.5;  // not used: counts are given
    surface.opacity_law = OpacityLaw::oblique;
    surface.shading.flat = true;
    return surface;
}

[[nodiscard]] int even(double pixels) { return 2 * static_cast<int>(std::ceil(0.5 * pixels)); }

/// Distance at which an image of that many pixels has the field of view of all perspective patches.
[[nodiscard]] double distance_for(double pixels) {
    return 0.5 * pixels / std::tan(0.5 * kFovDegrees * kDegree);
}

[[nodiscard]] std::optional<Scene> flat_scene(const PatchView& view, double& span, double& whole_rows,
                                              double& columns) {
    const double cos_tilt = std::cos(view.tilt_deg * kDegree);
    span = cos_tilt / view.ratio;  // ν
    // With room for rounding: at s/S = 0.5 and 60° the one pixel there is always covered, and its variance of
    // rounding alone would weigh more in a fit than all other points.
    if (!(span > 1 + 1e-9)) return std::nullopt;
    FlatPlan plan{};
    plan.cos_tilt = cos_tilt;
    plan.sin_tilt = std::sin(view.tilt_deg * kDegree);
    plan.width = columns = std::max(1.0, std::floor(std::sqrt(span)));
    whole_rows = std::floor(span / columns * (1 + 1e-12));
    plan.left = -std::floor(0.5 * columns);
    plan.top = std::floor(0.5 * span / columns);
    plan.slant = 1 / (view.ratio * columns);
    // The tilted patch must stay in front of the camera: at most half of the way to it.
    const Stage stage{
        view.projection == Projection::perspective,
        std::max(distance_for(std::max(columns, span / columns) + 2), plan.slant * plan.sin_tilt)};
    if (stage.perspective)
        plan.slant = solve(1 / view.ratio, 0, 2 * plan.slant, [&](double slant) {
            FlatPlan p = plan;
            p.slant = slant;
            return virtual_pixels(p, stage);
        });
    // Nearer parts look larger: find the image from the corners.
    double reach_x = 0;
    double reach_y = 0;
    for (const double a : {0.0, 1.0})
        for (const double b : {0.0, 1.0}) {
            const Vec3 p = plan.at(a, b);
            const double grow = stage.perspective ? stage.distance / (stage.distance - p.z) : 1;
            reach_x = std::max(reach_x, std::abs(p.x) * grow);
            reach_y = std::max(reach_y, std::abs(p.y) * grow);
        }
    Scene scene = empty_scene(stage, even(2 * reach_x + 2), even(2 * reach_y + 2));
    const Vec3 corner = plan.at(0, 0);
    const Vec3 half_u = 0.5 * (plan.at(1, 0) - corner);
    const Vec3 half_v = 0.5 * (plan.at(0, 1) - corner);
    scene.surfaces.push_back(patch_surface(RectangleShape{corner + half_u + half_v, half_u, half_v, {}}));
    return scene;
}

[[nodiscard]] std::optional<Scene> curved_scene(const PatchView& view) {
    if (!(view.ratio < 1)) return std::nullopt;
    const bool sphere = view.shape == PatchShape::sphere;
    // Orthographic sizes are known: S = 2πr² and 2π²·major·minor.
    const double flat_size = sphere ? std::sqrt(1 / (2 * kPi * view.ratio))
                                    : std::sqrt(1 / (2 * kPi * kPi * kMinorOverMajor * view.ratio));
    const double extent = 2 * flat_size * (sphere ? 1 : 1 + kMinorOverMajor);
    const Stage stage{view.projection == Projection::perspective,
                      std::max(distance_for(extent), 3 * flat_size)};
    double size = flat_size;
    if (stage.perspective)
        size = solve(1 / view.ratio, 0.25 * flat_size, 1.5 * flat_size,
                     [&](double r) { return sphere ? sphere_pixels(r, stage) : torus_pixels(r, stage); });
    // Room for what perspective makes larger; odd, so that the axis meets a pixel's centre.
    const int side = even(extent * 1.5 * size / flat_size + 4) + 1;
    Scene scene = empty_scene(stage, side, side);
    const ImplicitShape shape =
        sphere ? ImplicitShape{"sphere", {{"radius", size}}}
               : ImplicitShape{"torus", {{"major", size}, {"minor", kMinorOverMajor * size}}};
    Surface surface = patch_surface(shape);
    surface.clip.push_back({{0, 0, -1}, sphere ? -sphere_floor(size, stage) : 0});
    scene.surfaces.push_back(std::move(surface));
    return scene;
}

/// What one ray of a pixel sees: 1/|cosθ| of the single layer; empty for none or several.
class PixelProbe {
public:
    PixelProbe(const PreparedScene& scene) : scene_(scene) {}

    /// Adds a ray at an image position; false once the pixel is known not to be whole.
    void look(double x, double y, double weight) {
        const Object& object = scene_.objects[0];
        const Ray ray = scene_.camera.ray(x, y);
        object.geometry->crossings(
            0, {ray.origin, ray.direction, scene_.camera.near(), scene_.camera.far()}, found_);
        int layers = 0;
        double cosine = 0;
        for (const Crossing& hit : found_.hits) {
            if (!object.keeps(ray.origin + hit.t * ray.direction)) continue;
            ++layers;
            cosine = std::abs(dot(hit.normal, ray.direction)) / (length(hit.normal) * length(ray.direction));
        }
        if (layers != 1 || cosine == 0) {
            whole = false;
            return;
        }
        any = true;
        const double theta = std::acos(std::min(cosine, 1.0)) / kDegree;
        lo = std::min(lo, theta);
        hi = std::max(hi, theta);
        coverage += weight / cosine;
        if (weight > 0) seen.push_back({theta, weight});
    }

    struct Seen {
        double theta, weight;
    };
    bool whole = true, any = false;
    double lo = 180, hi = 0, coverage = 0;
    std::vector<Seen> seen;

private:
    const PreparedScene& scene_;
    CrossingList found_;
};

[[nodiscard]] PixelProbe probe_pixel(const PreparedScene& scene, int column, int row) {
    static const Rule few = gauss_rule(4);
    static const Rule many = gauss_rule(24);
    PixelProbe probe(scene);
    for (const double a : {0.0, 0.5, 1.0})
        for (const double b : {0.0, 0.5, 1.0}) probe.look(column + a, row + b, 0);
    const Rule& rule = probe.hi - probe.lo > kWideDegrees ? many : few;
    for (std::size_t i = 0; i < rule.node.size(); ++i)
        for (std::size_t j = 0; j < rule.node.size(); ++j)
            probe.look(column + rule.node[i], row + rule.node[j], rule.weight[i] * rule.weight[j]);
    return probe;
}

/// Looks at every pixel and sorts the whole ones into rings.
void find_rings(OpacityPatch& patch, const std::vector<double>& edges) {
    const PreparedScene scene = prepare(patch.scene);
    const int width = scene.camera.width();
    const auto rows = static_cast<std::size_t>(scene.camera.height());
    const std::size_t ring_count = edges.size() - 1;
    std::vector<std::vector<Ring>> by_row(rows, std::vector<Ring>(ring_count));
    parallel_for(rows, 4, [&](std::size_t begin, std::size_t end) {
        for (std::size_t row = begin; row < end; ++row)
            for (int column = 0; column < width; ++column) {
                const PixelProbe probe = probe_pixel(scene, column, static_cast<int>(row));
                if (!probe.any) continue;
                for (std::size_t r = 0; r < ring_count; ++r) {
                    Ring& ring = by_row[row][r];
                    for (const auto& seen : probe.seen)
                        if (seen.theta >= edges[r] && seen.theta < edges[r + 1]) ring.pixels += seen.weight;
                    if (!probe.whole || probe.lo < edges[r] || probe.hi >= edges[r + 1]) continue;
                    ring.members.push_back(static_cast<std::uint32_t>(row) *
                                               static_cast<std::uint32_t>(width) +
                                           static_cast<std::uint32_t>(column));
                    ring.landing.push_back(probe.coverage * patch.view.ratio);
                    // Kept for now as the range that is met.
                    ring.theta_lo_deg =
                        ring.members.size() == 1 ? probe.lo : std::min(ring.theta_lo_deg, probe.lo);
                    ring.theta_hi_deg = std::max(ring.theta_hi_deg, probe.hi);
                }
            }
    });
    for (std::size_t r = 0; r < ring_count; ++r) {
        Ring ring{.theta_lo_deg = edges[r], .theta_hi_deg = edges[r + 1]};
        double met_lo = 180;
        double met_hi = 0;
        for (const auto& row : by_row) {
            const Ring& part = row[r];
            ring.pixels += part.pixels;
            ring.members.insert(ring.members.end(), part.members.begin(), part.members.end());
            ring.landing.insert(ring.landing.end(), part.landing.begin(), part.landing.end());
            if (part.members.empty()) continue;
            met_lo = std::min(met_lo, part.theta_lo_deg);
            met_hi = std::max(met_hi, part.theta_hi_deg);
        }
        if (patch.view.shape == PatchShape::flat && !ring.members.empty()) {
            ring.theta_lo_deg = met_lo;
            ring.theta_hi_deg = met_hi;
        }
        ring.classes = pixel_classes(ring.landing);
        patch.rings.push_back(std::move(ring));
    }
}

/// An orthographic flat patch needs no search: whole rows and columns, one landing chance.
[[nodiscard]] Ring flat_ring(const PatchView& view, const Scene& scene, double span, double rows,
                             double columns) {
    Ring ring{.theta_lo_deg = view.tilt_deg, .theta_hi_deg = view.tilt_deg, .pixels = span, .equal = true};
    const int first_column = scene.image.width / 2 - static_cast<int>(std::floor(0.5 * columns));
    const int first_row = scene.image.height / 2 - static_cast<int>(std::floor(0.5 * span / columns));
    for (int row = 0; row < static_cast<int>(rows); ++row)
        for (int column = 0; column < static_cast<int>(columns); ++column)
            ring.members.push_back(
                static_cast<std::uint32_t>((first_row + row) * scene.image.width + first_column + column));
    ring.landing.assign(ring.members.size(), 1 / span);
    ring.classes = pixel_classes(ring.landing);
    return ring;
}

/// Covered pixels of a patch, repeat by repeat, as one drawer drew them.
class PatchCount {
public:
    explicit PatchCount(const OpacityPatch& patch)
        : patch_(&patch),
          ring_of_(static_cast<std::size_t>(patch.scene.image.width) *
                       static_cast<std::size_t>(patch.scene.image.height),
                   kNoRing),
          times_covered_(ring_of_.size(), 0),
          covered_(patch.rings.size()),
          draws_(patch.rings.size()) {
        for (std::size_t r = 0; r < patch.rings.size(); ++r)
            for (const std::uint32_t pixel : patch.rings[r].members)
                ring_of_[pixel] = static_cast<std::uint8_t>(r);
    }

    /// Adds one repeat. No two winners share a pixel; those of the twin may.
    void add(const Winners& winners, DrawTwin twin) {
        hit_.clear();
        for (const std::uint32_t pixel : winners)
            if (pixel != kNoPixel) hit_.push_back(pixel);
        if (twin == DrawTwin::two_pixels_wide) {
            for (std::size_t i = 0, count = hit_.size(); i < count; ++i)
                if (hit_[i] + 1 < ring_of_.size()) hit_.push_back(hit_[i] + 1);
            std::sort(hit_.begin(), hit_.end());
            hit_.erase(std::unique(hit_.begin(), hit_.end()), hit_.end());
        }
        std::fill(covered_.begin(), covered_.end(), 0);
        for (const std::uint32_t pixel : hit_) {
            if (ring_of_[pixel] == kNoRing) continue;
            ++covered_[ring_of_[pixel]];
            ++times_covered_[pixel];
        }
        for (std::size_t r = 0; r < draws_.size(); ++r) {
            const auto members = static_cast<double>(patch_->rings[r].members.size());
            if (members == 0) continue;
            draws_[r].covered += covered_[r];
            draws_[r].share.add(static_cast<double>(covered_[r]) / members);
        }
    }

    /// Pixel by pixel: squared error of the ensemble mean in units of its Bernoulli variance.
    [[nodiscard]] std::vector<RingDraw> finish(double count, double repeats) {
        for (std::size_t r = 0; r < draws_.size(); ++r) {
            const Ring& ring = patch_->rings[r];
            for (std::size_t k = 0; k < ring.members.size(); ++k) {
                const double alpha = -std::expm1(count * std::log1p(-std::min(ring.landing[k], 1.0)));
                const double spread = alpha * (1 - alpha);
                // Pixels that are nearly always clear or covered say nothing about the rate.
                if (!(spread > 0.01)) continue;
                const double off = times_covered_[ring.members[k]] / repeats - alpha;
                draws_[r].squares += off * off / spread;
                // Var of (x̄ − α)²·L/(α(1−α)) for a mean of L Bernoulli draws: 2 + (1/(α(1−α)) − 6)/L.
                draws_[r].squares_variance += (2 + (1 / spread - 6) / repeats) / (repeats * repeats);
                ++draws_[r].informative;
            }
        }
        return std::move(draws_);
    }

private:
    static constexpr std::uint8_t kNoRing = 255;
    const OpacityPatch* patch_;
    std::vector<std::uint8_t> ring_of_;
    std::vector<std::uint32_t> times_covered_;
    std::vector<std::int64_t> covered_;
    std::vector<RingDraw> draws_;
    std::vector<std::uint32_t> hit_;
};

}  // namespace

std::optional<OpacityPatch> make_opacity_patch(const PatchView& view,
                                               const std::vector<double>& ring_edges_deg) {
    OpacityPatch patch{.view = view, .scene = {}, .rings = {}};
    if (view.shape != PatchShape::flat) {
        auto scene = curved_scene(view);
        if (!scene) return std::nullopt;
        patch.scene = std::move(*scene);
        find_rings(patch, ring_edges_deg);
        return patch;
    }
    double span = 0;
    double rows = 0;
    double columns = 0;
    auto scene = flat_scene(view, span, rows, columns);
    if (!scene) return std::nullopt;
    patch.scene = std::move(*scene);
    if (view.projection == Projection::orthographic) {
        patch.rings.push_back(flat_ring(view, patch.scene, span, rows, columns));
    } else {
        find_rings(patch, {0, 90});
    }
    return patch;
}

CoveredShare ring_theory(const Ring& ring, double count) {
    if (ring.equal)
        return covered_share(PatchPixels{count, static_cast<double>(ring.members.size()), ring.pixels});
    return covered_share(count, ring.classes);
}

std::vector<PatchDraw> draw_patch(const OpacityPatch& patch, const PreparedScene& scene,
                                  const LineSampler& sampler,
                                  std::span<const std::unique_ptr<ParticleDrawer>> drawers,
                                  const PatchThrow& thrown) {
    std::vector<PatchDraw> draws(drawers.size());
    std::vector<PatchCount> counts(drawers.size(), PatchCount(patch));
    const SamplerSettings settings{.seed = thrown.seed, .exact_count = thrown.count,
                                   .same_set_in_all_repeats = thrown.twin == DrawTwin::shared_set};
    // Batches keep at most a few million particles at a time.
    const auto batch = static_cast<std::uint32_t>(
        std::clamp<std::uint64_t>(8'000'000 / std::max<std::uint64_t>(thrown.count, 1), 1, thrown.repeats));
    for (std::uint32_t first = 0; first < thrown.repeats; first += batch) {
        const ParticleSet set =
            sample_particles(scene, SourceRefs(sampler), settings, first, std::min(batch, thrown.repeats - first));
        std::vector<Winners> of_first;
        for (std::size_t d = 0; d < drawers.size(); ++d) {
            std::vector<Winners> winners = drawers[d]->winners(set);
            for (const Winners& repeat : winners) counts[d].add(repeat, thrown.twin);
            if (d == 0) of_first = std::move(winners);
            else draws[d].as_first = draws[d].as_first && winners == of_first;
        }
    }
    for (std::size_t d = 0; d < drawers.size(); ++d)
        draws[d].rings = counts[d].finish(static_cast<double>(thrown.count), thrown.repeats);
    return draws;
}

double ring_z_score(const Ring& ring, const RingDraw& draw, double count, double repeats, Seed seed) {
    const double uniform =
        unit_interval(random_bits(seed, {.object = static_cast<std::uint32_t>(Purpose::p_value)})[0]);
    const auto total = static_cast<double>(draw.covered);
    if (ring.equal)
        return covered_z_score(total, repeats,
                               PatchPixels{count, static_cast<double>(ring.members.size()), ring.pixels},
                               uniform);
    return covered_z_score(total, repeats, count, ring.classes, uniform);
}

OpacityPoint fit_point(const OpacityPatch& patch, const Ring& ring, const RingDraw& draw, double count,
                       double repeats) {
    const double ratio = patch.view.ratio;
    OpacityPoint point{.count = count, .ratio = ratio, .alpha_drawn = draw.alpha(),
                       .alpha_variance = ring_theory(ring, count).variance / repeats};
    if (ring.equal) {
        point.cos_tilt = std::min(1.0, ratio * ring.pixels);
        return point;
    }
    // The very classes of the theory: with 32 quantiles, steep perspective patches were off by several σ.
    const auto members = static_cast<double>(ring.members.size());
    for (const PixelClass& c : ring.classes)
        if (c.landing > 0) point.ring.push_back({c.pixels / members, std::min(1.0, ratio / c.landing)});
    return point;
}

}  // namespace pellucid
