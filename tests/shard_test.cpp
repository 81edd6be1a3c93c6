// Rendering in shards: any split merges to the bytes of one run, and what is not all the shards of one image
// is refused.
#include "render/shard.hpp"

#include <cstdlib>
#include <functional>
#include <numeric>

#include <sys/wait.h>

#include <nlohmann/json.hpp>

#include "core/error.hpp"
#include "io/image_file.hpp"
#include "scene_testing.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

std::string slurp(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

/// A few tiles of colours, as the texture of a rectangle.
void put_texture(const fs::path& file) {
    Image image(5, 3);
    for (const char* name : {"R", "G", "B"})
        for (std::size_t i = 0; i < image.pixel_count(); ++i)
            image.add(name)[i] = static_cast<float>((i * 7 + static_cast<std::size_t>(name[0])) % 11) / 11.0F;
    write_png(image, Vec3(0.0), file);
}

const std::string kPerspective = R"(
image.resolution = [45, 37]
camera = { position = [0.5, 1, 4], target = [0, 0, 0], fov_degrees = 35 }
[[light]]
direction = [-1, 2, 1.5]
[[surface]]
name = "ball"
implicit = "sphere"
scale = 0.8
opacity = 0.4
color = [0.2, 0.5, 0.9]
shading = { specular = 0.7 }
[[surface]]
name = "poster"
rectangle = { center = [0, 0, 0], u = [1, 0, 0], v = [0, 0.7, -0.5], image = "poster.png" }
opacity = 0.6
)";

const std::string kOrthographic = R"(
image.resolution = [29, 40]
camera = { projection = "orthographic", position = [3, 1, 4], target = [0, 0, 0], view_height = 2.6 }
[[surface]]
name = "mesh"
mesh = "ball.ply"
opacity = 0.3
opacity_law = "oblique"
[[surface]]
name = "poster"
rectangle = { center = [0.1, 0, 0], u = [0, 0, 1], v = [0, 1, 0], image = "poster.png" }
opacity = 0.8
[[surface]]
name = "ring"
implicit = "torus"
scale = 0.7
opacity = 0.9
)";

class ShardCommand : public testing::Test {
protected:
    fs::path folder = test_folder();

    ShardCommand() {
        put_texture(folder / "poster.png");
        put_sphere_mesh(folder / "ball.ply", 8, 0.9);
        put(folder / "p.toml", kPerspective);
        put(folder / "o.toml", kOrthographic);
    }

    struct Result {
        int code = -1;
        std::string out, err;
    };
    Result run(const std::string& command_line) const {
        const std::string command = fmt::format("cd '{}' && timeout 60 '{}'/{} > out 2> err", folder.string(),
                                                PELLUCID_BIN_DIR, command_line);
        const int status = std::system(command.c_str());
        return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, slurp(folder / "out"), slurp(folder / "err")};
    }
    void succeeds(const std::string& command_line) const {
        const Result r = run(command_line);
        EXPECT_EQ(r.code, 0) << command_line << ": " << r.err;
        EXPECT_EQ(r.err, "") << command_line;
    }
    /// Exit 2, one line that says all words, and an old OUT.exr stays as it was.
    void refused(const std::string& command_line, const std::vector<std::string>& words) const {
        SCOPED_TRACE(command_line);
        put(folder / "out.exr", "old");
        const Result r = run(command_line);
        EXPECT_EQ(r.code, 2) << r.err;
        EXPECT_EQ(std::count(r.err.begin(), r.err.end(), '\n'), 1) << r.err;
        for (const std::string& word : words)
            EXPECT_NE(r.err.find(word), std::string::npos) << word << " in: " << r.err;
        EXPECT_EQ(slurp(folder / "out.exr"), "old");
        EXPECT_TRUE(r.out.empty()) << r.out;
    }
    void draw(const std::string& scene, const std::string& part, const std::string& output,
              const std::string& options = "") const {
        const bool seeded = options.find("--seed") != std::string::npos;
        succeeds(fmt::format("render {} --method particles --set particles.repeats=11 {} {} -o {} {}", scene,
                             seeded ? "" : "--seed 5", part.empty() ? "" : "--shard " + part, output,
                             options));
    }
};

