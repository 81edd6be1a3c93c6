// What the tests of the renderers share: scenes from text, small files, hypothesis tests over pixels.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "core/image.hpp"
#include "io/config.hpp"
#include "measure/statistics.hpp"
#include "reference/truth.hpp"
#include "render/particles.hpp"
#include "scene/prepared_scene.hpp"
#include "scene/scene_file.hpp"

namespace pellucid::testing_scenes {

namespace fs = std::filesystem;

/// An empty folder of this test alone.
inline fs::path test_folder() {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    std::string name = std::string("pellucid_") + info->test_suite_name() + "_" + info->name();
    std::replace(name.begin(), name.end(), '/', '_');
    const fs::path path = fs::path(testing::TempDir()) / name;
    fs::remove_all(path);
    fs::create_directories(path);
    return path;
}

inline fs::path put(const fs::path& file, const std::string& bytes) {
    std::ofstream(file, std::ios::binary) << bytes;
    return file;
}

inline Scene scene_from(const std::string& toml, const fs::path& folder = "/") {
    const Config config = Config::parse(toml, "test.toml", folder);
    Scene scene = scene_from_config(config);
    config.finish();
    return scene;
}

/// A raw float NRRD, x fastest, first sample at the origin.
inline fs::path put_volume(const fs::path& file, const std::array<int, 3>& size, const std::vector<float>& values,
                           const Vec3& spacing = Vec3(1.0)) {
    std::string bytes = fmt::format(
        "NRRD0004\ntype: float\ndimension: 3\nsizes: {} {} {}\nspacings: {} {} {}\nencoding: raw\nendian: little\n\n",
        size[0], size[1], size[2], spacing.x, spacing.y, spacing.z);
    const std::size_t head = bytes.size();
    bytes.resize(head + sizeof(float) * values.size());
    std::memcpy(bytes.data() + head, values.data(), sizeof(float) * values.size());
    return put(file, bytes);
}

/// f sampled at the integers 0 … size−1.
template <class F>
std::vector<float> sampled(const std::array<int, 3>& size, const F& f) {
    std::vector<float> values;
    for (int k = 0; k < size[2]; ++k)
        for (int j = 0; j < size[1]; ++j)
            for (int i = 0; i < size[0]; ++i) values.push_back(static_cast<float>(f(Vec3(i, j, k))));
    return values;
}

/// A closed sphere of triangles (rings × 2·rings), ASCII PLY.
inline fs::path put_sphere_mesh(const fs::path& file, int rings, double radius = 1) {
    std::string vertices, faces;
    const int around = 2 * rings;
    vertices += fmt::format("0 0 {}\n0 0 {}\n", radius, -radius);
    for (int i = 1; i < rings; ++i)
        for (int j = 0; j < around; ++j) {
            const double theta = M_PI * i / rings;
            const double phi = 2 * M_PI * j / around;
            vertices += fmt::format("{:.9g} {:.9g} {:.9g}\n", radius * std::sin(theta) * std::cos(phi),
                                    radius * std::sin(theta) * std::sin(phi), radius * std::cos(theta));
        }
    const auto at = [&](int i, int j) { return 2 + (i - 1) * around + j % around; };
    int count = 0;
    const auto face = [&](int a, int b, int c) {
        faces += fmt::format("3 {} {} {}\n", a, b, c);
        ++count;
    };
    for (int j = 0; j < around; ++j) {
        face(0, at(1, j), at(1, j + 1));
        face(1, at(rings - 1, j + 1), at(rings - 1, j));
        for (int i = 1; i + 1 < rings; ++i) {
            face(at(i, j), at(i + 1, j), at(i + 1, j + 1));
            face(at(i, j), at(i + 1, j + 1), at(i, j + 1));
        }
    }
    return put(file, fmt::format("ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
                                 "property float z\nelement face {}\nproperty list uchar int vertex_indices\n"
                                 "end_header\n{}{}",
                                 2 + (rings - 1) * around, count, vertices, faces));
}

/// All planes equal to the last bit (NaN equals itself).
inline void expect_same_planes(const Image& a, const Image& b) {
    ASSERT_EQ(a.names(), b.names());
    ASSERT_EQ(a.width(), b.width());
    ASSERT_EQ(a.height(), b.height());
    for (const std::string& name : a.names())
        EXPECT_EQ(0, std::memcmp(a.plane(name).data(), b.plane(name).data(), a.plane(name).size_bytes())) << name;
}

/// p-values of all pixels, randomised so that they are uniform under the law of the truth, by KS; and
/// the total of all pixels. Both at half of `level`.
struct OpacityVerdict {
    double ks_p = 1;
    double total_z = 0;
    double worst_z = 0;
    std::size_t pixels = 0;
};

inline OpacityVerdict judge_opacity(const Image& drawn, const Image& truth, double repeats, std::uint64_t seed = 1) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> unit(1e-12, 1);
    std::vector<double> p_values;
    double excess = 0;
    double variance = 0;
    OpacityVerdict verdict;
    for (std::size_t i = 0; i < drawn.pixel_count(); ++i) {
        const double alpha = static_cast<double>(truth.plane("A")[i]);
        const double covered = std::round(static_cast<double>(drawn.plane("A")[i]) * repeats);
        if (alpha == 0) {  // 64 sub-rays saw nothing: a corner may still be touched
            EXPECT_LT(covered, 0.02 * repeats + 10) << "pixel " << i << " is empty in the truth";
            continue;
        }
        const double z = binomial_randomized_z(covered, {repeats, alpha}, unit(random));
        p_values.push_back(normal_cdf(z));
        verdict.worst_z = std::max(verdict.worst_z, std::abs(z));
        excess += covered - repeats * alpha;
        variance += repeats * alpha * (1 - alpha) + repeats * repeats * static_cast<double>(truth.plane("variance.A")[i]);
    }
    verdict.pixels = p_values.size();
    if (p_values.empty()) return verdict;
    verdict.ks_p = ks_uniformity(p_values)->p_value;
    verdict.total_z = excess / std::sqrt(std::max(variance, 1e-12));
    return verdict;
}

}  // namespace pellucid::testing_scenes
