#include "stage/particle_shading.hpp"

#include <cmath>

#include "scene/shading.hpp"
#include "stage/ensemble.hpp"

namespace pellucid {
namespace {

[[nodiscard]] twin::Vec3f narrow(const Vec3& v) {
    return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

/// Appends the image's texels and notes where a point of the surface finds its place among them.
void add_texture(const SurfaceTexture& texture, const Camera& camera, const ParticleFrame& frame,
                 twin::Material& m, std::vector<twin::Vec3f>& texels) {
    const Image& image = *texture.image;
    m.first_texel = static_cast<int>(texels.size());
    m.texture_width = image.width();
    m.texture_height = image.height();
    for (std::size_t i = 0; i < image.pixel_count(); ++i)
        texels.push_back({image.plane("R")[i], image.plane("G")[i], image.plane("B")[i]});
    // a = (q − center)·along_u is 1 at center + u and 0 along v: the dual basis of u, v.
    const double unit = std::ldexp(1.0, frame.exponent);
    const Vec3 u = camera.view_vector(texture.u) / unit;
    const Vec3 v = camera.view_vector(texture.v) / unit;
    const Vec3 normal = cross(u, v);
    m.center = narrow((camera.to_view(texture.center) - Vec3(0, 0, frame.near)) / unit);
    m.along_u = narrow(cross(v, normal) / dot(normal, normal));
    m.along_v = narrow(cross(normal, u) / dot(normal, normal));
}

}  // namespace

ParticleShading::ParticleShading(const PreparedScene& scene, const ParticleFrame& frame) {
    const Camera& camera = scene.camera;
    view.perspective = camera.perspective() ? 1 : 0;
    view.near = camera.perspective() ? static_cast<float>(std::ldexp(frame.near, -frame.exponent)) : 0.0F;
    view.light_count = static_cast<int>(scene.settings.lights.size());
    view.units = static_cast<float>(color_units_of(brightest_color(scene)));
    for (const Light& light : scene.settings.lights)
        lights.push_back({narrow(camera.view_vector(light.direction)), static_cast<float>(light.intensity),
                          light.headlight ? 1 : 0});
    const auto add_painted = [&](const Vec3& brightest) {
        twin::Material m{};
        m.red = static_cast<float>(brightest.x);
        m.green = static_cast<float>(brightest.y);
        m.blue = static_cast<float>(brightest.z);
        m.flat_colored = m.painted = 1;
        materials.push_back(m);
    };
    for (const Object& object : scene.objects) {
        if (object.geometry->painted()) {
            add_painted(brightest_color(scene.settings.lights, object));
            continue;
        }
        const Shading& s = object.surface.shading;
        const Vec3& color = object.surface.color;
        twin::Material m{};
        m.red = static_cast<float>(color.x);
        m.green = static_cast<float>(color.y);
        m.blue = static_cast<float>(color.z);
        m.ambient = static_cast<float>(s.ambient);
        m.diffuse = static_cast<float>(s.diffuse);
        m.specular = static_cast<float>(s.specular);
        m.shininess = static_cast<float>(s.shininess);
        m.flat_colored = s.flat ? 1 : 0;
        if (const auto texture = object.geometry->texture()) add_texture(*texture, camera, frame, m, texels);
        materials.push_back(m);
    }
    for (const VolumeObject& volume : scene.volumes) add_painted(brightest_color(scene.settings.lights, volume));
}

twin::ColorUnits shade_particle(const ParticleShading& shading, std::uint32_t object,
                                const Particle& particle) {
    const twin::Material& m = shading.materials[object];
    const twin::Vec3f to_viewer = twin::direction_to_viewer(shading.view, particle);
    const twin::Vec3f normal = twin::turned_to(twin::unpack_normal(particle.normal), to_viewer);
    twin::LightSums sums{0, 0};
    for (const twin::ViewLight& light : shading.lights)
        sums = twin::add_light(sums, normal, to_viewer, light.headlight != 0 ? to_viewer : light.direction,
                               light.intensity, m.shininess);
    twin::Vec3f color{m.red, m.green, m.blue};
    if (m.texture_width > 0) {
        const twin::TexelPlace at = twin::texel_place(m, particle);
        const auto texel = [&](int column, int row) -> const twin::Vec3f& {
            return shading.texels[static_cast<std::size_t>(m.first_texel) +
                                  static_cast<std::size_t>(row) * static_cast<std::size_t>(m.texture_width) +
                                  static_cast<std::size_t>(column)];
        };
        const twin::Vec3f& a = texel(at.left, at.top);
        const twin::Vec3f& b = texel(at.right, at.top);
        const twin::Vec3f& c = texel(at.left, at.bottom);
        const twin::Vec3f& d = texel(at.right, at.bottom);
        color = {twin::mix_texels(at, a.x, b.x, c.x, d.x), twin::mix_texels(at, a.y, b.y, c.y, d.y),
                 twin::mix_texels(at, a.z, b.z, c.z, d.z)};
    }
    if (m.painted != 0) color = twin::paint_color(m, particle);
    return twin::color_units(m, sums, color.x, color.y, color.z, shading.view.units);
}

EnsembleSums::Pixel winner_sums(const ParticleShading& shading, std::uint32_t object,
                                const Particle& particle) {
    const twin::ColorUnits c = shade_particle(shading, object, particle);
    EnsembleSums::Pixel one{.color = {c.red, c.green, c.blue},
                            .covered = 1,
                            .depth = twin::floatBitsToUint(particle.above_near)};
    for (int k = 0; k < 3; ++k) one.square[k] = one.color[k] * one.color[k];
    return one;
}

}  // namespace pellucid
