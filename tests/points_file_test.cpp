#include "io/points_file.hpp"

#include <cstring>
#include <string>

#include <gtest/gtest.h>

#include "core/error.hpp"

namespace pellucid {
namespace {

std::string ply(const std::string& format, const std::string& count, const std::string& type, const std::string& body,
                bool normals = true) {
    std::string text = "ply\nformat " + format + " 1.0\nelement vertex " + count + "\n";
    for (const char* name : {"x", "y", "z"}) text += "property " + type + " " + name + "\n";
    if (normals)
        for (const char* name : {"nx", "ny", "nz"}) text += "property " + type + " " + name + "\n";
    return text + "end_header\n" + body;
}

template <class T>
std::string bytes_of(std::initializer_list<T> values) {
    std::string out;
    for (T value : values) out.append(reinterpret_cast<const char*>(&value), sizeof value);
    return out;
}

std::string refusal(const std::string& extension, const std::string& bytes) {
    DroppedPoints dropped;
    try {
        (void)parse_points("p", extension, bytes, dropped);
    } catch (const Error& e) {
        EXPECT_EQ(e.kind(), Failure::input);
        return e.what();
    }
    return "";
}

TEST(PointsFile, TextAndBinaryAndXyzHoldTheSame) {
    const std::string files[][2] = {
        {".ply", ply("ascii", "1", "float", "1 -2 3 0 3 4\n")},
        {".ply", ply("binary_little_endian", "1", "float", bytes_of<float>({1, -2, 3, 0, 3, 4}))},
        {".ply", ply("binary_little_endian", "1", "double", bytes_of<double>({1, -2, 3, 0, 3, 4}))},
        {".xyz", "# one\n1 -2 3 0 3 4\n\n"}};
    for (const auto& [extension, bytes] : files) {
        DroppedPoints dropped;
        const auto points = parse_points("p", extension, bytes, dropped);
        ASSERT_EQ(points.size(), 1U);
        EXPECT_EQ(points[0].position, Vec3(1, -2, 3));
        EXPECT_NEAR(static_cast<double>(points[0].normal[1]), 0.6, 1e-7);
        EXPECT_NEAR(static_cast<double>(points[0].normal[2]), 0.8, 1e-7);
    }
}

TEST(PointsFile, DoublesKeepTheirDigits) {
    DroppedPoints dropped;
    const auto points = parse_points(
        "p", ".ply", ply("binary_little_endian", "1", "double", bytes_of<double>({1234567.123456, 0, 0, 1, 0, 0})), dropped);
    EXPECT_EQ(points.at(0).position.x, 1234567.123456);
}

TEST(PointsFile, WhatIsNoNumberIsDroppedAndCounted) {
    DroppedPoints dropped;
    const auto points =
        parse_points("p", ".xyz", "nan 0 0 1 0 0\n0 inf 0 1 0 0\n0 0 0 0 0 0\n0 0 0 nan 0 1\n0 0 0 1e-200 0 0\n", dropped);
    EXPECT_EQ(dropped.no_position, 2U);
    EXPECT_EQ(dropped.no_normal, 2U);
    ASSERT_EQ(points.size(), 1U);
    EXPECT_EQ(points[0].normal[0], 1.0F);
}

TEST(PointsFile, BadFilesAreRefusedByName) {
    EXPECT_NE(refusal(".ply", "").find("empty"), std::string::npos);
    EXPECT_NE(refusal(".ply", ply("ascii", "1", "float", "1 2 3\n", false)).find("normals"), std::string::npos);
    EXPECT_NE(refusal(".xyz", "1 2 3\n").find("normals"), std::string::npos);
    EXPECT_NE(refusal(".xyz", "1 2 3 4\n").find("4 numbers"), std::string::npos);
    EXPECT_NE(refusal(".xyz", "1 2 3 0 0 one\n").find("\"one\""), std::string::npos);
    EXPECT_NE(refusal(".ply", ply("ascii", "1000000000000", "float", "1 2 3 0 0 1\n")).find("cut short"), std::string::npos);
    EXPECT_NE(refusal(".ply", ply("binary_little_endian", "2", "float", bytes_of<float>({1, 2, 3, 0, 0, 1, 5}))).find("cut short"),
              std::string::npos);
    EXPECT_NE(refusal(".ply", "solid").find("PLY"), std::string::npos);
    EXPECT_NE(refusal(".pcd", "x").find(".xyz"), std::string::npos);
}

}  // namespace
}  // namespace pellucid
