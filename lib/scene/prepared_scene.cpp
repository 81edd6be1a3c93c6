#include "scene/prepared_scene.hpp"

#include <algorithm>
#include <cmath>

#include "core/box_corners.hpp"
#include "core/error.hpp"
#include "io/input_file.hpp"

namespace pellucid {

bool Object::keeps(const Vec3& world) const {
    for (const ClipPlane& plane : surface.clip)
        if (dot(plane.normal, world) > plane.offset) return false;
    if (surface.bounds && !bounds_are_geometry()) {
        const Vec3 p = to_object.point(world);
        for (int axis = 0; axis < 3; ++axis)
            if (p[axis] < surface.bounds->lo[axis] || p[axis] > surface.bounds->hi[axis]) return false;
    }
    return true;
}

double Object::opacity(double cos_theta, double share) const {
    const double straight_on = surface.opacity * share;
    if (surface.opacity_law == OpacityLaw::constant || straight_on == 1) return straight_on;
    return -std::expm1(std::log1p(-straight_on) / cos_theta);
}

double Object::optical_depth(double cos_theta, double most_opacity, double share) const {
    const double straight_on = -std::log1p(-std::min(surface.opacity * share, most_opacity));
    return surface.opacity_law == OpacityLaw::oblique ? straight_on / cos_theta : straight_on;
}

std::size_t PreparedScene::bytes() const {
    std::size_t sum = 0;
    for (const Object& object : objects) sum += object.geometry->bytes();
    for (const VolumeObject& volume : volumes) sum += volume.bytes();
    return sum;
}

namespace {

/// Warns of what is in front of the eye, and yet before the least near plane that the scene's size allows.
void warn_if_cut(const Scene& scene, const Camera& camera, const Box& box, const std::string& label) {
    if (box.empty()) return;
    double nearest = kInfinity;
    for (const Vec3& corner : corners_of(box)) nearest = std::min(nearest, camera.to_view(corner).z);
    if (nearest > std::max(0.0, scene.camera.near.value_or(0)) && nearest < camera.near())
        warn("{}: cut off nearer than {:.3g}: 1e-9 of the scene's size is the least near", label, camera.near());
}

[[nodiscard]] Box bounds_of(const Object& object) {
    return object.geometry->patch_count() > 0 ? object.geometry->bounds() : Box();
}

/// Makes room for one object more. Squares of lengths must stay within doubles.
void include(Box& visible, const Box& box, const Scene& scene, const std::string& label) {
    if (!box.empty()) visible.include(box);
    const double reach = visible.empty() ? 1 : std::max(length(visible.size()), length(visible.center()));
    if (!(reach < 1e100 && (visible.empty() || length(visible.size()) > 1e-100)))
        throw input_error("{}: {} makes the scene {:.3g} large, expected 1e-100 to 1e100", scene.source, label,
                          length(visible.size()));
}

/// Refuses formulas whose samples together have no room, before the first of them is sampled.
void check_room(const Scene& scene) {
    const std::uint64_t available = available_memory();
    std::uint64_t bytes = 0;
    for (const Volume& volume : scene.volumes) {
        const auto* formula = std::get_if<ExpressionVolume>(&volume.source);
        if (formula == nullptr) continue;
        std::uint64_t samples = sizeof(float);
        for (const int n : formula->resolution) samples *= static_cast<std::uint64_t>(n);
        bytes += samples;
        if (bytes > available)
            throw input_error("{}: volume \"{}\": the samples of formulas up to this one take {} bytes, {} are free: "
                              "expected a smaller resolution",
                              scene.source, volume.name, bytes, available);
    }
}

}  // namespace

PreparedScene prepare(const Scene& scene, std::optional<PixelRect> crop) {
    const auto label = [](const auto& settings, const char* kind) { return fmt::format("{} \"{}\"", kind, settings.name); };
    std::vector<Object> objects;
    std::vector<VolumeObject> volumes;
    Box visible;
    check_room(scene);
    for (const Surface& surface : scene.surfaces) {
        objects.push_back({surface, make_geometry(surface), surface.to_world.inverse()});
        include(visible, bounds_of(objects.back()), scene, label(surface, "surface"));
    }
    for (const Volume& volume : scene.volumes) {
        volumes.emplace_back(volume);
        include(visible, volumes.back().bounds(), scene, label(volume, "volume"));
    }
    const Camera camera(scene.camera, scene.image, visible, crop);
    for (const Object& object : objects) warn_if_cut(scene, camera, bounds_of(object), label(object.surface, "surface"));
    for (const VolumeObject& volume : volumes) warn_if_cut(scene, camera, volume.bounds(), label(volume.settings(), "volume"));
    return {scene, std::move(objects), std::move(volumes), camera};
}

}  // namespace pellucid
