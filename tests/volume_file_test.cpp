#include "io/volume_file.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <zlib.h>

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

std::string gzip(const std::string& bytes) {
    z_stream stream{};
    deflateInit2(&stream, 9, Z_DEFLATED, 15 + 16, 9, Z_DEFAULT_STRATEGY);
    std::string out(deflateBound(&stream, bytes.size()), '\0');
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    stream.avail_in = static_cast<uInt>(bytes.size());
    stream.next_out = reinterpret_cast<Bytef*>(out.data());
    stream.avail_out = static_cast<uInt>(out.size());
    deflate(&stream, Z_FINISH);
    out.resize(stream.total_out);
    deflateEnd(&stream);
    return out;
}

// The one line of the Error(input); empty where the volume is read.
std::string refusal(const fs::path& file) {
    try {
        (void)read_volume(file);
    } catch (const Error& error) {
        EXPECT_EQ(error.kind(), Failure::input) << error.what();
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
        EXPECT_NE(std::string(error.what()).find(file.filename().string().substr(0, 1)), std::string::npos);
        return error.what();
    }
    return "";
}

bool says(const std::string& message, const std::string& part) {
    return message.find(part) != std::string::npos;
}

template <class T>
std::string samples(std::size_t count, bool big_endian = false) {
    std::string bytes;
    for (std::size_t i = 0; i < count; ++i) {
        const T value = static_cast<T>(i + 1);
        char raw[sizeof(T)];
        std::memcpy(raw, &value, sizeof(T));
        if (big_endian) std::reverse(raw, raw + sizeof(T));
        bytes.append(raw, sizeof(T));
    }
    return bytes;
}

void expect_counting(const VoxelGrid& grid) {
    ASSERT_EQ(grid.size, (std::array<int, 3>{4, 3, 2}));
    ASSERT_EQ(grid.values.size(), 24U);
    for (std::size_t i = 0; i < 24; ++i) EXPECT_EQ(grid.values[i], static_cast<float>(i + 1));
    EXPECT_EQ(grid.at(1, 2, 1), static_cast<float>(1 + 4 * 2 + 12 + 1));
}

// -- NRRD -------------------------------------------------------------------------------------

std::string nrrd(const std::string& type, const std::string& encoding, const std::string& more = "",
                 const std::string& sizes = "4 3 2", int dimension = 3) {
    return "NRRD0004\n# a test\ntype: " + type + "\ndimension: " + std::to_string(dimension) +
           "\nsizes: " + sizes + "\nencoding: " + encoding + "\nendian: little\n" + more + "\n";
}

TEST(Nrrd, EveryTypeEncodingAndEndianReadsTheSame) {
    const fs::path dir = folder();
    const auto check = [&](const std::string& type, const std::string& little, const std::string& big) {
        SCOPED_TRACE(type);
        std::string big_header = nrrd(type, "raw");
        big_header.replace(big_header.find("little"), 6, "big");
        expect_counting(read_volume(put(dir / "a.nrrd", nrrd(type, "raw") + little)));
        expect_counting(read_volume(put(dir / "a.nrrd", big_header + big)));
        expect_counting(read_volume(put(dir / "a.nrrd", nrrd(type, "gzip") + gzip(little))));
        put(dir / "a.raw", "one\ntwo\nxx" + little);
        expect_counting(read_volume(
            put(dir / "a.nhdr", nrrd(type, "raw", "line skip: 2\nbyte skip: 2\ndata file: a.raw\n"))));
        expect_counting(
            read_volume(put(dir / "a.nhdr", nrrd(type, "raw", "byte skip: -1\ndata file: ./a.raw\n"))));
        std::string text;
        for (int i = 1; i <= 24; ++i) text += std::to_string(i) + (i % 4 == 0 ? "\n" : " ");
        expect_counting(read_volume(put(dir / "a.nrrd", nrrd(type, "ascii") + text)));
    };
    check("int8", samples<std::int8_t>(24), samples<std::int8_t>(24, true));
    check("uchar", samples<std::uint8_t>(24), samples<std::uint8_t>(24, true));
    check("short", samples<std::int16_t>(24), samples<std::int16_t>(24, true));
    check("uint16", samples<std::uint16_t>(24), samples<std::uint16_t>(24, true));
    check("int", samples<std::int32_t>(24), samples<std::int32_t>(24, true));
    check("uint32", samples<std::uint32_t>(24), samples<std::uint32_t>(24, true));
    check("int64", samples<std::int64_t>(24), samples<std::int64_t>(24, true));
    check("uint64", samples<std::uint64_t>(24), samples<std::uint64_t>(24, true));
    check("float", samples<float>(24), samples<float>(24, true));
    check("double", samples<double>(24), samples<double>(24, true));
}

