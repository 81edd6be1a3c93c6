// The methods z-test, depth-peeling and alpha-blend as users meet them: against rays through the pixels' centres.
#include <map>

#include "core/error.hpp"
#include "field/catalogue.hpp"
#include "reference/ray_scene.hpp"
#include "render/method.hpp"
#include "scene/shading.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

[[nodiscard]] Image draw(const PreparedScene& scene, const char* method, const std::string& settings = "", RenderStats* stats = nullptr) {
    const Config config = Config::parse(settings, "--set");
    const RenderInput input{.scene = scene, .settings = config.root().table(method), .seed = {}, .max_error = {},
                            .tessellate = config.root().table("tessellate")};
    const Method& m = method_by_name(method);
    m.check_settings(input);
    config.finish();
    RenderStats own;
    return m.render(input, stats != nullptr ? *stats : own);
}

/// Hits, colour and opacity on the ray of every pixel's centre, by the truth's own parts.
struct CenterTruth {
    std::size_t hits = 0;
    double nearest = kInfinity;
    double rgba[4]{};
};
[[nodiscard]] std::vector<CenterTruth> trace_centers(const PreparedScene& scene) {
    const RayScene rays(scene);
    const Camera& camera = scene.camera;
    std::vector<CenterTruth> all;
    PacketHits found;
    for (int y = 0; y < camera.height(); ++y)
        for (int x0 = 0; x0 < camera.width(); x0 += kPacket) {
            std::array<Ray, kPacket> packet;
            for (int i = 0; i < kPacket; ++i) packet[static_cast<std::size_t>(i)] = camera.ray(std::min(x0 + i, camera.width() - 1) + 0.5, y + 0.5);
            rays.gather(packet, found);
            for (int i = 0; i < kPacket && x0 + i < camera.width(); ++i) {
                const Ray& ray = packet[static_cast<std::size_t>(i)];
                CenterTruth& pixel = all.emplace_back();
                double clear = 1;
                for (const RayHit& hit : found[static_cast<std::size_t>(i)]) {
                    const Object& object = scene.objects[hit.object];
                    const Vec3 place = ray.origin + hit.t * ray.direction;
                    const double alpha = object.opacity(
                        std::max(std::abs(dot(hit.normal, ray.direction)) / (length(hit.normal) * length(ray.direction)), 1e-12),
                        object.geometry->opacity_at(place));
                    const Vec3 color = shade(scene, object, place, object.geometry->shading_normal(hit.patch, place, hit.normal));
                    for (int c = 0; c < 3; ++c) pixel.rgba[c] += clear * alpha * color[c];
                    clear *= 1 - alpha;
                    pixel.nearest = std::min(pixel.nearest, hit.t);
                    ++pixel.hits;
                }
                pixel.rgba[3] = 1 - clear;
            }
        }
    return all;
}

/// Pixels around which all rays meet as many surfaces: outlines are elsewhere.
[[nodiscard]] std::vector<bool> interior(const std::vector<CenterTruth>& truth, int width, int height) {
    std::vector<bool> inside(truth.size(), false);
    for (int y = 1; y + 1 < height; ++y)
        for (int x = 1; x + 1 < width; ++x) {
            const auto at = [&](int dx, int dy) { return truth[static_cast<std::size_t>((y + dy) * width + x + dx)].hits; };
            bool same = true;
            for (int dy = -1; dy <= 1; ++dy)
                for (int dx = -1; dx <= 1; ++dx) same = same && at(dx, dy) == at(0, 0);
            inside[static_cast<std::size_t>(y * width + x)] = same;
        }
    return inside;
}

class CatalogueByTriangles : public testing::TestWithParam<std::string> {};

