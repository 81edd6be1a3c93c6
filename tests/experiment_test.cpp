#include "harness/experiment.hpp"

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <limits>
#include <set>

#include <gtest/gtest.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include "core/error.hpp"
#include "io/image_file.hpp"

namespace pellucid {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

const char* const kConfig =
    "counts = [1, 2]\nlimit = 0.5\n[quick]\ncounts = [1]\n[paper]\ncounts = [1, 2, 3]\n";

struct Settings {
    std::vector<std::int64_t> counts;
    double limit = 0;
    std::string mode;
};

Settings read_settings(const ConfigTable& table) {
    return {table.integers("counts", kRequired, {1, 100}), table.number("limit", kRequired),
            table.one_of("mode", "plain", {"plain", "fancy"})};
}

void body(Experiment& ex) {
    const Settings settings = ex.config(read_settings);
    CsvWriter& csv = ex.csv("table", {"count", "half", "missing", "word"});
    const auto progress = ex.progress("counts", settings.counts.size());
    const auto stage = ex.stage("rows");
    for (const std::int64_t count : settings.counts) {
        csv.row(count, static_cast<double>(count) / 2, std::optional<double>{}, "a,b");
        progress->step();
    }
    Image image(2, 1);
    image.add("R", 0.5F);
    image.add("G", 0.25F);
    image.add("B", 0.125F);
    ex.image("pictures/one", image);
    ex.png("one", image, Vec3(0));
    ex.check("limit", 0.25, "<=", settings.limit);
}

/// One test's own folder, with fake.toml in it, and runs in it.
class ExperimentTest : public testing::Test {
protected:
    struct Run {
        int code = 0;
        std::string err;
    };

    void SetUp() override {
        const auto* info = testing::UnitTest::GetInstance()->current_test_info();
        folder = fs::path(testing::TempDir()) / (std::string("experiment_test_") + info->name());
        fs::remove_all(folder);
        fs::create_directories(folder);
        std::ofstream(folder / "fake.toml") << kConfig;
        out = folder / "out";
    }

    [[nodiscard]] Run run(std::vector<std::string> words,
                          const std::function<void(Experiment&)>& what = body,
                          bool reads_scene = false) const {
        words.insert(words.begin(),
                     {"fake", "--config", (folder / "fake.toml").string(), "--out", out.string()});
        return run_bare(std::move(words), what, reads_scene);
    }
    static Run run_bare(std::vector<std::string> words, const std::function<void(Experiment&)>& what = body,
                        bool reads_scene = false) {
        std::vector<char*> argv;
        for (std::string& word : words) argv.push_back(word.data());
        testing::internal::CaptureStderr();
        const int code = run_experiment(static_cast<int>(argv.size()), argv.data(),
                                        {"fake", "Is it so?", reads_scene}, what);
        return {code, testing::internal::GetCapturedStderr()};
    }
    [[nodiscard]] std::string text(const std::string& file) const {
        std::ifstream in(out / file, std::ios::binary);
        return {std::istreambuf_iterator<char>(in), {}};
    }
    [[nodiscard]] Json summary() const { return Json::parse(text("summary.json")); }
    /// Everything below the test's folder; shows left-overs.
    [[nodiscard]] std::set<std::string> tree() const {
        std::set<std::string> files;
        for (const auto& entry : fs::recursive_directory_iterator(folder))
            if (!entry.is_directory())
                files.insert(fs::relative(entry.path(), folder).string());
            else if (fs::is_empty(entry.path()))
                files.insert(fs::relative(entry.path(), folder).string() + "/");
        return files;
    }
    static void expect_one_line(const std::string& err) {
        EXPECT_EQ(err.rfind("fake: ", 0), 0U) << err;
        EXPECT_EQ(err.find('\n'), err.size() - 1) << err;
    }