Affine place_of(const fs::path& file, const std::string& more) {
    return read_volume(put(file, nrrd("uchar", "raw", more) + samples<std::uint8_t>(24))).index_to_world;
}

TEST(Nrrd, PlacementIsRasOrSpacing) {
    const fs::path file = folder() / "a.nrrd";
    EXPECT_EQ(place_of(file, "").point({1, 2, 3}), Vec3(1, 2, 3));
    EXPECT_EQ(place_of(file, "spacings: 1 2 0.5\n").point({1, 1, 1}), Vec3(1, 2, 0.5));
    const std::string oblique = "space directions: (0,2,0) (3,0,0) (0,1,4)\nspace origin: (10,20,30)\n";
    // (1, 2, 3) stands at (10 + 6, 20 + 2 + 3, 30 + 12)
    const std::vector<std::pair<std::string, Vec3>> spaces = {
        {"space: right-anterior-superior\n", {16, 25, 42}},
        {"space: left-posterior-superior\n", {-16, -25, 42}},
        {"space: LAS\n", {-16, 25, 42}},
        {"space dimension: 3\n", {16, 25, 42}}};
    for (const auto& [space, world] : spaces)
        EXPECT_EQ(place_of(file, space + oblique).point({1, 2, 3}), world) << space;
    EXPECT_EQ(place_of(file, "space: RAS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n").point({0, 0, 0}),
              Vec3(0));
}

TEST(Nrrd, BadPlacementIsRefused) {
    const fs::path file = folder() / "a.nrrd";
    const std::string data = samples<std::uint8_t>(24);
    for (const std::string more :
         {"spacings: 1 0 1\n", "spacings: 1 -2 1\n", "spacings: nan 1 1\n", "spacings: 1 inf 1\n",
          "space: RAS\nspace directions: (1,0,0) (2,0,0) (0,0,1)\n",
          "space: RAS\nspace directions: (1,0,0) (0,0,0) (0,0,1)\n",
          "space: RAS\nspace directions: (1,0,0) (0,nan,0) (0,0,1)\n",
          "space: RAS\nspace directions: (1,0,0) none (0,0,1)\n",
          "space: RAS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (nan,0,0)\n",
          "space: RAST\nspace directions: (1,0,0,0) (0,1,0,0) (0,0,1,0)\n"})
        EXPECT_NE(refusal(put(file, nrrd("uchar", "raw", more) + data)), "") << more;
}

TEST(Nrrd, ShapeMustBeThreeDimensional) {
    const fs::path file = folder() / "a.nrrd";
    const std::string data = samples<std::uint8_t>(24);
    EXPECT_TRUE(says(refusal(put(file, nrrd("uchar", "raw", "", "4 6", 2) + data)), "three-dimensional"));
    EXPECT_TRUE(says(refusal(put(file, nrrd("uchar", "raw", "", "2 3 2 2", 4) + data)), "three-dimensional"));
    EXPECT_TRUE(says(refusal(put(file, nrrd("uchar", "raw", "kinds: vector domain domain\n") + data)),
                     "three-dimensional"));
    EXPECT_TRUE(
        says(refusal(put(file, nrrd("uchar", "raw", "kinds: RGB-color domain domain\n", "3 4 2") + data)),
             "three-dim"));
    expect_counting(read_volume(put(file, nrrd("uchar", "raw", "", "4 3 2 1", 4) + data)));
    expect_counting(read_volume(put(file, nrrd("uchar", "raw", "kinds: space domain ???\n") + data)));
    EXPECT_NE(refusal(put(file, nrrd("uchar", "raw", "", "4 0 2") + data)), "");
    EXPECT_NE(refusal(put(file, nrrd("uchar", "raw", "", "4 -3 2") + data)), "");
    EXPECT_EQ(read_volume(put(file, nrrd("uchar", "raw", "", "1 24 1") + data)).values.size(), 24U);
}

