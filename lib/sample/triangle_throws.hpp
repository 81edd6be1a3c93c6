// Uniform points on whole triangles of a mesh: the arithmetic of a trial, one at a time and over SIMD lanes.
//
// A trial takes one block of Philox (edge_lines.hpp takes two) and one cache line: triangles are kept as records in view
// space, a line each, and fetched ahead for a chunk of trials. With fewer particles in a repeat than triangles, which is what
// opacity of thin surfaces asks for, that line is what a trial waits for, so triangles are picked at random, not walked.
// A place's rounding is that of its particle: view space from the near plane, in float32. Scalar and SIMD agree to the last
// bit.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "sample/edge_lines.hpp"
#include "sample/particle_source.hpp"

namespace pellucid {

struct alignas(64) TriangleRecord {
    std::array<float, 3> corner{};  // view space, z from the near plane
    std::array<float, 3> edge[2]{};
    float bound = 0;                // as in BoxLines; a throw is kept with (z_l/z)³ or least s/s
    std::array<std::uint64_t, 3> normal{};  // at the corners, view space: three times 21 bits, each + 2^20

    TriangleRecord() = default;
    /// `normals`: of length one or zero.
    TriangleRecord(const LineView& view, const std::array<Vec3, 3>& corners_in_view,
                   const std::array<Vec3, 3>& normals_in_view, double the_bound);
};
static_assert(sizeof(TriangleRecord) == 64);

/// Of a view, and a block's own.
struct TriangleBlock {
    const LineView* view;  // of world space
    const TriangleRecord* records;
    const AliasTable* table;  // of 2^20 columns at most: the bits that choose one, and its part, come from one word
};

/// From 128 random bits; false: not kept.
[[nodiscard]] bool throw_triangle(const TriangleBlock& block, const std::array<std::uint32_t, 4>& bits, SourcePoint& out);
/// Appends what trials first … first + count − 1 keep, in their order.
void throw_triangles(const TriangleBlock& block, const LineKeys& keys, std::uint32_t first, std::uint32_t count,
                     std::vector<SourcePoint>& out);

}  // namespace pellucid