    fs::path folder;
    fs::path out;
};

const std::set<std::string> kAllFiles{"fake.toml", "out/one.png", "out/pictures/one.exr", "out/summary.json",
                                      "out/table.csv"};

TEST_F(ExperimentTest, WritesTablesImagesAndSummary) {
    const Run r = run({});
    EXPECT_EQ(r.code, 0);
    EXPECT_EQ(r.err, "");
    EXPECT_EQ(tree(), kAllFiles);
    EXPECT_EQ(text("table.csv"), "count,half,missing,word\n1,0.5,,\"a,b\"\n2,1,,\"a,b\"\n");
    const Image image = read_exr(out / "pictures/one.exr");
    EXPECT_EQ(image.plane("G")[0], 0.25F);
    EXPECT_EQ(image.attributes.at("experiment"), "fake");
    EXPECT_EQ(image.attributes.at("seed"), "1");
}

TEST_F(ExperimentTest, SummaryHoldsWhatTheContractNames) {
    ASSERT_EQ(run({"--seed", "18446744073709551615", "--threads", "1", "--set", "limit=0.75"}).code, 0);
    const Json s = summary();
    EXPECT_EQ(s["experiment"], "fake");
    EXPECT_EQ(s["preset"], "default");
    EXPECT_EQ(s["seed"], 18446744073709551615U);
    EXPECT_TRUE(s["commit"].is_string());
    EXPECT_TRUE(s["host"].is_object());
    EXPECT_EQ(s["host"]["threads"], 1);
    ASSERT_EQ(s["devices"].size(), 1U);
    EXPECT_EQ(s["devices"][0]["backend"], "cpu");
    EXPECT_GE(s["wall_s"].get<double>(), 0.0);
    EXPECT_GT(s["peak_rss_bytes"].get<std::uint64_t>(), 0U);
    EXPECT_EQ(s["checks"], Json::parse(R"([{"name": "limit", "value": 0.25, "relation": "<=", "limit": 0.75,
                                            "passed": true}])"));
    EXPECT_EQ(s["files"], Json::parse(R"(["table.csv", "pictures/one.exr", "one.png"])"));
    EXPECT_EQ(s["config"], Json::parse(R"({"seed": 1, "counts": [1, 2], "limit": 0.75, "mode": "plain"})"));
    EXPECT_EQ(s["stages"][0]["name"], "rows");
}

TEST_F(ExperimentTest, PresetsLieOverTheBase) {
    const auto counts = [&](const std::string& preset) {
        EXPECT_EQ(run({"--preset", preset}).code, 0);
        EXPECT_EQ(summary()["preset"], preset);
        return summary()["config"]["counts"].get<std::vector<int>>();
    };
    EXPECT_EQ(counts("quick"), (std::vector{1}));
    EXPECT_EQ(counts("default"), (std::vector{1, 2}));
    EXPECT_EQ(counts("paper"), (std::vector{1, 2, 3}));
}

TEST_F(ExperimentTest, OverridesComeAfterThePreset) {
    EXPECT_EQ(run({"--preset", "paper", "--set", "counts=[7,8]", "--set", "mode=fancy"}).code, 0);
    EXPECT_EQ(summary()["config"]["counts"], Json::parse("[7, 8]"));
    EXPECT_EQ(summary()["config"]["mode"], "fancy");
}

TEST_F(ExperimentTest, BackendAllIsTheCpuAndVulkanOrSaysThatThereIsNone) {
    EXPECT_EQ(run({"--backend", "all"}).code, 0);
    ASSERT_EQ(summary()["devices"].size(), 2U);
    const Json vulkan = summary()["devices"][1];
    EXPECT_EQ(vulkan["backend"], "vulkan");
    EXPECT_EQ(vulkan.contains("note"), !Backend::has_vulkan());
    EXPECT_NE(vulkan["name"].get<std::string>().empty(), Backend::has_vulkan());
}

