#include "vulkan/plain_casts.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/parallel.hpp"
#include "field/iso_field.hpp"

namespace pellucid::vulkan {
namespace {

static_assert(sizeof(twin::PlainPiece) == 80 && sizeof(twin::PlainGrid) == 272 &&
              sizeof(twin::PlainVolume) == 296 && sizeof(twin::PlainSurface) == 496);
static_assert(offsetof(twin::PlainGrid, samples) == 248 && offsetof(twin::PlainSurface, to_object) == 320);

[[nodiscard]] std::size_t wide(int n) {
    return static_cast<std::size_t>(n);
}

/// The samples with one more on every side, continued as VolumeField::samples_around does.
[[nodiscard]] std::vector<float> continued(const VoxelGrid& grid) {
    const std::array<int, 3>& size = grid.size;
    std::vector<float> out(wide(size[0] + 2) * wide(size[1] + 2) * wide(size[2] + 2));
    struct Tap {
        int at, other;  // v = at, or 2·at − other where other >= 0
    };
    const auto tap = [&](std::size_t axis, int at) -> Tap {
        const int last = size[axis] - 1;
        if (at < 0) return {0, last > 0 ? 1 : -1};
        if (at > last) return {last, last > 0 ? last - 1 : -1};
        return {at, -1};
    };
    parallel_for(wide(size[1] + 2) * wide(size[2] + 2), 16, [&](std::size_t begin, std::size_t end) {
        for (std::size_t row = begin; row < end; ++row) {
            const Tap y = tap(1, static_cast<int>(row % wide(size[1] + 2)) - 1);
            const Tap z = tap(2, static_cast<int>(row / wide(size[1] + 2)) - 1);
            for (int i = -1; i <= size[0]; ++i) {
                const Tap x = tap(0, i);
                double sum = 0;
                for (int corner = 0; corner < 8; ++corner) {
                    const bool ox = (corner & 1) != 0, oy = (corner & 2) != 0, oz = (corner & 4) != 0;
                    if ((ox && x.other < 0) || (oy && y.other < 0) || (oz && z.other < 0)) continue;
                    double weight = 1;
                    for (const auto& [each, other] : {std::pair(x, ox), std::pair(y, oy), std::pair(z, oz)})
                        if (each.other >= 0) weight *= other ? -1 : 2;
                    sum += weight * static_cast<double>(grid.at(ox ? x.other : x.at, oy ? y.other : y.at,
                                                                oz ? z.other : z.at));
                }
                constexpr double kMost = std::numeric_limits<float>::max();
                out[row * wide(size[0] + 2) + wide(i + 1)] =
                    static_cast<float>(std::isfinite(sum) ? std::clamp(sum, -kMost, kMost) : sum);
            }
        }
    });
    return out;
}

[[nodiscard]] std::vector<twin::PlainPiece> pieces_of(const TransferFunction& transfer) {
    std::vector<twin::PlainPiece> pieces;
    const auto kinks = transfer.kinks();
    for (const TransferFunction::Piece& p : transfer.pieces()) {
        const double end = pieces.size() < kinks.size() ? kinks[pieces.size()] : 1e300;
        pieces.push_back({p.from, p.opacity, p.opacity_slope, twin_of(p.color), twin_of(p.color_slope), end});
    }
    return pieces;
}

}  // namespace

PlainCasts::PlainCasts(const Device& device, const PreparedScene& scene,
                       std::span<const VolumeObject* const> volumes, const CastSettings& settings, int rays)
    : device_(&with_doubles(device)),
      group_size_(cast_group_size(device)),
      band_(packets_of_band(device, scene.camera, kPlainTimes)) {
    std::vector<twin::PlainVolume> items;
    for (const VolumeObject* volume : volumes) {
        const pellucid::VolumeCaster exact(scene, *volume, settings);
        Held held;
        twin::PlainVolume v{};
        v.grid = grid_on_device(volume->field(), volume->to_world(), volume->to_index(), exact.empty_space(),
                                volume->settings().clip, volume->settings().shading, held);
        v.opacity_step = volume->opacity_step();
        const std::vector<twin::PlainPiece> pieces = pieces_of(volume->transfer());
        held.pieces = filled(device, pieces);
        v.pieces = held.pieces.address();
        v.piece_count = static_cast<std::uint32_t>(pieces.size());
        items.push_back(v);
        held_.push_back(std::move(held));
    }
    items_ = filled(device, items);
    set_up(scene, settings, rays, items.size());
}

PlainCasts::PlainCasts(const Device& device, const PreparedScene& scene,
                       std::span<const Object* const> objects, std::span<const double> thickness,
                       const CastSettings& settings, int rays)
    : device_(&with_doubles(device)),
      group_size_(cast_group_size(device)),
      band_(packets_of_band(device, scene.camera, kPlainTimes)) {
    std::vector<twin::PlainSurface> items;
    for (const Object* object : objects) {
        const FieldSurface surface = *object->geometry->field_surface();
        const auto& iso = dynamic_cast<const IsoField&>(*surface.field);
        const pellucid::IsosurfaceCaster exact(scene, *object, settings);
        Held held;
        twin::PlainSurface s{};
        s.grid = grid_on_device(iso.volume(), surface.to_world, surface.to_world.inverse(),
                                exact.empty_space(), object->surface.clip, object->surface.shading, held);
        s.isovalue = iso.isovalue();
        s.opacity = object->surface.opacity;
        s.thickness = thickness[items.size()];
        s.color = twin_of(object->surface.color);
        s.to_object = place_of(object->to_object, Vec3(0.0));
        s.has_bounds = object->surface.bounds && !object->bounds_are_geometry() ? 1 : 0;
        if (object->surface.bounds) {
            s.bounds_lo = twin_of(object->surface.bounds->lo);
            s.bounds_hi = twin_of(object->surface.bounds->hi);
        }
        s.oblique = object->surface.opacity_law == OpacityLaw::oblique ? 1 : 0;
        items.push_back(s);
        held_.push_back(std::move(held));
    }
    items_ = filled(device, items);
    set_up(scene, settings, rays, items.size());
}

void PlainCasts::set_up(const PreparedScene& scene, const CastSettings& settings, int rays,
                        std::size_t count) {
    std::vector<twin::CastLight> lights = lights_of(scene);
    lights_ = filled(*device_, lights);
    status_ = Buffer(*device_, twin::kStatusWords * sizeof(std::uint32_t));
    setup_ = Buffer(*device_, sizeof(twin::CastSetup));
    setup.camera = camera_of(scene.camera, settings.step, rays);
    setup.volume_count = static_cast<std::uint32_t>(count);
    setup.light_count = static_cast<std::uint32_t>(lights.size());
    setup.packet_columns = packets_of_row(scene.camera);
    setup.volumes = items_.address();
    setup.lights = lights_.address();
    setup.status = status_.address();
    for (const Held& held : held_)
        bytes_ += held.samples.bytes() + held.pieces.bytes() + held.distance.bytes() + held.planes.bytes();
}

twin::PlainGrid PlainCasts::grid_on_device(const VolumeField& field, const Affine& to_world,
                                           const Affine& to_index, const EmptySpace& space,
                                           std::span<const ClipPlane> clip, const Shading& shading,
                                           Held& held) {
    const VoxelGrid& grid = field.grid();
    held.samples = field.interpolation() == Interpolation::catmull_rom
                       ? filled(*device_, continued(grid))
                       : filled(*device_, std::span<const float>(grid.values));
    held.planes = filled(*device_, planes_of(clip));
    std::vector<std::uint8_t> distance = space.distance();
    distance.resize((distance.size() + 3) / 4 * 4);  // read as words
    held.distance = filled(*device_, distance);
    interpolations_ |= 1U << static_cast<std::uint32_t>(field.interpolation());
    holes_ = holes_ || has_holes(grid);
    lit_ = lit_ || !shading.flat;
    glossy_ = glossy_ || (!shading.flat && shading.specular != 0);
    twin::PlainGrid g{};
    g.place = place_of(to_index, field.hull().hi);
    g.cofactor0 = twin_of(to_world.normal({1, 0, 0}));
    g.cofactor1 = twin_of(to_world.normal({0, 1, 0}));
    g.cofactor2 = twin_of(to_world.normal({0, 0, 1}));
    g.size_x = grid.size[0];
    g.size_y = grid.size[1];
    g.size_z = grid.size[2];
    g.blocks_x = space.blocks()[0];
    g.blocks_y = space.blocks()[1];
    g.blocks_z = space.blocks()[2];
    g.anything = space.anything() ? 1 : 0;
    g.plane_count = static_cast<std::uint32_t>(clip.size());
    g.lit = shading.flat ? 0 : 1;
    g.interpolation = static_cast<std::uint32_t>(field.interpolation());
    g.ambient = static_cast<float>(shading.ambient);
    g.diffuse = static_cast<float>(shading.diffuse);
    g.specular = static_cast<float>(shading.specular);
    g.shininess = static_cast<float>(shading.shininess);
    g.samples = held.samples.address();
    g.distance = held.distance.address();
    g.planes = held.planes.address();
    return g;
}

std::vector<std::uint32_t> PlainCasts::constants() const {
    return {group_size_,       interpolations_,   lit_ ? 1U : 0U,
            glossy_ ? 1U : 0U, setup.light_count, holes_ ? 1U : 0U};
}

void PlainCasts::begin(Commands& commands) const {
    upload(*device_, setup_, std::as_bytes(std::span(&setup, 1)));
    commands.fill(status_, 0, status_.bytes(), 0);
    commands.barrier();
}

std::uint32_t PlainCasts::check() const {
    return check_status(*device_, status_);
}

}  // namespace pellucid::vulkan