TEST(Nrrd, SizeClaimsAreHeldAgainstTheFile) {
    const fs::path dir = folder();
    const std::string data = samples<std::uint8_t>(24);
    for (const std::string sizes :
         {"1048576 1024 1024", "4294967296 4294967296 4294967296", "2147483647 2147483647 4", "4 3 3"})
        for (const std::string encoding : {"raw", "ascii"})
            EXPECT_NE(refusal(put(dir / "a.nrrd", nrrd("uchar", encoding, "", sizes) + data)), "") << sizes;
    EXPECT_TRUE(says(refusal(put(dir / "a.nrrd", nrrd("uchar", "gzip", "", "65536 65536 256") + gzip(data))),
                     "cut short"));
    EXPECT_TRUE(
        says(refusal(put(dir / "a.nrrd", nrrd("uchar", "gzip", "", "4 3 3") + gzip(data))), "cut short"));
}

TEST(Nrrd, DamagedGzipIsRefused) {
    const fs::path file = folder() / "a.nrrd";
    const std::string packed = gzip(samples<std::uint16_t>(24));
    const std::string header = nrrd("uint16", "gzip");
    for (const std::size_t cut : {std::size_t{1}, std::size_t{8}, packed.size() / 2})
        EXPECT_TRUE(says(refusal(put(file, header + packed.substr(0, packed.size() - cut))), "cut short"))
            << cut;
    std::string wrong = packed;
    wrong[packed.size() - 6] = static_cast<char>(wrong[packed.size() - 6] ^ 1);  // checksum
    EXPECT_TRUE(says(refusal(put(file, header + wrong)), "damaged"));
    EXPECT_TRUE(says(refusal(put(file, header + "no gzip at all, but long enough for the claim")), "gzip"));
}

TEST(Nrrd, WrongFilesAreRefusedInOneLine) {
    const fs::path dir = folder();
    const std::string data = samples<std::uint8_t>(24);
    EXPECT_TRUE(says(refusal(dir / "none.nrrd"), "no such file"));
    fs::create_directory(dir / "folder.nrrd");
    EXPECT_TRUE(says(refusal(dir / "folder.nrrd"), "directory"));
    EXPECT_TRUE(says(refusal(put(dir / "a.nrrd", "")), "empty"));
    EXPECT_TRUE(says(refusal(put(dir / "a.nrrd", "P6 3 3 255 nothing")), "not a NRRD"));
    EXPECT_TRUE(says(refusal(put(dir / "a.nrrd", "NRRD0004\ntype: uchar\n")), "cut short"));
    EXPECT_TRUE(says(refusal(put(dir / "a.vol", data)), ".nrrd, .nhdr, .nii or .nii.gz"));
    EXPECT_TRUE(says(refusal(put(dir / "a.nrrd", nrrd("uchar", "hex") + data)), "raw, gzip or ascii"));
    EXPECT_NE(refusal(put(dir / "a.nrrd", nrrd("block", "raw", "blocksize: 1\n") + data)), "");
    EXPECT_NE(refusal(put(dir / "a.nrrd", nrrd("nonsense", "raw") + data)), "");
    EXPECT_TRUE(
        says(refusal(put(dir / "a.nhdr", nrrd("uchar", "raw", "data file: none.raw\n"))), "none.raw"));
    EXPECT_NE(refusal(put(dir / "a.nhdr", nrrd("uchar", "raw", "data file: LIST\na.raw\n"))), "");
    EXPECT_TRUE(
        says(refusal(put(dir / "a.nrrd",
                         nrrd("uchar", "ascii") + "1 2 three 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20")),
             "\"three"));
}

// -- NIfTI ------------------------------------------------------------------------------------

// The parts of the NIfTI-1 header that matter, at their places by the standard.
struct Nifti {
    std::string bytes = std::string(352, '\0');