TEST_F(ShardCommand, MergedShardsAreTheBytesOfOneRun) {
    std::mt19937 random(3);
    for (const std::string scene : {"p.toml", "o.toml"}) {
        draw(scene, "", "one.exr");
        const std::string expected = slurp(folder / "one.exr");
        ASSERT_FALSE(expected.empty());
        for (const int count : {1, 2, 3, 7, 11}) {
            std::vector<int> order(static_cast<std::size_t>(count));
            std::iota(order.begin(), order.end(), 0);
            for (const int i : order)
                draw(scene, fmt::format("{}/{}", i, count), fmt::format("s{}.exr", i),
                     fmt::format("--threads {}", 1 + i % 2));
            for (int round = 0; round < 3; ++round) {
                std::string files;
                for (const int i : order) files += fmt::format(" s{}.exr", i);
                succeeds("merge merged.exr" + files);
                EXPECT_EQ(slurp(folder / "merged.exr"), expected) << scene << files;
                std::shuffle(order.begin(), order.end(), random);
            }
        }
    }
}

TEST_F(ShardCommand, SettingsCropAndLittleMemoryMergeToo) {
    const std::string options =
        "--crop 9,4,31,35 --set particles.count=binomial --set camera.near=2.5 --set particles.memory_mib=1";
    draw("p.toml", "", "one.exr", options);
    draw("p.toml", "0/2", "a.exr", options);
    draw("p.toml", "1/2", "b.exr", options);
    succeeds("merge merged.exr b.exr a.exr");
    EXPECT_EQ(slurp(folder / "merged.exr"), slurp(folder / "one.exr"));
}

TEST_F(ShardCommand, ShardsOfTwoBackendsMergeToTheSamePixels) {
    const std::string vulkan =
        "render p.toml --method particles --set particles.repeats=11 --seed 5 --shard 0/2 -o a.exr --backend vulkan";
    const Result r = run(vulkan);
    if (r.code == 3) GTEST_SKIP() << "skipped: no Vulkan device";
    ASSERT_EQ(r.code, 0) << r.err;
    draw("p.toml", "", "one.exr");
    draw("p.toml", "1/2", "b.exr");
    succeeds("merge merged.exr b.exr a.exr");
    const Image merged = read_exr(folder / "merged.exr");
    const Image one = read_exr(folder / "one.exr");
    expect_same_planes(merged, one);
    EXPECT_NE(merged.attributes.at("device").find(one.attributes.at("device")), std::string::npos);
    EXPECT_NE(merged.attributes.at("device").find(" + "), std::string::npos);
}

TEST_F(ShardCommand, EmptySceneAndFullCropMerge) {
    put(folder / "e.toml", "image.resolution = [3, 2]\ncamera.position = [0, 0, 4]\n");
    draw("e.toml", "", "one.exr");
    draw("e.toml", "0/2", "a.exr", "--crop 0,0,3,2");
    draw("e.toml", "1/2", "b.exr");
    succeeds("merge merged.exr a.exr b.exr");
    EXPECT_EQ(slurp(folder / "merged.exr"), slurp(folder / "one.exr"));
}

TEST_F(ShardCommand, ShardIsAnImageOfItsOwnRepeats) {
    draw("p.toml", "1/3", "s.exr", "--stats s.json");
    const auto stats = nlohmann::json::parse(slurp(folder / "s.json"));
    EXPECT_EQ(stats["repeats"], 4);  // 3, 4, 5, 6 of 11
    const Image image = read_exr(folder / "s.exr");
    EXPECT_EQ(image.attributes.at("shard"), "1/3");
    EXPECT_EQ(image.attributes.at("shard.repeats"), "3 to 6 of 11");
    EXPECT_EQ(nlohmann::json::parse(image.attributes.at("settings"))["particles"]["repeats"], 11);
    float most = 0;
    for (std::size_t i = 0; i < image.pixel_count(); ++i) {
        EXPECT_EQ(image.plane("A")[i], image.plane("shard.covered")[i] / 4);
        EXPECT_NEAR(static_cast<double>(image.plane("G")[i]),
                    static_cast<double>(image.plane("shard.G.low")[i]) / 65535 / 4, 1e-6);
        EXPECT_EQ(std::isinf(image.plane("Z")[i]), image.plane("A")[i] == 0);
        most = std::max(most, image.plane("A")[i]);
    }
    EXPECT_EQ(most, 1);
}

