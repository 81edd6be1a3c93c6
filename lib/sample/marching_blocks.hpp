// Marching Cubes by signs alone: which edges of a grid a surface crosses, and the triangles between these crossings.
//
// The GNU Triangulated Surface Library (gts_isosurface_cartesian) joins the crossings of one block of cells at a time, blocks
// in parallel. It is given ±1 for values, so that a crossing's place names its edge; where on the edge the surface is, is for
// the caller to find. On a face between two cells what is joined depends on the signs of its corners alone: blocks meet to
// the bit.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <vector>

namespace pellucid {

/// From a node of the grid to its neighbour along an axis.
struct GridEdge {
    std::array<int, 3> node;
    int axis;
    bool rising;  // negative at the node, positive at its neighbour
};

/// A vertex an edge; the triangles' winding is the same all over. The same for any number of threads.
struct GridTriangles {
    std::vector<GridEdge> edges;
    std::vector<std::array<std::uint32_t, 3>> triangles;
};

/// What the grid's nodes are, 0 … cells along each axis. Asked by several threads at once.
struct GridSigns {
    using Node = std::array<int, 3>;
    /// ±1 where all nodes from `first` to `last` (both belong to them), and all that is between, have that sign; else 0.
    std::function<int(const Node& first, const Node& last)> known;
    /// Asked once a node, of those of which nothing is known.
    std::function<bool(const Node& node)> negative;
};

/// Throws Error(run) for more than 2^32 crossings.
[[nodiscard]] GridTriangles march(const std::array<int, 3>& cells, const GridSigns& signs);

}  // namespace pellucid
