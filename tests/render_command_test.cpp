// The render command from end to end: what it writes, and how it refuses.
#include <cstdio>
#include <cstdlib>

#include <sys/wait.h>

#include <nlohmann/json.hpp>
#include <zlib.h>

#include "field/catalogue.hpp"
#include "io/image_file.hpp"
#include "render/method.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

std::string slurp(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

class RenderCommand : public testing::Test {
protected:
    fs::path folder = test_folder();

    const std::string head_ = "image.resolution = [12, 10]\ncamera.position = [0, 0, 4]\n";
    const std::string good_ = head_ + "[[surface]]\nname = \"ball\"\nimplicit = \"sphere\"\nopacity = 0.5\n";

    struct Result {
        int code = -1;
        std::string out, err;
    };
    Result run(const std::string& arguments) const {
        const std::string command = fmt::format("cd '{}' && timeout 60 '{}/render' {} > out 2> err",
                                                folder.string(), PELLUCID_BIN_DIR, arguments);
        const int status = std::system(command.c_str());
        return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, slurp(folder / "out"), slurp(folder / "err")};
    }
    void scene(const std::string& toml) const { put(folder / "s.toml", toml); }

    /// Refused with `code`, one line that says `word`, and an old result stays as it was.
    void refused(const std::string& arguments, const std::string& word, int code = 2) const {
        SCOPED_TRACE(arguments);
        put(folder / "o.exr", "old");
        const Result r = run(arguments);
        EXPECT_EQ(r.code, code) << r.err;
        EXPECT_EQ(std::count(r.err.begin(), r.err.end(), '\n'), 1) << r.err;
        EXPECT_NE(r.err.find(word), std::string::npos) << r.err;
        EXPECT_EQ(slurp(folder / "o.exr"), "old");
        EXPECT_TRUE(r.out.empty()) << r.out;
    }
    void refused_scene(const std::string& toml, const std::string& word) const {
        scene(toml);
        for (const char* method : {"particles", "reference"})
            refused(fmt::format("s.toml --method {} -o o.exr", method), word);
    }
};

TEST_F(RenderCommand, WritesPlanesAttributesAndStatistics) {
    scene(good_);
    for (const std::string method : {"particles", "reference"}) {
        const Result r = run("s.toml --method " + method +
                             " -o o.exr --stats s.json --seed 5 --set image.background=[0,0,1] --quiet");
        ASSERT_EQ(r.code, 0) << r.err;
        EXPECT_EQ(r.err, "");
        const Image image = read_exr(folder / "o.exr");
        EXPECT_EQ(image.width(), 12);
        EXPECT_EQ(image.height(), 10);
        for (const char* plane :
             {"R", "G", "B", "A", "Z", "variance.R", "variance.G", "variance.B", "variance.A"})
            EXPECT_TRUE(image.has(plane)) << plane;
        for (const char* key : {"scene", "method", "settings", "seed", "commit", "device"})
            EXPECT_FALSE(image.attributes.at(key).empty()) << key;
        EXPECT_EQ(image.attributes.at("method"), method);
        EXPECT_EQ(image.attributes.at("seed"), "5");
        EXPECT_TRUE(std::isinf(image.plane("Z")[0]));
        EXPECT_NEAR(static_cast<double>(image.plane("A")[12 * 5 + 6]), 0.75, 0.1);
        const auto stats = nlohmann::json::parse(slurp(folder / "s.json"));
        for (const char* key :
             {"method", "backend", "device", "seed", "stages", "total_s", "peak_rss_bytes", "device_bytes"})
            EXPECT_TRUE(stats.contains(key)) << key;
        for (const auto& stage : stats["stages"])
            for (const char* key : {"name", "wall_s", "device_s"}) EXPECT_TRUE(stage.contains(key)) << key;
        if (method == "particles") {
            EXPECT_EQ(stats["repeats"], 500);
            EXPECT_GT(stats["particles"], 1000);
        }
    }
}