TEST_F(ExperimentTest, FailedChecksAreNamedAndResultsStillWritten) {
    const Run r = run({"--set", "limit=0.125"});
    EXPECT_EQ(r.code, 1);
    EXPECT_EQ(r.err, "fake: check failed: limit = 0.25, expected <= 0.125\n");
    EXPECT_EQ(tree(), kAllFiles);
    EXPECT_EQ(summary()["checks"][0]["passed"], false);
}

TEST_F(ExperimentTest, EachRelationIsWhatItSaysAndNanFails) {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const Run r = run({}, [&](Experiment& ex) {
        (void)ex.config(read_settings);
        ex.check("1", 1, "<=", 1);
        ex.check("2", 1, "<", 1);
        ex.check("3", 1, ">=", 1);
        ex.check("4", 1, ">", 1);
        ex.check("5", 1, "==", 1);
        ex.check("6", 1, "==", 2);
        for (const char* relation : {"<=", "<", ">=", ">", "=="}) ex.check("nan", nan, relation, 1);
        ex.check("nan", 1, "<=", nan);
    });
    EXPECT_EQ(r.code, 1);
    const Json written = summary();
    std::string passed;
    for (const Json& check : written["checks"]) passed += check["passed"].get<bool>() ? '1' : '0';
    EXPECT_EQ(passed, "101010000000");
    EXPECT_TRUE(written["checks"][6]["value"].is_null());
}

TEST_F(ExperimentTest, BadInputIsTwoOneLineAndNothingWritten) {
    std::ofstream(folder / "typo.toml") << kConfig << "counst = [3]\n";
    const std::vector<std::vector<std::string>> cases{
        {"--set", "cuonts=[1]"},
        {"--set", "counts=[0]"},
        {"--set", "limit=nan"},
        {"--set", "counts"},
        {"--set", "mode=odd"},
        {"--set", "camera.near=1"},
        {"--preset", "slow"},
        {"--seed", "x"},
        {"--set", "seed=-1"},
        {"--config", "/nonexistent"},
        {"surplus"},
    };
    for (const std::vector<std::string>& words : cases) {
        const Run r = run(words);
        EXPECT_EQ(r.code, 2) << words.back() << ": " << r.err;
        expect_one_line(r.err);
    }
    const Run typo = run_bare({"fake", "--config", (folder / "typo.toml").string(), "--out", out.string()});
    EXPECT_EQ(typo.code, 2);
    EXPECT_NE(typo.err.find("typo.toml:7: "), std::string::npos) << typo.err;
    EXPECT_EQ(tree(), (std::set<std::string>{"fake.toml", "typo.toml"}));
}

TEST_F(ExperimentTest, UnknownOverridesAreNamed) {
    EXPECT_NE(run({"--set", "cuonts=[1]"})
                  .err.find("--set cuonts: unknown key \"cuonts\", did you mean \"counts\"?"),
              std::string::npos);
    EXPECT_NE(run({"--set", "camera.near=1"}).err.find("--set camera.near"), std::string::npos);
}

TEST_F(ExperimentTest, AbsentDevicesAreThree) {
    for (const std::vector<std::string>& words :
         {std::vector<std::string>{"--backend", "vulkan", "--device", "none"},
          {"--backend", "all", "--device", "none"}}) {
        const Run r = run(words);
        EXPECT_EQ(r.code, 3);
        expect_one_line(r.err);
    }
    EXPECT_EQ(tree(), std::set<std::string>{"fake.toml"});
}