TEST_F(ShardCommand, PlanIsOfTheShardsRepeats) {
    const Result r = run("render p.toml --method particles --set particles.repeats=11 --shard 1/3 --plan");
    EXPECT_EQ(r.code, 0) << r.err;
    EXPECT_NE(r.out.find("each of 4 repeats"), std::string::npos) << r.out;
}

TEST_F(ShardCommand, BadShardsAreRefusedByRender) {
    const std::string ok = "render p.toml --method particles --set particles.repeats=4 -o out.exr ";
    for (const char* part : {"3/3", "4/3", "0/0", "-1/3", "1", "/", "1/", "/3", "1/3/3", "a/b", "01/3",
                             "+1/3", "0x1/3", "' 1/3'", "1.0/3", "0/99999999999999999999"})
        refused(ok + "--shard " + part, {"--shard", "0 <= i < n"});
    refused(ok + "--shard ''", {"--shard"});
    refused(ok + "--shard 0/5", {"--shard 0/5", "at most 4"});
    refused(ok + "--shard 0/5 --plan", {"--shard 0/5", "at most 4"});
    refused(ok + "--shard 0/2 --max-error 0.1", {"--shard", "--max-error"});
    refused("render p.toml --method reference -o out.exr --shard 0/2", {"--shard 0/2", "reference"});
    refused("render p.toml --method particles -o out.png --shard 0/2", {"out.png", ".exr"});
    EXPECT_FALSE(fs::exists(folder / "out.png"));
}

TEST_F(ShardCommand, WhatIsNotAllShardsOfOneImageIsRefusedByMerge) {
    draw("p.toml", "", "one.exr");
    draw("p.toml", "0/3", "a.exr");
    draw("p.toml", "1/3", "b.exr");
    draw("p.toml", "2/3", "c.exr");
    fs::copy_file(folder / "b.exr", folder / "b2.exr");
    put(folder / "text.exr", "no image");

    refused("merge", {"OUT"});
    refused("merge out.exr", {"SHARD"});
    refused("merge out.exr a.exr c.exr", {"1/3", "missing"});
    refused("merge out.exr b.exr", {"0/3, 2/3", "2 of them are missing"});
    refused("merge out.exr a.exr b.exr c.exr b2.exr", {"b2.exr", "b.exr", "1/3", "once"});
    refused("merge out.exr a.exr b.exr a.exr", {"a.exr", "0/3", "once"});
    refused("merge out.exr a.exr b.exr one.exr", {"one.exr", "shard"});
    refused("merge out.exr text.exr", {"text.exr"});
    refused("merge out.exr a.exr b.exr nowhere.exr", {"nowhere.exr"});
    refused("merge out.exr .", {"."});
    refused("merge out.png a.exr b.exr c.exr", {"out.png", ".exr", "background"});
    refused("merge a.exr a.exr b.exr c.exr", {"a.exr"});
    refused("merge ./c.exr a.exr b.exr c.exr", {"c.exr"});
    refused("merge --nonsense out.exr a.exr b.exr c.exr", {"nonsense"});
    const Result unwritable = run("merge nowhere/out.exr a.exr b.exr c.exr");
    EXPECT_EQ(unwritable.code, 4) << unwritable.err;
    succeeds("merge merged.exr a.exr b.exr c.exr");
    EXPECT_EQ(slurp(folder / "merged.exr"), slurp(folder / "one.exr"));
}

TEST_F(ShardCommand, ShardsOfOtherRunsAreRefusedByMerge) {
    draw("p.toml", "0/2", "a.exr");
    const auto other = [&](const std::string& scene, const std::string& part, const std::string& options,
                           const std::vector<std::string>& words) {
        draw(scene, part, "b.exr", options);
        refused("merge out.exr a.exr b.exr", words);
    };
    other("p.toml", "1/2", "--seed 6", {"b.exr", "seed = 6", "expected 5", "a.exr"});
    other("p.toml", "1/2", "--set particles.repeats=12", {"b.exr", "overrides", "12"});
    other("p.toml", "1/2", "--set particles.count=binomial", {"b.exr", "overrides", "binomial"});
    other("p.toml", "1/2", "--set camera.fov_degrees=36", {"b.exr", "overrides", "36"});
    other("p.toml", "1/2", "--set image.resolution=[45,38]", {"b.exr", "45 x 38", "45 x 37"});
    other("p.toml", "1/3", "", {"b.exr", "1/3", "expected one of 2"});
    other("o.toml", "1/2", "--set image.resolution=[45,37]", {"b.exr"});
    other("p.toml", "1/2", "--crop 0,0,44,37", {"b.exr", "44 x 37"});
    draw("p.toml", "0/2", "a.exr", "--crop 0,0,20,20");
    other("p.toml", "1/2", "--crop 1,0,21,20", {"b.exr", "shard.input", "a.exr"});
    draw("p.toml", "0/2", "a.exr");
    put(folder / "p.toml", kPerspective + "color = [1, 0, 0]\n");
    other("p.toml", "1/2", "", {"b.exr", "shard.input"});
    put(folder / "p.toml", kPerspective);
    Image texture = read_png(folder / "poster.png");
    texture.plane("R")[3] = 1;
    write_png(texture, Vec3(0.0), folder / "poster.png");
    other("p.toml", "1/2", "", {"b.exr", "shard.input"});
}

