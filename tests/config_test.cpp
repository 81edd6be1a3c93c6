#include "io/config.hpp"

#include <cmath>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace pellucid {
namespace {

/// The message of the Error(input) that `body` throws; "" if it throws none.
template <class Body>
std::string refusal(const Body& body) {
    try {
        body();
    } catch (const Error& e) {
        EXPECT_EQ(e.kind(), Failure::input);
        EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos) << e.what();
        return e.what();
    }
    return "";
}

Config doc(std::string_view toml) {
    return Config::parse(toml, "x.toml", "/somewhere");
}

std::string write_file(const std::string& name, const std::string& bytes) {
    std::string path = testing::TempDir() + "config_test_" + name;
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
}

TEST(Config, ReadsEachKindOfValue) {
    const Config c = doc(R"(
        yes = true
        n = -7
        x = 2.5e-3
        s = "two words"
        p = [1, 2.5, -3]
        xs = [1, 2.5]
        ns = [1, 10]
        names = ["a", "b"]
        rows = [[0, 1], [2, 3]]
        kind = "second"
        f = "sub/a.ply"
        [map]
        minor = 0.5
        major = 2
    )");
    const ConfigTable t = c.root();
    EXPECT_TRUE(t.boolean("yes", kRequired));
    EXPECT_EQ(t.integer("n", kRequired), -7);
    EXPECT_EQ(t.number("x", kRequired), 2.5e-3);
    EXPECT_EQ(t.number("n", kRequired), -7.0);
    EXPECT_EQ(t.text("s", kRequired), "two words");
    EXPECT_EQ(t.vec3("p", kRequired), Vec3(1, 2.5, -3));
    EXPECT_EQ(t.numbers("xs", kRequired), (std::vector{1.0, 2.5}));
    EXPECT_EQ(t.integers("ns", kRequired), (std::vector<std::int64_t>{1, 10}));
    EXPECT_EQ(t.texts("names", kRequired), (std::vector<std::string>{"a", "b"}));
    EXPECT_EQ(t.rows("rows", 2), (std::vector<std::vector<double>>{{0, 1}, {2, 3}}));
    EXPECT_EQ(t.one_of("kind", kRequired, {"first", "second"}), "second");
    EXPECT_EQ(t.choice<int>("kind", kRequired, {{"first", 1}, {"second", 2}}), 2);
    EXPECT_EQ(t.file("f"), "/somewhere/sub/a.ply");
    EXPECT_EQ(t.number_map("map"), (std::map<std::string, double>{{"minor", 0.5}, {"major", 2.0}}));
    EXPECT_EQ(refusal([&] { c.finish(); }), "");
}

TEST(Config, AbsentKeysTakeTheDefault) {
    const Config c = doc("");
    const ConfigTable t = c.root();
    EXPECT_FALSE(t.boolean("a", false));
    EXPECT_EQ(t.integer("b", 3), 3);
    EXPECT_EQ(t.number("c", 0.5), 0.5);
    EXPECT_EQ(t.number_if("d"), std::nullopt);
    EXPECT_EQ(t.text("e", "e"), "e");
    EXPECT_EQ(t.vec3("f", Vec3(1, 2, 3)), Vec3(1, 2, 3));
    EXPECT_EQ(t.numbers("g", std::vector{1.5}), std::vector{1.5});
    EXPECT_EQ(t.one_of("h", "x", {"x", "y"}), "x");
    EXPECT_TRUE(t.number_map("i").empty());
    EXPECT_FALSE(t.table("j").present());
    EXPECT_EQ(t.table("j").table("k").number("l", 4.0), 4.0);
    EXPECT_TRUE(t.tables("m").empty());
    EXPECT_FALSE(t.has("n"));
}

TEST(Config, OneValueIsAListOfOne) {
    const Config c = doc("n = 5\ns = \"a\"");
    EXPECT_EQ(c.root().integers("n", kRequired), std::vector<std::int64_t>{5});
    EXPECT_EQ(c.root().texts("s", kRequired), std::vector<std::string>{"a"});
}