TEST_F(ExperimentTest, AFailureLeavesOldResultsAsTheyWere) {
    ASSERT_EQ(run({}).code, 0);
    const std::string table = text("table.csv");
    const std::string old_summary = text("summary.json");
    const std::vector<std::pair<int, std::function<void(Experiment&)>>> failures{
        {4, [](Experiment&) { throw std::runtime_error("half way"); }},
        {4, [](Experiment&) { throw std::bad_alloc(); }},
        {2, [](Experiment&) { throw input_error("mesh.ply: empty"); }},
        {3, [](Experiment&) { throw Error(Failure::device, "gone"); }},
        {4,
         [](Experiment& ex) {
             ex.csv("table2", {"a", "b"}).row(1);
         }},
        {4, [](Experiment& ex) { (void)ex.csv("table", {"a"}); }},
        {4, [](Experiment& ex) { (void)ex.csv("../escape", {"a"}); }},
        {4, [](Experiment& ex) { ex.json("summary", "{}"); }},
        {4, [](Experiment& ex) { ex.check("a", 1, "~", 1); }},
    };
    for (const auto& [code, failure] : failures) {
        const Run r = run({}, [&](Experiment& ex) {
            body(ex);
            failure(ex);
        });
        EXPECT_EQ(r.code, code) << r.err;
        expect_one_line(r.err);
        EXPECT_EQ(tree(), kAllFiles);
        EXPECT_EQ(text("table.csv"), table);
        EXPECT_EQ(text("summary.json"), old_summary);
    }
}

TEST_F(ExperimentTest, StaleFilesGoOnlyIfTheOldRunWroteThem) {
    ASSERT_EQ(run({}).code, 0);
    std::ofstream(out / "notes.txt") << "mine";
    std::ofstream(folder / "outside.txt") << "mine";
    // A summary that names what is not its own is not believed.
    Json forged = summary();
    forged["files"].push_back("../outside.txt");
    forged["files"].push_back((folder / "outside.txt").string());
    forged["files"].push_back(7);
    std::ofstream(out / "summary.json") << forged.dump();
    EXPECT_EQ(run({},
                  [](Experiment& ex) {
                      (void)ex.config(read_settings);
                      ex.json("other", "{}");
                  })
                  .code,
              0);
    EXPECT_TRUE(fs::exists(out / "notes.txt"));
    EXPECT_TRUE(fs::exists(folder / "outside.txt"));
    EXPECT_TRUE(fs::exists(out / "other.json"));
    EXPECT_FALSE(fs::exists(out / "table.csv"));
    EXPECT_FALSE(fs::exists(out / "pictures/one.exr"));
}

TEST_F(ExperimentTest, OldSummariesThatAreNoneDoNoHarm) {
    for (const char* old : {"", "{", "[]", "{\"files\": 3}", "\xff\xff"}) {
        fs::create_directories(out);
        std::ofstream(out / "summary.json") << old;
        EXPECT_EQ(run({}).code, 0) << old;
        EXPECT_EQ(tree(), kAllFiles);
    }
}

TEST_F(ExperimentTest, OutThatIsAFileIsTwo) {
    std::ofstream(out) << "mine";
    const Run r = run({});
    EXPECT_EQ(r.code, 2);
    expect_one_line(r.err);
    std::ifstream in(out);
    EXPECT_EQ(std::string(std::istreambuf_iterator<char>(in), {}), "mine");
}

TEST_F(ExperimentTest, OutThatCannotBeMadeIsFour) {
    std::vector<std::string> outs{(folder / "fake.toml/below").string(),
                                  (folder / "fake.toml/far/below").string(), "/proc/no/results"};
    if (geteuid() != 0) {
        fs::create_directories(folder / "closed");
        fs::permissions(folder / "closed", fs::perms::owner_read);
        outs.push_back((folder / "closed/out").string());
    }
    for (const std::string& bad : outs) {
        const Run r = run_bare({"fake", "--config", (folder / "fake.toml").string(), "--out", bad});
        EXPECT_EQ(r.code, 4) << bad;
        expect_one_line(r.err);
    }
}

