// The command slabs-merge from end to end.
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

namespace pellucid {
namespace {

namespace fs = std::filesystem;

class SlabsMergeCommand : public testing::Test {
protected:
    struct Result {
        int code = -1;
        std::string out, err;
    };

    void SetUp() override {
        const auto* test = testing::UnitTest::GetInstance()->current_test_info();
        folder_ = fs::path(testing::TempDir()) / fmt::format("pellucid_{}_{}", test->test_suite_name(), test->name());
        fs::remove_all(folder_);
        fs::create_directories(folder_);
        put("red.csv", "z,d,r,g,b,a\n2,2,0.5,0,0,0.5\n");
        put("green.csv", "3,2,0,0.5,0,0.5\n");
        put("blue.csv", "a,b,g,r,d,z\n1,1,0,0,0,1.5\n");
    }
    void TearDown() override { fs::remove_all(folder_); }

    void put(const std::string& name, const std::string& text) const { std::ofstream(folder_ / name) << text; }
    [[nodiscard]] std::string get(const std::string& name) const {
        std::ifstream in(folder_ / name, std::ios::binary);
        return {std::istreambuf_iterator<char>(in), {}};
    }
    [[nodiscard]] Result run(const std::string& arguments) const {
        const std::string command = fmt::format("cd '{}' && timeout 60 '{}/slabs-merge' {} > out 2> err", folder_.string(),
                                                PELLUCID_BIN_DIR, arguments);
        const int status = std::system(command.c_str());
        return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, get("out"), get("err")};
    }
    void refused(const std::string& arguments, const std::string& word) const {
        const Result r = run(arguments);
        EXPECT_EQ(r.code, 2) << arguments;
        EXPECT_TRUE(r.out.empty());
        EXPECT_EQ(std::count(r.err.begin(), r.err.end(), '\n'), 1) << r.err;
        EXPECT_NE(r.err.find(word), std::string::npos) << r.err;
    }
    void refused_file(const std::string& text, const std::string& word) const {
        put("bad.csv", text);
        refused("red.csv bad.csv -o o.csv", word);
        EXPECT_FALSE(fs::exists(folder_ / "o.csv"));
    }

private:
    fs::path folder_;
};

// Worked out in slab_kernel_test.cpp, PartialOverlap.
TEST_F(SlabsMergeCommand, MergesTwoArrays) {
    const Result r = run("red.csv green.csv");
    EXPECT_EQ(r.code, 0) << r.err;
    EXPECT_EQ(r.out, "z,d,r,g,b,a\n2,2,0.46875,0.15625,0,0.625\n3,1,0,0.33333334,0,0.33333334\n");
    EXPECT_EQ(run("green.csv red.csv").out, r.out);
    EXPECT_EQ(run("red.csv green.csv --intermix hybrid").out, r.out);
    EXPECT_EQ(run("red.csv green.csv --layers 3").out, r.out);
    EXPECT_EQ(run("red.csv green.csv -o o.csv").out, "");
    EXPECT_EQ(get("o.csv"), r.out);
}

TEST_F(SlabsMergeCommand, LayersAndComposite) {
    EXPECT_EQ(run("red.csv green.csv --composite").out, "z,d,r,g,b,a\n3,3,0.46875,0.28125,0,0.75\n");
    for (const char* compression : {"tail", "slope", "transmittance"})
        for (const char* how : {"", "--streaming"})
            EXPECT_EQ(run(fmt::format("red.csv green.csv --layers 2 --compression {} {}", compression, how)).out,
                      run("red.csv green.csv --composite").out);
}

TEST_F(SlabsMergeCommand, StreamingSeesNoSlabBeforeItComes) {
    std::string ray;
    for (int i = 1; i <= 40; ++i) ray += fmt::format("{},1,0,0,0,{}\n", i, i % 7 == 0 ? 0.5 : 0.01 * (i % 5));
    put("ray.csv", ray);
    const auto rows = [](const std::string& text) { return std::count(text.begin(), text.end(), '\n') - 1; };
    const std::string whole = run("ray.csv --layers 6").out, streamed = run("ray.csv --layers 6 --streaming").out;
    EXPECT_EQ(rows(whole), 5);
    EXPECT_EQ(rows(streamed), 5);
    EXPECT_NE(whole, streamed);
    EXPECT_EQ(run("ray.csv --layers 41 --streaming").out, run("ray.csv").out);
}

TEST_F(SlabsMergeCommand, EveryRuleIsReached) {
    put("pale.csv", "3,2,0,0.25,0,0.25\n");
    std::vector<std::string> seen;
    for (const char* interpolation : {"modified", "original"})
        for (const char* mixing : {"average", "normalised", "extinction"})
            for (const char* intermix : {"image", "order-free"}) {
                const Result r = run(fmt::format("red.csv pale.csv --interpolation {} --mixing {} --intermix {}",
                                                 interpolation, mixing, intermix));
                EXPECT_EQ(r.code, 0) << r.err;
                seen.push_back(r.out);
            }
    std::sort(seen.begin(), seen.end());
    EXPECT_EQ(std::unique(seen.begin(), seen.end()) - seen.begin(), 12);
    EXPECT_EQ(run("red.csv --interpolation original-textbook").code, 0);
}

TEST_F(SlabsMergeCommand, OrderFreeForgetsTheOrder) {
    const std::string first = run("red.csv green.csv blue.csv --intermix order-free").out;
    EXPECT_EQ(run("blue.csv red.csv green.csv --intermix order-free").out, first);
    EXPECT_NE(first.find("\n1.5,0,0,0,1,1\n"), std::string::npos) << first;
}

TEST_F(SlabsMergeCommand, UnsortedAndOverlappingRowsAreInserted) {
    put("both.csv", "z,d,r,g,b,a\n3,2,0,0.5,0,0.5\n2,2,0.5,0,0,0.5\n");
    EXPECT_EQ(run("both.csv").out, run("red.csv green.csv").out);
}

TEST_F(SlabsMergeCommand, NothingIsAnEmptyTable) {
    put("empty.csv", "z,d,r,g,b,a\n");
    EXPECT_EQ(run("empty.csv").out, "z,d,r,g,b,a\n");
    EXPECT_EQ(run("red.csv empty.csv").out, "z,d,r,g,b,a\n2,2,0.5,0,0,0.5\n");
}

TEST_F(SlabsMergeCommand, RefusesInOneLine) {
    refused_file("z,d,r,g,b\n1,1,0,0,0\n", "bad.csv:1: no column \"a\"");
    refused_file("z,d,r,g,b,a,q\n", "bad.csv:1: column \"q\"");
    refused_file("z,d,r,g,b,z\n", "bad.csv:1: column \"z\" twice");
    refused_file("1,1,0,0,0\n", "bad.csv:1: 5 cells");
    refused_file("z,d,r,g,b,a\n1,1,0,0,0,nan\n", "bad.csv:2: a = nan");
    refused_file("1,1,0,0,0,1.5\n", "bad.csv:1: a = 1.5");
    refused_file("1,1,0,0,0,-0.1\n", "bad.csv:1: a = -0.1");
    refused_file("1,1,0,0,0,1\n\n1,-1,0,0,0,1\n", "bad.csv:3: d = -1");
    refused_file("1,1,inf,0,0,1\n", "bad.csv:1: r = inf");
    refused_file("1,1,-1,0,0,1\n", "bad.csv:1: r = -1");
    refused_file("1,one,0,0,0,1\n", "bad.csv:1: d = one");
    refused_file("1,,0,0,0,1\n", "bad.csv:1: d = nothing");
    refused_file("1e99,1,0,0,0,1\n", "bad.csv:1: z = 1e99");
    refused_file("", "bad.csv");
    refused("none.csv", "none.csv");
    refused("", "FILE");
    refused("red.csv --layers 1", "--layers = 1");
    refused("red.csv --layers 1000000", "--layers = 1000000");
    refused("red.csv --mixing salt", "--mixing");
    refused("red.csv --opaque-at nan", "--opaque-at");
}

}  // namespace
}  // namespace pellucid