TEST(Config, MessagesNamePlaceKeyValueAndExpectation) {
    const Config c =
        doc("a = 1.5\nb = 'word'\nc = [1, 2]\nd = nan\ne = inf\n[t]\nx = 99\n[[item]]\nname = 'ring'\n"
            "q = -1\n[[item]]\nl = [{ w = true }]\n");
    const ConfigTable t = c.root();
    EXPECT_EQ(refusal([&] { t.number("a", kRequired, within(0, 1)); }), "x.toml:1: a = 1.5, expected [0, 1]");
    EXPECT_EQ(refusal([&] { t.integer("a", kRequired); }),
              "x.toml:1: a = 1.5 is a number, expected an integer");
    EXPECT_EQ(refusal([&] { t.number("b", 1.0); }), "x.toml:2: b = \"word\" is a string, expected a number");
    EXPECT_EQ(refusal([&] {
                  t.one_of("b", kRequired, {"x", "y", "z"});
              }),
              "x.toml:2: b = \"word\", expected \"x\", \"y\" or \"z\"");
    EXPECT_EQ(refusal([&] { t.vec3("c", kRequired); }), "x.toml:3: c has 2 elements, expected 3");
    EXPECT_EQ(refusal([&] { t.text("c", kRequired); }), "x.toml:3: c = [1, 2] is a list, expected a string");
    EXPECT_EQ(refusal([&] { t.number("d", kRequired); }), "x.toml:4: d = nan, expected a finite number");
    EXPECT_EQ(refusal([&] { t.number("e", kRequired, at_least(0)); }),
              "x.toml:5: e = inf, expected a finite number");
    EXPECT_EQ(refusal([&] { t.number("t", kRequired); }), "x.toml:6: t is a table, expected a number");
    EXPECT_EQ(refusal([&] {
                  t.table("t").integer("x", kRequired, {1, 9});
              }),
              "x.toml:7: t.x = 99, expected [1, 9]");
    EXPECT_EQ(refusal([&] { t.table("t").number("y", kRequired); }),
              "x.toml:6: t.y is missing, expected a number");
    EXPECT_EQ(refusal([&] { t.number("z", kRequired); }), "x.toml: z is missing, expected a number");
    EXPECT_EQ(refusal([&] { t.tables("item")[0].number("q", kRequired, at_least(0)); }),
              "x.toml:10: item \"ring\": q = -1, expected >= 0");
    EXPECT_EQ(refusal([&] { t.tables("item")[1].tables("l")[0].number("w", kRequired); }),
              "x.toml:12: item 1: l[0].w = true is a boolean, expected a number");
    EXPECT_EQ(refusal([&] { t.tables("t"); }), "x.toml:6: t is a table, expected a list of tables");
    EXPECT_EQ(refusal([&] { t.tables("c"); }), "x.toml:3: c = 1 is an integer, expected a table");
    EXPECT_EQ(refusal([&] { t.table("a"); }), "x.toml:1: a = 1.5 is a number, expected a table");
}

TEST(Config, RangesAreSharpAtTheirEnds) {
    EXPECT_TRUE(within(0, 1).contains(0) && within(0, 1).contains(1));
    EXPECT_FALSE(within(0, 1).contains(std::nextafter(1.0, 2.0)));
    EXPECT_FALSE(strictly_within(0, 180).contains(0) || strictly_within(0, 180).contains(180));
    EXPECT_FALSE(above(0).contains(0));
    EXPECT_TRUE(above(0).contains(5e-324));
    EXPECT_FALSE(Range{}.contains(NAN) || Range{}.contains(INFINITY) || Range{}.contains(-INFINITY));
    EXPECT_TRUE(Range{.infinite = true}.contains(INFINITY));
    EXPECT_FALSE(Range{.infinite = true}.contains(NAN));
}