// In process: shards made of numbers.

Shard some_shard(ShardPart part, std::uint64_t seed = 1, double units = 65535) {
    std::mt19937_64 random(seed * 1000 + part.index);
    Shard shard{part, 10, {0.1 + 1e-17, -3}, EnsembleSums(4 * 3, units)};
    const RepeatRange range = part.repeats_of(10);
    shard.sums.repeats = range.end - range.first;
    shard.sums.particles = random();
    for (EnsembleSums::Pixel& p : shard.sums.pixels) {
        p.covered = static_cast<std::uint32_t>(random() % 4);
        if (p.covered == 0) continue;
        for (int c = 0; c < 3; ++c) {
            p.color[c] = random() % (std::uint64_t{1} << 44U);
            p.square[c] = random() % (std::uint64_t{1} << 63U);
        }
        p.depth = static_cast<std::uint32_t>(random() % 0x3f800000U);
    }
    return shard;
}

Image some_image() {
    Image image(4, 3);
    image.add("R", 0.5F);
    image.attributes = {
        {"seed", "3"}, {"commit", "abc"}, {"device", "CPU"}, {"settings", std::string(100, 'x') + "\n{}"}};
    return image;
}

bool equal(const EnsembleSums& a, const EnsembleSums& b) {
    return a.pixels.size() == b.pixels.size() && a.units == b.units && a.particles == b.particles &&
           a.repeats == b.repeats &&
           std::memcmp(a.pixels.data(), b.pixels.data(), a.pixels.size() * sizeof(EnsembleSums::Pixel)) == 0;
}

/// The one line of the Error(input) that `action` throws.
std::string refusal(const std::function<void()>& action) {
    try {
        action();
    } catch (const Error& error) {
        EXPECT_EQ(error.kind(), Failure::input) << error.what();
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
        return error.what();
    }
    ADD_FAILURE() << "nothing was refused";
    return "";
}

TEST(Shard, PartsTakeEveryRepeatOnce) {
    for (const std::uint32_t repeats : {1U, 2U, 7U, 100U, kMostRepeats})
        for (const std::uint32_t count : {1U, 2U, 3U, 7U, 64U}) {
            if (count > repeats) continue;
            std::uint32_t next = 0;
            for (std::uint32_t i = 0; i < count; ++i) {
                const RepeatRange range = ShardPart{i, count}.repeats_of(repeats);
                EXPECT_EQ(range.first, next);
                EXPECT_GE(range.end - range.first, repeats / count);
                EXPECT_LE(range.end - range.first, repeats / count + 1);
                next = range.end;
            }
            EXPECT_EQ(next, repeats);
        }
    const RepeatRange last = ShardPart{kMostRepeats - 1, kMostRepeats}.repeats_of(kMostRepeats);
    EXPECT_EQ(last.first, kMostRepeats - 1);
    EXPECT_EQ(last.end, kMostRepeats);
}

TEST(Shard, DrawnSumsOfPartsAddUpToThoseOfAll) {
    const PreparedScene scene =
        prepare(scene_from("image.resolution = [20, 15]\ncamera.position = [0, 0, 4]\n"
                           "[[surface]]\nname = \"ball\"\nimplicit = \"sphere\"\nopacity = 0.5\n"));
    RenderStats stats;
    const EnsembleSums all = draw_particles(scene, {.repeats = 10}, stats);
    EnsembleSums sum = make_sums(scene);
    for (std::uint32_t i = 3; i-- > 0;) {
        const RepeatRange range = ShardPart{i, 3}.repeats_of(10);
        sum.add(
            draw_particles(scene, {.repeats = range.end - range.first, .first_repeat = range.first}, stats));
        EXPECT_EQ(stats.repeats, range.end - range.first);
    }
    EXPECT_TRUE(equal(sum, all));
    EXPECT_FALSE(equal(draw_particles(scene, {.repeats = 10, .first_repeat = 1}, stats), all));
}