TEST_F(RenderCommand, SettingsAreInTheHeaderWithTheirDefaults) {
    scene(good_);
    ASSERT_EQ(run("s.toml --method particles -o o.exr --set particles.repeats=3").code, 0);
    const auto settings = nlohmann::json::parse(read_exr(folder / "o.exr").attributes.at("settings"));
    EXPECT_EQ(settings["particles"]["repeats"], 3);
    EXPECT_EQ(settings["particles"]["sampler"], "lines");
}

TEST_F(RenderCommand, PngIsOverTheBackground) {
    scene(good_ + "shading = \"flat\"\n");
    ASSERT_EQ(run("s.toml --method reference -o o.png --set image.background=[0,0,1]").code, 0);
    const Image image = read_png(folder / "o.png");
    EXPECT_NEAR(static_cast<double>(image.plane("B")[0]), 1, 1e-3);
    EXPECT_NEAR(static_cast<double>(image.plane("R")[0]), 0, 1e-3);
    EXPECT_NEAR(static_cast<double>(image.plane("R")[12 * 5 + 6]), 0.75 * 0.8, 0.01);
}

TEST_F(RenderCommand, CropIsThatPartOfTheWhole) {
    scene(good_);
    ASSERT_EQ(run("s.toml --method reference -o whole.exr").code, 0);
    ASSERT_EQ(run("s.toml --method reference -o part.exr --crop 3,2,9,7").code, 0);
    const Image whole = read_exr(folder / "whole.exr");
    const Image part = read_exr(folder / "part.exr");
    ASSERT_EQ(part.width(), 6);
    ASSERT_EQ(part.height(), 5);
    for (std::size_t y = 0; y < 5; ++y)
        for (std::size_t x = 0; x < 6; ++x)
            EXPECT_EQ(part.plane("G")[6 * y + x], whole.plane("G")[12 * (y + 2) + x + 3]);
}

TEST_F(RenderCommand, PlanDrawsNothing) {
    scene(good_);
    const Result r = run("s.toml --method particles -o o.exr --plan");
    EXPECT_EQ(r.code, 0) << r.err;
    EXPECT_FALSE(fs::exists(folder / "o.exr"));
    EXPECT_NE(r.out.find("bytes"), std::string::npos);
    EXPECT_NE(r.out.find("total"), std::string::npos);
}

TEST_F(RenderCommand, PlanTellsTheCandidatesOfStratifiedSets) {
    scene(good_);
    const Result plan = run("s.toml --method particles --plan --set particles.sampler=stratified --set particles.repeats=64");
    EXPECT_EQ(plan.code, 0) << plan.err;
    EXPECT_NE(plan.out.find("candidates for each of 64 repeats, in groups of 8"), std::string::npos) << plan.out;
}

TEST_F(RenderCommand, ListsNameEveryMethodAndSurface) {
    const Result methods = run("--list");
    EXPECT_EQ(methods.code, 0);
    EXPECT_EQ(std::count(methods.out.begin(), methods.out.end(), '\n'), static_cast<std::ptrdiff_t>(pellucid::methods().size()));
    for (const char* word : {"particles: ", "reference: ", "z-test: ", "depth-peeling: ", "alpha-blend: ", "tessellate.error_px = 0.25", "particles.repeats = 500", "reference.filter"})
        EXPECT_NE(methods.out.find(word), std::string::npos) << word;
    const Result surfaces = run("--list-implicit");
    for (const CatalogueEntry& entry : catalogue())
        EXPECT_NE(surfaces.out.find(fmt::format("\n{} ", entry.name)), std::string::npos) << entry.name;
}