TEST(Config, InfinityIsReadWhereAllowed) {
    EXPECT_EQ(doc("a = inf").root().number("a", kRequired, {.infinite = true}), INFINITY);
    EXPECT_NE(refusal([] { doc("a = nan").root().number("a", kRequired, {.infinite = true}); }), "");
}

TEST(Config, UnknownKeysAreErrorsWithTheNearestKnownOne) {
    const auto read = [](const std::string& toml) {
        return refusal([&] {
            const Config c = doc(toml);
            const ConfigTable t = c.root();
            t.number("opacity", 1.0);
            t.table("shading").number("ambient", 0.2);
            for (const ConfigTable& clip : t.tables("clip")) clip.number("offset", 0.0);
            c.finish();
        });
    };
    EXPECT_EQ(read("opacity = 1\nshading.ambient = 1\nclip = [{ offset = 1 }]"), "");
    EXPECT_EQ(read("a = 1"), "x.toml:1: unknown key \"a\"");
    EXPECT_EQ(read("\nopcaity = 1"), "x.toml:2: unknown key \"opcaity\", did you mean \"opacity\"?");
    EXPECT_EQ(read("[shading]\nambeint = 1"),
              "x.toml:2: shading: unknown key \"ambeint\", did you mean \"ambient\"?");
    EXPECT_EQ(read("clip = [{ offset = 1 }, { ofset = 1 }]"),
              "x.toml:1: clip[1]: unknown key \"ofset\", did you mean \"offset\"?");
    EXPECT_EQ(read("[extra]\ndeep.er = 1"), "x.toml:1: unknown key \"extra\"");
}

TEST(Config, SyntaxErrorsAreOneLineWithFileAndLine) {
    for (const std::string bad : {"a = 1\nb = ", "a = 1\na b", "a = 1\n[t", "a = 1\na = 2",
                                  "a = 1\nb = \"\n\"", "a = 1\n\x01", "a = 1\nb = \"\xff\xfe\""})
        EXPECT_EQ(refusal([&] { (void)doc(bad); }).rfind("x.toml:", 0), 0U) << bad;
    EXPECT_EQ(refusal([&] { (void)doc("a = 1\nb = "); }).rfind("x.toml:2: ", 0), 0U);
}

TEST(Config, FilesThatAreNoneAreRefused) {
    EXPECT_NE(
        refusal([] { (void)Config::read("/nonexistent/a.toml"); }).find("/nonexistent/a.toml: no such file"),
        std::string::npos);
    EXPECT_NE(refusal([] { (void)Config::read(testing::TempDir()); }).find("not a file"), std::string::npos);
    EXPECT_NE(refusal([] { (void)Config::read("/dev/zero"); }).find("not a file"), std::string::npos);
    std::string garbage;
    for (int i = 0; i < 4096; ++i) garbage += static_cast<char>((i * 7919 + 13) % 256);
    EXPECT_NE(refusal([&] { (void)Config::read(write_file("garbage.toml", garbage)); }), "");
}

TEST(Config, HugeFilesAreRefusedUnread) {
    const std::string path = write_file("huge.toml", "");
    std::filesystem::resize_file(path, std::uintmax_t{1} << 40);  // sparse
    EXPECT_NE(refusal([&] { (void)Config::read(path); }).find("1099511627776 bytes"), std::string::npos);
    std::filesystem::remove(path);
}

TEST(Config, DeepNestingIsRefusedWithoutRecursion) {
    // before + (what × times) + after
    const auto deep = [](std::string before, const std::string& what, int times, const char* after) {
        for (int i = 0; i < times; ++i) before += what;
        return before.append(after);
    };
    for (const std::string& bad :
         {deep("a = ", "[", 100000, ""), deep("a = ", "{a=", 100000, ""), deep("a", ".a", 1000000, " = 1"),
          deep("[a", ".a", 1000000, "]"), deep("[", "'x'.", 1000000, "a]"),
          deep("x = 1\ny = {a", ".a", 1000000, "=1}"), deep(deep("a = ", "[", 100, ""), "]", 100, "")})
        EXPECT_EQ(refusal([&] { (void)doc(bad); }).rfind("x.toml:", 0), 0U) << bad.substr(0, 20);
}