TEST(Shard, FileKeepsEveryBitOfTheSums) {
    const fs::path file = test_folder() / "s.exr";
    const Shard shard = some_shard({2, 3}, 1, 65535.0 / 8);
    write_shard(some_image(), shard, 7, file);
    const ShardHeader header = read_shard_header(file);
    EXPECT_EQ(header.width, 4);
    EXPECT_EQ(header.height, 3);
    EXPECT_EQ(header.part.text(), "2/3");
    EXPECT_EQ(header.all_repeats, 10U);
    EXPECT_EQ(header.frame.near, shard.frame.near);
    EXPECT_EQ(header.frame.exponent, -3);
    EXPECT_TRUE(equal(read_shard_sums(header), shard.sums));
}

class ShardFiles : public testing::Test {
protected:
    fs::path folder = test_folder();
    std::vector<fs::path> files{folder / "a.exr", folder / "b.exr"};

    void write(std::uint32_t index, const Image& image, const Shard& shard, std::uint64_t digest = 7) const {
        write_shard(image, shard, digest, files[index]);
    }
    void SetUp() override {
        for (std::uint32_t i = 0; i < 2; ++i) write(i, some_image(), some_shard({i, 2}));
    }
};

TEST_F(ShardFiles, MergedImageIsThatOfTheSum) {
    EnsembleSums sums = some_shard({0, 2}).sums;
    sums.add(some_shard({1, 2}).sums);
    Image expected(4, 3);
    add_ensemble_planes({0.1 + 1e-17, -3}, sums, expected);
    const Image merged = merge_shards(files);
    expect_same_planes(merged, expected);
    EXPECT_EQ(merged.attributes, some_image().attributes);
}

TEST_F(ShardFiles, DevicesAreJoinedInOneOrder) {
    Image image = some_image();
    image.attributes["device"] = "Another";
    write(1, image, some_shard({1, 2}));
    EXPECT_EQ(merge_shards(files).attributes.at("device"), "Another + CPU");
    std::swap(files[0], files[1]);
    EXPECT_EQ(merge_shards(files).attributes.at("device"), "Another + CPU");
}

TEST_F(ShardFiles, WhatDiffersIsNamed) {
    const auto differs = [&](const std::string& word, const Image& image, const Shard& shard,
                             std::uint64_t digest = 7) {
        write(1, image, shard, digest);
        const std::string line = refusal([&] { (void)merge_shards(files); });
        EXPECT_NE(line.find(word), std::string::npos) << line;
        EXPECT_NE(line.find("b.exr"), std::string::npos) << line;
        EXPECT_NE(line.find("a.exr"), std::string::npos) << line;
    };
    const Shard shard = some_shard({1, 2});
    for (const char* name : {"seed", "commit"}) {
        Image image = some_image();
        image.attributes[name] = "other";
        differs(fmt::format("{} = other", name), image, shard);
    }
    Image image = some_image();
    image.attributes["settings"].replace(95, 1, "y");
    differs("yxxxx {}", image, shard);
    image.attributes.erase("settings");
    differs("has no attribute settings", image, shard);
    image = some_image();
    image.attributes["backend"] = "vulkan";
    differs("has an attribute backend", image, shard);
    differs("shard.input", some_image(), shard, 8);
    differs("shard.units", some_image(), some_shard({1, 2}, 1, 65535.0 / 2));
    Shard moved = shard;
    moved.frame.near = 0.1 + 1e-16;
    differs("shard.near", some_image(), moved);
    moved.frame = {shard.frame.near, -2};
    differs("shard.exponent", some_image(), moved);
    Shard more = shard;
    more.all_repeats = 11;
    differs("shard.repeats", some_image(), more);
    write(1, some_image(), shard);
    EXPECT_NO_THROW((void)merge_shards(files));
}

TEST_F(ShardFiles, MissingOnesAreListedUpToEight) {
    const std::vector<fs::path> file{folder / "c.exr"};
    write_shard(some_image(), some_shard({1, 10}), 7, file[0]);
    const std::string line = refusal([&] { (void)merge_shards(file); });
    EXPECT_NE(line.find("9 of them are missing: 0/10, 2/10, 3/10, 4/10, 5/10, 6/10, 7/10, 8/10, …"),
              std::string::npos)
        << line;
}

