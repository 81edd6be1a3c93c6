// Volumes as scanners and simulations make them, by `slabs` and `mdvr`, beside the truth: bytes, words and floats,
// labels, anisotropic and oblique grids, three registered volumes in one place, surfaces among them.
//
// Methods with one ray a pixel are drawn at 4 × 4 of them and averaged, as the truth averages over a pixel, so that what
// is left is the error of their model: steps of a voxel, mixtures within a step, slabs that were merged into few.
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "measure/image_metrics.hpp"
#include "scene_testing.hpp"
#include "study/method_image.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

const fs::path kShared = fs::path(PELLUCID_SOURCE_DIR) / "../shared/data/volumes";
const fs::path kTemplates = "/usr/share/mricron/templates";  // Debian's mricron-data

constexpr int kSide = 24;
constexpr int kRays = 4;
/// Standard error of the truth in every channel of every pixel, at most.
constexpr double kTruthError = 4e-3;
/// RMSE beside the truth that is allowed, of linear colours on 0 to 1 over black: hardly more than the truth's own error.
constexpr double kMostRmse = 1.5 * kTruthError;

struct RealScene {
    const char* name;
    std::vector<fs::path> files;
    std::string toml;  // after [image]
};
void PrintTo(const RealScene& scene, std::ostream* out) { *out << scene.name; }

std::string view(const char* position, const char* target, double height) {
    return fmt::format("[camera]\nprojection = \"orthographic\"\nposition = {}\ntarget = {}\nup = [0, 0, 1]\n"
                       "view_height = {}\n",
                       position, target, height);
}

std::string volume(const char* name, const fs::path& file, const std::string& transfer, const std::string& more = "") {
    return fmt::format("[[volume]]\nname = \"{}\"\nfile = \"{}\"\ntransfer = {}\n{}\n", name, file.string(), transfer, more);
}

std::vector<RealScene> scenes() {
    const fs::path tooth = kShared / "ct_tooth.nrrd", hydrogen = kShared / "sim_hydrogen.nrrd";
    const fs::path head = kTemplates / "ch2.nii.gz", labels = kTemplates / "aal.nii.gz";
    const fs::path anisotropic = kShared / "mri_head.nii.gz";
    const fs::path t1 = kShared / "mri_stroke_t1.nii.gz", t2 = kShared / "mri_stroke_t2.nii.gz";
    const fs::path flair = kShared / "mri_stroke_flair.nii.gz";
    return {
        {"words", {tooth}, view("[250, 180, 160]", "[51, 46, 80]", 190) +
         volume("tooth", tooth, "[[350, 0.8, 0.5, 0.3, 0], [600, 0.9, 0.7, 0.5, 0.03], [900, 1, 0.95, 0.85, 0.15]]",
                "shading = { ambient = 0.3, diffuse = 0.7 }")},
        {"floats", {hydrogen}, view("[150, 90, 110]", "[31.5, 31.5, 31.5]", 90) +
         volume("orbital", hydrogen, "[[0.02, 0.1, 0.2, 0.9, 0], [0.2, 0.3, 0.9, 0.4, 0.1], [0.7, 1, 0.4, 0.1, 0.4]]")},
        {"anisotropic", {anisotropic}, view("[90, 320, 600]", "[-308, 22, 477]", 260) +
         volume("head", anisotropic, "[[60, 0.6, 0.3, 0.2, 0], [200, 0.9, 0.7, 0.6, 0.02], [420, 1, 1, 1, 0.1]]")},
        {"head_labels_and_surfaces", {head, labels}, view("[-330, 540, 90]", "[0, -17, 4]", 230) +
         volume("head", head, "[[30, 0.7, 0.5, 0.4, 0], [90, 0.9, 0.7, 0.6, 0.01], [250, 1, 1, 1, 0.05]]") +
         volume("regions", labels, "[[0.5, 0, 0, 0, 0], [0.5, 0.9, 0.2, 0.1, 0.04], [116, 0.1, 0.4, 0.9, 0.04]]",
                "interpolation = \"nearest\"") +
         fmt::format("[[surface]]\nname = \"skin\"\nisosurface = {{ volume = \"{}\", isovalue = 40 }}\nopacity = 0.2\n"
                     "color = [0.9, 0.7, 0.5]\n[[surface]]\nname = \"cut\"\nrectangle = {{ center = [0, -20, 10], u = [60, 0, "
                     "20], v = [0, 70, 0] }}\nopacity = 0.5\ncolor = [0.2, 0.8, 0.3]\nshading = \"flat\"\n", head.string())},
        {"three_oblique", {t1, t2, flair}, view("[260, 330, 150]", "[0, -20, 20]", 190) +
         volume("t1", t1, "[[60, 0.9, 0.3, 0.2, 0], [220, 1, 0.4, 0.3, 0.03]]") +
         volume("t2", t2, "[[150, 0.2, 0.9, 0.3, 0], [450, 0.2, 1, 0.3, 0.05]]") +
         volume("flair", flair, "[[90, 0.2, 0.3, 0.9, 0], [230, 0.3, 0.4, 1, 0.05]]")},
    };
}