TEST_P(CatalogueByTriangles, HasTheSurfacesOfTheTruth) {
    constexpr int kSide = 48;
    const PreparedScene scene = prepare(scene_from(
        fmt::format("image.resolution = [{0}, {0}]\ncamera = {{ position = [3, 2.2, 5], fov_degrees = 40 }}\n"
                    "[[surface]]\nname = \"s\"\nimplicit = \"{1}\"\nopacity = 0.4\n", kSide, GetParam())));
    const Image image = draw(scene, "depth-peeling");
    const auto truth = trace_centers(scene);
    const auto inside = interior(truth, kSide, kSide);
    std::size_t compared = 0, other_count = 0, other_color = 0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
        if (!inside[i]) continue;
        ++compared;
        // Constant opacity: as many surfaces, the same opacity.
        if (std::abs(static_cast<double>(image.plane("A")[i]) - truth[i].rgba[3]) > 1e-5) {
            ++other_count;
            continue;
        }
        for (int c = 0; c < 3; ++c)
            if (std::abs(static_cast<double>(image.plane(c == 0 ? "R" : c == 1 ? "G" : "B")[i]) - truth[i].rgba[c]) > 0.03) {
                ++other_color;
                break;
            }
    }
    EXPECT_GT(compared, 500U);
    // Handles and creases narrower than a pixel hide between equal neighbours.
    EXPECT_LE(other_count, compared / 50) << compared;
    EXPECT_LE(other_color, compared / 50) << compared;
}

[[nodiscard]] std::vector<std::string> catalogue_names() {
    std::vector<std::string> names;
    for (const CatalogueEntry& entry : catalogue()) names.emplace_back(entry.name);
    return names;
}
INSTANTIATE_TEST_SUITE_P(All, CatalogueByTriangles, testing::ValuesIn(catalogue_names()), [](const auto& each) { return each.param; });

const std::string kCards =
    "image.resolution = [64, 48]\ncamera.position = [0.5, 0.3, 4]\n"
    "[[surface]]\nname = \"far\"\nrectangle = { center = [0, 0, -1], u = [1, 0, 0], v = [0, 1, 0] }\ncolor = [1, 0, 0]\nopacity = 0.5\n"
    "[[surface]]\nname = \"near\"\nrectangle = { center = [0.3, 0, 1], u = [0.4, 0, 0], v = [0, 1, 0] }\ncolor = [0, 1, 0]\nopacity = 0.25\n";

TEST(SurfaceMethods, ZTestDrawsTheNearestAsOpaque) {
    const PreparedScene scene = prepare(scene_from(kCards));
    const Image image = draw(scene, "z-test");
    const auto truth = trace_centers(scene);
    std::size_t both = 0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
        EXPECT_EQ(image.plane("A")[i], truth[i].hits > 0 ? 1 : 0);
        if (truth[i].hits == 0) {
            EXPECT_EQ(image.plane("Z")[i], std::numeric_limits<float>::infinity());
            continue;
        }
        EXPECT_FLOAT_EQ(image.plane("Z")[i], static_cast<float>(truth[i].nearest));
        if (truth[i].hits < 2) continue;
        ++both;
        EXPECT_EQ(image.plane("R")[i], 0);
        EXPECT_GT(image.plane("G")[i], 0.9F);
    }
    EXPECT_GT(both, 20U);
}

TEST(SurfaceMethods, AlphaBlendFollowsTheFileOrTheDepthOfCentres) {
    // The nearer card comes last in the file: all orders are right. Turned over, the file's order is wrong.
    const std::size_t second = kCards.find("[[surface]]", kCards.find("[[surface]]") + 1);
    const std::string head = kCards.substr(0, kCards.find("[[surface]]"));
    const std::string turned = head + kCards.substr(second) + kCards.substr(head.size(), second - head.size());
    const auto truth = trace_centers(prepare(scene_from(kCards)));
    for (const bool over : {false, true}) {
        const PreparedScene scene = prepare(scene_from(over ? turned : kCards));
        for (const std::string sort : {"none", "object", "triangle"}) {
            const Image image = draw(scene, "alpha-blend", fmt::format("alpha-blend.sort = \"{}\"", sort));
            std::size_t wrong = 0;
            for (std::size_t i = 0; i < truth.size(); ++i) {
                EXPECT_NEAR(static_cast<double>(image.plane("A")[i]), truth[i].rgba[3], 1e-6);
                wrong += std::abs(static_cast<double>(image.plane("R")[i]) - truth[i].rgba[0]) > 0.01 ? 1U : 0U;
            }
            if (over && sort == "none")
                EXPECT_GT(wrong, 20U);
            else
                EXPECT_EQ(wrong, 0U) << sort << over;
        }
    }
}

