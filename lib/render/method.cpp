#include "render/method.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "render/methods.hpp"

namespace pellucid {

const std::vector<Method>& methods() {
    static const std::vector<Method> all{particles_method(),     slabs_method(),  mdvr_method(),
                                         reference_method(),     z_test_method(), depth_peeling_method(),
                                         alpha_blend_method()};
    return all;
}

const Method& method_by_name(std::string_view name) {
    std::string known;
    for (const Method& method : methods()) {
        if (method.name == name) return method;
        known += (known.empty() ? "" : ", ") + std::string(method.name);
    }
    throw input_error("--method {}: expected one of {}", name, known);
}

void require_drawable(const Method& method, const Scene& scene) {
    if (const auto why = method.refusal(scene))
        throw input_error("{}: method {} cannot draw {}", scene.source, method.name, *why);
}

std::optional<std::string> refusal_of_ray_and_particle_methods(const Scene& scene) {
    for (const Surface& surface : scene.surfaces) {
        if (!has_geometry(surface.shape))
            return fmt::format(
                "surface \"{}\": it draws every kind but isosurfaces with interpolation = \"nearest\"", surface.name);
        if (!surface.contours.empty()) return fmt::format("surface \"{}\": it has contours", surface.name);
    }
    return std::nullopt;
}

void warn_of_rough_depths(const PreparedScene& scene) {
    constexpr double kRough = 2e-4;  // of the scene's size: a tenth of a voxel where there are 500
    Box visible;
    for (const Object& object : scene.objects)
        if (object.geometry->patch_count() > 0) visible.include(object.geometry->bounds());
    for (const VolumeObject& volume : scene.volumes)
        if (!volume.bounds().empty()) visible.include(volume.bounds());
    if (visible.empty()) return;
    const double size = length(visible.size());
    const double depth = std::min(scene.camera.to_view(visible.center()).z + 0.5 * size, scene.camera.far());
    const double step = std::ldexp(depth, -23);
    if (step > kRough * size)
        warn("at a depth of {:.3g} float32 goes in steps of {:.2g}, and the scene is {:.2g} large: what is nearer to each "
             "other is drawn in any order. Place the camera nearer",
             depth, step, size);
}

}  // namespace pellucid
