#include "study/uniformity_surfaces.hpp"

#include <cmath>
#include <fstream>
#include <vector>

#include "core/error.hpp"

namespace pellucid {

std::string uniformity_surface(const std::string& name, const std::filesystem::path& folder) {
    if (name == "ellipsoid") return "implicit = \"ellipsoid\"\nparameters = { a = 1.0, b = 0.6, c = 0.35 }";
    if (name != "catmull_rom") return "implicit = \"" + name + "\"";
    constexpr int kSamples = 24;
    std::vector<float> values;
    for (int k = 0; k < kSamples; ++k)
        for (int j = 0; j < kSamples; ++j)
            for (int i = 0; i < kSamples; ++i) {
                const double x = i - 11.5, y = j - 11.5, z = k - 11.5;
                const double r = std::sqrt(x * x + 1.3 * y * y + 0.8 * z * z) / 11.5;
                values.push_back(static_cast<float>(r + 0.12 * std::sin(0.9 * x + 0.3 * y) * std::cos(0.7 * z - 0.2 * x) +
                                                    0.05 * std::sin(1.7 * y + 0.4 * z)));
            }
    const std::filesystem::path file = folder / "waves.nrrd";
    std::ofstream out(file, std::ios::binary);
    out << "NRRD0004\ntype: float\ndimension: 3\nsizes: 24 24 24\nspacings: 1 1 1\nencoding: raw\nendian: little\n\n";
    out.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(float)));
    out.close();
    if (!out) throw run_error("{}: cannot be written", file.string());
    return "isosurface = { volume = \"" + file.string() + "\", isovalue = 0.7, interpolation = \"catmull-rom\" }";
}

}  // namespace pellucid
