// Methods by name, and what they refuse.
#include "render/method.hpp"

#include "core/error.hpp"
#include "scene/geometry.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

TEST(Methods, NamesAreFoundAndOthersListed) {
    EXPECT_EQ(method_by_name("particles").name, "particles");
    EXPECT_EQ(method_by_name("reference").name, "reference");
    try {
        (void)method_by_name("partikels");
        FAIL();
    } catch (const Error& e) {
        EXPECT_EQ(e.kind(), Failure::input);
        for (const Method& method : methods())
            EXPECT_NE(std::string(e.what()).find(method.name), std::string::npos) << method.name;
    }
}

TEST(Methods, WhatCannotBeDrawnIsRefusedByName) {
    const std::string head = "image.resolution = [8, 8]\ncamera.position = [0, 0, 4]\n[[surface]]\nname = \"fine\"\nimplicit = \"sphere\"\n";
    for (const std::string& odd :
         {std::string("[[surface]]\nname = \"odd\"\nimplicit = \"sphere\"\ncontours = [{ field = \"y\", spacing = 1 }]")})
        for (const Method& method : methods()) {
            const Scene scene = scene_from(head + odd);
            try {
                require_drawable(method, scene);
                ADD_FAILURE() << odd;
            } catch (const Error& e) {
                EXPECT_EQ(e.kind(), Failure::input);
                EXPECT_NE(std::string(e.what()).find("\"odd\""), std::string::npos) << e.what();
                EXPECT_NE(std::string(e.what()).find(method.name), std::string::npos) << e.what();
            }
            EXPECT_NO_THROW(require_drawable(method, scene_from(head)));
        }
}

/// The key of a scene's surface. A shape that is new has no overload here, and does not compile.
struct KeyOfShape {
    std::string operator()(const ImplicitShape&) const { return "implicit"; }
    std::string operator()(const ExpressionShape&) const { return "expression"; }
    std::string operator()(const IsosurfaceShape&) const { return "isosurface"; }
    std::string operator()(const MeshShape&) const { return "mesh"; }
    std::string operator()(const PointsShape&) const { return "points"; }
    std::string operator()(const RectangleShape&) const { return "rectangle"; }
    std::string operator()(const SliceShape&) const { return "slice"; }
};

template <std::size_t... kIndex>
std::vector<Shape> one_of_each(std::index_sequence<kIndex...>) {
    return {Shape(std::variant_alternative_t<kIndex, Shape>{})...};
}

TEST(Methods, SummariesNameEveryShapeThatHasAGeometry) {
    for (const Shape& shape : one_of_each(std::make_index_sequence<std::variant_size_v<Shape>>{})) {
        if (!has_geometry(shape)) continue;
        const std::string key = std::visit(KeyOfShape{}, shape);
        for (const std::string_view name : {"particles", "reference", "slabs"})
            EXPECT_NE(method_by_name(name).summary.find(key), std::string_view::npos) << name << ": " << key;
    }
}

TEST(Methods, StratifiedRefusesWhatItWouldIgnore) {
    const PreparedScene scene = prepare(scene_from("image.resolution = [8, 8]\ncamera.position = [0, 0, 4]\n[[surface]]\nimplicit = \"sphere\"\n"));
    const auto check = [&](const std::string& settings) {
        const Config config = Config::parse("[particles]\n" + settings, "settings");
        method_by_name("particles").check_settings({.scene = scene, .settings = config.root().table("particles"), .seed = {1}, .max_error = {}});
    };
    for (const std::string odd : {"count = \"binomial\"", "lines = \"fast\""}) {
        EXPECT_NO_THROW(check(odd));
        EXPECT_NO_THROW(check("sampler = \"stratified\""));
        try {
            check("sampler = \"stratified\"\n" + odd);
            ADD_FAILURE() << odd;
        } catch (const Error& e) {
            EXPECT_EQ(e.kind(), Failure::input);
            EXPECT_NE(std::string(e.what()).find(odd), std::string::npos) << e.what();
        }
    }
}

TEST(Methods, SettingsThatASamplerDoesNotReadAreWarnedOf) {
    const PreparedScene scene = prepare(scene_from("image.resolution = [8, 8]\ncamera.position = [0, 0, 4]\n[[surface]]\nimplicit = \"sphere\"\n"));
    const auto said = [&](const std::string& sampler, const std::string& setting) {
        const Config config = Config::parse("particles.sampler = \"" + sampler + "\"\nparticles." + setting, "settings");
        testing::internal::CaptureStderr();
        method_by_name("particles").check_settings({.scene = scene, .settings = config.root().table("particles"), .seed = {1}, .max_error = {}});
        return testing::internal::GetCapturedStderr();
    };
    struct Case {
        std::string setting, reader, other;
    };
    for (const Case& c : {Case{"lines = \"fast\"", "lines", "brownian"}, Case{"lines = \"fast\"", "mesh", "octree"},
                          Case{"group = 4", "stratified", "lines"}, Case{"walk.step = 0.1", "brownian", "lines"},
                          Case{"mesh.cells = 9", "mesh", "octree"}, Case{"octree.cells = 9", "octree", "mesh"},
                          Case{"memory_mib = 9", "lines", "stratified"}}) {
        EXPECT_EQ(said(c.reader, c.setting), "") << c.setting;
        const std::string key = c.setting.substr(0, c.setting.find(' '));
        EXPECT_EQ(said(c.other, c.setting), "warning: particles." + key + " is not read by particles.sampler = \"" + c.other + "\"\n");
    }
}

}  // namespace
}  // namespace pellucid