TEST_F(RenderCommand, BadArgumentsAreRefused) {
    scene(good_);
    const std::string ok = "s.toml --method particles -o o.exr ";
    refused("s.toml --method nonsense -o o.exr", "nonsense");
    refused("s.toml -o o.exr", "--method");
    refused("--method particles -o o.exr", "scene");
    refused("nowhere.toml --method particles -o o.exr", "nowhere.toml");
    refused("s.toml --method particles -o o.jpg", "o.jpg");
    refused(ok + "--nonsense", "nonsense");
    refused(ok + "--set particles.repeat=3", "repeat");
    refused(ok + "--set nonsense.key=3", "nonsense");
    refused(ok + "--set camera.positon=[0,0,1]", "positon");
    refused(ok + "--set particles.repeats=0", "repeats");
    refused(ok + "--set particles.repeats=many", "repeats");
    refused(ok + "--set particles.sampler=\\\"cubes\\\"", "cubes");
    refused(ok + "--set particles.repeats=4 --set particles.group=5", "particles.group = 5");
    refused(ok + "--max-error 0", "--max-error");
    for (const char* crop :
         {"0,0,13,10", "5,5,5,9", "1,2,3", "a,b,c,d", "-1,0,3,3", "0,0,99999999999,4", "1,2,3,4,5"})
        refused(ok + "--crop " + crop, "--crop");
    refused(ok + "--backend vulkan --device GTX", "Vulkan device", 3);
    refused(ok + "--device GTX", "GTX");
    refused(ok + "--backend all", "all");
    const Result unwritable = run("s.toml --method particles -o nowhere/o.exr --set particles.repeats=2");
    EXPECT_EQ(unwritable.code, 4) << unwritable.err;
    EXPECT_EQ(std::count(unwritable.err.begin(), unwritable.err.end(), '\n'), 1) << unwritable.err;
}

TEST_F(RenderCommand, BadScenesAreRefused) {
    refused_scene(good_ + "colour = [1, 1, 1]\n", "colour");
    refused_scene(good_ + "bounds = [[1, 1, 1], [-1, -1, -1]]\n", "bounds");
    refused_scene("image.resolution = [4000000, 4000000]\ncamera.position = [0, 0, 4]\n", "resolution");
    refused_scene("image.resolution = [8, 8]\ncamera.position = [0, 0, 0]\n", "target");
    refused_scene(head_ + "[[surface]]\nname = \"b\"\nimplicit = \"sphear\"\n", "sphear");
    refused_scene(head_ + "[[surface]]\nname = \"b\"\nimplicit = \"sphere\"\nopacity = 1.5\n", "opacity");
    refused_scene(head_ + "[[surface]]\nname = \"b\"\nmesh = \"gone.ply\"\n", "gone.ply");
    const std::string transfer = "transfer = [[0, 0, 0, 0, 0], [1, 1, 1, 1, 1]]\n";
    refused_scene(good_ + "[[volume]]\nname = \"fog\"\nfile = \"v.nrrd\"\n" + transfer, "fog");
    refused_scene(good_ + "[[surface]]\nname = \"odd\"\npoints = \"p.ply\"\n", "p.ply");
}

TEST_F(RenderCommand, BadExpressionsAreRefused) {
    const auto formula = [&](const std::string& text, const std::string& bounds = "[[-1, -1, -1], [1, 1, 1]]") {
        return head_ + "[[surface]]\nname = \"f\"\nexpression = \"" + text + "\"\nbounds = " + bounds + "\n";
    };
    refused_scene(formula(std::string(50000, '(') + "x" + std::string(50000, ')')), "1000 parentheses");
    std::string terms = "x";
    for (int i = 0; i < 100000; ++i) terms += fmt::format("+sin({}*x)", i);
    refused_scene(formula(terms), "\"f\"");
    refused_scene(formula("x+foo"), "foo");
    refused_scene(formula(""), "empty");
    refused_scene(formula("  "), "empty");
    refused_scene(formula("x/0"), "by 0");
    refused_scene(formula("x^"), "column");
    refused_scene(formula("x", "[[0, 0, 0], [0, 1, 1]]"), "bounds");
    refused_scene(formula("x", "[[nan, 0, 0], [1, 1, 1]]"), "bounds");
    refused_scene(formula("x", "[[0, 0, 0]]"), "bounds");
    for (const char* large : {"1e300", "1.7e308"})
        refused_scene(formula("x", fmt::format("[[-{0}, -{0}, -{0}], [{0}, {0}, {0}]]", large)), "bounds");
    refused_scene(formula("x", "[[-1e-300, -1e-300, -1e-300], [1e-300, 1e-300, 1e-300]]"), "expected 1e-100");
}