TEST_F(ShardFiles, PixelsExchangedAfterTheHeaderWasReadAreNoticed) {
    const ShardHeader header = read_shard_header(files[1]);
    write(1, some_image(), some_shard({1, 2}, 2));
    EXPECT_NE(refusal([&] { (void)read_shard_sums(header); }).find("shard.checksum"), std::string::npos);
}

TEST_F(ShardFiles, AttributesOutOfRangeAreRefused) {
    // write_exr in place of write_shard: attributes that no shard has.
    const auto attributes = read_shard_header(files[0]).attributes;
    const auto broken = [&](const std::string& name, const std::string& value) {
        SCOPED_TRACE(name + " = " + value);
        Image image(4, 3);
        image.add("R");
        image.attributes = attributes;
        image.attributes[name] = value;
        write_exr(image, folder / "c.exr");
        const std::string line = refusal([&] { (void)read_shard_header(folder / "c.exr"); });
        EXPECT_NE(line.find("c.exr: " + name), std::string::npos) << line;
    };
    for (const char* value : {"", "2/2", "0/2 ", "x"}) broken("shard", value);
    for (const char* value :
         {"", "0 to 4 of 9", "0 to 4", "0 to 0 of 1", "0 to 16777215 of 33554432", "0 to 4 of 010"})
        broken("shard.repeats", value);
    for (const char* value : {"", "nan", "inf", "0.1", "0x1p+0x"}) {
        broken("shard.near", value);
        broken("shard.units", value);
    }
    for (const char* value : {"", "1e3", "99999999999"}) broken("shard.exponent", value);
    for (const char* value : {"", "-1", "99999999999999999999"}) broken("shard.particles", value);

    Image image(4, 3);
    image.add("R");
    image.attributes = attributes;
    write_exr(image, files[0]);
    EXPECT_NE(refusal([&] { (void)merge_shards(files); }).find("shard.R.low"), std::string::npos);
    image.add("shard.R.low");
    for (const char* channel :
         {"shard.R.low", "shard.R.high", "shard.R2.low", "shard.R2.high", "shard.G.low", "shard.G.high",
          "shard.G2.low", "shard.G2.high", "shard.B.low", "shard.B.high", "shard.B2.low", "shard.B2.high",
          "shard.covered", "shard.depth"})
        image.add(channel);
    write_exr(image, files[0]);
    EXPECT_NE(refusal([&] { (void)merge_shards(files); }).find("another type"), std::string::npos);
}

TEST_F(ShardFiles, DamageIsRefusedOrHarmless) {
    const Image expected = merge_shards(files);
    const std::string whole = slurp(files[1]);
    std::mt19937 random(11);
    std::size_t refusals = 0;
    std::size_t merges = 0;
    // What may be thrown is Error(input); what is not refused must be the right image.
    const auto survives = [&](const std::string& damaged) {
        put(files[1], damaged);
        try {
            const Image merged = merge_shards(files);
            ++merges;
            expect_same_planes(merged, expected);
            EXPECT_EQ(merged.attributes, expected.attributes);
        } catch (const Error& error) {
            ++refusals;
            EXPECT_EQ(error.kind(), Failure::input) << error.what();
            EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
        }
    };
    for (std::size_t length = 0; length < whole.size(); length += length < 64 ? 1 : 13)
        survives(whole.substr(0, length));
    EXPECT_EQ(merges, 0U) << "a file cut short was merged";
    for (std::size_t at = 0; at < whole.size(); at += 1 + random() % 8) {
        std::string damaged = whole;
        damaged[at] = static_cast<char>(damaged[at] ^ static_cast<char>(1U << random() % 8));
        survives(damaged);
        if (HasFailure()) FAIL() << "byte " << at;
    }
    for (int i = 0; i < 500; ++i) {
        std::string damaged = whole;
        for (std::size_t flips = 2 + random() % 6; flips > 0; --flips)
            damaged[random() % damaged.size()] = static_cast<char>(random());
        survives(damaged);
        if (HasFailure()) FAIL() << "round " << i;
    }
    EXPECT_GT(refusals, 10 * merges);
}

}  // namespace
}  // namespace pellucid
