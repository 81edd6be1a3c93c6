#include "core/image.hpp"

#include <cassert>

namespace pellucid {

std::span<float> Image::add(std::string_view name, float fill) {
    const auto [it, made] = planes_.try_emplace(std::string(name));
    if (made) it->second.assign(pixel_count(), fill);
    return it->second;
}

std::span<const float> Image::plane(std::string_view name) const {
    const auto it = planes_.find(name);
    assert(it != planes_.end());
    return it->second;
}

std::span<float> Image::plane(std::string_view name) {
    const auto it = planes_.find(name);
    assert(it != planes_.end());
    return it->second;
}

std::vector<std::string> Image::names() const {
    std::vector<std::string> all;
    all.reserve(planes_.size());
    for (const auto& [name, values] : planes_) all.push_back(name);
    return all;
}

}  // namespace pellucid
