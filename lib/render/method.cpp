#include "render/method.hpp"

#include "core/error.hpp"
#include "render/methods.hpp"

namespace pellucid {

const std::vector<Method>& methods() {
    static const std::vector<Method> all{particles_method(),     reference_method(),   z_test_method(),
                                         depth_peeling_method(), alpha_blend_method(), mdvr_method()};
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

}  // namespace pellucid
