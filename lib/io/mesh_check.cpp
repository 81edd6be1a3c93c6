#include "io/mesh_check.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "core/error.hpp"
#include "io/file_rows.hpp"

namespace pellucid {
namespace {

using namespace rows;

void check_index(const Path& file, double index, std::uint64_t face, std::uint64_t vertices) {
    if (!(index >= 0 && index < static_cast<double>(vertices)) || index != std::floor(index))
        throw input_error("{}: face {}: vertex index {} out of range, expected 0 to {}", file.string(), face,
                          index, vertices - 1);
}

// A polygon of more corners would make assimp's triangulation, quadratic in them, run for minutes.
constexpr double kMostCorners = 10'000;

void check_corners(const Path& file, double corners, std::uint64_t face) {
    if (!(corners >= 1 && corners <= kMostCorners) || corners != std::floor(corners))
        throw input_error("{}: face {}: {} corners, expected 3 to {}", file.string(), face, corners,
                          kMostCorners);
}

// -- PLY --------------------------------------------------------------------------------------

MeshCounts check_ply(const Path& file, std::string_view bytes) {
    const PlyHeader header = ply_header(file, bytes);
    MeshCounts counts;

    check_ply_counts(file, header);
    for (const PlyElement& element : header.elements) {
        const auto has = [&](std::string_view name) {
            return std::any_of(
                element.properties.begin(), element.properties.end(),
                [&](const PlyProperty& p) { return p.name == name && p.count_type == PlyType::none; });
        };
        if (element.name == "vertex") {
            if (!has("x") || !has("y") || !has("z"))
                throw input_error("{}: vertices without x, y, z", file.string());
            counts.vertices = element.count;
        }
        if (element.name == "face") counts.faces = element.count;
        if (element.name == "tristrips")
            throw input_error("{}: has triangle strips, expected faces", file.string());
    }
    if (counts.vertices == 0 || counts.faces == 0)
        throw input_error("{}: {} vertices and {} faces, expected a mesh with triangles", file.string(),
                          counts.vertices, counts.faces);

    counts.faces = 0;
    PlyBody body(file, header);
    for (const PlyElement& element : header.elements)
        for (std::uint64_t row = 0; row < element.count; ++row)
            for (const PlyProperty& property : element.properties) {
                if (property.count_type == PlyType::none) {
                    (void)body.next(property.type, element, row);
                    continue;
                }
                const bool corners = element.name == "face" &&
                                     (property.name == "vertex_indices" || property.name == "vertex_index");
                const double length = body.next(property.count_type, element, row);
                if (corners) check_corners(file, length, row);
                if (corners && length >= 3) ++counts.faces;
                if (!(length >= 0 && length <= static_cast<double>(bytes.size())))
                    throw input_error("{}: {} {}: a list of {} values", file.string(), shown(element.name),
                                      row, length);
                for (double i = 0; i < length; ++i) {
                    const double value = body.next(property.type, element, row);
                    if (corners) check_index(file, value, row, counts.vertices);
                }
            }
    return counts;
}

// -- OFF --------------------------------------------------------------------------------------

// [C][N]OFF in text: vertices of 3 numbers and more to the end of the line, faces, edges not used.
MeshCounts check_off(const Path& file, std::string_view bytes) {
    Words words(bytes, '#');
    const std::string_view magic = words.next();
    if (magic != "OFF" && magic != "COFF" && magic != "NOFF" && magic != "CNOFF")
        throw input_error(
            "{}: not a readable OFF file: begins with \"{}\", expected OFF, COFF, NOFF or CNOFF",
            file.string(), shown(magic));
    MeshCounts counts;
    std::uint64_t edges = 0;
    for (std::uint64_t* count : {&counts.vertices, &counts.faces, &edges}) {
        const std::string_view word = words.next();
        if (!parse(word, *count))
            throw input_error("{}: count \"{}\", expected an integer", file.string(), shown(word));
    }
    // a vertex is three numbers of a character and a blank at least, a face a count and one index
    if (counts.vertices > bytes.size() / 6 + 1 || counts.faces > bytes.size() / 4 + 1)
        throw input_error("{}: is cut short: claims {} vertices and {} faces, {} bytes are there",
                          file.string(), counts.vertices, counts.faces, bytes.size());
    if (counts.vertices == 0 || counts.faces == 0)
        throw input_error("{}: {} vertices and {} faces, expected a mesh with triangles", file.string(),
                          counts.vertices, counts.faces);

    for (std::uint64_t vertex = 0; vertex < counts.vertices; ++vertex) {
        for (int i = 0; i < 3; ++i) (void)number(file, words.next(), fmt::format("vertex {}", vertex));
        words.skip_line();
    }
    for (std::uint64_t face = 0, claimed = std::exchange(counts.faces, 0); face < claimed; ++face) {
        const double corners = number(file, words.next(), fmt::format("face {}", face));
        check_corners(file, corners, face);
        if (corners >= 3) ++counts.faces;
        for (double i = 0; i < corners; ++i)
            check_index(file, number(file, words.next(), fmt::format("face {}", face)), face,
                        counts.vertices);
        words.skip_line();
    }
    return counts;
}

// -- STL --------------------------------------------------------------------------------------

MeshCounts check_stl(const Path& file, std::string_view bytes) {
    // Binary: 80 bytes of anything (some writers begin it with "solid"), a count, 50 bytes a triangle.
    constexpr std::uint64_t kHead = 84;
    constexpr std::uint64_t kRow = 50;
    std::uint32_t claimed = 0;
    if (bytes.size() >= kHead) std::memcpy(&claimed, bytes.data() + kHead - 4, 4);
    if (std::endian::native == std::endian::big) claimed = __builtin_bswap32(claimed);
    const bool binary = bytes.size() >= kHead && bytes.size() == kHead + kRow * claimed;
    MeshCounts counts{.vertices = 0, .faces = claimed, .shared = false};
    if (!binary && !bytes.starts_with("solid"))
        throw input_error("{}: not a whole STL file: no \"solid\", and {} bytes where {} triangles take {}",
                          file.string(), bytes.size(), claimed, kHead + kRow * claimed);
    if (!binary) {
        counts.faces = 0;
        Words words(bytes);
        const auto expect = [&](std::string_view wanted) {
            const std::string_view word = words.next();
            if (words.rest().empty() && word != wanted && wanted.starts_with(word))
                throw input_error("{}: is cut short: ends in facet {}", file.string(), counts.faces);
            if (word != wanted)
                throw input_error("{}: facet {}: \"{}\", expected \"{}\"", file.string(), counts.faces,
                                  shown(word), wanted);
        };
        const auto expect_numbers = [&] {
            for (int i = 0; i < 3; ++i)
                (void)number(file, words.next(), fmt::format("facet {}", counts.faces));
        };
        for (std::string_view solid = words.next(); !solid.empty(); solid = words.next()) {
            if (solid != "solid")
                throw input_error("{}: \"{}\", expected \"solid\"", file.string(), shown(solid));
            words.skip_line();
            std::string_view word = words.next();
            for (; word == "facet"; word = words.next()) {
                expect("normal");
                expect_numbers();
                expect("outer");
                expect("loop");
                for (int corner = 0; corner < 3; ++corner) {
                    expect("vertex");
                    expect_numbers();
                }
                expect("endloop");
                expect("endfacet");
                ++counts.faces;
            }
            if (word != "endsolid")
                throw input_error("{}: is cut short: \"{}\" after facet {}, expected \"endsolid\"",
                                  file.string(), shown(word), counts.faces);
            words.skip_line();
        }
    }
    if (counts.faces == 0) throw input_error("{}: 0 facets, expected a mesh with triangles", file.string());
    counts.vertices = 3 * counts.faces;
    return counts;
}

// -- OBJ --------------------------------------------------------------------------------------

// What stands before a line: positions, texture points, normals.
using ObjCounts = std::array<std::uint64_t, 3>;

// One corner "v", "v/vt", "v//vn" or "v/vt/vn": each counts from 1, or from −1 backwards from its
// own line. Returns which of the three it has, as bits.
unsigned check_obj_corner(const Path& file, std::string_view corner, std::uint64_t line,
                          const ObjCounts& so_far, const ObjCounts& all) {
    constexpr std::array<std::string_view, 3> kNames = {"vertex", "texture", "normal"};
    unsigned has = 0;
    std::string_view rest = corner;
    for (std::size_t i = 0; i < 3; ++i) {
        const std::size_t slash = std::min(rest.find('/'), rest.size());
        const std::string_view word = rest.substr(0, slash);
        rest.remove_prefix(std::min(slash + 1, rest.size()));
        if (word.empty() && i > 0) continue;
        std::int64_t index = 0;
        if (!parse(word, index) || (i == 2 && !rest.empty()))
            throw input_error("{}:{}: corner \"{}\", expected v/vt/vn", file.string(), line, shown(corner));
        const std::uint64_t there = index < 0 ? so_far[i] : all[i];
        const auto most = static_cast<std::int64_t>(there);
        if (index == 0 || index > most || index < -most)
            throw input_error("{}:{}: {} index {} out of range, {} are there", file.string(), line, kNames[i],
                              index, there);
        has |= 1U << i;
    }
    return has;
}

MeshCounts check_obj(const Path& file, std::string_view bytes) {
    if (bytes.find('\0') != std::string_view::npos)
        throw input_error("{}: not an OBJ file: not text", file.string());
    MeshCounts counts{.vertices = 0, .faces = 0, .shared = false};
    ObjCounts all{};  // counted first: an index may name a vertex of a later line
    for (const bool counting : {true, false}) {
        std::uint64_t line = 0;
        ObjCounts so_far{};
        for (std::string_view rest = bytes; !rest.empty();) {
            // a backslash joins a line to the next
            std::size_t end = rest.find('\n');
            for (++line; end != std::string_view::npos && rest.substr(0, end).ends_with('\\'); ++line)
                end = rest.find('\n', end + 1);
            end = std::min(end, rest.size());
            Words words(rest.substr(0, end), '#');
            rest.remove_prefix(std::min(end + 1, rest.size()));
            const std::string_view key = words.next();
            if (key == "vt") ++so_far[1];
            if (key == "vn") ++so_far[2];
            if (key == "v") {
                ++so_far[0];
                for (int i = 0; counting && i < 3; ++i)
                    (void)number(file, words.next(), fmt::format("vertex {} (line {})", so_far[0], line));
            }
            if (key != "f" || counting) continue;
            double corners = 0;
            unsigned kinds = 0;
            for (std::string_view corner = words.next(); !corner.empty(); corner = words.next()) {
                if (corner == "\\") continue;
                ++corners;
                const unsigned kind = check_obj_corner(file, corner, line, so_far, all);
                if (corners > 1 && kind != kinds)
                    throw input_error("{}:{}: corner \"{}\" unlike the others of its face", file.string(),
                                      line, shown(corner));
                kinds = kind;
            }
            check_corners(file, corners, counts.faces);
            if (corners >= 3) ++counts.faces;
        }
        all = so_far;
    }
    counts.vertices = all[0];
    if (counts.vertices == 0 || counts.faces == 0)
        throw input_error("{}: {} vertices and {} faces, expected a mesh with triangles", file.string(),
                          counts.vertices, counts.faces);
    return counts;
}

}  // namespace

MeshCounts check_mesh(const Path& file, std::string_view extension, std::string_view bytes) {
    if (extension == ".ply") return check_ply(file, bytes);
    if (extension == ".off") return check_off(file, bytes);
    if (extension == ".stl") return check_stl(file, bytes);
    if (extension == ".obj") return check_obj(file, bytes);
    throw input_error("{}: unknown kind of mesh \"{}\", expected .ply, .obj, .off or .stl", file.string(),
                      extension);
}

}  // namespace pellucid