    template <class T>
    Nifti& set(std::size_t at, T value) {
        std::memcpy(bytes.data() + at, &value, sizeof(T));
        return *this;
    }
    Nifti() {
        set(0, std::int32_t{348}).dim({3, 4, 3, 2, 1, 1, 1, 1}).type(2, 8).pixdim(1, 1, 1);
        set(108, 352.0F);
        bytes.replace(344, 3, "n+1");
    }
    Nifti& dim(const std::array<std::int16_t, 8>& d) { return set(40, d); }
    Nifti& type(std::int16_t code, std::int16_t bits) { return set(70, code).set(72, bits); }
    Nifti& pixdim(float x, float y, float z) { return set(76, 1.0F).set(80, x).set(84, y).set(88, z); }
    Nifti& units(char code) { return set(123, code); }
    Nifti& scale(float slope, float inter) { return set(112, slope).set(116, inter); }
    Nifti& qform(std::array<float, 3> bcd, std::array<float, 3> offset, float qfac) {
        return set(252, std::int16_t{1}).set(256, bcd).set(268, offset).set(76, qfac);
    }
    Nifti& sform(std::array<float, 12> rows) { return set(254, std::int16_t{2}).set(280, rows); }
};

const std::string kBytes = samples<std::uint8_t>(24);

VoxelGrid read_nifti(const fs::path& file, const Nifti& header) {
    return read_volume(put(file, header.bytes + kBytes));
}

TEST(Nifti, EveryTypeReadsTheSame) {
    const fs::path dir = folder();
    const auto check = [&](std::int16_t code, const std::string& data) {
        SCOPED_TRACE(code);
        const std::string bytes = Nifti().type(code, static_cast<std::int16_t>(data.size() / 3)).bytes + data;
        expect_counting(read_volume(put(dir / "a.nii", bytes)));
        expect_counting(read_volume(put(dir / "a.nii.gz", gzip(bytes))));
    };
    check(2, samples<std::uint8_t>(24));
    check(256, samples<std::int8_t>(24));
    check(4, samples<std::int16_t>(24));
    check(512, samples<std::uint16_t>(24));
    check(8, samples<std::int32_t>(24));
    check(768, samples<std::uint32_t>(24));
    check(1024, samples<std::int64_t>(24));
    check(1280, samples<std::uint64_t>(24));
    check(16, samples<float>(24));
    check(64, samples<double>(24));
    for (const int code : {0, 1, 32, 128, 1536, 1792, 2048, 2304, 7777})
        EXPECT_TRUE(says(refusal(put(dir / "a.nii", Nifti().type(static_cast<std::int16_t>(code), 8).bytes +
                                                        std::string(1000, '\1'))),
                         "datatype"))
            << code;
}

TEST(Nifti, OtherByteOrderReadsTheSame) {
    Nifti header;
    header.type(512, 16);
    // every field used, turned round by its size
    const auto turn = [&](std::size_t at, std::size_t size, std::size_t count) {
        for (std::size_t i = 0; i < count; ++i)
            std::reverse(header.bytes.begin() + static_cast<std::ptrdiff_t>(at + i * size),
                         header.bytes.begin() + static_cast<std::ptrdiff_t>(at + (i + 1) * size));
    };
    turn(0, 4, 1), turn(40, 2, 8), turn(70, 2, 2), turn(76, 4, 8), turn(108, 4, 1);
    expect_counting(read_volume(put(folder() / "a.nii", header.bytes + samples<std::uint16_t>(24, true))));
}

