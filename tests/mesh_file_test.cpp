#include "io/mesh_file.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <functional>
#include <random>

#include <gtest/gtest.h>

#include "core/error.hpp"

namespace pellucid {
namespace {

namespace fs = std::filesystem;

fs::path folder() {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    fs::path path = fs::path(testing::TempDir()) /
                    (std::string("pellucid_") + info->test_suite_name() + "_" + info->name());
    fs::remove_all(path);
    fs::create_directories(path);
    return path;
}

fs::path put(const fs::path& file, const std::string& bytes) {
    std::ofstream(file, std::ios::binary) << bytes;
    return file;
}

// The one line of the Error(input); empty where the mesh is read.
std::string refusal(const fs::path& file) {
    try {
        (void)read_mesh(file);
    } catch (const Error& error) {
        EXPECT_EQ(error.kind(), Failure::input) << error.what();
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
        EXPECT_NE(std::string(error.what()).find(file.filename().string()), std::string::npos)
            << error.what();
        return error.what();
    }
    return "";
}

bool says(const std::string& message, const std::string& part) {
    return message.find(part) != std::string::npos;
}

Vec3 area_vector(const TriangleMesh& mesh) {
    Vec3 sum(0.0);
    for (const auto& t : mesh.triangles)
        sum += 0.5 * cross(mesh.positions[t[1]] - mesh.positions[t[0]],
                           mesh.positions[t[2]] - mesh.positions[t[0]]);
    return sum;
}

std::string ply(const std::string& vertices, int vertex_count, const std::string& faces, int face_count,
                const std::string& more = "") {
    return "ply\nformat ascii 1.0\ncomment a test\nelement vertex " + std::to_string(vertex_count) +
           "\nproperty float x\nproperty float y\nproperty float z\n" + more + "element face " +
           std::to_string(face_count) + "\nproperty list uchar int vertex_indices\nend_header\n" + vertices +
           faces;
}

// A unit square and a vertex that no face uses, in the middle of the list.
const std::string kSquare = "0 0 0\n1 0 0\n9 9 9\n1 1 0\n0 1 0\n";

template <class T>
void append(std::string& bytes, T value, bool big_endian) {
    char raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof(T));
    if (big_endian) std::reverse(raw, raw + sizeof(T));
    bytes.append(raw, sizeof(T));
}

std::string binary_square(bool big_endian) {
    std::string bytes = ply("", 5, "", 1);
    bytes.replace(bytes.find("ascii"), 5, big_endian ? "binary_big_endian" : "binary_little_endian");
    for (const int x : {0, 0, 0, 1, 0, 0, 9, 9, 9, 1, 1, 0, 0, 1, 0})
        append(bytes, static_cast<float>(x), big_endian);
    append(bytes, std::uint8_t{4}, big_endian);
    for (const std::int32_t i : {0, 1, 3, 4}) append(bytes, i, big_endian);
    return bytes;
}

std::string binary_stl(const std::vector<std::array<float, 9>>& triangles) {
    std::string bytes(80, ' ');
    bytes.replace(0, 5, "solid");  // some writers do
    append(bytes, static_cast<std::uint32_t>(triangles.size()), false);
    for (const auto& triangle : triangles) {
        for (int i = 0; i < 3; ++i) append(bytes, 0.0F, false);
        for (const float x : triangle) append(bytes, x, false);
        append(bytes, std::uint16_t{0}, false);
    }
    return bytes;
}

const std::string kTextStl =
    "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\n"
    "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 1 0\nvertex -0 1 0\nendloop\nendfacet\nendsolid "
    "x\n";

TEST(Mesh, EveryFormatReadsTheSameSquare) {
    const fs::path dir = folder();
    const std::vector<fs::path> files = {
        put(dir / "text.ply", ply(kSquare, 5, "4 0 1 3 4\n", 1)),
        put(dir / "little.ply", binary_square(false)),
        put(dir / "big.PLY", binary_square(true)),
        put(dir / "a.off", "OFF # square\n5 1 0\n" + kSquare + "4 0 1 3 4 255 0 0\n"),
        put(dir / "a.obj", "v 0 0 0\nv 1 0 0\nv 9 9 9\nv 1 1 0\nv 0 1 0\n# a # b\nf 1 2 -2 \\\n -1 # c\n"),
        put(dir / "text.stl", kTextStl),
        put(dir / "binary.stl", binary_stl({{0, 0, 0, 1, 0, 0, 1, 1, 0}, {0, 0, 0, 1, 1, 0, 0, 1, 0}})),
    };
    for (const fs::path& file : files) {
        SCOPED_TRACE(file.filename().string());
        const TriangleMesh mesh = read_mesh(file);
        const bool keeps_order = file.extension() != ".obj" && file.extension() != ".stl";
        ASSERT_EQ(mesh.positions.size(), keeps_order ? 5U : 4U);
        if (keeps_order) {
            EXPECT_EQ(mesh.positions[2], Vec3(9, 9, 9));
        }
        EXPECT_EQ(mesh.triangles.size(), 2U);
        EXPECT_EQ(area_vector(mesh), Vec3(0, 0, 1));  // counter-clockwise: +z
        EXPECT_TRUE(mesh.normals.empty());
    }
}

TEST(Mesh, ConcavePolygonKeepsItsArea) {
    // an arrow head of area 10, from each corner
    const std::vector<std::string> corners = {"1", "2", "3", "4", "5"};
    for (std::size_t first = 0; first < 5; ++first) {
        std::string face = "f";
        for (std::size_t i = 0; i < 5; ++i) face += " " + corners[(first + i) % 5];
        const TriangleMesh mesh =
            read_mesh(put(folder() / "a.obj", "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0\nv 0 4 0\n" + face + "\n"));
        EXPECT_EQ(mesh.triangles.size(), 3U);
        double sum = 0;  // of absolute areas: none is turned round or overlaps
        for (const auto& t : mesh.triangles)
            sum += 0.5 * length(cross(mesh.positions[t[1]] - mesh.positions[t[0]],
                                      mesh.positions[t[2]] - mesh.positions[t[0]]));
        EXPECT_DOUBLE_EQ(sum, 10.0);
        EXPECT_DOUBLE_EQ(area_vector(mesh).z, 10.0);
    }
}

TEST(Mesh, NormalsOfTheFileAreKeptAndMadeUnit) {
    const fs::path dir = folder();
    const std::string normals = "property float nx\nproperty float ny\nproperty float nz\n";
    const TriangleMesh mesh = read_mesh(
        put(dir / "a.ply", ply("0 0 0 0 0 2\n1 0 0 3 0 0\n0 1 0 0 -1 0\n", 3, "3 0 1 2\n", 1, normals)));
    ASSERT_EQ(mesh.normals.size(), 3U);
    EXPECT_EQ(mesh.normals[0], Vec3(0, 0, 1));
    EXPECT_EQ(mesh.normals[1], Vec3(1, 0, 0));
    EXPECT_EQ(mesh.normals[2], Vec3(0, -1, 0));
    // one vertex with two normals is two; one normal of three is none
    const std::string vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvn 0 -1 0\n";
    EXPECT_EQ(read_mesh(put(dir / "crease.obj", vertices + "f 1//1 2//1 3//1\nf 1//2 2//2 4//2\n"))
                  .positions.size(),
              6U);
    const TriangleMesh some = read_mesh(put(dir / "some.obj", vertices + "f 1//1 2//1 3//1\nf 1 2 4\n"));
    EXPECT_TRUE(some.normals.empty());
    EXPECT_EQ(some.positions.size(), 4U);
    EXPECT_TRUE(read_mesh(put(dir / "zero.ply",
                              ply("0 0 0 0 0 0\n1 0 0 3 0 0\n0 1 0 0 -1 0\n", 3, "3 0 1 2\n", 1, normals)))
                    .normals.empty());
}

TEST(Mesh, SeveralGroupsBecomeOne) {
    const TriangleMesh mesh = read_mesh(
        put(folder() / "a.obj",
            "o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\no b\nv 1 1 0\ng c\nusemtl m\nf 2 4 3\nl 1 4\n"));
    EXPECT_EQ(mesh.triangles.size(), 2U);
    EXPECT_EQ(mesh.positions.size(), 4U);
}

TEST(Mesh, DegenerateTrianglesAreLeftOut) {
    const fs::path dir = folder();
    EXPECT_EQ(
        read_mesh(put(dir / "a.ply", ply(kSquare, 5, "3 0 1 3\n3 0 0 1\n3 1 1 1\n", 3))).triangles.size(),
        1U);
    EXPECT_EQ(read_mesh(put(dir / "tiny.ply", ply("0 0 0\n1e-30 0 0\n0 1e-30 0\n", 3, "3 0 1 2\n", 1)))
                  .triangles.size(),
              1U);
    EXPECT_TRUE(says(refusal(put(dir / "line.ply", ply("0 0 0\n1 1 1\n2 2 2\n", 3, "3 0 1 2\n", 1))),
                     "no triangle with an area"));
}

TEST(Mesh, IndexOutOfRangeIsNamed) {
    const fs::path dir = folder();
    EXPECT_TRUE(says(refusal(put(dir / "a.ply", ply(kSquare, 5, "3 0 1 5\n", 1))), "index 5 out of range"));
    EXPECT_TRUE(says(refusal(put(dir / "b.ply", ply(kSquare, 5, "3 0 -1 2\n", 1))), "index -1 out of range"));
    EXPECT_TRUE(
        says(refusal(put(dir / "a.off", "OFF\n5 1 0\n" + kSquare + "3 0 1 7\n")), "index 7 out of range"));
    for (const std::string face : {"f 1 2 4", "f 1 2 -4", "f 0 1 2", "f 1//1 2//1 3//2", "f 1/1 2/1 3/1"}) {
        const std::string message =
            refusal(put(dir / "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\n" + face + "\n"));
        EXPECT_TRUE(says(message, "out of range") && says(message, "a.obj:5")) << message;
    }
}

TEST(Mesh, LyingCountsAreRefused) {
    const fs::path dir = folder();
    EXPECT_TRUE(
        says(refusal(put(dir / "a.ply", ply(kSquare, 5, "3 0 1 3\n", 1'000'000'000))), "claims 1000000000"));
    EXPECT_TRUE(says(refusal(put(dir / "b.ply", ply(kSquare, 5, "3 0 1 3\n", 2))), "cut short"));
    EXPECT_TRUE(says(refusal(put(dir / "a.off", "OFF\n5 1000000000 0\n" + kSquare + "3 0 1 3\n")), "claims"));
    EXPECT_TRUE(says(refusal(put(dir / "b.off", "OFF\n5 2 0\n" + kSquare + "3 0 1 3\n")), "cut short"));
    std::string stl = binary_stl({{0, 0, 0, 1, 0, 0, 1, 1, 0}});
    stl.replace(0, 5, "     ");
    stl.replace(80, 4, "\xff\xff\xff\x7f");
    EXPECT_NE(refusal(put(dir / "a.stl", stl)), "");
    EXPECT_TRUE(says(refusal(put(dir / "b.stl", kTextStl.substr(0, 150))), "cut short"));
    for (const bool big : {false, true}) {
        const std::string whole = binary_square(big);
        EXPECT_TRUE(says(refusal(put(dir / "c.ply", whole.substr(0, whole.size() - 1))), "cut short"));
    }
}

TEST(Mesh, CoordinatesMustBeFinite) {
    const fs::path dir = folder();
    for (const std::string bad : {"nan", "inf", "-inf", "1e300"})
        EXPECT_NE(refusal(put(dir / "a.ply", ply("0 0 0\n1 " + bad + " 0\n0 1 0\n", 3, "3 0 1 2\n", 1))), "")
            << bad;
    EXPECT_NE(refusal(put(dir / "a.obj", "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n")), "");
    const float nan = std::nanf("");
    EXPECT_TRUE(says(refusal(put(dir / "a.stl", binary_stl({{0, 0, 0, 1, nan, 0, 1, 1, 0}}))), "finite"));
    EXPECT_TRUE(says(refusal(put(dir / "b.ply", ply("0 0 0\n1 x 0\n0 1 0\n", 3, "3 0 1 2\n", 1))),
                     "expected a number"));
}

TEST(Mesh, WrongFilesAreRefusedInOneLine) {
    const fs::path dir = folder();
    EXPECT_TRUE(says(refusal(dir / "none.ply"), "no such file"));
    fs::create_directory(dir / "folder.ply");
    EXPECT_TRUE(says(refusal(dir / "folder.ply"), "directory"));
    EXPECT_TRUE(says(refusal(put(dir / "a.txt", "x")), ".ply, .obj, .off or .stl"));
    EXPECT_TRUE(says(refusal(put(dir / "points.ply", ply(kSquare, 5, "", 0))), "0 faces"));
    std::mt19937 random(3);
    std::string garbage(5000, ' ');
    for (char& c : garbage) c = static_cast<char>(random());
    for (const std::string extension : {".ply", ".obj", ".off", ".stl"}) {
        EXPECT_TRUE(says(refusal(put(dir / ("empty" + extension), "")), "is empty"));
        EXPECT_NE(refusal(put(dir / ("garbage" + extension), garbage)), "");
        EXPECT_NE(refusal(put(dir / ("long" + extension), std::string(10'000'000, 'v'))), "");
    }
}

// Flipped bytes and cut ends: success or Error(input), nothing else.
TEST(Mesh, DamageNeverDoesMoreThanAnError) {
    const fs::path dir = folder();
    const std::vector<std::pair<std::string, std::string>> files = {
        {"text.ply", ply(kSquare, 5, "4 0 1 3 4\n3 0 1 2\n", 2)},
        {"little.ply", binary_square(false)},
        {"big.ply", binary_square(true)},
        {"a.off", "OFF\n5 2 0\n" + kSquare + "4 0 1 3 4\n3 0 1 2\n"},
        {"a.obj",
         "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvn 0 0 1\nvt 0 0\nf 1//1 2//1 3//1\nf 2/1/1 4/1/1 3/1/1\ng "
         "x\n"},
        {"text.stl", kTextStl},
        {"binary.stl", binary_stl({{0, 0, 0, 1, 0, 0, 1, 1, 0}, {0, 0, 0, 1, 1, 0, 0, 1, 0}})},
    };
    std::mt19937 random(11);
    int refused = 0;
    for (const auto& [name, whole] : files)
        for (int i = 0; i < 300; ++i) {
            std::string damaged = whole;
            if (i % 3 == 0) damaged.resize(random() % damaged.size());
            for (std::size_t flips = i % 3 == 0 ? 0 : 1 + random() % 3; flips > 0; --flips) {
                // half of the flips stay text, which gets further
                const char byte =
                    i % 2 == 0 ? static_cast<char>(random()) : "0123456789-. \n/ef"[random() % 17];
                damaged[random() % damaged.size()] = byte;
            }
            SCOPED_TRACE(name + " " + std::to_string(i));
            refused += refusal(put(dir / name, damaged)).empty() ? 0 : 1;
        }
    EXPECT_GE(refused, 300);
}

struct Known {
    const char* name;
    std::size_t vertices;
    std::size_t triangles;  // with those of no area
    double extent;
    bool normals;
};

TEST(Mesh, RealMeshesHaveTheirCountsAndExtents) {
    const fs::path data = fs::path(PELLUCID_SOURCE_DIR) / "../shared/data/meshes";
    if (!fs::exists(data)) GTEST_SKIP() << "no " << data;
    for (const Known& known : {Known{"bunny.ply", 35947, 69451, 0.1557, false},
                               {"teapot.obj", 5600, 10920, 1.608, false},
                               {"klein8.off", 2256, 4608, 6.488, false},
                               {"organ_brain.ply", 29604, 59204, 174.3, true},
                               {"organ_skull.ply", 65105, 130510, 191.1, true},
                               {"organ_cortex.ply", 56231, 111706, 179.7, true},
                               {"frog_skeleton.ply", 60118, 120028, 448.2, true},
                               {"frog_liver.ply", 13566, 27128, 138.2, true},
                               {"frog_heart.ply", 2844, 5680, 68.37, true},
                               {"frog_lung.ply", 4298, 8588, 121.6, true},
                               {"frog_stomach.ply", 19603, 39362, 202.4, true}}) {
        SCOPED_TRACE(known.name);
        const TriangleMesh mesh = read_mesh(data / known.name);
        Box box;
        for (const Vec3& p : mesh.positions) box.include(p);
        const Vec3 size = box.size();
        EXPECT_EQ(mesh.positions.size(), known.vertices);
        EXPECT_LE(mesh.triangles.size(), known.triangles);
        EXPECT_GE(mesh.triangles.size() + 6, known.triangles);
        EXPECT_NEAR(std::max({size.x, size.y, size.z}), known.extent, 5e-4 * known.extent);  // four digits
        EXPECT_EQ(mesh.normals.size(), known.normals ? known.vertices : 0U);
    }
}

}  // namespace
}  // namespace pellucid