TEST_F(ExperimentTest, MissingParentsOfOutAreMade) {
    out = folder / "not/yet/there";
    EXPECT_EQ(run({"--set", "cuonts=[1]"}).code, 2);
    EXPECT_EQ(tree(), std::set<std::string>{"fake.toml"});  // and go again where the run fails
    const Run r = run({});
    EXPECT_EQ(r.code, 0) << r.err;
    EXPECT_EQ(summary()["preset"], "default");
    EXPECT_TRUE(fs::exists(out / "table.csv"));
}

TEST_F(ExperimentTest, OutMayEndWithASlashOrBeALink) {
    EXPECT_EQ(
        run_bare({"fake", "--config", (folder / "fake.toml").string(), "--out", out.string() + "/"}).code, 0);
    fs::rename(out, folder / "elsewhere");
    fs::create_directory_symlink(folder / "elsewhere", out);
    EXPECT_EQ(run({}).code, 0);
    EXPECT_TRUE(fs::is_symlink(out));
    EXPECT_EQ(summary()["preset"], "default");
}

TEST_F(ExperimentTest, SceneOverridesReachTheScene) {
    std::ofstream(folder / "s.toml") << "image.resolution = [8, 8]\ncamera.position = [0, 0, 4]\n";
    const auto width = [&](const std::vector<std::string>& words) {
        int found = 0;
        const Run r = run(words, [&](Experiment& ex) {
            (void)ex.config(read_settings);
            found = ex.scene(folder / "s.toml").image.width;
        }, true);
        return r.code == 0 ? found : -r.code;
    };
    EXPECT_EQ(width({}), 8);
    EXPECT_EQ(width({"--set", "image.resolution=[32,32]"}), 32);
    EXPECT_EQ(width({"--set", "image.resolutoin=[32,32]"}), -2);
}

TEST_F(ExperimentTest, SceneOverridesWithoutASceneAreRefusedBeforeTheRun) {
    bool ran = false;
    const Run r = run({"--set", "surface.ring.opacity=1"}, [&](Experiment&) { ran = true; });
    EXPECT_EQ(r.code, 2);
    EXPECT_NE(r.err.find("--set surface.ring.opacity: "), std::string::npos) << r.err;
    EXPECT_FALSE(ran);
}

TEST_F(ExperimentTest, SeedComesFromTheOptionThenTheConfigThenOne) {
    const auto seed = [&](const std::vector<std::string>& words) {
        EXPECT_EQ(run(words).code, 0);
        return summary()["seed"].get<int>();
    };
    EXPECT_EQ(seed({}), 1);
    EXPECT_EQ(seed({"--set", "seed=5"}), 5);
    EXPECT_EQ(seed({"--set", "seed=5", "--seed", "7"}), 7);
}

TEST_F(ExperimentTest, WithoutAConfigItSaysWhereItLooked) {
    const Run r = run_bare({"fake", "--out", out.string()});
    EXPECT_EQ(r.code, 2);
    EXPECT_NE(r.err.find("configs/fake.toml"), std::string::npos);
}

TEST(CsvCell, NumbersReadBackAsTheSameBits) {
    for (const double x : {0.1, 1.0 / 3, 1e-308, 5e-324, 1.7976931348623157e308, -0.0, 123456789.125})
        EXPECT_EQ(std::strtod(csv_cell(x).c_str(), nullptr), x) << csv_cell(x);
    EXPECT_EQ(csv_cell(0.1), "0.1");
    EXPECT_EQ(csv_cell(0.1F), "0.1");
    EXPECT_EQ(csv_cell(3), "3");
    EXPECT_EQ(csv_cell(std::size_t{7}), "7");
    EXPECT_EQ(csv_cell(true), "true");
    EXPECT_EQ(csv_cell(std::optional<int>{}), "");
    EXPECT_EQ(csv_cell(std::optional<int>{4}), "4");
    EXPECT_EQ(csv_cell("plain"), "plain");
    EXPECT_EQ(csv_cell("say \"a\",\nb"), "\"say \"\"a\"\",\nb\"");
}

}  // namespace
}  // namespace pellucid
