#include "io/write_points.hpp"

#include <array>
#include <fstream>

#include <fmt/format.h>

#include "core/error.hpp"
#include "io/atomic_file.hpp"

namespace pellucid {

void write_points(std::span<const OrientedPoint> points, const std::filesystem::path& file) {
    write_atomically(file, [&](const std::filesystem::path& temporary) {
        std::ofstream out(temporary, std::ios::binary);
        out << fmt::format(
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
            "property float nx\nproperty float ny\nproperty float nz\nend_header\n",
            points.size());
        for (const OrientedPoint& p : points) {
            const std::array<float, 6> row{static_cast<float>(p.position.x), static_cast<float>(p.position.y),
                                           static_cast<float>(p.position.z), p.normal[0], p.normal[1], p.normal[2]};
            out.write(reinterpret_cast<const char*>(row.data()), sizeof row);
        }
        out.close();
        if (!out) throw run_error("{}: cannot be written", file.string());
    });
}

}  // namespace pellucid
