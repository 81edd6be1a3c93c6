#include "sample/marching_blocks.hpp"

#include <algorithm>
#include <bit>
#include <memory>

#include <gts.h>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace pellucid {
namespace {

/// Cells of a block along an axis, 2^3; blocks of a group, that a thread looks into at a time.
constexpr int kSide = 8;
constexpr int kGroupBlocks = 8;
constexpr std::size_t kAxes = 3;

using Node = GridSigns::Node;

/// A block owns kSide nodes along each axis, and the edges that begin there. Bit j·kSide + i of word k.
struct Block {
    std::array<int, 3> at;  // of blocks
    std::array<std::uint64_t, kSide> negative{};
    std::array<std::array<std::uint64_t, kSide>, kAxes> crossed{};
    std::uint32_t first_edge = 0;

    /// Number of one of its edges, which is crossed.
    [[nodiscard]] std::uint32_t edge(std::size_t axis, const std::array<unsigned, 3>& node) const {
        const unsigned bit = node[1] * kSide + node[0];
        std::uint32_t number = first_edge;
        for (std::size_t a = 0; a < axis; ++a)
            for (const std::uint64_t word : crossed[a]) number += static_cast<std::uint32_t>(std::popcount(word));
        for (std::size_t k = 0; k < node[2]; ++k) number += static_cast<std::uint32_t>(std::popcount(crossed[axis][k]));
        return number + static_cast<std::uint32_t>(std::popcount(crossed[axis][node[2]] & ((std::uint64_t{1} << bit) - 1)));
    }
};

/// The middle of an edge in half cells of its block, five bits an axis: what GTS makes of ±1.
using EdgeCode = std::uint32_t;

struct BlockTriangles {
    std::vector<std::array<EdgeCode, 3>> triangles;
};

gint append_face(gpointer item, gpointer data) {
    GtsVertex* v[3] = {};
    gts_triangle_vertices(GTS_TRIANGLE(item), &v[0], &v[1], &v[2]);
    std::array<EdgeCode, 3> codes;
    for (std::size_t i = 0; i < 3; ++i) {
        const GtsPoint* p = GTS_POINT(v[i]);
        codes[i] = static_cast<EdgeCode>(2 * p->x + 0.5) | static_cast<EdgeCode>(2 * p->y + 0.5) << 5U |
                   static_cast<EdgeCode>(2 * p->z + 0.5) << 10U;
    }
    static_cast<std::vector<std::array<EdgeCode, 3>>*>(data)->push_back(codes);
    return 0;
}

/// The signs of a block's nodes and of those beyond its upper faces.
struct Values {
    double value[kSide + 1][kSide + 1][kSide + 1];  // x, y, z
};

void slice_for_gts(gdouble** values, GtsCartesianGrid grid, guint k, gpointer data) {
    const auto& signs = *static_cast<const Values*>(data);
    for (guint i = 0; i < grid.nx; ++i)
        for (guint j = 0; j < grid.ny; ++j) values[i][j] = signs.value[i][j][k];
}

class Marcher {
public:
    Marcher(const std::array<int, 3>& cells, const GridSigns& signs) : cells_(cells), signs_(signs) {
        for (std::size_t a = 0; a < kAxes; ++a) blocks_[a] = cells[a] / kSide + 1;
        slots_.resize(slot_of({0, 0, blocks_[2]}));
    }

    [[nodiscard]] GridTriangles run() {
        find_blocks();
        parallel_for(found_.size(), 8, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) find_signs(found_[i]);
        });
        std::vector<BlockTriangles> parts(found_.size());
        // The classes of GTS are made at first use, which is not for several threads at once.
        (void)gts_surface_class(), (void)gts_face_class(), (void)gts_edge_class(), (void)gts_vertex_class();
        parallel_for(found_.size(), 8, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) cross(found_[i], parts[i]);
        });
        GridTriangles out;
        std::uint64_t edges = 0;
        std::vector<std::size_t> first_triangle(found_.size() + 1, 0);
        for (std::size_t i = 0; i < found_.size(); ++i) {
            found_[i].first_edge = static_cast<std::uint32_t>(edges);
            for (const auto& words : found_[i].crossed)
                for (const std::uint64_t word : words) edges += static_cast<std::uint64_t>(std::popcount(word));
            first_triangle[i + 1] = first_triangle[i] + parts[i].triangles.size();
            if (edges > 0xfffffff0U) throw run_error("a surface crosses more than 2^32 edges of its grid: use fewer cells");
        }
        out.edges.resize(edges);
        out.triangles.resize(first_triangle.back());
        parallel_for(found_.size(), 8, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                put_edges(found_[i], out.edges);
                put_triangles(found_[i], parts[i], out.triangles.data() + first_triangle[i]);
                parts[i] = {};
            }
        });
        // Edges of which a sure sign and a value disagree have no vertex.
        std::erase_if(out.triangles, [](const auto& t) { return std::ranges::find(t, kNone) != t.end(); });
        return out;
    }

