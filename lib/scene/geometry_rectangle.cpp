// Rectangles: one flat patch, with or without an image.
#include <algorithm>
#include <cmath>

#include "io/image_file.hpp"
#include "scene/geometry_makers.hpp"

namespace pellucid {
namespace {

class RectangleGeometry final : public SurfaceGeometry {
public:
    RectangleGeometry(const Vec3& center, const Vec3& u, const Vec3& v, Image image)
        : center_(center), u_(u), v_(v), normal_(cross(u, v)), image_(std::move(image)) {}

    [[nodiscard]] std::size_t patch_count() const override { return 1; }
    [[nodiscard]] int max_crossings() const override { return 1; }
    [[nodiscard]] Body body(std::size_t) const override {
        return {Body::Kind::parallelogram, center_ - u_ - v_, {2.0 * u_, 2.0 * v_, Vec3(0.0)}};
    }

    int crossings(std::size_t, const Line& line, CrossingList& out) const override {
        out.hits.clear();
        const double against = dot(normal_, line.direction);
        if (against == 0) return 0;
        const double t = dot(normal_, center_ - line.origin) / against;
        if (!(t >= line.t_lo && t <= line.t_hi)) return 0;
        const Vec2 place = coordinates(line.origin + t * line.direction);
        if (std::abs(place.x) > 1 || std::abs(place.y) > 1) return 0;
        out.hits.push_back({t, normal_});
        return 1;
    }

    [[nodiscard]] Box bounds() const override {
        Box box;
        for (const double a : {-1.0, 1.0})
            for (const double b : {-1.0, 1.0}) box.include(center_ + a * u_ + b * v_);
        return box;
    }
    [[nodiscard]] bool has_color() const override { return image_.pixel_count() > 0; }
    [[nodiscard]] std::optional<SurfaceTexture> texture() const override {
        if (!has_color()) return std::nullopt;
        return SurfaceTexture{&image_, center_, u_, v_};
    }

    /// Bilinear between pixel centres, clamped at the border; columns run along u, the top row is at +v.
    [[nodiscard]] Vec3 color(const Vec3& point) const override {
        const Vec2 place = coordinates(point);
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
    /// (a, b) with point = center + a u + b v, for a point of the plane.
    [[nodiscard]] Vec2 coordinates(const Vec3& point) const {
        const Vec3 from = point - center_;
        const double area2 = dot(normal_, normal_);
        return {dot(cross(from, v_), normal_) / area2, dot(cross(u_, from), normal_) / area2};
    }
    [[nodiscard]] Vec3 pixel(int x, int y) const {
        const auto i = static_cast<std::size_t>(y) * static_cast<std::size_t>(image_.width()) +
                       static_cast<std::size_t>(x);
        return {image_.plane("R")[i], image_.plane("G")[i], image_.plane("B")[i]};
    }

    Vec3 center_, u_, v_, normal_;
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
    return std::make_unique<RectangleGeometry>(place.point(shape.center), place.vector(shape.u),
                                               place.vector(shape.v), std::move(image));
}

}  // namespace pellucid