TEST(Nifti, PlacementIsSformThenQformThenSpacing) {
    const fs::path file = folder() / "a.nii";
    const Vec3 index(1, 2, 3);
    EXPECT_EQ(read_nifti(file, Nifti().pixdim(2, 3, 4)).index_to_world.point(index), Vec3(2, 6, 12));
    // a quarter turn about z: quaternion (√½, 0, 0, √½), x ↦ y, y ↦ −x; qfac −1 turns z round
    const float half = std::sqrt(0.5F);
    Nifti turned = Nifti().pixdim(2, 3, 4).qform({0, 0, half}, {10, 20, 30}, 1);
    const Vec3 q = read_nifti(file, turned).index_to_world.point(index);
    EXPECT_NEAR(length(q - Vec3(10 - 6, 20 + 2, 30 + 12)), 0, 1e-5);
    const Vec3 flipped =
        read_nifti(file, turned.qform({0, 0, half}, {10, 20, 30}, -1)).index_to_world.point(index);
    EXPECT_NEAR(length(flipped - Vec3(10 - 6, 20 + 2, 30 - 12)), 0, 1e-5);
    const Nifti both = turned.sform({0, 2, 0, 5, 1, 0, 0, 6, 0, 1, 4, 7});
    EXPECT_EQ(read_nifti(file, both).index_to_world.point(index), Vec3(9, 7, 21));
    EXPECT_EQ(read_nifti(file, Nifti(both).units(1)).index_to_world.point(index), Vec3(9000, 7000, 21000));
    EXPECT_EQ(read_nifti(file, Nifti(both).units(2)).index_to_world.point(index), Vec3(9, 7, 21));
    EXPECT_NEAR(read_nifti(file, Nifti(both).units(3)).index_to_world.point(index).z, 0.021, 1e-15);
}

TEST(Nifti, ScalingIsAppliedWhereThereIsOne) {
    const fs::path file = folder() / "a.nii";
    EXPECT_EQ(read_nifti(file, Nifti().scale(2, 0.5F)).values[2], 6.5F);
    EXPECT_EQ(read_nifti(file, Nifti().scale(0, 5)).values[2], 3.0F);
    EXPECT_EQ(read_nifti(file, Nifti().scale(std::nanf(""), std::nanf(""))).values[2], 3.0F);
    EXPECT_TRUE(says(refusal(put(file, Nifti().scale(1, std::nanf("")).bytes + kBytes)), "scl_inter"));
}

TEST(Nifti, LyingHeadersAreRefused) {
    const fs::path dir = folder();
    const auto refused = [&](const Nifti& header) {
        const std::string plain = refusal(put(dir / "a.nii", header.bytes + kBytes));
        EXPECT_EQ(plain.empty(), refusal(put(dir / "a.nii.gz", gzip(header.bytes + kBytes))).empty());
        return plain;
    };
    EXPECT_TRUE(says(refused(Nifti().dim({3, 16384, 16384, 4096, 1, 1, 1, 1})), "cut short"));
    EXPECT_TRUE(says(refused(Nifti().dim({3, 4, 3, 3, 1, 1, 1, 1})), "cut short"));
    EXPECT_TRUE(says(refused(Nifti().dim({3, 4, 0, 2, 1, 1, 1, 1})), "dim[2] = 0"));
    EXPECT_TRUE(says(refused(Nifti().dim({3, 4, 3, -2, 1, 1, 1, 1})), "dim[3] = -2"));
    EXPECT_TRUE(says(refused(Nifti().dim({2, 4, 3, 2, 1, 1, 1, 1})), "three-dimensional"));
    EXPECT_TRUE(says(refused(Nifti().dim({4, 2, 3, 2, 2, 1, 1, 1})), "three-dimensional"));
    EXPECT_NE(refused(Nifti().dim({9, 4, 3, 2, 1, 1, 1, 1})), "");
    EXPECT_EQ(refused(Nifti().dim({5, 4, 3, 2, 1, 1, 1, 1})), "");
    for (const float bad : {0.0F, -1.0F, std::nanf(""), std::numeric_limits<float>::infinity()}) {
        EXPECT_TRUE(says(refused(Nifti().pixdim(1, bad, 1)), "pixdim[2]"));
        EXPECT_NE(refused(Nifti().set(108, bad == 0 ? 1e30F : bad)), "") << bad;
    }
    EXPECT_TRUE(says(refused(Nifti().sform({1, 0, 0, 0, 2, 0, 0, 0, 0, 0, 1, 0})), "spacing of axis 1 is 0"));
    EXPECT_TRUE(says(refused(Nifti().sform({1, 1, 0, 0, 2, 2, 0, 0, 0, 0, 1, 0})), "singular"));
    EXPECT_TRUE(says(refused(Nifti().sform({1, 0, 0, 0, 0, std::nanf(""), 0, 0, 0, 0, 1, 0})), "NaN"));
    EXPECT_TRUE(says(refused(Nifti().set(0, 540)), "NIfTI-2"));
    EXPECT_TRUE(says(refused(Nifti().set(344, std::array<char, 4>{'n', 'i', '1', '\0'})), "pair"));
    EXPECT_TRUE(says(refused(Nifti().set(344, std::array<char, 4>{})), "magic"));
    EXPECT_TRUE(says(refusal(put(dir / "b.nii", Nifti().bytes.substr(0, 200))), "cut short"));
}

