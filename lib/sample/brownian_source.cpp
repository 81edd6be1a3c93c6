#include "sample/brownian_source.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"

namespace pellucid {
namespace {

/// Trials that a walker is given to find a place to start from.
constexpr std::uint64_t kMostStarts = 100'000;
/// Sets the numbers of walks apart from those of lines (block·2³² + index, blocks below 2²³).
constexpr std::uint64_t kWalkIndex = std::uint64_t{1} << 55U;

[[nodiscard]] DrawKey step_key(std::uint32_t object, std::uint32_t repeat, std::uint32_t walker, std::uint32_t step) {
    return {.object = object, .repeat = repeat, .index = kWalkIndex | std::uint64_t{walker} << 32U | step, .block = 0};
}

[[nodiscard]] const Object& with_field(const Object& object) {
    if (!object.geometry->field_surface())
        throw input_error(
            "surface \"{}\": particles.sampler = \"brownian\" walks on f = 0, expected implicit, expression, isosurface or points",
            object.surface.name);
    return object;
}

}  // namespace

BrownianSource::BrownianSource(const Object& object, const Camera& camera, std::uint32_t object_id, const WalkSettings& settings)
    : object_(&with_field(object)),
      camera_(&camera),
      object_id_(object_id),
      settings_(settings),
      field_(object),
      places_(object, object_id),
      step_(settings.twin) {
    const FieldSurface& surface = field_.surface();
    const double world_cell = surface.cell_width * std::cbrt(std::abs(surface.to_world.determinant()));
    step_.length = settings.step ? *settings.step * field_.width()
                   : surface.cell_width > 0 ? kWalkCellStep * world_cell
                                            : kWalkStep * field_.width();
    step_.drift = settings.drift;
    if (!(places_.area() > 0)) return;
    std::array<Vec3, 8> corners;
    const Box box = object.geometry->bounds();
    for (std::size_t i = 0; i < 8; ++i)
        corners[i] = {(i & 1U) != 0 ? box.hi.x : box.lo.x, (i & 2U) != 0 ? box.hi.y : box.lo.y, (i & 4U) != 0 ? box.hi.z : box.lo.z};
    const auto area = camera.pixel_area_range(corners.data(), 8);
    if (!area) return;
    least_area_ = area->least;
    virtual_pixels_ = places_.area() / least_area_;
}

std::string BrownianSource::label() const { return fmt::format("surface \"{}\"", object_->surface.name); }

double BrownianSource::optical_depth() const { return -std::log1p(-std::min(object_->surface.opacity, kMostParticleOpacity)); }

std::vector<Vec3> BrownianSource::positions(Seed seed, std::uint32_t repeat, std::uint32_t count) const {
    const std::uint32_t walkers = std::min(settings_.walkers, std::max(count, 1U));
    std::vector<Vec3> at(walkers);
    std::uint64_t trial = 0;
    const auto place = [&] {
        for (const std::uint64_t end = trial + kMostStarts; trial < end;)
            if (const auto found = places_.point(seed, repeat, trial++)) return *found;
        throw run_error("{}: particles.sampler = \"brownian\" finds no place to start in {} trials", label(), kMostStarts);
    };
    if (settings_.start == WalkSettings::Start::single)
        std::ranges::fill(at, place());
    else
        for (Vec3& x : at) x = place();

    Stats stats;
    std::vector<Vec3> out(count);
    for (std::uint32_t i = 0; i < count; ++i) {
        const std::uint32_t walker = i % walkers;
        const std::uint32_t done = i / walkers * settings_.thinning;
        for (std::uint32_t step = done; step < done + settings_.thinning; ++step) {
            const WalkOutcome outcome =
                walk_one_step(field_, step_, normal_numbers(seed, step_key(object_id_, repeat, walker, step)), at[walker]);
            stats.at_borders += outcome == WalkOutcome::stayed_inside ? 1 : 0;
            stats.lost += outcome == WalkOutcome::lost ? 1 : 0;
        }
        stats.steps += settings_.thinning;
        out[i] = at[walker];
    }
    steps_ += stats.steps;
    at_borders_ += stats.at_borders;
    lost_ += stats.lost;
    return out;
}

std::optional<BrownianSource::Point> BrownianSource::keep(const Vec3& world, double chance) const {
    const Vec3 view = camera_->to_view(world);
    if (!(view.z >= camera_->near() && view.z <= camera_->far())) return std::nullopt;
    const Vec2 pixel = camera_->project(view);
    if (!(pixel.x >= 0 && pixel.x < camera_->width() && pixel.y >= 0 && pixel.y < camera_->height())) return std::nullopt;
    const Vec3 normal = field_.slope(world).gradient;
    const double size = length(normal);
    const Vec3 ray = camera_->ray_direction(world);
    double share = least_area_ / camera_->pixel_area(view);
    if (object_->surface.opacity_law == OpacityLaw::constant && size > 0)
        share *= std::abs(dot(normal, ray)) / (size * length(ray));
    if (!(chance < share)) return std::nullopt;
    return Point{view, camera_->view_vector(size > 0 ? normal : -ray)};
}

void BrownianSource::trials_in_block(std::size_t, Seed seed, std::uint32_t repeat, std::uint32_t first, std::uint32_t count,
                                     std::vector<Point>& out) const {
    const std::vector<Vec3> places = positions(seed, repeat, first + count);
    const std::uint32_t walkers = std::min(settings_.walkers, std::max(first + count, 1U));
    for (std::uint32_t i = first; i < first + count; ++i) {
        DrawKey key = step_key(object_id_, repeat, i % walkers, i / walkers);
        key.block = 1;
        if (const auto point = keep(places[i], unit_interval(random_bits(seed, key)[0]))) out.push_back(*point);
    }
}

BrownianSource::Stats BrownianSource::stats() const { return {steps_, at_borders_, lost_}; }

std::string BrownianSource::complaint() const {
    if (lost_ == 0) return {};
    return fmt::format("{}: {} of {} Brownian steps found no way back to the surface and were not made", label(), lost_.load(),
                       steps_.load());
}

}  // namespace pellucid