TEST_F(RenderCommand, ExpressionsWithoutASurfaceAreAWarningAndAnEmptyImage) {
    for (const char* text : {"0", "1", "x-x", "log(-1-x^2)", "sqrt(-1-y^2)+x", "x^2+y^2+z^2+1", "exp(x)"}) {
        scene(head_ + "[[surface]]\nname = \"f\"\nexpression = \"" + text + "\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\n");
        for (const char* method : {"particles", "reference"}) {
            const Result r = run(fmt::format("s.toml --method {} -o o.exr", method));
            EXPECT_EQ(r.code, 0) << text << r.err;
            EXPECT_NE(r.err.find("warning: surface \"f\": nothing of it"), std::string::npos) << text << r.err;
            const Image image = read_exr(folder / "o.exr");
            for (const float a : image.plane("A")) ASSERT_EQ(a, 0) << text;
        }
    }
}

TEST_F(RenderCommand, WildExpressionsEnd) {
    std::string terms = "x";
    for (int i = 0; i < 100000; ++i) terms += fmt::format("+{}*x", i);
    for (const std::string& text : {terms, std::string("tan(1000*x)+1/y"), std::string("exp(exp(exp(10*x)))-1"), std::string("x^1000000000-y"),
                                    std::string("max(x,x)")}) {
        scene("image.resolution = [3, 2]\ncamera.position = [0.3, 0.2, 4]\n[[surface]]\nname = \"f\"\nexpression = \"" + text +
              "\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\nopacity = 0.3\n");
        EXPECT_EQ(run("s.toml --method particles -o o.exr --set particles.repeats=1").code, 0) << text.substr(0, 40);
        EXPECT_EQ(run("s.toml --method reference -o o.exr --set reference.max_error=0.1").code, 0) << text.substr(0, 40);
    }
}