TEST(SurfaceMethods, SlicesAndImagesAreAskedAtEveryFragment) {
    const fs::path folder = test_folder();
    (void)put_volume(folder / "v.nrrd", {8, 8, 8}, sampled({8, 8, 8}, [](const Vec3& p) { return p.x + 0.3 * p.y; }));
    const PreparedScene scene = prepare(scene_from(
        "image.resolution = [60, 60]\ncamera = { position = [5, 4, 16], target = [3.5, 3.5, 3.5] }\n"
        "[[surface]]\nname = \"cut\"\nslice = { volume = \"v.nrrd\", center = [3.5, 3.5, 3.5], u = [3.5, 0, 1], v = [0, 3.5, 0], "
        "transfer = [[0, 1, 0, 0, 0], [4, 0, 1, 0, 0.5], [9, 0, 0, 1, 0.9]] }\nopacity_law = \"oblique\"\n",
        folder));
    const Image image = draw(scene, "depth-peeling");
    const auto truth = trace_centers(scene);
    const auto inside = interior(truth, 60, 60);
    std::size_t compared = 0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
        if (!inside[i] || truth[i].hits == 0) continue;
        ++compared;
        EXPECT_NEAR(static_cast<double>(image.plane("A")[i]), truth[i].rgba[3], 1e-5);
        EXPECT_NEAR(static_cast<double>(image.plane("R")[i]), truth[i].rgba[0], 1e-5);
        EXPECT_NEAR(static_cast<double>(image.plane("B")[i]), truth[i].rgba[2], 1e-5);
    }
    EXPECT_GT(compared, 500U);
}

TEST(SurfaceMethods, LayersLimitWhatIsPeeledAndAreReported) {
    const PreparedScene scene = prepare(scene_from(kCards));
    RenderStats all, one;
    (void)draw(scene, "depth-peeling", "", &all);
    const Image first = draw(scene, "depth-peeling", "depth-peeling.layers = 1", &one);
    EXPECT_EQ(all.layers, 2U);
    EXPECT_EQ(one.layers, 1U);
    EXPECT_LT(one.hits, all.hits);
    for (const float a : first.plane("A")) EXPECT_TRUE(a == 0 || a == 0.25F || a == 0.5F);
}

TEST(SurfaceMethods, ACropIsThePartOfTheWhole) {
    const std::string toml = "image.resolution = [61, 47]\ncamera.position = [1, 0.7, 3]\n"
                             "[[surface]]\nname = \"ball\"\nimplicit = \"torus\"\nopacity = 0.4\n" + kCards.substr(kCards.find("[[surface]]"));
    const PixelRect crop{5, 9, 44, 40};
    // Triangles that depend on the view: as coarse in both.
    const Image whole = draw(prepare(scene_from(toml)), "depth-peeling", "tessellate.error_px = 1");
    const Image part = draw(prepare(scene_from(toml), crop), "depth-peeling", "tessellate.error_px = 1");
    for (int y = crop.y0; y < crop.y1; ++y)
        for (int x = crop.x0; x < crop.x1; ++x) {
            const auto i = static_cast<std::size_t>(y * 61 + x);
            const auto j = static_cast<std::size_t>((y - crop.y0) * (crop.x1 - crop.x0) + x - crop.x0);
            for (const char* plane : {"R", "A", "Z"}) ASSERT_EQ(whole.plane(plane)[i], part.plane(plane)[j]) << plane << x << ' ' << y;
        }
}

TEST(SurfaceMethods, VolumesAreRefusedByName) {
    const Scene scene = scene_from(kCards + "[[volume]]\nname = \"fog\"\nexpression = \"x\"\nbounds = [[0, 0, 0], [1, 1, 1]]\n"
                                            "resolution = [4, 4, 4]\ntransfer = [[0, 0, 0, 0, 0], [1, 1, 1, 1, 1]]\n");
    for (const char* name : {"z-test", "depth-peeling", "alpha-blend"}) {
        try {
            require_drawable(method_by_name(name), scene);
            ADD_FAILURE() << name;
        } catch (const Error& e) {
            EXPECT_NE(std::string(e.what()).find("\"fog\""), std::string::npos) << e.what();
        }
    }
}

TEST(SurfaceMethods, SettingsOutOfRangeAreOneLine) {
    const PreparedScene scene = prepare(scene_from(kCards));
    EXPECT_THROW((void)draw(scene, "depth-peeling", "depth-peeling.layers = -1"), Error);
    EXPECT_THROW((void)draw(scene, "alpha-blend", "alpha-blend.sort = \"depth\""), Error);
    EXPECT_THROW((void)draw(scene, "z-test", "tessellate.error_px = 0"), Error);
}

}  // namespace
}  // namespace pellucid
