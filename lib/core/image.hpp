// Images as named planes of float32, the way OpenEXR thinks of them.
#pragma once

#include <cstddef>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace pellucid {

/// A width × height raster of named float planes ("R", "variance.A", "Z"); row 0 is on top.
/// `attributes` is free text for the file's header (scene, method, settings, seed, commit, …).
class Image {
public:
    Image() = default;
    /// Precondition: width, height >= 0.
    Image(int width, int height) : width_(width), height_(height) {}

    [[nodiscard]] int width() const { return width_; }
    [[nodiscard]] int height() const { return height_; }
    [[nodiscard]] std::size_t pixel_count() const {
        return static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_);
    }

    /// The plane called `name`, made (filled with `fill`) where there is none yet.
    std::span<float> add(std::string_view name, float fill = 0.0F);
    [[nodiscard]] bool has(std::string_view name) const { return planes_.find(name) != planes_.end(); }
    /// Precondition: has(name).
    [[nodiscard]] std::span<const float> plane(std::string_view name) const;
    [[nodiscard]] std::span<float> plane(std::string_view name);
    [[nodiscard]] std::vector<std::string> names() const;

    std::map<std::string, std::string> attributes;

private:
    int width_ = 0;
    int height_ = 0;
    std::map<std::string, std::vector<float>, std::less<>> planes_;
};

}  // namespace pellucid