TEST_F(RenderCommand, PointsThatMakeNoSurfaceAreRefused) {
    const std::string toml = head_ + "[[surface]]\nname = \"scan\"\npoints = \"p.xyz\"\n";
    const auto points = [&](int count, const auto& line) {
        std::string text;
        for (int i = 0; i < count; ++i) text += line(i);
        put(folder / "p.xyz", text);
    };
    const auto on_sphere = [](int i) {
        const double z = 1 - (2 * i + 1) / 400.0;
        return Vec3(std::sqrt(1 - z * z) * std::cos(2.4 * i), std::sqrt(1 - z * z) * std::sin(2.4 * i), z);
    };
    points(100, [](int i) { return fmt::format("{} 0 0\n", i); });
    refused_scene(toml, "p.xyz:1: 3 numbers, expected x y z nx ny nz");
    points(3, [](int i) { return fmt::format("{} {} 0 0 0 1\n", i, i * i); });
    refused_scene(toml, "3 different points, expected at least 15");
    points(200, [](int) { return "1 2 3 0 0 1\n"; });
    scene(toml);
    const Result one = run("s.toml --method particles -o o.exr");
    EXPECT_EQ(one.code, 2) << one.err;
    EXPECT_NE(one.err.find("1 different points, expected at least 15"), std::string::npos) << one.err;
    points(200, [](int i) { return fmt::format("{} {} 0 0 0 1\n", i, 2 * i); });
    refused_scene(toml, "the points lie along a line");
    points(200, [](int i) { return fmt::format("{} {} 0 0.6 0.8 0\n", i % 14, i / 14); });
    refused_scene(toml, "the normals lie in the surface");

    // What can be drawn is, with a word.
    const auto warned = [&](const std::string& word) {
        scene(toml);
        const Result r = run("s.toml --method particles -o o.exr --set particles.repeats=4");
        EXPECT_EQ(r.code, 0) << r.err;
        EXPECT_NE(r.err.find(word), std::string::npos) << r.err;
    };
    const auto with_normal = [](const Vec3& p, double sign) {
        return fmt::format("{} {} {} {} {} {}\n", p.x, p.y, p.z, sign * p.x, sign * p.y, sign * p.z);
    };
    points(400, [&](int i) { return with_normal(on_sphere(i), i % 3 == 0 ? -1 : 1); });
    warned("have a normal against that of their nearest neighbour");
    points(400, [&](int i) { return with_normal(on_sphere(i / 2 * 2), 1); });
    warned("200 stand where another one does and are merged");
    points(400, [&](int i) { return i == 7 ? "nan 0 0 0 0 1\n" : with_normal(on_sphere(i), 1); });
    warned("1 points whose position is no number are left out");
    points(401, [&](int i) { return i == 400 ? "900 0 0 1 0 0\n" : with_normal(on_sphere(i), 1); });
    warned("1 of 401 lie farther than 2 widths from the others");
}

TEST_F(RenderCommand, DamagedFilesAreRefused) {
    const std::string iso =
        head_ + "[[surface]]\nname = \"b\"\nisosurface = { volume = \"v.nrrd\", isovalue = 0.5 }\n";
    put_volume(folder / "v.nrrd", {8, 8, 8}, std::vector<float>(512, 1));
    fs::resize_file(folder / "v.nrrd", fs::file_size(folder / "v.nrrd") - 100);
    refused_scene(iso, "v.nrrd");

    const std::string raw(4096, 'x');
    std::string header =
        "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 16 16 16\nspacings: 1 1 1\nencoding: gzip\n\n";
    gzFile zip = gzopen((folder / "z.gz").c_str(), "wb");
    gzwrite(zip, raw.data(), 4096);
    gzclose(zip);
    std::string packed = slurp(folder / "z.gz");
    packed[packed.size() / 2] = static_cast<char>(packed[packed.size() / 2] ^ 0x55);
    put(folder / "v.nrrd", header + packed);
    refused_scene(iso, "v.nrrd");

    const std::string mesh = head_ + "[[surface]]\nname = \"m\"\nmesh = \"m.ply\"\n";
    const std::string vertices =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n"
        "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n";
    put(folder / "m.ply", fmt::format(fmt::runtime(vertices), 1000000000) + "3 0 1 2\n");
    refused_scene(mesh, "m.ply");
    put(folder / "m.ply", fmt::format(fmt::runtime(vertices), 1) + "3 0 1 7\n");
    refused_scene(mesh, "m.ply");
}

TEST_F(RenderCommand, SurfaceThatNeverCrossesItsIsovalueIsAWarningAndAnEmptyImage) {
    put_volume(folder / "v.nrrd", {4, 4, 4}, std::vector<float>(64, 1));
    scene(head_ + "[[surface]]\nname = \"b\"\nisosurface = { volume = \"v.nrrd\", isovalue = 5 }\n");
    for (const char* method : {"particles", "reference"}) {
        const Result r = run(fmt::format("s.toml --method {} -o o.exr", method));
        EXPECT_EQ(r.code, 0) << r.err;
        EXPECT_NE(r.err.find("warning: "), std::string::npos) << r.err;
        const Image image = read_exr(folder / "o.exr");
        for (const float a : image.plane("A")) EXPECT_EQ(a, 0);
    }
}

}  // namespace
}  // namespace pellucid