Image draw(const std::string& toml, int side, const MethodChoice& choice) {
    RenderStats stats;
    const std::string head = fmt::format("[image]\nresolution = [{}, {}]\n", side, side);
    return method_image(prepare(scene_from(head + toml)), choice, Seed{1}, stats);
}

/// Means of n × n pixels.
RgbImage averaged(const Image& fine, int n) {
    const RgbImage all = over_background(fine, Vec3(0.0), "test");
    RgbImage out{all.width / n, all.height / n, {}};
    for (std::size_t c = 0; c < 3; ++c) {
        out.channels[c].resize(out.pixel_count());
        for (int y = 0; y < all.height; ++y)
            for (int x = 0; x < all.width; ++x)
                out.channels[c][static_cast<std::size_t>(y / n * out.width + x / n)] +=
                    all.channels[c][static_cast<std::size_t>(y * all.width + x)] / (n * n);
    }
    return out;
}

class RealVolumes : public testing::TestWithParam<RealScene> {
protected:
    void SetUp() override {
        for (const fs::path& file : GetParam().files)
            if (!fs::exists(file)) GTEST_SKIP() << "skipped: no " << file;
    }
};

TEST_P(RealVolumes, SlabsAndRayCastingAreNearTheTruth) {
    const RealScene& scene = GetParam();
    const MethodChoice reference{"reference", {fmt::format("reference.max_error={}", kTruthError)}};
    const RgbImage truth = over_background(draw(scene.toml, kSide, reference), Vec3(0.0), "truth");
    double seen = 0;
    for (const double v : truth.channels[0]) seen = std::max(seen, v);
    ASSERT_GT(seen, 0.2);  // there is something to compare
    // It would be seen if a tenth of the light were lost.
    RgbImage dark = truth;
    for (auto& channel : dark.channels)
        for (double& v : channel) v *= 0.9;
    ASSERT_GT(rmse(dark, truth), kMostRmse);
    const auto error = [&](const char* method, std::vector<std::string> settings) {
        return rmse(averaged(draw(scene.toml, kRays * kSide, {method, std::move(settings)}), kRays), truth);
    };
    EXPECT_LE(error("mdvr", {"mdvr.mixing=extinction"}), kMostRmse);
    for (const char* intermix : {"image", "hybrid", "order-free"}) {
        const std::string how = fmt::format("slabs.intermix={}", intermix);
        EXPECT_LE(error("slabs", {how, "slabs.layers=256", "slabs.mixing=extinction", "slabs.interpolation=original"}),
                  kMostRmse)
            << intermix;
        EXPECT_LE(error("slabs", {how}), kMostRmse) << intermix;
    }
}

INSTANTIATE_TEST_SUITE_P(Scenes, RealVolumes, testing::ValuesIn(scenes()),
                         [](const auto& scene) { return std::string(scene.param.name); });

}  // namespace
}  // namespace pellucid
