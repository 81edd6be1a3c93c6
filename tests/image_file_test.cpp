#include "io/image_file.hpp"

#include <cmath>
#include <cstring>
#include <fstream>
#include <functional>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <png.h>
#include <zlib.h>

#include "core/color.hpp"
#include "core/error.hpp"
#include "io/atomic_file.hpp"

namespace pellucid {
namespace {

namespace fs = std::filesystem;

// A folder of this test alone.
fs::path folder() {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    fs::path path = fs::path(testing::TempDir()) /
                    (std::string("pellucid_") + info->test_suite_name() + "_" + info->name());
    fs::remove_all(path);
    fs::create_directories(path);
    return path;
}

std::string bytes_of(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

void put(const fs::path& file, const std::string& bytes) {
    std::ofstream(file, std::ios::binary) << bytes;
}

// The one line of the Error(input) that `action` throws; empty where it throws none.
std::string refusal(const std::function<void()>& action) {
    try {
        action();
    } catch (const Error& error) {
        EXPECT_EQ(error.kind(), Failure::input) << error.what();
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
        return error.what();
    }
    return "";
}

Image gradient(int width, int height) {
    Image image(width, height);
    for (const char* name : {"R", "G", "B", "A", "variance.R"}) {
        const std::span<float> plane = image.add(name);
        for (std::size_t i = 0; i < plane.size(); ++i)
            plane[i] = static_cast<float>(i) / 7.0F + static_cast<float>(name[0]);
    }
    return image;
}

// 300 damaged copies: flipped bytes and cut ends. Success or Error(input), nothing else.
void survive_damage(const fs::path& file, const std::function<void()>& read) {
    const std::string whole = bytes_of(file);
    std::mt19937 random(7);
    int refused = 0;
    for (int i = 0; i < 300; ++i) {
        std::string damaged = whole;
        for (std::size_t flips = i % 3 == 0 ? 0 : 1 + random() % 4; flips > 0; --flips)
            damaged[random() % damaged.size()] = static_cast<char>(random());
        if (i % 3 == 0) damaged.resize(random() % damaged.size());
        put(file, damaged);
        try {
            read();
        } catch (const Error& error) {
            ++refused;
            EXPECT_EQ(error.kind(), Failure::input) << i << ": " << error.what();
        }
    }
    EXPECT_GE(refused, 100);  // each cut one at least
}

TEST(Color, SrgbMatchesTheStandardAndInvertsItself) {
    // values of IEC 61966-2-1, to more digits than 8 bit need
    EXPECT_NEAR(srgb_encode(0.5), 0.735356983052449, 1e-12);
    EXPECT_NEAR(srgb_decode(0.5), 0.214041140482232, 1e-12);
    EXPECT_EQ(srgb_encode(0.0), 0.0);
    EXPECT_NEAR(srgb_encode(1.0), 1.0, 1e-15);
    for (int i = 0; i <= 1000; ++i) EXPECT_NEAR(srgb_decode(srgb_encode(i / 1000.0)), i / 1000.0, 1e-7);
}

TEST(Exr, RoundTripKeepsBitsNamesAndAttributes) {
    const fs::path file = folder() / "a.exr";
    Image image = gradient(37, 21);
    image.plane("R")[3] = std::numeric_limits<float>::quiet_NaN();
    image.add("Z", std::numeric_limits<float>::infinity());
    image.attributes = {{"method", "particles"}, {"seed", "1"}, {"settings", "a = 1\nb = \"ü\""}};
    write_exr(image, file);
    const Image back = read_exr(file);
    EXPECT_EQ(back.width(), 37);
    EXPECT_EQ(back.height(), 21);
    EXPECT_EQ(back.attributes, image.attributes);
    ASSERT_EQ(back.names(), image.names());
    for (const std::string& name : image.names())
        EXPECT_EQ(std::memcmp(back.plane(name).data(), image.plane(name).data(),
                              back.pixel_count() * sizeof(float)),
                  0)
            << name;
}

TEST(Exr, OnePixelRoundTrips) {
    const fs::path file = folder() / "a.exr";
    write_exr(gradient(1, 1), file);
    EXPECT_EQ(read_exr(file).plane("G")[0], 71.0F);
}

// tests/data/exr, written by OpenEXR 3.1: data window (−1, 2) to (1, 3) in a display window (0, 0) to
// (9, 9), R = 0.5, 1, … 3 as half, id = 1, 2, … 6 as uint; tiles of 2 × 2, PIZ, one part of several.
TEST(Exr, TiledMultiPartAndShiftedFilesReadTheSame) {
    const fs::path data = fs::path(PELLUCID_SOURCE_DIR) / "tests/data/exr";
    for (const char* name : {"tiled.exr", "mipmap.exr", "offset_window.exr", "one_part.exr"}) {
        SCOPED_TRACE(name);
        const Image image = read_exr(data / name);
        ASSERT_EQ(image.names(), (std::vector<std::string>{"R", "id"}));
        ASSERT_EQ(image.width(), 3);
        ASSERT_EQ(image.height(), 2);
        for (std::size_t i = 0; i < 6; ++i) {
            EXPECT_EQ(image.plane("R")[i], 0.5F * static_cast<float>(i + 1));
            EXPECT_EQ(image.plane("id")[i], static_cast<float>(i + 1));
        }
    }
    EXPECT_EQ(read_exr(data / "one_part.exr").attributes.at("note"), "x");
    EXPECT_NE(refusal([&] { (void)read_exr(data / "two_parts.exr"); }).find("2 parts"), std::string::npos);
    EXPECT_NE(refusal([&] { (void)read_exr(data / "subsampled.exr"); }).find("channel RY"),
              std::string::npos);
}

TEST(Exr, LyingWindowIsRefused) {
    const fs::path file = folder() / "a.exr";
    write_exr(gradient(8, 8), file);
    const std::string whole = bytes_of(file);
    const std::size_t at = whole.find(std::string("dataWindow\0box2i\0", 17)) + 17 + 4 + 8;
    for (const std::int32_t most : {1'000'000'000, 1'000'000, 30'000, -100}) {
        std::string lie = whole;
        std::memcpy(lie.data() + at, &most, 4);
        std::memcpy(lie.data() + at + 4, &most, 4);
        put(file, lie);
        EXPECT_NE(refusal([&] { (void)read_exr(file); }).find("a.exr: "), std::string::npos) << most;
    }
}

TEST(Exr, WrongFilesAreRefusedInOneLine) {
    const fs::path dir = folder();
    const auto refused = [&](const fs::path& file) { return refusal([&] { (void)read_exr(file); }); };
    EXPECT_NE(refused(dir / "none.exr").find("no such file"), std::string::npos);
    EXPECT_NE(refused(dir).find("directory"), std::string::npos);
    put(dir / "empty.exr", "");
    EXPECT_NE(refused(dir / "empty.exr").find("empty"), std::string::npos);
    put(dir / "text.exr", "not an image at all");
    EXPECT_NE(refused(dir / "text.exr"), "");
}

TEST(Exr, DamageNeverDoesMoreThanAnError) {
    const fs::path file = folder() / "a.exr";
    Image image = gradient(20, 40);
    image.attributes["method"] = "x";
    write_exr(image, file);
    survive_damage(file, [&] { (void)read_exr(file); });
}

TEST(Atomic, FailureKeepsTheOldFileAndLeavesNoOther) {
    const fs::path dir = folder();
    write_text_file(dir / "a.txt", "old");
    EXPECT_THROW(write_atomically(dir / "a.txt",
                                  [](const fs::path& temporary) {
                                      put(temporary, "half");
                                      throw std::runtime_error("no more");
                                  }),
                 Error);
    EXPECT_EQ(bytes_of(dir / "a.txt"), "old");
    EXPECT_EQ(std::distance(fs::directory_iterator(dir), fs::directory_iterator()), 1);
    write_text_file(dir / "a.txt", "new");
    EXPECT_EQ(bytes_of(dir / "a.txt"), "new");
}

TEST(Atomic, NoFolderIsAFailedRun) {
    const fs::path dir = folder();
    for (const fs::path& target : {dir / "no" / "a.exr", dir}) {
        try {
            write_exr(gradient(2, 2), target);
            ADD_FAILURE() << "written: " << target;
        } catch (const Error& error) {
            EXPECT_EQ(error.kind(), Failure::run) << error.what();
        }
    }
}

TEST(Png, WritesOverTheBackgroundClampedAndEncoded) {
    const fs::path file = folder() / "a.png";
    Image image(3, 1);
    for (const char* name : {"R", "G", "B", "A"}) image.add(name);
    image.plane("R")[0] = 0.25F;  // over white at half opacity: 0.75
    image.plane("A")[0] = 0.5F;
    image.plane("R")[1] = 7.0F;  // clamped
    image.plane("G")[1] = -1.0F;
    image.plane("A")[1] = 1.0F;
    image.plane("R")[2] = std::numeric_limits<float>::quiet_NaN();
    image.plane("A")[2] = 1.0F;
    write_png(image, Vec3(1, 1, 1), file);
    const Image back = read_png(file);
    EXPECT_NEAR(back.plane("R")[0], 0.75, 0.004);
    EXPECT_NEAR(back.plane("G")[0], 0.5, 0.004);
    EXPECT_EQ(back.plane("R")[1], 1.0F);
    EXPECT_EQ(back.plane("G")[1], 0.0F);
    EXPECT_EQ(back.plane("R")[2], 0.0F);
    EXPECT_EQ(back.plane("A")[2], 1.0F);
}

TEST(Png, EveryByteSurvivesReadAndWrite) {
    const fs::path file = folder() / "a.png";
    Image image(256, 1);
    for (const char* name : {"R", "G", "B"})
        for (std::size_t i = 0; i < 256; ++i)
            image.add(name)[i] = static_cast<float>(srgb_decode(static_cast<double>(i) / 255));
    write_png(image, Vec3(0), file);
    const Image back = read_png(file);
    for (std::size_t i = 0; i < 256; ++i) EXPECT_EQ(back.plane("B")[i], image.plane("B")[i]) << i;
}

struct PngKind {
    int colour_type;
    int depth;
    int interlace;
};

// One row of `bytes` a file of that kind, by libpng itself.
void write_kind(const fs::path& file, const PngKind& kind, png_uint_32 width,
                std::vector<std::vector<png_byte>> rows, bool transparent = false) {
    std::FILE* out = std::fopen(file.c_str(), "wb");
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
    png_infop info = png_create_info_struct(png);
    png_init_io(png, out);
    png_set_IHDR(png, info, width, static_cast<png_uint_32>(rows.size()), kind.depth, kind.colour_type,
                 kind.interlace, 0, 0);
    png_set_gAMA(png, info, 1.0);
    const png_color palette[2] = {{255, 0, 0}, {0, 255, 0}};
    if (kind.colour_type == PNG_COLOR_TYPE_PALETTE) png_set_PLTE(png, info, palette, 2);
    const png_byte alpha[1] = {51};
    png_color_16 key{};
    key.gray = 1;
    if (transparent)
        png_set_tRNS(png, info, alpha, 1, kind.colour_type == PNG_COLOR_TYPE_PALETTE ? nullptr : &key);
    std::vector<png_bytep> pointers;
    for (auto& row : rows) pointers.push_back(row.data());
    png_write_info(png, info);
    png_write_image(png, pointers.data());
    png_write_end(png, nullptr);
    png_destroy_write_struct(&png, &info);
    std::fclose(out);
}

TEST(Png, EveryKindIsReadAsLinearRgba) {
    const fs::path file = folder() / "a.png";
    write_kind(file, {PNG_COLOR_TYPE_GRAY, 8, 0}, 2, {{0, 128}});
    EXPECT_FLOAT_EQ(read_png(file).plane("G")[1], static_cast<float>(srgb_decode(128 / 255.0)));
    EXPECT_EQ(read_png(file).plane("A")[1], 1.0F);
    write_kind(file, {PNG_COLOR_TYPE_GRAY, 1, 0}, 8, {{0x40}}, true);  // value 1 is transparent
    EXPECT_EQ(read_png(file).plane("R")[1], 1.0F);
    EXPECT_EQ(read_png(file).plane("A")[1], 0.0F);
    EXPECT_EQ(read_png(file).plane("A")[0], 1.0F);
    write_kind(file, {PNG_COLOR_TYPE_GRAY, 16, 0}, 1, {{0x80, 0x01}});
    EXPECT_FLOAT_EQ(read_png(file).plane("B")[0], static_cast<float>(srgb_decode(0x8001 / 65535.0)));
    write_kind(file, {PNG_COLOR_TYPE_GRAY_ALPHA, 8, 0}, 1, {{255, 51}});
    EXPECT_FLOAT_EQ(read_png(file).plane("A")[0], 0.2F);
    EXPECT_EQ(read_png(file).plane("R")[0], 1.0F);  // straight
    write_kind(file, {PNG_COLOR_TYPE_PALETTE, 8, 0}, 2, {{0, 1}}, true);
    EXPECT_EQ(read_png(file).plane("R")[0], 1.0F);
    EXPECT_FLOAT_EQ(read_png(file).plane("A")[0], 0.2F);
    EXPECT_EQ(read_png(file).plane("G")[1], 1.0F);
    EXPECT_EQ(read_png(file).plane("A")[1], 1.0F);
    write_kind(file, {PNG_COLOR_TYPE_RGB_ALPHA, 16, PNG_INTERLACE_ADAM7}, 1,
               {{0, 0, 0xff, 0xff, 0x80, 0, 0x80, 0}, {0xff, 0xff, 0, 0, 0, 0, 0xff, 0xff}});
    const Image image = read_png(file);
    EXPECT_EQ(image.plane("R")[1], 1.0F);
    EXPECT_EQ(image.plane("G")[0], 1.0F);
    EXPECT_FLOAT_EQ(image.plane("A")[0], 0x8000 / 65535.0F);
}

TEST(Png, LyingSizeIsRefused) {
    const fs::path file = folder() / "a.png";
    write_png(gradient(8, 8), Vec3(0), file);
    std::string lie = bytes_of(file);
    lie[16] = 0, lie[17] = 0x0f, lie[20] = 0, lie[21] = 0x0f;  // about 10^6 × 10^6
    const auto crc = crc32(0, reinterpret_cast<const Bytef*>(lie.data()) + 12, 17);
    for (std::size_t i = 0; i < 4; ++i) lie[29 + i] = static_cast<char>(crc >> (24 - 8 * i));
    put(file, lie);
    EXPECT_NE(refusal([&] { (void)read_png(file); }).find("claims"), std::string::npos);
}

TEST(Png, DamageNeverDoesMoreThanAnError) {
    const fs::path file = folder() / "a.png";
    write_png(gradient(30, 20), Vec3(0), file);
    survive_damage(file, [&] { (void)read_png(file); });
    write_kind(file, {PNG_COLOR_TYPE_PALETTE, 8, PNG_INTERLACE_ADAM7}, 4, {{0, 1, 0, 1}, {1, 1, 0, 1}}, true);
    survive_damage(file, [&] { (void)read_png(file); });
}

}  // namespace
}  // namespace pellucid
