// What the benchmarks work on: scenes that are made, not read, so that they are the same everywhere.
#pragma once

#include <cstdint>
#include <vector>

#include "field/mpu.hpp"
#include "io/mesh_file.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid::bench {

inline constexpr int kImageSize = 1024;

/// Four closed surfaces that overlap on the screen and cross each other, lit and glossy.
[[nodiscard]] PreparedScene overlapping_surfaces();
/// Four rectangles that cross each other: the shape whose particles are sampled fastest.
[[nodiscard]] PreparedScene crossing_cards();
/// One torus that fills the image.
[[nodiscard]] PreparedScene torus();
/// Barth's sextic with its 65 nodes, as a formula, in an image of size².
[[nodiscard]] PreparedScene barth_sextic(int size);
/// Eight nested wavy spheres, 1.04 million triangles, seen along −z in an image of size².
[[nodiscard]] PreparedScene nested_spheres(int size, double opacity);
/// Eight spheres, a little wavy, of 99 372 triangles each, that overlap and cross each other: what depth peeling is for.
[[nodiscard]] PreparedScene eight_spheres(int size);
inline constexpr const char* kHeadFile = "/usr/share/mricron/templates/ch2.nii.gz";
/// The skin of the head of Debian's mricron-data, 181 x 217 x 181.
[[nodiscard]] PreparedScene real_head(Interpolation interpolation = Interpolation::trilinear);
/// The isosurface of a wavy ball in a volume of 128³.
[[nodiscard]] PreparedScene wavy_isosurface(Interpolation interpolation = Interpolation::trilinear);
/// A cube of 256³ uint8 that fills an image of 512², seen aslant; opacity a few thousandths a voxel where there is
/// anything: in `share` of its blocks of 32³, scattered (1: everywhere). `copies` of it lie across one another.
struct CubeSettings {
    double share = 1;
    Shading shading{.flat = true};
    int copies = 1;
};
inline constexpr int kCubeSamples = 256;
inline constexpr int kCubePixels = 512;
[[nodiscard]] std::uint8_t cube_value(int i, int j, int k);
[[nodiscard]] PreparedScene transparent_cube(const CubeSettings& settings);
/// Points on a wavy ball with normals of any length, evenly spread.
[[nodiscard]] std::vector<OrientedPoint> points_on_wavy_ball(int count);
/// MPU surface through 120 000 of them.
[[nodiscard]] PreparedScene wavy_points();

}  // namespace pellucid::bench
