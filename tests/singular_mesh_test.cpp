// Triangles of surfaces that cross themselves or have cuspidal edges.
#include <gtest/gtest.h>

#include <map>

#include "core/parallel.hpp"
#include "sample/surface_mesh.hpp"
#include "scene_testing.hpp"
#include "stage/singular_mesh.hpp"
#include "study/method_image.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

PreparedScene scene_of(const std::string& surface, const char* position, double height, int side = 96) {
    return prepare(scene_from(fmt::format("[image]\nresolution = [{0}, {0}]\n[camera]\nprojection = \"orthographic\"\nposition = {1}\n"
                                          "view_height = {2}\n[[surface]]\nname = \"s\"\nopacity = 0.5\nshading = \"flat\"\n{3}\n",
                                          side, position, height, surface)));
}
TriangleMesh mesh_of(const PreparedScene& scene) {
    return singular_mesh(surface_for_triangles(scene.objects[0]), scene.camera, {});
}
double area_of(const TriangleMesh& mesh) {
    double sum = 0;
    for (const auto& t : mesh.triangles) {
        const auto& p = mesh.positions;
        sum += 0.5 * length(cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]));
    }
    return sum;
}

const std::string kSteiner = "implicit = \"steiner\"", kHunt = "implicit = \"hunt\"";

TEST(SingularMesh, NoCrackOpensWhereTetrahedraOfDifferentSizesMeet) {
    for (const auto& [surface, height] : {std::pair{kSteiner, 2.6}, {kHunt, 9.0}}) {
        const TriangleMesh mesh = mesh_of(scene_of(surface, "[8, 6, 12]", height, 48));
        std::map<std::pair<std::uint32_t, std::uint32_t>, int> uses;
        for (const auto& t : mesh.triangles)
            for (std::size_t i = 0; i < 3; ++i) ++uses[std::minmax(t[i], t[(i + 1) % 3])];
        ASSERT_GT(uses.size(), 1000U);
        for (const auto& [edge, count] : uses) ASSERT_EQ(count, 2);
    }
}

TEST(SingularMesh, TwoSheetsNearerThanACellAreBothFound) {
    // |r² − 1| = 0.01: 5 thousandths on either side of the unit sphere, where a pixel is 52 thousandths.
    const PreparedScene scene =
        scene_of("expression = \"(x^2 + y^2 + z^2 - 1)^2 - 1e-4\"\nbounds = [[-1.2, -1.2, -1.2], [1.2, 1.2, 1.2]]", "[0, 0, 5]", 2.5, 48);
    const double both = 8 * M_PI;
    EXPECT_NEAR(area_of(mesh_of(scene)), both, 0.03 * both);
    EXPECT_LT(area_of(tessellate(scene.objects[0], 64).mesh), 0.3 * both);  // what a grid's signs see of it
}

TEST(SingularMesh, AnyNumberOfThreadsMakesTheSame) {
    const PreparedScene scene = scene_of(kSteiner, "[1.6, 2.2, 3.2]", 2.6);
    const TriangleMesh all = mesh_of(scene);
    set_thread_count(1);
    const TriangleMesh one = mesh_of(scene);
    set_thread_count(0);
    ASSERT_EQ(all.triangles, one.triangles);
    for (std::size_t i = 0; i < all.positions.size(); ++i) ASSERT_EQ(all.positions[i], one.positions[i]);
}

TEST(SingularMesh, NothingInItsBoundsIsNoMesh) {
    EXPECT_TRUE(mesh_of(scene_of("expression = \"x^2 + y^2 + z^2 + 1\"\nbounds = [[-1, -1, -1], [1, 1, 1]]", "[0, 0, 5]", 2)).triangles.empty());
    // A pole is no surface.
    EXPECT_EQ(area_of(mesh_of(scene_of("expression = \"1/(x - 0.01)\"\nbounds = [[-1, -1, -1], [1, 1, 1]]", "[0, 0, 5]", 2))), 0);
}

TEST(SingularMesh, PeelingMeetsEverySheetThatRaysMeet) {
    // Where a pixel has the same number of sheets all over, it is that of its centre.
    for (const auto& [surface, position, height] :
         {std::tuple{kSteiner, "[1.6, 2.2, 3.2]", 2.6}, {kHunt, "[8, 6, 12]", 9.0}, {std::string("implicit = \"boy\""), "[3, 2.2, 4]", 3.4}}) {
        const PreparedScene scene = scene_of(surface, position, height, 64);
        RenderStats stats;
        const Image truth = method_image(scene, {"reference", {"reference.samples=16"}}, Seed{1}, stats);
        const Image peeled = method_image(scene, {"depth-peeling", {}}, Seed{1}, stats);
        int whole = 0, wrong = 0;
        for (std::size_t i = 0; i < truth.pixel_count(); ++i) {
            const double sheets = -std::log2(1 - static_cast<double>(truth.plane("A")[i]));
            if (sheets < 0.5 || std::abs(sheets - std::round(sheets)) > 1e-4) continue;
            ++whole;
            const double found = -std::log2(1 - static_cast<double>(peeled.plane("A")[i]));
            wrong += std::abs(found - sheets) > 0.01 ? 1 : 0;
        }
        EXPECT_GT(whole, 500) << surface;
        EXPECT_LE(wrong, whole / 200) << surface << " " << whole;
    }
}

}  // namespace
}  // namespace pellucid