TEST(Nifti, DamagedGzipIsRefused) {
    const fs::path file = folder() / "a.nii.gz";
    const std::string packed = gzip(Nifti().bytes + kBytes);
    EXPECT_TRUE(says(refusal(put(file, packed.substr(0, packed.size() - 1))), "cut short"));
    EXPECT_TRUE(says(refusal(put(file, packed.substr(0, packed.size() - 10))), "cut short"));
    std::string wrong = packed;
    wrong[packed.size() - 6] = static_cast<char>(wrong[packed.size() - 6] ^ 1);
    EXPECT_TRUE(says(refusal(put(file, wrong)), "damaged"));
}

TEST(Volume, NanSamplesAreKeptAndCounted) {
    std::string data = samples<float>(24);
    const float bad[2] = {std::nanf(""), std::numeric_limits<float>::infinity()};
    std::memcpy(data.data() + 12, bad, sizeof bad);
    testing::internal::CaptureStderr();
    const VoxelGrid grid = read_volume(put(folder() / "a.nrrd", nrrd("float", "raw") + data));
    const std::string warning = testing::internal::GetCapturedStderr();
    EXPECT_TRUE(std::isnan(grid.values[3]));
    EXPECT_TRUE(std::isinf(grid.values[4]));
    EXPECT_TRUE(says(warning, "warning: ") && says(warning, "2 of 24")) << warning;
}

