// Rectangles: one flat patch, with or without an image.
#include <algorithm>
#include <cmath>

#include "io/image_file.hpp"
#include "scene/geometry_makers.hpp"
#include "scene/parallelogram.hpp"

namespace pellucid {
namespace {

class RectangleGeometry final : public SurfaceGeometry {
public:
    RectangleGeometry(const Parallelogram& place, Image image) : place_(place), image_(std::move(image)) {}

    [[nodiscard]] std::size_t patch_count() const override { return 1; }
    [[nodiscard]] int max_crossings() const override { return 1; }
    [[nodiscard]] Body body(std::size_t) const override { return place_.body(); }
    int crossings(std::size_t, const Line& line, CrossingList& out) const override { return place_.crossings(line, out); }
    [[nodiscard]] Box bounds() const override { return place_.bounds(); }
    [[nodiscard]] bool has_color() const override { return image_.pixel_count() > 0; }
    [[nodiscard]] std::optional<SurfaceTexture> texture() const override {
        if (!has_color()) return std::nullopt;
        return SurfaceTexture{&image_, place_.center, place_.u, place_.v};
    }

    /// Bilinear between pixel centres, clamped at the border; columns run along u, the top row is at +v.
    [[nodiscard]] Vec3 color(const Vec3& point) const override {
        const Vec2 place = place_.coordinates(point);
        const double x = std::clamp((0.5 + 0.5 * place.x) * image_.width() - 0.5, 0.0, image_.width() - 1.0);
        const double y =
            std::clamp((0.5 - 0.5 * place.y) * image_.height() - 0.5, 0.0, image_.height() - 1.0);
        const int column = static_cast<int>(x);
        const int row = static_cast<int>(y);
        const double fx = x - column;
        const double fy = y - row;
        Vec3 sum(0.0);
        for (int dy = 0; dy < 2; ++dy)
            for (int dx = 0; dx < 2; ++dx) {
                const double weight = (dx != 0 ? fx : 1 - fx) * (dy != 0 ? fy : 1 - fy);
                if (weight > 0) sum += weight * pixel(column + dx, row + dy);
            }
        return sum;
    }
    [[nodiscard]] std::size_t bytes() const override { return sizeof(*this) + 16 * image_.pixel_count(); }

private:
    [[nodiscard]] Vec3 pixel(int x, int y) const {
        const auto i = static_cast<std::size_t>(y) * static_cast<std::size_t>(image_.width()) +
                       static_cast<std::size_t>(x);
        return {image_.plane("R")[i], image_.plane("G")[i], image_.plane("B")[i]};
    }

    Parallelogram place_;
    Image image_;
};

}  // namespace

std::unique_ptr<SurfaceGeometry> make_rectangle(const Surface& surface, const RectangleShape& shape) {
    Image image;
    if (shape.image) {
        image = read_png(*shape.image);
        if (std::ranges::any_of(image.plane("A"), [](float a) { return a < 1; }))
            warn("{}: its opacity is not used, only its colour", shape.image->string());
    }
    const Affine& place = surface.to_world;
    return std::make_unique<RectangleGeometry>(
        Parallelogram{place.point(shape.center), place.vector(shape.u), place.vector(shape.v)}, std::move(image));
}

}  // namespace pellucid
