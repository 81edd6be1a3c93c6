// Scenes on which every backend that draws particles must agree: all shapes, both projections, many and few
// tiles, equal depths, images on rectangles, bright and absent lights.
#pragma once

#include <functional>

#include "io/image_file.hpp"
#include "sample/particle_sampler.hpp"
#include "scene_testing.hpp"

namespace pellucid::testing_scenes {

struct DrawerScene {
    std::string name;
    PreparedScene scene;
    std::uint32_t repeats;
};

/// A folder with what the scenes name: a mesh, a volume, an image.
inline fs::path drawer_folder() {
    const fs::path folder = test_folder();
    put(folder / "tetrahedron.obj",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
    std::vector<float> values;
    for (int k = 0; k < 9; ++k)
        for (int j = 0; j < 8; ++j)
            for (int i = 0; i < 7; ++i)
                values.push_back(static_cast<float>(std::sin(i + 0.3 * j) + std::cos(j - 0.7 * k)));
    put_volume(folder / "waves.nrrd", {7, 8, 9}, values);
    Image image(5, 3);
    for (const char* channel : {"R", "G", "B", "A"}) {
        std::span<float> plane = image.add(channel, 1.0F);
        if (channel[0] == 'A') continue;
        for (std::size_t i = 0; i < plane.size(); ++i)
            plane[i] = static_cast<float>((i * 7 + static_cast<std::size_t>(channel[0])) % 11) / 10;
    }
    write_png(image, Vec3(0.0), folder / "checks.png");
    return folder;
}

inline std::vector<DrawerScene> drawer_scenes() {
    const fs::path folder = drawer_folder();
    std::vector<DrawerScene> scenes;
    const auto add = [&](const std::string& name, std::uint32_t repeats, const std::string& toml,
                         std::optional<PixelRect> crop = std::nullopt) {
        scenes.push_back({name, prepare(scene_from(toml, folder), crop), repeats});
    };
    const std::string lights =
        "[[light]]\nheadlight = true\nintensity = 0.7\n[[light]]\ndirection = [1, 2, 1]\nintensity = 0.6\n";
    const std::string glossy = "shading = { ambient = 0.1, diffuse = 0.6, specular = 0.5, shininess = 40 }\n";
    const auto torus = [&](const std::string& more) {
        return "[[surface]]\nname = \"ring\"\nimplicit = \"torus\"\ncolor = [0.9, 0.5, 0.2]\n" + glossy +
               more;
    };
    add("perspective, many tiles", 5,
        "[image]\nresolution = [333, 201]\n[camera]\nposition = [1.5, 2, 4.5]\nfov_degrees = 35\n" + lights +
            torus("opacity = 0.6\n") +
            "[[surface]]\nname = \"ball\"\nimplicit = \"sphere\"\nopacity = 0.3\ntranslate = [0.4, 0, 0.2]\nopacity_law = \"oblique\"\n");
    add("orthographic, every shape", 6,
        "[image]\nresolution = [190, 150]\n[camera]\nprojection = \"orthographic\"\nposition = [2, 3, 5]\nview_height = 4\n" +
            lights + torus("opacity = 0.4\nclip = [{ normal = [1, 0, 0], offset = 0.3 }]\n") +
            "[[surface]]\nname = \"tetrahedron\"\nmesh = \"tetrahedron.obj\"\nopacity = 0.7\n" +
            "[[surface]]\nname = \"waves\"\nisosurface = { volume = \"waves.nrrd\", isovalue = 0.2 }\nscale = 0.2\nopacity = 0.5\n" +
            glossy +
            "[[surface]]\nname = \"checks\"\nrectangle = { center = [0, -0.5, 0], u = [1.2, 0, 0.3], v = [0, 0.3, 1], image = \"checks.png\" }\nopacity = 0.8\n");
    add("an image in perspective, flat", 8,
        "[image]\nresolution = [97, 64]\n[camera]\nposition = [0.3, 1.2, 2.5]\n[[surface]]\nname = \"checks\"\n"
        "rectangle = { u = [1, 0, 0], v = [0, 0.7, 0.7], image = \"checks.png\" }\nopacity = 0.9\nshading = \"flat\"\n");
    add("coincident surfaces", 40,
        "[image]\nresolution = [40, 30]\n[camera]\nposition = [0, 0, 3]\n"
        "[[surface]]\nname = \"a\"\nrectangle = {}\nopacity = 0.6\ncolor = [1, 0, 0]\n"
        "[[surface]]\nname = \"b\"\nrectangle = {}\nopacity = 0.6\ncolor = [0, 1, 0]\n");
    add("crop off the axis", 4,
        "[image]\nresolution = [800, 600]\n[camera]\nposition = [1.5, 2, 4.5]\n" + lights +
            torus("opacity = 0.9\n"),
        PixelRect{420, 200, 615, 333});
    add("inside, wide angle", 4,
        "[image]\nresolution = [150, 150]\n[camera]\nposition = [1, 0, 0.1]\ntarget = [0, 1, 0]\nfov_degrees = 140\nnear = 1e-3\n" +
            lights + torus("opacity = 0.5\n"));
    add("bright lights", 3,
        "[image]\nresolution = [70, 70]\n[camera]\nposition = [1.5, 2, 4.5]\n[[light]]\ndirection = [0, 0, 1]\nintensity = 3000\n" +
            torus("opacity = 0.5\n"));
    std::string crowd =
        "[image]\nresolution = [130, 130]\n[camera]\nposition = [0, 0, 9]\nfov_degrees = 40\n" + lights;
    for (int i = 0; i < 70; ++i)
        crowd += fmt::format(
            "[[surface]]\nname = \"ball {}\"\nimplicit = \"sphere\"\nscale = 0.3\ntranslate = [{}, {}, {}]\ncolor = [{}, 0.5, 0.5]\nopacity = 0.5\n",
            i, 0.3 * (i % 10) - 1.4, 0.4 * (i / 10) - 1.2, 0.05 * (i % 7), 0.01 * i);
    add("seventy objects", 3, crowd);
    add("nothing in view", 2,
        "[image]\nresolution = [33, 17]\n[camera]\nposition = [0, 0, 5]\ntarget = [0, 0, 9]\n" + torus(""));
    // Painted particles: of a lit volume with colours above 1, and of a slice; between them a surface.
    add("volume, slice and surface", 5,
        "[image]\nresolution = [170, 120]\n[camera]\nposition = [1.5, 2, 4.5]\n" + lights + torus("opacity = 0.4\n") +
            "[[volume]]\nname = \"fog\"\nfile = \"waves.nrrd\"\nscale = 0.25\ntranslate = [-0.8, -0.8, -0.8]\n" + glossy +
            "transfer = [[-1, 0.2, 0.4, 1, 0], [0.5, 1, 0.3, 0.1, 0.2], [0.5, 0.9, 0.9, 0.2, 0.5]]\n"
            "[[surface]]\nname = \"cut\"\nscale = 0.3\nopacity = 0.8\n"
            "slice = { volume = \"waves.nrrd\", center = [3, 3, 4], u = [3, 0, 1], v = [0, 3, 0], "
            "transfer = [[-1, 0, 0, 1, 0.1], [1, 1, 1, 0, 1]] }\n");
    const fs::path head = "/usr/share/mricron/templates/ch2.nii.gz";
    if (fs::exists(head))
        add("head", 2,
            fmt::format(
                "[image]\nresolution = [150, 150]\n[camera]\nposition = [300, 350, 80]\ntarget = [0, -18, 10]\nup = [0, 0, 1]\nfov_degrees = 40\n[[surface]]\n"
                "name = \"skin\"\nisosurface = {{ volume = \"{}\", isovalue = 40 }}\nopacity = 0.3\n",
                head.string()));
    return scenes;
}

inline ParticleSet drawer_particles(const DrawerScene& each, Seed seed = {1}) {
    return sample_particles(each.scene, make_sources(each.scene), {.seed = seed}, 0, each.repeats);
}

/// FNV-1a over the winners of all repeats: what a failing test prints.
inline std::uint64_t hash_of(const std::vector<std::vector<std::uint32_t>>& winners) {
    std::uint64_t hash = 14695981039346656037ULL;
    for (const auto& repeat : winners)
        for (const std::uint32_t pixel : repeat)
            for (int byte = 0; byte < 4; ++byte)
                hash = (hash ^ (pixel >> (8 * byte) & 255U)) * 1099511628211ULL;
    return hash;
}

/// Sums equal bit for bit.
inline void expect_equal_sums(const EnsembleSums& a, const EnsembleSums& b) {
    EXPECT_EQ(a.repeats, b.repeats);
    EXPECT_EQ(a.particles, b.particles);
    ASSERT_EQ(a.pixels.size(), b.pixels.size());
    std::size_t different = 0;
    for (std::size_t i = 0; i < a.pixels.size(); ++i)
        different += std::memcmp(&a.pixels[i], &b.pixels[i], sizeof(EnsembleSums::Pixel)) != 0 ? 1U : 0U;
    EXPECT_EQ(different, 0U) << "of " << a.pixels.size() << " pixels";
}

}  // namespace pellucid::testing_scenes
