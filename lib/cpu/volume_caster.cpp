#include "cpu/volume_caster.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "core/error.hpp"
#include "cpu/preintegration.hpp"
#include "field/iso_field.hpp"
#include "scene/shading.hpp"
#include "stage/virtual_slab.hpp"

namespace pellucid {
namespace {

/// Values are computed in double: by what share of its size one may leave the range of its block.
constexpr double kRoom = 1e-9;
/// Samples less than this share of a step before the end of what is skipped are looked at: beyond rounding.
constexpr double kGuard = 1e-6;
/// zSlab, section 6.1.
constexpr int kBisections = 10;

/// The part of a line in which value + slope·t >= 0 for all that is asked.
struct Span {
    double lo, hi;
    void keep(double value, double slope) {
        if (slope > 0) lo = std::max(lo, -value / slope);
        if (slope < 0) hi = std::min(hi, -value / slope);
        if (slope == 0 && value < 0) hi = lo;
    }
    void keep_box(const Vec3& from, const Vec3& along, const Vec3& lo_corner, const Vec3& hi_corner) {
        for (int axis = 0; axis < 3; ++axis) {
            keep(from[axis] - lo_corner[axis], along[axis]);
            keep(hi_corner[axis] - from[axis], -along[axis]);
        }
    }
    void keep_clip(const Ray& ray, std::span<const ClipPlane> planes) {
        for (const ClipPlane& plane : planes)
            keep(plane.offset - dot(plane.normal, ray.origin), -dot(plane.normal, ray.direction));
    }
};

/// The grid's number of the sample at or before t.
[[nodiscard]] std::int64_t sample_before(double t, double dt) {
    auto k = static_cast<std::int64_t>(std::floor(t / dt));
    while (static_cast<double>(k) * dt > t) --k;
    while (static_cast<double>(k + 1) * dt <= t) ++k;
    return k;
}

/// The sample to go on with where nothing is seen before depth `end`; k where there is no later one.
[[nodiscard]] std::int64_t sample_after_skip(std::int64_t k, double end, double dt) {
    return std::max(k, static_cast<std::int64_t>(std::floor(end / dt - kGuard)));
}

[[nodiscard]] twin::Slab make_slab(double begin, double end, double opacity, const Vec3& color) {
    const auto z = static_cast<float>(end);
    return {z,
            z - static_cast<float>(begin),
            static_cast<float>(color.x),
            static_cast<float>(color.y),
            static_cast<float>(color.z),
            static_cast<float>(opacity)};
}

void refuse_too_many_steps(const Box& bounds, double step, const char* kind, const std::string& name) {
    if (bounds.empty() || length(bounds.size()) / step <= kMostSteps) return;
    throw input_error("{} \"{}\": it is {:.3g} across, {:.2g} steps of {:.3g}, expected at most {}: take longer steps; they go by "
                      "the smallest distance of samples",
                      kind, name, length(bounds.size()), length(bounds.size()) / step, step, kMostSteps);
}

}  // namespace

double voxel_pitch(const Affine& index_to_world) {
    return std::min({length(index_to_world.linear[0]), length(index_to_world.linear[1]),
                     length(index_to_world.linear[2])});
}

VolumeCaster::VolumeCaster(const PreparedScene& scene, const VolumeObject& volume,
                           const CastSettings& settings)
    : scene_(&scene), volume_(&volume), settings_(settings), last_(volume.field().hull().hi) {
    assert(settings.step > 0);
    refuse_too_many_steps(volume.bounds(), settings.step, "volume", volume.settings().name);
    if (settings.skip) space_ = find_empty_space(volume, kRoom);
}

Vec3 VolumeCaster::index_at(const Progress& p, double t) const {
    return glm::clamp(p.from + t * p.along, Vec3(0.0), last_);
}

double VolumeCaster::value_at(const Progress& p, double t) const {
    return volume_->value(index_at(p, t));
}

VolumeCaster::Progress VolumeCaster::enter(const Ray& ray) const {
    Progress p{};
    p.ray = ray;
    p.ray_length = length(ray.direction);
    p.dt = settings_.step / p.ray_length;
    p.from = volume_->to_index().point(ray.origin);
    p.along = volume_->to_index().vector(ray.direction);
    Span span{scene_->camera.near(), scene_->camera.far()};
    span.keep_box(p.from, p.along, Vec3(0.0), last_);
    span.keep_clip(ray, volume_->settings().clip);
    p.t = p.t_in = span.lo;
    p.t_out = volume_->bounds().empty() || (settings_.skip && !space_.anything()) ? span.lo : span.hi;
    if (!p.done()) p.k = sample_before(p.t, p.dt);
    return p;
}

VolumeCaster::Progress VolumeCaster::start(const Ray& ray) const {
    Progress p = enter(ray);
    if (!p.done()) p.value = value_at(p, p.t);
    return p;
}

twin::Slab VolumeCaster::advance(Progress& p, double t) const {
    const double begin = p.t;
    const double steps = p.ray_length / volume_->opacity_step();  // for a depth of 1
    p.t = t;
    Look look;
    if (volume_->settings().interpolation == Interpolation::nearest) {
        // Cut where the ray passes from cell to cell: in each the value is constant.
        const Vec3 from = p.from + Vec3(volume_->cell_shift());
        for (double at = begin; at < t && look.opacity < 1;) {
            double end = t;
            for (int axis = 0; axis < 3; ++axis) {
                if (p.along[axis] == 0) continue;
                const double where = from[axis] + at * p.along[axis];
                for (double face = p.along[axis] > 0 ? std::floor(where) : std::ceil(where);;
                     face += p.along[axis] > 0 ? 1 : -1) {
                    const double meet = (face - from[axis]) / p.along[axis];
                    if (meet <= at) continue;
                    end = std::min(end, meet);
                    break;
                }
            }
            const double value = value_at(p, 0.5 * (at + end));
            const Look part = preintegrate(volume_->transfer(), value, value, steps * (end - at));
            look.color += (1 - look.opacity) * part.color;
            look.opacity += (1 - look.opacity) * part.opacity;
            at = end;
        }
        return make_slab(begin, t, look.opacity, look.color);
    }
    const double front = p.value;
    p.value = value_at(p, t);
    look = preintegrate(volume_->transfer(), front, p.value, steps * (t - begin));
    if (look.opacity > 0 && !volume_->settings().shading.flat) {
        const double middle = 0.5 * (begin + t);
        look.color = look.opacity * shade(*scene_, *volume_, p.ray.origin + middle * p.ray.direction,
                                          look.color / look.opacity, volume_->gradient(index_at(p, middle)));
    }
    return make_slab(begin, t, look.opacity, look.color);
}

void VolumeCaster::skip(Progress& p) const {
    if (!settings_.skip) return;
    const double end = space_.empty_until(p.from + Vec3(volume_->cell_shift()), p.along, p.t);
    if (end >= p.t_out * (1 + kRoom)) {
        p.t = p.t_out;
        return;
    }
    const std::int64_t k = sample_after_skip(p.k, end, p.dt);
    if (k == p.k) return;
    p.k = k;
    p.t = static_cast<double>(k) * p.dt;
    if (!p.done()) p.value = value_at(p, p.t);
}

twin::Slab VolumeCaster::step(Progress& p) const {
    return advance(p, std::min(static_cast<double>(++p.k) * p.dt, p.t_out));
}

// ---- Isosurfaces ------------------------------------------------------------------------------

bool IsosurfaceCaster::casts(const Object& object) {
    if (!std::holds_alternative<IsosurfaceShape>(object.surface.shape)) return false;
    const auto surface = object.geometry->field_surface();
    return surface && dynamic_cast<const IsoField*>(surface->field) != nullptr;
}

IsosurfaceCaster::IsosurfaceCaster(const PreparedScene& scene, const Object& object,
                                   const CastSettings& settings)
    : scene_(&scene), object_(&object), settings_(settings) {
    const FieldSurface surface = *object.geometry->field_surface();
    const auto& iso = dynamic_cast<const IsoField&>(*surface.field);
    field_ = &iso.volume();
    isovalue_ = iso.isovalue();
    to_world_ = surface.to_world;
    to_index_ = to_world_.inverse();
    refuse_too_many_steps(object.geometry->bounds(), settings.step, "surface", object.surface.name);
    static_assert(IsoField::kBrick == EmptySpace::kBlock);
    if (!settings.skip) return;
    space_ = EmptySpace(field_->cells(), [&](const std::array<int, 3>& first, const std::array<int, 3>& end) {
        const EmptySpace::Kind samples = kind_of_samples(field_->grid(), first, end);
        if (samples != EmptySpace::Kind::clear) return samples;
        std::size_t brick = 0;
        for (std::size_t a = 3; a-- > 0;)
            brick = brick * static_cast<std::size_t>((field_->cells()[a] + EmptySpace::kBlock - 1) /
                                                     EmptySpace::kBlock) +
                    static_cast<std::size_t>(first[a] / EmptySpace::kBlock);
        return iso.brick_may_hold(brick) ? EmptySpace::Kind::visit : EmptySpace::Kind::clear;
    });
}

double IsosurfaceCaster::pitch() const {
    return voxel_pitch(to_world_);
}

void IsosurfaceCaster::crossings(const Ray& ray, std::vector<Crossing>& out) const {
    const Vec3 from = to_index_.point(ray.origin);
    const Vec3 along = to_index_.vector(ray.direction);
    const double dt = settings_.step / length(ray.direction);
    const Vec3 last = field_->hull().hi;
    Span span{scene_->camera.near(), scene_->camera.far()};
    span.keep_box(from, along, Vec3(0.0), last);
    if (!(span.lo < span.hi)) return;
    const auto index = [&](double t) { return glm::clamp(from + t * along, Vec3(0.0), last); };
    const auto value = [&](double t) { return field_->value(index(t), isovalue_); };
    std::int64_t k = sample_before(span.lo, dt);
    double t = span.lo;
    double here = value(t);
    while (t < span.hi) {
        const double end = space_.empty_until(from, along, t);
        if (end >= span.hi * (1 + kRoom)) return;
        if (const std::int64_t next = sample_after_skip(k, end, dt); next > k) {
            k = next;
            t = static_cast<double>(k) * dt;
            if (!(t < span.hi)) return;
            here = value(t);
        }
        const double t0 = t;
        const double before = here;
        t = std::min(static_cast<double>(++k) * dt, span.hi);
        here = value(t);
        // What is on the surface counts as above, so that a sample on it is one crossing.
        if (!std::isfinite(before) || !std::isfinite(here) || (before >= 0) == (here >= 0)) continue;
        double lo = t0, hi = t;
        for (int i = 0; i < kBisections; ++i) {
            const double middle = 0.5 * (lo + hi);
            ((value(middle) >= 0) == (before >= 0) ? lo : hi) = middle;
        }
        // The rest by a line.
        const double at_lo = std::abs(value(lo)), at_hi = std::abs(value(hi));
        const double at = at_lo + at_hi > 0 ? lo + (hi - lo) * at_lo / (at_lo + at_hi) : hi;
        const Vec3 world = ray.origin + at * ray.direction;
        if (!object_->keeps(world)) continue;
        Vec3 normal = to_world_.normal(field_->jet(index(at)).gradient);
        if (!(dot(normal, normal) > 0)) normal = -ray.direction;
        const double cosine =
            std::clamp(std::abs(dot(normalize(normal), normalize(ray.direction))), 1e-12, 1.0);
        out.push_back({at, normal, object_->opacity(cosine), shade(*scene_, *object_, world, normal)});
        if (out.back().opacity >= 1) return;
    }
}

std::int64_t IsosurfaceCaster::planned_bytes(const Object& object) {
    const Vec3 last = object.geometry->field_surface()->bounds.hi;
    return EmptySpace::count_of({static_cast<int>(last.x), static_cast<int>(last.y), static_cast<int>(last.z)});
}

twin::Slab IsosurfaceCaster::virtual_slab(const Crossing& crossing, double thickness) {
    twin::Slab slab = make_slab(crossing.t, crossing.t, crossing.opacity, crossing.opacity * crossing.color);
    slab.d = static_cast<float>(seen_thickness(thickness, crossing.t));
    return slab;
}

}  // namespace pellucid