private:
    static constexpr std::int32_t kAllPositive = -1;
    static constexpr std::int32_t kAllNegative = -2;
    static constexpr std::uint32_t kNone = ~0U;

    [[nodiscard]] std::size_t slot_of(const std::array<int, 3>& at) const {
        return (static_cast<std::size_t>(at[2]) * static_cast<std::size_t>(blocks_[1]) + static_cast<std::size_t>(at[1])) *
                   static_cast<std::size_t>(blocks_[0]) +
               static_cast<std::size_t>(at[0]);
    }

    /// Blocks of which no sign is known, group by group.
    void find_blocks() {
        std::array<int, 3> groups;
        for (std::size_t a = 0; a < kAxes; ++a) groups[a] = (blocks_[a] + kGroupBlocks - 1) / kGroupBlocks;
        const auto count = static_cast<std::size_t>(groups[0]) * static_cast<std::size_t>(groups[1]) *
                           static_cast<std::size_t>(groups[2]);
        std::vector<std::vector<Block>> found(count);
        parallel_for(count, 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const auto number = static_cast<int>(i);
                look({kGroupBlocks * (number % groups[0]), kGroupBlocks * (number / groups[0] % groups[1]),
                      kGroupBlocks * (number / groups[0] / groups[1])},
                     kGroupBlocks, found[i]);
            }
        });
        for (const auto& part : found)
            for (const Block& block : part) {
                slots_[slot_of(block.at)] = static_cast<std::int32_t>(found_.size());
                found_.push_back(block);
            }
    }

    void look(const std::array<int, 3>& at, int extent, std::vector<Block>& found) {
        Node first, last;
        std::array<int, 3> end;
        for (std::size_t a = 0; a < kAxes; ++a) {
            first[a] = at[a] * kSide;
            if (first[a] > cells_[a]) return;
            last[a] = std::min(cells_[a], (at[a] + extent) * kSide);
            end[a] = std::min(blocks_[a], at[a] + extent);
        }
        if (const int sign = signs_.known(first, last); sign != 0) {
            for (int k = at[2]; k < end[2]; ++k)
                for (int j = at[1]; j < end[1]; ++j)
                    for (int i = at[0]; i < end[0]; ++i) slots_[slot_of({i, j, k})] = sign > 0 ? kAllPositive : kAllNegative;
            return;
        }
        if (extent == 1) {
            found.push_back({at});
            return;
        }
        const int half = extent / 2;
        for (int part = 0; part < 8; ++part)
            look({at[0] + (part & 1) * half, at[1] + (part >> 1 & 1) * half, at[2] + (part >> 2) * half}, half, found);
    }

    void find_signs(Block& block) const {
        for (int k = 0; k < kSide; ++k)
            for (int j = 0; j < kSide; ++j)
                for (int i = 0; i < kSide; ++i) {
                    const Node node{block.at[0] * kSide + i, block.at[1] * kSide + j, block.at[2] * kSide + k};
                    if (node[0] > cells_[0] || node[1] > cells_[1] || node[2] > cells_[2]) continue;
                    if (signs_.negative(node))
                        block.negative[static_cast<std::size_t>(k)] |= std::uint64_t{1} << static_cast<unsigned>(j * kSide + i);
                }
    }

    [[nodiscard]] bool negative(const Node& node) const {
        const std::int32_t slot = slots_[slot_of({node[0] / kSide, node[1] / kSide, node[2] / kSide})];
        if (slot < 0) return slot == kAllNegative;
        const auto bit = static_cast<unsigned>(node[1] % kSide * kSide + node[0] % kSide);
        return (found_[static_cast<std::size_t>(slot)].negative[static_cast<std::size_t>(node[2] % kSide)] >> bit & 1U) != 0;
    }

    /// Which of a block's edges are crossed, and the triangles of its cells.
    void cross(Block& block, BlockTriangles& out) const {
        std::array<int, 3> size;  // nodes, own and beyond
        for (std::size_t a = 0; a < kAxes; ++a) size[a] = std::min(kSide, cells_[a] - block.at[a] * kSide) + 1;
        Values values;
        bool some = false;
        bool all = true;
        for (int i = 0; i < size[0]; ++i)
            for (int j = 0; j < size[1]; ++j)
                for (int k = 0; k < size[2]; ++k) {
                    const bool below = negative({block.at[0] * kSide + i, block.at[1] * kSide + j, block.at[2] * kSide + k});
                    values.value[i][j][k] = below ? -1 : 1;
                    some = some || below;
                    all = all && below;
                }
        if (!some || all) return;
        for (int k = 0; k < std::min(kSide, size[2]); ++k)
            for (int j = 0; j < std::min(kSide, size[1]); ++j)
                for (int i = 0; i < std::min(kSide, size[0]); ++i) {
                    const double here = values.value[i][j][k];
                    const std::uint64_t bit = std::uint64_t{1} << static_cast<unsigned>(j * kSide + i);
                    const auto layer = static_cast<std::size_t>(k);
                    if (i + 1 < size[0] && values.value[i + 1][j][k] != here) block.crossed[0][layer] |= bit;
                    if (j + 1 < size[1] && values.value[i][j + 1][k] != here) block.crossed[1][layer] |= bit;
                    if (k + 1 < size[2] && values.value[i][j][k + 1] != here) block.crossed[2][layer] |= bit;
                }
        if (size[0] < 2 || size[1] < 2 || size[2] < 2) return;
        struct Deleter {
            void operator()(GtsSurface* s) const { gts_object_destroy(GTS_OBJECT(s)); }
        };
        const std::unique_ptr<GtsSurface, Deleter> surface(
            gts_surface_new(gts_surface_class(), gts_face_class(), gts_edge_class(), gts_vertex_class()));
        const GtsCartesianGrid grid{static_cast<guint>(size[0]), static_cast<guint>(size[1]), static_cast<guint>(size[2]),
                                    0, 1, 0, 1, 0, 1};
        gts_isosurface_cartesian(surface.get(), grid, slice_for_gts, &values, 0);
        gts_surface_foreach_face(surface.get(), append_face, &out.triangles);
        // GTS keeps its items by their addresses, which differ from run to run.
        for (auto& t : out.triangles) std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
        std::sort(out.triangles.begin(), out.triangles.end());
    }

    static void put_edges(const Block& block, std::vector<GridEdge>& edges) {
        std::size_t number = block.first_edge;
        for (std::size_t axis = 0; axis < kAxes; ++axis)
            for (std::size_t k = 0; k < kSide; ++k)
                for (std::uint64_t rest = block.crossed[axis][k]; rest != 0; rest &= rest - 1) {
                    const int bit = std::countr_zero(rest);
                    edges[number++] = {{block.at[0] * kSide + bit % kSide, block.at[1] * kSide + bit / kSide,
                                        block.at[2] * kSide + static_cast<int>(k)},
                                       static_cast<int>(axis),
                                       (block.negative[k] >> static_cast<unsigned>(bit) & 1U) != 0};
                }
    }

    void put_triangles(const Block& block, const BlockTriangles& from, std::array<std::uint32_t, 3>* to) const {
        for (const auto& codes : from.triangles) {
            for (std::size_t corner = 0; corner < 3; ++corner) (*to)[corner] = vertex(block, codes[corner]);
            ++to;
        }
    }

    [[nodiscard]] std::uint32_t vertex(const Block& block, EdgeCode code) const {
        std::array<unsigned, 3> node;
        std::size_t axis = 0;
        std::array<int, 3> owner = block.at;
        for (std::size_t a = 0; a < kAxes; ++a) {
            const unsigned twice = code >> (5 * a) & 31U;
            if ((twice & 1U) != 0) axis = a;
            node[a] = twice / 2 % kSide;
            owner[a] += static_cast<int>(twice / 2 / kSide);
        }
        const std::int32_t slot = slots_[slot_of(owner)];
        if (slot < 0) return kNone;
        const Block& own = found_[static_cast<std::size_t>(slot)];
        const bool crossed = (own.crossed[axis][node[2]] >> (node[1] * kSide + node[0]) & 1U) != 0;
        return crossed ? own.edge(axis, node) : kNone;
    }

    std::array<int, 3> cells_, blocks_{};
    const GridSigns& signs_;
    std::vector<std::int32_t> slots_;  // of a block: its place in found_, or what all of it is
    std::vector<Block> found_;
};

}  // namespace

GridTriangles march(const std::array<int, 3>& cells, const GridSigns& signs) { return Marcher(cells, signs).run(); }

}  // namespace pellucid