TEST(Volume, LibrariesPrintNothing) {
    const fs::path dir = folder();
    testing::internal::CaptureStderr();
    EXPECT_NE(refusal(put(dir / "a.nii", Nifti().dim({0, 0, 0, 0, 0, 0, 0, 0}).bytes)), "");
    EXPECT_NE(refusal(put(dir / "a.nrrd", nrrd("nonsense", "raw"))), "");
    EXPECT_NE(refusal(put(dir / "a.nrrd", nrrd("uchar", "raw", "spacings: 1\n"))), "");
    EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

// Flipped bytes and cut ends: success or Error(input), nothing else.
TEST(Volume, DamageNeverDoesMoreThanAnError) {
    const fs::path dir = folder();
    put(dir / "a.raw", kBytes);
    const std::string place =
        "space: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (1,2,3)\nkinds: domain domain "
        "domain\n";
    const std::vector<std::pair<std::string, std::string>> files = {
        {"raw.nrrd", nrrd("uint16", "raw", place) + samples<std::uint16_t>(24)},
        {"gzip.nrrd", nrrd("float", "gzip", "spacings: 1 2 3\n") + gzip(samples<float>(24))},
        {"text.nrrd",
         nrrd("uchar", "ascii", "") + "1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24\n"},
        {"a.nhdr", nrrd("uchar", "raw", place + "byte skip: 0\ndata file: a.raw\n")},
        {"a.nii", Nifti().sform({1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}).bytes + kBytes},
        {"q.nii", Nifti().qform({0, 0, 0.5F}, {1, 2, 3}, 1).bytes + kBytes},
        {"a.nii.gz", gzip(Nifti().bytes + kBytes)},
    };
    std::mt19937 random(5);
    int refused = 0;
    testing::internal::CaptureStderr();  // warnings, hundreds of them
    for (const auto& [name, whole] : files)
        for (int i = 0; i < 300; ++i) {
            std::string damaged = whole;
            if (i % 3 == 0) damaged.resize(random() % damaged.size());
            for (std::size_t flips = i % 3 == 0 ? 0 : 1 + random() % 3; flips > 0; --flips)
                damaged[random() % damaged.size()] =
                    i % 2 == 0 ? static_cast<char>(random()) : "0123456789-. \n(),"[random() % 17];
            SCOPED_TRACE(name + " " + std::to_string(i));
            refused += refusal(put(dir / name, damaged)).empty() ? 0 : 1;
        }
    (void)testing::internal::GetCapturedStderr();
    EXPECT_GE(refused, 300);
}

struct Known {
    const char* name;
    std::array<int, 3> size;
    Vec3 spacing;
    float least;
    float most;
};

TEST(Volume, RealVolumesHaveTheirSizesSpacingsAndRanges) {
    const fs::path data = fs::path(PELLUCID_SOURCE_DIR) / "../shared/data/volumes";
    if (!fs::exists(data)) GTEST_SKIP() << "no " << data;
    const float slope = 2.007874F;
    for (const Known& known : {Known{"ct_engine.nrrd", {256, 256, 128}, {1, 1, 1}, 0, 255},
                               {"ct_bonsai.nrrd", {256, 256, 256}, {1, 1, 1}, 0, 255},
                               {"ct_tooth.nrrd", {103, 94, 161}, {1, 1, 1}, 0, 1300},
                               {"mri_ch2.nii.gz", {181, 217, 181}, {1, 1, 1}, 0, 254},
                               {"label_ch2_aal.nii.gz", {181, 217, 181}, {1, 1, 1}, 0, 116},
                               {"mri_head.nii.gz", {160, 232, 160}, {1, 0.8984, 0.8984}, 0, 255 * slope},
                               {"label_head.nrrd", {160, 232, 160}, {1, 0.8984, 0.8984}, 0, 2},
                               {"mri_stroke_t1.nii.gz", {124, 160, 140}, {1, 1, 1}, 0, 252},
                               {"mri_stroke_t2.nii.gz", {124, 160, 140}, {1, 1, 1}, 0, 251 * slope},
                               {"mri_stroke_flair.nii.gz", {124, 160, 140}, {1, 1, 1}, 0, 255},
                               {"label_frog.nrrd", {250, 235, 136}, {2, 2, 1.5}, 0, 29},
                               {"sim_fuel.nrrd", {64, 33, 32}, {1, 1, 1}, 0, 255},
                               {"sim_neghip.nrrd", {66, 66, 66}, {1, 1, 1}, 0, 255},
                               {"sim_hydrogen.nrrd", {64, 64, 64}, {1, 1, 1}, 0, 1},
                               {"sim_heptane.nrrd", {151, 151, 151}, {2, 2, 2}, 0, 255}}) {
        SCOPED_TRACE(known.name);
        const VoxelGrid grid = read_volume(data / known.name);
        EXPECT_EQ(grid.size, known.size);
        const auto [least, most] = std::minmax_element(grid.values.begin(), grid.values.end());
        EXPECT_EQ(*least, known.least);
        EXPECT_NEAR(*most, known.most, 1e-3 * known.most);
        for (int axis = 0; axis < 3; ++axis)
            EXPECT_NEAR(length(grid.index_to_world.linear[axis]), known.spacing[axis], 1e-3) << axis;
    }
}

TEST(Volume, RegisteredFilesShareOneGridAndAnObliqueOneIsOblique) {
    const fs::path data = fs::path(PELLUCID_SOURCE_DIR) / "../shared/data/volumes";
    if (!fs::exists(data)) GTEST_SKIP() << "no " << data;
    for (const auto& [a, b] : {std::pair{"mri_head.nii.gz", "label_head.nrrd"},
                               std::pair{"mri_ch2.nii.gz", "label_ch2_aal.nii.gz"},
                               std::pair{"mri_stroke_t1.nii.gz", "mri_stroke_flair.nii.gz"}}) {
        const Affine one = read_volume(data / a).index_to_world;
        const Affine other = read_volume(data / b).index_to_world;
        for (const Vec3& p : {Vec3(0, 0, 0), Vec3(100, 0, 0), Vec3(0, 100, 0), Vec3(0, 0, 100)})
            EXPECT_LT(length(one.point(p) - other.point(p)), 0.01) << a;
    }
    const Affine oblique = read_volume(data / "mri_stroke_t1.nii.gz").index_to_world;
    EXPECT_LT(std::abs(oblique.linear[1].y), 0.96);
    EXPECT_NEAR(std::abs(oblique.determinant()), 1.0, 1e-3);
}

}  // namespace
}  // namespace pellucid