TEST(Config, ManyNumbersOnOneLineAreNoDeepKey) {
    std::string toml = "a = [";
    for (int i = 0; i < 1000; ++i) toml += "0.5, ";
    EXPECT_EQ(doc(toml + "]").root().numbers("a", kRequired).size(), 1000U);
}

// ---- overrides

TEST(ConfigOverride, ReachesKeysTablesListsAndElements) {
    const std::string base =
        "n = 1\nlist = [1, 2, 3]\n[camera]\nposition = [0, 0, 4]\n[[surface]]\nname = \"ring\"\n"
        "opacity = 1\n[[surface]]\nopacity = 0.25\n";
    const auto with = [&](const std::string& assignment) {
        Config c = doc(base);
        c.apply_override(assignment);
        return c;
    };
    EXPECT_EQ(with("n=2").root().integer("n", kRequired), 2);
    EXPECT_EQ(with("n = [1,10]").root().integers("n", kRequired), (std::vector<std::int64_t>{1, 10}));
    EXPECT_EQ(with("list.1=7").root().integers("list", kRequired), (std::vector<std::int64_t>{1, 7, 3}));
    EXPECT_EQ(with("camera.position=[0,0,3]").root().table("camera").vec3("position", kRequired),
              Vec3(0, 0, 3));
    EXPECT_EQ(with("surface.0.opacity=0.5").root().tables("surface")[0].number("opacity", kRequired), 0.5);
    EXPECT_EQ(with("surface.1.opacity=0.5").root().tables("surface")[1].number("opacity", kRequired), 0.5);
    EXPECT_EQ(with("surface.ring.opacity=0.5").root().tables("surface")[0].number("opacity", kRequired), 0.5);
    EXPECT_EQ(with("surface.\"ring\".opacity=0.5").root().tables("surface")[0].number("opacity", kRequired),
              0.5);
    EXPECT_EQ(with("a.b.c=true").root().table("a").table("b").boolean("c", kRequired), true);
    EXPECT_EQ(with("camera={position=[1,1,1]}").root().table("camera").vec3("position", kRequired), Vec3(1));
    EXPECT_EQ(with("s=\"a = b\"").root().text("s", kRequired), "a = b");
}

TEST(ConfigOverride, PlainWordsAreStrings) {
    for (const char* assignment :
         {"sampler=lines", "sampler=\"lines\"", "sampler='lines'", "sampler = lines"}) {
        Config c = doc("");
        c.apply_override(assignment);
        EXPECT_EQ(c.root().text("sampler", kRequired), "lines") << assignment;
    }
    Config c = doc("");
    c.apply_override("intermix=order-free");
    c.apply_override("file=../a/b.ply");
    EXPECT_EQ(c.root().text("intermix", kRequired), "order-free");
    EXPECT_EQ(c.root().text("file", kRequired), "../a/b.ply");
}

TEST(ConfigOverride, TheLastOneHolds) {
    Config c = doc("n = 1");
    c.apply_override("n=2");
    c.apply_override("n=3");
    EXPECT_EQ(c.root().integer("n", kRequired), 3);
}

