#include "study/fused_inputs.hpp"

#include <array>
#include <cmath>
#include <fstream>
#include <numbers>
#include <vector>

#include "core/error.hpp"
#include "field/volume_points.hpp"
#include "io/volume_file.hpp"
#include "io/write_points.hpp"

namespace pellucid {
namespace {

namespace fs = std::filesystem;

/// Regions of the AAL atlas (N. Tzourio-Mazoyer et al. 2002) by their number.
struct Region {
    const char* name;
    float label;
};
constexpr Region kOrgans[] = {{"caudate_left", 71},     {"caudate_right", 72},     {"putamen_left", 73},  {"putamen_right", 74},
                              {"thalamus_left", 77},    {"thalamus_right", 78},    {"hippocampus_left", 37},
                              {"hippocampus_right", 38}, {"cingulum_left", 33},    {"cingulum_right", 34}};

void write_organs(const fs::path& templates, const fs::path& folder) {
    const VoxelGrid atlas = read_volume(templates / "aal.nii.gz");
    // Blurred by 2 voxels, the border at 0.3 of a region stands outside of it: neighbours overlap.
    constexpr double kBlur = 2;
    constexpr double kBorder = 0.3;
    for (const Region& region : kOrgans)
        write_points(isosurface_points(label_mask(atlas, region.label, kBlur), kBorder),
                     folder / (std::string(region.name) + ".ply"));
}

/// Two crossing beams through the head's middle, largest value 1.
void write_dose(const fs::path& folder) {
    constexpr int kSamples = 48;
    constexpr double kSpacing = 4;  // mm
    const fs::path file = folder / "dose.nrrd";
    std::ofstream out(file, std::ios::binary);
    out << "NRRD0004\ntype: float\ndimension: 3\nspace: right-anterior-superior\nsizes: 48 48 48\n"
           "space directions: (4,0,0) (0,4,0) (0,0,4)\nspace origin: (-94,-110,-86)\nencoding: raw\nendian: little\n\n";
    const Vec3 origin(-94, -110, -86);
    const Vec3 target(18, 5, 12);
    double largest = 0;
    std::vector<double> dose;
    for (int k = 0; k < kSamples; ++k)
        for (int j = 0; j < kSamples; ++j)
            for (int i = 0; i < kSamples; ++i) {
                const Vec3 from = origin + kSpacing * Vec3(i, j, k) - target;
                double sum = 0;
                for (const Vec3& beam : {normalize(Vec3(0.8, 0.6, 0.1)), normalize(Vec3(-0.3, 0.7, 0.65))}) {
                    const double along = dot(from, beam);
                    const double off = dot(from, from) - along * along;
                    sum += std::exp(-off / (2 * 14 * 14)) * std::exp(-along * along / (2 * 55 * 55));
                }
                dose.push_back(sum);
                largest = std::max(largest, sum);
            }
    for (const double value : dose) {
        const auto v = static_cast<float>(value / largest);
        out.write(reinterpret_cast<const char*>(&v), sizeof v);
    }
    out.close();
    if (!out) throw run_error("{}: cannot be written", file.string());
}

/// A closed tube of triangles with a point.
void write_needle(const fs::path& folder) {
    constexpr int kAround = 24;
    const Vec3 tip(18, 5, 12);
    const Vec3 along = normalize(Vec3(-0.55, 0.6, 0.58));
    const Vec3 aside = normalize(cross(along, Vec3(0, 0, 1)));
    const Vec3 up = cross(along, aside);
    const fs::path file = folder / "needle.off";
    std::ofstream out(file);
    out << fmt::format("OFF\n{} {} 0\n{} {} {}\n", 2 * kAround + 2, 4 * kAround, tip.x, tip.y, tip.z);
    const double ends[] = {8, 130};  // mm from the tip
    for (const double end : ends)
        for (int i = 0; i < kAround; ++i) {
            const double angle = 2 * std::numbers::pi * i / kAround;
            const Vec3 p = tip + end * along + 2.5 * (std::cos(angle) * aside + std::sin(angle) * up);
            out << fmt::format("{} {} {}\n", p.x, p.y, p.z);
        }
    const Vec3 back = tip + ends[1] * along;
    out << fmt::format("{} {} {}\n", back.x, back.y, back.z);
    for (int i = 0; i < kAround; ++i) {
        const int a = 1 + i, b = 1 + (i + 1) % kAround;
        const int c = a + kAround, d = b + kAround;
        out << fmt::format("3 0 {} {}\n3 {} {} {}\n3 {} {} {}\n3 {} {} {}\n", b, a, a, b, c, b, d, c, c, d, 2 * kAround + 1);
    }
    out.close();
    if (!out) throw run_error("{}: cannot be written", file.string());
}

}  // namespace

void write_fused_inputs(const std::string& name, const fs::path& templates, const fs::path& folder) {
    if (name == "organs") write_organs(templates, folder);
    if (name == "scan_and_wave") {
        // Raw, the border has noise and folds of one voxel, which no scanner of surfaces sees.
        constexpr double kBlur = 2;
        write_points(isosurface_points(blurred(read_volume(templates / "ch2bet.nii.gz"), kBlur), 50), folder / "brain.ply");
    }
    if (name == "dose") write_dose(folder);
    if (name == "slice") write_needle(folder);
}

}  // namespace pellucid
