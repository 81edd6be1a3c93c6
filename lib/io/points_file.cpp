#include "io/points_file.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "io/file_rows.hpp"
#include "io/input_file.hpp"

namespace pellucid {
namespace {

using namespace rows;

/// Squares of differences are numbers.
constexpr double kLargest = 1e150;

void add(const std::array<double, 6>& row, std::vector<OrientedPoint>& points, DroppedPoints& dropped) {
    const Vec3 position(row[0], row[1], row[2]);
    const Vec3 normal(row[3], row[4], row[5]);
    if (!std::all_of(row.begin(), row.begin() + 3, [](double x) { return std::abs(x) <= kLargest; })) {
        ++dropped.no_position;
        return;
    }
    const Vec3 size = glm::abs(normal);
    const double largest = std::max({size.x, size.y, size.z});
    const bool usable = std::isfinite(normal.x + normal.y + normal.z) && largest > 0;
    if (!usable) {
        ++dropped.no_normal;
        return;
    }
    const Vec3 unit = normalize(normal / largest);
    points.push_back({position, {static_cast<float>(unit.x), static_cast<float>(unit.y), static_cast<float>(unit.z)}});
}

constexpr std::array<std::string_view, 6> kColumns = {"x", "y", "z", "nx", "ny", "nz"};

void parse_ply(const Path& file, std::string_view bytes, std::vector<OrientedPoint>& points, DroppedPoints& dropped) {
    const PlyHeader header = ply_header(file, bytes);
    check_ply_counts(file, header);
    PlyBody body(file, header);
    bool found = false;
    for (const PlyElement& element : header.elements) {
        const bool vertices = element.name == "vertex" && !found;
        std::vector<std::size_t> column(element.properties.size(), kColumns.size());
        if (vertices) {
            found = true;
            std::array<bool, 6> has{};
            for (std::size_t i = 0; i < column.size(); ++i) {
                const PlyProperty& property = element.properties[i];
                const auto at = std::ranges::find(kColumns, std::string_view(property.name));
                if (at == kColumns.end() || property.count_type != PlyType::none) continue;
                column[i] = static_cast<std::size_t>(at - kColumns.begin());
                has[column[i]] = true;
            }
            if (!has[0] || !has[1] || !has[2]) throw input_error("{}: vertices without x, y, z", file.string());
            if (!has[3] || !has[4] || !has[5])
                throw input_error("{}: vertices without nx, ny, nz; a surface through points needs their normals",
                                  file.string());
            points.reserve(element.count);
        }
        if (found && !vertices) break;  // nothing of what follows is needed
        std::array<double, 6> row{};
        for (std::uint64_t i = 0; i < element.count; ++i) {
            for (std::size_t k = 0; k < column.size(); ++k) {
                const PlyProperty& property = element.properties[k];
                if (property.count_type == PlyType::none) {
                    const double value = body.next(property.type, element, i);
                    if (column[k] < row.size()) row[column[k]] = value;
                    continue;
                }
                const double length = body.next(property.count_type, element, i);
                if (!(length >= 0 && length <= static_cast<double>(bytes.size())))
                    throw input_error("{}: {} {}: a list of {} values", file.string(), shown(element.name), i, length);
                for (double j = 0; j < length; ++j) (void)body.next(property.type, element, i);
            }
            if (vertices) add(row, points, dropped);
        }
    }
    if (!found) throw input_error("{}: has no vertices", file.string());
}

void parse_xyz(const Path& file, std::string_view bytes, std::vector<OrientedPoint>& points, DroppedPoints& dropped) {
    if (bytes.find('\0') != std::string_view::npos) throw input_error("{}: not an XYZ file: not text", file.string());
    std::size_t line = 0;
    for (std::string_view rest = bytes; !rest.empty();) {
        const std::size_t end = std::min(rest.find('\n'), rest.size());
        const std::string_view text = rest.substr(0, end);
        rest.remove_prefix(std::min(end + 1, rest.size()));
        ++line;
        Words words(text.substr(0, text.find('#')));
        std::array<double, 6> row{};
        std::size_t count = 0;
        for (std::string_view word = words.next(); !word.empty(); word = words.next(), ++count) {
            double value = 0;
            if (!parse(word, value))
                throw input_error("{}:{}: \"{}\", expected a number", file.string(), line, shown(word));
            if (count < row.size()) row[count] = value;
        }
        if (count == 0) continue;
        if (count == 3)
            throw input_error("{}:{}: 3 numbers, expected x y z nx ny nz; a surface through points needs their normals",
                              file.string(), line);
        if (count != row.size())
            throw input_error("{}:{}: {} numbers, expected x y z nx ny nz", file.string(), line, count);
        add(row, points, dropped);
    }
}

}  // namespace

std::vector<OrientedPoint> parse_points(const std::filesystem::path& file, std::string_view extension,
                                        std::string_view bytes, DroppedPoints& dropped) {
    std::vector<OrientedPoint> points;
    if (bytes.empty()) throw input_error("{}: is empty", file.string());
    if (extension == ".ply")
        parse_ply(file, bytes, points, dropped);
    else if (extension == ".xyz")
        parse_xyz(file, bytes, points, dropped);
    else
        throw input_error("{}: unknown kind of points \"{}\", expected .ply or .xyz", file.string(), extension);
    return points;
}

std::vector<OrientedPoint> read_points(const std::filesystem::path& file) {
    const std::string bytes = read_input_file(file);
    DroppedPoints dropped;
    auto points = parse_points(file, lower_extension(file), bytes, dropped);
    if (dropped.no_position > 0)
        warn("{}: {} points whose position is no number are left out", file.string(), dropped.no_position);
    if (dropped.no_normal > 0)
        warn("{}: {} points whose normal is zero or no number are left out", file.string(), dropped.no_normal);
    return points;
}

}  // namespace pellucid