TEST(ConfigOverride, BadOnesAreRefusedByName) {
    const auto apply = [](const std::string& assignment) {
        return refusal([&] {
            Config c = doc("n = 1\n[[surface]]\nname = \"ring\"\nopacity = 1\n");
            c.apply_override(assignment);
            c.root().integer("n", kRequired);
            for (const ConfigTable& s : c.root().tables("surface")) {
                s.text("name", kRequired);
                s.number("opacity", kRequired, within(0, 1));
            }
            c.finish();
        });
    };
    EXPECT_EQ(apply("n=2"), "");
    EXPECT_EQ(apply("m=2"), "--set m: unknown key \"m\"");
    EXPECT_EQ(apply("surface.ring.opactiy=0.5"),
              "--set surface.ring.opactiy: surface[0]: unknown key \"opactiy\", did you mean \"opacity\"?");
    EXPECT_EQ(apply("surface.ring.opacity=2"),
              "--set surface.ring.opacity: surface \"ring\": opacity = 2, expected [0, 1]");
    EXPECT_EQ(apply("surface.rung.opacity=1"),
              "--set surface.rung.opacity: no surface called \"rung\" (1 element: \"ring\")");
    EXPECT_EQ(apply("surface.1.opacity=1"),
              "--set surface.1.opacity: no surface called \"1\" (1 element: \"ring\")");
    EXPECT_EQ(apply("n.x=1"), "--set n.x: n is an integer, not a table");
    EXPECT_EQ(apply("new.table=1"), "--set new.table: unknown key \"new\"");
    for (const char* nonsense : {"n", "=1", "", ".=1", "n.=1", "n..m=1", "\"n=1", "n=", "n=two words",
                                 "n=[1,", "n=1\nm=2", "n=\"a", "n={a=1"})
        EXPECT_EQ(apply(nonsense).rfind("--set", 0), 0U) << nonsense << ": " << apply(nonsense);
}

// ---- presets

TEST(ConfigPreset, LiesOverTheBase) {
    const std::string toml =
        "n = 1\nm = 1\n[deep]\na = 1\nb = 1\n[quick]\nn = 2\ndeep.b = 2\n[paper]\nm = 3\n";
    const std::vector<std::string> names{"quick", "default", "paper"};
    const auto sum = [&](const std::string& preset) {
        Config c = doc(toml);
        c.apply_preset(preset, names);
        const ConfigTable t = c.root();
        const std::int64_t digits = 1000 * t.integer("n", kRequired) + 100 * t.integer("m", kRequired) +
                                    10 * t.table("deep").integer("a", kRequired) +
                                    t.table("deep").integer("b", kRequired);
        c.finish();
        return digits;
    };
    EXPECT_EQ(sum("default"), 1111);
    EXPECT_EQ(sum("quick"), 2112);
    EXPECT_EQ(sum("paper"), 1311);
}

TEST(ConfigPreset, KeysOfTheOthersAreCheckedToo) {
    Config c = doc("n = 1\n[paper]\nm = 3\n");
    c.apply_preset("default", std::vector<std::string>{"paper"});
    c.root().integer("n", kRequired);
    EXPECT_EQ(refusal([&] { c.finish(); }), "x.toml:3: unknown key \"m\"");
}

// ---- what was resolved

TEST(Config, ResolvedConfigHoldsValuesAndDefaults) {
    Config c = doc("x = 0.1\n[t]\nn = 3\n[[item]]\nv = [1, 2, 3]\n[[item]]\n");
    c.apply_override("t.n=4");
    const ConfigTable t = c.root();
    t.number("x", kRequired);
    t.number("y", 0.5);
    t.table("t").integer("n", kRequired);
    t.table("absent").text("s", "default");
    for (const ConfigTable& item : t.tables("item")) item.vec3("v", Vec3(0.0));
    EXPECT_EQ(nlohmann::json::parse(c.to_json()), nlohmann::json::parse(R"({"x": 0.1, "y": 0.5, "t": {"n": 4},
        "absent": {"s": "default"}, "item": [{"v": [1.0, 2.0, 3.0]}, {"v": [0.0, 0.0, 0.0]}]})"));
}

TEST(NearestName, FindsSwapsAndSlipsButNotStrangers) {
    const std::vector<std::string> known{"opacity", "color", "clip"};
    EXPECT_EQ(nearest_name("opcaity", known), "opacity");
    EXPECT_EQ(nearest_name("colour", known), "color");
    EXPECT_EQ(nearest_name("banana", known), std::nullopt);
    EXPECT_EQ(nearest_name("", known), std::nullopt);
    EXPECT_EQ(nearest_name("x", {}), std::nullopt);
}

}  // namespace
}  // namespace pellucid
