#include "scene/scene_file.hpp"

#include <cmath>
#include <fstream>
#include <string>

#include <gtest/gtest.h>

namespace pellucid {
namespace {

Scene parse(const std::string& toml) {
    const Config config = Config::parse(toml, "s.toml", "/data");
    Scene scene = scene_from_config(config);
    config.finish();
    return scene;
}

const std::string kHead = "image.resolution = [8, 8]\ncamera.position = [0, 0, 4]\n";       // lines 1, 2
const std::string kSurface = kHead + "[[surface]]\nname = \"s\"\nimplicit = \"sphere\"\n";  // 3, 4, 5
const std::string kVolume = kHead +
                            "[[volume]]\nname = \"v\"\nfile = \"v.nrrd\"\n"     // 3, 4, 5
                            "transfer = [[0, 0, 0, 0, 0], [1, 1, 1, 1, 1]]\n";  // 6

TEST(SceneFile, ReadsEveryKey) {
    const Scene scene = parse(R"(
[image]
resolution = [640, 480]
background = [0.1, 0.2, 0.3]
[camera]
projection = "orthographic"
position = [1, 2, 3]
target = [1, 2, 0]
up = [1, 1, 0]
view_height = 2.5
near = 0.5
far = 20
[[light]]
direction = [0, 3, 4]
intensity = 0.5
[[light]]
headlight = true
[[surface]]
name = "ring"
implicit = "torus"
parameters = { major = 1.0, minor = 0.4 }
bounds = [[-2, -2, -2], [2, 2, 3]]
color = [0.1, 0.5, 1]
opacity = 0.25
opacity_law = "oblique"
shading = { ambient = 0.1, diffuse = 0.7, specular = 0.5, shininess = 8 }
thickness = 0.125
matrix = [0,-1,0,5, 1,0,0,6, 0,0,2,7, 0,0,0,1]
clip = [{ normal = [2, 0, 0], offset = 0.1 }, { normal = [0, 1, 0] }]
contours = [{ field = "y", spacing = 0.2, width_px = 3, color = [1, 0, 0] }]
[[surface]]
name = "blob"
expression = "x^2 + y^2 + z^2 - 1"
bounds = [[-1, -1, -1], [1, 1, 1]]
shading = "flat"
thickness = "auto"
[[surface]]
name = "skull"
isosurface = { volume = "head.nii.gz", isovalue = 90, interpolation = "catmull-rom" }
[[surface]]
mesh = "/abs/bunny.ply"
[[surface]]
name = "scan"
points = "scan.ply"
[[surface]]
name = "card"
rectangle = { center = [0, 0, 1], u = [1, 0, 0], v = [0, 2, 0], image = "slice.png" }
[[surface]]
name = "cut"
slice = { volume = "head.nii.gz", center = [1, 1, 1], u = [0, 1, 0], v = [0, 0, 1], transfer = [[0, 0, 0, 0, 0.5]] }
[[volume]]
name = "head"
file = "head.nii.gz"
transfer = [[0, 0, 0, 0, 0], [90, 1, 0.8, 0.6, 0.05], [90, 0, 0, 0, 1], [255, 1, 1, 1, 0.4]]
opacity_step = 2.0
interpolation = "nearest"
shading = { ambient = 0.5 }
translate = [1, 2, 3]
clip = [{ normal = [0, 0, 1], offset = -1 }]
[[volume]]
expression = "x"
bounds = [[0, 0, 0], [1, 2, 3]]
resolution = [2, 3, 4]
transfer = [[0, 0, 0, 0, 0]]
)");
    EXPECT_EQ(scene.source, "s.toml");
    EXPECT_EQ(scene.image.width, 640);
    EXPECT_EQ(scene.image.height, 480);
    EXPECT_EQ(scene.image.background, Vec3(0.1, 0.2, 0.3));
    EXPECT_EQ(scene.camera.projection, Projection::orthographic);
    EXPECT_EQ(scene.camera.position, Vec3(1, 2, 3));
    EXPECT_EQ(scene.camera.target, Vec3(1, 2, 0));
    EXPECT_EQ(scene.camera.up, Vec3(1, 1, 0));
    EXPECT_EQ(scene.camera.view_height, 2.5);
    EXPECT_EQ(scene.camera.near, 0.5);
    EXPECT_EQ(scene.camera.far, 20.0);
    ASSERT_EQ(scene.lights.size(), 2U);
    EXPECT_FALSE(scene.lights[0].headlight);
    EXPECT_NEAR(length(scene.lights[0].direction - Vec3(0, 0.6, 0.8)), 0, 1e-15);
    EXPECT_EQ(scene.lights[0].intensity, 0.5);
    EXPECT_TRUE(scene.lights[1].headlight);
    EXPECT_EQ(scene.lights[1].intensity, 1.0);

    ASSERT_EQ(scene.surfaces.size(), 7U);
    const Surface& ring = scene.surfaces[0];
    EXPECT_EQ(ring.name, "ring");
    EXPECT_EQ(std::get<ImplicitShape>(ring.shape).name, "torus");
    EXPECT_EQ(std::get<ImplicitShape>(ring.shape).parameters,
              (std::map<std::string, double>{{"major", 1.0}, {"minor", 0.4}}));
    EXPECT_EQ(ring.bounds->lo, Vec3(-2));
    EXPECT_EQ(ring.bounds->hi, Vec3(2, 2, 3));
    EXPECT_EQ(ring.color, Vec3(0.1, 0.5, 1));
    EXPECT_EQ(ring.opacity, 0.25);
    EXPECT_EQ(ring.opacity_law, OpacityLaw::oblique);
    EXPECT_EQ(ring.shading.ambient, 0.1);
    EXPECT_EQ(ring.shading.diffuse, 0.7);
    EXPECT_EQ(ring.shading.specular, 0.5);
    EXPECT_EQ(ring.shading.shininess, 8);
    EXPECT_FALSE(ring.shading.flat);
    EXPECT_EQ(ring.thickness, 0.125);
    EXPECT_EQ(ring.to_world.point({1, 2, 3}), Vec3(-2 + 5, 1 + 6, 6 + 7));
    ASSERT_EQ(ring.clip.size(), 2U);
    EXPECT_EQ(ring.clip[0].normal, Vec3(2, 0, 0));
    EXPECT_EQ(ring.clip[0].offset, 0.1);
    EXPECT_EQ(ring.clip[1].offset, 0.0);
    ASSERT_EQ(ring.contours.size(), 1U);
    EXPECT_EQ(ring.contours[0].field, "y");
    EXPECT_EQ(ring.contours[0].spacing, 0.2);
    EXPECT_EQ(ring.contours[0].width_px, 3);
    EXPECT_EQ(ring.contours[0].color, Vec3(1, 0, 0));
    EXPECT_EQ(std::get<ExpressionShape>(scene.surfaces[1].shape).text, "x^2 + y^2 + z^2 - 1");
    EXPECT_TRUE(scene.surfaces[1].shading.flat);
    EXPECT_EQ(scene.surfaces[1].thickness, std::nullopt);
    const auto& skull = std::get<IsosurfaceShape>(scene.surfaces[2].shape);
    EXPECT_EQ(skull.volume, "/data/head.nii.gz");
    EXPECT_EQ(skull.isovalue, 90);
    EXPECT_EQ(skull.interpolation, Interpolation::catmull_rom);
    EXPECT_EQ(std::get<MeshShape>(scene.surfaces[3].shape).file, "/abs/bunny.ply");
    EXPECT_EQ(scene.surfaces[3].name, "surface 3");
    EXPECT_EQ(std::get<PointsShape>(scene.surfaces[4].shape).file, "/data/scan.ply");
    const auto& card = std::get<RectangleShape>(scene.surfaces[5].shape);
    EXPECT_EQ(card.center, Vec3(0, 0, 1));
    EXPECT_EQ(card.u, Vec3(1, 0, 0));
    EXPECT_EQ(card.v, Vec3(0, 2, 0));
    EXPECT_EQ(card.image, "/data/slice.png");
    const auto& cut = std::get<SliceShape>(scene.surfaces[6].shape);
    EXPECT_EQ(cut.volume, "/data/head.nii.gz");
    EXPECT_EQ(cut.v, Vec3(0, 0, 1));
    EXPECT_EQ(cut.transfer, (std::vector<TransferPoint>{{0, 0, 0, 0, 0.5}}));

    ASSERT_EQ(scene.volumes.size(), 2U);
    const Volume& head = scene.volumes[0];
    EXPECT_EQ(std::get<std::filesystem::path>(head.source), "/data/head.nii.gz");
    ASSERT_EQ(head.transfer.size(), 4U);
    EXPECT_EQ(head.transfer[1], (TransferPoint{90, 1, 0.8, 0.6, 0.05}));
    EXPECT_EQ(head.opacity_step, 2.0);
    EXPECT_EQ(head.interpolation, Interpolation::nearest);
    EXPECT_FALSE(head.shading.flat);
    EXPECT_EQ(head.shading.ambient, 0.5);
    EXPECT_EQ(head.shading.diffuse, 0.8);
    EXPECT_EQ(head.to_world.point(Vec3(0)), Vec3(1, 2, 3));
    EXPECT_EQ(head.clip.at(0).offset, -1);
    const auto& formula = std::get<ExpressionVolume>(scene.volumes[1].source);
    EXPECT_EQ(formula.text, "x");
    EXPECT_EQ(formula.bounds.hi, Vec3(1, 2, 3));
    EXPECT_EQ(formula.resolution, (std::array{2, 3, 4}));
    EXPECT_EQ(scene.volumes[1].name, "volume 1");
    EXPECT_EQ(scene.volumes[1].opacity_step, std::nullopt);
    EXPECT_TRUE(scene.volumes[1].shading.flat);
    EXPECT_EQ(scene.volumes[1].interpolation, Interpolation::trilinear);
}

TEST(SceneFile, DefaultsAreThoseOfTheFormat) {
    const Scene scene = parse(kSurface);
    EXPECT_EQ(scene.image.background, Vec3(0));
    EXPECT_EQ(scene.camera.projection, Projection::perspective);
    EXPECT_EQ(scene.camera.target, Vec3(0));
    EXPECT_EQ(scene.camera.up, Vec3(0, 1, 0));
    EXPECT_EQ(scene.camera.fov_degrees, 30);
    EXPECT_EQ(scene.camera.near, std::nullopt);
    EXPECT_EQ(scene.camera.far, std::nullopt);
    ASSERT_EQ(scene.lights.size(), 1U);
    EXPECT_TRUE(scene.lights[0].headlight);
    const Surface& s = scene.surfaces.at(0);
    EXPECT_EQ(s.bounds, std::nullopt);
    EXPECT_EQ(s.color, Vec3(0.8));
    EXPECT_EQ(s.opacity, 1);
    EXPECT_EQ(s.opacity_law, OpacityLaw::constant);
    EXPECT_FALSE(s.shading.flat);
    EXPECT_EQ(s.shading.ambient, 0.2);
    EXPECT_EQ(s.shading.diffuse, 0.8);
    EXPECT_EQ(s.shading.specular, 0);
    EXPECT_EQ(s.shading.shininess, 32);
    EXPECT_EQ(s.thickness, std::nullopt);
    EXPECT_EQ(s.to_world.linear, Mat3(1.0));
    EXPECT_EQ(s.to_world.offset, Vec3(0));
    EXPECT_TRUE(s.clip.empty() && s.contours.empty());
}

TEST(SceneFile, PartialShadingTakesTheOtherDefaults) {
    const Shading shading = parse(kSurface + "shading = { specular = 0.3 }").surfaces[0].shading;
    EXPECT_EQ(shading.specular, 0.3);
    EXPECT_EQ(shading.ambient, 0.2);
    EXPECT_EQ(shading.diffuse, 0.8);
    EXPECT_EQ(shading.shininess, 32);
}

TEST(SceneFile, AnEmptySceneIsAScene) {
    const Scene scene = parse(kHead);
    EXPECT_TRUE(scene.surfaces.empty() && scene.volumes.empty());
    EXPECT_EQ(scene.lights.size(), 1U);
}

TEST(SceneFile, ScaleRotateTranslateApplyInThisOrder) {
    const auto moved = [](const std::string& keys, const Vec3& p) {
        return parse(kSurface + keys).surfaces[0].to_world.point(p);
    };
    EXPECT_EQ(moved("scale = 2", {1, 2, 3}), Vec3(2, 4, 6));
    EXPECT_EQ(moved("scale = [1, 2, -3]", {1, 1, 1}), Vec3(1, 2, -3));
    EXPECT_EQ(moved("translate = [1, 2, 3]", {1, 1, 1}), Vec3(2, 3, 4));
    // Right-handed quarter turns, exact: x -> y about z, y -> z about x, z -> x about y.
    EXPECT_EQ(moved("rotate_degrees = [0, 0, 90]", {1, 0, 0}), Vec3(0, 1, 0));
    EXPECT_EQ(moved("rotate_degrees = [90, 0, 0]", {0, 1, 0}), Vec3(0, 0, 1));
    EXPECT_EQ(moved("rotate_degrees = [0, 90, 0]", {0, 0, 1}), Vec3(1, 0, 0));
    EXPECT_EQ(moved("rotate_degrees = [0, 0, -630]", {1, 0, 0}), Vec3(0, 1, 0));
    // Rx first: y -> z -> (Ry) x -> (Rz) y.
    EXPECT_EQ(moved("rotate_degrees = [90, 90, 90]", {0, 1, 0}), Vec3(0, 1, 0));
    // Scale before the rotation, translation last.
    EXPECT_EQ(moved("scale = [2, 1, 1]\nrotate_degrees = [0, 0, 90]\ntranslate = [10, 0, 0]", {1, 0, 0}),
              Vec3(10, 2, 0));
    const double c = std::sqrt(3.0) / 2;
    EXPECT_NEAR(length(moved("rotate_degrees = [0, 0, 30]", {1, 0, 0}) - Vec3(c, 0.5, 0)), 0, 1e-15);
}

TEST(SceneFile, MatrixIsRowMajorAndMayMirrorOrBeSmall) {
    const Affine map = parse(kSurface + "matrix = [1,2,3,4, 0,1,5,6, 0,0,1,7, 0,0,0,1]").surfaces[0].to_world;
    EXPECT_EQ(map.point({1, 1, 1}), Vec3(1 + 2 + 3 + 4, 1 + 5 + 6, 1 + 7));
    EXPECT_EQ(parse(kSurface + "scale = -1e-9").surfaces[0].to_world.linear[0].x, -1e-9);
}

TEST(SceneFile, OverridesReachTheScene) {
    const std::string file = testing::TempDir() + "scene_file_test_overrides.toml";
    std::ofstream(file) << kSurface;
    const std::vector<std::string> overrides{"camera.position=[0,0,3]", "image.resolution=[64,32]",
                                             "surface.s.opacity=0.5", "surface.0.color=[0,0,1]",
                                             "light=[{direction=[0,1,0]}]"};
    const Scene scene = load_scene(file, overrides);
    EXPECT_EQ(scene.source, file);
    EXPECT_EQ(scene.camera.position, Vec3(0, 0, 3));
    EXPECT_EQ(scene.image.width, 64);
    EXPECT_EQ(scene.image.height, 32);
    EXPECT_EQ(scene.surfaces[0].opacity, 0.5);
    EXPECT_EQ(scene.surfaces[0].color, Vec3(0, 0, 1));
    EXPECT_EQ(scene.lights.at(0).direction, Vec3(0, 1, 0));
    for (const std::string bad : {"camera.positon=[0,0,3]", "particles.repeats=5", "surface.s.opacity=5"})
        try {
            (void)load_scene(file, std::vector{bad});
            ADD_FAILURE() << bad << " was taken";
        } catch (const Error& e) {
            EXPECT_EQ(std::string(e.what()).rfind("--set " + bad.substr(0, bad.find('=')), 0), 0U)
                << e.what();
        }
}

TEST(SceneFile, PathsAreTakenFromBesideTheScene) {
    const std::string file = testing::TempDir() + "scene_file_test_paths.toml";
    std::ofstream(file) << kHead << "[[surface]]\nmesh = \"sub/a.ply\"\n";
    EXPECT_EQ(std::get<MeshShape>(load_scene(file).surfaces[0].shape).file,
              std::filesystem::path(testing::TempDir()) / "sub/a.ply");
}

TEST(SceneFile, KnowsOverridesOfItsOwn) {
    EXPECT_TRUE(is_scene_override("camera.position=[0,0,1]"));
    EXPECT_TRUE(is_scene_override("light=[]"));
    EXPECT_FALSE(is_scene_override("particles.repeats=5"));
    EXPECT_FALSE(is_scene_override("cameras.x=5"));
    EXPECT_FALSE(is_scene_override(""));
}

TEST(SceneFile, ExampleScenesLoad) {
    int count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(PELLUCID_SOURCE_DIR "/scenes")) {
        if (entry.path().extension() != ".toml") continue;
        const Scene scene = load_scene(entry.path());
        EXPECT_FALSE(scene.surfaces.empty() && scene.volumes.empty()) << entry.path();
        ++count;
    }
    EXPECT_GE(count, 3);
}

// ---- what is refused

struct Bad {
    std::string toml;
    std::string line;   // "s.toml:6: " or "s.toml: "
    std::string words;  // in the message
};

void expect_refused(const Bad& bad) {
    try {
        (void)parse(bad.toml);
        ADD_FAILURE() << "was taken: " << bad.toml;
    } catch (const Error& e) {
        const std::string message = e.what();
        EXPECT_EQ(e.kind(), Failure::input);
        EXPECT_EQ(message.rfind(bad.line, 0), 0U) << message << "\nexpected at " << bad.line << "\n"
                                                  << bad.toml;
        EXPECT_NE(message.find(bad.words), std::string::npos) << message << "\nexpected: " << bad.words;
        EXPECT_EQ(message.find('\n'), std::string::npos) << message;
    }
}

TEST(SceneFile, BadImagesAreRefused) {
    const std::string camera = "\ncamera.position = [0, 0, 4]\n";
    const std::vector<Bad> cases{
        {"camera.position = [0, 0, 4]", "s.toml: ", "image is missing"},
        {"[image]" + camera, "s.toml:1: ", "image.resolution is missing"},
        {"image = 3" + camera, "s.toml:1: ", "image = 3 is an integer, expected a table"},
        {"image.resolution = [8]" + camera, "s.toml:1: ", "has 1 element, expected 2"},
        {"image.resolution = [8, 8, 8]" + camera, "s.toml:1: ", "has 3 elements"},
        {"image.resolution = 8" + camera, "s.toml:1: ", "expected a list"},
        {"image.resolution = [0, 8]" + camera, "s.toml:1: ", "= 0, expected [1, 65536]"},
        {"image.resolution = [8, -8]" + camera, "s.toml:1: ", "= -8, expected [1, 65536]"},
        {"image.resolution = [8, 8.5]" + camera, "s.toml:1: ", "8.5 is a number, expected an integer"},
        {"image.resolution = [4000000, 4000000]" + camera, "s.toml:1: ", "= 4000000, expected [1, 65536]"},
        {"image.resolution = [65536, 65536]" + camera, "s.toml:1: ", "at most 2147483648 pixels"},
        {"image.resolution = [8, 8]\nimage.background = [0, 0, 2]" + camera,
         "s.toml:2: ", "background = 2, expected [0, 1]"},
        {"image.resolution = [8, 8]\nimage.backgrund = [0, 0, 0]" + camera,
         "s.toml:2: ", "did you mean \"background\"?"},
        {kHead + "colour = 3", "s.toml:3: ", "unknown key \"colour\""},
    };
    for (const Bad& bad : cases) expect_refused(bad);
}

TEST(SceneFile, BadCamerasAndLightsAreRefused) {
    const std::string image = "image.resolution = [8, 8]\n";
    const std::string position = image + "[camera]\nposition = [0, 0, 4]\n";  // lines 2, 3
    const std::vector<Bad> cases{
        {image, "s.toml: ", "camera is missing"},
        {image + "[camera]\ntarget = [0, 0, 0]", "s.toml:2: ", "camera.position is missing"},
        {image + "[camera]\nposition = [0, 0, 0]", "s.toml:3: ", "camera.position is the target"},
        {image + "[camera]\nposition = [0, nan, 0]", "s.toml:3: ", "= nan"},
        {image + "[camera]\nposition = [0, inf, 0]", "s.toml:3: ", "= inf, expected a finite number"},
        {image + "[camera]\nposition = [1e308, 1e308, 0]\ntarget = [-1e308, 0, 0]",
         "s.toml:3: ", "finite way apart"},
        {image + "[camera]\nposition = [0, 4, 0]", "s.toml:2: ", "camera.up is parallel"},
        {position + "up = [0, 0, -3]", "s.toml:4: ", "camera.up is parallel"},
        {position + "up = [0, 0, 0]", "s.toml:4: ", "camera.up has no length"},
        {position + "fov_degrees = 0", "s.toml:4: ", "fov_degrees = 0, expected (0, 180)"},
        {position + "fov_degrees = 180", "s.toml:4: ", "expected (0, 180)"},
        {position + "view_height = 0", "s.toml:4: ", "view_height = 0, expected > 0"},
        {position + "near = -1", "s.toml:4: ", "near = -1, expected >= 0"},
        {position + "far = 0", "s.toml:4: ", "far = 0, expected > 0"},
        {position + "near = 2\nfar = 1", "s.toml:5: ", "far = 1, expected > near = 2"},
        {position + "near = 2\nfar = 2", "s.toml:5: ", "expected > near = 2"},
        {position + "projection = \"fisheye\"", "s.toml:4: ", "expected \"perspective\" or \"orthographic\""},
        {position + "fov = 30", "s.toml:4: ", "unknown key \"fov\""},
        {kHead + "[[light]]\nintensity = 1", "s.toml:3: ", "light 0 has no direction"},
        {kHead + "[[light]]\nheadlight = false", "s.toml:3: ", "light 0 has no direction"},
        {kHead + "[[light]]\nheadlight = true\ndirection = [0, 0, 1]", "s.toml:3: ", "expected one of them"},
        {kHead + "[[light]]\ndirection = [0, 0, 0]", "s.toml:4: ", "direction has no length"},
        {kHead + "[[light]]\ndirection = [0, 0, 1]\nintensity = -1",
         "s.toml:5: ", "intensity = -1, expected >= 0"},
        {kHead + "[light]\ndirection = [0, 0, 1]", "s.toml:3: ", "expected a list of tables"},
    };
    for (const Bad& bad : cases) expect_refused(bad);
}

TEST(SceneFile, BadSurfacesAreRefused) {
    const std::string open = kHead + "[[surface]]\nname = \"s\"\n";  // the next line is 5
    const std::vector<Bad> cases{
        {open, "s.toml:3: ", "surface \"s\" has no shape, expected exactly one of implicit, expression"},
        {kSurface + "mesh = \"a.ply\"", "s.toml:3: ", "has implicit and mesh, expected exactly one"},
        {open + "implicit = \"\"", "s.toml:5: ", "implicit is empty"},
        {open + "implicit = 3", "s.toml:5: ", "expected a string"},
        {kSurface + "parameters = { radius = \"big\" }",
         "s.toml:6: ", "parameters.radius = \"big\" is a string"},
        {kSurface + "parameters = { radius = nan }", "s.toml:6: ", "parameters.radius = nan"},
        {open + "mesh = \"a.ply\"\nparameters = { a = 1 }",
         "s.toml:6: ", "parameters belong to implicit, not to mesh"},
        {open + "mesh = \"\"", "s.toml:5: ", "expected the path of a file"},
        {open + "expression = \"x\"", "s.toml:3: ", "bounds are missing"},
        {open + "expression = \"\"\nbounds = [[0, 0, 0], [1, 1, 1]]", "s.toml:5: ", "expression is empty"},
        {kSurface + "bounds = [[0, 0, 0], [1, -1, 1]]", "s.toml:6: ", "bounds are inside out: y = 0 … -1"},
        {kSurface + "bounds = [[0, 0, 0], [1, 1, 0]]", "s.toml:6: ", "inside out: z"},
        {kSurface + "bounds = [[0, 0, nan], [1, 1, 1]]", "s.toml:6: ", "bounds = nan"},
        {kSurface + "bounds = [[0, 0, 0], [1, 1, inf]]", "s.toml:6: ", "bounds = inf"},
        {kSurface + "bounds = [0, 0, 0, 1, 1, 1]", "s.toml:6: ", "expected 2"},
        {kSurface + "bounds = [[0, 0], [1, 1]]", "s.toml:6: ", "rows of 3 numbers"},
        {open + "isosurface = { isovalue = 1 }", "s.toml:5: ", "isosurface.volume is missing"},
        {open + "isosurface = { volume = \"a.nrrd\" }", "s.toml:5: ", "isosurface.isovalue is missing"},
        {open + "isosurface = { volume = \"a.nrrd\", isovalue = 1, interpolation = \"nearest\" }",
         "s.toml:5: ", "expected \"trilinear\" or \"catmull-rom\""},
        {open + "isosurface = { volume = \"a.nrrd\", isovalue = 1, value = 2 }",
         "s.toml:5: ", "unknown key \"value\""},
        {open + "rectangle = { u = [0, 0, 0] }", "s.toml:5: ", "rectangle.u has no length"},
        {open + "rectangle = { v = [0, 0, 0] }", "s.toml:5: ", "rectangle.v has no length"},
        {open + "rectangle = { u = [1, 1, 0], v = [-2, -2, 0] }",
         "s.toml:5: ", "rectangle.v is parallel to u"},
        {open + "rectangle = { u = [1e200, 0, 0] }", "s.toml:5: ", "rectangle.u"},
        {open + "slice = { volume = \"a.nrrd\" }", "s.toml:5: ", "slice.transfer is missing"},
        {open + "slice = { volume = \"a.nrrd\", transfer = [[1, 0, 0, 0, 0], [0, 1, 1, 1, 1]] }",
         "s.toml:5: ", "values fall from 1 to 0"},
        {kSurface + "color = [1, 1]", "s.toml:6: ", "color has 2 elements, expected 3"},
        {kSurface + "color = [-0.1, 0, 0]", "s.toml:6: ", "color = -0.1, expected [0, 1]"},
        {kSurface + "color = [0, 0, 1.1]", "s.toml:6: ", "color = 1.1, expected [0, 1]"},
        {kSurface + "opacity = 1.5", "s.toml:6: ", "surface \"s\": opacity = 1.5, expected [0, 1]"},
        {kSurface + "opacity = -1e-9", "s.toml:6: ", "expected [0, 1]"},
        {kSurface + "opacity = nan", "s.toml:6: ", "opacity = nan"},
        {kSurface + "opacity = \"half\"", "s.toml:6: ", "is a string, expected a number"},
        {kSurface + "opacity_law = \"slanted\"", "s.toml:6: ", "expected \"constant\" or \"oblique\""},
        {kSurface + "shading = \"phong\"", "s.toml:6: ", "shading = \"phong\", expected \"flat\""},
        {kSurface + "shading = 3", "s.toml:6: ", "expected a table"},
        {kSurface + "shading = { ambient = -1 }", "s.toml:6: ", "shading.ambient = -1, expected >= 0"},
        {kSurface + "shading = { shininess = 0 }", "s.toml:6: ", "shading.shininess = 0, expected > 0"},
        {kSurface + "shading = { ambeint = 1 }", "s.toml:6: ", "did you mean \"ambient\"?"},
        {kSurface + "thickness = \"thin\"", "s.toml:6: ", "thickness = \"thin\", expected \"auto\""},
        {kSurface + "thickness = -1", "s.toml:6: ", "thickness = -1, expected >= 0"},
        {kSurface + "matrix = [1, 0, 0]", "s.toml:6: ", "matrix has 3 elements, expected 16"},
        {kSurface + "matrix = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,1,1]",
         "s.toml:6: ", "last row 0 0 1 1, expected 0 0 0 1"},
        {kSurface + "matrix = [1,0,0,0, 1,0,0,0, 0,0,1,0, 0,0,0,1]", "s.toml:6: ", "matrix is singular"},
        {kSurface + "matrix = [1,2,3,0, 4,5,6,0, 7,8,9,0, 0,0,0,1]", "s.toml:6: ", "matrix is singular"},
        {kSurface + "matrix = [1,0,0,0, 0,1,0,0, 0,0,nan,0, 0,0,0,1]", "s.toml:6: ", "matrix = nan"},
        {kSurface + "matrix = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]\nscale = 2",
         "s.toml:7: ", "scale stands beside matrix"},
        {kSurface + "matrix = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]\ntranslate = [0,0,0]",
         "s.toml:7: ", "beside matrix"},
        {kSurface + "scale = 0", "s.toml:6: ", "singular"},
        {kSurface + "scale = [1, 0, 1]", "s.toml:6: ", "singular"},
        {kSurface + "scale = [1, 1]", "s.toml:6: ", "has 2 elements, expected 3"},
        {kSurface + "rotate_degrees = 90", "s.toml:6: ", "expected three numbers"},
        {kSurface + "translate = [0, 0, inf]", "s.toml:6: ", "translate = inf"},
        {kSurface + "clip = [{ normal = [0, 0, 0] }]", "s.toml:6: ", "clip[0].normal has no length"},
        {kSurface + "clip = [{ offset = 1 }]", "s.toml:6: ", "clip[0].normal is missing"},
        {kSurface + "clip = { normal = [1, 0, 0] }", "s.toml:6: ", "expected a list of tables"},
        {kSurface + "contours = [{ field = \"y\", spacing = 0 }]",
         "s.toml:6: ", "contours[0].spacing = 0, expected > 0"},
        {kSurface + "contours = [{ spacing = 1 }]", "s.toml:6: ", "contours[0].field is missing"},
        {kSurface + "opactiy = 1", "s.toml:6: ", "unknown key \"opactiy\", did you mean \"opacity\"?"},
        {kSurface + "[[surface]]\nname = \"s\"\nimplicit = \"sphere\"",
         "s.toml:7: ", "name = \"s\" is taken"},
        {kHead + "[[surface]]\nname = \"\"\nimplicit = \"sphere\"", "s.toml:4: ", "name is empty"},
        {kHead + "surface = 5", "s.toml:3: ", "expected a list of tables"},
    };
    for (const Bad& bad : cases) expect_refused(bad);
}

TEST(SceneFile, BadVolumesAreRefused) {
    const std::string open = kHead + "[[volume]]\nname = \"v\"\n";  // the next line is 5
    const std::string formula = open +
                                "expression = \"x\"\nbounds = [[0, 0, 0], [1, 1, 1]]\n"  // 5, 6
                                "transfer = [[0, 0, 0, 0, 0]]\n";                        // 7
    const std::vector<Bad> cases{
        {open + "transfer = [[0, 0, 0, 0, 0]]", "s.toml:3: ", "volume \"v\" has neither file nor expression"},
        {kVolume + "expression = \"x\"", "s.toml:3: ", "has file and expression"},
        {kVolume + "bounds = [[0, 0, 0], [1, 1, 1]]", "s.toml:7: ", "bounds belongs to expression"},
        {open + "file = \"v.nrrd\"", "s.toml:3: ", "transfer is missing"},
        {open + "file = \"v.nrrd\"\ntransfer = []", "s.toml:6: ", "has 0 elements, expected at least 1"},
        {open + "file = \"v.nrrd\"\ntransfer = [[0, 0, 0, 0]]", "s.toml:6: ", "rows of 5 numbers"},
        {open + "file = \"v.nrrd\"\ntransfer = [0, 0, 0, 0, 0]", "s.toml:6: ", "rows of 5 numbers"},
        {open + "file = \"v.nrrd\"\ntransfer = [[5, 0, 0, 0, 0], [4, 0, 0, 0, 0]]",
         "s.toml:6: ", "fall from 5 to 4"},
        {open + "file = \"v.nrrd\"\ntransfer = [[5, 0, 0, 0, 1.5]]",
         "s.toml:6: ", "at value 5 has opacity = 1.5"},
        {open + "file = \"v.nrrd\"\ntransfer = [[5, 0, -1, 0, 0]]",
         "s.toml:6: ", "green = -1, expected [0, 1]"},
        {open + "file = \"v.nrrd\"\ntransfer = [[nan, 0, 0, 0, 0]]", "s.toml:6: ", "transfer = nan"},
        {kVolume + "opacity_step = 0", "s.toml:7: ", "opacity_step = 0, expected > 0"},
        {kVolume + "opacity_step = \"cell\"", "s.toml:7: ", "expected \"voxel\""},
        {kVolume + "interpolation = \"cubic\"",
         "s.toml:7: ", "\"trilinear\", \"catmull-rom\" or \"nearest\""},
        {kVolume + "opacity = 1", "s.toml:7: ", "unknown key \"opacity\""},
        {kVolume + "scale = 0", "s.toml:7: ", "singular"},
        {formula, "s.toml:3: ", "resolution is missing"},
        {formula + "resolution = [1, 2, 2]", "s.toml:8: ", "resolution = 1, expected [2, 65536]"},
        {formula + "resolution = [8, 8]", "s.toml:8: ", "has 2 elements, expected 3"},
        {formula + "resolution = [65536, 65536, 65536]", "s.toml:8: ", "at most 2147483648 voxels"},
        {open + "expression = \"x\"\nresolution = 8\ntransfer = [[0, 0, 0, 0, 0]]",
         "s.toml:3: ", "bounds are missing"},
        {kVolume + "[[surface]]\nname = \"v\"\nimplicit = \"sphere\"", "s.toml:4: ", "name = \"v\" is taken"},
    };
    for (const Bad& bad : cases) expect_refused(bad);
}

}  // namespace
}  // namespace pellucid
